// An exact sphere about the origin. Parameter: its radius.
fn sphere(origin: vec3f, direction: vec3f, nearest: f32, parameters: vec4f) -> vec4f {
    let radius = parameters.x;
    // The point of the line nearest to the centre, and half the chord from there. The difference of squares is a
    // product, because the usual discriminant loses digits (Haines et al. 2019, Ray Tracing Gems, chapter 7).
    let along = -dot(origin, direction);
    let across = origin + along * direction;
    let offset = length(across);
    let half_squared = (radius - offset) * (radius + offset);
    if half_squared <= 0.0 { return vec4f(-1.0); }
    let half = sqrt(half_squared);
    let t = select(along + half, along - half, along - half > nearest);
    return vec4f(origin + t * direction, t);
}
