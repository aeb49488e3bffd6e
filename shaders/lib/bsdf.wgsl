// How surfaces reflect and let light pass: glTF's metallic-roughness model (glTF 2.0, appendix B; KHR_materials_specular,
// _ior, _transmission, _volume, _clearcoat, _sheen and _anisotropy): a GGX microfacet lobe over a Lambertian base, of which a
// part may let light pass, under the sheen of fibres, and under a second GGX lobe, the coat.

import package::lib::math::{PI, basis, safe_sqrt};
import package::lib::sampling::sample_cosine;
@if(sheen) import package::lib::sampling::sample_cap;
@if(sheen) import package::lib::constants::{SHEEN_COLUMNS, SHEEN_ROWS};

// By cell of the cubic root of the cosine and the logarithm of the roughness: what the albedo of fibres is interpolated
// from (src/tables/sheen.rs).
@if(sheen) @group(1) @binding(22) var<uniform> sheen_albedos: array<vec4f, SHEEN_COLUMNS * SHEEN_ROWS>;
@if(sheen) override least_sheen_roughness: f32;

// A surface as a viewer sees it. The normals are on the viewer's side.
struct Surface {
    // Reflectance of the diffuse base: base colour times (1 - metallic), and times (1 - transmission).
    albedo: vec3f,
    // Specular reflectance at normal and at grazing incidence, metal and dielectric mixed.
    @if(glossy) f0: vec3f,
    @if(glossy) f90: f32,
    // The same of the dielectric layer over the diffuse base: what it reflects, the base does not get.
    @if(glossy) dielectric: vec2f,
    // Width of the GGX distribution: roughness squared; across the tangent where that is not 0.
    @if(glossy) alpha: f32,
    @if(anisotropy) tangent: vec3f,
    // The width along it.
    @if(anisotropy) alpha_along: f32,
    // What passes of the light that the dielectric layer does not reflect: base colour times (1 - metallic) times transmission.
    @if(transmission) tint: vec3f,
    // Index of refraction on the viewer's side over that on the other; 1 where light passes straight on (a thin wall).
    @if(transmission) eta: f32,
    // Of the coat: its factor, and its width as alpha.
    @if(clearcoat) coat: vec2f,
    // The coat's own shading normal; without, it has the base's.
    @if(coat_normals) coat_normal: vec3f,
    // Of the fibres: their colour and their roughness.
    @if(sheen) sheen: vec4f,
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

// The same of the coat.
@if(clearcoat)
fn coat_faces(s: Surface, direction: vec3f) -> bool {
    @if(coat_normals) { return dot(direction, s.geometric_normal) > 0.0 && dot(direction, s.coat_normal) > 0.0; }
    @else { return bsdf_faces(s, direction); }
}

// Light from the direction passes through the surface.
@if(transmission)
fn bsdf_passes(s: Surface, direction: vec3f) -> bool {
    return any(s.tint > vec3f(0.0)) && dot(direction, s.geometric_normal) < 0.0 && dot(direction, s.shading_normal) < 0.0;
}

// The geometric normal on the side that the direction leaves to.
fn leaving_normal(s: Surface, direction: vec3f) -> vec3f {
    @if(transmission) { return select(s.geometric_normal, -s.geometric_normal, dot(direction, s.geometric_normal) < 0.0); }
    @else { return s.geometric_normal; }
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

// Reflectance at grazing incidence of a layer: a rough one reflects less there than Fresnel's term says, a tenth of it at
// alpha 1, which is a little above what its lobe sums to.
@if(glossy)
fn layer_grazing(reflectances: vec2f, alpha: f32) -> f32 {
    return max(reflectances.y * (1.0 - 0.9 * alpha), reflectances.x);
}

// What a dielectric layer lets through to the base and out again: what it does not reflect at the lower of the two
// angles, of reflectances at normal and at grazing incidence. Appendix B takes the term at the half vector instead, but then a
// white base under a smooth layer, seen at one degree, returns 1.8 times what it gets; this stays within 1, and is the same
// both ways.
@if(glossy)
fn through_layer(reflectances: vec2f, alpha: f32, light_z: f32, view_z: f32) -> f32 {
    return 1.0 - mix(reflectances.x, layer_grazing(reflectances, alpha), schlick(min(light_z, view_z)));
}

// Reflectances of the coat at normal and at grazing incidence: its index of refraction is 1.5 (KHR_materials_clearcoat).
@if(clearcoat) const COAT_REFLECTANCES = vec2f(0.04, 1.0);

// What the coat lets through to what lies below it, by the heights of light and view over it.
@if(clearcoat)
fn through_coat(s: Surface, heights: vec2f) -> f32 {
    return 1.0 - s.coat.x * (1.0 - through_layer(COAT_REFLECTANCES, s.coat.y, heights.x, heights.y));
}

// Heights of light and view over the coat, for light that comes to the base from outside of it or leaves it inside.
@if(clearcoat)
fn coat_heights(pair: LocalPair) -> vec2f {
    @if(coat_normals) { return vec2f(pair.coat_heights.x * sign(pair.light.z), pair.coat_heights.y); }
    @else { return vec2f(abs(pair.light.z), pair.view.z); }
}

// What fibres look like from one direction: how much they mask there (lambda of Estevez and Kulla 2017, equation 3, as
// KHR_materials_sheen has it), and how much light from there they would reflect if white: their directional albedo, which
// by the extension's formula is more than 1 at grazing angles where they are less rough than 0.3.
@if(sheen)
struct FibreSide {
    lambda: f32,
    albedo: f32,
}

@if(sheen)
fn sheen_roughness(s: Surface) -> f32 {
    return clamp(s.sheen.w, least_sheen_roughness, 1.0);
}

@if(sheen)
fn fibre_side(roughness: f32, height: f32) -> FibreSide {
    let cosine = clamp(height, 1e-4, 1.0);
    let alpha = roughness * roughness;
    let smoothness = (1.0 - alpha) * (1.0 - alpha);
    let a = mix(21.5473, 25.3245, smoothness);
    let b = mix(3.82987, 3.32435, smoothness);
    let c = mix(0.19823, 0.16801, smoothness);
    let d = mix(-1.97760, -1.27393, smoothness);
    let e = mix(-4.32054, -4.85967, smoothness);
    let low = min(cosine, max(1.0 - cosine, 1e-6));
    let l = a / (1.0 + b * pow(low, c)) + d * low + e;
    let middle = a / (1.0 + b * pow(0.5, c)) + d * 0.5 + e;
    let lambda = exp(select(2.0 * middle - l, l, cosine < 0.5));

    let last = vec2u(SHEEN_COLUMNS, SHEEN_ROWS) - 1u;
    let at = vec2f(pow(cosine, 1.0 / 3.0), log2(roughness) / log2(least_sheen_roughness)) * vec2f(last + 1u);
    let cell = min(vec2u(at), last);
    let f = at - vec2f(cell);
    let corners = sheen_albedos[cell.y * SHEEN_COLUMNS + cell.x];
    let found = mix(mix(corners.x, corners.y, f.x), mix(corners.z, corners.w, f.x), f.y);
    return FibreSide(lambda, exp2(found) / (4.0 * cosine * (1.0 + lambda)));
}

// What fibres of that albedo let through to what lies below them.
@if(sheen)
fn through_fibres(s: Surface, albedo: f32) -> f32 {
    return 1.0 - max(s.sheen.x, max(s.sheen.y, s.sheen.z)) * min(albedo, 1.0);
}

// What the fibres reflect: the extension's formula, less as much as keeps their albedo from either side within 1. So it is the
// same both ways, makes no light, and is the formula as it is wherever that does so.
@if(sheen)
fn sheen_value(s: Surface, pair: LocalPair) -> vec3f {
    let roughness = sheen_roughness(s);
    let light = fibre_side(roughness, pair.light.z);
    let view = fibre_side(roughness, pair.view.z);
    let across = cross(normalize(pair.view + pair.light), vec3f(0.0, 0.0, 1.0));
    let inverse_alpha = 1.0 / (roughness * roughness);
    // sin^(1 / alpha), of the squared sine.
    let distribution = (2.0 + inverse_alpha) / (2.0 * PI) * pow(max(dot(across, across), 1e-30), 0.5 * inverse_alpha);
    let masked = (1.0 + light.lambda + view.lambda) * 4.0 * max(pair.light.z, 1e-4) * pair.view.z;
    return s.sheen.xyz * (distribution / (masked * max(max(light.albedo, view.albedo), 1.0)));
}

// What coat and fibres let through to the microfacets, and to what lies behind them. Fibres do at the less favourable of the
// two angles, as the extension's albedo scaling has it.
@if(glossy)
fn through_upper(s: Surface, pair: LocalPair) -> f32 {
    var through = 1.0;
    @if(sheen) {
        let roughness = sheen_roughness(s);
        let light = fibre_side(roughness, abs(pair.light.z)).albedo;
        through = through_fibres(s, max(light, fibre_side(roughness, pair.view.z).albedo));
    }
    @if(clearcoat) { through *= through_coat(s, coat_heights(pair)); }
    return through;
}

// What all layers let through to the diffuse base.
@if(glossy)
fn through_to_base(s: Surface, pair: LocalPair) -> f32 {
    return through_layer(s.dielectric, s.alpha, pair.light.z, pair.view.z) * through_upper(s, pair);
}

// The cosine that Schlick's term is for: that on the side of the lower index of refraction. -1 where all is reflected.
@if(transmission)
fn fresnel_cosine(s: Surface, cosine: f32) -> f32 {
    if s.eta <= 1.0 { return cosine; }
    let sine_squared = s.eta * s.eta * (1.0 - cosine * cosine);
    return select(safe_sqrt(1.0 - sine_squared), -1.0, sine_squared >= 1.0);
}

// Reflectance of the microfacets for light at that cosine to their normal.
@if(glossy)
fn reflectance(s: Surface, cosine: f32) -> vec3f {
    @if(transmission) {
        let outer = fresnel_cosine(s, cosine);
        if outer < 0.0 { return vec3f(1.0); }
        return mix(s.f0, vec3f(s.f90), schlick(outer));
    }
    @else { return mix(s.f0, vec3f(s.f90), schlick(cosine)); }
}

// What of light at that cosine to their normal passes the microfacets.
@if(transmission)
fn transmittance(s: Surface, cosine: f32) -> vec3f {
    let outer = fresnel_cosine(s, cosine);
    if outer < 0.0 { return vec3f(0.0); }
    return s.tint * (1.0 - mix(s.dielectric.x, s.dielectric.y, schlick(outer)));
}

// Axes about the shading normal.
fn shading_frame(s: Surface) -> mat3x3f {
    @if(anisotropy) {
        let along = s.tangent - s.shading_normal * dot(s.tangent, s.shading_normal);
        if dot(along, along) > 1e-8 {
            let x = normalize(along);
            return mat3x3f(x, cross(s.shading_normal, x), s.shading_normal);
        }
    }
    return basis(s.shading_normal);
}

// The view and another direction about the shading normal.
@if(glossy)
struct LocalPair {
    view: vec3f,
    light: vec3f,
    // Widths along x and y.
    alpha: vec2f,
    // Heights of light and view over the coat.
    @if(coat_normals) coat_heights: vec2f,
}

// Light and view about the normal of a frame.
@if(glossy)
fn pair_about(frame: mat3x3f, s: Surface, direction: vec3f, alpha: vec2f) -> LocalPair {
    var pair: LocalPair;
    pair.view = s.view * frame;
    // A bent shading normal leaves the view about its horizon, never behind it.
    pair.view.z = max(pair.view.z, 1e-4);
    pair.light = direction * frame;
    pair.alpha = max(alpha, vec2f(MIN_ALPHA));
    @if(coat_normals) { pair.coat_heights = vec2f(dot(direction, s.coat_normal), max(dot(s.view, s.coat_normal), 1e-4)); }
    return pair;
}

@if(glossy)
fn local_pair(s: Surface, direction: vec3f) -> LocalPair {
    var alpha = vec2f(s.alpha);
    @if(anisotropy) { if any(s.tangent != vec3f(0.0)) { alpha.x = s.alpha_along; } }
    return pair_about(shading_frame(s), s, direction, alpha);
}

// Axes about the coat's normal.
@if(clearcoat)
fn coat_frame(s: Surface) -> mat3x3f {
    @if(coat_normals) { return basis(s.coat_normal); }
    @else { return shading_frame(s); }
}

// The same of the coat.
@if(clearcoat)
fn coat_pair(s: Surface, direction: vec3f) -> LocalPair {
    return pair_about(coat_frame(s), s, direction, vec2f(s.coat.y));
}

// GGX, of a half vector about the normal: by its tangent part, which has digits left where alpha is small.
@if(glossy)
fn ggx_density(h: vec3f, alpha: vec2f) -> f32 {
    let across = h.xy / alpha;
    let x = dot(across, across) + h.z * h.z;
    return 1.0 / (PI * alpha.x * alpha.y * x * x);
}

// Smith's masking of a direction of height z is 2 z / (z + this).
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

// Distribution, masking and shadowing: what is left is Fresnel's term.
@if(glossy)
fn microfacets(pair: LocalPair, h: vec3f) -> f32 {
    return smith_visibility(pair) * ggx_density(h, pair.alpha);
}

// Light that microfacets and fibres reflect, less what the layers above keep from them.
@if(glossy)
fn specular_value(s: Surface, pair: LocalPair) -> vec3f {
    let h = normalize(pair.view + pair.light);
    let value = reflectance(s, dot(pair.view, h)) * microfacets(pair, h) * through_upper(s, pair);
    @if(sheen && clearcoat) { return value + sheen_value(s, pair) * through_coat(s, coat_heights(pair)); }
    @if(sheen && !clearcoat) { return value + sheen_value(s, pair); }
    @if(!sheen) { return value; }
}

// What the coat reflects.
@if(clearcoat)
fn coat_value(s: Surface, pair: LocalPair) -> f32 {
    let h = normalize(pair.view + pair.light);
    let fresnel = mix(COAT_REFLECTANCES.x, COAT_REFLECTANCES.y, schlick(dot(pair.view, h)));
    return s.coat.x * fresnel * microfacets(pair, h);
}

// The microfacet normal by which light from `pair.light`, below the surface, passes towards the viewer, and how densely
// directions lie about it: the normal's density times this is the direction's (Walter et al. 2007, equations 16 and 17). 0
// where there is none. A thin wall bends no light: it spreads it as its mirror image is spread.
@if(transmission)
struct Passing {
    normal: vec3f,
    jacobian: f32,
}

@if(transmission)
fn passing(s: Surface, pair: LocalPair) -> Passing {
    if s.eta == 1.0 {
        let mirrored = vec3f(pair.light.xy, -pair.light.z);
        let h = normalize(pair.view + mirrored);
        return Passing(h, 0.25 / max(dot(pair.view, h), 1e-6));
    }
    let bent = -(pair.light + s.eta * pair.view);
    let h = normalize(select(bent, -bent, bent.z < 0.0));
    let view_h = dot(pair.view, h);
    let light_h = dot(pair.light, h);
    if view_h <= 0.0 || light_h >= 0.0 { return Passing(h, 0.0); }
    let root = light_h + s.eta * view_h;
    return Passing(h, -light_h / (root * root));
}

// The BSDF for light that passes from the other side. Radiance is denser where the index of refraction is higher.
@if(transmission)
fn transmitted_value(s: Surface, pair: LocalPair) -> vec3f {
    let found = passing(s, pair);
    let view_h = dot(pair.view, found.normal);
    let value = transmittance(s, view_h) * (4.0 * view_h * found.jacobian * s.eta * s.eta * microfacets(pair, found.normal));
    return value * through_upper(s, pair);
}

// The BSDF less its diffuse part, times the cosine, for light from the unit `direction`. Negative where the layers keep more
// from the base than they reflect this way. The cosine is to the normal of each lobe, as KHR_materials_clearcoat has it: so a
// coat whose normal is not the base's reflects no more than one that has it.
fn bsdf_residual(s: Surface, direction: vec3f) -> vec3f {
    @if(glossy) {
        let pair = local_pair(s, direction);
        @if(transmission) { if bsdf_passes(s, direction) { return transmitted_value(s, pair) * -pair.light.z; } }
        var value = vec3f(0.0);
        if bsdf_faces(s, direction) {
            value = (specular_value(s, pair) - bsdf_diffuse(s) * (1.0 - through_to_base(s, pair))) * pair.light.z;
        }
        @if(clearcoat) {
            let coat = coat_pair(s, direction);
            if coat_faces(s, direction) { value += vec3f(coat_value(s, coat) * coat.light.z); }
        }
        return value;
    }
    @else { return vec3f(0.0); }
}

// Largest specular reflectance of what counts as a dielectric where a path ends: glass has 0.04, diamond 0.17.
@if(glossy) const DIELECTRIC = 0.2;

// Whether a path that ends here by a look-up leaves out what must be traced: the reflection of a metal, and what passes.
fn reflects_more(s: Surface) -> bool {
    @if(glossy) {
        var more = max(s.f0.x, max(s.f0.y, s.f0.z)) > DIELECTRIC;
        @if(transmission) { more = more || any(s.tint > vec3f(0.0)); }
        return more;
    }
    @else { return false; }
}

// Whether the camera's ray goes on from there: a mirror or clear glass, to the eye.
@if(chains)
fn is_clear(s: Surface) -> bool {
    var clear = s.alpha <= MIN_ALPHA && all(s.albedo == vec3f(0.0)) && reflects_more(s);
    @if(clearcoat) { clear = clear && s.coat.x == 0.0; }
    @if(sheen) { clear = clear && all(s.sheen.xyz == vec3f(0.0)); }
    @if(anisotropy) { clear = clear && all(s.tangent == vec3f(0.0)); }
    return clear;
}

// Widest lobes of metals that count as focusing.
@if(caustics) override focusing_alpha: f32;

// Whether light that the surface sends on is the caustic map's: that from lights by way of such surfaces alone, on surfaces
// that are seen.
@if(caustics)
fn focuses(s: Surface) -> bool {
    var focusing = reflects_more(s) && s.alpha <= focusing_alpha;
    @if(transmission) { focusing = focusing || any(s.tint > vec3f(0.0)); }
    return focusing;
}

// Means over both directions, weighted by their cosines, of a lobe of the width alpha: of what its masking leaves, and of that times
// Schlick's term. Fits to integrals by 10^6 samples at 39 widths, off by 0.004 and 0.0005 at most.
@if(glossy)
fn lobe_means(alpha: f32) -> vec2f {
    return vec2f(1.0, 1.0 / 21.0) / (1.0 + vec2f(1.42, 13.6) * pow(vec2f(alpha), vec2f(1.72, 1.54)));
}

// What `through_layer` keeps on average: Schlick's term at the lower of two angles is 11/126, both weighted by their cosines.
@if(glossy)
fn mean_kept(reflectances: vec2f, alpha: f32) -> f32 {
    return mix(reflectances.x, layer_grazing(reflectances, alpha), 11.0 / 126.0);
}

// What of the irradiance of the geometric surface is reflected towards one direction, where a path ends. A dielectric layer
// reflects its mean over all directions as if spread like the base's light. Traced, its highlights of small lights would be
// found by few rays, each as bright as the light. A bent shading normal turns away from part of the light.
fn bsdf_seen_afar(s: Surface) -> vec3f {
    let facing = max(dot(s.shading_normal, s.geometric_normal), 0.0) / PI;
    @if(glossy) {
        if !reflects_more(s) {
            let means = lobe_means(s.alpha);
            var base = s.albedo * (1.0 - mean_kept(s.dielectric, s.alpha)) + s.f0 * means.x + (vec3f(s.f90) - s.f0) * means.y;
            @if(sheen) {
                // Means over the cosine-weighted hemisphere of the fibres' albedo, and of the larger of two: fits, 0.001 and
                // 0.003 off at most.
                let r = sheen_roughness(s);
                let mean = r * (0.197 + r * (0.059 + r * (0.430 - 0.387 * r)));
                let larger = r * (0.439 + r * (-0.299 + r * (0.708 - 0.483 * r)));
                base = base * through_fibres(s, larger) + s.sheen.xyz * mean;
            }
            @if(clearcoat) {
                let coat_means = lobe_means(s.coat.y);
                let coat = dot(vec2f(COAT_REFLECTANCES.x, COAT_REFLECTANCES.y - COAT_REFLECTANCES.x), coat_means);
                let below = base * (1.0 - s.coat.x * mean_kept(COAT_REFLECTANCES, s.coat.y)) * facing;
                @if(coat_normals) { return below + s.coat.x * coat * max(dot(s.coat_normal, s.geometric_normal), 0.0) / PI; }
                @else { return below + s.coat.x * coat * facing; }
            }
            @else { return base * facing; }
        }
    }
    return s.albedo * facing;
}

// The BSDF, per steradian, times the cosine; 0 for directions that the surface neither faces nor lets pass.
fn bsdf_evaluate(s: Surface, direction: vec3f) -> vec3f {
    var value = vec3f(0.0);
    if bsdf_faces(s, direction) { value = bsdf_diffuse(s) * dot(direction, s.shading_normal); }
    @if(glossy) { value += bsdf_residual(s, direction); }
    return value;
}

// How often each lobe is sampled, by its share of what is reflected straight back; the diffuse base has the rest.
@if(glossy)
struct LobeChances {
    // The lobe that reflects and lets pass.
    microfacets: f32,
    @if(clearcoat) coat: f32,
    @if(sheen) sheen: f32,
}

@if(glossy)
fn lobe_chances(s: Surface, pair: LocalPair) -> LobeChances {
    let view_z = pair.view.z;
    var specular = dot(reflectance(s, view_z), vec3f(1.0));
    @if(transmission) { specular += dot(transmittance(s, view_z), vec3f(1.0)); }
    let diffuse = dot(s.albedo, vec3f(1.0)) * through_layer(s.dielectric, s.alpha, view_z, view_z);
    // Neither lobe so seldom that its samples weigh more than ten times their value.
    var share = clamp(specular / max(specular + diffuse, 1e-30), 0.1, 0.9);
    share = select(select(share, 0.0, specular <= 0.0), 1.0, diffuse <= 0.0);
    var chances: LobeChances;
    chances.microfacets = share;
    var below = specular + diffuse;
    @if(sheen) {
        let albedo = fibre_side(sheen_roughness(s), view_z).albedo;
        let sheen = dot(s.sheen.xyz, vec3f(1.0)) * min(albedo, 1.0);
        below *= through_fibres(s, albedo);
        chances.sheen = select(0.0, clamp(sheen / max(sheen + below, 1e-30), 0.1, 0.9), any(s.sheen.xyz > vec3f(0.0)));
        chances.microfacets *= 1.0 - chances.sheen;
        below += sheen;
    }
    @if(clearcoat) {
        let through = through_coat(s, coat_heights(pair).yy);
        let coat = 3.0 * (1.0 - through);
        chances.coat = select(0.0, clamp(coat / (coat + through * below), 0.1, 0.9), s.coat.x > 0.0);
        chances.microfacets *= 1.0 - chances.coat;
        @if(sheen) { chances.sheen *= 1.0 - chances.coat; }
    }
    return chances;
}

// How often a microfacet is sampled as one that lets pass.
@if(transmission)
fn passing_share(s: Surface, cosine: f32) -> f32 {
    let passes = dot(transmittance(s, cosine), vec3f(1.0));
    return passes / max(passes + dot(reflectance(s, cosine), vec3f(1.0)), 1e-30);
}

// Density of the visible normals, over four times its cosine to the view: that of reflected directions (Heitz 2018).
@if(glossy)
fn visible_density(pair: LocalPair, h: vec3f) -> f32 {
    return ggx_density(h, pair.alpha) / (2.0 * (pair.view.z + smith_root(pair.view, pair.alpha)));
}

struct BsdfSample {
    // Unit, from the surface.
    direction: vec3f,
    // What `bsdf_evaluate` gives over the density.
    weight: vec3f,
    // By solid angle; 0 where the sample went into a surface that lets nothing pass: the path ends.
    pdf: f32,
    // Radiance over flux: light that passes into a medium of another index is denser there, a photon's flux is not.
    @if(transmission) concentration: f32,
}

// The density, by solid angle, with which `bsdf_sample` chooses the direction.
fn bsdf_pdf(s: Surface, direction: vec3f) -> f32 {
    @if(glossy) {
        let pair = local_pair(s, direction);
        let chances = lobe_chances(s, pair);
        @if(transmission) {
            if bsdf_passes(s, direction) {
                let found = passing(s, pair);
                let view_h = dot(pair.view, found.normal);
                let density = 4.0 * view_h * found.jacobian * visible_density(pair, found.normal);
                return chances.microfacets * passing_share(s, view_h) * density;
            }
        }
        let h = normalize(pair.view + pair.light);
        var specular = chances.microfacets;
        @if(transmission) { specular *= 1.0 - passing_share(s, dot(pair.view, h)); }
        var diffuse = 1.0 - chances.microfacets;
        @if(clearcoat) { diffuse -= chances.coat; }
        @if(sheen) { diffuse -= chances.sheen; }
        var pdf = specular * visible_density(pair, h) + max(diffuse, 0.0) * (pair.light.z / PI);
        // Fibres are sampled alike in all directions, as Estevez and Kulla (2017) found best for lobes so wide.
        @if(sheen) { pdf += chances.sheen / (2.0 * PI); }
        pdf = select(0.0, pdf, bsdf_faces(s, direction));
        @if(clearcoat) {
            let coat = coat_pair(s, direction);
            let density = visible_density(coat, normalize(coat.view + coat.light));
            pdf += select(0.0, chances.coat * density, coat_faces(s, direction));
        }
        return pdf;
    }
    @else {
        if !bsdf_faces(s, direction) { return 0.0; }
        return dot(direction, s.shading_normal) / PI;
    }
}

// A direction that light comes from, about as often as much does.
fn bsdf_sample(s: Surface, u: vec3f) -> BsdfSample {
    let frame = shading_frame(s);
    @if(glossy) {
        let pair = local_pair(s, s.view);
        let chances = lobe_chances(s, pair);
        var below = chances.microfacets;
        var lobe = pair;
        @if(clearcoat) let of_coat = u.z >= below && u.z < below + chances.coat;
        @if(coat_normals) var axes = frame;
        @if(clearcoat) {
            below += chances.coat;
            if of_coat { lobe = coat_pair(s, s.view); }
            @if(coat_normals) { if of_coat { axes = coat_frame(s); } }
        }
        let h = sample_visible_normal(lobe.view, lobe.alpha, u.xy);
        var wide = sample_cosine(u.xy);
        @if(sheen) { if u.z < below + chances.sheen { wide = sample_cap(u.xy, 1.0); } }
        var local = select(wide, reflect(-lobe.view, h), u.z < below);
        @if(transmission) var passed = false;
        @if(transmission) {
            // The lots of the microfacets' lobe come in two parts: those that pass first.
            passed = u.z < chances.microfacets * passing_share(s, dot(pair.view, h));
            if passed {
                if s.eta == 1.0 { local.z = -local.z; } else { local = refract(-pair.view, h, s.eta); }
            }
        }
        @if(coat_normals) let direction = normalize(axes * local);
        @if(!coat_normals) let direction = normalize(frame * local);
        var result = BsdfSample();
        result.direction = direction;
        // Light that is reflected into the surface, or bent out of it, would meet more microfacets: it is left out.
        @if(transmission) { if bsdf_passes(s, direction) != passed { return result; } }
        // A direction counts to the density of a lobe only where that lobe faces it.
        @if(coat_normals) {
            var faced = select(bsdf_faces(s, direction), coat_faces(s, direction), of_coat);
            @if(transmission) { faced |= passed; }
            if !faced { return result; }
        }
        result.pdf = bsdf_pdf(s, direction);
        if result.pdf <= 0.0 { return result; }
        result.weight = bsdf_evaluate(s, direction) / result.pdf;
        @if(transmission) { result.concentration = select(1.0, s.eta * s.eta, bsdf_passes(s, direction)); }
        return result;
    }
    @else {
        let direction = normalize(frame * sample_cosine(u.xy));
        let pdf = bsdf_pdf(s, direction);
        return BsdfSample(direction, select(vec3f(0.0), s.albedo, pdf > 0.0), pdf);
    }
}

// A microfacet normal as the view sees them, by a spherical cap (Dupuy and Benyoub 2023).
@if(glossy)
fn sample_visible_normal(view: vec3f, alpha: vec2f, u: vec2f) -> vec3f {
    let stretched = normalize(vec3f(alpha * view.xy, view.z));
    let phi = 2.0 * PI * u.x;
    let z = (1.0 - u.y) * (1.0 + stretched.z) - stretched.z;
    let radius = safe_sqrt(1.0 - z * z);
    let h = vec3f(radius * cos(phi), radius * sin(phi), z) + stretched;
    return normalize(vec3f(alpha * h.xy, h.z));
}

// Whether the surface has a lobe besides its diffuse base.
fn has_lobes(s: Surface) -> bool {
    @if(glossy) {
        var lobes = any(vec4f(s.f0, s.f90) != vec4f(0.0));
        @if(transmission) { lobes = lobes || any(s.tint != vec3f(0.0)); }
        @if(clearcoat) { lobes = lobes || s.coat.x != 0.0; }
        @if(sheen) { lobes = lobes || any(s.sheen.xyz != vec3f(0.0)); }
        return lobes;
    }
    @else { return false; }
}
