// GGX microfacets, and dielectric layers of them over a base: the code that the specular lobe, transmission and the
// clear coat share.

@if(glossy) import package::lib::math::{PI, circle_point, safe_sqrt};

// Minimum width. Narrower lobes look like mirrors, and their peak, 1 / (pi alpha^2), would exceed the precision of f32.
@if(glossy) const MIN_ALPHA = 1e-3;

// Minimum cosine of the view to a shading normal: bending the normal brings the view to its horizon, up to rounding.
@if(glossy) const MIN_VIEW_COSINE = 1e-4;

// The view and the direction of light in the frame of a shading normal.
@if(glossy)
struct LocalPair {
    view: vec3f,
    light: vec3f,
    // Widths of the distribution along x and y.
    alpha: vec2f,
}

@if(glossy)
fn pair_in_frame(frame: mat3x3f, view: vec3f, direction: vec3f, alpha: vec2f) -> LocalPair {
    var pair: LocalPair;
    pair.view = view * frame;
    pair.view.z = max(pair.view.z, MIN_VIEW_COSINE);
    pair.light = direction * frame;
    pair.alpha = max(alpha, vec2f(MIN_ALPHA));
    return pair;
}

// The same pair for a distribution of other widths.
@if(glossy)
fn with_alpha(pair: LocalPair, alpha: vec2f) -> LocalPair {
    return LocalPair(pair.view, pair.light, max(alpha, vec2f(MIN_ALPHA)));
}

@if(glossy)
fn schlick(cosine: f32) -> f32 {
    let x = clamp(1.0 - cosine, 0.0, 1.0);
    let x2 = x * x;
    return x2 * x2 * x;
}

// Reflectance of a layer at grazing incidence. A rough layer reflects less there than the Fresnel term: a tenth of it
// at alpha 1, which is slightly above the integral of its lobe.
@if(glossy)
fn layer_grazing(reflectances: vec2f, alpha: f32) -> f32 {
    return max(reflectances.y * (1.0 - 0.9 * alpha), reflectances.x);
}

// The share of light that a dielectric layer transmits to its base and out again: what it does not reflect at the lower
// of the two angles. `reflectances` are those at normal and at grazing incidence. Appendix B of glTF takes the Fresnel
// term at the half vector instead; but then a white base under a smooth layer, seen at one degree, returns 1.8 times
// the light that it receives. This form stays within 1 and is reciprocal.
@if(glossy)
fn through_layer(reflectances: vec2f, alpha: f32, light_z: f32, view_z: f32) -> f32 {
    return 1.0 - mix(reflectances.x, layer_grazing(reflectances, alpha), schlick(min(light_z, view_z)));
}

// By how much more a layer keeps at grazing than at normal incidence.
@if(glossy)
fn layer_rise(reflectances: vec2f, alpha: f32) -> f32 {
    return layer_grazing(reflectances, alpha) - reflectances.x;
}

// The cosine-weighted mean of Schlick's term at the lower of two angles, and its variance.
@if(glossy) const LOWER_SCHLICK = 11.0 / 126.0;
@if(glossy) const LOWER_SCHLICK_VARIANCE = 8.0 / 273.0 - LOWER_SCHLICK * LOWER_SCHLICK;
// LOWER_SCHLICK less the mean of Schlick's term at one angle, 1 / 21. And the mean of the term's square, 1 / 66, over
// its mean, less LOWER_SCHLICK.
@if(glossy) const ONE_ANGLE_LESS = LOWER_SCHLICK - 1.0 / 21.0;
@if(glossy) const SQUARE_MORE = 21.0 / 66.0 - LOWER_SCHLICK;

// The mean of 1 - `through_layer` over both directions.
@if(glossy)
fn mean_kept(reflectances: vec2f, alpha: f32) -> f32 {
    return reflectances.x + layer_rise(reflectances, alpha) * LOWER_SCHLICK;
}

// Cosine-weighted means over both directions for a lobe of width alpha: of the light that masking leaves, and of that
// times Schlick's term. Fitted to integrals of 10^6 samples at 39 widths; the errors are at most 0.004 and 0.0005.
@if(glossy)
fn lobe_means(alpha: f32) -> vec2f {
    return vec2f(1.0, 1.0 / 21.0) / (1.0 + vec2f(1.42, 13.6) * pow(vec2f(alpha), vec2f(1.72, 1.54)));
}

// The GGX density of a half vector, computed from its tangential part, which is precise where alpha is small.
@if(glossy)
fn ggx_density(h: vec3f, alpha: vec2f) -> f32 {
    let across = h.xy / alpha;
    let x = dot(across, across) + h.z * h.z;
    return 1.0 / (PI * alpha.x * alpha.y * x * x);
}

// Smith's masking of a direction with cosine z is 2 z / (z + this).
@if(glossy)
fn smith_root(v: vec3f, alpha: vec2f) -> f32 {
    let across = v.xy * alpha;
    return sqrt(dot(across, across) + v.z * v.z);
}

// Height-correlated masking and shadowing over 4 times both cosines.
@if(glossy)
fn smith_visibility(pair: LocalPair) -> f32 {
    let light_z = abs(pair.light.z);
    return 0.5 / (light_z * smith_root(pair.view, pair.alpha) + pair.view.z * smith_root(pair.light, pair.alpha));
}

// Distribution, masking and shadowing: the BSDF of microfacets that reflect everything.
@if(glossy)
fn microfacets(pair: LocalPair, h: vec3f) -> f32 {
    return smith_visibility(pair) * ggx_density(h, pair.alpha);
}

// Density of the visible normals over four times their cosine to the view: the density of reflected directions (Heitz
// 2018).
@if(glossy)
fn visible_density(pair: LocalPair, h: vec3f) -> f32 {
    return ggx_density(h, pair.alpha) / (2.0 * (pair.view.z + smith_root(pair.view, pair.alpha)));
}

// The density of directions reflected by visible normals.
@if(glossy)
fn reflection_density(pair: LocalPair) -> f32 {
    return visible_density(pair, normalize(pair.view + pair.light));
}

// Upper bound of `visible_density`, and of the lobe times its cosine over its reflectance, for a view at the given
// cosine. The distribution is highest at the normal itself, 1 / (pi alpha_x alpha_y), as widths are at most 1. Smith's
// root of the view is at least that of the narrower width.
@if(glossy)
fn max_visible_density(view_z: f32, widths: vec2f) -> f32 {
    let alpha = max(widths, vec2f(MIN_ALPHA));
    let root = smith_root(vec3f(safe_sqrt(1.0 - view_z * view_z), 0.0, view_z), vec2f(min(alpha.x, alpha.y)));
    return 0.5 / (PI * alpha.x * alpha.y * (view_z + root));
}

// Samples a microfacet normal in proportion to its projected area towards the viewer, by a spherical cap (Dupuy and
// Benyoub 2023).
@if(glossy)
fn sample_visible_normal(view: vec3f, alpha: vec2f, u: vec2f) -> vec3f {
    let stretched = normalize(vec3f(alpha * view.xy, view.z));
    let z = (1.0 - u.y) * (1.0 + stretched.z) - stretched.z;
    let radius = safe_sqrt(1.0 - z * z);
    let h = vec3f(radius * circle_point(u.x), z) + stretched;
    return normalize(vec3f(alpha * h.xy, h.z));
}
