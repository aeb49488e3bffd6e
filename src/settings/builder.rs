//! [`SettingsBuilder`]: settings by chained calls.

use super::{Aov, Denoise, LightSampling, SampleRange, Sampling, Settings, Technique};
use crate::Result;

/// Builds [`Settings`] from the defaults; [`SettingsBuilder::build`] checks the ranges.
///
/// ```
/// use penumbra::{Aov, Settings, Technique};
///
/// let builder = Settings::builder().technique(Technique::TWO_PASS).size(320, 200).spp(64);
/// let settings = builder.aovs([Aov::Albedo]).build()?;
/// assert_eq!(settings.image.width, 320);
///
/// let error = Settings::builder().nearest(600).build().unwrap_err();
/// assert_eq!(error.to_string(), "`visibility_map.nearest` is 600; it must be from 1 to 511");
/// # Ok::<(), penumbra::Error>(())
/// ```
#[derive(Clone, Debug, Default)]
#[must_use = "a builder does nothing until `build` is called"]
pub struct SettingsBuilder {
    settings: Settings,
}

macro_rules! setters {
    ($($name:ident: $type:ty => $doc:literal, $($field:ident).+;)*) => {
        impl SettingsBuilder {$(
            #[doc = concat!("Sets `", $doc, "`.")]
            pub fn $name(mut self, $name: $type) -> Self {
                self.settings.$($field).+ = $name.into();
                self
            }
        )*}
    };
}

setters! {
    technique: Technique => "Settings::technique", technique;
    spp: u32 => "ImageSettings::spp", image.spp;
    sampling: Sampling => "ImageSettings::sampling", image.sampling;
    piece: SampleRange => "ImageSettings::piece", image.piece;
    seed: u32 => "ImageSettings::seed", image.seed;
    denoise: Denoise => "ImageSettings::denoise", image.denoise;
    noise: f64 => "ImageSettings::noise", image.noise;
    photons_per_light: u32 => "VisibilityMapSettings::photons_per_light", visibility_map.photons_per_light;
    nearest: u32 => "VisibilityMapSettings::nearest", visibility_map.nearest;
    shadow_photons_per_ray: u32 => "VisibilityMapSettings::shadow_photons_per_ray",
        visibility_map.shadow_photons_per_ray;
    dilate: u32 => "VisibilityMapSettings::dilate", visibility_map.dilate;
    audit: f32 => "VisibilityMapSettings::audit", visibility_map.audit;
    paper_counting: bool => "VisibilityMapSettings::paper_counting", visibility_map.paper_counting;
    fine_cells: bool => "VisibilityMapSettings::fine_cells", visibility_map.fine_cells;
    shadow_samples: u32 => "ShadowRaySettings::samples", shadow_rays.samples;
    light_sampling: LightSampling => "LightSamplingSettings::strategy", light_sampling.strategy;
    sampled_lights: u32 => "LightSamplingSettings::sampled_lights", light_sampling.sampled_lights;
    max_bounces: u32 => "IndirectSettings::max_bounces", indirect.max_bounces;
    indirect_photons: u32 => "IndirectSettings::photons", indirect.photons;
    clamp: f32 => "IndirectSettings::clamp", indirect.clamp;
    irradiance_cache: bool => "IrradianceCacheSettings::enabled", indirect.irradiance_cache.enabled;
    accuracy: f32 => "IrradianceCacheSettings::accuracy", indirect.irradiance_cache.accuracy;
    gather_rays: u32 => "IrradianceCacheSettings::gather_rays", indirect.irradiance_cache.gather_rays;
    cells: u32 => "CellSettings::resolution", cells.resolution;
    cell_rays: u32 => "CellSettings::rays_per_light", cells.rays_per_light;
    light_buffer_cells: u32 => "LightBufferSettings::resolution", light_buffer.resolution;
    ward_tolerance: f32 => "WardSettings::tolerance", ward.tolerance;
    light_scale: f32 => "Settings::light_scale", light_scale;
}

impl SettingsBuilder {
    /// Sets the width and the height of the image, in pixels.
    pub fn size(mut self, width: u32, height: u32) -> Self {
        (self.settings.image.width, self.settings.image.height) = (width, height);
        self
    }

    /// Sets [`ImageSettings::aovs`](super::ImageSettings::aovs).
    pub fn aovs(mut self, aovs: impl IntoIterator<Item = Aov>) -> Self {
        self.settings.image.aovs = aovs.into_iter().collect();
        self
    }

    /// The settings.
    ///
    /// # Errors
    /// As [`Settings::check`].
    pub fn build(self) -> Result<Settings> {
        self.settings.check()?;
        Ok(self.settings)
    }
}
