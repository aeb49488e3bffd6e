// Stores points' shadow rays in fine cells, and looks up the points' classes, for a test to compare.

import package::kit::group_index;
import package::lib::fine_cell::{fine_class, store_rays};

struct Rays {
    position: vec3f,
    // Rays that reached the light in bits 0-7, those that did not in bits 8-15, the light above.
    word: u32,
    normal: vec3f,
    padding: u32,
}

override count: u32;

@group(0) @binding(0) var<storage, read> rays: array<Rays>;
// The class, and 8 where a boundary is near.
@group(0) @binding(1) var<storage, read_write> found: array<u32>;

@compute @workgroup_size(64)
fn store(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = group_index(group, groups) * 64u + lane;
    if i >= count { return; }
    let r = rays[i % arrayLength(&rays)];
    store_rays(r.word >> 16u, r.position, r.normal, r.word & 255u, (r.word >> 8u) & 255u);
}

@compute @workgroup_size(64)
fn look_up(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = group_index(group, groups) * 64u + lane;
    if i >= count { return; }
    let r = rays[i];
    let fine = fine_class(r.word >> 16u, r.position, r.normal);
    found[i] = fine.class_ | (u32(fine.near) << 3u);
}
