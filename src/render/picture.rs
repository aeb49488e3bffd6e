//! The channels of an image from sums of samples, whether the samples are those of a render or of merged pieces.

use glam::{DVec3, DVec4};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::film::Channel;
use crate::Result;
use crate::passes::film::{Sum, variance_of_mean};
use crate::scene::Normalisation;
use crate::settings::{Aov, Background};

/// Depth of rays that leave the scene: Blender's value, because some EXR readers fail on infinities.
const NO_DEPTH: f64 = 1e10;

/// A quantity whose samples the film sums.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub(super) enum Quantity {
    /// Direct light; w is the share of rays that hit a surface or the environment.
    Direct,
    Indirect,
    /// Squares of the whole light.
    Squares,
    Albedo,
    Normal,
    /// Position; w is the depth.
    Position,
    /// Squares of direct and of indirect light. Only denoisers need these and those that follow.
    DirectSquares,
    IndirectSquares,
    GuideAlbedo,
    GuideNormal,
    GuidePosition,
}

impl Quantity {
    pub const ALL: [Quantity; 11] = [
        Quantity::Direct,
        Quantity::Indirect,
        Quantity::Squares,
        Quantity::Albedo,
        Quantity::Normal,
        Quantity::Position,
        Quantity::DirectSquares,
        Quantity::IndirectSquares,
        Quantity::GuideAlbedo,
        Quantity::GuideNormal,
        Quantity::GuidePosition,
    ];

    /// The name in the files of pieces.
    pub fn name(self) -> &'static str {
        match self {
            Quantity::Direct => "direct",
            Quantity::Indirect => "indirect",
            Quantity::Squares => "squares",
            Quantity::Albedo => "albedo",
            Quantity::Normal => "normal",
            Quantity::Position => "position",
            Quantity::DirectSquares => "direct-squares",
            Quantity::IndirectSquares => "indirect-squares",
            Quantity::GuideAlbedo => "guide-albedo",
            Quantity::GuideNormal => "guide-normal",
            Quantity::GuidePosition => "guide-position",
        }
    }
}

/// The sums of the samples of an image.
pub(super) trait Sums {
    /// The sums of each pixel; `None` if the quantity was not requested.
    fn sums(&self, quantity: Quantity) -> Result<Option<Vec<Sum>>>;

    /// The sums of the first half of each pixel's samples (`tiles::first_half`), of direct or indirect light; `None` if
    /// they were not kept.
    fn first_halves(&self, quantity: Quantity) -> Result<Option<Vec<Sum>>>;

    /// Whether the camera has a lens, which spreads the rays of a pixel beyond the pixel.
    fn has_lens(&self) -> bool;

    /// The number of samples of a pixel.
    fn samples_of(&self, pixel: usize) -> u32;

    /// The relMSE of each pixel due to errors that all its samples share. Only that of gather rays is estimated; `None`
    /// before it is.
    fn shared_errors(&self) -> Option<&[f32]>;

    /// Adds the channels of the AOV `shadow`.
    fn push_class_channels(&self, channels: &mut Vec<Channel>) -> Result<()>;
}

/// How sums are shown.
pub(super) struct Picture<'a> {
    pub aovs: &'a [Aov],
    pub background: Background,
    pub normalisation: &'a Normalisation,
}

impl Picture<'_> {
    /// The channels of the image.
    pub fn channels(&self, sums: &dyn Sums) -> Result<Vec<Channel>> {
        let direct_sums = sums.sums(Quantity::Direct)?.unwrap_or_default();
        let direct: Vec<DVec4> = direct_sums.par_iter().map(Sum::mean).collect();
        let indirect = means(sums, Quantity::Indirect)?;
        let with = |(d, i): (&DVec4, &DVec4)| (d.truncate() + i.truncate()).extend(d.w);
        let total: Vec<DVec4> = match &indirect {
            Some(indirect) => direct.iter().zip(indirect).map(with).collect(),
            None => direct.clone(),
        };
        let indirect = indirect.unwrap_or_else(|| vec![DVec4::ZERO; direct.len()]);
        let mut channels = Vec::new();
        let background = colour_of(self.background);
        let over = |(v, sum): (&DVec4, &Sum)| match background {
            Some(colour) if sum.kept > 0.0 => (v.truncate() + behind(colour, sum)).extend(1.0),
            _ => *v,
        };
        let shown: Vec<DVec4> = total.iter().zip(&direct_sums).map(over).collect();
        push(&mut channels, ["R", "G", "B"], &shown);
        channels.push(Channel { name: "A".into(), samples: shown.iter().map(|v| v.w as f32).collect() });
        let positioned = self.aovs.iter().any(|aov| matches!(aov, Aov::Position | Aov::Depth));
        let shares = if positioned { surface_shares(sums, &total)? } else { Vec::new() };
        for aov in self.aovs {
            match aov {
                Aov::Direct => push(&mut channels, ["direct.R", "direct.G", "direct.B"], &direct),
                Aov::Indirect => push(&mut channels, ["indirect.R", "indirect.G", "indirect.B"], &indirect),
                Aov::Albedo => {
                    let albedo = means(sums, Quantity::Albedo)?.unwrap_or_default();
                    push(&mut channels, ["albedo.R", "albedo.G", "albedo.B"], &albedo);
                }
                Aov::Normal => push(&mut channels, ["N.X", "N.Y", "N.Z"], &normals(sums)?),
                Aov::Position => push(&mut channels, ["P.X", "P.Y", "P.Z"], &self.positions(sums, &shares)?),
                Aov::Depth => channels.push(Channel { name: "Z".into(), samples: self.depths(sums, &shares)? }),
                Aov::Variance => {
                    let variances = variances(sums, &total, &direct_sums, background)?;
                    push(&mut channels, ["variance.R", "variance.G", "variance.B"], &variances);
                }
                Aov::Samples => {
                    let samples = (0..total.len()).map(|pixel| sums.samples_of(pixel) as f32).collect();
                    channels.push(Channel { name: "samples".into(), samples });
                }
                Aov::Shadow => sums.push_class_channels(&mut channels)?,
            }
        }
        Ok(channels)
    }

    /// Positions in world space, by the share of each pixel's rays that hit a surface.
    fn positions(&self, sums: &dyn Sums, shares: &[f64]) -> Result<Vec<DVec4>> {
        let mut positions = means(sums, Quantity::Position)?.unwrap_or_default();
        for (p, share) in positions.iter_mut().zip(shares) {
            let normalised = if *share > 0.0 { p.truncate() / *share } else { DVec3::ZERO };
            let world = if *share > 0.0 { self.normalisation.undo_f64(normalised) } else { DVec3::ZERO };
            *p = world.extend(0.0);
        }
        Ok(positions)
    }

    /// Depth in world units; `shares` as for [`Picture::positions`].
    fn depths(&self, sums: &dyn Sums, shares: &[f64]) -> Result<Vec<f32>> {
        let positions = means(sums, Quantity::Position)?.unwrap_or_default();
        let scale = self.normalisation.scale();
        let depth = |(p, share): (&DVec4, &f64)| (if *share > 0.0 { p.w / share / scale } else { NO_DEPTH }) as f32;
        Ok(positions.iter().zip(shares).map(depth).collect())
    }
}

/// The colour behind the scene, if one takes the place of what the camera sees there.
pub(super) fn colour_of(background: Background) -> Option<DVec3> {
    match background {
        Background::Colour(colour) => Some(colour.map(f64::from).into()),
        Background::Environment | Background::Transparent => None,
    }
}

pub(super) fn means(sums: &dyn Sums, quantity: Quantity) -> Result<Option<Vec<DVec4>>> {
    Ok(sums.sums(quantity)?.map(|sums| sums.par_iter().map(Sum::mean).collect()))
}

fn normals(sums: &dyn Sums) -> Result<Vec<DVec4>> {
    let mut normals = means(sums, Quantity::Normal)?.unwrap_or_default();
    normals.iter_mut().for_each(|n| *n = n.truncate().normalize_or_zero().extend(0.0));
    Ok(normals)
}

/// The share of each pixel's rays that hit a surface. If the camera sees no environment, it is w of `total`; otherwise
/// it is w of the sums of albedo, which are then always present.
fn surface_shares(sums: &dyn Sums, total: &[DVec4]) -> Result<Vec<f64>> {
    let albedo = means(sums, Quantity::Albedo)?;
    Ok(albedo.as_deref().unwrap_or(total).iter().map(|mean| mean.w).collect())
}

/// The part of a background's colour that is seen in a pixel with this sum of direct light, whose w counts the rays
/// that meet the scene. It is 0 in a pixel without samples, of which nothing is known.
pub(super) fn behind(colour: DVec3, direct: &Sum) -> DVec3 {
    if direct.kept > 0.0 { colour * (1.0 - direct.mean().w) } else { DVec3::ZERO }
}

/// See [`variance_of_mean`]. A ray that meets nothing brings the background's colour and no light.
fn variances(sums: &dyn Sums, total: &[DVec4], direct: &[Sum], background: Option<DVec3>) -> Result<Vec<DVec4>> {
    let squares = sums.sums(Quantity::Squares)?.unwrap_or_default();
    let colour = background.unwrap_or_default();
    let variance = |(square, (mean, direct)): (&Sum, (&DVec4, &Sum))| {
        let [more, more_squared] = [colour, colour * colour].map(|colour| behind(colour, direct).extend(0.0));
        variance_of_mean(*mean + more, square.mean() + more_squared, square.kept)
    };
    Ok(squares.iter().zip(total.iter().zip(direct)).map(variance).collect())
}

fn push(channels: &mut Vec<Channel>, names: [&str; 3], values: &[DVec4]) {
    for (axis, name) in names.into_iter().enumerate() {
        channels.push(Channel { name: name.to_owned(), samples: values.iter().map(|v| v[axis] as f32).collect() });
    }
}
