// Tiles: pixel and sample of a point. A tile is a number of whole rows of the image, with several samples of each
// pixel. Each sample is a layer of `pixel_count` points; the layers follow one another.

import package::lib::constants::{DIMENSION_HALF, SAMPLING_HALVES};
import package::lib::rng::hash2;

struct Tile {
    // Size of the image.
    width: u32,
    height: u32,
    // First row of the tile, and pixels in it.
    first_row: u32,
    pixel_count: u32,
    // Points in it: pixels times layers.
    point_count: u32,
    // Sample index of the first layer, and the render's seed.
    first_sample: u32,
    seed: u32,
    // How pixels are sampled: SAMPLING_ANYWHERE, SAMPLING_CENTRED or SAMPLING_HALVES.
    sampling: u32,
}

// Image coordinates of the pixel of point i.
fn tile_pixel(tile: Tile, i: u32) -> vec2u {
    let pixel = i % tile.pixel_count;
    return vec2u(pixel % tile.width, tile.first_row + pixel / tile.width);
}

// Number of the sample that point i is.
fn sample_number(tile: Tile, i: u32) -> u32 {
    return tile.first_sample + i / tile.pixel_count;
}

// Index of point i in the sequences of its seed.
fn tile_sample(tile: Tile, i: u32) -> u32 {
    let number = sample_number(tile, i);
    return select(number, number >> 1u, tile.sampling == SAMPLING_HALVES);
}

// The seed of the sample sequences of point i's pixel, and of its half of the samples. It does not depend on the tiles.
fn pixel_seed(tile: Tile, i: u32) -> u32 {
    let pixel = tile_pixel(tile, i);
    let seed = hash2(pixel.x + pixel.y * tile.width, tile.seed);
    let is_other_half = tile.sampling == SAMPLING_HALVES && (sample_number(tile, i) & 1u) == 1u;
    return select(seed, hash2(seed, DIMENSION_HALF), is_other_half);
}
