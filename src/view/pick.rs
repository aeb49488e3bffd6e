//! What is at a pixel: the surface that the ray through its centre meets first.

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use crate::gpu_scene::CameraUniform;
use crate::procedural::box_corners;
use crate::scene::{Camera, Scene, SharedMesh, Vertex};

/// A surface at a pixel.
#[derive(Clone, Debug, PartialEq)]
pub struct Hit {
    /// Name of its material.
    pub material: String,
    /// Position in the file's world space.
    pub position: DVec3,
    /// Unit normal of the triangle, towards the camera; none of an object that is a function.
    pub normal: Option<DVec3>,
    /// Depth along the direction of view, in the units of the file.
    pub depth: f64,
}

/// The nearest surface at a point of the image, from 0 to 1 each way from the top left. Pixels of textures that let
/// rays pass do so here, too, only if the whole material does; objects that are functions are met at their boxes.
pub fn pick(scene: &Scene, camera: &Camera, [width, height]: [u32; 2], [x, y]: [f32; 2]) -> Option<Hit> {
    let uniform = CameraUniform::new(camera, width, height);
    let vector = |v: [f32; 3]| Vec3::from(v).as_dvec3();
    let across = f64::from(2.0 * x - 1.0) * vector(uniform.right) + f64::from(1.0 - 2.0 * y) * vector(uniform.up);
    let (position, ahead) = (vector(uniform.position), -vector(uniform.backward));
    let (origin, way) = if uniform.orthographic == 1 { (position + across, ahead) } else { (position, ahead + across) };
    // The way has a length of 1 along the direction of view, so that its multiples are depths.
    let range = f64::from(camera.near)..=f64::from(camera.far);
    let met = |index: usize, place: &dyn Fn(Vec3) -> Vec3| {
        let corners = scene.triangle_positions(index).map(|corner| place(corner).as_dvec3());
        let depth = triangle_depth(corners, origin, way)?;
        let material = scene.triangles[index].material;
        range.contains(&depth).then_some(Met { depth, material, corners })
    };
    let flat = (0..scene.flat_triangles()).into_par_iter().filter_map(|index| met(index, &|corner| corner));
    let around = |mesh: &SharedMesh| corners_around(&scene.vertices[mesh.vertices.clone()]);
    let boxes: Vec<_> = scene.shared_meshes.par_iter().map(around).collect();
    let instances = scene.instances.par_iter().filter(|instance| {
        let corners = boxes[instance.mesh].map(|corner| instance.apply(corner));
        box_depths(&corners, origin, way).is_some_and(|[_, leave]| leave >= 0.0)
    });
    let of_instances = instances.flat_map_iter(|instance| {
        let triangles = scene.shared_meshes[instance.mesh].triangles.clone();
        triangles.filter_map(move |index| met(index, &|corner| instance.apply(corner)))
    });
    let nearest = flat.chain(of_instances).min_by(|a, b| a.depth.total_cmp(&b.depth));
    let boxes = scene.procedurals.iter().filter_map(|object| {
        let [enter, _] = box_depths(&object.corners(), origin, way)?;
        range.contains(&enter).then_some((enter, object.material))
    });
    let object = boxes.min_by(|a, b| a.0.total_cmp(&b.0));
    let scale = scene.normalisation.scale();
    let hit = |depth: f64, material: u32, normal: Option<DVec3>| Hit {
        material: scene.materials[material as usize].name.clone(),
        position: scene.normalisation.undo_f64(origin + depth * way),
        normal: normal.map(|n| if n.dot(way) > 0.0 { -n } else { n }),
        depth: depth / scale,
    };
    match (nearest, object) {
        (Some(Met { depth, material, corners: [a, b, c] }), object)
            if object.is_none_or(|(enter, _)| depth <= enter) =>
        {
            Some(hit(depth, material, (b - a).cross(c - a).try_normalize()))
        }
        (_, Some((enter, material))) => Some(hit(enter, material, None)),
        _ => None,
    }
}

/// A triangle that a ray meets.
struct Met {
    depth: f64,
    material: u32,
    corners: [DVec3; 3],
}

/// The corners of the box around vertices.
fn corners_around(vertices: &[Vertex]) -> [Vec3; 8] {
    let positions = || vertices.iter().map(|vertex| vertex.position);
    let ends = [positions().fold(Vec3::MAX, Vec3::min), positions().fold(Vec3::MIN, Vec3::max)];
    box_corners(ends.map(|end| end.as_dvec3())).map(|corner| corner.as_vec3())
}

/// The multiples of `way` at which a ray enters and leaves the box around the corners of another box.
fn box_depths(corners: &[Vec3; 8], origin: DVec3, way: DVec3) -> Option<[f64; 2]> {
    let lower = corners.iter().copied().reduce(Vec3::min)?.as_dvec3() - origin;
    let upper = corners.iter().copied().reduce(Vec3::max)?.as_dvec3() - origin;
    let (a, b) = (lower / way, upper / way);
    let (enter, leave) = (a.min(b).max_element(), a.max(b).min_element());
    (enter <= leave).then_some([enter, leave])
}

/// The multiple of `way` at which a ray meets a triangle, from either side.
fn triangle_depth([a, b, c]: [DVec3; 3], origin: DVec3, way: DVec3) -> Option<f64> {
    let (a, b, c) = (a - origin, b - origin, c - origin);
    let normal = (b - a).cross(c - a);
    let depth = a.dot(normal) / way.dot(normal);
    let at = depth * way;
    let inside = |p: DVec3, q: DVec3| (q - p).cross(at - p).dot(normal) >= 0.0;
    (depth.is_finite() && inside(a, b) && inside(b, c) && inside(c, a)).then_some(depth)
}
