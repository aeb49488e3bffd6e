//! Devices that are lost in the middle of a render, or have no memory.

use std::cell::Cell;
use std::path::Path;
use std::thread;
use std::time::Duration;

use penumbra::internal::gpu::{DeviceChoice, Features, Gpu, Kernel, Resources, compose};
use penumbra::internal::render::recovery::{self, Failure};
use penumbra::internal::scene::ImportOptions;
use penumbra::{Aov, Camera, Error, Image, Renderer, Result, Scene, Settings, Technique};

fn open() -> Result<Gpu> {
    let choice = std::env::var("PENUMBRA_DEVICE").map_or(DeviceChoice::Software, |name| name.parse().unwrap());
    Gpu::open(&choice)
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
        s.visibility_map.photons_per_light = 4096;
        s.indirect.photons = 4096;
        s.visibility_map.audit = 0.25;
        s.image.aovs = Aov::ALL.to_vec();
    })
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

/// Renders `samples` samples with nothing in the way.
fn undisturbed(settings: &Settings, samples: u32) -> (Image, penumbra::Statistics) {
    let ((scene, camera), gpu) = (subject(), open().unwrap());
    let mut renderer = Renderer::new(&gpu, scene, &camera, settings).unwrap();
    while renderer.samples() < samples {
        renderer.render_batch().unwrap();
    }
    (renderer.image().unwrap(), renderer.statistics().unwrap())
}

/// Renders with `disturb` called before every batch and before the image is read.
fn disturbed(
    settings: &Settings,
    open_another: impl Fn() -> Result<Gpu>,
    disturb: impl Fn(&Renderer<'_>),
) -> std::result::Result<(Image, penumbra::Statistics), Failure> {
    let (scene, camera) = subject();
    recovery::render(
        open().unwrap(),
        open_another,
        |gpu| Renderer::new(gpu, scene.clone(), &camera, settings),
        None,
        |renderer| {
            while renderer.samples() < settings.image.spp {
                disturb(renderer);
                renderer.render_batch()?;
            }
            disturb(renderer);
            Ok((renderer.image()?, renderer.statistics()?))
        },
    )
}

/// Lost before the first sample, after the pilot, twice in the middle, and before the image is read: the image and the
/// counts are those of a render that nothing happened to.
#[test]
fn a_render_goes_on_where_its_device_is_lost() {
    for technique in [Technique::ShadowPhotons, Technique::Path] {
        let settings = settings(technique);
        let (image, statistics) = undisturbed(&settings, 20);
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

/// As a driver does it: from another thread, at any moment of a batch.
#[test]
fn a_device_may_be_lost_while_it_works() {
    let settings = settings(Technique::ShadowPhotons);
    let (image, _) = undisturbed(&settings, 20);
    let (scene, camera) = subject();
    for milliseconds in [0, 3, 20] {
        let lost = Cell::new(false);
        let rendered = recovery::render(
            open().unwrap(),
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
                    renderer.image()
                })
            },
        );
        assert_same(&image, &rendered.unwrap_or_else(|failure| panic!("{milliseconds}: {}", failure.error)));
    }
}

/// A device that is lost at the same place again and again ends the render, and so does one that cannot be replaced: with
/// the image of the samples that were kept, and a checkpoint that brings the rest.
#[test]
fn what_cannot_be_recovered_is_saved() {
    let settings = settings(Technique::ShadowPhotons);
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
        let samples = salvage.checkpoint.samples();
        assert!(samples >= 1 && salvage.statistics.samples == samples);
        assert_same(&undisturbed(&settings, samples).0, &salvage.image);

        let ((scene, camera), gpu) = (subject(), open().unwrap());
        let mut renderer = Renderer::new(&gpu, scene, &camera, &settings).unwrap();
        renderer.resume_from(&salvage.checkpoint).unwrap();
        while renderer.samples() < 20 {
            renderer.render_batch().unwrap();
        }
        assert_same(&undisturbed(&settings, 20).0, &renderer.image().unwrap());
    }
    // Before there is a sample there is nothing to save.
    let at_once = |renderer: &Renderer<'_>| renderer.gpu().lose();
    assert!(disturbed(&settings, open, at_once).err().unwrap().salvage.is_none());
}

/// What is timed begins anew, whole, on another device; where that is lost too, again and again, it ends.
#[test]
fn work_begins_anew_where_its_device_is_lost() {
    let settings = settings(Technique::ShadowPhotons);
    let (scene, camera) = subject();
    let work = |losses: u32| {
        let (mut gpu, begun) = (open().unwrap(), Cell::new(0));
        let done = recovery::anew(&mut gpu, open, |gpu| {
            begun.set(begun.get() + 1);
            let mut renderer = Renderer::new(gpu, scene.clone(), &camera, &settings)?;
            while renderer.samples() < 4 {
                renderer.render_at_most(1)?;
                if begun.get() <= losses && renderer.samples() == 2 {
                    gpu.lose();
                }
            }
            renderer.image()
        });
        (done, begun.get())
    };
    let image = work(0).0.unwrap();
    for losses in [1, 3] {
        let (done, begun) = work(losses);
        assert_same(&image, &done.unwrap());
        assert_eq!(begun, losses + 1);
    }
    let (done, begun) = work(u32::MAX);
    assert!(matches!(done, Err(Error::DeviceLost { .. })) && begun == 4);
}

/// A checkpoint is of one scene and its settings, in memory as in a file.
#[test]
fn a_checkpoint_of_something_else_is_refused() {
    let ((scene, camera), gpu) = (subject(), open().unwrap());
    let settings = settings(Technique::Path);
    let checkpoint = Renderer::new(&gpu, scene.clone(), &camera, &settings).unwrap().checkpoint().unwrap();
    let other = settings.with(|s| s.image.seed = 1);
    let error = Renderer::new(&gpu, scene, &camera, &other).unwrap().resume_from(&checkpoint).unwrap_err();
    assert!(error.to_string().contains("`image.seed`"), "{error}");
}

/// Whatever is asked of a device that is lost is an error: no panic, no wait without end, nothing that looks like a result.
#[test]
fn a_lost_device_answers_with_errors() {
    let gpu = open().unwrap();
    let before = gpu.upload("test/before", &[1u32; 1000]).unwrap();
    let source = "
@group(0) @binding(0) var<storage, read_write> numbers: array<u32>;
@compute @workgroup_size(64) fn add(@builtin(global_invocation_id) id: vec3u) { numbers[id.x] += 1u; }";
    let composed = compose::compose_source("add", source, &Features::default()).unwrap();
    let kernel = Kernel::new(&gpu, &composed, &[], &[]).unwrap();
    let sets = Resources::new().with("numbers", &before);
    let bound = kernel.bind(&gpu, "add", &[&sets]).unwrap();
    gpu.lose();
    let refused = |what: &str, error: Option<Error>| {
        let error = error.unwrap_or_else(|| panic!("{what} works on a lost device"));
        assert!(matches!(error, Error::DeviceLost { .. }), "{what}: {error}");
        assert!(!error.to_string().contains('\n'), "{what}: {error}");
    };
    refused("buffer", gpu.buffer::<u32>("test/new", 10).err());
    refused("upload", gpu.upload("test/new", &[1u32; 10]).err());
    refused("read", gpu.read::<u32>(&before, 10).err());
    gpu.write(&before, &[2u32; 10]);
    let mut frame = gpu.frame("test");
    frame.run(&bound, 1000, &[0u32; 0]);
    refused("submit", frame.submit().err());
    refused("wait", gpu.wait("test").err());
    refused("compile", Kernel::new(&gpu, &composed, &[], &[]).err());
    refused("bind", kernel.bind(&gpu, "add", &[&sets]).err());
    let (scene, camera) = subject();
    refused("render", Renderer::new(&gpu, scene, &camera, &settings(Technique::ShadowPhotons)).err());
}
