//! Notes on a render that are known before its first sample.

use crate::count::count;
use crate::gpu_scene::GpuScene;
use crate::scene::Scene;
use crate::settings::Settings;
use crate::settings::stages::settings_of_stage;
use crate::specialisation::features::{Feature, Features};
use crate::statistics::Indirect;

/// The notes, one line each. The settings are those that were given, and `stage` is that of the first sample.
pub(super) fn notes(
    scene: &Scene,
    settings: &Settings,
    stage: i32,
    features: &Features,
    indirect: &Indirect,
    gpu_scene: &GpuScene,
) -> Vec<String> {
    let mut notes = Vec::new();
    let unused = settings.unused();
    if !unused.is_empty() {
        notes.push(format!("the technique {} does not use {}", settings.technique, unused.join(", ")));
    }
    let (lights, wanted) = (scene.placed_lights().len(), settings.photons_per_light());
    let emitted = settings.photons_of_light(lights);
    if features.has(Feature::VisibilityMap) && emitted < wanted {
        let of = if lights == 1 { "the light emits".to_owned() } else { format!("each of {lights} lights emits") };
        notes.push(format!("{of} {emitted} visibility photons, not {wanted}: the map has no room for more"));
    }
    let environment = gpu_scene.lights.environment.as_ref();
    if let Some([width, height]) = environment.and_then(|environment| environment.reduced) {
        notes.push(format!("the panorama is reduced to {width} x {height} texels: the device has no room for more"));
    }
    if scene.is_empty() {
        let shown = if environment.is_some() { "is the environment alone" } else { "is empty" };
        notes.push(format!("the scene has no triangles: the image {shown}"));
    }
    let wanted = u64::from(settings_of_stage(settings, stage).flux_photons());
    // Rounding per light removes a few rays. Only a lack of device memory leaves less than half.
    if indirect.emitted > 0 && indirect.emitted <= wanted / 2 {
        let emitted = indirect.emitted;
        notes.push(format!(
            "the photons of {} fill the device's largest buffer: the global map has no room for those of \
             {wanted}",
            count(emitted, "ray", "rays")
        ));
    }
    if indirect.clipped > 0 {
        let photons = count(indirect.clipped, "photon", "photons");
        notes.push(format!("the flux of {photons} exceeds what a photon can store: indirect light is too dark"));
    }
    notes
}
