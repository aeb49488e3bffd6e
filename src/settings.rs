//! What to render and how: the settings of a render, with their ranges.

mod builder;
mod groups;
pub(crate) mod stages;
pub mod technique;
mod unused;
pub(crate) mod values;

use std::fmt;
use std::str::FromStr;

use crate::{Error, Result};

/// Default numbers of visibility photons per light, without and with fine cells. With fine cells, photons only have to
/// classify large pieces of surface, until the shadow rays of earlier samples do. In sphere, box and crowd of scenes/,
/// 8,192 to 131,072 photons gave the same error at 16 and 64 samples; after 64 samples, 8,192 photons needed 20 % more
/// rays in the sphere and 3 % more in the box. Where photons alone decide, 63,000 save 88 % of the shadow rays of the
/// box, and a million save 89 % (docs/experiments.md, "Against the number of photons").
const MAP_PHOTONS: u32 = 131_072;
const LEARNING_PHOTONS: u32 = 16_384;

/// One photon is emitted for this many shadow rays to the light. A photon, with its share of the grid, costs as much as
/// ten to twenty shadow rays, so photons take at most a third of the time of the rays that they may
/// save. At 256 x 256 pixels and one sample, 4,096 photons instead of 131,072 shortened the renders of box, crowd and
/// sphere from between 0.25 and 0.52 s to between 0.09 and 0.15 s.
const RAYS_PER_PHOTON: u64 = 64;
/// Minimum of the default number: fewer photons take no less time.
const MIN_PHOTONS: u32 = 4096;

/// Maximum number of visibility photons that all lights together emit. If their rays hit two surfaces on average, what
/// they store fills the smallest storage binding that devices offer (128 MiB, eight million photons).
const MAX_MAP_PHOTONS: u32 = 1 << 22;

/// Default numbers of photons of the global map and of gather rays per record. Renders have from a sixteenth to sixteen
/// times as many. In the box, the error of 256 rays is a 39th of that of 16 (docs/experiments.md, "Waves of gather
/// rays"), and 65,536 photons give 0.995 of the indirect light, a quarter of them 0.990, and 16 times as many 0.998
/// ("Discs of photons").
const FLUX_PHOTONS: u32 = 65_536;
const GATHER_RAYS: u32 = 256;

pub use builder::SettingsBuilder;
pub use groups::{
    Background, CellSettings, Crop, ImageSettings, IndirectSettings, IrradianceCacheSettings, LightBufferSettings,
    LightSamplingSettings, SampleRange, ShadowRaySettings, VisibilityMapSettings, WardSettings,
};
pub use technique::Technique;
use technique::{Requirements, Transport, Visibility};

/// How lights are sampled: which lights a point uses if direct light is a separate pass, and with which probabilities a
/// path samples one.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, serde::Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum LightSampling {
    /// All lights.
    All,
    /// A few lights, with equal probability.
    Uniform,
    /// A few lights: with probability 1/2 by power, else with equal probability.
    Power,
    /// A few lights, by the light that each would send to the point if nothing were in between (Shirley, Wang and
    /// Zimmerman 1996).
    Contribution,
    /// A few of the lights that reach the point's zone, in proportion to the light that they send there: the paper's
    /// proposal for many lights.
    Zones,
}

impl LightSampling {
    /// All strategies.
    pub const ALL: [LightSampling; 5] = [
        LightSampling::All,
        LightSampling::Uniform,
        LightSampling::Power,
        LightSampling::Contribution,
        LightSampling::Zones,
    ];

    /// The name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            LightSampling::All => "all",
            LightSampling::Uniform => "uniform",
            LightSampling::Power => "power",
            LightSampling::Contribution => "contribution",
            LightSampling::Zones => "zones",
        }
    }
}

/// A group of channels of the image in addition to the picture itself.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, serde::Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Aov {
    /// `direct.R` ...: emitted light that the camera sees, and light that comes straight from a light to the surface.
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
    /// `samples`: number of samples of the pixel.
    Samples,
    /// `shadow.<light>.class` (0 dark, 1 lit, 2 shadowed, 3 boundary, 4 unknown; of the first sample), `.visibility`
    /// (of the part of the light above the surface's horizon), `.ni` and `.ns` (illumination and shadow photons among
    /// the nearest), for each light.
    Shadow,
}

impl Aov {
    /// All groups.
    pub const ALL: [Aov; 9] = [
        Aov::Direct,
        Aov::Indirect,
        Aov::Albedo,
        Aov::Normal,
        Aov::Position,
        Aov::Depth,
        Aov::Variance,
        Aov::Samples,
        Aov::Shadow,
    ];

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
            Aov::Samples => "samples",
            Aov::Shadow => "shadow",
        }
    }
}

/// What removes noise from an image.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, serde::Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Denoise {
    /// The mixture of the raw image and of the results of all available denoisers: in each region the one with the
    /// smallest estimated error.
    Auto,
    /// Nothing.
    #[default]
    None,
    /// The statistical denoiser alone, which needs no library.
    Statistical,
    /// Intel's Open Image Denoise 2 alone.
    Oidn,
}

impl Denoise {
    /// All choices.
    pub const ALL: [Denoise; 4] = [Denoise::Auto, Denoise::None, Denoise::Statistical, Denoise::Oidn];

    /// Whether it uses Open Image Denoise, for [`Denoise::Auto`] where it is found.
    pub fn uses_oidn(self) -> bool {
        matches!(self, Denoise::Auto | Denoise::Oidn)
    }

    /// The name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Denoise::Auto => "auto",
            Denoise::None => "none",
            Denoise::Statistical => "statistical",
            Denoise::Oidn => "oidn",
        }
    }
}

/// Which pixels get how many samples.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, serde::Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Sampling {
    /// All pixels get the same number.
    #[default]
    Uniform,
    /// Pixels with noise around them get up to eight times as many, those without up to half as many. The mean is the
    /// same.
    Adaptive,
}

impl Sampling {
    /// All choices.
    pub const ALL: [Sampling; 2] = [Sampling::Uniform, Sampling::Adaptive];

    /// The name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Sampling::Uniform => "uniform",
            Sampling::Adaptive => "adaptive",
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
                    format!(concat!("no ", $what, " is called '{}'; available: {}"), text, names.join(", "))
                })
            }
        }
    };
}
by_name!(Aov, "AOV");
by_name!(Denoise, "denoiser");
by_name!(LightSampling, "light sampling");
by_name!(Sampling, "sampling");

/// The settings of a render, in groups. [`Settings::builder`] sets single ones and checks their ranges.
///
/// As JSON the groups are one flat object, with the keys of `docs/statistics.md`.
///
/// ```
/// use penumbra::{Settings, Technique};
///
/// let settings = Settings::builder().technique(Technique::PATH).size(256, 256).spp(16).build()?;
/// let brighter = settings.clone().with(|s| s.light_scale = 2.0);
/// assert_eq!(brighter.image, settings.image);
/// # Ok::<(), penumbra::Error>(())
/// ```
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
#[non_exhaustive]
pub struct Settings {
    /// How light is computed.
    pub technique: Technique,
    /// Size, samples and channels of the image.
    #[serde(flatten)]
    pub image: ImageSettings,
    /// Illumination and shadow photons.
    #[serde(flatten)]
    pub visibility_map: VisibilityMapSettings,
    /// Shadow rays of boundary points.
    #[serde(flatten)]
    pub shadow_rays: ShadowRaySettings,
    /// Sampling of many lights.
    #[serde(flatten)]
    pub light_sampling: LightSamplingSettings,
    /// Indirect light: global map and irradiance cache.
    #[serde(flatten)]
    pub indirect: IndirectSettings,
    /// Grid of `visibility-cells` and `voxel-tags`.
    #[serde(flatten)]
    pub cells: CellSettings,
    /// `light-buffer`.
    #[serde(flatten)]
    pub light_buffer: LightBufferSettings,
    /// `ward-adaptive`.
    #[serde(flatten)]
    pub ward: WardSettings,
    /// Factor on the power of every light, at least 0.
    pub light_scale: f32,
}

impl Default for Settings {
    fn default() -> Self {
        Settings {
            technique: Technique::default(),
            image: ImageSettings::default(),
            visibility_map: VisibilityMapSettings::default(),
            shadow_rays: ShadowRaySettings::default(),
            light_sampling: LightSamplingSettings::default(),
            indirect: IndirectSettings::default(),
            cells: CellSettings::default(),
            light_buffer: LightBufferSettings::default(),
            ward: WardSettings::default(),
            light_scale: 1.0,
        }
    }
}

impl Settings {
    /// A builder that starts from the defaults.
    pub fn builder() -> SettingsBuilder {
        SettingsBuilder::default()
    }

    /// These settings after `change`. The ranges are not checked before [`Settings::check`].
    #[must_use]
    pub fn with(mut self, change: impl FnOnce(&mut Settings)) -> Settings {
        change(&mut self);
        self
    }

    /// Whether the image converges to the true one as samples are added. Indirect light converges only as far as
    /// photons and irradiance records allow; their number grows with the samples.
    pub fn is_unbiased(&self) -> bool {
        let Requirements { transport, visibility, .. } = self.technique.requirements();
        let has_true_visibility = match visibility {
            Visibility::ShadowRays | Visibility::LightBuffer => true,
            Visibility::Photons => self.visibility_map.audit > 0.0,
            Visibility::Adaptive => self.ward.tolerance == 0.0,
            Visibility::PhotonsAlone | Visibility::Cells | Visibility::Voxels => false,
        };
        let is_unbiased = match transport {
            Transport::Paths => true,
            Transport::TwoPass => has_true_visibility,
            Transport::ShownMap | Transport::ShownMapWithNegativePhotons => false,
        };
        is_unbiased && self.indirect.clamp.is_none()
    }

    /// Whether the film keeps the sums from which the error of the image is estimated.
    pub(crate) fn estimates_error(&self) -> bool {
        let is_requested =
            self.image.denoise != Denoise::None || self.image.noise.is_some() || self.image.allocates_samples();
        // A piece leaves that to the merged image.
        self.image.spp > 1 && is_requested && self.image.piece.is_none()
    }

    /// Whether the shadow rays of earlier samples decide where the map does not. This is false for a single sample, if
    /// the image shows the classes by photons, and if photons alone must decide.
    pub(crate) fn learns_from_shadow_rays(&self) -> bool {
        self.image.spp > 1 && !self.image_depends_on_photons()
    }

    /// Whether visibility photons are on trial: the number is not set, and samples can show whether they save time.
    pub(crate) fn tries_photons(&self) -> bool {
        self.learns_from_shadow_rays() && self.visibility_map.photons_per_light.is_none()
    }

    /// Whether the number of visibility photons affects more than noise: photons alone decide, or the image shows the
    /// classes that they give. Also true for techniques other than `shadow-photons`.
    pub(crate) fn image_depends_on_photons(&self) -> bool {
        let map = &self.visibility_map;
        let shown = self.image.aovs.contains(&Aov::Shadow);
        let photons_alone = map.audit == 0.0 || map.paper_counting || !map.fine_cells || self.image.piece.is_some();
        !self.technique.traces_by_photons() || shown || photons_alone
    }

    /// Shadow rays to a light without photons, at most.
    pub(crate) fn shadow_rays_to_a_light(&self) -> u64 {
        let ImageSettings { width, height, spp, .. } = self.image;
        let factors = [width, height, spp, self.shadow_rays.samples].map(u64::from);
        factors.into_iter().fold(1, u64::saturating_mul)
    }

    /// Visibility photons emitted from each light, if [`VisibilityMapSettings::photons_per_light`] is `None`: 131,072
    /// where photons alone decide, as in pieces, or where the image shows the classes that they give. Otherwise one for
    /// each 64 shadow rays that they may save, but at least 4,096, and at most 16,384, or 131,072 if the image has a
    /// single sample.
    pub fn photons_per_light(&self) -> u32 {
        let most = if self.learns_from_shadow_rays() { LEARNING_PHOTONS } else { MAP_PHOTONS };
        let default = match self.image_depends_on_photons() {
            true => MAP_PHOTONS,
            false => {
                (self.shadow_rays_to_a_light() / RAYS_PER_PHOTON).clamp(u64::from(MIN_PHOTONS), u64::from(most)) as u32
            }
        };
        self.visibility_map.photons_per_light.unwrap_or(default)
    }

    /// Like [`Settings::photons_per_light`], but no more than fit in the map when each of `lights` lights has as many.
    pub(crate) fn photons_of_light(&self, lights: usize) -> u32 {
        self.photons_per_light().min(MAX_MAP_PHOTONS / lights.max(1) as u32)
    }

    /// Photons emitted for the global map: 65,536 if [`IndirectSettings::photons`] is `None`. If
    /// [`IrradianceCacheSettings::gather_rays`] is `None` too, the first sample has a sixteenth of them. Later samples
    /// have up to sixteen times as many in any case.
    pub fn flux_photons(&self) -> u32 {
        self.indirect.photons.unwrap_or(FLUX_PHOTONS)
    }

    /// Gather rays per irradiance record: 256 if [`IrradianceCacheSettings::gather_rays`] is `None`. As with photons,
    /// the first sample has fewer, and later ones have more.
    pub fn gather_rays(&self) -> u32 {
        self.indirect.irradiance_cache.gather_rays.unwrap_or(GATHER_RAYS)
    }

    /// Checks every range, and that the settings do not contradict each other.
    ///
    /// # Errors
    /// [`Error::Setting`] with the setting and its range.
    pub fn check(&self) -> Result<()> {
        self.check_integers()?;
        self.check_reals()?;
        self.check_piece()?;
        self.check_noise()?;
        self.check_light_sampling()
    }

    fn check_integers(&self) -> Result<()> {
        let Settings { image, visibility_map, shadow_rays, light_sampling, cells, light_buffer, .. } = self;
        let range = |name, value: u32, min: u32, max: u32| match (min..=max).contains(&value) {
            true => Ok(()),
            false => Err(Error::setting(name, format!("is {value}; it must be from {min} to {max}"))),
        };
        range("image.width", image.width, 1, Self::MAX_SIDE)?;
        range("image.height", image.height, 1, Self::MAX_SIDE)?;
        if let Some(Crop { x, y, width, height }) = image.crop
            && (x.checked_add(width).is_none_or(|end| end > image.width || width == 0)
                || y.checked_add(height).is_none_or(|end| end > image.height || height == 0))
        {
            let problem =
                format!("is {width} x {height} pixels at {x}, {y}; it must not be empty and must lie in the image");
            return Err(Error::setting("image.crop", format!("{problem} of {} x {}", image.width, image.height)));
        }
        range("image.spp", image.spp, 1, Self::UNLIMITED_SPP)?;
        let is_repeated = |aov: &&Aov| image.aovs.iter().filter(|other| other == aov).count() > 1;
        if let Some(aov) = image.aovs.iter().find(is_repeated) {
            return Err(Error::setting("image.aovs", format!("has {} more than once", aov.name())));
        }
        range("visibility_map.photons_per_light", self.photons_per_light(), 1, Self::MAX_PHOTONS)?;
        range("visibility_map.nearest", visibility_map.nearest, 1, Self::MAX_NEAREST)?;
        let stored = visibility_map.shadow_photons_per_ray;
        range("visibility_map.shadow_photons_per_ray", stored, 1, Self::MAX_SHADOW_PHOTONS)?;
        range("visibility_map.dilate", visibility_map.dilate.unwrap_or(0), 0, 1)?;
        range("shadow_rays.samples", shadow_rays.samples, 1, Self::MAX_SHADOW_SAMPLES)?;
        range("light_sampling.sampled_lights", light_sampling.sampled_lights, 1, Self::MAX_SAMPLED_LIGHTS)?;
        range("indirect.photons", self.flux_photons(), 1, Self::MAX_PHOTONS)?;
        range("indirect.irradiance_cache.gather_rays", self.gather_rays(), 1, Self::MAX_GATHER_RAYS)?;
        range("cells.resolution", cells.resolution, 1, Self::MAX_CELLS)?;
        range("cells.rays_per_light", cells.rays_per_light, 1, Self::MAX_CELL_RAYS)?;
        range("light_buffer.resolution", light_buffer.resolution, 1, Self::MAX_LIGHT_BUFFER_CELLS)
    }

    /// The samples of a piece must not depend on those of others.
    fn check_piece(&self) -> Result<()> {
        let Some(SampleRange { first, end }) = self.image.piece else { return Ok(()) };
        let refuse = |name, problem: String| Err(Error::setting(name, problem));
        let spp = self.image.spp;
        if first >= end || end > spp {
            let problem = format!("is {first}..{end}; it must not be empty, and must not go beyond `image.spp`, {spp}");
            return refuse("image.piece", problem);
        }
        let with = "cannot be combined with `image.piece`:";
        let is_adaptive = self.image.sampling == Sampling::Adaptive;
        for (name, is_set) in [("image.noise", self.image.noise.is_some()), ("image.sampling", is_adaptive)] {
            if is_set {
                let problem = format!("{with} which pixels get samples would depend on those of other pieces");
                return refuse(name, problem);
            }
        }
        if self.technique.requirements().visibility == Visibility::Adaptive {
            let problem = format!("{with} {} learns from earlier samples", self.technique);
            return refuse("technique", problem);
        }
        if self.image.aovs.contains(&Aov::Shadow) {
            return refuse("image.aovs", format!("{with} pieces do not keep the AOV shadow"));
        }
        if self.visibility_map.dilate == Some(1) {
            let problem = format!("{with} boundaries would grow into the pixels of other pieces");
            return refuse("visibility_map.dilate", problem);
        }
        Ok(())
    }

    fn check_noise(&self) -> Result<()> {
        let problem = match self.image.noise {
            Some(noise) if !(noise > 0.0 && noise.is_finite()) => {
                format!("is {noise}; it must be finite and more than 0")
            }
            Some(_) if !self.is_unbiased() => "needs an unbiased technique without `indirect.clamp`, and audits where \
                 photons classify points: only then can the error be estimated"
                .to_owned(),
            _ => return Ok(()),
        };
        Err(Error::setting("image.noise", problem))
    }

    fn check_reals(&self) -> Result<()> {
        let refuse =
            |name, value: f32, range: &str| Err(Error::setting(name, format!("is {value}; it must be {range}")));
        if let Background::Colour(colour) = self.image.background
            && let Some(value) = colour.into_iter().find(|value| !(*value >= 0.0 && value.is_finite()))
        {
            return refuse("image.background", value, "finite and 0 or more");
        }
        let accuracy = self.indirect.irradiance_cache.accuracy;
        if !(accuracy > 0.0 && accuracy <= Self::MAX_ACCURACY) {
            let range = format!("more than 0, at most {}", Self::MAX_ACCURACY);
            return refuse("indirect.irradiance_cache.accuracy", accuracy, &range);
        }
        if let Some(clamp) = self.indirect.clamp
            && !(clamp > 0.0 && clamp.is_finite())
        {
            return refuse("indirect.clamp", clamp, "finite and more than 0");
        }
        let audit = self.visibility_map.audit;
        if !(0.0..=1.0).contains(&audit) {
            return refuse("visibility_map.audit", audit, "from 0 to 1");
        }
        if !(0.0..=1.0).contains(&self.ward.tolerance) {
            return refuse("ward.tolerance", self.ward.tolerance, "from 0 to 1");
        }
        if !(self.light_scale >= 0.0 && self.light_scale.is_finite()) {
            return refuse("light_scale", self.light_scale, "finite and 0 or more");
        }
        Ok(())
    }

    fn check_light_sampling(&self) -> Result<()> {
        let technique = self.technique;
        let zones = matches!(self.light_sampling.strategy, None | Some(LightSampling::Zones));
        if self.light_sampling.sampled_lights == 1 && zones && technique.uses_zones() {
            let problem = format!("is 1; it must be from 2 to {} with zones", Self::MAX_SAMPLED_LIGHTS);
            return Err(Error::setting("light_sampling.sampled_lights", format!("{problem}: one audits the zones")));
        }
        let Some(strategy) = self.light_sampling.strategy else { return Ok(()) };
        let problem = match strategy {
            LightSampling::Zones if !technique.uses_zones() => {
                format!("{technique} has no visibility photons that tell which lights reach a zone")
            }
            LightSampling::All if technique.is_path_tracing() => "a path samples one light at each vertex".to_owned(),
            LightSampling::Contribution if technique.is_path_tracing() => {
                "a path does not weigh all lights at each vertex".to_owned()
            }
            LightSampling::Uniform | LightSampling::Power | LightSampling::Contribution
                if !technique.samples_lights() && !technique.is_path_tracing() =>
            {
                format!("{technique} uses all lights")
            }
            LightSampling::Uniform | LightSampling::Power | LightSampling::Contribution | LightSampling::Zones
                if self.image.aovs.contains(&Aov::Shadow) =>
            {
                "the AOV shadow needs all lights".to_owned()
            }
            _ => return Ok(()),
        };
        Err(Error::setting("light_sampling.strategy", format!("cannot be {strategy}: {problem}")))
    }
}
