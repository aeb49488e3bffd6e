// Iridescence: a thin film on the specular lobe, which replaces its Fresnel term (KHR_materials_iridescence, after
// Belcour and Barla 2017). Its parameters are read in src/scene/material/lobes/iridescence.rs.

@if(iridescence) import package::lib::bsdf::lobe::LobeContext;
@if(iridescence) import package::lib::bsdf::microfacet::schlick;
@if(iridescence) import package::lib::bsdf::specular::Specular;
@if(iridescence) import package::lib::constants::IRIDESCENCE_TEXEL;
@if(iridescence && textures) import package::lib::constants::{
    IRIDESCENCE_TEXTURE, IRIDESCENCE_TEXTURES, IRIDESCENCE_THICKNESS_TEXTURE,
};
@if(iridescence) import package::lib::material::load_material_texel;
@if(iridescence) import package::lib::math::{PI, circle_point, safe_sqrt};

@if(iridescence)
struct Iridescence {
    // How much of the reflectance is that of the film; 0 where there is none.
    factor: f32,
    // Index of refraction, at least 1.
    ior: f32,
    // Thickness in nanometres.
    thickness: f32,
}

// For the factor, and for the thickness from minimum to maximum.
@if(iridescence) alias IridescenceFactors = vec2f;

@if(iridescence)
fn iridescence_untextured() -> IridescenceFactors {
    return vec2f(1.0);
}

@if(iridescence && textures)
fn iridescence_textures() -> u32 {
    return IRIDESCENCE_TEXTURES;
}

@if(iridescence && textures)
fn iridescence_texture(factors: IridescenceFactors, texel: vec4f, texture: u32) -> IridescenceFactors {
    let of_thickness = texture == IRIDESCENCE_THICKNESS_TEXTURE;
    return select(factors, texel.xy, vec2<bool>(texture == IRIDESCENCE_TEXTURE, of_thickness));
}

@if(iridescence)
fn iridescence_lobe(material: u32, factors: IridescenceFactors, context: LobeContext) -> Iridescence {
    let own = bitcast<vec4f>(load_material_texel(material + IRIDESCENCE_TEXEL));
    return Iridescence(own.x * factors.x, own.y, mix(own.z, own.w, factors.y));
}

@if(iridescence)
fn iridescence_is_present(lobe: Iridescence) -> bool {
    return lobe.factor > 0.0;
}

@if(iridescence)
fn pack_iridescence(lobe: Iridescence) -> vec4f {
    return vec4f(lobe.factor, lobe.ior, lobe.thickness, 0.0);
}

@if(iridescence)
fn unpack_iridescence(packed: vec4f) -> Iridescence {
    return Iridescence(packed.x, packed.y, packed.z);
}

// ---- The film as part of the specular lobe

// Reflectance for light at the given cosine, which is `bare` without the film.
@if(iridescence)
fn iridescence_reflectance(lobe: Iridescence, specular: Specular, bare: vec3f, cosine: f32) -> vec3f {
    var reflected = bare;
    if iridescence_is_present(lobe) { reflected = mix(bare, film_reflectance(lobe, specular.f0, cosine), lobe.factor); }
    return reflected;
}

// The share of light that does not reach the layers below; without the film it is `bare`.
@if(iridescence)
fn iridescence_kept(lobe: Iridescence, specular: Specular, bare: f32, cosine: f32) -> f32 {
    var kept = bare;
    if iridescence_is_present(lobe) { kept = mix(bare, film_kept(lobe, specular.f0, cosine), lobe.factor); }
    return kept;
}

// The share of light transmitted to the diffuse base and out again, which is `bare` without the film.
@if(iridescence)
fn iridescence_through(lobe: Iridescence, specular: Specular, bare: f32, light_z: f32, view_z: f32) -> f32 {
    var through = bare;
    if iridescence_is_present(lobe) {
        through = mix(bare, through_film(lobe, specular.f0, specular.alpha, light_z, view_z), lobe.factor);
    }
    return through;
}

// ---- The film

// The Fourier transform of the eye's sensitivity at an optical path difference, in linear sRGB: Gaussians fitted to the
// CIE's functions (Belcour and Barla 2017, appendix), with the constants of KHR_materials_iridescence. `shift` is the
// phase shift.
@if(iridescence)
fn film_sensitivity(path: f32, shift: vec3f) -> vec3f {
    let turns = path * 1e-9;
    let phase = 2.0 * PI * turns;
    // Normalised, and multiplied by the Gaussians' widths.
    let amplitude = vec3f(0.8465900023, 1.0002218936, 1.0011224857);
    let position = vec3f(1.6810e6, 1.7953e6, 2.2084e6);
    let variance = vec3f(4.3278e9, 9.3046e9, 6.6121e9);
    let wave = position * turns + shift * (0.5 / PI);
    let cosines = vec3f(circle_point(wave.x).x, circle_point(wave.y).x, circle_point(wave.z).x);
    var xyz = amplitude * cosines * exp(-variance * (phase * phase));
    let second = circle_point(2.2399e6 * turns + shift.x * (0.5 / PI)).x;
    xyz.x += 0.1538683065 * second * exp(-4.5282e9 * (phase * phase));
    return mat3x3f(
        vec3f(3.2404542, -0.9692660, 0.0556434),
        vec3f(-1.5371385, 1.8760108, -0.2040259),
        vec3f(-0.4985314, 0.0415560, 1.0572252),
    ) * xyz;
}

// Reflectance of film and base for light at the given cosine, outside the film, to their normal. `f0` is the
// reflectance of the base at normal incidence, without the film. The limits (a thickness of 0.03 nm, reflectances of
// 1e-5 and 0.9999) are those of the Khronos sample viewer's code.
@if(iridescence)
fn film_reflectance(lobe: Iridescence, f0: vec3f, cosine: f32) -> vec3f {
    // As the thickness goes to 0, the film's index goes to that of the medium outside, which leaves the base alone.
    let index = mix(1.0, lobe.ior, smoothstep(0.0, 0.03, lobe.thickness));
    let inner = safe_sqrt(1.0 - (1.0 - cosine * cosine) / (index * index));
    let outer_f0 = (index - 1.0) / (index + 1.0);
    let outer = mix(outer_f0 * outer_f0, 1.0, schlick(cosine));
    let passed = 1.0 - outer;

    let root = sqrt(clamp(f0, vec3f(0.0), vec3f(0.9999)));
    let base_index = (1.0 + root) / (1.0 - root);
    let base_f0 = (base_index - index) / (base_index + index);
    let base = mix(base_f0 * base_f0, vec3f(1.0), schlick(inner));
    // Reflection at a higher index shifts the phase by half a wave. Within the film this does not happen at the air,
    // but may happen at the base.
    let shift = PI + select(vec3f(0.0), vec3f(PI), base_index < vec3f(index));
    let path = 2.0 * index * lobe.thickness * inner;

    // Airy's sum over the orders of reflection in the film, as a cosine series: two terms are enough.
    let both = clamp(outer * base, vec3f(1e-5), vec3f(0.9999));
    let returned = passed * passed * base / (1.0 - both);
    let ratio = sqrt(both);
    var reflected = outer + returned;
    var amplitude = (returned - passed) * ratio;
    reflected += amplitude * 2.0 * film_sensitivity(path, shift);
    amplitude *= ratio;
    reflected += amplitude * 2.0 * film_sensitivity(2.0 * path, 2.0 * shift);
    // Spectral colours lie partly outside sRGB. Clamp components below 0, and those above 1, which would create light.
    return clamp(reflected, vec3f(0.0), vec3f(1.0));
}

// The largest component: light that the film reflects in any colour does not reach the layers below.
@if(iridescence)
fn film_kept(lobe: Iridescence, f0: vec3f, cosine: f32) -> f32 {
    let reflected = film_reflectance(lobe, f0, cosine);
    return max(reflected.x, max(reflected.y, reflected.z));
}

// The share of light that film and base transmit at both of two angles to the surface's normal. The film's reflectance
// is not monotonic towards grazing angles, so the larger of the two reflectances counts, not that at the lower angle.
// As without a film, a rough layer reflects less at grazing angles.
@if(iridescence)
fn through_film(lobe: Iridescence, f0: vec3f, alpha: f32, light_z: f32, view_z: f32) -> f32 {
    let of_light = film_kept(lobe, f0, light_z) * (1.0 - 0.9 * alpha * schlick(light_z));
    let of_view = film_kept(lobe, f0, view_z) * (1.0 - 0.9 * alpha * schlick(view_z));
    return 1.0 - max(of_light, of_view);
}
