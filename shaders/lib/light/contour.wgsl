// The closed form of mesh lights: Lambert's formula for polygons, over their contours.

import package::lib::constants::{LIGHT_CONTOUR_TEXEL, LIGHT_SPHERE_TEXEL, LIGHT_TWO_SIDED};
import package::lib::light::emitter::{IN_PLANE, load_light_vertex};
import package::lib::light::table::{light_texel, light_texel_f32};
import package::lib::math::angle_of;

// Lambert's term of a side from a to b, both relative to the position: the angle it spans times the component along n
// of the unit normal of the plane of position and side. `across` is a x (b - a), which is more precise than a x b for
// sides that are short compared with their distance.
fn edge_term(a: vec3f, b: vec3f, across: vec3f, n: vec3f) -> f32 {
    let sine = length(across);
    // A side in line with the position spans no angle.
    return select(angle_of(sine, dot(a, b)) * (dot(n, across) / sine), 0.0, sine == 0.0);
}

// Lights farther away than this number of radii of their bounding sphere use `small_edge_term`, which is more precise
// for them. Its series assumes sides of less than a quarter of the distance.
const SMALL_LIGHT = 8.0;

// Lambert's term for a side of a small light, times the squared length of `base`. `base` leads from the position to a
// point of the contour's plane, `offset_a` and `offset_b` from there to the side's ends; `across` is that of
// `edge_term`.
//
// Lambert's terms are proportional to the width of the light, but their sum to its area: they cancel. For a light a
// thousandth as wide as its distance, Lambert's formula keeps three digits. Write a term as n . (a x b) f(a, b), where
// f is the angle over |a x b|. With the constant f = 1 / base^2, the sum over a closed contour is that of n . (offset_a
// x offset_b) / base^2, which is precise because it only uses differences of vertices. The rest, f base^2 - 1, is small
// by itself; it follows from the ends' distances and from the ratio of the angle to its sine.
fn small_edge_term(base: vec3f, offset_a: vec3f, offset_b: vec3f, across: vec3f, n: vec3f) -> f32 {
    let inverse = 1.0 / dot(base, base);
    let area = cross(offset_a, offset_b);
    // Squared distances of the ends over base^2, minus 1.
    let farther_a = dot(offset_a, offset_a + 2.0 * base) * inverse;
    let farther_b = dot(offset_b, offset_b + 2.0 * base) * inverse;
    let farther = farther_a + farther_b + farther_a * farther_b;
    let root = sqrt(1.0 + farther);
    let nearer = -farther / (root * (1.0 + root));
    // The series of asin(x) / x - 1. x is at most 1/4, and the truncation error 2e-8.
    let sine2 = dot(across, across) * inverse * inverse / (1.0 + farther);
    let bent = sine2 * (1.0 / 6.0 + sine2 * (3.0 / 40.0 + sine2 * (5.0 / 112.0 + sine2 * (35.0 / 1152.0))));
    return dot(n, area + across * (nearer + bent + nearer * bent));
}

fn contour_term(small: bool, base: vec3f, a: vec3f, b: vec3f, n: vec3f) -> f32 {
    let across = cross(select(a, base + a, small), b - a);
    // Software devices execute both branches of an `if`, and more slowly.
    return select(edge_term(a, b, across, n), small_edge_term(base, a, b, across, n), small);
}

// A contour of a light, whose vertices are relative to `origin`: the position, or the first vertex of a small light.
struct Contour {
    small: bool,
    // From the position to the first vertex.
    base: vec3f,
    origin: vec3f,
    // Vertices in the table; the last one repeats the first.
    first: u32,
    end: u32,
}

// As IN_PLANE for a contour, from whose plane its corners may lie 2e-6 away (src/gpu_scene/lights/contour.rs).
const IN_CONTOUR = 3.0 * IN_PLANE;

// Whether a position lies on the shining side of a contour's plane, and farther from the plane than rounding. `side` is
// the height of the plane over it.
fn contour_shines(normal: vec3f, side: f32, two_sided: bool) -> bool {
    let sizes = abs(normal);
    let is_perpendicular = max(sizes.x, max(sizes.y, sizes.z)) == sizes.x + sizes.y + sizes.z;
    return select(-side, abs(side), two_sided) > select(IN_CONTOUR, 0.0, is_perpendicular);
}

// The sum of Lambert's terms over a contour's part above the horizon, that is, of positive height along the normal
// (Sutherland and Hodgman's clipping, by edges). Each iteration adds one side of the part: what is above the horizon of
// an edge, or the side along the horizon from where the contour sets to where it rises again.
fn sum_above_horizon(contour: Contour, position: vec3f, normal: vec3f) -> f32 {
    var sum = 0.0;
    var a = select(contour.base, vec3f(0.0), contour.small);
    var height_a = dot(normal, contour.base);
    let begins_below = height_a <= 0.0;
    var first_rise = vec3f(0.0);
    var has_risen = false;
    var last_set = vec3f(0.0);
    var has_set = false;
    var at = contour.first + 1u;
    while at < contour.end || (has_set && begins_below) {
        let vertex = load_light_vertex(min(at, contour.end - 1u)).xyz;
        let b = vertex - contour.origin;
        let height_b = dot(normal, vertex - position);
        let ends = at == contour.end;
        let rises = !ends && height_a <= 0.0 && height_b > 0.0;
        let sets = !ends && height_a > 0.0 && height_b <= 0.0;
        let crossing = a + (b - a) * (height_a / (height_a - height_b));
        // The next iteration is for the edge that rises.
        let along_horizon = has_set && (ends || rises);
        let above = along_horizon || height_a > 0.0 || height_b > 0.0;
        var start = select(crossing, a, height_a > 0.0);
        var stop = select(crossing, b, height_b > 0.0);
        if along_horizon {
            start = last_set;
            stop = select(crossing, first_rise, ends);
        }
        sum += select(0.0, contour_term(contour.small, contour.base, start, stop, normal), above);
        if rises && !has_risen { first_rise = crossing; }
        has_risen = has_risen || rises;
        if sets { last_set = crossing; }
        has_set = sets || (has_set && !along_horizon);
        if !along_horizon {
            a = b;
            height_a = height_b;
            at++;
        }
    }
    return sum;
}

// The integral of the cosine over the solid angle of the light, by Lambert's formula over its contours, clipped at the
// surface's horizon. The relative error is about 1e-6 if the whole light is above the horizon; if the horizon cuts the
// light, the absolute error is about 1e-6 times the angle that the light spans.
fn mesh_form_factor(light: u32, header: vec4u, position: vec3f, normal: vec3f) -> f32 {
    let two_sided = (header.x & LIGHT_TWO_SIDED) != 0u;
    let sphere = light_texel_f32(light, LIGHT_SPHERE_TEXEL);
    let centre = sphere.xyz - position;
    let small = dot(centre, centre) > SMALL_LIGHT * SMALL_LIGHT * sphere.w * sphere.w;
    let end = header.w + light_texel(light, LIGHT_CONTOUR_TEXEL).x;
    var at = header.w;
    var sum = 0.0;
    while at < end {
        let plane = load_light_vertex(at);
        let contour_end = at + 1u + u32(plane.w);
        let start = load_light_vertex(at + 1u).xyz;
        let base = start - position;
        let side = dot(plane.xyz, base);
        if contour_shines(plane.xyz, side, two_sided) {
            let contour = Contour(small, base, select(position, start, small), at + 1u, contour_end);
            var contour_sum = sum_above_horizon(contour, position, normal);
            contour_sum = select(contour_sum, contour_sum / dot(base, base), small);
            // Counter-clockwise seen from the front is clockwise seen along the rays that arrive.
            sum += select(contour_sum, -contour_sum, side < 0.0);
        }
        at = contour_end;
    }
    return max(0.5 * sum, 0.0);
}
