//! Devices that are lost during a render.

use std::cell::Cell;
use std::path::Path;
use std::thread;
use std::time::Duration;

use kernel_kit::{DeviceChoice, Gpu, Resources};
use penumbra::internal::kernels::compose_source;
use penumbra::internal::passes::new_kernel;
use penumbra::internal::render::recovery::{self, Failure, Salvage};
use penumbra::internal::scene::ImportOptions;
use penumbra::internal::specialisation::features::Features;
use penumbra::settings::Denoise;
use penumbra::{Aov, Camera, Denoiser, Error, Image, Renderer, Result, Scene, Settings, Technique};

use crate::program::oidn_library;

fn open() -> Result<Gpu> {
    let choice = std::env::var("PENUMBRA_DEVICE").map_or(DeviceChoice::Software, |name| name.parse().unwrap());
    Ok(Gpu::open(&choice)?)
}

fn subject() -> (Scene, Camera) {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes/box.glb");
    let scene = Scene::load(&file, &ImportOptions::default()).unwrap();
    let camera = scene.cameras[0].clone();
    (scene, camera)
}

fn settings(technique: Technique) -> Settings {
    Settings::default().with(|s| {
        s.technique = technique;
        s.image.width = 24;
        s.image.height = 16;
        s.image.spp = 20;
        s.visibility_map.photons_per_light = Some(4096);
        s.indirect.photons = Some(4096);
        s.visibility_map.audit = 0.25;
        s.image.aovs = Aov::ALL.to_vec();
    })
}

/// The denoiser of the settings.
fn denoiser(settings: &Settings) -> Denoiser {
    match settings.image.denoise {
        Denoise::None => Denoiser::default(),
        denoise => Denoiser::new(denoise, Some(&oidn_library())).unwrap(),
    }
}

fn bits(image: &Image) -> Vec<(&str, Vec<u32>)> {
    let bits = |samples: &[f32]| samples.iter().map(|x| x.to_bits()).collect();
    image.channels.iter().map(|channel| (channel.name.as_str(), bits(&channel.samples))).collect()
}

#[track_caller]
fn assert_same(a: &Image, b: &Image) {
    for ((name, a), (_, b)) in bits(a).into_iter().zip(bits(b)) {
        assert!(a == b, "{name} differs");
    }
}

/// Renders `samples` samples without a fault.
fn undisturbed(settings: &Settings, samples: u32) -> (Image, penumbra::Statistics) {
    let ((scene, camera), gpu) = (subject(), open().unwrap());
    let mut renderer = Renderer::new(&gpu, scene, &camera, settings).unwrap();
    while renderer.samples() < samples {
        renderer.render_batch().unwrap();
    }
    (renderer.denoised_image(&denoiser(settings)).unwrap(), renderer.statistics().unwrap())
}

/// Renders and calls `disturb` before every batch and before the image is read.
fn disturbed(
    settings: &Settings,
    open_another: impl Fn() -> Result<Gpu>,
    disturb: impl Fn(&Renderer<'_>),
) -> std::result::Result<(Image, penumbra::Statistics), Failure> {
    let (scene, camera) = subject();
    recovery::render(
        &mut open().unwrap(),
        open_another,
        |gpu| Renderer::new(gpu, scene.clone(), &camera, settings),
        None,
        |renderer| {
            while renderer.samples() < settings.image.spp {
                disturb(renderer);
                renderer.render_batch()?;
            }
            disturb(renderer);
            Ok((renderer.denoised_image(&denoiser(settings))?, renderer.statistics()?))
        },
    )
}

/// A render continues on another device if its device is lost: before the first sample, after the pilot, twice in the
/// middle, or before the image is read. The image and the counts are those of an undisturbed render.
#[test]
fn a_render_continues_after_a_lost_device() {
    let denoised = settings(Technique::SHADOW_PHOTONS).with(|s| s.image.denoise = Denoise::Auto);
    for settings in [settings(Technique::SHADOW_PHOTONS), settings(Technique::PATH), denoised] {
        let (image, statistics) = undisturbed(&settings, 20);
        assert_eq!(image.channel("error").is_some(), settings.image.denoise != Denoise::None);
        for lost_at in [&[0][..], &[1, 9], &[20]] {
            let losses = Cell::new(0);
            let lose = |renderer: &Renderer<'_>| {
                if lost_at.get(losses.get()).is_some_and(|samples| renderer.samples() >= *samples) {
                    losses.set(losses.get() + 1);
                    renderer.gpu().lose();
                }
            };
            let (found, counted) =
                disturbed(&settings, open, lose).unwrap_or_else(|failure| panic!("{}", failure.error));
            assert_same(&image, &found);
            assert_eq!((counted.points, counted.rays), (statistics.points, statistics.rays), "{lost_at:?}");
            assert_eq!(counted.conditioning.devices_lost, lost_at.len() as u64);
            assert!(counted.notes.iter().any(|note| note.contains("device was lost")), "{:?}", counted.notes);
            assert!(found.metadata.contains_key("penumbra:conditioning"));
        }
        assert!(!image.metadata.contains_key("penumbra:conditioning"));
    }
}

/// A device may be lost at any moment of a batch, from another thread, as drivers do it.
#[test]
fn a_device_may_be_lost_during_a_batch() {
    let settings = settings(Technique::SHADOW_PHOTONS);
    let (image, _) = undisturbed(&settings, 20);
    let (scene, camera) = subject();
    for milliseconds in [0, 3, 20] {
        let lost = Cell::new(false);
        let rendered = recovery::render(
            &mut open().unwrap(),
            open,
            |gpu| Renderer::new(gpu, scene.clone(), &camera, &settings),
            None,
            |renderer| {
                let gpu = renderer.gpu();
                thread::scope(|scope| {
                    if !lost.replace(true) {
                        scope.spawn(move || {
                            thread::sleep(Duration::from_millis(milliseconds));
                            gpu.lose();
                        });
                    }
                    while renderer.samples() < settings.image.spp {
                        renderer.render_batch()?;
                    }
                    Ok(renderer.image()?)
                })
            },
        );
        assert_same(&image, &rendered.unwrap_or_else(|failure| panic!("{milliseconds}: {}", failure.error)));
    }
}

/// A render that cannot recover saves its samples as an image, and a checkpoint to resume from. That is the case if a
/// device is lost repeatedly without progress, and if there is no replacement.
#[test]
fn a_render_that_cannot_recover_saves_its_samples() {
    let settings = settings(Technique::SHADOW_PHOTONS);
    let always = |renderer: &Renderer<'_>| {
        if renderer.samples() > 0 {
            renderer.gpu().lose();
        }
    };
    let never = || Err(Error::NoDevice("they are all gone".to_owned()));
    let failures = [
        (disturbed(&settings, open, always), "lost on purpose"),
        (disturbed(&settings, never, always), "they are all gone"),
    ];
    for (failed, word) in failures {
        let Err(Failure { error, salvage }) = failed else { panic!("{word}: it did not fail") };
        assert_eq!(error.exit_code(), 4, "{error}");
        assert!(error.to_string().contains(word) && !error.to_string().contains('\n'), "{error}");
        let salvage = salvage.expect("the pilot's sample was kept");
        let checkpoint = salvage.checkpoint.expect("it is of the state that was kept");
        let samples = checkpoint.samples();
        assert!(samples >= 1 && salvage.statistics.samples == samples);
        assert_same(&undisturbed(&settings, samples).0, &salvage.image);

        let ((scene, camera), gpu) = (subject(), open().unwrap());
        let mut renderer = Renderer::new(&gpu, scene, &camera, &settings).unwrap();
        renderer.resume_from(&checkpoint).unwrap();
        while renderer.samples() < 20 {
            renderer.render_batch().unwrap();
        }
        assert_same(&undisturbed(&settings, 20).0, &renderer.image().unwrap());
    }
    // Before the first sample there is nothing to save.
    let at_once = |renderer: &Renderer<'_>| renderer.gpu().lose();
    assert!(disturbed(&settings, open, at_once).err().unwrap().salvage.is_none());
}

/// A device that is lost while it denoises is replaced. If there is no other, the samples in hand are saved, not those
/// that were kept before.
#[test]
fn samples_in_hand_are_saved_if_denoising_fails() {
    let settings = settings(Technique::SHADOW_PHOTONS).with(|s| s.image.denoise = Denoise::Statistical);
    let (image, _) = undisturbed(&settings, 20);
    let (scene, camera) = subject();
    let render = |losses: u32, another: &dyn Fn() -> Result<Gpu>| {
        let lost = Cell::new(0);
        recovery::render(
            &mut open().unwrap(),
            another,
            |gpu| Renderer::new(gpu, scene.clone(), &camera, &settings),
            None,
            |renderer| {
                while renderer.samples() < 20 {
                    renderer.render_batch()?;
                }
                let (mut image, statistics) = (renderer.image()?, renderer.statistics()?);
                if lost.replace(lost.get() + 1) < losses {
                    renderer.gpu().lose();
                }
                match renderer.add_denoised(&mut image, &denoiser(&settings)) {
                    Ok(()) => Ok(image),
                    Err(error) => {
                        let salvage = Some(Box::new(Salvage { image, statistics, checkpoint: None }));
                        Err(Failure { error, salvage })
                    }
                }
            },
        )
    };
    assert_same(&image, &render(1, &open).unwrap_or_else(|failure| panic!("{}", failure.error)));
    let none = || Err(Error::NoDevice("they are all gone".to_owned()));
    for outcome in [render(1, &none), render(u32::MAX, &open)] {
        let Err(Failure { error, salvage }) = outcome else { panic!("it did not fail") };
        assert_eq!(error.exit_code(), 4, "{error}");
        let salvage = salvage.expect("the samples are in hand");
        assert!(salvage.statistics.samples == 20 && salvage.checkpoint.is_none(), "it was kept before");
        assert!(salvage.image.channel("G") == image.channel("G"));
    }
}

/// Timed work starts again from the beginning after a lost device, and fails after the fourth loss.
#[test]
fn timed_work_restarts_after_a_lost_device() {
    let settings = settings(Technique::SHADOW_PHOTONS);
    let (scene, camera) = subject();
    let work = |losses: u32| {
        let (mut gpu, started) = (open().unwrap(), Cell::new(0));
        let done = recovery::anew(&mut gpu, open, |gpu| {
            started.set(started.get() + 1);
            let mut renderer = Renderer::new(gpu, scene.clone(), &camera, &settings)?;
            while renderer.samples() < 4 {
                renderer.render_up_to(1)?;
                if started.get() <= losses && renderer.samples() == 2 {
                    gpu.lose();
                }
            }
            renderer.image()
        });
        (done, started.get())
    };
    let image = work(0).0.unwrap();
    for losses in [1, 3] {
        let (done, started) = work(losses);
        assert_same(&image, &done.unwrap());
        assert_eq!(started, losses + 1);
    }
    let (done, started) = work(u32::MAX);
    assert!(matches!(done, Err(Error::DeviceLost { .. })) && started == 4);
}

/// A checkpoint in memory is refused for other settings, as one in a file is.
#[test]
fn a_checkpoint_of_other_settings_is_refused() {
    let ((scene, camera), gpu) = (subject(), open().unwrap());
    let settings = settings(Technique::PATH);
    let checkpoint = Renderer::new(&gpu, scene.clone(), &camera, &settings).unwrap().checkpoint().unwrap();
    let other = settings.with(|s| s.image.seed = 1);
    let error = Renderer::new(&gpu, scene, &camera, &other).unwrap().resume_from(&checkpoint).unwrap_err();
    assert!(error.to_string().contains("other settings: seed is 0, not 1"), "{error}");
}

/// Every operation on a lost device returns an error: no panic, no endless wait, no false result.
#[test]
fn a_lost_device_returns_errors() {
    let gpu = open().unwrap();
    let before = gpu.upload("test/before", &[1u32; 1000]).unwrap();
    let source = "
@group(0) @binding(0) var<storage, read_write> numbers: array<u32>;
@compute @workgroup_size(64) fn add(@builtin(global_invocation_id) id: vec3u) { numbers[id.x] += 1u; }";
    let composed = compose_source("add", source, &Features::default()).unwrap();
    let kernel = new_kernel(&gpu, &composed, &[], &[]).unwrap();
    let sets = Resources::new().with("numbers", &before);
    let bound = kernel.bind(&gpu, "add", &[&sets]).unwrap();
    gpu.lose();
    fn refused(what: &str, error: Option<impl Into<Error>>) {
        let error: Error = error.unwrap_or_else(|| panic!("{what} works on a lost device")).into();
        assert!(matches!(error, Error::DeviceLost { .. }), "{what}: {error}");
        assert!(!error.to_string().contains('\n'), "{what}: {error}");
    }
    refused("buffer", gpu.buffer::<u32>("test/new", 10).err());
    refused("upload", gpu.upload("test/new", &[1u32; 10]).err());
    refused("read", gpu.read::<u32>(&before, 10).err());
    gpu.write(&before, &[2u32; 10]);
    let mut frame = gpu.frame("test");
    frame.run(&bound, 1000, &[0u32; 0]);
    refused("submit", frame.submit().err());
    refused("wait", gpu.wait("test").err());
    refused("compile", new_kernel(&gpu, &composed, &[], &[]).err());
    refused("bind", kernel.bind(&gpu, "add", &[&sets]).err());
    let (scene, camera) = subject();
    refused("render", Renderer::new(&gpu, scene, &camera, &settings(Technique::SHADOW_PHOTONS)).err());
}
