//! Sessions without a window.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::mpsc::channel;
use std::time::Duration;

use glam::DVec3;
use kernel_kit::{DeviceChoice, Gpu};
use penumbra::internal::scene::LookAt;
use penumbra::internal::view::{Command, Event, Overlay, Shown, Viewpoint, Worker};
use penumbra::settings::LightSampling;
use penumbra::{Image, ImportOptions, Renderer, Scene, Settings, Technique};

use crate::device::gpu;
use crate::setup::{BOX, SPHERE, choices, folder, session, settings, settle, state};

/// A view of the box from the right.
const FROM_THE_RIGHT: LookAt = LookAt { from: DVec3::new(0.8, 0.7, 2.2), at: DVec3::new(0.0, 0.4, 0.0), fov: 35.0 };

fn render(file: &str, view: Option<&LookAt>, settings: &Settings) -> Image {
    let scene = Scene::load(file, &ImportOptions::default()).unwrap();
    let camera = view.map_or_else(|| scene.cameras[0].clone(), |view| scene.look_at(view).unwrap());
    let mut renderer = Renderer::new(gpu(), scene, &camera, settings).unwrap();
    while renderer.samples() < settings.image.spp {
        renderer.render_batch().unwrap();
    }
    renderer.image().unwrap()
}

fn bytes(image: &Image) -> Vec<u8> {
    let shown = choices(settings()).display;
    let file = folder();
    let path = file.path().join("a.png");
    image.write_png(&path, shown.view, shown.exposure).unwrap();
    image_bytes(&path)
}

fn image_bytes(path: &Path) -> Vec<u8> {
    let picture = image::open(path).unwrap();
    picture.into_rgb8().into_raw()
}

/// The first picture has the bits of a render, and so has one after movements of the camera, in other sizes meanwhile.
#[test]
fn a_picture_after_movements_has_the_bits_of_a_render() {
    for technique in [Technique::SHADOW_PHOTONS, Technique::PATH] {
        let settings = settings().with(|s| s.technique = technique);
        let mut session = session(gpu(), BOX.as_ref(), settings.clone());
        let first = settle(&mut session, []);
        assert!(first.is_complete && first.samples == 4);
        assert!(*first.pixels == bytes(&render(BOX, None, &settings)), "the first picture, by {technique}");
        let moves = (0..6).map(|_| Command::Orbit([0.05, 0.02]));
        let moved = settle(&mut session, moves);
        assert!(matches!(moved.picture.eye.viewpoint, Viewpoint::Placed(_)));
        assert_ne!(moved.pixels, first.pixels);
        let there = settle(&mut session, [Command::Camera(Viewpoint::Placed(FROM_THE_RIGHT))]);
        assert!(there.is_complete);
        assert!(*there.pixels == bytes(&render(BOX, Some(&FROM_THE_RIGHT), &settings)), "moved, by {technique}");
    }
}

/// `Renderer::look` leaves nothing of the view before: not its samples, its audits, or its stage of indirect light.
#[test]
fn another_look_of_a_renderer_has_the_bits_of_a_new_one() {
    let scene = Scene::load(SPHERE, &ImportOptions::default()).unwrap();
    let view = scene.frame_camera();
    // 64 samples reach the second stage; without fine cells, audits repair the map.
    for (spp, fine_cells) in [(64, true), (8, false)] {
        let settings = Settings::builder().size(24, 20).spp(spp).fine_cells(fine_cells).build().unwrap();
        let complete = |renderer: &mut Renderer<'_>| {
            while renderer.samples() < spp {
                renderer.render_batch().unwrap();
            }
            renderer.image().unwrap().rgb().unwrap().map(<[f32]>::to_vec)
        };
        let new = |camera| Renderer::new(gpu(), scene.clone(), camera, &settings).unwrap();
        let mut looking = new(&scene.cameras[0]);
        let first = complete(&mut looking);
        looking.look(&view, [12, 10]).unwrap();
        looking.render_batch().unwrap();
        looking.look(&view, [24, 20]).unwrap();
        assert_eq!(looking.samples(), 0);
        let second = complete(&mut looking);
        assert_ne!(first, second);
        assert!(second == complete(&mut new(&view)), "{spp} samples");
        looking.look(&scene.cameras[0], [24, 20]).unwrap();
        assert!(first == complete(&mut looking), "and back, {spp} samples");
    }
}

/// While the camera moves, the picture is smaller.
#[test]
fn a_moving_picture_is_smaller() {
    let mut session = session(gpu(), BOX.as_ref(), settings());
    settle(&mut session, []);
    session.command(Command::Orbit([0.1, 0.0]));
    let (snapshot, worked) = session.step().unwrap();
    let snapshot = snapshot.unwrap();
    assert!(worked && snapshot.samples == 1 && snapshot.size[0] < 48, "{:?}", snapshot.size);
    assert_eq!(snapshot.pixels.len(), (snapshot.size[0] * snapshot.size[1] * 3) as usize);
    assert_eq!(settle(&mut session, []).size, [48, 36]);
}

/// Each overlay shows something, and none changes the picture.
#[test]
fn overlays_leave_the_picture() {
    let mut session = session(gpu(), BOX.as_ref(), settings());
    let picture = settle(&mut session, []);
    let mut seen = vec![picture.pixels.clone()];
    let show = |overlay| {
        let mut choices = choices(settings());
        choices.display = Shown { overlay, ..choices.display };
        Command::Choose(Box::new(choices))
    };
    for overlay in Overlay::ALL {
        // A raw picture has no estimated error.
        if [Overlay::Picture, Overlay::Error].contains(&overlay) {
            continue;
        }
        let shown = settle(&mut session, [show(overlay)]);
        assert!(!seen.contains(&shown.pixels), "{overlay:?} is like another");
        assert!(shown.pixels.iter().any(|x| *x > 0), "{overlay:?} is black");
        seen.push(shown.pixels);
    }
    assert!(settle(&mut session, [show(Overlay::Picture)]).pixels == picture.pixels);
}

/// A pixel tells its surface, and with the overlay of classes what photons say.
#[test]
fn a_picked_pixel_tells_its_surface_and_its_lights() {
    let mut session = session(gpu(), BOX.as_ref(), settings());
    let floor = settle(&mut session, [Command::Pick([0.5, 0.97])]).picked.unwrap();
    let hit = floor.hit.unwrap();
    assert!(hit.normal.unwrap().y > 0.99, "{hit:?}");
    assert!(floor.lights.is_empty());
    let mut choices = choices(settings());
    choices.display.overlay = Overlay::Classes;
    settle(&mut session, [Command::Choose(Box::new(choices))]);
    let floor = settle(&mut session, [Command::Pick([0.5, 0.97])]).picked.unwrap();
    let [light] = floor.lights.as_slice() else { panic!("{floor:?}") };
    assert!(["lit", "boundary"].contains(&light.class), "{light:?}");
    assert!(light.photons[0] > 0.0 && light.visibility > 0.2, "{light:?}");
}

/// A point that is framed comes to the centre.
#[test]
fn a_framed_point_is_in_the_centre() {
    let mut session = session(gpu(), BOX.as_ref(), settings());
    let before = settle(&mut session, [Command::Pick([0.3, 0.8])]).picked.unwrap().hit.unwrap();
    let framed = settle(&mut session, [Command::FrameAt([0.3, 0.8]), Command::Pick([0.5, 0.5])]);
    let after = framed.picked.unwrap().hit.unwrap();
    // Positions are rounded to a millionth of the scene's size.
    assert!(before.position.distance(after.position) < 1e-4, "{before:?} {after:?}");
    let all = settle(&mut session, [Command::FrameAll]);
    let Viewpoint::Placed(view) = all.picture.eye.viewpoint else { panic!("{all:?}") };
    assert!(view.from.distance(view.at) > after.depth, "the whole scene is seen from farther away");
}

/// A broken file leaves the last picture and a message; once it is right again, the view is still there.
#[test]
fn a_broken_file_keeps_the_picture() {
    let folder = folder();
    let file = folder.path().join("scene.glb");
    fs::copy(BOX, &file).unwrap();
    let mut session = session(gpu(), &file, settings());
    let placed = Command::Camera(Viewpoint::Placed(FROM_THE_RIGHT));
    let first = settle(&mut session, [placed]);
    fs::write(&file, "broken").unwrap();
    let broken = settle(&mut session, [Command::Reload]);
    assert!(broken.message.unwrap().contains("scene.glb"));
    assert_eq!(broken.pixels, first.pixels);
    fs::copy(SPHERE, &file).unwrap();
    let other = settle(&mut session, [Command::Reload]);
    assert_eq!(other.message, None);
    assert_ne!(other.pixels, first.pixels);
    assert_eq!(other.picture.eye.viewpoint, Viewpoint::Placed(FROM_THE_RIGHT));
    fs::copy(BOX, &file).unwrap();
    assert_eq!(settle(&mut session, [Command::Reload]).pixels, first.pixels);
}

/// Another scene begins with its own camera; a missing one leaves the picture.
#[test]
fn another_scene_replaces_the_first() {
    let mut session = session(gpu(), BOX.as_ref(), settings());
    let first = settle(&mut session, [Command::Camera(Viewpoint::Placed(FROM_THE_RIGHT))]);
    let missing = settle(&mut session, [Command::Open(PathBuf::from("missing.glb"))]);
    assert!(missing.message.unwrap().contains("missing.glb"));
    assert_eq!(missing.pixels, first.pixels);
    let sphere = settle(&mut session, [Command::Open(SPHERE.into())]);
    assert_eq!((sphere.message, sphere.picture.eye.viewpoint), (None, Viewpoint::Given));
    assert!(*sphere.pixels == bytes(&render(SPHERE, None, &settings())));
}

/// Settings that cannot be rendered leave a message; others go on.
#[test]
fn settings_that_contradict_leave_a_message() {
    let mut session = session(gpu(), BOX.as_ref(), settings());
    let first = settle(&mut session, []);
    let wrong = settings().with(|s| {
        s.technique = Technique::PATH;
        s.light_sampling.strategy = Some(LightSampling::All);
    });
    let refused = settle(&mut session, [Command::Choose(Box::new(choices(wrong)))]);
    assert!(refused.message.unwrap().contains("light_sampling"));
    assert_eq!(refused.pixels, first.pixels);
    let right = settle(&mut session, [Command::Choose(Box::new(choices(settings())))]);
    assert_eq!((right.message, right.pixels), (None, first.pixels));
}

/// The picture is resized, to next to nothing and back, and saved.
#[test]
fn a_resized_picture_is_rendered_and_saved() {
    let mut session = session(gpu(), BOX.as_ref(), settings());
    let first = settle(&mut session, []);
    assert_eq!(settle(&mut session, [Command::Resize([1, 1])]).size, [1, 1]);
    let folder = folder();
    let (png, exr) = (folder.path().join("a.png"), folder.path().join("a.exr"));
    let again = [Command::Resize([48, 36])];
    assert_eq!(settle(&mut session, again).pixels, first.pixels);
    let saved = settle(&mut session, [Command::Save(png.clone()), Command::Save(exr.clone())]);
    assert!(saved.message.unwrap().contains("a.exr"));
    assert!(image_bytes(&png) == *first.pixels);
    assert!(Image::read(&exr).unwrap().channel("albedo.R").is_some());
    let refused = settle(&mut session, [Command::Save(folder.path().join("a.txt"))]);
    assert!(refused.message.unwrap().contains(".exr"));
}

/// A lost device is replaced, and the picture has the same bits.
#[test]
fn a_lost_device_is_replaced() {
    let choice: DeviceChoice = std::env::var("PENUMBRA_DEVICE").unwrap_or("software".into()).parse().unwrap();
    let open = move || Ok(Arc::new(Gpu::open(&choice)?));
    let gpu = open().unwrap();
    let (events, heard) = channel();
    let tell = move |event| events.send(event).unwrap();
    let worker = Worker::start(gpu.clone(), state(BOX.as_ref(), settings()), open, tell);
    let complete = |replaced: &mut bool| loop {
        match heard.recv_timeout(Duration::from_secs(60)).unwrap() {
            Event::Picture => {}
            Event::Device(_) => *replaced = true,
            Event::Failed(problem) => panic!("{problem}"),
        }
        if let Some(snapshot) = worker.take().filter(|snapshot| snapshot.is_complete) {
            return snapshot;
        }
    };
    let mut replaced = false;
    let first = complete(&mut replaced);
    assert!(!replaced);
    gpu.lose();
    worker.send(Command::Camera(Viewpoint::Placed(FROM_THE_RIGHT)));
    worker.send(Command::Camera(Viewpoint::Given));
    // A reload needs the device.
    worker.send(Command::Reload);
    let again = complete(&mut replaced);
    assert!(replaced && again.pixels == first.pixels);
}

/// The device's memory stays level over a thousand movements.
#[test]
fn a_thousand_movements_leave_memory_level() {
    // A device of its own: other tests run meanwhile.
    let choice: DeviceChoice = std::env::var("PENUMBRA_DEVICE").unwrap_or("software".into()).parse().unwrap();
    let gpu = Gpu::open(&choice).unwrap();
    let settings = Settings::builder().size(16, 12).spp(1).max_bounces(0).build().unwrap();
    let mut session = session(&gpu, BOX.as_ref(), settings);
    let mut moved = |count: usize| {
        for i in 0..count {
            session.command(Command::Orbit([0.01, if i % 2 == 0 { 0.01 } else { -0.01 }]));
            session.step().unwrap();
        }
        gpu.wait("test").unwrap();
        gpu.device.generate_allocator_report().expect("Vulkan reports its memory").total_allocated_bytes
    };
    let (before, after) = (moved(100), moved(1000));
    // Tables in textures come and go in other sizes, and the report is of blocks.
    assert!(after < before + before / 2, "{before} bytes, then {after}");
}
