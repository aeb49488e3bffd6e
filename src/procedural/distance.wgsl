// Sphere tracing (Hart 1996) from one side of the surface to the other: no step is shorter than epsilon, and one that has
// crossed the surface is halved until it is no longer than that. Gives the far end of the last step, which is on the other
// side, so that the next crossing can be looked for from there.
//
// A ray that skims the surface would take a quarter of a million steps of epsilon. So the shortest step grows, twofold in 70
// turns: what is missed of a crossing is none of its place, but two that are nearer to each other than that.
fn procedural_next_SUFFIX(origin: vec3f, direction: vec3f, so_far: f32, end: f32, epsilon: f32, parameters: vec4f) -> vec4f {
    var t = so_far;
    let first = procedural_function_SUFFIX(origin + t * direction, parameters);
    let side = select(-1.0, 1.0, first >= 0.0);
    var finite = is_finite4(vec4f(first));
    var step = max(abs(first), epsilon);
    var least = epsilon;
    var crossed = false;
    while finite && t < end && procedural_iterations < PROCEDURAL_ITERATIONS {
        procedural_iterations++;
        let next = t + step;
        let there = procedural_function_SUFFIX(origin + next * direction, parameters);
        finite = is_finite4(vec4f(there));
        // Past its turns a function's answer is none.
        if !finite || procedural_iterations >= PROCEDURAL_ITERATIONS { break; }
        least *= 1.01;
        let crosses = there * side < 0.0;
        if crosses && step <= epsilon { return vec4f(0.0, 0.0, 0.0, select(-1.0, next, next <= end)); }
        crossed |= crosses;
        t = select(next, t, crosses);
        step = select(max(abs(there), least), max(0.5 * step, epsilon), crossed);
    }
    if !finite { return procedural_lost(true); }
    if procedural_iterations >= PROCEDURAL_ITERATIONS { return procedural_lost(false); }
    return NO_CROSSING;
}

// Central differences along the diagonals of a cube that make a tetrahedron. Eight times epsilon: differences have digits
// enough, and edges are no rounder than that.
fn procedural_gradient_SUFFIX(place: vec3f, epsilon: f32, parameters: vec4f) -> vec3f {
    let h = 8.0 * epsilon;
    let a = vec3f(1.0, -1.0, -1.0);
    return a.xyy * procedural_function_SUFFIX(place + h * a.xyy, parameters)
        + a.yyx * procedural_function_SUFFIX(place + h * a.yyx, parameters)
        + a.yxy * procedural_function_SUFFIX(place + h * a.yxy, parameters)
        + a.xxx * procedural_function_SUFFIX(place + h * a.xxx, parameters);
}
