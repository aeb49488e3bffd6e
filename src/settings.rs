//! What to render and how: the settings of a render, with their ranges.

pub mod technique;

use std::fmt;
use std::str::FromStr;

use crate::{Error, Result};
pub use technique::Technique;

/// Which lights a point asks, where direct light is a pass of its own; and by what paths choose one.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, serde::Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum LightSampling {
    /// All of them.
    All,
    /// A few, each as likely as the other.
    Uniform,
    /// A few, half by power and half alike.
    Power,
    /// A few of those that reach the point's zone, by what they send there: the paper's proposal for many lights.
    Zones,
}

impl LightSampling {
    /// All of them.
    pub const ALL: [LightSampling; 4] =
        [LightSampling::All, LightSampling::Uniform, LightSampling::Power, LightSampling::Zones];

    /// The name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            LightSampling::All => "all",
            LightSampling::Uniform => "uniform",
            LightSampling::Power => "power",
            LightSampling::Zones => "zones",
        }
    }
}

/// A group of channels of the image beside the picture itself.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, serde::Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Aov {
    /// `direct.R` ...: light seen directly, and light that comes straight from a light.
    Direct,
    /// `indirect.R` ...: the rest.
    Indirect,
    /// `albedo.R` ...: base colour.
    Albedo,
    /// `N.X` ...: shading normal, in world space.
    Normal,
    /// `P.X` ...: position, in world space.
    Position,
    /// `Z`: depth along the viewing direction, in world units.
    Depth,
    /// `variance.R` ...: variance of the pixel's mean.
    Variance,
    /// `shadow.<light>.class` (0 dark, 1 lit, 2 shadowed, 3 boundary, 4 unknown; of the first sample), `.visibility`
    /// (of the part of the light that is above the surface's horizon), `.ni`, `.ns`: what the photons say of each light.
    Shadow,
}

impl Aov {
    /// All groups.
    pub const ALL: [Aov; 8] =
        [Aov::Direct, Aov::Indirect, Aov::Albedo, Aov::Normal, Aov::Position, Aov::Depth, Aov::Variance, Aov::Shadow];

    /// The name on the command line, and the layer's in the EXR file.
    pub fn name(self) -> &'static str {
        match self {
            Aov::Direct => "direct",
            Aov::Indirect => "indirect",
            Aov::Albedo => "albedo",
            Aov::Normal => "N",
            Aov::Position => "P",
            Aov::Depth => "Z",
            Aov::Variance => "variance",
            Aov::Shadow => "shadow",
        }
    }
}

macro_rules! by_name {
    ($type:ty, $what:literal) => {
        impl fmt::Display for $type {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str(self.name())
            }
        }

        impl FromStr for $type {
            type Err = String;

            fn from_str(text: &str) -> std::result::Result<Self, String> {
                Self::ALL.into_iter().find(|v| v.name() == text).ok_or_else(|| {
                    let names: Vec<_> = Self::ALL.iter().map(|v| v.name()).collect();
                    format!(concat!("no ", $what, " is called '{}'; there is: {}"), text, names.join(", "))
                })
            }
        }
    };
}
by_name!(Aov, "AOV");
by_name!(LightSampling, "choice of lights");

/// The settings of a render.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct Settings {
    /// How light is computed.
    pub technique: Technique,
    /// Width in pixels, 1 to [`Settings::MAX_SIDE`].
    pub width: u32,
    /// Height in pixels, 1 to [`Settings::MAX_SIDE`].
    pub height: u32,
    /// Samples a pixel that the render is meant to have, at least 1. One sample goes through the pixel's middle.
    pub spp: u32,
    /// Seed of all random choices.
    pub seed: u32,
    /// Visibility photons emitted from each light.
    pub photons: u32,
    /// Photons that classify a point: k of the paper, 1 to [`Settings::MAX_NEAREST`].
    pub nearest: u32,
    /// Shadow photons that are kept of one ray, 1 to [`Settings::MAX_SHADOW_PHOTONS`].
    pub shadow_photons_per_ray: u32,
    /// Light points that are asked for by a boundary point, 1 to [`Settings::MAX_SHADOW_SAMPLES`].
    pub shadow_samples: u32,
    /// Pixels by which boundaries are widened, 0 or 1; none: 1 for lights with wide penumbrae, 0 for small ones.
    pub dilate: Option<u32>,
    /// Which lights points ask; none: `zones` of `shadow-photons` in scenes of more than [`Settings::MANY_LIGHTS`] lights, else `all`,
    /// and `power` of paths.
    pub light_sampling: Option<LightSampling>,
    /// Lights that a point asks where they are chosen, 2 to [`Settings::MAX_SAMPLED_LIGHTS`].
    pub sampled_lights: u32,
    /// Probability that a decided point is audited, 0 to 1. 0 is the paper, and biased; zones are then not audited either.
    pub audit: f32,
    /// Count photons without regard to their normals, as the paper does.
    pub paper_counting: bool,
    /// Cells along the longest side of the scene, of the techniques that judge cells: 1 to [`Settings::MAX_CELLS`].
    pub cells: u32,
    /// Rays from each cell to each light, of those techniques: 1 to [`Settings::MAX_CELL_RAYS`].
    pub cell_rays: u32,
    /// Share of a point's light below which the lights that are left are not tested, of `ward-adaptive`: 0 to 1. 0 tests
    /// all of them.
    pub shadow_tolerance: f32,
    /// Most bounces of indirect light; 0 for direct light alone. Gather rays that meet something too near go one bounce on: with
    /// irradiance records and two bounces a room has some 0.2 % of the light of a third.
    pub max_bounces: u32,
    /// Rays from all lights together, by their power, whose photons carry flux, 1 to [`Settings::MAX_PHOTONS`].
    pub flux_photons: u32,
    /// Interpolate irradiance between records; without, every point gathers along one ray.
    pub cache: bool,
    /// Radius of an irradiance record over the harmonic mean distance of its surroundings (a of Ward and Heckbert 1992):
    /// smaller is more accurate. More than 0, at most [`Settings::MAX_ACCURACY`].
    pub accuracy: f32,
    /// Rays of the final gather, about, at each irradiance record: 1 to [`Settings::MAX_GATHER_RAYS`].
    pub gather_rays: u32,
    /// Factor on the power of every light, at least 0.
    pub light_scale: f32,
    /// Channels beside the picture.
    pub aovs: Vec<Aov>,
}

impl Default for Settings {
    fn default() -> Self {
        Settings {
            technique: Technique::default(),
            width: 512,
            height: 512,
            spp: 16,
            seed: 0,
            photons: 131_072,
            // At 50 the sphere of the paper keeps 7.0 % of its shadow rays, at 36 5.8 %; the error of the box is the same.
            nearest: 36,
            shadow_photons_per_ray: 10,
            shadow_samples: 4,
            dilate: None,
            light_sampling: None,
            sampled_lights: 8,
            audit: 1.0 / 64.0,
            paper_counting: false,
            cells: 64,
            // Zimmerman and Shirley: up to 100.
            cell_rays: 100,
            // What the renderer that the method was made for has by default (Radiance, -dt).
            shadow_tolerance: 0.05,
            // Russian roulette ends paths long before; this bounds a path in a scene that absorbs nothing.
            max_bounces: 64,
            flux_photons: 65_536,
            cache: true,
            accuracy: 0.25,
            gather_rays: 256,
            light_scale: 1.0,
            aovs: Vec::new(),
        }
    }
}

impl Settings {
    /// Largest side of an image.
    pub const MAX_SIDE: u32 = 16_384;
    /// Samples a pixel that a render ended by time never reaches. A power of two keeps those of a pixel well stratified.
    pub const UNLIMITED_SPP: u32 = 1 << 24;
    /// Largest k: what a class word has room for.
    pub const MAX_NEAREST: u32 = 511;
    /// Most light points of a boundary point.
    pub const MAX_SHADOW_SAMPLES: u32 = 1024;
    /// Most shadow photons that are kept of one ray: what an invocation has registers for.
    pub const MAX_SHADOW_PHOTONS: u32 = 64;
    /// Most lights that all points ask by default. Of 16 small lamps a sample that asks eight takes half to a sixth of the time at
    /// the same error (docs/decisions.md, many lights).
    pub const MANY_LIGHTS: u32 = 16;
    /// Most lights that a point asks where they are chosen: as many as a zone lists.
    pub const MAX_SAMPLED_LIGHTS: u32 = 64;
    /// Most photons of a light: a map of so many fills a storage buffer of 128 MiB several times.
    pub const MAX_PHOTONS: u32 = 1 << 26;
    /// Most cells along a side: 2^24 in all.
    pub const MAX_CELLS: u32 = 256;
    /// Most rays of a cell and a light: they are counted in half a word.
    pub const MAX_CELL_RAYS: u32 = 4096;

    /// Largest radius of a record, in distances of its surroundings.
    pub const MAX_ACCURACY: f32 = 10.0;
    /// Most rays of a record: what one invocation can sum up on software devices.
    pub const MAX_GATHER_RAYS: u32 = 16_384;

    /// Checks every range.
    ///
    /// # Errors
    /// [`Error::Usage`] naming the setting and its range.
    pub fn check(&self) -> Result<()> {
        let range = |name: &str, value: u32, least: u32, most: u32| {
            if (least..=most).contains(&value) {
                return Ok(());
            }
            Err(Error::Usage(format!("{name} is {value}; it must be from {least} to {most}")))
        };
        range("--width", self.width, 1, Self::MAX_SIDE)?;
        range("--height", self.height, 1, Self::MAX_SIDE)?;
        range("--spp", self.spp, 1, u32::MAX)?;
        range("--photons", self.photons, 1, Self::MAX_PHOTONS)?;
        range("--flux-photons", self.flux_photons, 1, Self::MAX_PHOTONS)?;
        range("--gather-rays", self.gather_rays, 1, Self::MAX_GATHER_RAYS)?;
        if !(self.accuracy > 0.0 && self.accuracy <= Self::MAX_ACCURACY) {
            let most = Self::MAX_ACCURACY;
            return Err(Error::Usage(format!(
                "--accuracy is {}; it must be more than 0, at most {most}",
                self.accuracy
            )));
        }
        range("--nearest", self.nearest, 1, Self::MAX_NEAREST)?;
        range("--shadow-photons-per-ray", self.shadow_photons_per_ray, 1, Self::MAX_SHADOW_PHOTONS)?;
        range("--shadow-samples", self.shadow_samples, 1, Self::MAX_SHADOW_SAMPLES)?;
        range("--dilate", self.dilate.unwrap_or(0), 0, 1)?;
        range("--chosen-lights", self.sampled_lights, 2, Self::MAX_SAMPLED_LIGHTS)?;
        self.check_light_sampling()?;
        if !(0.0..=1.0).contains(&self.audit) {
            return Err(Error::Usage(format!("--audit is {}; it must be from 0 to 1", self.audit)));
        }
        range("--cells", self.cells, 1, Self::MAX_CELLS)?;
        range("--cell-rays", self.cell_rays, 1, Self::MAX_CELL_RAYS)?;
        if !(0.0..=1.0).contains(&self.shadow_tolerance) {
            let given = self.shadow_tolerance;
            return Err(Error::Usage(format!("--shadow-tolerance is {given}; it must be from 0 to 1")));
        }
        if !(self.light_scale >= 0.0 && self.light_scale.is_finite()) {
            return Err(Error::Usage(format!("--light-scale is {}; it must be 0 or more", self.light_scale)));
        }
        Ok(())
    }

    fn check_light_sampling(&self) -> Result<()> {
        let refuse = |why: String| Err(Error::Usage(why));
        match self.light_sampling {
            Some(LightSampling::Zones) if !self.technique.uses_zones() => {
                refuse(format!("--light-choice zones: {} asks no photons which lights reach a point", self.technique))
            }
            Some(LightSampling::All) if self.technique.is_path_tracing() => {
                refuse("--light-choice all: paths ask one light at each vertex".to_owned())
            }
            Some(LightSampling::Uniform | LightSampling::Power)
                if !self.technique.samples_lights() && !self.technique.is_path_tracing() =>
            {
                refuse(format!("--light-choice: {} asks all lights", self.technique))
            }
            Some(choice) if choice != LightSampling::All && self.aovs.contains(&Aov::Shadow) => {
                refuse(format!("--light-choice {choice}: the AOV shadow is of all lights"))
            }
            _ => Ok(()),
        }
    }
}
