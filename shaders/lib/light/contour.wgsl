// The closed form of mesh lights: Lambert's formula for polygons, over their contours.

import package::lib::constants::{LIGHT_CONTOUR_TEXEL, LIGHT_SPHERE_TEXEL, LIGHT_TWO_SIDED};
import package::lib::light::emitter::load_light_vertex;
import package::lib::light::table::{light_texel, light_texel_f32};
import package::lib::math::angle_of;

// Lambert's term of the edge from a to b, both relative to the position: the angle it spans times the component
// along n of the unit normal of the plane of position and edge.
fn edge_term(a: vec3f, b: vec3f, n: vec3f) -> f32 {
    // a x (b - a) is more precise than a x b for edges that are short compared with their distance.
    let c = cross(a, b - a);
    let sine = length(c);
    // An edge in line with the position spans no angle.
    if sine == 0.0 { return 0.0; }
    return angle_of(sine, dot(a, b)) * (dot(n, c) / sine);
}

// Lights farther away than this number of radii of their bounding sphere use `small_edge_term`, which is more precise
// for them.
const SMALL_LIGHT = 8.0;

// Lambert's term for an edge of a small light, times the squared length of `base`. `base` leads from the position to a
// point of the contour's plane, `offset_a` and `offset_b` from there to the edge's ends.
//
// Lambert's terms are proportional to the width of the light, but their sum to its area: they cancel. For a light a
// thousandth as wide as its distance, Lambert's formula keeps three digits. Write a term as n . (a x b) f(a, b), where
// f is the angle over |a x b|. With the constant f = 1 / base^2, the sum over a closed contour is that of n . (offset_a
// x offset_b) / base^2, which is precise because it only uses differences of vertices. The rest, f base^2 - 1, is small
// by itself; it follows from the ends' distances and from the ratio of the angle to its sine.
fn small_edge_term(base: vec3f, offset_a: vec3f, offset_b: vec3f, n: vec3f) -> f32 {
    let inverse = 1.0 / dot(base, base);
    let area = cross(offset_a, offset_b);
    let across = cross(base, offset_b - offset_a) + area;
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
    if small { return small_edge_term(base, a, b, n); }
    return edge_term(a, b, n);
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
        let loop_end = at + 1u + u32(plane.w);
        at += 1u;
        let start = load_light_vertex(at).xyz;
        let base = start - position;
        let side = dot(plane.xyz, base);
        if select(side < 0.0, side != 0.0, two_sided) {
            // Sutherland and Hodgman's clipping, one vertex at a time. Contours are closed: the last vertex
            // repeats the first. Vertices are relative to the position, those of a small light to the first one.
            let origin = select(position, start, small);
            var loop_sum = 0.0;
            var started = false;
            var first: vec3f;
            var last: vec3f;
            var a = start - origin;
            var height_a = dot(normal, base);
            for (at += 1u; at < loop_end; at += 1u) {
                let vertex = load_light_vertex(at).xyz;
                let b = vertex - origin;
                let height_b = dot(normal, vertex - position);
                if height_a > 0.0 {
                    if started {
                        loop_sum += contour_term(small, base, last, a, normal);
                    } else {
                        first = a;
                        started = true;
                    }
                    last = a;
                }
                if (height_a > 0.0) != (height_b > 0.0) {
                    let crossing = a + (b - a) * (height_a / (height_a - height_b));
                    if started {
                        loop_sum += contour_term(small, base, last, crossing, normal);
                    } else {
                        first = crossing;
                        started = true;
                    }
                    last = crossing;
                }
                a = b;
                height_a = height_b;
            }
            if started { loop_sum += contour_term(small, base, last, first, normal); }
            loop_sum = select(loop_sum, loop_sum / dot(base, base), small);
            // Counter-clockwise seen from the front is clockwise seen along the rays that arrive.
            sum += select(loop_sum, -loop_sum, side < 0.0);
        }
        at = loop_end;
    }
    return max(0.5 * sum, 0.0);
}
