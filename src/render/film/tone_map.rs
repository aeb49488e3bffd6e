//! Tone mapping: from scene-linear colour to display values.

use std::fmt;
use std::str::FromStr;

use crate::Error;

/// The transform from scene-linear Rec.709 colour to sRGB pixels.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum View {
    /// Khronos PBR Neutral (the Khronos Group's specification, 2024): base colours stay as they are.
    #[default]
    Neutral,
    /// AgX (Sobotka) with the Rec.2020 matrices of Blender's configuration and the polynomial of degree 6 that Wrensch
    /// fitted to its base contrast ("Minimal AgX Implementation"), as Filament and three.js have them.
    Agx,
    /// The sRGB transfer function, clipped.
    Standard,
    /// Linear values, clipped, without any transfer function.
    Raw,
}

impl View {
    /// All views.
    pub const ALL: [View; 4] = [View::Neutral, View::Agx, View::Standard, View::Raw];

    /// The coded display values in 0 to 1 for the scene-linear Rec.709 `colour`. Negative and NaN components count as
    /// 0.
    pub fn apply(self, colour: [f32; 3]) -> [f32; 3] {
        // Differences or quotients of infinities would be NaN.
        let colour = colour.map(|x| if x > 0.0 { x.min(f32::MAX) } else { 0.0 });
        match self {
            View::Neutral => neutral(colour).map(srgb_from_linear),
            View::Agx => agx(colour).map(srgb_from_linear),
            View::Standard => colour.map(srgb_from_linear),
            View::Raw => colour.map(|x| x.min(1.0)),
        }
    }
}

impl fmt::Display for View {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.write_str(match self {
            View::Neutral => "neutral",
            View::Agx => "agx",
            View::Standard => "standard",
            View::Raw => "raw",
        })
    }
}

impl FromStr for View {
    type Err = Error;

    fn from_str(name: &str) -> Result<Self, Error> {
        let view = View::ALL.into_iter().find(|view| view.to_string() == name);
        view.ok_or_else(|| Error::Usage(format!("no view is called '{name}'; available: neutral, agx, standard, raw")))
    }
}

/// The sRGB transfer function (IEC 61966-2-1), with `x` clipped to 0 to 1.
pub(super) fn srgb_from_linear(x: f32) -> f32 {
    let x = x.clamp(0.0, 1.0);
    if x <= 0.003_130_8 { 12.92 * x } else { 1.055 * x.powf(1.0 / 2.4) - 0.055 }
}

/// Khronos PBR Neutral, with the names and constants of its specification.
fn neutral(colour: [f32; 3]) -> [f32; 3] {
    const F90: f32 = 0.04;
    const START_COMPRESSION: f32 = 0.8 - F90;
    const DESATURATION: f32 = 0.15;

    let x = colour[0].min(colour[1]).min(colour[2]);
    let offset = if x < 2.0 * F90 { x - x * x / (4.0 * F90) } else { F90 };
    let colour = colour.map(|c| c - offset);

    let peak = colour[0].max(colour[1]).max(colour[2]);
    if peak < START_COMPRESSION {
        return colour;
    }
    const D: f32 = 1.0 - START_COMPRESSION;
    let new_peak = 1.0 - D * D / (peak + D - START_COMPRESSION);
    let g = 1.0 - 1.0 / (DESATURATION * (peak - new_peak) + 1.0);
    colour.map(|c| c * (new_peak / peak) * (1.0 - g) + new_peak * g)
}

/// AgX's base look, display-linear, with the matrices and the range of Blender and Filament, and with Wrensch's
/// polynomial for the curve (2023, "Minimal AgX Implementation").
fn agx(colour: [f32; 3]) -> [f32; 3] {
    // Matrices for column vectors, as rows. Rec.709 to Rec.2020 and back are from ITU-R BT.2087.
    const REC2020_FROM_REC709: Matrix = [[0.6274, 0.3293, 0.0433], [0.0691, 0.9195, 0.0113], [0.0164, 0.0880, 0.8956]];
    const REC709_FROM_REC2020: Matrix =
        [[1.6605, -0.5876, -0.0728], [-0.1246, 1.1329, -0.0083], [-0.0182, -0.1006, 1.1187]];
    const INSET: Matrix = [
        [0.856_627_17, 0.095_121_24, 0.048_251_607],
        [0.137_318_97, 0.761_242, 0.101_439_04],
        [0.111_898_21, 0.076_799_42, 0.811_302_4],
    ];
    const OUTSET: Matrix = [
        [1.127_100_6, -0.110_606_64, -0.016_493_939],
        [-0.141_329_76, 1.157_823_7, -0.016_493_939],
        [-0.141_329_76, -0.110_606_64, 1.251_936_4],
    ];
    // The range of the curve: 10 stops below to 6.5 stops above middle grey (0.18).
    const MIN_EV: f32 = -12.473_93;
    const MAX_EV: f32 = 4.026_069;

    let coded = multiply(&INSET, multiply(&REC2020_FROM_REC709, colour)).map(|x| {
        let x = ((x.log2() - MIN_EV) / (MAX_EV - MIN_EV)).clamp(0.0, 1.0);
        [-0.00232, 0.1191, 0.4298, -6.868, 31.96, -40.14, 15.5].iter().rev().fold(0.0, |sum, factor| sum * x + factor)
    });
    let display = multiply(&OUTSET, coded).map(|x| x.max(0.0).powf(2.2));
    multiply(&REC709_FROM_REC2020, display)
}

type Matrix = [[f32; 3]; 3];

fn multiply(matrix: &Matrix, v: [f32; 3]) -> [f32; 3] {
    matrix.map(|row| row[0] * v[0] + row[1] * v[1] + row[2] * v[2])
}
