//! A rough look at what a camera sees, by a few rays on the CPU.

use std::f64::consts::TAU;

use glam::{DVec2, DVec3};

use crate::gpu_scene::CameraUniform;
use crate::scene::{Camera, Scene, SurfaceSearch};

/// Rays from the camera along each axis of the image. The shares of so many are right within a few hundredths. All rays
/// together take a few milliseconds, or 0.1 s in a scene of 150,000 triangles.
const SIDE: u32 = 16;

/// The next ray starts above the surface by this share of the way to it, far more than rounding in double precision.
const OFFSET: f64 = 1e-4;

/// Models by themselves cover 0.05 to 0.47 of the image. A ball on a floor covers 0.59, and there `path` has the larger
/// error from the first sample of the default technique on.
const MAX_COVERAGE: f64 = 0.5;

/// Share of the pixels whose path meets a second surface: 0.004 to 0.075 for models by themselves, 0.21 to 1 in rooms
/// and landscapes.
const MAX_SECOND_SURFACES: f64 = 0.1;

/// What a few rays have met.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ViewSketch {
    /// Share of the image that shows a surface.
    pub coverage: f64,
    /// Share of the directions above these surfaces in which there is another surface, weighted by their cosine: the
    /// ambient occlusion. 0 if the image shows no surface.
    pub occlusion: f64,
}

impl ViewSketch {
    /// Looks at the scene by a ray through each of some points of the image, and another from where it ends.
    pub fn new(scene: &Scene, camera: &Camera, [width, height]: [u32; 2]) -> ViewSketch {
        let uniform = CameraUniform::new(camera, width, height);
        let range = f64::from(camera.near)..=f64::from(camera.far);
        let surfaces = SurfaceSearch::new(scene);
        let (mut met, mut occluded) = (0_u32, 0_u32);
        for index in 0..SIDE * SIDE {
            let [x, y] = [index % SIDE, index / SIDE].map(|i| (f64::from(i) + 0.5) / f64::from(SIDE));
            let (origin, way) = uniform.ray([x, y]);
            let Some(nearest) = surfaces.nearest(origin, way, &range) else { continue };
            met += 1;
            let normal = nearest.normal.unwrap_or(-way.normalize());
            let normal = if normal.dot(way) > 0.0 { -normal } else { normal };
            let above = origin + nearest.depth * (way * (1.0 - OFFSET));
            let next = cosine_weighted(normal, r2(index));
            occluded += u32::from(surfaces.nearest(above, next, &(0.0..=f64::MAX)).is_some());
        }
        let share = |part: u32, of: u32| f64::from(part) / f64::from(of.max(1));
        ViewSketch { coverage: share(met, SIDE * SIDE), occlusion: share(occluded, met) }
    }

    /// Whether it shows a model by itself: most pixels are empty, and few paths go on from one surface to another.
    /// Many samples of paths take little time there, and little of the light is indirect, which is what needs records.
    pub fn is_of_few_paths(&self) -> bool {
        self.coverage < MAX_COVERAGE && self.coverage * self.occlusion < MAX_SECOND_SURFACES
    }
}

/// The point `index` of Roberts' sequence R2, which fills the unit square evenly at any length.
fn r2(index: u32) -> DVec2 {
    const STEP: DVec2 = DVec2::new(0.754_877_666_246_692_7, 0.569_840_290_998_053_2);
    (DVec2::splat(0.5) + f64::from(index) * STEP).fract()
}

/// A unit vector above a surface, with a density in proportion to its cosine.
fn cosine_weighted(normal: DVec3, u: DVec2) -> DVec3 {
    let (across, along) = normal.any_orthonormal_pair();
    let (sine, cosine) = (TAU * u.x).sin_cos();
    u.y.sqrt() * (cosine * across + sine * along) + (1.0 - u.y).sqrt() * normal
}

#[cfg(test)]
mod tests {
    use glam::{Vec3, vec3};

    use super::*;
    use crate::scene::{Material, NO_LIGHT, Projection, Triangle, Vertex};

    type Quad = [Vec3; 4];

    fn sketch(quads: &[Quad], position: Vec3) -> ViewSketch {
        let vertex = |position: Vec3| Vertex { position, colour: glam::Vec4::ONE, ..Vertex::default() };
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
        ViewSketch::new(&scene, &camera, [64, 64])
    }

    /// A rectangle at z = 0.
    fn floor([x0, x1]: [f32; 2], half: f32) -> Quad {
        [vec3(x0, -half, 0.0), vec3(x1, -half, 0.0), vec3(x1, half, 0.0), vec3(x0, half, 0.0)]
    }

    /// Nothing, parts of the view without anything above them, the foot of an endless wall, and the inside of a box.
    #[test]
    fn coverage_and_occlusion_are_those_of_closed_forms() {
        let above = vec3(0.0, 0.0, 0.5);
        assert_eq!(sketch(&[], above), ViewSketch { coverage: 0.0, occlusion: 0.0 });
        let part = |x: f32| sketch(&[floor([-1.0, x], 1.0)], above);
        assert_eq!(part(-0.25), ViewSketch { coverage: 0.375, occlusion: 0.0 });
        assert_eq!(part(0.25), ViewSketch { coverage: 0.625, occlusion: 0.0 });
        // Half of the directions above any point of the floor go towards the wall.
        let wall = [[-1e4, 0.0], [1e4, 0.0], [1e4, 1e4], [-1e4, 1e4]].map(|[y, z]| vec3(0.0, y, z));
        let foot = sketch(&[floor([-1.0, 1.0], 1.0), wall], above);
        assert_eq!(foot.coverage, 1.0);
        // Shares of 256 points of an even sequence: a few points.
        assert!((foot.occlusion - 0.5).abs() < 0.02, "{foot:?}");
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
        assert_eq!(sketch(&sides, above), ViewSketch { coverage: 1.0, occlusion: 1.0 });
    }

    /// Paths are few if little of the view is covered and little of that is occluded.
    #[test]
    fn paths_are_few_where_little_is_seen_and_occluded() {
        let is_of_few = |coverage, occlusion| ViewSketch { coverage, occlusion }.is_of_few_paths();
        assert!(is_of_few(0.45, 0.2) && is_of_few(0.05, 1.0) && is_of_few(0.0, 0.0));
        assert!(!is_of_few(0.45, 0.3) && !is_of_few(0.55, 0.0) && !is_of_few(1.0, 1.0));
    }
}
