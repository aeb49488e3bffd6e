//! The environment as `shaders/lib/environment.wgsl` reads it: a table by which directions are sampled, and the texels.
//!
//! A *patch* is the rectangle between the centres of four texels, over which radiance is interpolated. The cells of the
//! sampling table consist of whole patches, so that the probability is positive exactly where there is radiance. There
//! is one more row of patches than of texels: the first and the last row are half as high, from a pole to the centres
//! of the nearest texels.

use std::borrow::Cow;
use std::f64::consts::{PI, TAU};

use kernel_kit::{Gpu, Table, TableFormat};
use rayon::prelude::*;

use super::cumulative::{cumulative, texels_of};
use crate::Result;
use crate::kernels::scene_texels::ENVIRONMENT_HEADER;
use crate::scene::Panorama;
use crate::scene::mip::covered;

/// Maximum number of cells along the width, and along the height without one extra row: a table of 2 MiB, searched in
/// twenty steps.
const MAX_CELLS: [u32; 2] = [1024, 512];

/// Maximum number of texels on the device: 8192 x 4096, half a GiB.
const MAX_TEXELS: u64 = 1 << 25;

/// The panorama on the device.
pub struct GpuEnvironment {
    /// Header, rows of cells, cells, texels.
    pub(super) table: Table,
    /// The integral of radiance, mean of the three channels, over solid angle.
    pub(super) irradiance: f64,
    /// Bytes of the table.
    pub bytes: u64,
    /// The width and height to which the panorama was reduced, if the device has no room for all texels.
    pub reduced: Option<[u32; 2]>,
}

impl GpuEnvironment {
    /// Uploads a panorama, rotated by `turn` full rotations.
    ///
    /// # Errors
    /// As [`Gpu::table`].
    pub fn new(gpu: &Gpu, panorama: &Panorama, turn: f32, strength: f32) -> Result<GpuEnvironment> {
        // The maximum size of the sampling table, besides the texels.
        let others = u64::from(ENVIRONMENT_HEADER + (MAX_CELLS[0] / 4 + 1) * (MAX_CELLS[1] + 2));
        let fitting = fitting(panorama, MAX_TEXELS.min(gpu.max_table_records().saturating_sub(others)).max(1));
        let EnvironmentTexels { texels, irradiance } = EnvironmentTexels::new(&fitting, turn, strength);
        let reduced = matches!(fitting, Cow::Owned(_)).then_some([fitting.width, fitting.height]);
        let bytes = size_of_val(texels.as_slice()) as u64;
        let table = gpu.table("penumbra/scene/environment_texels", &texels, TableFormat::Float)?;
        Ok(GpuEnvironment { table, irradiance: irradiance * f64::from(strength), bytes, reduced })
    }
}

/// The panorama, or a smaller one of at most `max_texels` texels with the same means over solid angle.
fn fitting(panorama: &Panorama, max_texels: u64) -> Cow<'_, Panorama> {
    let [width, height] = [panorama.width, panorama.height].map(f64::from);
    let scale = (max_texels as f64 / (width * height)).sqrt();
    if scale >= 1.0 {
        return Cow::Borrowed(panorama);
    }
    let [columns, rows] = [width, height].map(|side| ((side * scale) as u32).max(1));
    let mut texels = vec![[0.0; 3]; columns as usize * rows as usize];
    texels.par_chunks_exact_mut(columns as usize).enumerate().for_each(|(row, texels)| {
        for (column, texel) in texels.iter_mut().enumerate() {
            let (mut sum, mut weight) = ([0.0; 3], 0.0);
            for (y, [top, bottom]) in covered(row, rows, panorama.height) {
                let across = (PI * top / height).cos() - (PI * bottom / height).cos();
                for (x, [left, right]) in covered(column, columns, panorama.width) {
                    let part = across * (right - left);
                    let from = panorama.texels[y * panorama.width as usize + x];
                    (0..3).for_each(|c| sum[c] += part * f64::from(from[c]));
                    weight += part;
                }
            }
            *texel = sum.map(|sum| (sum / weight) as f32);
        }
    });
    Cow::Owned(Panorama { width: columns, height: rows, texels })
}

struct EnvironmentTexels {
    texels: Vec<[f32; 4]>,
    irradiance: f64,
}

impl EnvironmentTexels {
    fn new(panorama: &Panorama, turn: f32, strength: f32) -> EnvironmentTexels {
        let Panorama { width, height, texels } = panorama;
        // Cells are squares of whole patches; the last of a row or column may be cut off.
        let step = width.div_ceil(MAX_CELLS[0]).max(height.div_ceil(MAX_CELLS[1]));
        let [columns, rows] = [width.div_ceil(step), (height + 1).div_ceil(step)];
        let brightness = |x: u32, y: u32| {
            let texel = texels[y as usize * *width as usize + (x % width) as usize];
            texel.iter().map(|radiance| f64::from(*radiance)).sum::<f64>() / 3.0
        };
        // Angle from the zenith at which a row of patches begins.
        let angle = |row: u32| ((f64::from(row) - 0.5) / f64::from(*height)).clamp(0.0, 1.0) * PI;
        let weigh = |row: u32| -> Vec<f64> {
            let mut weights = vec![0.0; columns as usize];
            for patch in row * step..((row + 1) * step).min(height + 1) {
                let (upper, lower) = (patch.max(1) - 1, patch.min(height - 1));
                let solid_angle = (angle(patch).cos() - angle(patch + 1).cos()) * TAU / f64::from(*width);
                for x in 0..*width {
                    let corners = [(x, upper), (x + 1, upper), (x, lower), (x + 1, lower)];
                    let mean = corners.map(|(x, y)| brightness(x, y)).iter().sum::<f64>() / 4.0;
                    weights[(x / step) as usize] += mean * solid_angle;
                }
            }
            weights
        };
        let weights: Vec<Vec<f64>> = (0..rows).into_par_iter().map(weigh).collect();
        let row_weights: Vec<f64> = weights.iter().map(|row| row.iter().sum()).collect();

        let mut table =
            vec![[*width as f32, *height as f32, step as f32, turn], [columns as f32, rows as f32, strength, 0.0]];
        for (row, cumulative) in (0..rows).zip(cumulative(&row_weights)) {
            let ends = [angle(row * step), angle(((row + 1) * step).min(height + 1))];
            // Heights below the nearer pole, from which they are precise: the zenith for rows above the horizon.
            let above = ends[0] + ends[1] <= PI;
            let [first, last] = ends.map(|end| match above {
                true => 2.0 * (end / 2.0).sin().powi(2),
                false => 2.0 * (end / 2.0).cos().powi(2),
            });
            // One over the solid angle of one column of patches. Its sign shows from which pole heights are measured.
            let density = f64::from(*width) / (TAU * (last - first).abs());
            let density = if above { density } else { -density };
            table.push([cumulative, first as f32, (last - first) as f32, density as f32]);
        }
        let cells: Vec<f32> = weights.iter().flat_map(|row| cumulative(row)).collect();
        table.extend(texels_of(&cells));
        table.extend(texels.iter().map(|[r, g, b]| [*r, *g, *b, 0.0]));
        EnvironmentTexels { texels: table, irradiance: row_weights.iter().sum() }
    }
}
