// Menger's sponge in the cube of edge 2 about the origin. Parameter: number of levels.
fn menger(position: vec3f, parameters: vec4f) -> f32 {
    let beyond = abs(position) - 1.0;
    var distance = length(max(beyond, vec3f(0.0))) + min(max(beyond.x, max(beyond.y, beyond.z)), 0.0);
    var scale = 1.0;
    for (var level = 0; level < i32(parameters.x); level++) {
        // Position in the cell of this level, -1 to 1. The middle third of the cell is hollow along each axis.
        let p = scale * position + 1.0;
        let cell = p - 2.0 * floor(0.5 * p) - 1.0;
        scale *= 3.0;
        let r = 3.0 * abs(cell) - 1.0;
        let bars = min(max(r.x, r.y), min(max(r.y, r.z), max(r.z, r.x)));
        distance = max(distance, -bars / scale);
    }
    return distance;
}
