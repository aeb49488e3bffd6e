//! Cameras of the file, and the camera that frames a scene without one.

use glam::Vec3;
use penumbra::internal::scene::Projection;
use serde_json::json;

use crate::builder::File;

/// A file with a camera and a triangle. The bounding box is 4 x 2 around (2, 1, 0) with radius sqrt(5), so the scale is
/// 1/4.
fn with_camera(camera: serde_json::Value, node: serde_json::Value) -> File {
    let mut file = File::triangle();
    let index = file.add("cameras", camera);
    let node = file.add("nodes", node);
    file.json["nodes"][node]["camera"] = json!(index);
    file
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

#[test]
fn the_framing_camera_sees_every_corner() {
    let mut file = File::new();
    file.mesh(&[[-5., 0., 3.], [7., 100., 2.], [1., 2., -60.]], json!({}));
    let scene = file.load();
    assert!(scene.cameras.is_empty(), "loading adds no camera");
    let camera = scene.frame_camera();
    let Projection::Perspective { yfov, aspect: None } = camera.projection else { panic!("{camera:?}") };
    let [right, up, backward] = camera.axes;
    assert!(right.cross(up).dot(backward) > 0.999, "a right-handed frame");
    assert!(backward.z > 0.0 && backward.y > 0.0, "from the front, from above");
    for vertex in &scene.vertices {
        let v = vertex.position - camera.position;
        let depth = -v.dot(backward);
        assert!(depth > camera.near);
        let limit = depth * (yfov / 2.0).tan();
        assert!(v.dot(up).abs() <= limit && v.dot(right).abs() <= limit, "{v} is outside the view");
    }
}
