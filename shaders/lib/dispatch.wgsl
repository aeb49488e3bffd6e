// Which item an invocation works on.

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
