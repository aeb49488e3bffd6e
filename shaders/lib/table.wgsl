// Where a record of a table is, where tables are textures.

import package::lib::constants::TABLE_WIDTH_LOG2;

fn table_place(i: u32) -> vec2u {
    return vec2u(i & ((1u << TABLE_WIDTH_LOG2) - 1u), i >> TABLE_WIDTH_LOG2);
}
