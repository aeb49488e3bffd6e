// The BSDF: glTF's metallic-roughness model. This file combines the lobes of lib/bsdf/: GGX microfacets over a
// Lambertian base, part of which may transmit light; films and tangents that change the microfacets; above them layers,
// first those that reflect to all sides, then those of other microfacets. `@each` repeats a line for every lobe of such
// a part: see src/kernels/each.rs.
//
// Here and in lib/bsdf/ conditions are joined by & and |, and values come from `select`, where an `if` would save
// little: &&, || and early returns are branches. Each branch that follows another in a loop, as in that over the
// vertices of a path, may double the time of SwiftShader's compiler (docs/devices.md, "Branches in loops"), and each
// call copies this code into the loop.

import package::lib::bsdf::diffuse::{diffuse_density, diffuse_value};
import package::lib::bsdf::surface::Surface;
@if(transmission) import package::lib::bsdf::surface::passes_light;
@if(diffuse_transmission) import package::lib::bsdf::diffuse_transmission::{
    diffuse_transmission_is_present, diffusely_passing_share,
};
import package::lib::math::{PI, basis};
import package::lib::sampling::sample_cosine;
@if(glossy) import package::lib::bsdf::lobe::LayerPair;
@if(glossy) import package::lib::bsdf::microfacet::{
    LocalPair, MIN_ALPHA, MIN_VIEW_COSINE, max_visible_density, microfacets, pair_in_frame, reflection_density,
    sample_visible_normal, visible_density,
};
@if(glossy) import package::lib::bsdf::specular::{
    change_under_layer, is_black_specular, is_metallic, mean_with_specular, specular_kept, specular_reflectance,
    specular_through,
};
@if(transmission) import package::lib::bsdf::transmission::{
    fresnel_cosine, passed_direction, passing, passing_density, passing_value, transmission_is_present,
};
@each(film) import package::lib::bsdf::NAME::{NAME_is_present, NAME_kept, NAME_reflectance, NAME_through};
@each(spread) import package::lib::bsdf::NAME::{NAME_alpha, NAME_frame, NAME_is_present};
@each(wide_layer) import package::lib::bsdf::NAME::{
    NAME_chance, NAME_density, NAME_is_present, NAME_max_density, NAME_mean, NAME_sample, NAME_through, NAME_value,
};
@each(glossy_layer) import package::lib::bsdf::NAME::{
    NAME_axes, NAME_chance, NAME_faces, NAME_has_normal, NAME_is_present, NAME_max_density, NAME_pair, NAME_seen_afar,
    NAME_through, NAME_value,
};

// ---- Sides

// Whether both the surface itself and its shading normal face the direction.
fn bsdf_faces(s: Surface, direction: vec3f) -> bool {
    return (dot(direction, s.geometric_normal) > 0.0) & (dot(direction, s.shading_normal) > 0.0);
}

// Whether light from the direction is transmitted through the surface.
@if(transmission)
fn bsdf_passes(s: Surface, direction: vec3f) -> bool {
    let behind = (dot(direction, s.geometric_normal) < 0.0) & (dot(direction, s.shading_normal) < 0.0);
    return passes_light(s) & behind;
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
    var frame = basis(s.shading_normal);
    @each(spread) { frame = NAME_frame(s.NAME, frame); }
    return frame;
}

// The view and another direction in the frame of the shading normal.
@if(glossy)
fn local_pair(s: Surface, direction: vec3f) -> LocalPair {
    var alpha = vec2f(s.specular.alpha);
    @each(spread) { alpha = NAME_alpha(s.NAME, alpha); }
    return pair_in_frame(shading_frame(s), s.view, direction, alpha);
}

// ---- The specular lobe and its films

// The cosine that Fresnel's terms depend on, for a cosine on the viewer's side; -1 for total internal reflection.
@if(glossy)
fn outer_cosine(s: Surface, cosine: f32) -> f32 {
    @if(transmission) { return fresnel_cosine(s.transmission.eta, cosine); }
    @else { return cosine; }
}

// Reflectance of the microfacets for light at the given cosine to their normal.
@if(glossy)
fn reflectance(s: Surface, cosine: f32) -> vec3f {
    let outer = outer_cosine(s, cosine);
    var reflected = specular_reflectance(s.specular, outer);
    @each(film) { reflected = NAME_reflectance(s.NAME, s.specular, reflected, outer); }
    @if(transmission) { reflected = select(reflected, vec3f(1.0), outer < 0.0); }
    return reflected;
}

// The share of light that the microfacets transmit, at the given cosine to their normal.
@if(transmission)
fn transmittance(s: Surface, cosine: f32) -> vec3f {
    let outer = outer_cosine(s, cosine);
    var kept = specular_kept(s.specular, outer);
    @each(film) { kept = NAME_kept(s.NAME, s.specular, kept, outer); }
    return select(s.transmission.tint * (1.0 - kept), vec3f(0.0), outer < 0.0);
}

// The share of light that the microfacets transmit to the diffuse base and out again; both cosines are outer ones.
@if(glossy)
fn through_microfacets(s: Surface, light: f32, view: f32) -> f32 {
    var through = specular_through(s.specular, light, view);
    @each(film) { through = NAME_through(s.NAME, s.specular, through, light, view); }
    @if(transmission) { through = select(through, 0.0, min(light, view) < 0.0); }
    return through;
}

// ---- Evaluation

// The share of light that the layers transmit to the microfacets.
@if(glossy)
fn through_layers(s: Surface, pair: LayerPair) -> f32 {
    var through = 1.0;
    @each(layer) { through *= NAME_through(s.NAME, pair); }
    return through;
}

// The share of light that layers and microfacets transmit to the diffuse base.
@if(glossy)
fn through_to_base(s: Surface, pair: LayerPair) -> f32 {
    let outer = vec2f(outer_cosine(s, pair.local.light.z), outer_cosine(s, pair.local.view.z));
    return through_microfacets(s, outer.x, outer.y) * through_layers(s, pair);
}

// The diffuse part of the BSDF, which is the same for light from all directions: what the base reflects to the viewer
// of light along the normal. Layers take more of other light, which the residual subtracts. At a grazing view they
// take most; if that were left to the residual, its noise would exceed what is seen.
fn bsdf_diffuse(s: Surface) -> vec3f {
    @if(glossy) {
        let pair = LayerPair(local_pair(s, s.shading_normal), s.shading_normal, s.view);
        return diffuse_value(s.albedo) * through_to_base(s, pair);
    }
    @else { return diffuse_value(s.albedo); }
}

// The BSDF of microfacets and wide layers, attenuated by the layers above each.
@if(glossy)
fn specular_value(s: Surface, pair: LayerPair) -> vec3f {
    let local = pair.local;
    let h = normalize(local.view + local.light);
    var value = reflectance(s, dot(local.view, h)) * microfacets(local, h) * through_layers(s, pair);
    var above = 1.0;
    @each_from_top(glossy_layer) { above *= NAME_through(s.NAME, pair); }
    @each_from_top(wide_layer) {
        value += NAME_value(s.NAME, local) * above;
        above *= NAME_through(s.NAME, pair);
    }
    return value;
}

// The BSDF of the glossy layers times the cosine to their normals, attenuated by the layers above each.
@if(glossy)
fn glossy_layers_value(s: Surface, pair: LayerPair, faced: bool) -> vec3f {
    var value = vec3f(0.0);
    var above = 1.0;
    @each_from_top(glossy_layer) {
        let own = NAME_pair(s.NAME, pair);
        if NAME_faces(s.NAME, s.geometric_normal, pair.light, faced) {
            value += NAME_value(s.NAME, own) * own.light.z * above;
        }
        above *= NAME_through(s.NAME, pair);
    }
    return value;
}

// The BSDF of the base for light from the other side that it scatters.
@if(diffuse_transmission)
fn diffusely_passed(s: Surface, local: LocalPair) -> vec3f {
    // Seen from the light, the media change places.
    let light = fresnel_cosine(1.0 / s.transmission.eta, -local.light.z);
    return diffuse_value(s.diffuse_transmission.tint) * through_microfacets(s, light, outer_cosine(s, local.view.z));
}

// The BSDF less a part that is the same for all directions, times the cosine, for light from the unit `direction`. With
// the diffuse part as `part` this is the residual. It is negative where the layers take more of this light from the
// base than of light along the normal, and more than they reflect. Each lobe uses the cosine to its own normal, as
// KHR_materials_clearcoat does: a coat with a normal of its own then reflects no more than one with the base's normal.
@if(glossy)
fn bsdf_less(s: Surface, direction: vec3f, part: vec3f) -> vec3f {
    let pair = LayerPair(local_pair(s, direction), direction, s.view);
    @if(transmission) {
        if bsdf_passes(s, direction) {
            let found = passing(s.transmission, pair.local);
            let share = transmittance(s, dot(pair.local.view, found.normal));
            var value = share * passing_value(s.transmission, found, pair.local);
            @if(diffuse_transmission) { value += diffusely_passed(s, pair.local); }
            return value * through_layers(s, pair) * -pair.local.light.z;
        }
    }
    var value = vec3f(0.0);
    let faced = bsdf_faces(s, direction);
    if faced {
        let base = diffuse_value(s.albedo) * through_to_base(s, pair);
        value = (specular_value(s, pair) + (base - part)) * pair.local.light.z;
    }
    return value + glossy_layers_value(s, pair, faced);
}

// The BSDF, per steradian, times the cosine; 0 for directions that the surface neither faces nor transmits.
fn bsdf_evaluate(s: Surface, direction: vec3f) -> vec3f {
    @if(glossy) { return bsdf_less(s, direction, vec3f(0.0)); }
    @else { return diffuse_reflection(s, direction); }
}

// The diffuse part of the BSDF, times the cosine; 0 for directions that the surface does not face.
fn diffuse_reflection(s: Surface, direction: vec3f) -> vec3f {
    let cosine = select(0.0, dot(direction, s.shading_normal), bsdf_faces(s, direction));
    return bsdf_diffuse(s) * cosine;
}

// ---- Where paths end and continue

// Whether the surface reflects as a metal or a film does, or refracts.
@if(glossy)
fn reflects_or_refracts(s: Surface) -> bool {
    var more = is_metallic(s.specular);
    // The colours of a film depend on the direction: a mean cannot represent them.
    @each(film) { more |= NAME_is_present(s.NAME); }
    @if(transmission) { more |= transmission_is_present(s.transmission); }
    return more;
}

// Whether a path that ends here by a look-up would lose light that must be traced: the reflection of a metal, or
// transmitted light.
fn reflects_more(s: Surface) -> bool {
    @if(glossy) {
        var more = reflects_or_refracts(s);
        @if(transmission) { more |= passes_light(s); }
        return more;
    }
    @else { return false; }
}

// Whether camera rays continue from this surface: it looks like a mirror or clear glass.
@if(specular_chains)
fn is_clear(s: Surface) -> bool {
    var clear = s.specular.alpha <= MIN_ALPHA && all(s.albedo == vec3f(0.0)) && reflects_more(s);
    @each(layer) { clear = clear && !NAME_is_present(s.NAME); }
    @each(spread) { clear = clear && !NAME_is_present(s.NAME); }
    @if(diffuse_transmission) { clear = clear && !diffuse_transmission_is_present(s.diffuse_transmission); }
    return clear;
}

// Maximum alpha of metals that count as focusing.
@if(caustics) override focusing_alpha: f32;

// Whether the surface focuses light. The caustic map holds the light that reaches visible surfaces from lights by way
// of focusing surfaces only.
@if(caustics)
fn focuses(s: Surface) -> bool {
    var focusing = reflects_or_refracts(s) && s.specular.alpha <= focusing_alpha;
    @if(transmission) { focusing = focusing || transmission_is_present(s.transmission); }
    return focusing;
}

// Minimum alpha of a dielectric layer that is met by a ray of a diffuse surface. A layer shows a light without a size
// as bright as 1 / alpha^2: a smooth pane in scenes/still_life.glb made a record a thousand times too bright
// (docs/decisions.md, "Lights in smooth layers"). Other values were not compared.
const MIN_INDIRECT_ALPHA = 0.3;

// The surface as rays in a cone of directions see it; `spread` is 1 for those of a Lambertian surface, and less for a
// narrower cone. Its dielectric layers are as rough as the cone is wide (Kaplanyan and Dachsbacher 2013, path space
// regularisation). Metals, films and surfaces that transmit light (`reflects_more`) stay as they are: the caustic map
// has their light.
@if(global_map && glossy)
fn blurred_surface(s: Surface, spread: f32) -> Surface {
    var seen = s;
    if !reflects_more(s) {
        let alpha = MIN_INDIRECT_ALPHA * spread;
        seen.specular.alpha = max(s.specular.alpha, alpha);
        @each(glossy_layer) { seen.NAME.alpha = max(s.NAME.alpha, alpha); }
    }
    return seen;
}

// The ratio of reflected radiance to irradiance, where a path ends. A dielectric layer counts with its mean
// reflectance, spread as the base's light is. If paths were traced instead, few rays would hit the layer's highlights
// of small lights, and each would be as bright as the light.
fn bsdf_seen_afar(s: Surface) -> vec3f {
    @if(glossy) {
        if !reflects_more(s) {
            var base = mean_with_specular(s.specular, s.albedo);
            @each(wide_layer) { base = NAME_mean(s.NAME, base); }
            var reflected = 0.0;
            @each(glossy_layer) {
                let layer = NAME_seen_afar(s.NAME, s.geometric_normal);
                base = base * layer.y + change_under_layer(s.specular, s.albedo) * layer.z;
                reflected = reflected * layer.y + layer.x;
            }
            return (base + reflected) / PI;
        }
    }
    // Paths continue with the residual.
    return bsdf_diffuse(s);
}

// ---- Sampling

// The probability of sampling each lobe, by its share of the light reflected straight back. The diffuse base has the
// rest.
@if(glossy)
struct LobeChances {
    // The microfacets' lobe, which reflects and transmits.
    microfacets: f32,
    @each(layer) NAME: f32,
}

@if(glossy)
fn lobe_chances(s: Surface, pair: LayerPair) -> LobeChances {
    let view_z = pair.local.view.z;
    var specular = dot(reflectance(s, view_z), vec3f(1.0));
    @if(transmission) { specular += dot(transmittance(s, view_z), vec3f(1.0)); }
    var base = s.albedo;
    @if(diffuse_transmission) { base += s.diffuse_transmission.tint; }
    let outer = outer_cosine(s, view_z);
    let diffuse = dot(base, vec3f(1.0)) * through_microfacets(s, outer, outer);
    // No probability below a tenth, which bounds the weights of samples to ten times their value.
    var share = clamp(specular / max(specular + diffuse, 1e-30), 0.1, 0.9);
    share = select(select(share, 0.0, specular <= 0.0), 1.0, diffuse <= 0.0);
    var chances: LobeChances;
    chances.microfacets = share;
    var below = specular + diffuse;
    @each(layer) {
        let layer = NAME_chance(s.NAME, pair, below);
        chances.NAME = layer.chance;
        chances.microfacets *= 1.0 - layer.chance;
        below = layer.reflected;
    }
    var above = 1.0;
    @each_from_top(layer) {
        let chance = chances.NAME;
        chances.NAME *= above;
        above *= 1.0 - chance;
    }
    return chances;
}

// The probability that a sampled microfacet transmits; 0 if it neither transmits nor reflects.
@if(transmission)
fn passing_share(s: Surface, cosine: f32) -> f32 {
    let passes = dot(transmittance(s, cosine), vec3f(1.0));
    return passes / max(passes + dot(reflectance(s, cosine), vec3f(1.0)), 1e-30);
}

// The probability of sampling the diffuse base.
@if(glossy)
fn diffuse_chance(chances: LobeChances) -> f32 {
    var diffuse = 1.0 - chances.microfacets;
    @each_from_top(layer) { diffuse -= chances.NAME; }
    return max(diffuse, 0.0);
}

struct BsdfSample {
    // Unit vector, away from the surface.
    direction: vec3f,
    // The value of `bsdf_evaluate` over the density.
    weight: vec3f,
    // The value of `bsdf_less` for the diffuse part.
    @if(glossy) residual: vec3f,
    // Density by solid angle; 0 if the direction enters a surface that does not transmit, which ends the path.
    pdf: f32,
    // `weight` is for radiance. Over this it is for a photon's flux, which refraction into a medium of another index
    // does not scale.
    @if(transmission) concentration: vec3f,
}

// The density, by solid angle, with which `bsdf_sample` samples the direction.
fn bsdf_pdf(s: Surface, direction: vec3f) -> f32 {
    @if(glossy) {
        let layer_pair = LayerPair(local_pair(s, direction), direction, s.view);
        let pair = layer_pair.local;
        let chances = lobe_chances(s, layer_pair);
        @if(transmission) {
            if bsdf_passes(s, direction) {
                let found = passing(s.transmission, pair);
                let share = passing_share(s, dot(pair.view, found.normal));
                var passes = chances.microfacets * share * passing_density(found, pair);
                @if(diffuse_transmission) {
                    let diffused = diffuse_chance(chances) * diffusely_passing_share(s.diffuse_transmission, s.albedo);
                    passes += diffused * diffuse_density(-pair.light.z);
                }
                return passes;
            }
        }
        let h = normalize(pair.view + pair.light);
        let faced = bsdf_faces(s, direction);
        var specular = chances.microfacets;
        @if(transmission) { specular *= 1.0 - passing_share(s, dot(pair.view, h)); }
        var diffuse = diffuse_chance(chances);
        @if(diffuse_transmission) { diffuse *= 1.0 - diffusely_passing_share(s.diffuse_transmission, s.albedo); }
        var pdf = specular * visible_density(pair, h) + diffuse * diffuse_density(pair.light.z);
        @each(wide_layer) { pdf += NAME_density(chances.NAME, pair); }
        pdf = select(0.0, pdf, faced);
        @each(glossy_layer) {
            let density = reflection_density(NAME_pair(s.NAME, layer_pair));
            pdf += select(0.0, chances.NAME * density, NAME_faces(s.NAME, s.geometric_normal, direction, faced));
        }
        return pdf;
    }
    @else {
        if !bsdf_faces(s, direction) { return 0.0; }
        return diffuse_density(dot(direction, s.shading_normal));
    }
}

// Stands for a density without an upper bound: that of light that passes through the surface.
@if(glossy) const UNBOUNDED_DENSITY = 1e30;

// Upper bound of `bsdf_pdf` over all directions; 0 for surfaces whose BSDF is diffuse alone, so that the residual is 0.
// The density is a mean of those of the lobes, weighted by the probabilities of sampling them.
@if(glossy)
fn bsdf_max_density(s: Surface) -> f32 {
    let view_z = clamp(dot(s.view, s.shading_normal), MIN_VIEW_COSINE, 1.0);
    var alpha = vec2f(s.specular.alpha);
    @each(spread) { alpha = NAME_alpha(s.NAME, alpha); }
    var black = is_black_specular(s.specular);
    @each(film) { black &= !NAME_is_present(s.NAME); }
    var density = select(max_visible_density(view_z, alpha), 0.0, black);
    @each(layer) { density = max(density, NAME_max_density(s.NAME, s.view, view_z)); }
    @if(transmission) { if passes_light(s) { return UNBOUNDED_DENSITY; } }
    return select(max(density, diffuse_density(1.0)), 0.0, density == 0.0);
}

// A direction in scene space, and the lobe that it was sampled from.
@if(glossy)
struct LobeDirection {
    direction: vec3f,
    // Whether the direction leads through the surface.
    @if(transmission) passed: bool,
    // Whether it was sampled from this layer.
    @each(glossy_layer) of_NAME: bool,
}

@if(glossy)
fn sample_lobe(s: Surface, u: vec3f) -> LobeDirection {
    let frame = shading_frame(s);
    let pair = local_pair(s, s.view);
    let layer_pair = LayerPair(pair, s.view, s.view);
    let chances = lobe_chances(s, layer_pair);
    var result: LobeDirection;
    var below = chances.microfacets;
    var lobe = pair;
    var axes = frame;
    @each_from_top(glossy_layer) {
        result.of_NAME = (u.z >= below) & (u.z < below + chances.NAME);
        below += chances.NAME;
        if result.of_NAME {
            lobe = NAME_pair(s.NAME, layer_pair);
            axes = NAME_axes(s.NAME, frame);
        }
    }
    let h = sample_visible_normal(lobe.view, lobe.alpha, u.xy);
    var wide = sample_cosine(u.xy);
    var end = below;
    @each_from_top(wide_layer) {
        let of_layer = (u.z >= end) & (u.z < end + chances.NAME);
        end += chances.NAME;
        if of_layer { wide = NAME_sample(u.xy); }
    }
    @if(diffuse_transmission) {
        // The upper part of the base's random numbers passes.
        let diffused = diffuse_chance(chances) * diffusely_passing_share(s.diffuse_transmission, s.albedo);
        result.passed = u.z >= max(1.0 - diffused, end);
        if result.passed { wide.z = -wide.z; }
    }
    var local = select(wide, reflect(-lobe.view, h), u.z < below);
    @if(transmission) {
        // The lower part of the microfacets' random numbers transmits, the rest reflects.
        let refracted = u.z < chances.microfacets * passing_share(s, dot(pair.view, h));
        if refracted { local = passed_direction(s.transmission, pair.view, h, local); }
        result.passed |= refracted;
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
        // A lobe contributes to the density of a direction only if it faces the direction. If all lobes have the same
        // normal, the density of other directions is 0.
        let base_faced = bsdf_faces(s, direction);
        var faced = base_faced;
        var normals_differ = false;
        @each(glossy_layer) {
            let layer_faced = NAME_faces(s.NAME, s.geometric_normal, direction, base_faced);
            faced = select(faced, layer_faced, sampled.of_NAME);
            normals_differ |= NAME_has_normal();
        }
        @if(transmission) { faced |= sampled.passed; }
        if normals_differ && !faced { return result; }
        result.pdf = bsdf_pdf(s, direction);
        if result.pdf <= 0.0 { return result; }
        let diffuse = bsdf_diffuse(s);
        result.residual = bsdf_less(s, direction, diffuse);
        let cosine = select(0.0, dot(direction, s.shading_normal), base_faced);
        result.weight = (diffuse * cosine + result.residual) / result.pdf;
        @if(transmission) {
            let eta = s.transmission.eta;
            result.concentration = vec3f(select(1.0, eta * eta, bsdf_passes(s, direction)));
            @if(diffuse_transmission) {
                // Only the refracted part is concentrated.
                if bsdf_passes(s, direction) {
                    let pair = LayerPair(local_pair(s, direction), direction, s.view);
                    let diffused = diffusely_passed(s, pair.local) * through_layers(s, pair) * -pair.local.light.z;
                    let share = clamp(diffused / max(result.weight * result.pdf, vec3f(1e-30)), vec3f(0.0), vec3f(1.0));
                    result.concentration = 1.0 / mix(vec3f(1.0 / (eta * eta)), vec3f(1.0), share);
                }
            }
        }
        return result;
    }
    @else {
        let direction = normalize(shading_frame(s) * sample_cosine(u.xy));
        let pdf = bsdf_pdf(s, direction);
        return BsdfSample(direction, select(vec3f(0.0), s.albedo, pdf > 0.0), pdf);
    }
}
