//! Cameras of the file, and the camera that frames a scene without one.

use std::fs;

use glam::{DVec3, Vec3};
use penumbra::ImportOptions;
use penumbra::internal::scene::{
    AddedCamera, Camera, Extent, Focus, Framing, Iris, LookAt, MAX_BLADES, Projection, Scene,
};
use serde_json::json;

use crate::builder::File;

/// A file with a camera and a triangle. The bounding box is 4 x 2 around (2, 1, 0) with radius sqrt(5), so the scale is
/// 1/4.
fn with_camera(camera: serde_json::Value, node: serde_json::Value) -> File {
    let mut file = File::triangle();
    add_camera(&mut file, camera, node);
    file
}

fn add_camera(file: &mut File, camera: serde_json::Value, node: serde_json::Value) {
    let index = file.add("cameras", camera);
    let node = file.add("nodes", node);
    file.json["nodes"][node]["camera"] = json!(index);
}

#[test]
fn perspective_without_far_plane() {
    let file = with_camera(
        json!({ "type": "perspective", "perspective": { "yfov": 0.5, "znear": 0.25 }, "name": "eye" }),
        json!({ "translation": [2, 1, 8] }),
    );
    let camera = &file.load().cameras[0];
    assert_eq!(camera.name, "eye");
    assert_eq!(camera.projection, Projection::Perspective { yfov: 0.5, aspect: None });
    assert_eq!((camera.near, camera.far), (0.0625, f32::INFINITY));
    assert_eq!(camera.position, Vec3::new(0.0, 0.0, 2.0));
    assert_eq!(camera.axes, [Vec3::X, Vec3::Y, Vec3::Z]);
}

#[test]
fn orthographic_and_node_scale() {
    // A rotation by 90 degrees about +y maps +z to +x and +x to -z. The camera looks along the node's -z with its +y
    // up; the scale does not matter.
    let half = std::f64::consts::FRAC_1_SQRT_2;
    let file = with_camera(
        json!({ "type": "orthographic", "orthographic": { "xmag": 2, "ymag": 1, "znear": 0, "zfar": 100 } }),
        json!({ "rotation": [0, half, 0, half], "scale": [3, -2, 7], "name": "side" }),
    );
    let camera = &file.load().cameras[0];
    assert_eq!(camera.name, "side");
    assert_eq!(camera.projection, Projection::Orthographic { xmag: 0.5, ymag: 0.25 });
    assert_eq!((camera.near, camera.far), (0.0, 25.0));
    for (axis, expected) in camera.axes.iter().zip([Vec3::Z, Vec3::NEG_Y, Vec3::X]) {
        // Rounding of the quaternion, in f64, and of the axes to f32.
        assert!((*axis - expected).length() < 1e-6, "{axis} for {expected}");
    }
}

/// The smallest and the largest position of a vertex in the image, from -1 to 1 to the right and upward.
fn spans(scene: &Scene, camera: &Camera, aspect: f32) -> [[f32; 2]; 2] {
    let Projection::Perspective { yfov, .. } = camera.projection else { panic!("{camera:?}") };
    let [right, up, backward] = camera.axes;
    let mut spans = [[f32::MAX, f32::MIN]; 2];
    for vertex in scene.vertices.iter() {
        let v = vertex.position - camera.position;
        let depth = -v.dot(backward);
        assert!(depth > camera.near, "{v} is clipped");
        for (span, (axis, aspect)) in spans.iter_mut().zip([(right, aspect), (up, 1.0)]) {
            let at = v.dot(axis) / (depth * (yfov / 2.0).tan() * aspect);
            *span = [span[0].min(at), span[1].max(at)];
        }
    }
    spans
}

/// Whatever the view, all vertices are in it with a margin of 5 % of the width and height, and two opposite sides of
/// the image have no more: no camera of that direction is nearer.
#[test]
fn views_are_filled() {
    let mut file = File::new();
    file.mesh(&[[-5., 0., 3.], [7., 100., 2.], [1., 2., -60.]], json!({}));
    file.mesh(&[[20., 3., 30.], [2., -4., 9.], [-40., 0., 1.]], json!({}));
    let scene = file.load();
    for (azimuth, elevation) in [(0.0, 15.0), (90.0, 0.0), (-130.0, 60.0), (200.0, -90.0), (10.0, 90.0)] {
        for (aspect, fov) in [(1.0, 40.0), (2.5, 40.0), (0.4, 40.0), (1.0, 10.0), (1.5, 55.0)] {
            let camera = scene.frame(&Framing { azimuth, elevation, aspect, fov });
            let spans = spans(&scene, &camera, aspect);
            let margin = |[low, high]: [f32; 2]| (low + 1.0).min(1.0 - high);
            let [x, y] = spans.map(margin);
            // Roundings of f32 positions of unit size.
            assert!((x.min(y) - 0.1).abs() < 1e-5, "{azimuth}, {elevation}, {aspect}, {fov}: {spans:?}");
            let [low, high] = if x < y { spans[0] } else { spans[1] };
            // Twice that, for two sides.
            assert!((low + high).abs() < 2e-5, "{azimuth}, {elevation}, {aspect}, {fov}: {spans:?}");
            let towards = camera.axes[2];
            let (a, e) = (azimuth.to_radians(), elevation.to_radians());
            let expected = Vec3::new(a.sin() * e.cos(), e.sin(), a.cos() * e.cos());
            // Roundings of unit vectors in f32.
            assert!((towards - expected).length() < 1e-6, "{towards} for {expected}");
            assert!(camera.axes[0].y.abs() < 1e-6, "the horizon is not level");
        }
    }
}

/// All cameras of a turntable look at the same point from the same distance, at equal angles. All vertices are in all
/// views, and in one of them they reach its margin.
#[test]
fn turntables_stand_still() {
    let mut file = File::new();
    file.mesh(&[[-5., 0., 3.], [7., 60., 2.], [1., 2., -60.]], json!({}));
    file.mesh(&[[20., 3., 30.], [2., -4., 9.], [-40., 0., 1.]], json!({}));
    let scene = file.load();
    let (azimuth, elevation, aspect) = (20.0, 30.0, 1.5);
    let cameras = scene.turntable(&Framing { azimuth, elevation, aspect, fov: 25.0 }, 8);
    assert_eq!(cameras.len(), 8);
    let middle = {
        let bounds = scene.bounds().unwrap();
        0.5 * (bounds[0] + bounds[1])
    };
    let distance = (cameras[0].position - middle).length();
    let mut margins = Vec::new();
    for (view, camera) in (0u8..).zip(&cameras) {
        let (a, e) = ((azimuth + 45.0 * f32::from(view)).to_radians(), elevation.to_radians());
        let towards = Vec3::new(a.sin() * e.cos(), e.sin(), a.cos() * e.cos());
        // The distance is a few units; below 8, half of a unit in the last place of f32 is 2.4e-7.
        assert!((camera.position - middle - distance * towards).length() < 1e-5, "view {view}: {}", camera.position);
        // Roundings of unit vectors in f32.
        assert!((camera.axes[2] - towards).length() < 1e-6);
        let inside = spans(&scene, camera, aspect).map(|[low, high]| (low + 1.0).min(1.0 - high));
        margins.push(inside[0].min(inside[1]));
    }
    // Roundings of f32 positions of unit size.
    let tightest = margins.into_iter().fold(f32::MAX, f32::min);
    assert!((tightest - 0.1).abs() < 1e-5, "{tightest}");
}

/// A triangle that fills half of the view covers half of it, as far as the view shows it. A turned camera sees none of
/// it; and one in the plane of a triangle cannot tell.
#[test]
fn surfaces_cover_their_share_of_the_image() {
    let orthographic = |x: f32| {
        let file = with_camera(
            json!({ "type": "orthographic", "orthographic": { "xmag": 2, "ymag": 1, "znear": 0, "zfar": 100 } }),
            json!({ "translation": [x, 1, 8] }),
        );
        let scene = file.load();
        let camera = scene.cameras[0].clone();
        (scene, camera)
    };
    // Corners and the cells of the sloping side: half of 64 of 4096 cells, up or down.
    let tolerance = 1.5 / 64.0;
    // The triangle is y < 2 - x / 2. From x = 2 on it has a quarter of its area, in an image of 4 x 2.
    for (x, expected) in [(2.0, 0.5), (4.0, 0.125), (0.0, 0.375), (7.0, 0.0)] {
        let (scene, camera) = orthographic(x);
        let covered = scene.covered_share(&camera, 2.0);
        assert!((covered - expected).abs() < tolerance, "{x}: {covered}");
    }
    let (scene, camera) = orthographic(2.0);
    let perspective = |yfov: f32, near: f32| Camera {
        projection: Projection::Perspective { yfov, aspect: None },
        near,
        ..camera.clone()
    };
    // At distance 8 the image is 8 wide and 4 high: the triangle fills an eighth of it.
    let covered = scene.covered_share(&perspective(2.0 * 0.25f32.atan(), 0.1), 2.0);
    assert!((covered - 0.125).abs() < tolerance, "{covered}");
    let [right, up, backward] = camera.axes;
    let turned = Camera { axes: [-right, up, -backward], ..perspective(0.5, 0.1) };
    assert_eq!(scene.covered_share(&turned, 2.0), 0.0);
    let inside = Camera { position: scene.vertices[0].position, axes: [backward, up, -right], ..perspective(0.5, 0.1) };
    assert_eq!(scene.covered_share(&inside, 2.0), 1.0);
}

/// The thin lens of a 50 mm objective at f/2, on film 24 mm high.
#[test]
fn lenses_have_the_size_of_their_f_number() {
    let mut file = File::new();
    // A wall 3 m before the camera, and a triangle beside the centre that is nearer.
    file.mesh(&[[-9., -9., -3.], [9., -9., -3.], [0., 9., -3.]], json!({}));
    file.mesh(&[[0.5, 0., -1.], [1., 0., -1.], [1., 1., -1.]], json!({}));
    let yfov = 2.0 * (12f32 / 50.0).atan();
    let perspective = json!({ "yfov": yfov, "znear": 0.1 });
    add_camera(&mut file, json!({ "type": "perspective", "perspective": perspective }), json!({}));
    let scene = file.load();
    let mut camera = scene.cameras[0].clone();
    let scale = scene.normalisation.scale();
    let metres = |length: f32| f64::from(length) / scale;
    // Lengths and the tangent of the angle are f32, each with a relative rounding of 6e-8.
    let near = |x: f64, expected: f64| (x / expected - 1.0).abs() < 1e-6;
    scene.open_iris(&mut camera, Iris { f_number: 2.0, blades: 7 }, Focus::Auto).unwrap();
    let lens = camera.lens.unwrap();
    assert!(near(metres(lens.radius), 0.0125) && lens.blades == 7, "{lens:?}");
    assert!(near(metres(lens.distance), 3.0), "{lens:?}");
    scene.open_iris(&mut camera, Iris { f_number: 4.0, blades: 0 }, Focus::Distance(0.75)).unwrap();
    let lens = camera.lens.unwrap();
    assert!(near(metres(lens.radius), 0.00625) && near(metres(lens.distance), 0.75), "{lens:?}");
    let iris = |f_number: f64, blades: u32| Iris { f_number, blades };
    for f_number in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        let problem = scene.open_iris(&mut camera, iris(f_number, 0), Focus::Auto).unwrap_err();
        assert!(problem.contains("an f-number must be"), "{problem}");
        let problem = scene.open_iris(&mut camera, iris(4.0, 0), Focus::Distance(f_number)).unwrap_err();
        assert!(problem.contains("a focus distance must be"), "{problem}");
    }
    for blades in [1, 2, MAX_BLADES + 1] {
        let problem = scene.open_iris(&mut camera, iris(4.0, blades), Focus::Auto).unwrap_err();
        assert!(problem.contains("from 3 to 64"), "{problem}");
    }
    // Lengths that kernels would read as 0 or infinite, or square to them.
    for f_number in [f64::MIN_POSITIVE, 1e-60, 1e-22] {
        let problem = scene.open_iris(&mut camera, iris(f_number, 0), Focus::Auto).unwrap_err();
        assert!(problem.contains("an f-number must be at least"), "{problem}");
    }
    for metres in [1e300, 1e22, 1e-60, f64::MIN_POSITIVE] {
        let problem = scene.open_iris(&mut camera, iris(4.0, 0), Focus::Distance(metres)).unwrap_err();
        assert!(problem.contains("a focus distance must be from"), "{problem}");
    }
    assert_eq!(camera.lens, Some(lens), "a refused iris changes the camera");
    // A lens with hardly an opening is a pinhole, and one in focus beyond a million kilometres is at infinity.
    scene.open_iris(&mut camera, iris(1e300, 0), Focus::Distance(1e9)).unwrap();
    assert!(camera.lens.unwrap().radius == 0.0);
    camera.axes[2] = Vec3::NEG_Z;
    let problem = scene.open_iris(&mut camera, Iris { f_number: 4.0, blades: 0 }, Focus::Auto).unwrap_err();
    assert!(problem.contains("centre of the image"), "{problem}");
    camera.projection = Projection::Orthographic { xmag: 1.0, ymag: 1.0 };
    let problem = scene.open_iris(&mut camera, Iris { f_number: 4.0, blades: 0 }, Focus::Auto).unwrap_err();
    assert!(problem.contains("orthographic"), "{problem}");
}

/// A camera that can see nothing gives a note with the reason.
#[test]
fn views_without_anything_in_them_are_reported() {
    let mut file = File::new();
    file.mesh(&[[0., 0., -1.], [1., 0., -1.], [0., 1., -2.]], json!({}));
    let seen_with = |near: f32, far: f32| {
        let mut file = file.clone();
        let perspective = json!({ "yfov": 1, "znear": near, "zfar": far });
        add_camera(&mut file, json!({ "type": "perspective", "perspective": perspective }), json!({}));
        let scene = file.load();
        scene.clipped_away(&scene.cameras[0])
    };
    assert_eq!(seen_with(0.5, 10.0), None);
    assert_eq!(seen_with(1.5, 10.0), None);
    assert_eq!(seen_with(0.1, 1.5), None);
    let beyond = "the camera sees nothing: all of the scene is beyond its zfar of 0.75";
    assert_eq!(seen_with(0.5, 0.75).as_deref(), Some(beyond));
    let nearer = "the camera sees nothing: all of the scene is nearer than its znear of 4";
    assert_eq!(seen_with(4.0, 10.0).as_deref(), Some(nearer));
    let scene = file.load();
    let mut camera = scene.frame_camera();
    assert_eq!(scene.clipped_away(&camera), None);
    camera.axes[2] *= -1.0;
    let behind = "the camera sees nothing: all of the scene is behind it";
    assert_eq!(scene.clipped_away(&camera).as_deref(), Some(behind));
}

/// A camera that is taken to another scene of the same world stays where it is there.
#[test]
fn a_camera_keeps_its_view_in_another_normalised_space() {
    for lens in [
        json!({ "type": "perspective", "perspective": { "yfov": 0.5, "znear": 0.25, "zfar": 64 } }),
        json!({ "type": "orthographic", "orthographic": { "xmag": 2, "ymag": 1, "znear": 0.25, "zfar": 64 } }),
    ] {
        let mut file = with_camera(lens, json!({ "translation": [2, 1, 8] }));
        let small = file.load();
        file.mesh(&[[40., 0., 0.], [41., 0., 0.], [40., 1., 0.]], json!({}));
        let large = file.load();
        assert_ne!(small.normalisation, large.normalisation);
        let moved = small.cameras[0].renormalised(&small.normalisation, &large.normalisation);
        // The numbers of the file are exact in both.
        assert_eq!(moved, large.cameras[0]);
        assert_ne!(moved, small.cameras[0]);
    }
}

/// A placed orthographic camera sees the scene from any distance, also when it is read from the file to which it is
/// saved.
#[test]
fn a_saved_camera_sees_the_scene_from_afar() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("triangle.glb");
    fs::write(&file, File::triangle().glb()).unwrap();
    let scene = Scene::load(&file, &ImportOptions::default()).unwrap();
    for distance in [8.0, 1e4, 1e8] {
        let view = LookAt::upright(DVec3::new(2.0, 1.0, distance), DVec3::new(2.0, 1.0, 0.0), Extent::Height(4.0));
        let added = AddedCamera::new("afar", &scene, &scene.look_at(&view).unwrap(), None);
        let (copy, _) = penumbra::internal::scene::with_camera(&file, folder.path(), &added).unwrap();
        let copy = Scene::from_bytes(&copy, &file, &ImportOptions::default()).unwrap();
        assert_eq!(copy.clipped_away(&copy.cameras[0]), None, "{distance}");
    }
    // As for every file, what is no regular file is not read.
    let added = AddedCamera::new("afar", &scene, &scene.frame_camera(), None);
    let problem = penumbra::internal::scene::with_camera(folder.path(), folder.path(), &added).unwrap_err();
    assert!(problem.to_string().contains("it is a folder"), "{problem}");
}

#[test]
fn the_framing_camera_sees_every_corner() {
    let mut file = File::new();
    file.mesh(&[[-5., 0., 3.], [7., 100., 2.], [1., 2., -60.]], json!({}));
    let scene = file.load();
    assert!(scene.cameras.is_empty(), "loading adds no camera");
    let camera = scene.frame_camera();
    let Projection::Perspective { yfov, aspect: None } = camera.projection else { panic!("{camera:?}") };
    let [right, up, backward] = camera.axes;
    // 1 for a right-handed frame of unit vectors in f32, and -1 for a left-handed one.
    assert!(right.cross(up).dot(backward) > 0.999, "a right-handed frame");
    assert!(backward.z > 0.0 && backward.y > 0.0, "from the front, from above");
    for vertex in scene.vertices.iter() {
        let v = vertex.position - camera.position;
        let depth = -v.dot(backward);
        assert!(depth > camera.near);
        let limit = depth * (yfov / 2.0).tan();
        assert!(v.dot(up).abs() <= limit && v.dot(right).abs() <= limit, "{v} is outside the view");
    }
}

/// The camera goes to the scene that is shown, also if its number is written as a float.
#[test]
fn a_saved_camera_is_in_the_scene_that_is_shown() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("triangle.glb");
    let mut file = File::triangle();
    file.json["scenes"] = json!([{}, { "nodes": [0] }]);
    file.json["scene"] = json!(1.0);
    fs::write(&path, file.glb()).unwrap();
    let scene = Scene::load(&path, &ImportOptions::default()).unwrap();
    assert_eq!((scene.triangles.len(), scene.cameras.len()), (1, 0));
    let added = AddedCamera::new("added", &scene, &scene.frame_camera(), None);
    let (copy, _) = penumbra::internal::scene::with_camera(&path, folder.path(), &added).unwrap();
    assert_eq!(Scene::from_bytes(&copy, &path, &ImportOptions::default()).unwrap().cameras.len(), 1);
}
