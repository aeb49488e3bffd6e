// Sphere tracing (Hart 1996) from one side of the surface to the other. No step is shorter than epsilon. A step that
// crosses the surface is halved until it is at most epsilon long. The result is the far end of the last step: it is on
// the other side, so that the search for the next crossing can start there.
//
// A ray that skims the surface would need a quarter of a million steps of epsilon, so the minimum step grows twofold
// every 70 iterations. This does not move a crossing, but misses two crossings that are closer to each other than the
// minimum step.
fn procedural_next_SUFFIX(
    origin: vec3f, direction: vec3f, so_far: f32, end: f32, epsilon: f32, parameters: vec4f,
) -> vec4f {
    var t = so_far;
    let first = procedural_function_SUFFIX(origin + t * direction, parameters);
    let side = select(-1.0, 1.0, first >= 0.0);
    var finite = is_finite4(vec4f(first));
    var step = max(abs(first), epsilon);
    var min_step = epsilon;
    var crossed = false;
    while finite && t < end && procedural_iterations < PROCEDURAL_ITERATIONS {
        procedural_iterations++;
        let next = t + step;
        let there = procedural_function_SUFFIX(origin + next * direction, parameters);
        finite = is_finite4(vec4f(there));
        // The result of a function whose loops were ended is not valid.
        if !finite || procedural_iterations >= PROCEDURAL_ITERATIONS { break; }
        min_step *= 1.01;
        let crosses = there * side < 0.0;
        if crosses && step <= epsilon { return vec4f(0.0, 0.0, 0.0, select(-1.0, next, next <= end)); }
        crossed |= crosses;
        t = select(next, t, crosses);
        step = select(max(abs(there), min_step), max(0.5 * step, epsilon), crossed);
    }
    if !finite { return procedural_lost(true); }
    if procedural_iterations >= PROCEDURAL_ITERATIONS { return procedural_lost(false); }
    return NO_CROSSING;
}

// Central differences along four diagonals of a cube, which form a tetrahedron. Their distance of eight epsilon leaves
// enough digits in the differences, and rounds edges by no more than that.
fn procedural_gradient_SUFFIX(position: vec3f, epsilon: f32, parameters: vec4f) -> vec3f {
    let h = 8.0 * epsilon;
    let a = vec3f(1.0, -1.0, -1.0);
    return a.xyy * procedural_function_SUFFIX(position + h * a.xyy, parameters)
        + a.yyx * procedural_function_SUFFIX(position + h * a.yyx, parameters)
        + a.yxy * procedural_function_SUFFIX(position + h * a.yxy, parameters)
        + a.xxx * procedural_function_SUFFIX(position + h * a.xxx, parameters);
}
