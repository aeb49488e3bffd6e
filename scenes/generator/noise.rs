//! Smooth noise from an integer hash, the same on every machine.

use glam::{DVec3, IVec3};

/// Fractal noise of `octaves` octaves in about -1 to 1. Its largest features have a size of about 1.
pub fn fractal(p: DVec3, octaves: u32) -> f64 {
    (0..octaves).map(|octave| f64::from(1 << octave)).map(|frequency| value(p * frequency) / frequency).sum()
}

/// Value noise in -1 to 1: random values at integer coordinates with smooth interpolation.
fn value(p: DVec3) -> f64 {
    let cell = p.floor();
    let t = (p - cell).map(|x| x * x * (3.0 - 2.0 * x));
    let cell = cell.as_ivec3();
    let mut sum = 0.0;
    for corner in 0..8 {
        let offset = IVec3::new(corner & 1, corner >> 1 & 1, corner >> 2 & 1);
        let weight = DVec3::select(offset.cmpeq(IVec3::ONE), t, 1.0 - t).element_product();
        sum += weight * (f64::from(hash(cell + offset)) / f64::from(u32::MAX) * 2.0 - 1.0);
    }
    sum
}

/// The first component of the 3D PCG of Jarzynski and Olano (Hash Functions for GPU Rendering, JCGT 9(3), 2020).
pub fn hash(p: IVec3) -> u32 {
    let mut v = p.as_uvec3().map(|x| x.wrapping_mul(1664525).wrapping_add(1013904223));
    for round in 0..2 {
        v.x = v.x.wrapping_add(v.y.wrapping_mul(v.z));
        v.y = v.y.wrapping_add(v.z.wrapping_mul(v.x));
        v.z = v.z.wrapping_add(v.x.wrapping_mul(v.y));
        if round == 0 {
            v ^= v >> 16;
        }
    }
    v.x
}
