// Dispersion (KHR_materials_dispersion): light of three wavelengths, red, green and blue. They travel together up to
// the first surface that refracts each in its own direction. From there a path continues with one of them, in place of
// all three: a third of the paths for each, with three times the light. Only that component of its light is then not 0,
// which identifies the wavelength.

@if(dispersion) import package::lib::rng::hash1;

// The wavelength, 0 red to 2 blue, that this invocation takes where light has all.
@if(dispersion) var<private> own_wavelength: u32;
// Factor of a path's light before its first vertex.
@if(dispersion) var<private> carried_before: vec3f;
// The light of the ray whose hit is being evaluated; 0 if no wavelength is needed.
@if(dispersion) var<private> carried: vec3f;

// Chooses the wavelength. Consecutive numbers of one seed take the three in turn.
@if(dispersion)
fn begin_wavelengths(seed: u32, number: u32, before: vec3f) {
    own_wavelength = (hash1(seed) % 3u + number % 3u) % 3u;
    carried_before = before;
    carried = before;
}

// Sets the light of the next ray.
@if(dispersion)
fn carry(light: vec3f) {
    carried = carried_before * light;
}

@if(dispersion)
struct Refracted {
    wavelength: u32,
    // Factor of its light; 0 for the other wavelengths.
    share: vec3f,
}

// The wavelength that a surface refracts, which lets the share `tint` of each pass: one that the ray carries and the
// surface lets pass, or green if there is none. So whatever wavelength is chosen, the surface transmits light, and
// paths and photons agree on whether it focuses light.
@if(dispersion)
fn refracted_wavelength(tint: vec3f) -> Refracted {
    let present = vec3u(carried * tint != vec3f(0.0));
    let count = present.x + present.y + present.z;
    if count == 0u { return Refracted(1u, vec3f(1.0)); }
    if count == 1u { return Refracted(present.y + 2u * present.z, vec3f(1.0)); }
    // In place of one that is absent comes the next one, which then has two thirds of the paths.
    let chosen = select((own_wavelength + 1u) % 3u, own_wavelength, present[own_wavelength] != 0u);
    let thirds = 2u - present[(chosen + 2u) % 3u];
    return Refracted(chosen, select(vec3f(0.0), vec3f(3.0 / f32(thirds)), vec3u(chosen) == vec3u(0u, 1u, 2u)));
}
