//! Renders that are to end in time.

use std::sync::Arc;

use penumbra::internal::scene::{ImportOptions, Panorama};
use penumbra::internal::techniques::auto::Choice;
use penumbra::settings::{Denoise, Sampling};
use penumbra::{Aov, Camera, Denoiser, Renderer, Scene, Settings, Technique};

use crate::setup::{assert_same, gpu, scene_file};

fn load(name: &str) -> Scene {
    Scene::load(scene_file(name), &ImportOptions::default()).unwrap()
}

fn renderer(settings: &Settings) -> Renderer<'static> {
    let scene = load("box.glb");
    let camera = scene.cameras[0].clone();
    Renderer::new(gpu(), scene, &camera, settings).unwrap()
}

fn settings(spp: u32) -> Settings {
    Settings::builder().technique(Technique::TWO_PASS).size(48, 48).spp(spp).build().unwrap()
}

/// With time for everything the image has the bits of one without a limit, through all stages of indirect light.
#[test]
fn ample_time_changes_no_bit() {
    let settings = settings(40);
    let (mut limited, mut free) = (renderer(&settings), renderer(&settings));
    while free.samples() < 40 {
        free.render_batch().unwrap();
        limited.render_within(1e9).unwrap().unwrap();
        assert_eq!(limited.samples(), free.samples());
    }
    assert_eq!(limited.statistics().unwrap().rays, free.statistics().unwrap().rays);
    assert_same(&limited.image().unwrap(), &free.image().unwrap(), "with ample time");
}

/// Whole batches have the bits of a render without a limit, wherever time ends.
#[test]
fn whole_batches_keep_their_bits() {
    let settings = settings(8);
    let (mut limited, mut free) = (renderer(&settings), renderer(&settings));
    limited.render_batch_within(0.0).unwrap().unwrap();
    assert!(limited.render_batch_within(0.0).unwrap().is_none());
    let mut seconds = 1e-6;
    while limited.samples() < 8 {
        let before = limited.samples();
        if limited.render_batch_within(seconds).unwrap().is_none() {
            assert_eq!(limited.samples(), before);
            seconds *= 2.0;
        }
    }
    while free.samples() < 8 {
        free.render_batch().unwrap();
    }
    assert_same(&limited.image().unwrap(), &free.image().unwrap(), "by whole batches");
}

/// The first sample is rendered in any case, and no other without time.
#[test]
fn without_time_there_is_one_sample() {
    let mut renderer = renderer(&settings(40));
    assert_eq!(renderer.render_within(0.0).unwrap().unwrap().samples, 1);
    assert!(renderer.render_within(0.0).unwrap().is_none());
    assert!(renderer.render_within(-1.0).unwrap().is_none());
    assert_eq!(renderer.samples(), 1);
    let image = renderer.image().unwrap();
    assert!(image.rgb().unwrap().iter().all(|channel| channel.iter().all(|x| x.is_finite())));
}

/// A render that had no time for a sample continues like one that made no attempt, also in adaptive sampling with a
/// fixed budget.
#[test]
fn no_time_changes_no_bit() {
    let settings = settings(8).with(|s| s.image.sampling = Sampling::Adaptive);
    let (mut asked, mut free) = (renderer(&settings), renderer(&settings));
    while free.samples() < 8 {
        free.render_batch().unwrap();
        asked.render_batch().unwrap();
        assert!(asked.render_within(0.0).unwrap().is_none());
    }
    assert_same(&asked.image().unwrap(), &free.image().unwrap(), "after no time");
}

/// With little time, samples are added with the present gather rays, because more rays take many times as long. Once
/// there is time, rays are added.
#[test]
fn little_time_is_for_samples() {
    let mut renderer = renderer(&settings(40));
    renderer.render_within(0.0).unwrap();
    let first = renderer.statistics().unwrap().rays.gather;
    assert!(first > 0);
    // At most twice what a sample takes.
    let mut seconds = 1e-6;
    while renderer.render_within(seconds).unwrap().is_none() {
        seconds *= 2.0;
    }
    assert!(renderer.samples() > 1);
    assert_eq!(renderer.statistics().unwrap().rays.gather, first, "there are more gather rays");
    renderer.render_within(1e9).unwrap().unwrap();
    assert!(renderer.statistics().unwrap().rays.gather > 2 * first, "there are no more gather rays");
}

/// A decision on where noise needs samples runs the denoiser, so it is made only if there is time for it. Without it
/// the render is not complete, and a note says that its noise is not known.
#[test]
fn decisions_by_noise_fit_the_time() {
    let settings = settings(64).with(|s| (s.image.noise, s.image.denoise) = (Some(1e-6), Denoise::Statistical));
    let denoiser = Denoiser::new(Denoise::Statistical, None).unwrap();
    let mut renderer = renderer(&settings);
    for samples in 1..=8 {
        assert!(renderer.wants_samples_within(&denoiser, 0.0).unwrap(), "no decision is due before the eighth sample");
        assert_eq!(renderer.render_up_to(1).unwrap().samples, samples);
    }
    assert!(!renderer.wants_samples_within(&denoiser, 0.0).unwrap() && !renderer.is_complete());
    let note = renderer.note_on_noise().unwrap();
    assert!(note.contains("is not known: the render ended before an estimate"), "{note}");
    assert!(renderer.wants_samples_within(&denoiser, 1e9).unwrap());
    let note = renderer.note_on_noise().unwrap();
    assert!(note.contains("a noise of 1e-6 was not reached everywhere"), "{note}");
}

/// Denoisers that take too long first lose the estimate of errors, and then go.
#[test]
fn denoisers_fit_the_time() {
    if !gpu().is_software() {
        return;
    }
    let pixels = 48 * 48;
    let new = || Denoiser::new(Denoise::Statistical, None).unwrap();
    let whole = new().seconds(gpu(), pixels);
    assert!(whole > 0.0);
    let mut renderer = renderer(&settings(2).with(|s| s.image.denoise = Denoise::Statistical));
    renderer.render_within(1e9).unwrap();
    renderer.render_within(1e9).unwrap();
    // `whole` is three runs of the filter, which are kept if they take two thirds of the time or less: from 3/2 on.
    // A single run is kept if it fits the time: from 1/3 on.
    for (share, is_changed, is_denoised, has_error) in
        [(1.51, false, true, true), (1.49, true, true, false), (0.34, true, true, false), (0.33, true, false, false)]
    {
        let mut denoiser = new();
        assert_eq!(denoiser.fit(gpu(), pixels, share * whole), is_changed, "{share}");
        assert!(denoiser.seconds(gpu(), pixels) <= share * whole, "{share}");
        let image = renderer.denoised_image(&denoiser).unwrap();
        assert_eq!(image.channel("denoised.R").is_some(), is_denoised, "{share}");
        assert_eq!(image.channel("error").is_some(), has_error, "{share}");
    }
}

/// `path` is used if the first sample of the default technique would come too late, on a software device, and if no
/// setting is requested that `path` does not support.
#[test]
fn the_technique_fits_the_time() {
    let is_software = gpu().is_software();
    for name in ["box.glb", "still_life.glb", "lamps.glb"] {
        let scene = load(name);
        let camera = scene.cameras[0].clone();
        let plain = settings(4).with(|s| s.technique = Technique::default());
        let technique = |settings: &Settings, within: Option<f64>| {
            let Choice { technique, reason, sampling, .. } = Choice::new(gpu(), &scene, &camera, settings, within, 1.0);
            assert_eq!(reason.is_some(), technique != Technique::default(), "{name}");
            // Of the times below, those of 5 s and more suffice for estimates of noise.
            let shares =
                is_software && within.is_some_and(|seconds| seconds > 4.0) && technique == Technique::default();
            assert_eq!(sampling, if shares { Sampling::Adaptive } else { Sampling::Uniform }, "{name}, {within:?}");
            technique
        };
        let short = if is_software { Technique::PATH } else { Technique::default() };
        for (within, expected) in
            [(None, Technique::default()), (Some(1e6), Technique::default()), (Some(0.0), short), (Some(-1.0), short)]
        {
            assert_eq!(technique(&plain, within), expected, "{name}, {within:?}");
        }
        // A large image takes longer than a small one.
        let large = plain.clone().with(|s| (s.image.width, s.image.height) = (8192, 8192));
        assert_eq!(technique(&large, Some(5.0)), short, "{name}");
        assert_eq!(technique(&plain, Some(5.0)), Technique::default(), "{name}");
        for asked in [
            plain.clone().with(|s| s.image.aovs = vec![Aov::Shadow]),
            plain.clone().with(|s| s.visibility_map.photons_per_light = Some(4096)),
            plain.clone().with(|s| s.indirect.photons = Some(4096)),
            plain.clone().with(|s| s.indirect.irradiance_cache.gather_rays = Some(64)),
            plain.clone().with(|s| s.indirect.irradiance_cache.accuracy = 0.1),
            plain.clone().with(|s| s.visibility_map.nearest = 32),
            plain.clone().with(|s| s.shadow_rays.samples = 16),
        ] {
            assert_eq!(technique(&asked, Some(0.0)), Technique::default(), "{name}");
        }
    }
}

/// A model before an empty background is rendered by paths until there are five times the first sample of the default
/// technique, under a sky until there are 25, and its pixels share samples out sooner.
#[test]
fn paths_render_models_by_themselves_for_longer() {
    let scene = load("box.glb");
    let mut under_a_sky = scene.clone();
    under_a_sky.lights.clear();
    let sky = Panorama { width: 2, height: 1, texels: vec![[0.5; 3], [1.0; 3]] };
    under_a_sky.set_environment(Arc::new(sky), 0.0, 1.0).unwrap();
    let room = scene.cameras[0].clone();
    let mut far = room.clone();
    far.position += 10.0 * far.axes[2];
    let plain = settings(Settings::UNLIMITED_SPP).with(|s| s.technique = Technique::default());
    let choice = |scene: &Scene, camera: &Camera, settings: &Settings, within: f64| {
        let Choice { technique, reason, sampling, .. } = Choice::new(gpu(), scene, camera, settings, Some(within), 1.0);
        assert_eq!(reason.is_some(), technique == Technique::PATH);
        assert!(reason.is_none_or(|reason| reason.contains("empty")));
        (technique, sampling)
    };
    // A first sample of so small an image is expected after 0.26 s.
    // These are 1.5 and 4.2 times that: `path` shares samples out from 1.7 times on.
    let (short, long) = (0.4, 1.1);
    let usual = (Technique::default(), Sampling::Adaptive);
    let shared = (Technique::PATH, Sampling::Adaptive);
    if !gpu().is_software() {
        assert_eq!(choice(&scene, &far, &plain, long), (usual.0, Sampling::Uniform));
        return;
    }
    assert_eq!(choice(&scene, &far, &plain, short), (Technique::PATH, Sampling::Uniform));
    assert_eq!(choice(&scene, &far, &plain, long), shared);
    assert_eq!(choice(&scene, &far, &plain, 5.0), usual);
    assert_eq!(choice(&under_a_sky, &far, &plain, 5.0), shared);
    assert_eq!(choice(&under_a_sky, &far, &plain, 10.0), usual);
    for scene in [&scene, &under_a_sky] {
        assert_eq!(choice(scene, &room, &plain, long), usual);
        // With few samples each one counts; photons that are requested are emitted.
        let few = plain.clone().with(|s| s.image.spp = 32);
        let photons = plain.clone().with(|s| s.visibility_map.photons_per_light = Some(4096));
        assert_eq!([few, photons].map(|settings| choice(scene, &far, &settings, long)), [usual; 2]);
    }
}

/// A first sample that just fits is used in a room, but not on a machine that is known to be slow, and in open scenes
/// only with time to spare.
#[test]
fn a_first_sample_that_just_fits_is_for_rooms() {
    if !gpu().is_software() {
        return;
    }
    let plain = settings(Settings::UNLIMITED_SPP).with(|s| s.technique = Technique::default());
    for (name, is_room) in [("box.glb", true), ("sphere.glb", false)] {
        let scene = load(name);
        let camera = scene.cameras[0].clone();
        let first_sample = |settings: &Settings| Choice::new(gpu(), &scene, &camera, settings, None, 1.0).first_sample;
        let expected = first_sample(&plain).unwrap();
        let takes_paths = |times: f64, slowness: f64| {
            let choice = Choice::new(gpu(), &scene, &camera, &plain, Some(times * expected), slowness);
            assert!(choice.reason.is_none_or(|reason| reason.contains("before the first image")));
            choice.technique == Technique::PATH
        };
        // Paths are used below 0.9 times the time of the first sample in rooms, and below 1.25 times in open scenes.
        assert!(takes_paths(0.8, 1.0) && takes_paths(1.6, 2.0) && takes_paths(8.0, 10.0), "{name}");
        assert_eq!([takes_paths(1.0, 1.0), takes_paths(2.0, 2.0)], [!is_room; 2], "{name}");
        assert!(!takes_paths(1.5, 1.0) && !takes_paths(3.0, 2.0) && !takes_paths(0.7, 0.5), "{name}");
        let photons = plain.clone().with(|s| s.indirect.photons = Some(4096));
        assert_eq!(first_sample(&photons), None, "{name}");
    }
}

/// With many lights each point samples a few, so a hundred thousand lights leave time for photons.
#[test]
fn many_lights_leave_time_for_photons() {
    let mut scene = load("box.glb");
    let camera = scene.cameras[0].clone();
    scene.lights = vec![scene.lights[0].clone(); 100_000];
    let settings = settings(4).with(|s| {
        s.technique = Technique::default();
        (s.image.width, s.image.height) = (256, 256);
    });
    let choice = Choice::new(gpu(), &scene, &camera, &settings, Some(5.0), 1.0);
    assert_eq!((choice.technique, choice.reason), (Technique::default(), None));
    // Where each block of pixels is to reach a noise, that decides.
    let noise = settings.with(|s| s.image.noise = Some(0.01));
    assert_eq!(Choice::new(gpu(), &scene, &camera, &noise, Some(5.0), 1.0).sampling, Sampling::Uniform);
}
