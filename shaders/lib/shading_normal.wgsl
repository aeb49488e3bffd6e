// Shading normals: normal maps, and the bending of normals that face away from the viewer.

import package::lib::attributes::tangent_frame;
import package::lib::ray::Hit;

// The normal of a normal map's texel. It and `normal` are on the viewer's side, which is the outer one if `front`.
fn mapped_normal(hit: Hit, texel: vec3f, scale: f32, normal: vec3f, front: bool) -> vec3f {
    let outer = select(-normal, normal, front);
    let frame = tangent_frame(hit.triangle, hit.u, hit.v, outer);
    if all(frame[0] == vec3f(0.0)) { return normal; }
    let local = (texel * 2.0 - 1.0) * vec3f(scale, scale, 1.0);
    let mapped = normalize(frame * local.xy + max(local.z, 1e-3) * outer);
    return select(-mapped, mapped, front);
}

// Cosine of the view to a bent normal: just above the horizon, so that rounding does not take the view below it.
const BENT_COSINE = 1e-3;

// Bends a shading normal that faces away from the viewer towards the view, just as far as needed (Schuessler et al.
// 2017 discuss the choices).
fn bent_to(normal: vec3f, view: vec3f) -> vec3f {
    let behind = dot(normal, view);
    if behind >= BENT_COSINE { return normal; }
    return normalize(normal + (BENT_COSINE - behind) * view);
}

// The irradiance of a surface with a shading normal over that of its triangle, in light that is the same from all
// directions above the triangle: a part of that sky is below the horizon of the shading normal.
fn share_of_sky(shading_normal: vec3f, triangle_normal: vec3f) -> f32 {
    return 0.5 + 0.5 * dot(shading_normal, triangle_normal);
}
