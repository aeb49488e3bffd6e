// Tiles: pixel and sample of a point. A tile is a number of whole rows of the image, or of the part of it that is
// rendered, with several samples of each pixel. The samples of a pixel are neighbours, because neighbouring lanes then
// trace rays that visit the same nodes, and interpolate from the same irradiance records. With adaptive sampling only
// the listed pixels of these rows are in the tile.

@if(adaptive_sampling) import package::lib::constants::NOT_SAMPLED;
import package::lib::math::{quotient, remainder};
import package::lib::rng::hash2;

struct Tile {
    // Size of the whole image.
    width: u32,
    height: u32,
    // First pixel of the tile, its size, and pixels that get samples.
    first_column: u32,
    first_row: u32,
    columns: u32,
    rows: u32,
    pixel_count: u32,
    // Points in it: pixels times samples.
    point_count: u32,
    // Index of the first sample of each pixel, and the render's seed.
    first_sample: u32,
    seed: u32,
    // 1: rays go through the centre of the pixel (a render of one sample), 0: anywhere in it (box filter). In general
    // they go through a square around the centre, with a side of 1 - centred pixels.
    centred: f32,
    // Samples of each pixel in it.
    samples_per_pixel: u32,
}

// The pixels that get samples. A pixel's index counts from the first one of the tile's rows.
@if(adaptive_sampling) @group(1) @binding(34) var<storage, read> sampled_pixels: array<u32>;

// For each pixel of the tile's rows its index in that list, or NOT_SAMPLED.
@if(adaptive_sampling) @group(1) @binding(35) var<storage, read> list_indices: array<u32>;

// Index of the pixel of point i.
fn pixel_index(tile: Tile, i: u32) -> u32 {
    @if(adaptive_sampling) { return sampled_pixels[quotient(i, tile.samples_per_pixel)]; }
    @else { return quotient(i, tile.samples_per_pixel); }
}

// The point of the first sample of a pixel, by the pixel's index, or NOT_SAMPLED.
fn first_point_of(tile: Tile, pixel: u32) -> u32 {
    @if(adaptive_sampling) {
        let index = list_indices[pixel];
        return select(index * tile.samples_per_pixel, NOT_SAMPLED, index == NOT_SAMPLED);
    }
    @else { return pixel * tile.samples_per_pixel; }
}

// Column and row of the pixel of point i within the tile.
fn tile_position(tile: Tile, i: u32) -> vec2u {
    let pixel = pixel_index(tile, i);
    let row = quotient(pixel, tile.columns);
    return vec2u(pixel - row * tile.columns, row);
}

// Image coordinates of the pixel of point i.
fn tile_pixel(tile: Tile, i: u32) -> vec2u {
    return tile_position(tile, i) + vec2u(tile.first_column, tile.first_row);
}

// Sample index of point i.
fn tile_sample(tile: Tile, i: u32) -> u32 {
    return tile.first_sample + remainder(i, tile.samples_per_pixel);
}

// The seed of a pixel's sample sequences. It does not depend on the tiles, nor on the part that is rendered.
fn pixel_seed(tile: Tile, i: u32) -> u32 {
    let pixel = tile_pixel(tile, i);
    return hash2(pixel.x + pixel.y * tile.width, tile.seed);
}
