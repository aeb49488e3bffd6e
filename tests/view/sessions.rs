//! Sessions without a window.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::mpsc::channel;
use std::time::Duration;

use glam::DVec3;
use kernel_kit::{DeviceChoice, Gpu};
use penumbra::internal::kernels::{CellKind, Class, ShownCell};
use penumbra::internal::memory::available_with_swap;
use penumbra::internal::render::photons::SurfacePoint;
use penumbra::internal::scene::{AddedCamera, Extent, LookAt, NO_LIGHT, with_camera};
use penumbra::internal::view::{Command, Event, Overlay, Picked, Session, Shown, Snapshot, Viewpoint, Worker, pick};
use penumbra::settings::{Aov, LightSampling};
use penumbra::{Error, Image, ImportOptions, Renderer, Scene, Settings, Technique};
use serde_json::json;

use crate::builder::File;
use crate::device::gpu;
use crate::setup::{BOX, SPHERE, choices, folder, session, settings, settle, state, state_with};

/// A view of the box from the right.
const FROM_THE_RIGHT: LookAt =
    LookAt::upright(DVec3::new(0.8, 0.7, 2.2), DVec3::new(0.0, 0.4, 0.0), Extent::FieldOfView(35.0));

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

/// The first picture is small. Neither visibility photons nor denoisers delay it; they are for the next picture.
#[test]
fn the_first_picture_comes_before_photons() {
    // At 64 x 48 pixels there are enough shadow rays for photons to pay off, and at a quarter of each side too.
    let settings = Settings::builder().size(64, 48).spp(16_384).build().unwrap();
    let mut session = session(gpu(), BOX.as_ref(), settings.clone());
    // As they are of a render.
    let scene = Scene::load(BOX, &ImportOptions::default()).unwrap();
    let mut new = Renderer::new(gpu(), scene.clone(), &scene.cameras[0], &settings).unwrap();
    while new.samples() < 2 {
        new.render_batch().unwrap();
    }
    let emitted = |photons: &[penumbra::internal::statistics::LightPhotons]| photons.iter().map(|p| p.emitted).sum();
    let photons = |session: &Session<'_>| emitted(&session.statistics().unwrap().unwrap().photons);
    let of_render: u64 = emitted(&new.statistics().unwrap().photons);
    let first = session.step().unwrap().0.unwrap();
    assert_eq!((first.size, first.samples, first.is_complete), ([16, 12], 1, false));
    assert!(first.pixels.iter().any(|x| *x > 0), "it is black");
    assert_eq!(photons(&session), 0, "before the first picture");
    let second = session.step().unwrap().0.unwrap();
    assert_eq!((second.size, second.samples), ([64, 48], 1));
    assert_eq!(photons(&session), 0, "before its first sample");
    session.step().unwrap();
    assert!(of_render > 0);
    assert_eq!(photons(&session), of_render, "of the full size");
}

/// `Renderer::set_view` leaves nothing of the view before: not its samples, its audits, or its stage of indirect light.
#[test]
fn another_view_of_a_renderer_has_the_bits_of_a_new_one() {
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
        let mut renderer = new(&scene.cameras[0]);
        let first = complete(&mut renderer);
        renderer.set_view(&view, [12, 10]).unwrap();
        renderer.render_batch().unwrap();
        renderer.set_view(&view, [24, 20]).unwrap();
        assert_eq!(renderer.samples(), 0);
        let second = complete(&mut renderer);
        assert_ne!(first, second);
        assert!(second == complete(&mut new(&view)), "{spp} samples");
        renderer.set_view(&scene.cameras[0], [24, 20]).unwrap();
        assert!(first == complete(&mut renderer), "and back, {spp} samples");
    }
}

/// A view that has no room in memory is refused, and the render of the last one goes on.
#[test]
fn a_view_without_room_leaves_the_last_one() {
    let aovs = [Aov::Direct, Aov::Indirect, Aov::Albedo, Aov::Normal, Aov::Position, Aov::Variance];
    // 22 channels in 4 bytes, and on a software device six sums in 32.
    let needed = u64::from(Settings::MAX_SIDE).pow(2) * (22 * 4 + if gpu().info.is_software() { 6 * 32 } else { 0 });
    if available_with_swap().is_none_or(|available| available >= needed) {
        eprintln!("this machine may have room for it");
        return;
    }
    let scene = Scene::load(SPHERE, &ImportOptions::default()).unwrap();
    let settings = Settings::builder().size(24, 20).spp(4).aovs(aovs).build().unwrap();
    let new = || Renderer::new(gpu(), scene.clone(), &scene.cameras[0], &settings).unwrap();
    let complete = |mut renderer: Renderer<'_>| {
        while renderer.samples() < 4 {
            renderer.render_batch().unwrap();
        }
        renderer.image().unwrap().rgb().unwrap().map(<[f32]>::to_vec)
    };
    let mut renderer = new();
    renderer.render_batch().unwrap();
    let side = Settings::MAX_SIDE;
    let refused =
        [renderer.set_view(&scene.frame_camera(), [side; 2]), renderer.preview(&scene.frame_camera(), [side; 2])];
    assert!(refused.iter().all(|refused| matches!(refused, Err(Error::Memory { .. }))), "{refused:?}");
    assert_eq!((renderer.samples(), renderer.settings().image.width), (1, 24));
    assert!(complete(renderer) == complete(new()));
}

/// An orthographic camera has no iris: its picture comes without depth of field.
#[test]
fn an_orthographic_camera_ends_depth_of_field() {
    let flat = LookAt { extent: Extent::Height(1.2), ..FROM_THE_RIGHT };
    let mut session = session(gpu(), BOX.as_ref(), settings());
    let blurred = settle(&mut session, [Command::Aperture(Some(0.5))]);
    assert_eq!(blurred.picture.eye.f_number, Some(0.5));
    let shown = settle(&mut session, [Command::Camera(Viewpoint::Placed(flat))]);
    assert_eq!((shown.picture.eye.f_number, &shown.message), (None, &None));
    assert!(*shown.pixels == bytes(&render(BOX, Some(&flat), &settings())));
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
    // The normal of a floor is Y, up to the rounding of f32.
    assert!(hit.normal.unwrap().y > 1.0 - 1e-6, "{hit:?}");
    assert!(floor.lights.is_empty());
    let mut choices = choices(settings());
    choices.display.overlay = Overlay::Classes;
    settle(&mut session, [Command::Choose(Box::new(choices))]);
    let floor = settle(&mut session, [Command::Pick([0.5, 0.97])]).picked.unwrap();
    let [light] = floor.lights.as_slice() else { panic!("{floor:?}") };
    assert!(["lit", "boundary"].contains(&light.class), "{light:?}");
    assert!(light.photons[0] > 0.0 && light.visibility > 0.2, "{light:?}");
}

fn add_camera(file: &mut File) {
    let lens = json!({ "type": "perspective", "perspective": { "yfov": 1.2, "aspectRatio": 1, "znear": 0.1 } });
    let camera = file.add("cameras", lens);
    file.add("nodes", json!({ "camera": camera }));
}

/// Instances are picked where they are, and the mesh that they share is nowhere else.
#[test]
fn instances_are_picked_where_they_are() {
    let mut file = File::new();
    let square = [[-1., -1., 0.], [1., -1., 0.], [1., 1., 0.], [-1., -1., 0.], [1., 1., 0.], [-1., 1., 0.]];
    // Meshes of two triangles are not shared.
    let mesh = file.mesh(&[square, square].concat(), json!({}));
    file.json["nodes"][mesh]["translation"] = json!([2, 0, -5]);
    file.add("nodes", json!({ "mesh": 0, "translation": [-2, 0, -7], "scale": [2, 2, 2] }));
    add_camera(&mut file);
    for max_copied_triangles in [Some(0), None] {
        let options = ImportOptions { max_copied_triangles, ..ImportOptions::default() };
        let scene = Scene::from_bytes(&file.glb(), Path::new("squares.glb"), &options).unwrap();
        assert_eq!(scene.instances.len(), if max_copied_triangles.is_some() { 2 } else { 0 });
        let depth = |x: f32| pick(&scene, &scene.cameras[0], [64, 64], [x, 0.5]).map(|hit| hit.depth);
        // Depths are below 8, where half of a unit in the last place of f32 is 2.4e-7.
        let is_near = |x: f32, expected: f64| depth(x).is_some_and(|depth| (depth - expected).abs() < 1e-5);
        // By similar triangles: at depth 5 a square from 1 to 3, at depth 7 one from -4 to 0.
        assert!(is_near(0.8, 5.0) && is_near(0.3, 7.0), "{:?} and {:?}", depth(0.8), depth(0.3));
        assert_eq!(depth(0.55), None, "between them");
    }
}

fn shows(overlay: Overlay) -> Command {
    let mut choices = choices(settings().with(|s| s.image.spp = 1));
    choices.display.overlay = overlay;
    Command::Choose(Box::new(choices))
}

/// The photons that are drawn about a point are those that the kernels counted there; Escape takes them away.
#[test]
fn a_picked_point_has_the_photons_that_decide_it() {
    let mut session = session(gpu(), BOX.as_ref(), settings());
    let unmarked = settle(&mut session, [shows(Overlay::Classes)]).pixels;
    let mut mixed = 0;
    for step in 0..24 {
        let at = [0.2 + 0.025 * step as f32, 0.9];
        let shown = settle(&mut session, [Command::Pick(at)]);
        assert_ne!(shown.pixels, unmarked, "nothing is drawn");
        let picked = shown.picked.unwrap();
        let nearest = picked.nearest.unwrap();
        let light = &picked.lights[0];
        // Where there are too few photons, or the light is behind the surface, nothing is counted.
        if ["dark", "unknown"].contains(&light.class) {
            continue;
        }
        assert_eq!(nearest.counts().map(|count| count as f32), light.photons, "at {at:?}: {light:?}");
        assert_eq!(nearest.photons.len(), settings().visibility_map.nearest as usize);
        let here = nearest.point.position;
        assert!(nearest.photons.iter().all(|photon| photon.position.distance(here) <= nearest.radius * 1.0001));
        mixed += usize::from(light.photons.iter().all(|count| *count > 0.0));
    }
    assert!(mixed > 0, "no boundary was picked");
    let shown = settle(&mut session, [Command::Unpick]);
    assert!(shown.picked.is_none() && shown.pixels == unmarked);
}

/// A point that is picked before the picture is there is that of the whole picture, not of the small one before it. It
/// has the photons that are emitted after the first sample.
#[test]
fn a_point_is_picked_before_the_picture() {
    // Enough shadow rays for photons to be on trial.
    let settings = Settings::builder().size(256, 256).spp(40).build().unwrap();
    let new = || session(gpu(), BOX.as_ref(), settings.clone());
    let until = |session: &mut Session<'_>, is: &dyn Fn(&Snapshot) -> bool| loop {
        let (shown, worked) = session.step().unwrap();
        match shown {
            Some(shown) if is(&shown) => return shown,
            _ => assert!(worked, "it never comes"),
        }
    };
    let is_whole = |shown: &Snapshot| shown.size == [256, 256] && shown.samples > 1;
    let mut later = new();
    until(&mut later, &is_whole);
    let mut moved = 0;
    for step in 0..3 {
        let at = [0.413 + 0.05 * step as f32, 0.913];
        let mut early = new();
        early.command(Command::Pick(at));
        let small = until(&mut early, &|shown| shown.samples == 1).picked.unwrap().point.unwrap();
        let picked = until(&mut early, &is_whole).picked.unwrap();
        later.command(Command::Pick(at));
        let expected = until(&mut later, &|shown| shown.picked.as_ref().is_some_and(|picked| picked.at == at));
        let expected = expected.picked.unwrap();
        assert_eq!(picked.point, expected.point, "at {at:?}");
        moved += usize::from(picked.point != Some(small));
        let photons = |picked: &Picked| picked.nearest.as_ref().map_or(0, |nearest| nearest.photons.len());
        assert_eq!(photons(&picked), photons(&expected), "at {at:?}");
        assert!(photons(&picked) > 0, "there are no photons");
    }
    assert!(moved > 0, "the small picture has the same points");
}

/// The share of points of the light that a point sees, from f64 rays among all triangles; `None` if the light is
/// behind.
fn light_share(scene: &Scene, point: &SurfacePoint) -> Option<f64> {
    let triangles = || (0..scene.triangles.len()).map(|i| (i, scene.triangle_positions(i).map(|p| p.as_dvec3())));
    let emits = |i: usize| scene.triangles[i].light != NO_LIGHT;
    let origin = point.position.as_dvec3() + 1e-5 * point.normal;
    let blocks = |[a, b, c]: [DVec3; 3], way: DVec3| {
        let (a, b, c) = (a - origin, b - origin, c - origin);
        let normal = (b - a).cross(c - a);
        let t = a.dot(normal) / way.dot(normal);
        let inside = |p: DVec3, q: DVec3| (q - p).cross(t * way - p).dot(normal) >= 0.0;
        t > 0.0 && t < 1.0 - 1e-6 && inside(a, b) && inside(b, c) && inside(c, a)
    };
    let (mut seen, mut all) = (0, 0);
    for (_, [a, b, c]) in triangles().filter(|(i, _)| emits(*i)) {
        for (u, v) in [(0.1, 0.1), (0.8, 0.1), (0.1, 0.8), (0.33, 0.33), (0.5, 0.2), (0.2, 0.5), (0.05, 0.45)] {
            let way = a + u * (b - a) + v * (c - a) - origin;
            if way.dot(point.normal) <= 0.0 {
                return None;
            }
            all += 1;
            seen += usize::from(!triangles().any(|(i, corners)| !emits(i) && blocks(corners, way)));
        }
    }
    Some(seen as f64 / all as f64)
}

/// Fine cells say of their points what rays say, but for faint parts of penumbrae; those of another view do not.
#[test]
fn shown_cells_are_right() {
    let scene = Scene::load(BOX, &ImportOptions::default()).unwrap();
    let settings = Settings::builder().size(32, 32).spp(32).max_bounces(0).photons_per_light(60_000).build().unwrap();
    let mut renderer = Renderer::new(gpu(), scene.clone(), &scene.cameras[0], &settings).unwrap();
    while renderer.samples() < 32 {
        renderer.render_batch().unwrap();
    }
    let cells = renderer.shown_cells(0).unwrap().unwrap();
    let points: Vec<_> = (0..1024).step_by(3).map(|i| renderer.surface_point([i % 32, i / 32]).unwrap()).collect();
    let told = |cells: &[ShownCell]| {
        let (mut right, mut wrong) = (0, 0);
        for (cell, point) in cells.iter().step_by(3).zip(&points) {
            let Some(share) = point.as_ref().and_then(|point| light_share(&scene, point)) else { continue };
            match cell.class {
                Class::Lit if share < 1.0 => wrong += 1,
                Class::Shadowed if share > 0.0 => wrong += 1,
                Class::Lit | Class::Shadowed => right += 1,
                _ => {}
            }
        }
        (right, wrong)
    };
    let fine = cells.iter().filter(|cell| cell.kind == CellKind::Fine).count();
    assert!(fine > 600, "{fine} of 1024 points have fine cells");
    let divided = cells.iter().filter(|cell| cell.level > 0 || cell.class == Class::Boundary).count();
    assert!(divided > 20, "{divided} points are in divided cells");
    // One in a hundred: a cell is decided by its first photons.
    let (right, wrong) = told(&cells);
    assert!(right > 150 && wrong * 100 <= right, "{right} right, {wrong} wrong");
    let turned: Vec<ShownCell> = cells.iter().rev().copied().collect();
    let (right, wrong) = told(&turned);
    assert!(wrong * 30 > right, "cells of other pixels are not found: {right} right, {wrong} wrong");
}

/// A copy of the scene has the camera, which renders the same bits; all else in the file stays.
#[test]
fn a_camera_is_saved_into_a_copy_of_the_scene() {
    let folder = folder();
    let file = folder.path().join("scene.glb");
    fs::copy(BOX, &file).unwrap();
    let rolled = LookAt { up: DVec3::new(0.3, 1.0, 0.1), ..FROM_THE_RIGHT };
    let flat = LookAt { extent: Extent::Height(1.2), ..FROM_THE_RIGHT };
    let mut session = session(gpu(), &file, settings());
    // A render that begins takes messages away.
    settle(&mut session, []);
    let save = |name: &str, camera: &str, replaces: bool| {
        let file = folder.path().join(name);
        Command::SaveCamera { file, name: camera.to_owned(), replaces }
    };
    for (number, view) in [FROM_THE_RIGHT, rolled, flat].into_iter().enumerate() {
        let name = format!("copy {number}.glb");
        let shown = settle(&mut session, [Command::Camera(Viewpoint::Placed(view)), save(&name, "side", false)]);
        assert!(shown.message.as_ref().is_some_and(|told| told.contains("camera \"side\"")), "{:?}", shown.message);
        let copy = folder.path().join(&name);
        let scene = Scene::load(&copy, &ImportOptions::default()).unwrap();
        let camera = scene.cameras.iter().find(|camera| camera.name == "side").unwrap().clone();
        let mut renderer = Renderer::new(gpu(), scene, &camera, &settings()).unwrap();
        while renderer.samples() < 4 {
            renderer.render_batch().unwrap();
        }
        assert!(bytes(&renderer.image().unwrap()) == *shown.pixels, "the picture of {view:?}");
        // The second chunk is the same.
        let chunk = |file: &Path| {
            let bytes = fs::read(file).unwrap();
            let first = 20 + u32::from_le_bytes([bytes[12], bytes[13], bytes[14], bytes[15]]) as usize;
            bytes[first..].to_vec()
        };
        assert!(chunk(&copy) == chunk(&file));
    }
    // Nothing is replaced unless `replace` is requested, and no file becomes one of another kind.
    let before = fs::read(&file).unwrap();
    let told = |session: &mut Session<'_>, command| settle(session, [command]).message.unwrap();
    assert!(told(&mut session, save("scene.glb", "side", false)).contains("is the open file"));
    assert!(told(&mut session, save("copy 0.glb", "side", false)).contains("exists"));
    assert!(told(&mut session, save("copy.gltf", "side", false)).contains("extension"));
    assert!(fs::read(&file).unwrap() == before);
    assert!(told(&mut session, save("scene.glb", "side", true)).contains("wrote"));
    assert!(told(&mut session, save("scene.glb", "side", true)).contains("\"side 2\""));
    let reloaded = settle(&mut session, [Command::Reload]);
    assert!(reloaded.cameras.iter().any(|name| name == "side"), "{:?}", reloaded.cameras);
    // A camera of the file that is orthographic and moves stays so.
    let flat = reloaded.cameras.iter().position(|name| name == "side").unwrap();
    let moves = [Command::Camera(Viewpoint::File(flat)), Command::Orbit([0.05, 0.0])];
    let Viewpoint::Placed(view) = settle(&mut session, moves).picture.eye.viewpoint else { panic!("not moved") };
    assert_eq!(view.extent, Extent::Height(1.2));
}

/// A text file is copied beside its buffers, and not elsewhere.
#[test]
fn a_text_file_is_copied_beside_its_buffers() {
    let [own, other] = [folder(), folder()];
    let json = r#"{ "asset": { "version": "2.0" }, "scene": 0,
        "scenes": [{ "nodes": [0] }], "nodes": [{ "mesh": 0 }],
        "meshes": [{ "primitives": [{ "attributes": { "POSITION": 0 } }] }],
        "accessors": [{ "bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3",
            "min": [0, 0, 0], "max": [1, 1, 0] }],
        "bufferViews": [{ "buffer": 0, "byteLength": 36 }],
        "buffers": [{ "uri": "corners.bin", "byteLength": 36 }] }"#;
    let corners: [f32; 9] = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0];
    let bytes: Vec<u8> = corners.iter().flat_map(|x| x.to_le_bytes()).collect();
    fs::write(own.path().join("corners.bin"), bytes).unwrap();
    let file = own.path().join("scene.gltf");
    fs::write(&file, json).unwrap();
    let scene = Scene::load(&file, &ImportOptions::default()).unwrap();
    let view = LookAt::upright(DVec3::new(0.5, 0.4, 3.0), DVec3::new(0.4, 0.4, 0.0), Extent::default());
    let (camera, placed) = (scene.look_at(&view).unwrap(), view.axes().map(|axes| (view.from, axes)));
    let camera = AddedCamera::new("view", &scene, &camera, placed);
    assert!(with_camera(&file, other.path(), &camera).unwrap_err().to_string().contains("beside"));
    let (copy, name) = with_camera(&file, own.path(), &camera).unwrap();
    let copied = Scene::from_bytes(&copy, &own.path().join("copy.gltf"), &ImportOptions::default()).unwrap();
    let expected = penumbra::Camera { name, ..scene.look_at(&view).unwrap() };
    assert_eq!(copied.cameras, [expected]);
    let text = String::from_utf8(copy).unwrap();
    assert!(text.contains(r#""nodes": [0,1]"#) && text.contains(r#""min": [0, 0, 0], "max": [1, 1, 0]"#), "{text}");
}

/// A point that is framed comes to the centre.
#[test]
fn a_framed_point_is_in_the_centre() {
    let mut session = session(gpu(), BOX.as_ref(), settings());
    let before = settle(&mut session, [Command::Pick([0.3, 0.8])]).picked.unwrap().hit.unwrap();
    let framed = settle(&mut session, [Command::FrameAt([0.3, 0.8]), Command::Pick([0.5, 0.5])]);
    let after = framed.picked.unwrap().hit.unwrap();
    // Positions are rounded to a millionth of the scene's size, more than once.
    assert!(before.position.distance(after.position) < 1e-5, "{before:?} {after:?}");
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

/// A scene is read again once a file appears that it refers to, even if it was refused for lack of that file.
#[test]
fn a_missing_file_is_awaited() {
    let folder = folder();
    let [scene, image] = ["scene.glb", "new.png"].map(|name| folder.path().join(name));
    let mut file = File::new();
    file.mesh(&[[-1., -1., -2.], [1., -1., -2.], [0., 1., -2.]], json!({}));
    add_camera(&mut file);
    fs::write(&scene, file.glb()).unwrap();
    let choice: DeviceChoice = std::env::var("PENUMBRA_DEVICE").unwrap_or("software".into()).parse().unwrap();
    let open = move || Ok(Arc::new(Gpu::open(&choice)?));
    let (events, heard) = channel();
    let tell = move |event| events.send(event).unwrap();
    let worker = Worker::start(open().unwrap(), state(&scene, settings()), open, tell);
    let wait_for_message = |is_expected: fn(Option<&str>) -> bool| loop {
        heard.recv_timeout(Duration::from_secs(60)).unwrap();
        if worker.take().is_some_and(|snapshot| snapshot.is_complete && is_expected(snapshot.message.as_deref())) {
            return;
        }
    };
    wait_for_message(|message| message.is_none());
    file.add("images", json!({ "uri": "new.png" }));
    fs::write(&scene, file.glb()).unwrap();
    wait_for_message(|message| message.is_some_and(|message| message.contains("new.png")));
    image::RgbImage::new(1, 1).save(&image).unwrap();
    wait_for_message(|message| message.is_none());
}

/// Another scene begins with its own camera; a missing one leaves the picture.
#[test]
fn another_scene_replaces_the_first() {
    let mut session = session(gpu(), BOX.as_ref(), settings());
    let first = settle(&mut session, [Command::Camera(Viewpoint::Placed(FROM_THE_RIGHT))]);
    let missing = settle(&mut session, [Command::Open(PathBuf::from("missing.glb"))]);
    assert!(missing.message.unwrap().contains("missing.glb"));
    assert_eq!((missing.pixels, missing.picture.file), (first.pixels, PathBuf::from(BOX)));
    let sphere = settle(&mut session, [Command::Open(SPHERE.into())]);
    assert_eq!((sphere.message, sphere.picture.eye.viewpoint), (None, Viewpoint::Given));
    assert!(*sphere.pixels == bytes(&render(SPHERE, None, &settings())));
}

/// The variant that was chosen is one of its file: a missing file leaves it, and another one is shown without.
#[test]
fn another_scene_has_no_variant_of_the_first() {
    let folder = folder();
    let path = folder.path().join("variants.glb");
    let mut file = File::triangle();
    add_camera(&mut file);
    file.json["extensions"] = json!({ "KHR_materials_variants": { "variants": [{ "name": "red" }] } });
    file.json["extensionsUsed"] = json!(["KHR_materials_variants"]);
    fs::write(&path, file.glb()).unwrap();
    let mut session = session(gpu(), &path, settings());
    let mut red = choices(settings());
    red.pose.variant = Some("red".into());
    assert_eq!(settle(&mut session, [Command::Choose(Box::new(red.clone()))]).message, None);
    let missing = settle(&mut session, [Command::Open(PathBuf::from("missing.glb"))]);
    assert_eq!((missing.picture.file, missing.picture.choices.pose), (path, red.pose));
    let sphere = settle(&mut session, [Command::Open(SPHERE.into())]);
    assert_eq!((sphere.message, sphere.picture.choices.pose.variant), (None, None));
    assert!(*sphere.pixels == bytes(&render(SPHERE, None, &settings())));
}

/// Settings that cannot be rendered leave a message; others are rendered.
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
    let mut albedo = choices(settings());
    albedo.display.overlay = Overlay::Albedo;
    let shown = settle(&mut session, [Command::Choose(Box::new(albedo)), Command::Save(png.clone())]);
    assert!(shown.pixels != first.pixels);
    // It is saved before it is shown, unless it is there already.
    settle(&mut session, [Command::Save(png.clone())]);
    assert!(image_bytes(&png) == *shown.pixels, "an overlay is not saved as it is shown");
    let refused = settle(&mut session, [Command::Save(folder.path().join("a.txt"))]);
    assert!(refused.message.unwrap().contains(".exr"));
}

/// Nothing is saved over a file that the picture is made from, such as a panorama. A copy may replace the scene.
#[test]
fn inputs_are_not_written_over() {
    let folder = folder();
    let (scene, panorama, copy) =
        (folder.path().join("scene.glb"), folder.path().join("panorama.exr"), folder.path().join("copy.exr"));
    fs::copy(BOX, &scene).unwrap();
    fs::write(&panorama, "a panorama").unwrap();
    let mut session = Session::new(gpu(), state_with(&scene, settings(), vec![panorama.clone()]));
    settle(&mut session, []);
    let detour = folder.path().join("..").join(folder.path().file_name().unwrap()).join("panorama.exr");
    for path in [&panorama, &detour] {
        let refused = settle(&mut session, [Command::Save(path.clone())]).message.unwrap();
        assert!(refused.contains("is an input, which would be overwritten"), "{refused}");
    }
    assert_eq!(fs::read(&panorama).unwrap(), b"a panorama");
    let saved = settle(&mut session, [Command::Save(copy)]).message.unwrap();
    assert!(saved.contains("wrote"), "{saved}");
    let replace = |file: &Path| Command::SaveCamera { file: file.to_owned(), name: "new".into(), replaces: true };
    let refused = settle(&mut session, [replace(&panorama)]).message.unwrap();
    assert!(refused.contains("is an input, which would be overwritten"), "{refused}");
    let replaced = settle(&mut session, [replace(&scene)]).message.unwrap();
    assert!(replaced.contains("camera \"new\""), "{replaced}");
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
            Event::Picture | Event::Compiling(_) => {}
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
