// Dispatches: the linear index of a workgroup, and the size of a dispatch for a number of items.

import package::lib::constants::MAX_GROUPS;

// Linear index of a workgroup; more than 65,535 workgroups are laid out in two dimensions. Lavapipe splits the
// workgroups of a dispatch in two contiguous halves, one a thread: interleaving them balances uneven work.
fn group_index(group: vec3u, groups: vec3u) -> u32 {
    let linear = group.x + group.y * groups.x;
    @if(interleave) {
        let count = groups.x * groups.y;
        if count % 2u == 0u {
            return select((linear * 2u - count) | 1u, linear * 2u, linear * 2u < count);
        }
    }
    return linear;
}

// The size of a dispatch of `items` in workgroups of `size`, as `dispatch_size` in src/gpu/frame.rs.
fn dispatch_groups(items: u32, size: u32) -> vec3u {
    let groups = (items + size - 1u) / size;
    return vec3u(min(groups, MAX_GROUPS), (groups + MAX_GROUPS - 1u) / MAX_GROUPS, 1u);
}
