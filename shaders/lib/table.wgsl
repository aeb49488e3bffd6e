// Tables: arrays of vectors that kernels read through textures where the device is a software one, or a table is large.
// In: the index of a vector. Out: the texel that holds it.

import package::kit::{TABLE_LAYER_ROWS_LOG2, TABLE_WIDTH_LOG2};

fn table_texel(i: u32) -> vec2u {
    return vec2u(i & ((1u << TABLE_WIDTH_LOG2) - 1u), i >> TABLE_WIDTH_LOG2);
}

// For a table in layers: the texel within the layer.
fn layer_texel(i: u32) -> vec2u {
    return table_texel(i & ((1u << (TABLE_WIDTH_LOG2 + TABLE_LAYER_ROWS_LOG2)) - 1u));
}

// For a table in layers: the layer.
fn table_layer(i: u32) -> u32 {
    return i >> (TABLE_WIDTH_LOG2 + TABLE_LAYER_ROWS_LOG2);
}
