import package::lib::scale::scaled;
override times: u32 = 1u;
@group(0) @binding(0) var<storage, read_write> values: array<u32>;
@compute @workgroup_size(1) fn double() { values[0] = scaled(values[0] * times); }
