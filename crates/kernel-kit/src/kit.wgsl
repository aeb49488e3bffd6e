// Which item an invocation works on, where a dispatch may have more groups than fit one dimension.

// The groups of `Frame::run` are laid out in two dimensions where they are more than MAX_GROUPS; their linear index.
// The last groups may be past the last item.
fn group_index(group: vec3u, groups: vec3u) -> u32 {
    return group.x + group.y * groups.x;
}

// The size of a dispatch of `items` in workgroups of `size`, for kernels that write the arguments of an indirect
// dispatch.
fn dispatch_groups(items: u32, size: u32) -> vec3u {
    let groups = (items + size - 1u) / size;
    return vec3u(min(groups, MAX_GROUPS), (groups + MAX_GROUPS - 1u) / MAX_GROUPS, 1u);
}
