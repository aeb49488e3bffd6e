//! The trial of visibility photons in the first samples of a render that did not ask for them.

use glam::DVec3;
use penumbra::internal::scene::{Camera, Material, Scene};
use penumbra::{Aov, ImportOptions, Renderer, Settings, Technique};

use crate::meshes::{camera, scene, square, surface};
use crate::setup::{deviation, gpu, mean_and_error, scene_file};

/// A floor under a wide lamp, of which slats hide a part. With many slats every point is in their penumbrae.
fn slats(number: u32) -> Scene {
    let mut boards = Vec::new();
    for i in 0..number {
        let x = 3.0 * (f64::from(i) + 0.5) / f64::from(number) - 1.5;
        boards.extend(square(DVec3::new(x, 1.0, 0.0), DVec3::X * (0.6 / f64::from(number)), -DVec3::Z * 1.5));
    }
    let meshes = [
        (square(DVec3::ZERO, DVec3::X, -DVec3::Z), surface(0.6, 0.0)),
        (boards, Material { double_sided: true, ..surface(0.0, 0.0) }),
        (square(DVec3::Y * 2.0, DVec3::X * 0.8, DVec3::Z * 0.8), surface(0.0, 5.0)),
    ];
    scene(&meshes, Vec::new())
}

/// From below the slats.
fn view() -> Camera {
    camera(DVec3::new(0.0, 0.8, 0.9), DVec3::new(0.0, -0.8, -0.9), 0.5)
}

/// Enough samples for photons to be tried.
fn settings(technique: Technique) -> Settings {
    Settings::default().with(|s| {
        s.technique = technique;
        (s.image.width, s.image.height, s.image.spp) = (128, 128, 40);
        s.indirect.max_bounces = 0;
        s.image.aovs = vec![Aov::Variance];
    })
}

fn renderer(slat_number: u32, settings: &Settings) -> Renderer<'static> {
    Renderer::new(gpu(), slats(slat_number), &view(), settings).unwrap()
}

fn has_photons(renderer: &Renderer<'_>) -> bool {
    renderer.specialisation().kept.iter().any(|item| item.name() == "visibility_map")
}

fn render_to(renderer: &mut Renderer<'_>, samples: u32) {
    while renderer.samples() < samples {
        renderer.render_batch().unwrap();
    }
}

/// Photons that decide hardly a point are asked for four samples; the others trace all shadow rays. The mean stays that
/// of `two-pass`, within three standard errors. Where photons decide, or were asked for, they stay.
#[test]
fn photons_that_decide_little_are_left_out() {
    let mut few = renderer(24, &settings(Technique::SHADOW_PHOTONS));
    render_to(&mut few, 2);
    assert!(has_photons(&few), "they are not tried");
    render_to(&mut few, 4);
    assert!(!has_photons(&few), "they stay");
    let points = few.statistics().unwrap().points;
    render_to(&mut few, 40);
    let statistics = few.statistics().unwrap();
    assert!(statistics.points.lit + statistics.points.shadowed == points.lit + points.shadowed, "some are still asked");

    let mut all = renderer(24, &settings(Technique::TWO_PASS));
    render_to(&mut all, 40);
    assert!(statistics.rays.shadow as f64 > 0.95 * all.statistics().unwrap().rays.shadow as f64);
    let [expected, mean] = [&all, &few].map(|renderer| mean_and_error(&renderer.image().unwrap(), "G"));
    let off = deviation(expected, mean);
    assert!(off < 3.0, "{off} standard errors");

    // Batches of any size: none of these ends after four samples.
    let mut uneven = renderer(24, &settings(Technique::SHADOW_PHOTONS));
    for _ in 0..3 {
        uneven.render_up_to(1).unwrap();
    }
    uneven.render_batch().unwrap();
    assert!(uneven.samples() > 4 && !has_photons(&uneven), "{} samples", uneven.samples());

    let mut decided = renderer(1, &settings(Technique::SHADOW_PHOTONS));
    render_to(&mut decided, 8);
    assert!(has_photons(&decided), "they decide, and are left out");
    let requested = settings(Technique::SHADOW_PHOTONS).with(|s| s.visibility_map.photons_per_light = Some(16_384));
    let mut requested = renderer(24, &requested);
    render_to(&mut requested, 8);
    assert!(has_photons(&requested), "they were asked for, and are left out");
}

/// A render that is continued from a checkpoint, before or after the trial, has the bits of one without interruption.
#[test]
fn a_trial_is_continued() {
    let settings = settings(Technique::SHADOW_PHOTONS);
    let mut whole = renderer(24, &settings);
    render_to(&mut whole, 40);
    for samples in [2, 8] {
        let mut interrupted = renderer(24, &settings);
        render_to(&mut interrupted, samples);
        let mut resumed = renderer(24, &settings);
        resumed.resume_from(&interrupted.checkpoint().unwrap()).unwrap();
        assert_eq!(has_photons(&resumed), samples < 4);
        render_to(&mut resumed, 40);
        assert!(resumed.image().unwrap().channels == whole.image().unwrap().channels, "after {samples} samples");
    }
}

/// A view that follows a glance has photons on trial as a new renderer has, and so has the next, whether the trial kept
/// them or not.
#[test]
fn each_view_has_a_trial_of_its_own() {
    for slat_number in [1, 24] {
        let settings = settings(Technique::SHADOW_PHOTONS);
        let mut new = renderer(slat_number, &settings);
        let mut looking = Renderer::with_glance(gpu(), slats(slat_number), &view(), &settings, [16, 16]).unwrap();
        assert!(has_photons(&new) && !has_photons(&looking), "a glance has photons");
        looking.render_up_to(1).unwrap();
        render_to(&mut new, 8);
        for _ in 0..2 {
            looking.look(&view(), [128, 128]).unwrap();
            assert!(has_photons(&looking));
            render_to(&mut looking, 8);
            assert_eq!(has_photons(&looking), slat_number == 1);
            assert!(looking.image().unwrap().channels == new.image().unwrap().channels, "{slat_number} slats");
            looking.glance(&view(), [16, 16]).unwrap();
            looking.render_up_to(1).unwrap();
        }
    }
}

/// Several lights, textures, glossy surfaces and caustics: the kernels and maps that a glance leaves for the view after
/// it give the bits of a new renderer, though photons of visibility, with tags of their lights, are only in the view.
#[test]
fn a_view_after_a_glance_has_the_bits_of_a_new_renderer() {
    let scene = Scene::load(scene_file("still_life.glb"), &ImportOptions::default()).unwrap();
    let camera = scene.cameras[0].clone();
    // So many samples that photons pay in a small image; four are compared.
    let settings = Settings::builder().size(32, 24).spp(16_384).build().unwrap();
    let mut new = Renderer::new(gpu(), scene.clone(), &camera, &settings).unwrap();
    let mut looking = Renderer::with_glance(gpu(), scene, &camera, &settings, [8, 6]).unwrap();
    looking.render_up_to(1).unwrap();
    looking.look(&camera, [32, 24]).unwrap();
    for renderer in [&mut new, &mut looking] {
        assert!(has_photons(renderer), "photons do not pay");
        render_to(renderer, 4);
    }
    assert!(looking.image().unwrap().channels == new.image().unwrap().channels);
}
