// Dispersion (KHR_materials_dispersion): light of three wavelengths, red, green and blue. It travels together up to the
// first surface that refracts each its own way. There a path goes on with one of them, for all three: a third of the
// paths each, with three times the light. From then on, that component alone is not 0, which tells the wavelength.

@if(dispersion) import package::lib::rng::hash1;

// The wavelength, 0 red to 2 blue, that this invocation takes where light has all.
@if(dispersion) var<private> own_wavelength: u32;
// What a path's light was multiplied with before the path's first vertex.
@if(dispersion) var<private> carried_before: vec3f;
// The light that the ray carries whose hit is looked at; 0 where nobody asks for a wavelength.
@if(dispersion) var<private> carried: vec3f;

// Chooses the wavelength: consecutive numbers of one seed have all three in turn.
@if(dispersion)
fn begin_wavelengths(seed: u32, number: u32, before: vec3f) {
    own_wavelength = (hash1(seed) % 3u + number % 3u) % 3u;
    carried_before = before;
    carried = before;
}

// Says what light the next ray carries.
@if(dispersion)
fn carry(light: vec3f) {
    carried = carried_before * light;
}

@if(dispersion)
struct Refracted {
    wavelength: u32,
    // What its light counts; 0 for the others.
    share: vec3f,
}

// The wavelength that a surface refracts. Surfaces seen by nobody's light refract green.
@if(dispersion)
fn refracted_wavelength() -> Refracted {
    let there = vec3u(carried != vec3f(0.0));
    let count = there.x + there.y + there.z;
    if count == 0u { return Refracted(1u, vec3f(1.0)); }
    if count == 1u { return Refracted(there.y + 2u * there.z, vec3f(1.0)); }
    let own = vec3u(own_wavelength) == vec3u(0u, 1u, 2u);
    return Refracted(own_wavelength, select(vec3f(0.0), vec3f(3.0), own));
}
