// The inputs that the files of all lobes take from their surface. src/specialisation/lobes.rs lists the functions of
// such a file.

@if(glossy) import package::lib::bsdf::microfacet::LocalPair;
@if(glossy) import package::lib::ray::Hit;

// The surface at a hit, as far as it is known before its lobes are.
@if(glossy)
struct LobeContext {
    hit: Hit,
    // Whether the ray came from outside.
    front: bool,
    // Base colour times (1 - metallic).
    albedo: vec3f,
    // 1 - metallic.
    dielectric: f32,
    // Width of the microfacets' distribution.
    alpha: f32,
    shading_normal: vec3f,
    // The shading normal without any map.
    unmapped_normal: vec3f,
    // Unit vector towards the viewer.
    view: vec3f,
}

// Light and view at the layers of a surface.
@if(glossy)
struct LayerPair {
    // Both in the frame of the shading normal, with the width of the microfacets below.
    local: LocalPair,
    // Unit vectors in scene space.
    light: vec3f,
    view: vec3f,
}

// The probability of sampling a layer, and what it and everything below reflect straight back, summed over the three
// colours.
@if(glossy)
struct LayerChance {
    chance: f32,
    reflected: f32,
}
