//! The trial of visibility photons in a render that did not request them.

use glam::{DVec3, Vec3};
use kernel_kit::{DeviceChoice, Gpu};
use penumbra::internal::scene::{Camera, Light, LightKind, Material, Scene};
use penumbra::{Aov, ImportOptions, Renderer, Settings, Technique};

use crate::meshes::{camera, scene, square, surface};
use crate::setup::{deviation, gpu, mean_and_error, scene_file};

/// Shadows of slats on a floor.
#[derive(Clone, Copy)]
enum Shadows {
    /// All points are in the penumbrae of many slats under a wide lamp.
    Penumbrae,
    /// Boundaries without penumbrae are everywhere: the slats under a point light are as wide as a few pixels.
    Edges,
    /// One slat under a point light.
    Simple,
}

fn slats(shadows: Shadows) -> Scene {
    let number = match shadows {
        Shadows::Penumbrae => 24,
        Shadows::Edges => 200,
        Shadows::Simple => 1,
    };
    let mut boards = Vec::new();
    for i in 0..number {
        let x = 3.0 * (f64::from(i) + 0.5) / f64::from(number) - 1.5;
        boards.extend(square(DVec3::new(x, 1.0, 0.0), DVec3::X * (0.6 / f64::from(number)), -DVec3::Z * 1.5));
    }
    let mut meshes = vec![
        (square(DVec3::ZERO, DVec3::X, -DVec3::Z), surface(0.6, 0.0)),
        (boards, Material { double_sided: true, ..surface(0.0, 0.0) }),
    ];
    if matches!(shadows, Shadows::Penumbrae) {
        meshes.push((square(DVec3::Y * 2.0, DVec3::X * 0.8, DVec3::Z * 0.8), surface(0.0, 5.0)));
        return scene(&meshes, Vec::new());
    }
    let light = LightKind::Point { position: Vec3::Y * 2.0, intensity: Vec3::splat(5.0), range: f32::INFINITY };
    scene(&meshes, vec![light])
}

/// From below the slats.
fn view() -> Camera {
    camera(DVec3::new(0.0, 0.8, 0.9), DVec3::new(0.0, -0.8, -0.9), 0.5)
}

/// Enough samples for photons to be tried.
fn settings(technique: Technique) -> Settings {
    Settings::default().with(|s| {
        s.technique = technique;
        (s.image.width, s.image.height, s.image.spp) = (128, 128, 512);
        s.indirect.max_bounces = 0;
        s.image.aovs = vec![Aov::Variance];
    })
}

fn renderer(shadows: Shadows, settings: &Settings) -> Renderer<'static> {
    Renderer::new(gpu(), slats(shadows), &view(), settings).unwrap()
}

fn has_photons(renderer: &Renderer<'_>) -> bool {
    renderer.specialisation().kept.iter().any(|item| item.name() == "visibility_map")
}

fn render_to(renderer: &mut Renderer<'_>, samples: u32) {
    while renderer.samples() < samples {
        renderer.render_batch().unwrap();
    }
}

/// The first sample traces all shadow rays, and decides whether photons are emitted. They are not if points in
/// penumbrae trace the rays anyway, unless photons were requested.
#[test]
fn photons_are_made_after_the_first_sample() {
    let settings = settings(Technique::SHADOW_PHOTONS);
    let requested = settings.clone().with(|s| s.visibility_map.photons_per_light = Some(16_384));
    for (shadows, settings, has_them) in [
        (Shadows::Penumbrae, &settings, [false; 3]),
        (Shadows::Simple, &settings, [false, true, true]),
        (Shadows::Penumbrae, &requested, [true; 3]),
        (Shadows::Edges, &requested, [true; 3]),
    ] {
        let mut renderer = renderer(shadows, settings);
        let mut has = [false; 3];
        for (samples, has) in [1, 2, 16].into_iter().zip(&mut has) {
            render_to(&mut renderer, samples);
            *has = has_photons(&renderer);
        }
        assert_eq!(has, has_them);
        let statistics = renderer.statistics().unwrap();
        assert_eq!(statistics.rays.photon > 0, has[2]);
    }
}

/// The kernels of photons can be compiled while the first sample is rendered. None is missing later, and the image has
/// the same bits. If no photons can be emitted later, there is nothing to compile.
#[test]
fn later_kernels_are_compiled_ahead() {
    let settings = settings(Technique::SHADOW_PHOTONS);
    let device = Gpu::open(&DeviceChoice::Name(gpu().info.name.clone())).unwrap();
    device.keep_kernels();
    let mut renderer = Renderer::new(&device, slats(Shadows::Simple), &view(), &settings).unwrap();
    let first = device.kept_kernels();
    renderer.later_kernels().unwrap()(&device).unwrap();
    let all = device.kept_kernels();
    assert!(all > first, "{first} kernels, and {all}");
    render_to(&mut renderer, 2);
    assert!(has_photons(&renderer) && renderer.later_kernels().is_none());
    assert_eq!(device.kept_kernels(), all, "kernels that were not compiled ahead");
    let mut plain = self::renderer(Shadows::Simple, &settings);
    render_to(&mut plain, 2);
    assert_eq!(renderer.image().unwrap().rgb(), plain.image().unwrap().rgb());
    let requested = settings.with(|s| s.visibility_map.photons_per_light = Some(16_384));
    assert!(self::renderer(Shadows::Simple, &requested).later_kernels().is_none());
}

/// Photons that decide few points are used for eight samples; the other samples trace all shadow rays. The mean stays
/// that of `two-pass`, within three standard errors.
#[test]
fn photons_that_decide_little_are_left_out() {
    let mut few = renderer(Shadows::Edges, &settings(Technique::SHADOW_PHOTONS));
    let memory = |renderer: &Renderer<'_>| renderer.statistics().unwrap().memory;
    let without = memory(&few);
    render_to(&mut few, 2);
    assert!(has_photons(&few), "they are not tried");
    assert!(memory(&few).photons > without.photons && memory(&few).frame > without.frame);
    render_to(&mut few, 8);
    assert!(!has_photons(&few), "they stay");
    assert_eq!([memory(&few).photons, memory(&few).frame], [without.photons, without.frame], "their memory is counted");
    let points = few.statistics().unwrap().points;
    render_to(&mut few, 40);
    let statistics = few.statistics().unwrap();
    assert!(statistics.points.lit + statistics.points.shadowed == points.lit + points.shadowed, "some are still asked");

    let mut all = renderer(Shadows::Edges, &settings(Technique::TWO_PASS));
    render_to(&mut all, 40);
    // Seven of forty samples queried photons.
    assert!(statistics.rays.shadow as f64 > 33.0 / 40.0 * all.statistics().unwrap().rays.shadow as f64);
    let [expected, mean] = [&all, &few].map(|renderer| mean_and_error(&renderer.image().unwrap(), "G"));
    let off = deviation(expected, mean);
    assert!(off < 3.0, "{off} standard errors");

    // Batches of any size: none of these ends after eight samples.
    let mut uneven = renderer(Shadows::Edges, &settings(Technique::SHADOW_PHOTONS));
    for _ in 0..7 {
        uneven.render_up_to(1).unwrap();
    }
    assert!(has_photons(&uneven));
    uneven.render_batch().unwrap();
    assert!(uneven.samples() > 8 && !has_photons(&uneven), "{} samples", uneven.samples());
}

/// Photons are made where the time is expected to allow enough samples that gain from them.
#[test]
fn little_time_makes_no_photons() {
    let settings = settings(Technique::SHADOW_PHOTONS);
    let [mut short, mut long] = [(); 2].map(|()| renderer(Shadows::Simple, &settings));
    for renderer in [&mut short, &mut long] {
        renderer.render_within(1e9).unwrap();
    }
    // At most twice what a sample takes.
    let mut seconds = 1e-6;
    while short.render_within(seconds).unwrap().is_none() {
        seconds *= 2.0;
    }
    long.render_within(1e9).unwrap();
    assert!(short.samples() > 1 && long.samples() > 1);
    assert_eq!([has_photons(&short), has_photons(&long)], [false, true]);
    // There is more time after all, also for a render that continues this one.
    let mut resumed = renderer(Shadows::Simple, &settings);
    resumed.resume_from(&short.checkpoint().unwrap()).unwrap();
    // How long a sample takes here is known after one more.
    resumed.render_within(1e9).unwrap();
    for renderer in [&mut short, &mut resumed] {
        renderer.render_within(1e9).unwrap();
        assert!(has_photons(renderer));
    }
}

/// A render that is continued from a checkpoint, before, in or after the trial, has the bits of one without
/// interruption.
#[test]
fn a_trial_is_continued() {
    let settings = settings(Technique::SHADOW_PHOTONS);
    for (shadows, checkpoints) in [
        (Shadows::Edges, vec![(1, false), (2, true), (8, false)]),
        (Shadows::Penumbrae, vec![(1, false), (2, false)]),
        (Shadows::Simple, vec![(1, false), (8, true)]),
    ] {
        let mut whole = renderer(shadows, &settings);
        render_to(&mut whole, 40);
        for (samples, has_them) in checkpoints {
            let mut interrupted = renderer(shadows, &settings);
            render_to(&mut interrupted, samples);
            let mut resumed = renderer(shadows, &settings);
            resumed.resume_from(&interrupted.checkpoint().unwrap()).unwrap();
            assert_eq!(has_photons(&resumed), has_them, "after {samples} samples");
            render_to(&mut resumed, 40);
            assert!(resumed.image().unwrap().channels == whole.image().unwrap().channels, "after {samples} samples");
        }
    }
}

/// A view that follows a preview has photons on trial, as in a new renderer. So has the next one, whether the trial
/// kept the photons or not.
#[test]
fn each_view_has_a_trial_of_its_own() {
    for (shadows, has_them) in [(Shadows::Simple, true), (Shadows::Edges, false), (Shadows::Penumbrae, false)] {
        let settings = settings(Technique::SHADOW_PHOTONS);
        let mut new = renderer(shadows, &settings);
        let mut viewed = Renderer::with_preview(gpu(), slats(shadows), &view(), &settings, [16, 16]).unwrap();
        viewed.render_up_to(1).unwrap();
        render_to(&mut new, 16);
        for _ in 0..2 {
            viewed.set_view(&view(), [128, 128]).unwrap();
            assert!(!has_photons(&viewed));
            render_to(&mut viewed, 16);
            assert_eq!([&new, &viewed].map(has_photons), [has_them; 2]);
            assert!(viewed.image().unwrap().channels == new.image().unwrap().channels);
            viewed.preview(&view(), [16, 16]).unwrap();
            viewed.render_up_to(1).unwrap();
        }
    }
}

/// A scene with several lights, textures, glossy surfaces and caustics: the kernels and maps that a preview leaves for
/// the following view give the bits of a new renderer, although only the view has visibility photons, with light tags.
#[test]
fn a_view_after_a_preview_has_the_bits_of_a_new_renderer() {
    let mut scene = Scene::load(scene_file("still_life.glb"), &ImportOptions::default()).unwrap();
    let camera = scene.cameras[0].clone();
    // Without them too many shadow rays are in penumbrae for photons to be emitted.
    for i in 0..11u8 {
        let position = Vec3::new(0.06 * f32::from(i) - 0.3, 0.5, 0.3);
        let kind = LightKind::Point { position, intensity: Vec3::ONE, range: f32::INFINITY };
        scene.lights.push(Light { name: String::new(), kind });
    }
    // Enough samples for photons to pay off in a small image; four are compared.
    let settings = Settings::builder().size(32, 24).spp(16_384).build().unwrap();
    let mut new = Renderer::new(gpu(), scene.clone(), &camera, &settings).unwrap();
    let mut viewed = Renderer::with_preview(gpu(), scene, &camera, &settings, [8, 6]).unwrap();
    viewed.render_up_to(1).unwrap();
    viewed.set_view(&camera, [32, 24]).unwrap();
    for renderer in [&mut new, &mut viewed] {
        render_to(renderer, 4);
        assert!(has_photons(renderer), "photons do not pay");
    }
    assert!(viewed.image().unwrap().channels == new.image().unwrap().channels);
}
