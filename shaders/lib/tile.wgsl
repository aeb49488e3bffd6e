// Tiles: pixel and sample of a point. A tile is a number of whole rows of the image, with several samples of each
// pixel. Each sample is a layer of `pixel_count` points; the layers follow one another.

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
    // 1: rays go through the centre of the pixel (a render of one sample), 0: anywhere in it (box filter).
    centred: u32,
}

// Image coordinates of the pixel of point i.
fn tile_pixel(tile: Tile, i: u32) -> vec2u {
    let pixel = i % tile.pixel_count;
    return vec2u(pixel % tile.width, tile.first_row + pixel / tile.width);
}

// Sample index of point i.
fn tile_sample(tile: Tile, i: u32) -> u32 {
    return tile.first_sample + i / tile.pixel_count;
}

// The seed of a pixel's sample sequences. It does not depend on the tiles.
fn pixel_seed(tile: Tile, i: u32) -> u32 {
    let pixel = tile_pixel(tile, i);
    return hash2(pixel.x + pixel.y * tile.width, tile.seed);
}
