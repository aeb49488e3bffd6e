// The wavelength that a surface refracts, for all sets of wavelengths that a ray has and that the surface lets pass.

import package::kit::group_index;
import package::lib::wavelength::{begin_wavelengths, refracted_wavelength};

override count: u32;

// The factor of each wavelength, and the number of the refracted one.
@group(0) @binding(0) var<storage, read_write> refracted: array<vec4f>;

fn wavelengths_of(bits: u32) -> vec3f {
    return vec3f(vec3u(bits & 1u, (bits >> 1u) & 1u, (bits >> 2u) & 1u));
}

@compute @workgroup_size(64)
fn refract_all(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = group_index(group, groups) * 64u + lane;
    if i >= count { return; }
    let sets = i % 64u;
    // A seed for all, so that consecutive numbers take the wavelengths in turn.
    begin_wavelengths(5u, i / 64u, wavelengths_of(sets & 7u));
    let found = refracted_wavelength(wavelengths_of(sets >> 3u));
    refracted[i] = vec4f(found.share, f32(found.wavelength));
}
