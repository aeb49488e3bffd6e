//! Settings that a technique does not use.

use super::Settings;
use super::technique::Visibility;

impl Settings {
    /// The names of the settings that differ from their defaults although the technique does not use them.
    pub(crate) fn unused(&self) -> Vec<&'static str> {
        let (technique, default) = (self.technique, Settings::default());
        let (indirect, map, lights) = (&self.indirect, &self.visibility_map, &self.light_sampling);
        let cache = &indirect.irradiance_cache;
        let (default_cache, default_map) = (&default.indirect.irradiance_cache, &default.visibility_map);
        let default_lights = &default.light_sampling;
        let two_pass = technique.is_two_pass();
        let records = two_pass && cache.enabled;
        let (mapped, chooses_rays) = (technique.uses_visibility_map(), technique.traces_by_photons());
        let (cells, buffers) = (technique.uses_cells(), technique.uses_light_buffers());
        let ward = technique.requirements().visibility == Visibility::Adaptive;
        // The name, whether the technique uses it, and whether it was set.
        let settings = [
            ("`indirect.photons`", two_pass || technique.shows_map(), indirect.photons.is_some()),
            ("`indirect.clamp`", !technique.shows_map(), indirect.clamp.is_some()),
            ("`indirect.irradiance_cache.accuracy`", records, cache.accuracy != default_cache.accuracy),
            ("`indirect.irradiance_cache.gather_rays`", records, cache.gather_rays.is_some()),
            ("`indirect.irradiance_cache.enabled`", two_pass, !cache.enabled),
            ("`visibility_map.photons_per_light`", mapped, map.photons_per_light.is_some()),
            ("`visibility_map.nearest`", mapped, map.nearest != default_map.nearest),
            (
                "`visibility_map.shadow_photons_per_ray`",
                mapped,
                map.shadow_photons_per_ray != default_map.shadow_photons_per_ray,
            ),
            ("`visibility_map.dilate`", chooses_rays, map.dilate.is_some()),
            ("`visibility_map.audit`", chooses_rays, map.audit != default_map.audit),
            ("`visibility_map.paper_counting`", mapped, map.paper_counting),
            ("`visibility_map.fine_cells`", chooses_rays, !map.fine_cells),
            ("`shadow_rays.samples`", two_pass, self.shadow_rays != default.shadow_rays),
            (
                "`light_sampling.sampled_lights`",
                technique.samples_lights(),
                lights.sampled_lights != default_lights.sampled_lights,
            ),
            ("`cells.resolution`", cells, self.cells.resolution != default.cells.resolution),
            ("`cells.rays_per_light`", cells, self.cells.rays_per_light != default.cells.rays_per_light),
            ("`light_buffer.resolution`", buffers, self.light_buffer != default.light_buffer),
            ("`ward.tolerance`", ward, self.ward != default.ward),
        ];
        settings.into_iter().filter(|(_, used, set)| *set && !used).map(|(name, ..)| name).collect()
    }
}

#[cfg(test)]
mod tests {
    use crate::settings::{Settings, Technique};

    /// A technique names the settings that were set and that it does not use, and none that has its default.
    #[test]
    fn techniques_name_what_they_do_not_use() {
        let settings = |technique| {
            Settings::default().with(|s| {
                s.technique = technique;
                s.visibility_map.audit = 0.0;
                s.indirect.irradiance_cache.gather_rays = Some(64);
                s.cells.resolution = 8;
            })
        };
        let (gather, audit, cells) =
            ("`indirect.irradiance_cache.gather_rays`", "`visibility_map.audit`", "`cells.resolution`");
        assert_eq!(settings(Technique::PATH).unused(), [gather, audit, cells]);
        assert_eq!(settings(Technique::SHADOW_PHOTONS).unused(), [cells]);
        assert_eq!(settings(Technique::VOXEL_TAGS).unused(), [audit]);
        assert_eq!(settings(Technique::PHOTON_MAP).unused(), [gather, audit, cells]);
        for technique in Technique::all() {
            assert!(Settings { technique, ..Settings::default() }.unused().is_empty(), "{technique}");
        }
        let without_records = settings(Technique::TWO_PASS).with(|s| s.indirect.irradiance_cache.enabled = false);
        assert_eq!(without_records.unused(), [gather, audit, cells]);
    }
}
