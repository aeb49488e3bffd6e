// Mathematics that many kernels share: finiteness by bits, angles, luminance, orthonormal bases and the octahedral map
// of unit vectors (Cigolle et al. 2014). Angles are in radians. Nothing is bound here.

const PI = 3.14159265358979;

fn safe_sqrt(x: f32) -> f32 {
    return sqrt(max(x, 0.0));
}

// Whether no component is infinite or NaN. It tests bits, as a compiler may assume that comparisons never see a NaN.
fn is_finite4(v: vec4f) -> bool {
    return all((bitcast<vec4u>(v) & vec4u(0x7f800000u)) != vec4u(0x7f800000u));
}

fn is_finite3(v: vec3f) -> bool {
    return is_finite4(vec4f(v, 0.0));
}

// NaN, the value of an invalid sample, which the film leaves out and counts. `bits` may be any value that is not a
// constant, as compilers reject a constant NaN.
fn invalid_sample(bits: u32) -> f32 {
    return bitcast<f32>(bits | 0x7fc00000u);
}

// The angle, 0 to pi, between a vector (x, y) and the x axis, for y >= 0; x and y must not both be 0. The error is at
// most 2 ULP. WGSL allows atan2 an error of 4096 ULP, and lavapipe's has 130: too much for the closed form of a distant
// polygonal light, a sum of angles that cancel. (This is Cephes' atanf. Its polynomial is valid up to tan(pi / 8);
// other angles are computed from the diagonal or from the y axis.)
fn angle_of(y: f32, x: f32) -> f32 {
    let low = min(y, abs(x));
    let high = max(y, abs(x));
    let middle = low > 0.41421356 * high;
    let t = select(low, low - high, middle) / select(high, low + high, middle);
    let z = t * t;
    let bend = (((0.0805374449538 * z - 0.138776856032) * z + 0.199777106478) * z - 0.333329491539) * z * t;
    let octant = select(0.0, 0.25 * PI, middle) + (bend + t);
    let quadrant = select(octant, 0.5 * PI - octant, y > abs(x));
    return select(quadrant, PI - quadrant, x < 0.0);
}

// Sine of an angle in turns, at most a quarter turn either way. The polynomial is minimax, with a relative error of
// 5e-9. Rounding makes that 2e-7, or 7e-7 where a device rounds towards 0, as Vulkan permits. This replaces WGSL's sin
// and cos, which Vulkan permits an absolute error of 2^-11: directions would not have unit length, and sines of small
// angles would be nothing but error.
fn quarter_sine(turns: vec2f) -> vec2f {
    let z = turns * turns;
    let p = (((39.71092224 * z - 76.57498932) * z + 81.60223389) * z - 41.34167862) * z + 6.283185482;
    return turns * p;
}

// The point of the unit circle at an angle in turns: its cosine and sine, with the errors of `quarter_sine`. Multiples
// of a quarter turn are exact. A sine near 0 keeps its relative precision, if the angle does.
fn circle_point(turns: f32) -> vec2f {
    let t = turns - round(turns);
    return quarter_sine(vec2f(0.25 - abs(t), max(min(t, 0.5 - t), -0.5 - t)));
}

// The quotient of unsigned integers, if it is below 2^20 and the divisor below 2^31: conversions and the division,
// which Vulkan allows 2.5 ULP, are less than one off then. Software devices divide integers lane by lane.
fn quotient(n: u32, d: u32) -> u32 {
    let near = u32(f32(n) / f32(d));
    let left = bitcast<i32>(n - near * d);
    return near + u32(left >= bitcast<i32>(d)) - u32(left < 0);
}

fn remainder(n: u32, d: u32) -> u32 {
    return n - quotient(n, d) * d;
}

// Relative luminance of linear Rec. 709 colour.
fn luminance(colour: vec3f) -> f32 {
    return dot(colour, vec3f(0.2126, 0.7152, 0.0722));
}

// Columns: two tangents, and the unit vector n (Duff et al. 2017).
fn basis(n: vec3f) -> mat3x3f {
    let sign = select(-1.0, 1.0, n.z >= 0.0);
    let a = -1.0 / (sign + n.z);
    let b = n.x * n.y * a;
    return mat3x3f(
        vec3f(1.0 + sign * n.x * n.x * a, sign * b, -sign * n.x),
        vec3f(b, sign + n.y * n.y * a, -n.y),
        n,
    );
}

// The octahedral map of a unit vector, -1 to 1 (Cigolle et al. 2014).
fn oct_wrap(n: vec3f) -> vec2f {
    let p = n.xy / (abs(n.x) + abs(n.y) + abs(n.z));
    let folded = (1.0 - abs(p.yx)) * select(vec2f(-1.0), vec2f(1.0), p >= vec2f(0.0));
    return select(folded, p, n.z >= 0.0);
}

fn oct_unwrap(p: vec2f) -> vec3f {
    return normalize(oct_unfold(p, 1.0));
}

// The point of the octahedron |x| + |y| + |z| = size that the octahedral map takes to p.
fn oct_unfold(p: vec2f, size: f32) -> vec3f {
    let z = size - abs(p.x) - abs(p.y);
    let fold = max(-z, 0.0);
    return vec3f(p - select(vec2f(-fold), vec2f(fold), p >= vec2f(0.0)), z);
}

// A unit vector in 32 bits, within 7e-5 radians; see oct_encode7 for the estimate.
fn oct_encode16(n: vec3f) -> u32 {
    return pack2x16snorm(oct_wrap(n));
}

fn oct_decode16(bits: u32) -> vec3f {
    return oct_unwrap(unpack2x16snorm(bits));
}

// A unit vector in 14 bits, within 0.034 radians. The error is half a step of 1/63 in each coordinate, which the map
// stretches threefold where the coordinates are equal. A coordinate has 127 levels, so that the axes are exact.
fn oct_encode7(n: vec3f) -> u32 {
    let q = vec2u(round(oct_wrap(n) * 63.0 + 63.0));
    return q.x | (q.y << 7u);
}

fn oct_decode7(bits: u32) -> vec3f {
    return normalize(oct_direction7(bits));
}

// The direction of a code's vector, with integer coordinates; not normalised.
fn oct_direction7(bits: u32) -> vec3f {
    return oct_unfold(vec2f(vec2i(vec2u(bits, bits >> 7u) & vec2u(127u)) - 63), 63.0);
}

// Whether the vector of a code is within an angle, below 90 degrees, of the unit vector n; `cosine_squared` is the
// squared cosine of the angle. The vector is not normalised: the square root and the divisions took a quarter of the
// time of a photon search.
fn oct_within7(bits: u32, n: vec3f, cosine_squared: f32) -> bool {
    let v = oct_direction7(bits);
    let along = dot(v, n);
    return along > 0.0 && along * along >= cosine_squared * dot(v, v);
}
