// The BSDF: glTF's metallic-roughness model. This file combines the lobes of lib/bsdf/: GGX microfacets over a
// Lambertian base, part of which may transmit light; above them the sheen of fibres; above all the coat, a second GGX
// lobe.

import package::lib::bsdf::diffuse::{diffuse_density, diffuse_value};
import package::lib::bsdf::surface::Surface;
import package::lib::math::{PI, basis};
import package::lib::sampling::sample_cosine;
@if(glossy) import package::lib::bsdf::microfacet::{
    LocalPair, MIN_ALPHA, max_visible_density, microfacets, pair_in_frame, sample_visible_normal, visible_density,
};
@if(glossy) import package::lib::bsdf::specular::{
    is_black_specular, is_metallic, mean_with_specular, specular_reflectance, through_specular,
};
@if(transmission) import package::lib::bsdf::transmission::{
    fresnel_cosine, is_transmissive, passed_direction, passing, passing_density, transmission_value, transmittance,
};
@if(clearcoat) import package::lib::bsdf::clearcoat::{
    clearcoat_chance, clearcoat_density, clearcoat_means, clearcoat_value, coat_heights, coat_view_height, is_coated,
    max_clearcoat_density, through_coat,
};
@if(anisotropy) import package::lib::bsdf::anisotropy::{anisotropy_frame, is_anisotropic};
@if(sheen) import package::lib::bsdf::sheen::{
    has_fibres, max_sheen_density, mean_with_sheen, sample_sheen, sheen_chance, sheen_density, sheen_value,
    through_sheen,
};

// ---- Sides

// Whether both the surface itself and its shading normal face the direction.
fn bsdf_faces(s: Surface, direction: vec3f) -> bool {
    return dot(direction, s.geometric_normal) > 0.0 && dot(direction, s.shading_normal) > 0.0;
}

// The same of the coat.
@if(clearcoat)
fn coat_faces(s: Surface, direction: vec3f) -> bool {
    @if(coat_normals) { return dot(direction, s.geometric_normal) > 0.0 && dot(direction, s.clearcoat.normal) > 0.0; }
    @else { return bsdf_faces(s, direction); }
}

// Whether light from the direction is transmitted through the surface.
@if(transmission)
fn bsdf_passes(s: Surface, direction: vec3f) -> bool {
    let behind = dot(direction, s.geometric_normal) < 0.0 && dot(direction, s.shading_normal) < 0.0;
    return is_transmissive(s.transmission) && behind;
}

// The geometric normal on the side into which the direction leaves.
fn leaving_normal(s: Surface, direction: vec3f) -> vec3f {
    @if(transmission) {
        return select(s.geometric_normal, -s.geometric_normal, dot(direction, s.geometric_normal) < 0.0);
    }
    @else { return s.geometric_normal; }
}

// ---- Frames

// Axes about the shading normal.
fn shading_frame(s: Surface) -> mat3x3f {
    @if(anisotropy) { return anisotropy_frame(s.anisotropy, s.shading_normal); }
    @else { return basis(s.shading_normal); }
}

// The view and another direction in the frame of the shading normal.
@if(glossy)
fn local_pair(s: Surface, direction: vec3f) -> LocalPair {
    var alpha = vec2f(s.specular.alpha);
    @if(anisotropy) { if is_anisotropic(s.anisotropy) { alpha.x = s.anisotropy.alpha_along; } }
    return pair_in_frame(shading_frame(s), s.view, direction, alpha);
}

// Axes about the coat's normal.
@if(clearcoat)
fn coat_frame(s: Surface) -> mat3x3f {
    @if(coat_normals) { return basis(s.clearcoat.normal); }
    @else { return shading_frame(s); }
}

// The view and another direction in the frame of the coat's normal.
@if(clearcoat)
fn coat_pair(s: Surface, direction: vec3f) -> LocalPair {
    return pair_in_frame(coat_frame(s), s.view, direction, vec2f(s.clearcoat.alpha));
}

// ---- Evaluation

// The part of the BSDF that is the same for all directions.
fn bsdf_diffuse(s: Surface) -> vec3f {
    return diffuse_value(s.albedo);
}

// Reflectance of the microfacets for light at the given cosine to their normal.
@if(glossy)
fn reflectance(s: Surface, cosine: f32) -> vec3f {
    @if(transmission) {
        let outer = fresnel_cosine(s.transmission, cosine);
        if outer < 0.0 { return vec3f(1.0); }
        return specular_reflectance(s.specular, outer);
    }
    @else { return specular_reflectance(s.specular, cosine); }
}

// The share of light that coat and fibres transmit to the microfacets and the layers below. `pair` holds `direction`
// and the view in the frame of the shading normal.
@if(glossy)
fn through_upper(s: Surface, direction: vec3f, pair: LocalPair) -> f32 {
    var through = 1.0;
    @if(sheen) { through = through_sheen(s.sheen, pair); }
    @if(clearcoat) { through *= through_coat(s.clearcoat, coat_heights(s.clearcoat, pair, direction, s.view)); }
    return through;
}

// The share of light that all layers transmit to the diffuse base.
@if(glossy)
fn through_to_base(s: Surface, direction: vec3f, pair: LocalPair) -> f32 {
    let layer = through_specular(s.specular, pair.light.z, pair.view.z);
    return layer * through_upper(s, direction, pair);
}

// The BSDF of microfacets and fibres, attenuated by the layers above each.
@if(glossy)
fn specular_value(s: Surface, direction: vec3f, pair: LocalPair) -> vec3f {
    let h = normalize(pair.view + pair.light);
    let value = reflectance(s, dot(pair.view, h)) * microfacets(pair, h) * through_upper(s, direction, pair);
    @if(sheen && clearcoat) {
        let through = through_coat(s.clearcoat, coat_heights(s.clearcoat, pair, direction, s.view));
        return value + sheen_value(s.sheen, pair) * through;
    }
    @if(sheen && !clearcoat) { return value + sheen_value(s.sheen, pair); }
    @if(!sheen) { return value; }
}

// The BSDF less its diffuse part, times the cosine, for light from the unit `direction`. Negative where the layers take
// more light from the base than they reflect in this direction. Each lobe uses the cosine to its own normal, as
// KHR_materials_clearcoat does: a coat with a normal of its own then reflects no more than one with the base's normal.
fn bsdf_residual(s: Surface, direction: vec3f) -> vec3f {
    @if(glossy) {
        let pair = local_pair(s, direction);
        @if(transmission) {
            if bsdf_passes(s, direction) {
                let value = transmission_value(s.transmission, s.specular, pair);
                return value * through_upper(s, direction, pair) * -pair.light.z;
            }
        }
        var value = vec3f(0.0);
        if bsdf_faces(s, direction) {
            let kept = bsdf_diffuse(s) * (1.0 - through_to_base(s, direction, pair));
            value = (specular_value(s, direction, pair) - kept) * pair.light.z;
        }
        @if(clearcoat) {
            let coat = coat_pair(s, direction);
            if coat_faces(s, direction) { value += vec3f(clearcoat_value(s.clearcoat, coat) * coat.light.z); }
        }
        return value;
    }
    @else { return vec3f(0.0); }
}

// The BSDF, per steradian, times the cosine; 0 for directions that the surface neither faces nor transmits.
fn bsdf_evaluate(s: Surface, direction: vec3f) -> vec3f {
    var value = vec3f(0.0);
    if bsdf_faces(s, direction) { value = bsdf_diffuse(s) * dot(direction, s.shading_normal); }
    @if(glossy) { value += bsdf_residual(s, direction); }
    return value;
}

// ---- Where paths end and go on

// Whether a path that ends here by a look-up would lose light that must be traced: the reflection of a metal, or
// transmitted light.
fn reflects_more(s: Surface) -> bool {
    @if(glossy) {
        var more = is_metallic(s.specular);
        @if(transmission) { more = more || is_transmissive(s.transmission); }
        return more;
    }
    @else { return false; }
}

// Whether camera rays continue from this surface: it looks like a mirror or clear glass.
@if(specular_chains)
fn is_clear(s: Surface) -> bool {
    var clear = s.specular.alpha <= MIN_ALPHA && all(s.albedo == vec3f(0.0)) && reflects_more(s);
    @if(clearcoat) { clear = clear && !is_coated(s.clearcoat); }
    @if(sheen) { clear = clear && !has_fibres(s.sheen); }
    @if(anisotropy) { clear = clear && !is_anisotropic(s.anisotropy); }
    return clear;
}

// Maximum alpha of metals that count as focusing.
@if(caustics) override focusing_alpha: f32;

// Whether the surface focuses light. The caustic map holds the light that reaches visible surfaces from lights by way
// of focusing surfaces only.
@if(caustics)
fn focuses(s: Surface) -> bool {
    var focusing = reflects_more(s) && s.specular.alpha <= focusing_alpha;
    @if(transmission) { focusing = focusing || is_transmissive(s.transmission); }
    return focusing;
}

// The ratio of reflected radiance to the irradiance of the geometric surface, where a path ends. A dielectric layer
// counts with its mean reflectance, spread as the base's light is: traced paths would find its highlights of small
// lights with few rays, each as bright as the light. A bent shading normal receives only part of the light.
fn bsdf_seen_afar(s: Surface) -> vec3f {
    let facing = max(dot(s.shading_normal, s.geometric_normal), 0.0) / PI;
    @if(glossy) {
        if !reflects_more(s) {
            var base = mean_with_specular(s.specular, s.albedo);
            @if(sheen) { base = mean_with_sheen(s.sheen, base); }
            @if(clearcoat) {
                let coat = clearcoat_means(s.clearcoat);
                let below = base * coat.y * facing;
                @if(coat_normals) {
                    let coat_facing = max(dot(s.clearcoat.normal, s.geometric_normal), 0.0);
                    return below + s.clearcoat.factor * coat.x * coat_facing / PI;
                }
                @else { return below + s.clearcoat.factor * coat.x * facing; }
            }
            @else { return base * facing; }
        }
    }
    return s.albedo * facing;
}

// ---- Sampling

// The probability of sampling each lobe, by its share of the light reflected straight back. The diffuse base has the
// rest.
@if(glossy)
struct LobeChances {
    // The microfacets' lobe, which reflects and transmits.
    microfacets: f32,
    @if(clearcoat) coat: f32,
    @if(sheen) sheen: f32,
}

@if(glossy)
fn lobe_chances(s: Surface, pair: LocalPair) -> LobeChances {
    let view_z = pair.view.z;
    var specular = dot(reflectance(s, view_z), vec3f(1.0));
    @if(transmission) { specular += dot(transmittance(s.transmission, s.specular, view_z), vec3f(1.0)); }
    let diffuse = dot(s.albedo, vec3f(1.0)) * through_specular(s.specular, view_z, view_z);
    // No probability below a tenth, which bounds the weights of samples to ten times their value.
    var share = clamp(specular / max(specular + diffuse, 1e-30), 0.1, 0.9);
    share = select(select(share, 0.0, specular <= 0.0), 1.0, diffuse <= 0.0);
    var chances: LobeChances;
    chances.microfacets = share;
    var below = specular + diffuse;
    @if(sheen) {
        let fibres = sheen_chance(s.sheen, view_z, below);
        chances.sheen = fibres.chance;
        chances.microfacets *= 1.0 - chances.sheen;
        below = fibres.below + fibres.reflected;
    }
    @if(clearcoat) {
        let through = through_coat(s.clearcoat, vec2f(coat_view_height(s.clearcoat, pair, s.view)));
        chances.coat = clearcoat_chance(s.clearcoat, through, below);
        chances.microfacets *= 1.0 - chances.coat;
        @if(sheen) { chances.sheen *= 1.0 - chances.coat; }
    }
    return chances;
}

// The probability that a sampled microfacet transmits.
@if(transmission)
fn passing_share(s: Surface, cosine: f32) -> f32 {
    let passes = dot(transmittance(s.transmission, s.specular, cosine), vec3f(1.0));
    return passes / max(passes + dot(reflectance(s, cosine), vec3f(1.0)), 1e-30);
}

struct BsdfSample {
    // Unit vector, away from the surface.
    direction: vec3f,
    // The value of `bsdf_evaluate` over the density.
    weight: vec3f,
    // By solid angle; 0 where the direction enters a surface that does not transmit, which ends the path.
    pdf: f32,
    // The change of radiance over that of flux: refraction into a medium of another index scales radiance, but not a
    // photon's flux.
    @if(transmission) concentration: f32,
}

// The density, by solid angle, with which `bsdf_sample` samples the direction.
fn bsdf_pdf(s: Surface, direction: vec3f) -> f32 {
    @if(glossy) {
        let pair = local_pair(s, direction);
        let chances = lobe_chances(s, pair);
        @if(transmission) {
            if bsdf_passes(s, direction) {
                let found = passing(s.transmission, pair);
                let share = passing_share(s, dot(pair.view, found.normal));
                return chances.microfacets * share * passing_density(found, pair);
            }
        }
        let h = normalize(pair.view + pair.light);
        var specular = chances.microfacets;
        @if(transmission) { specular *= 1.0 - passing_share(s, dot(pair.view, h)); }
        var diffuse = 1.0 - chances.microfacets;
        @if(clearcoat) { diffuse -= chances.coat; }
        @if(sheen) { diffuse -= chances.sheen; }
        var pdf = specular * visible_density(pair, h) + max(diffuse, 0.0) * diffuse_density(pair.light.z);
        @if(sheen) { pdf += sheen_density(chances.sheen); }
        pdf = select(0.0, pdf, bsdf_faces(s, direction));
        @if(clearcoat) {
            let density = clearcoat_density(coat_pair(s, direction));
            pdf += select(0.0, chances.coat * density, coat_faces(s, direction));
        }
        return pdf;
    }
    @else {
        if !bsdf_faces(s, direction) { return 0.0; }
        return diffuse_density(dot(direction, s.shading_normal));
    }
}

// A density that no bound holds for: that of light that passes through the surface.
@if(glossy) const UNBOUNDED_DENSITY = 1e30;

// Upper bound of `bsdf_pdf` over all directions; 0 for surfaces whose BSDF is diffuse alone, so that `bsdf_residual` is
// 0. The density is a mean of those of the lobes, weighted by the probabilities of sampling them.
@if(glossy)
fn bsdf_max_density(s: Surface) -> f32 {
    let view_z = clamp(dot(s.view, s.shading_normal), 1e-4, 1.0);
    var alpha = vec2f(s.specular.alpha);
    @if(anisotropy) { if is_anisotropic(s.anisotropy) { alpha.x = s.anisotropy.alpha_along; } }
    var density = select(max_visible_density(view_z, alpha), 0.0, is_black_specular(s.specular));
    @if(sheen) { density = max(density, max_sheen_density(s.sheen)); }
    @if(clearcoat) { density = max(density, max_clearcoat_density(s.clearcoat, s.view, view_z)); }
    @if(transmission) { if is_transmissive(s.transmission) { return UNBOUNDED_DENSITY; } }
    return select(max(density, diffuse_density(1.0)), 0.0, density == 0.0);
}

// A direction in scene space, and the lobe that it was sampled from.
@if(glossy)
struct LobeDirection {
    direction: vec3f,
    // Whether the direction leads through the surface.
    @if(transmission) passed: bool,
    @if(clearcoat) of_coat: bool,
}

@if(glossy)
fn sample_lobe(s: Surface, u: vec3f) -> LobeDirection {
    let frame = shading_frame(s);
    let pair = local_pair(s, s.view);
    let chances = lobe_chances(s, pair);
    var result: LobeDirection;
    var below = chances.microfacets;
    var lobe = pair;
    var axes = frame;
    @if(clearcoat) {
        result.of_coat = u.z >= below && u.z < below + chances.coat;
        below += chances.coat;
        if result.of_coat { lobe = coat_pair(s, s.view); }
        @if(coat_normals) { if result.of_coat { axes = coat_frame(s); } }
    }
    let h = sample_visible_normal(lobe.view, lobe.alpha, u.xy);
    var wide = sample_cosine(u.xy);
    @if(sheen) { if u.z < below + chances.sheen { wide = sample_sheen(u.xy); } }
    var local = select(wide, reflect(-lobe.view, h), u.z < below);
    @if(transmission) {
        // The lower part of the microfacets' random numbers transmits, the rest reflects.
        result.passed = u.z < chances.microfacets * passing_share(s, dot(pair.view, h));
        if result.passed { local = passed_direction(s.transmission, pair.view, h, local); }
    }
    result.direction = normalize(axes * local);
    return result;
}

// Samples a direction of incident light, approximately in proportion to the BSDF times the cosine.
fn bsdf_sample(s: Surface, u: vec3f) -> BsdfSample {
    @if(glossy) {
        let sampled = sample_lobe(s, u);
        let direction = sampled.direction;
        var result = BsdfSample();
        result.direction = direction;
        // A direction that is reflected into the surface, or refracted out of it, would hit more microfacets: it is
        // left out.
        @if(transmission) { if bsdf_passes(s, direction) != sampled.passed { return result; } }
        // A lobe contributes to the density of a direction only if it faces the direction.
        @if(coat_normals) {
            var faced = select(bsdf_faces(s, direction), coat_faces(s, direction), sampled.of_coat);
            @if(transmission) { faced |= sampled.passed; }
            if !faced { return result; }
        }
        result.pdf = bsdf_pdf(s, direction);
        if result.pdf <= 0.0 { return result; }
        result.weight = bsdf_evaluate(s, direction) / result.pdf;
        @if(transmission) {
            let eta = s.transmission.eta;
            result.concentration = select(1.0, eta * eta, bsdf_passes(s, direction));
        }
        return result;
    }
    @else {
        let direction = normalize(shading_frame(s) * sample_cosine(u.xy));
        let pdf = bsdf_pdf(s, direction);
        return BsdfSample(direction, select(vec3f(0.0), s.albedo, pdf > 0.0), pdf);
    }
}
