// How surfaces reflect: glTF's metallic-roughness model (glTF 2.0, appendix B; KHR_materials_specular and _ior): a
// GGX microfacet lobe over a Lambertian base.

import package::lib::math::{PI, basis, safe_sqrt};
import package::lib::sampling::sample_cosine;

// A surface as a viewer sees it. The normals are on the viewer's side.
struct Surface {
    // Reflectance of the diffuse base: base colour times (1 - metallic).
    albedo: vec3f,
    // Specular reflectance at normal and at grazing incidence, metal and dielectric mixed.
    @if(glossy) f0: vec3f,
    @if(glossy) f90: f32,
    // The same of the dielectric layer over the diffuse base: what it reflects, the base does not get.
    @if(glossy) dielectric: vec2f,
    // Width of the GGX distribution: roughness squared.
    @if(glossy) alpha: f32,
    // The surface's own: the triangle's, or the corners', interpolated, where that stands for a piece of a smooth surface.
    geometric_normal: vec3f,
    shading_normal: vec3f,
    // Unit, towards the viewer.
    view: vec3f,
}

// Narrower lobes are mirrors to the eye, and their peak, 1 / (pi alpha^2), would outgrow what f32 can tell apart.
@if(glossy) const MIN_ALPHA = 1e-3;

// Both the surface itself and its shading normal turn to the direction.
fn bsdf_faces(s: Surface, direction: vec3f) -> bool {
    return dot(direction, s.geometric_normal) > 0.0 && dot(direction, s.shading_normal) > 0.0;
}

// The part of the BSDF that is the same for all directions.
fn bsdf_diffuse(s: Surface) -> vec3f {
    return s.albedo / PI;
}

@if(glossy)
fn schlick(cosine: f32) -> f32 {
    let x = clamp(1.0 - cosine, 0.0, 1.0);
    let x2 = x * x;
    return x2 * x2 * x;
}

// What the dielectric layer lets through to the base and out again: what it does not reflect at the lower of the two
// angles. A rough layer reflects less at grazing angles than Fresnel's term says: a tenth of it at alpha 1, which is a
// little above what its lobe sums to. Appendix B takes the term at the half vector instead, but then a white base under a smooth layer, seen at one degree, returns 1.8 times
// what it gets; this stays within 1, and is the same both ways.
@if(glossy)
fn transmission(s: Surface, light_z: f32, view_z: f32) -> f32 {
    let grazing = max(s.dielectric.y * (1.0 - 0.9 * s.alpha), s.dielectric.x);
    return 1.0 - mix(s.dielectric.x, grazing, schlick(min(light_z, view_z)));
}

// The view and another direction about the shading normal.
@if(glossy)
struct LocalPair {
    view: vec3f,
    light: vec3f,
    alpha: f32,
}

@if(glossy)
fn local_pair(s: Surface, direction: vec3f) -> LocalPair {
    let frame = transpose(basis(s.shading_normal));
    var view = frame * s.view;
    // A bent shading normal leaves the view about its horizon, never behind it.
    view.z = max(view.z, 1e-4);
    return LocalPair(view, frame * direction, max(s.alpha, MIN_ALPHA));
}

// GGX, of a half vector about the normal: by its tangent part, which has digits left where alpha is small.
@if(glossy)
fn ggx_density(h: vec3f, alpha: f32) -> f32 {
    let x = dot(h.xy, h.xy) / (alpha * alpha) + h.z * h.z;
    return 1.0 / (PI * alpha * alpha * x * x);
}

// sqrt(alpha^2 + (1 - alpha^2) z^2): Smith's masking of a direction of height z is 2 z / (z + this).
@if(glossy)
fn smith_root(z: f32, alpha: f32) -> f32 {
    return sqrt(alpha * alpha + (1.0 - alpha * alpha) * z * z);
}

// Specular part: distribution, height-correlated masking and shadowing, Fresnel.
@if(glossy)
fn specular_value(s: Surface, pair: LocalPair) -> vec3f {
    let h = normalize(pair.view + pair.light);
    let light_z = pair.light.z;
    let view_z = pair.view.z;
    let visibility = 0.5 / (light_z * smith_root(view_z, pair.alpha) + view_z * smith_root(light_z, pair.alpha));
    let fresnel = mix(s.f0, vec3f(s.f90), schlick(dot(pair.view, h)));
    return fresnel * (visibility * ggx_density(h, pair.alpha));
}

// The BSDF less its diffuse part, for light from the unit `direction`. Negative where the dielectric layer keeps
// more from the base than it reflects this way.
fn bsdf_residual(s: Surface, direction: vec3f) -> vec3f {
    @if(glossy) {
        if !bsdf_faces(s, direction) { return vec3f(0.0); }
        let pair = local_pair(s, direction);
        return specular_value(s, pair) - bsdf_diffuse(s) * (1.0 - transmission(s, pair.light.z, pair.view.z));
    }
    @else { return vec3f(0.0); }
}

// Largest specular reflectance of what counts as a dielectric where a path ends: glass has 0.04, diamond 0.17.
@if(glossy) const DIELECTRIC = 0.2;

// Whether a path that ends here by a look-up leaves out what must be traced: the reflection of a metal.
fn reflects_more(s: Surface) -> bool {
    @if(glossy) { return max(s.f0.x, max(s.f0.y, s.f0.z)) > DIELECTRIC; }
    @else { return false; }
}

// What of the irradiance of the geometric surface is reflected towards one direction, where a path ends. A dielectric layer
// reflects the hemispherical mean of Schlick's term, 1/21 of its range, as if spread like the base's light; and it keeps from
// the base its mean at the lower of two angles, 11/126 of the range (both means weighted by the cosine). Traced, its highlights
// of small lights would be found by few rays, each as bright as the light. A bent shading normal turns away from part of the
// light.
fn bsdf_seen_afar(s: Surface) -> vec3f {
    let facing = max(dot(s.shading_normal, s.geometric_normal), 0.0) / PI;
    @if(glossy) {
        if !reflects_more(s) {
            // As in `transmission`, a rough layer reflects less at grazing angles.
            let rough = 1.0 - 0.9 * s.alpha;
            let layer = s.f0 + (vec3f(s.f90) - s.f0) * (rough / 21.0);
            let kept = s.dielectric.x + (s.dielectric.y - s.dielectric.x) * (rough * 11.0 / 126.0);
            return (s.albedo * (1.0 - kept) + layer) * facing;
        }
    }
    return s.albedo * facing;
}

// The BSDF, per steradian; 0 for directions that the surface does not face.
fn bsdf_evaluate(s: Surface, direction: vec3f) -> vec3f {
    if !bsdf_faces(s, direction) { return vec3f(0.0); }
    @if(glossy) {
        let pair = local_pair(s, direction);
        return specular_value(s, pair) + bsdf_diffuse(s) * transmission(s, pair.light.z, pair.view.z);
    }
    @else { return bsdf_diffuse(s); }
}

// How often the specular lobe is sampled: by its share of what is reflected straight back.
@if(glossy)
fn specular_share(s: Surface, view_z: f32) -> f32 {
    let specular = mix(s.f0, vec3f(s.f90), schlick(view_z));
    let specular_sum = specular.x + specular.y + specular.z;
    let diffuse_sum = (s.albedo.x + s.albedo.y + s.albedo.z) * transmission(s, view_z, view_z);
    if diffuse_sum <= 0.0 { return 1.0; }
    if specular_sum <= 0.0 { return 0.0; }
    // Neither lobe so seldom that its samples weigh more than ten times their value.
    return clamp(specular_sum / (specular_sum + diffuse_sum), 0.1, 0.9);
}

// Density of the visible normals, reflected (Heitz 2018).
@if(glossy)
fn specular_pdf(pair: LocalPair) -> f32 {
    let h = normalize(pair.view + pair.light);
    return ggx_density(h, pair.alpha) / (2.0 * (pair.view.z + smith_root(pair.view.z, pair.alpha)));
}

struct BsdfSample {
    // Unit, from the surface.
    direction: vec3f,
    // BSDF times cosine over density.
    weight: vec3f,
    // By solid angle; 0 where the sample went into the surface: the path ends.
    pdf: f32,
}

// The density, by solid angle, with which `bsdf_sample` chooses the direction.
fn bsdf_pdf(s: Surface, direction: vec3f) -> f32 {
    if !bsdf_faces(s, direction) { return 0.0; }
    let diffuse = dot(direction, s.shading_normal) / PI;
    @if(glossy) {
        let pair = local_pair(s, direction);
        return mix(diffuse, specular_pdf(pair), specular_share(s, pair.view.z));
    }
    @else { return diffuse; }
}

// A direction that light is reflected from, about as often as much is.
fn bsdf_sample(s: Surface, u: vec3f) -> BsdfSample {
    let frame = basis(s.shading_normal);
    @if(glossy) {
        let pair = local_pair(s, s.view);
        var direction: vec3f;
        if u.z < specular_share(s, pair.view.z) {
            direction = reflect(-pair.view, sample_visible_normal(pair.view, pair.alpha, u.xy));
        } else {
            direction = sample_cosine(u.xy);
        }
        direction = normalize(frame * direction);
        let pdf = bsdf_pdf(s, direction);
        if pdf <= 0.0 { return BsdfSample(direction, vec3f(0.0), 0.0); }
        let cosine = dot(direction, s.shading_normal);
        return BsdfSample(direction, bsdf_evaluate(s, direction) * (cosine / pdf), pdf);
    }
    @else {
        let direction = normalize(frame * sample_cosine(u.xy));
        let pdf = bsdf_pdf(s, direction);
        return BsdfSample(direction, select(vec3f(0.0), s.albedo, pdf > 0.0), pdf);
    }
}

// A microfacet normal as the view sees them, by a spherical cap (Dupuy and Benyoub 2023).
@if(glossy)
fn sample_visible_normal(view: vec3f, alpha: f32, u: vec2f) -> vec3f {
    let stretched = normalize(vec3f(alpha * view.xy, view.z));
    let phi = 2.0 * PI * u.x;
    let z = (1.0 - u.y) * (1.0 + stretched.z) - stretched.z;
    let radius = safe_sqrt(1.0 - z * z);
    let h = vec3f(radius * cos(phi), radius * sin(phi), z) + stretched;
    return normalize(vec3f(alpha * h.xy, h.z));
}
