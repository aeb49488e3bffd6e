//! Renders on a device with the least limits that a desktop has, and on a slow one.

use kernel_kit::{DeviceChoice, DeviceLimits, Gpu};
use penumbra::internal::report::metrics::relmse;
use penumbra::internal::scene::ImportOptions;
use penumbra::settings::Denoise;
use penumbra::{Image, Renderer, Scene, Settings};

use crate::setup::{gpu, scene_file};

fn render(gpu: &Gpu, name: &str, settings: &Settings) -> Image {
    let scene = Scene::load(scene_file(name), &ImportOptions::default()).unwrap();
    let camera = scene.cameras[0].clone();
    let mut renderer = Renderer::new(gpu, scene, &camera, settings).unwrap();
    while renderer.samples() < settings.image.spp {
        renderer.render_batch().unwrap();
    }
    renderer.image().unwrap()
}

fn settings(seed: u32) -> Settings {
    Settings::default().with(|s| {
        s.image.width = 48;
        s.image.height = 32;
        s.image.spp = 8;
        s.image.seed = seed;
        s.visibility_map.photons_per_light = Some(16384);
        s.indirect.photons = Some(16384);
    })
}

fn opened(limits: DeviceLimits) -> Gpu {
    Gpu::open_with(&DeviceChoice::Name(gpu().info.name.clone()), limits).unwrap()
}

/// With these limits the device renders the same image as with its own, within the difference of two seeds.
fn renders_the_same(limits: DeviceLimits, name: &str) {
    let image = render(&opened(limits), name, &settings(1));
    let own = render(gpu(), name, &settings(1));
    let error = relmse(&image, &own).unwrap();
    if error == 0.0 {
        return;
    }
    let seeds = relmse(&render(gpu(), name, &settings(2)), &own).unwrap();
    println!("{name}, {limits:?}: relMSE {error:.1e}, of two seeds {seeds:.1e}");
    assert!(error < 0.1 * seeds, "{name}, {limits:?}: relMSE {error:.1e}, of two seeds {seeds:.1e}");
}

// Three tests, which run at the same time: SwiftShader compiles the kernels of a device on one core. The box is below.
// docs/devices.md has the other scenes.

#[test]
fn few_limits_are_enough_for_the_still_life() {
    renders_the_same(DeviceLimits::Least, "still_life.glb");
}

#[test]
fn few_limits_are_enough_for_many_lights() {
    renders_the_same(DeviceLimits::Least, "lamps.glb");
}

#[test]
fn few_limits_are_enough_for_procedural_objects() {
    renders_the_same(DeviceLimits::Least, "procedural.glb");
}

/// The sampled lights of all points of an image of the default size would take 269 MB.
#[test]
fn many_sampled_lights_fit_into_small_bindings() {
    let scene = Scene::load(scene_file("lamps.glb"), &ImportOptions::default()).unwrap();
    let settings = Settings::default().with(|s| {
        s.light_sampling.sampled_lights = 64;
        (s.image.width, s.image.height, s.image.spp, s.indirect.max_bounces) = (512, 512, 2, 0);
    });
    let camera = scene.cameras[0].clone();
    Renderer::new(&opened(DeviceLimits::Least), scene, &camera, &settings).unwrap();
}

/// Tables are storage buffers, and rays are traced alone. SwiftShader has too few such buffers.
#[test]
fn software_devices_can_be_used_as_gpus() {
    if gpu().device.limits().max_storage_buffers_per_shader_stage >= 24 {
        renders_the_same(DeviceLimits::Gpu, "still_life.glb");
    }
}

/// Passes of a device that seems a thousand times slower are sliced, which changes no bit of the image.
#[test]
fn slices_do_not_show() {
    let image = |slowness: f64| {
        let gpu = opened(DeviceLimits::Least);
        gpu.pretend_slower(slowness);
        let image = render(&gpu, "box.glb", &settings(1).with(|s| s.image.denoise = Denoise::None));
        (image, gpu.slices())
    };
    let (fast, few) = image(0.0);
    let (slow, many) = image(1000.0);
    println!("{few} slices, and {many}");
    // Those of passes whose time is not known yet are in both.
    assert!(many > 2 * few + 100, "{few} slices, and {many}");
    for (fast, slow) in fast.channels.iter().zip(&slow.channels) {
        let bits = |samples: &[f32]| samples.iter().map(|x| x.to_bits()).collect::<Vec<_>>();
        assert!(bits(&fast.samples) == bits(&slow.samples), "{} differs", fast.name);
    }
}
