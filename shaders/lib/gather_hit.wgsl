// Hits of gather rays from which pass `path` continues, in addition to their points and surfaces (lib/point).

struct GatherHit {
    // Transmittance along the ray.
    transmittance: vec3f,
    // Radius of the path's footprint at the hit, and at a distance of 1 (lib/path_tracing).
    spread: f32,
    widest: f32,
    // Direction back along the ray (oct_encode16).
    view: u32,
    // Seed of the record, and the ray's index among the record's rays of all waves; `number` also has the bits
    // HIT_RESIDUAL and HIT_CAUSTIC_KNOWN.
    seed: u32,
    number: u32,
}

// Marks a ray whose look-up gave the diffuse part: its path adds only the rest, the reflection of a metal.
const HIT_RESIDUAL = 0x80000000u;
// Marks a ray whose look-up gave the light from focusing surfaces.
const HIT_CAUSTIC_KNOWN = 0x40000000u;
