// Tables: arrays of vectors that kernels read through textures where the device is a software one.
// In: the index of a vector. Out: the texel that holds it.

import package::kit::TABLE_WIDTH_LOG2;

fn table_texel(i: u32) -> vec2u {
    return vec2u(i & ((1u << TABLE_WIDTH_LOG2) - 1u), i >> TABLE_WIDTH_LOG2);
}
