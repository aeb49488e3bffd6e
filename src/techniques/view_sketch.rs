//! A rough estimate of what a camera sees, from a few rays on the CPU.

use std::f64::consts::TAU;

use glam::{DVec2, DVec3};
use rayon::prelude::*;

use crate::gpu_scene::CameraUniform;
use crate::random::r2;
use crate::scene::{Camera, Scene, SurfaceSearch};

/// Rays from the camera along each axis of the image. With this many, shares are right within a few hundredths.
const SIDE: u32 = 16;

/// Share of the way to a surface that is left before it, where the next ray starts: far more than rounding in double
/// precision.
const OFFSET: f64 = 1e-4;

/// Isolated models cover 0.10 to 0.49 of the image. A ball on a floor covers 0.59, and there `path` has the larger
/// error once the default technique has its first sample.
const MAX_COVERAGE: f64 = 0.5;

/// Share of the pixels whose path meets a second surface: 0.004 to 0.08 for isolated models, 0.21 to 1 for those of
/// `scenes/`, except for the ball on a floor with 0.07.
const MAX_SECOND_SURFACES: f64 = 0.1;

/// Like [`MAX_SECOND_SURFACES`], for open scenes, such as the crowd with 0.21. The closed view of the still life has
/// 0.39.
const MAX_SECOND_SURFACES_OF_OPEN_SCENE: f64 = 0.3;

/// Whether the image shows an open scene: most paths leave it after one surface.
pub fn shows_open_scene(scene: &Scene, camera: &Camera, size: [u32; 2]) -> bool {
    second_surfaces(scene, camera, size) < MAX_SECOND_SURFACES_OF_OPEN_SCENE
}

/// Whether the image shows an isolated model: most pixels are empty, and few paths continue from one surface to
/// another. There many samples of `path` take little time, and little of the light is indirect, so records are hardly
/// needed.
pub fn shows_isolated_model(scene: &Scene, camera: &Camera, [width, height]: [u32; 2]) -> bool {
    let aspect = width as f32 / height as f32;
    scene.covered_share(camera, aspect) < MAX_COVERAGE
        && second_surfaces(scene, camera, [width, height]) < MAX_SECOND_SURFACES
}

/// Share of the pixels whose path meets a second surface. It is estimated from rays through some points of the image,
/// and for each surface hit from one more ray, in a direction sampled in proportion to the cosine.
fn second_surfaces(scene: &Scene, camera: &Camera, [width, height]: [u32; 2]) -> f64 {
    let uniform = CameraUniform::new(camera, width, height);
    let range = f64::from(camera.near)..=f64::from(camera.far);
    let surfaces = SurfaceSearch::new(scene);
    let goes_on = |index: &u32| {
        let [x, y] = [index % SIDE, index / SIDE].map(|i| (f64::from(i) + 0.5) / f64::from(SIDE));
        let (origin, direction) = uniform.ray([x, y]);
        surfaces.nearest(origin, direction, &range).is_some_and(|nearest| {
            let normal = nearest.normal.unwrap_or(-direction.normalize());
            let normal = if normal.dot(direction) > 0.0 { -normal } else { normal };
            let above = origin + nearest.depth * (1.0 - OFFSET) * direction;
            surfaces.nearest(above, cosine_weighted(normal, r2(*index).into()), &(0.0..=f64::MAX)).is_some()
        })
    };
    (0..SIDE * SIDE).into_par_iter().filter(goes_on).count() as f64 / f64::from(SIDE * SIDE)
}

/// A unit vector above a surface, with a density in proportion to its cosine.
fn cosine_weighted(normal: DVec3, u: DVec2) -> DVec3 {
    let (across, along) = normal.any_orthonormal_pair();
    let (sine, cosine) = (TAU * u.x).sin_cos();
    u.y.sqrt() * (cosine * across + sine * along) + (1.0 - u.y).sqrt() * normal
}

#[cfg(test)]
mod tests {
    use glam::{Vec3, Vec4, vec3};

    use super::*;
    use crate::scene::{Material, NO_LIGHT, Projection, Triangle, Vertex};

    type Quad = [Vec3; 4];

    /// The share of pixels whose path meets a second surface, whether that is an isolated model, and whether it is an
    /// open scene.
    fn sketch(quads: &[Quad], position: Vec3) -> (f64, bool, bool) {
        let vertex = |position: Vec3| Vertex { position, colour: Vec4::ONE, ..Vertex::default() };
        let triangle = |vertices: [u32; 3]| Triangle { vertices, material: 0, light: NO_LIGHT };
        let scene = Scene {
            vertices: quads.iter().flatten().map(|corner| vertex(*corner)).collect::<Vec<_>>().into(),
            triangles: (0..quads.len() as u32)
                .flat_map(|i| [[0, 1, 2], [0, 2, 3]].map(|t| triangle(t.map(|corner| 4 * i + corner))))
                .collect(),
            materials: vec![Material::default()],
            ..Scene::default()
        };
        let camera = Camera {
            name: "camera".into(),
            position,
            axes: [Vec3::X, Vec3::Y, Vec3::Z],
            projection: Projection::Orthographic { xmag: 1.0, ymag: 1.0 },
            near: 0.0,
            far: f32::INFINITY,
            lens: None,
        };
        let size = [64, 64];
        let is_open = shows_open_scene(&scene, &camera, size);
        (second_surfaces(&scene, &camera, size), shows_isolated_model(&scene, &camera, size), is_open)
    }

    /// A rectangle at z = 0.
    fn floor([x0, x1]: [f32; 2], half: f32) -> Quad {
        [vec3(x0, -half, 0.0), vec3(x1, -half, 0.0), vec3(x1, half, 0.0), vec3(x0, half, 0.0)]
    }

    /// Nothing, parts of the view without anything above them, the foot of an endless wall, and the inside of a box.
    #[test]
    fn second_surfaces_are_those_of_closed_forms() {
        let above = vec3(0.0, 0.0, 0.5);
        assert_eq!(sketch(&[], above), (0.0, true, true));
        let part = |x: f32| sketch(&[floor([-1.0, x], 1.0)], above);
        assert_eq!(part(-0.25), (0.0, true, true));
        assert_eq!(part(0.25), (0.0, false, true));
        // The camera is above the wall. Half of the directions above any point of the floor go towards the wall. That
        // leaves few paths only if very little of the floor is in view.
        let wall = [[-1e4, 0.0], [1e4, 0.0], [1e4, 1e4], [-1e4, 1e4]].map(|[y, z]| vec3(0.0, y, z));
        for (x, covered, is_model, is_open) in
            [(1.0, 1.0, false, false), (-0.25, 0.375, false, true), (-0.8, 0.125, true, true)]
        {
            let (share, found, open) = sketch(&[floor([-1.0, x], 1.0), wall], vec3(0.0, 0.0, 2e4));
            assert_eq!((found, open), (is_model, is_open), "{x}");
            // Rays in even directions differ from their share by the logarithm of their number: about five.
            assert!((share - 0.5 * covered).abs() < 5.0 / 256.0, "{share}");
        }
        // The camera looks along -z from within a cube of half a side of 1.
        let sides: Vec<Quad> = (0..3)
            .flat_map(|axis| [-1.0, 1.0].map(|at| (axis, at)))
            .map(|(axis, at)| {
                [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]].map(|[u, v]| {
                    let mut corner = Vec3::splat(at);
                    (corner[(axis + 1) % 3], corner[(axis + 2) % 3]) = (u, v);
                    corner
                })
            })
            .collect();
        assert_eq!(sketch(&sides, above), (1.0, false, false));
    }
}
