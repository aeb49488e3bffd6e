//! What fibres reflect in all directions, as `shaders/lib/bsdf.wgsl` needs it to keep glTF's sheen from making light.

use std::f64::consts::{PI, TAU};

use rayon::prelude::*;

use crate::Result;
use crate::gpu::{Buffer, Gpu};

/// Cells along the cubic root of the cosine, and along the logarithm of the roughness.
pub(crate) const COLUMNS: u32 = 63;
pub(crate) const ROWS: u32 = 31;

/// Less rough fibres would reflect at grazing angles only, more than 2.7 times what they get: the least roughness of
/// three.js and Filament as well.
pub(crate) const LEAST_ROUGHNESS: f64 = 0.07;

/// Least cosine that fibres are seen at: that of a view in the kernels.
const LEAST_COSINE: f64 = 1e-4;

/// What the table is raised by: interpolation falls short by 0.14 % at most, and light must not come of it.
const RAISED: f64 = 1.0015;

/// Points of the quadrature each way. Twice as many change no entry by 1e-4.
const POINTS: usize = 48;

/// The uniform buffer `sheen_albedos`: of each cell the entries at its corners, by rows. An entry is the binary logarithm of
/// the directional albedo times 4 cosine (1 + lambda), which is smoother than the albedo.
///
/// # Errors
/// As [`Gpu::upload`].
pub fn upload(gpu: &Gpu) -> Result<Buffer> {
    let columns = COLUMNS as usize + 1;
    let entry = |i: usize| {
        let cosine = ((i % columns) as f64 / f64::from(COLUMNS)).powi(3);
        let roughness = LEAST_ROUGHNESS.powf((i / columns) as f64 / f64::from(ROWS));
        (scaled_albedo(cosine.max(LEAST_COSINE), roughness.powi(2)) * RAISED).log2() as f32
    };
    let entries: Vec<f32> = (0..columns * (ROWS as usize + 1)).into_par_iter().map(entry).collect();
    let corners = |cell: usize| {
        let first = cell / COLUMNS as usize * columns + cell % COLUMNS as usize;
        [entries[first], entries[first + 1], entries[first + columns], entries[first + columns + 1]]
    };
    let cells: Vec<[f32; 4]> = (0..(COLUMNS * ROWS) as usize).map(corners).collect();
    gpu.upload("penumbra/scene/sheen_albedos", &cells)
}

/// The directional albedo, over its factors of the view alone: the integral of D (1 + lambda_v) / (1 + lambda_v + lambda_l) over
/// the directions l of light. By midpoints: of the cubic root of l's height, as most happens low down, and of the azimuth.
fn scaled_albedo(cosine: f64, alpha: f64) -> f64 {
    let middle = |i: usize| (i as f64 + 0.5) / POINTS as f64;
    let sine = (1.0 - cosine * cosine).sqrt();
    let own = 1.0 + lambda(cosine, alpha);
    let rings = (0..POINTS).map(|i| {
        let t = middle(i);
        let height = t.powi(3);
        let across = sine * (1.0 - height * height).sqrt();
        let facing = |azimuth: f64| {
            let half = (cosine + height).powi(2) / (2.0 + 2.0 * (cosine * height + across * (azimuth * PI).cos()));
            distribution((1.0 - half).max(0.0), alpha)
        };
        let ring = (0..POINTS).map(|j| facing(middle(j))).sum::<f64>() / POINTS as f64;
        ring * own / (own + lambda(height.max(LEAST_COSINE), alpha)) * 3.0 * t * t
    });
    rings.sum::<f64>() / POINTS as f64 * TAU
}

/// Distribution of half vectors whose squared sine to the normal is given (Estevez and Kulla 2017, equation 2).
fn distribution(sine_squared: f64, alpha: f64) -> f64 {
    (2.0 + 1.0 / alpha) * sine_squared.powf(0.5 / alpha) / TAU
}

/// Masking: lambda of Estevez and Kulla 2017, equation 3, as KHR_materials_sheen has it.
fn lambda(cosine: f64, alpha: f64) -> f64 {
    let part = (1.0 - alpha).powi(2);
    let mix = |rough: f64, smooth: f64| rough + (smooth - rough) * part;
    let l = |x: f64| {
        mix(21.5473, 25.3245) / (1.0 + mix(3.82987, 3.32435) * x.powf(mix(0.19823, 0.16801)))
            + mix(-1.97760, -1.27393) * x
            + mix(-4.32054, -4.85967)
    };
    if cosine < 0.5 { l(cosine).exp() } else { (2.0 * l(0.5) - l(1.0 - cosine)).exp() }
}
