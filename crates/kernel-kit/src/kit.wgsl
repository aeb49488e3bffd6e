// Which item an invocation works on, where a dispatch may have more workgroups than fit one dimension.

// The linear index of a workgroup. `Frame::run` lays out more than MAX_GROUPS workgroups in two dimensions; the last
// ones may be past the last item. Lavapipe splits the workgroups of a dispatch into two contiguous halves, one a
// thread: with the feature `interleave` workgroups alternate between the halves, which balances uneven work.
fn group_index(group: vec3u, groups: vec3u) -> u32 {
    return FIRST_GROUP + index_in_slice(group, groups);
}

// The first workgroup of this part of a dispatch. On devices with a watchdog the host sets it: a uniform variable takes
// the constant's place (src/adapted.rs).
const FIRST_GROUP = 0u;

fn index_in_slice(group: vec3u, groups: vec3u) -> u32 {
    let linear = group.x + group.y * groups.x;
    @if(interleave) {
        let count = groups.x * groups.y;
        if count % 2u == 0u {
            return select((linear * 2u - count) | 1u, linear * 2u, linear * 2u < count);
        }
    }
    return linear;
}

// The size of a dispatch of `items` in workgroups of `size`, for kernels that write the arguments of an indirect
// dispatch.
fn dispatch_groups(items: u32, size: u32) -> vec3u {
    let groups = (items + size - 1u) / size;
    return vec3u(min(groups, MAX_GROUPS), (groups + MAX_GROUPS - 1u) / MAX_GROUPS, 1u);
}
