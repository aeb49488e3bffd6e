fn procedural_next_SUFFIX(
    origin: vec3f, direction: vec3f, so_far: f32, end: f32, epsilon: f32, parameters: vec4f,
) -> vec4f {
    // The search continues slightly beyond the previous crossing, because its distance is rounded.
    let nearest = so_far + select(0.0, epsilon, so_far > 0.0);
    let met = procedural_function_SUFFIX(origin, direction, nearest, parameters);
    if procedural_iterations >= PROCEDURAL_ITERATIONS { return procedural_lost(false); }
    let there = met.w > nearest && met.w <= end;
    if !is_finite4(select(vec4f(met.w), met, there)) || (there && all(met.xyz == vec3f(0.0))) {
        return procedural_lost(true);
    }
    return select(NO_CROSSING, met, there);
}
