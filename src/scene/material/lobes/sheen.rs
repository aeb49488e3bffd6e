//! Sheen, the light that fibres reflect: KHR_materials_sheen, and the table that keeps it from making light.

use std::f64::consts::{PI, TAU};

use glam::Vec3;
use rayon::prelude::*;

use crate::Result;
use crate::scene::json::Json;
use crate::scene::material::lobe::{Layout, Lobe, LobeContext, ReadTexture};
use crate::scene::texture::{ColourSpace, TextureInfo};

/// KHR_materials_sheen.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Sheen {
    /// Colour, each 0 to 1. Black is no sheen.
    pub colour: Vec3,
    /// Roughness, 0 to 1.
    pub roughness: f32,
    /// Colour (sRGB).
    pub colour_texture: Option<TextureInfo>,
    /// Roughness in A.
    pub roughness_texture: Option<TextureInfo>,
}

impl Sheen {
    /// One of that colour and roughness, without textures.
    pub const fn new(colour: Vec3, roughness: f32) -> Sheen {
        Sheen { colour, roughness, colour_texture: None, roughness_texture: None }
    }

    /// Whether there are fibres.
    pub fn is_present(&self) -> bool {
        self.colour != Vec3::ZERO
    }
}

impl Lobe for Sheen {
    const EXTENSION: &'static str = "KHR_materials_sheen";
    const LAYOUT: Layout = Layout {
        texel: "SHEEN_TEXEL",
        texels: 1,
        mask: "SHEEN_TEXTURES",
        textures: &["SHEEN_COLOUR_TEXTURE", "SHEEN_ROUGHNESS_TEXTURE"],
        constants: &[("SHEEN_COLUMNS", COLUMNS), ("SHEEN_ROWS", ROWS)],
    };

    fn read(material: &Json, textures: &mut dyn ReadTexture) -> Result<Self> {
        let Some(json) = material.extension(Self::EXTENSION)? else { return Ok(Self::default()) };
        Ok(Sheen {
            colour: json.numbers_in::<3>("sheenColorFactor", 0.0, 0.0..=1.0)?.into(),
            roughness: json.number_in("sheenRoughnessFactor", 0.0, 0.0..=1.0)?,
            colour_texture: textures.texture(&json, "sheenColorTexture", ColourSpace::Srgb)?,
            roughness_texture: textures.texture(&json, "sheenRoughnessTexture", ColourSpace::Linear)?,
        })
    }

    fn textures(&self) -> Vec<&Option<TextureInfo>> {
        vec![&self.colour_texture, &self.roughness_texture]
    }

    fn without_textures(self) -> Self {
        Sheen { colour_texture: None, roughness_texture: None, ..self }
    }

    fn texels(&self, _: &LobeContext) -> Vec<[f32; 4]> {
        vec![self.colour.extend(self.roughness).to_array()]
    }

    fn reflects(&self) -> bool {
        self.is_present()
    }
}

/// Cells along the cubic root of the cosine, and along the logarithm of the roughness. With so many, interpolation is
/// too low by 0.14 % at most.
const COLUMNS: u32 = 63;
const ROWS: u32 = 31;

/// Minimum roughness, also that of three.js and Filament. Smoother fibres would reflect at grazing angles alone, and
/// more than 2.7 times the light that they receive.
pub(crate) const MIN_ROUGHNESS: f64 = 0.07;

/// Minimum cosine of a view to the fibres, as in the kernels, which divide the albedo by it.
const MIN_COSINE: f64 = 1e-4;

/// Factor on the entries of the table. Interpolation can be too low by 0.14 %, and this error must not create light.
const RAISED: f64 = 1.0015;

/// Points of the quadrature along each of its two axes. Twice as many change no entry by 1e-4.
const POINTS: usize = 48;

/// The albedos from which kernels interpolate: for each cell the entries at its corners, by rows. An entry is the
/// binary logarithm of the directional albedo times 4 cosine (1 + lambda), which is smoother than the albedo.
pub(crate) fn albedos() -> Vec<[f32; 4]> {
    let columns = COLUMNS as usize + 1;
    let entry = |i: usize| {
        let cosine = ((i % columns) as f64 / f64::from(COLUMNS)).powi(3);
        let roughness = MIN_ROUGHNESS.powf((i / columns) as f64 / f64::from(ROWS));
        (scaled_albedo(cosine.max(MIN_COSINE), roughness.powi(2)) * RAISED).log2() as f32
    };
    let entries: Vec<f32> = (0..columns * (ROWS as usize + 1)).into_par_iter().map(entry).collect();
    let corners = |cell: usize| {
        let first = cell / COLUMNS as usize * columns + cell % COLUMNS as usize;
        [entries[first], entries[first + 1], entries[first + columns], entries[first + columns + 1]]
    };
    (0..(COLUMNS * ROWS) as usize).map(corners).collect()
}

/// The directional albedo, over its factors of the view alone: the integral of D (1 + lambda_v) / (1 + lambda_v +
/// lambda_l) over the directions l of light. It is integrated by midpoints, over the azimuth and over the cubic root of
/// l's height, because most of the light is scattered near grazing angles.
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
        ring * own / (own + lambda(height.max(MIN_COSINE), alpha)) * 3.0 * t * t
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
