// Solid white marble with grey veins. Parameter: number of features per unit of length.
fn marble(base: vec3f, position: vec3f, parameters: vec4f) -> vec3f {
    let scaled = parameters.x * position;
    let warp = vec3f(
        fractal(1.4 * scaled + 3.0, 5u),
        fractal(1.4 * scaled + 17.0, 5u),
        fractal(1.4 * scaled + 29.0, 5u),
    );
    let p = scaled + 0.45 * warp;
    // Veins are zeros of distorted planes that fade in and out. Some are broad and faint, others fine and dark.
    let broad = fade(p, 41.0) * vein(1.3 * dot(p, vec3f(0.6, 0.7, 0.4)), 0.35);
    let fine = fade(p, 53.0) * vein(1.9 * dot(p, vec3f(-0.7, 0.5, 0.5)), 0.1);
    let crossing = fade(p, 67.0) * vein(1.1 * dot(p, vec3f(0.2, -0.4, 0.9)) + 0.3, 0.06);
    let white = base * (1.0 - 0.12 * (0.5 + 0.5 * fractal(2.5 * p, 4u)));
    let dark = base * vec3f(0.05, 0.05, 0.07);
    return mix(mix(mix(white, 0.24 * base, 0.7 * broad), dark, 0.9 * fine), dark, 0.8 * crossing);
}

fn fade(p: vec3f, offset: f32) -> f32 {
    return clamp(0.45 + fractal(1.7 * p + offset, 3u), 0.0, 1.0);
}

// 1 at integers x, falling to 0 over the width.
fn vein(x: f32, width: f32) -> f32 {
    let height = max(1.0 - abs(x - round(x)) / width, 0.0);
    return height * height;
}

fn fractal(p: vec3f, octaves: u32) -> f32 {
    var sum = 0.0;
    var size = 1.0;
    for (var i = 0u; i < octaves; i++) {
        sum += size * noise(p / size);
        size *= 0.5;
    }
    return sum;
}

// Random values in -1 to 1 at integer coordinates with smooth interpolation.
fn noise(p: vec3f) -> f32 {
    let cell = floor(p);
    let t = smoothstep(vec3f(0.0), vec3f(1.0), p - cell);
    let at = vec3i(cell);
    let low = mix(
        mix(value(at), value(at + vec3i(1, 0, 0)), t.x),
        mix(value(at + vec3i(0, 1, 0)), value(at + vec3i(1, 1, 0)), t.x),
        t.y,
    );
    let high = mix(
        mix(value(at + vec3i(0, 0, 1)), value(at + vec3i(1, 0, 1)), t.x),
        mix(value(at + vec3i(0, 1, 1)), value(at + vec3i(1, 1, 1)), t.x),
        t.y,
    );
    return mix(low, high, t.z);
}

// The first component of PCG in three dimensions (Jarzynski and Olano 2020).
fn value(cell: vec3i) -> f32 {
    var v = vec3u(cell) * 1664525u + 1013904223u;
    v.x += v.y * v.z;
    v.y += v.z * v.x;
    v.z += v.x * v.y;
    v ^= v >> vec3u(16u);
    v.x += v.y * v.z;
    return f32(v.x) / 2147483648.0 - 1.0;
}
