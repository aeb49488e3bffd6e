//! Features that a scene does not need, forced on.

use kernel_kit::Feature as _;
use penumbra::internal::scene::ImportOptions;
use penumbra::internal::specialisation::device_features;
use penumbra::internal::specialisation::features::{Feature, Features};
use penumbra::{Image, Renderer, Scene, Settings};

use crate::setup::{gpu, scene_file};
use crate::unneeded_features::{
    NOT_FORCED, OTHER_RAYS, UNNEEDED, all_unneeded, relative_differences, share_beyond_rounding, values,
};

fn settings() -> Settings {
    Settings::default().with(|s| {
        (s.image.width, s.image.height, s.image.spp) = (48, 48, 4);
        // Images so small would have no photons unless their number is requested.
        s.visibility_map.photons_per_light = Some(4096);
    })
}

fn renderer(settings: &Settings, forced: &[(Feature, bool)]) -> Renderer<'static> {
    let scene = Scene::load(scene_file("box.glb"), &ImportOptions::default()).unwrap();
    let camera = scene.cameras[0].clone();
    Renderer::with_features(gpu(), scene, &camera, settings, forced).unwrap()
}

fn image(settings: &Settings, forced: &[(Feature, bool)]) -> Image {
    let mut renderer = renderer(settings, forced);
    while renderer.samples() < settings.image.spp {
        renderer.render_batch().unwrap();
    }
    renderer.image().unwrap()
}

/// Every feature is one that the box needs, one that is forced in the next test, or one that is said not to be.
#[test]
fn every_feature_is_needed_or_forced_or_excused() {
    let renderer = renderer(&settings(), &[]);
    let features = &renderer.specialisation().features;
    let of_device = device_features(gpu(), Features::default());
    for feature in [Feature::TextureLoads, Feature::Interleave, Feature::Packets] {
        assert_eq!(features.has(feature), of_device.has(feature), "{}", feature.name());
    }
    for feature in Feature::ALL {
        let needed = features.has(*feature);
        let forced = UNNEEDED.iter().filter(|unneeded| unneeded.feature == *feature).count();
        let excused = NOT_FORCED.iter().filter(|(excused, _)| excused.contains(feature)).count();
        let name = feature.name();
        match UNNEEDED.iter().find(|unneeded| unneeded.feature == *feature) {
            Some(unneeded) => assert!(needed != unneeded.on && forced + excused == 1, "{name}: nothing is forced"),
            None => assert!(needed || excused == 1, "{name}: neither forced nor excused"),
        }
    }
}

/// The share of values that differ by more than roundings.
fn differing(a: &Image, b: &Image) -> f64 {
    share_beyond_rounding(&relative_differences(&values(a), &values(b)))
}

/// Share of values that may differ on a GPU, whose compiler fuses other products and sums in each kernel: so a path may
/// go another way. An H200 had less than half as many.
const OTHER_WAYS: f64 = 0.1;

/// Features that the box does not need change its image by roundings alone. Irradiance records amplify those: there,
/// they change at most one of a hundred values by more. It was one of five hundred, because smooth surfaces and normal
/// maps keep records in another form. On GPUs a path may go another way besides. One test, because most kernels of the
/// two images are the same and take half a minute to compile.
#[test]
fn unneeded_features_change_no_image() {
    let exact = settings().with(|s| s.indirect.irradiance_cache.enabled = false);
    let plain = image(&exact, &[]);
    let (other, forced): (Vec<_>, Vec<_>) =
        all_unneeded().into_iter().partition(|(feature, _)| OTHER_RAYS.contains(feature));
    let other_ways = if gpu().is_software() { 0.0 } else { OTHER_WAYS };
    for forced in [&forced, &other] {
        let share = differing(&plain, &image(&exact, forced));
        assert!(share <= other_ways, "{share} of the values differ with {forced:?}");
    }
    let noise = image(&exact.with(|s| s.image.seed = 2), &[]);
    assert!(differing(&plain, &noise) > 0.5, "other random numbers are not seen");

    // Requested rays: estimates that differ by roundings may decide for more of them or not.
    let interpolated = settings().with(|s| s.indirect.irradiance_cache.gather_rays = Some(64));
    let share = differing(&image(&interpolated, &[]), &image(&interpolated, &forced));
    assert!(share < 0.01 + other_ways, "{share} of the values differ");
}
