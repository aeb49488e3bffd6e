// Which item an invocation works on, and how many workgroups there are.

import package::lib::constants::MAX_GROUPS;

// Groups of a dispatch of more than 65,535 are laid out in two dimensions; their linear index. On lavapipe the
// groups of a dispatch are split in two contiguous halves, one a thread: interleaving them levels uneven work.
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

// The size of a dispatch of `items` in workgroups of `size`, as `dispatch_size` in src/gpu/frame.rs has it.
fn dispatch_groups(items: u32, size: u32) -> vec3u {
    let groups = (items + size - 1u) / size;
    return vec3u(min(groups, MAX_GROUPS), (groups + MAX_GROUPS - 1u) / MAX_GROUPS, 1u);
}
