// Stores points' shadow rays in fine cells, and looks up the points' classes, for a test to compare.

import package::kit::group_index;
import package::lib::fine_cell::{fine_class, store_rays};

override count: u32;

// Of each point two vectors: position and word (rays that reached the light in bits 0-7, those that did not in bits
// 8-15, the light above), and normal.
@group(0) @binding(0) var<storage, read> rays: array<vec4f>;
// The class, and above it how the cell lies (lib/class_word).
@group(0) @binding(1) var<storage, read_write> found: array<u32>;

@compute @workgroup_size(64)
fn store(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = group_index(group, groups) * 64u + lane;
    if i >= count { return; }
    let point = i % (arrayLength(&rays) / 2u);
    let word = bitcast<u32>(rays[2u * point].w);
    store_rays(word >> 16u, rays[2u * point].xyz, rays[2u * point + 1u].xyz, word & 255u, (word >> 8u) & 255u);
}

@compute @workgroup_size(64)
fn look_up(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = group_index(group, groups) * 64u + lane;
    if i >= count { return; }
    let word = bitcast<u32>(rays[2u * i].w);
    let fine = fine_class(word >> 16u, rays[2u * i].xyz, rays[2u * i + 1u].xyz);
    found[i] = fine.class_ | (fine.nearness << 3u);
}
