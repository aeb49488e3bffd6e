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

fn least() -> Gpu {
    Gpu::open_with(&DeviceChoice::Name(gpu().info.name.clone()), DeviceLimits::Least).unwrap()
}

/// A device with the least limits renders what it renders with its own, as far as two seeds tell.
#[test]
fn few_limits_are_enough() {
    let least = least();
    for name in ["box.glb", "sphere.glb", "still_life.glb", "lamps.glb", "materials.glb", "procedural.glb"] {
        let image = render(&least, name, &settings(1));
        let own = render(gpu(), name, &settings(1));
        let seeds = relmse(&render(gpu(), name, &settings(2)), &own).unwrap();
        let limits = relmse(&image, &own).unwrap();
        println!("{name}: relMSE {limits:.1e}, of two seeds {seeds:.1e}");
        assert!(limits < 0.1 * seeds, "{name}: relMSE {limits:.1e}, of two seeds {seeds:.1e}");
    }
}

/// Passes of a device that seems a thousand times slower are sliced, which changes no bit of the image.
#[test]
fn slices_do_not_show() {
    let image = |slowness: f64| {
        let gpu = least();
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
