//! The nearest surface along a ray, for what is asked about a few rays: a picked pixel, the focus of a lens, or how
//! much of the view is empty.

use std::ops::{Range, RangeInclusive};

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use super::description::Scene;
use super::instance::Instance;
use crate::procedural::box_corners;

/// A surface that a ray meets.
pub struct Nearest {
    /// The multiple of the ray's direction at which it does.
    pub depth: f64,
    /// Index of its material.
    pub material: u32,
    /// Unit normal of the triangle, to either side; none of an object that is a function, or of a triangle of no area.
    pub normal: Option<DVec3>,
}

/// A scene's surfaces, searched by rays on the CPU. Making it reads each triangle once; a ray then tests only the runs
/// of triangles whose box it meets.
pub struct SurfaceSearch<'a> {
    scene: &'a Scene,
    /// Runs of the triangles that are no part of a shared mesh.
    flat: Vec<Run>,
    /// Runs of each shared mesh, in its own space.
    shared: Vec<Vec<Run>>,
    /// The box around each instance.
    instances: Vec<Box3>,
}

/// Consecutive triangles, which are mostly neighbours in a mesh, and the box around them.
struct Run {
    triangles: Range<usize>,
    bounds: Box3,
}

/// Lower and upper corner of a box along the axes.
type Box3 = [Vec3; 2];

/// Triangles of a run: about as many as make a test of its box cheap beside theirs, while the box stays small.
const RUN_LENGTH: usize = 32;

impl<'a> SurfaceSearch<'a> {
    /// Of all surfaces of `scene`.
    pub fn new(scene: &'a Scene) -> Self {
        let shared: Vec<_> = scene.shared_meshes.iter().map(|mesh| runs(scene, mesh.triangles.clone())).collect();
        let meshes: Vec<_> = shared.iter().map(|runs| around(runs.iter().flat_map(|run| run.bounds))).collect();
        let instances = scene.instances.iter().map(|instance| placed(meshes[instance.mesh], instance)).collect();
        SurfaceSearch { scene, flat: runs(scene, 0..scene.flat_triangles()), shared, instances }
    }

    /// The first surface that a ray meets at a multiple of `way` in `range`, in normalised space. Textures let no ray
    /// pass, and objects that are functions are met at their boxes.
    pub fn nearest(&self, origin: DVec3, way: DVec3, range: &RangeInclusive<f64>) -> Option<Nearest> {
        let scene = self.scene;
        let depths = |bounds: Box3| {
            box_depths(bounds, origin, way).filter(|[enter, leave]| enter <= range.end() && leave >= range.start())
        };
        let met = |index: usize, place: &dyn Fn(Vec3) -> Vec3| {
            let corners = scene.triangle_positions(index).map(|corner| place(corner).as_dvec3());
            let depth = triangle_depth(corners, origin, way).filter(|depth| range.contains(depth))?;
            let [a, b, c] = corners;
            let normal = (b - a).cross(c - a).try_normalize();
            Some(Nearest { depth, material: scene.triangles[index].material, normal })
        };
        let flat = self.flat.iter().filter(|run| depths(run.bounds).is_some()).flat_map(|run| run.triangles.clone());
        let flat = flat.filter_map(|index| met(index, &|corner| corner));
        let instances = scene.instances.iter().zip(&self.instances).filter(|(_, bounds)| depths(**bounds).is_some());
        let of_instances = instances.flat_map(|(instance, _)| {
            let runs = self.shared[instance.mesh].iter();
            let runs = runs.filter(move |run| depths(placed(run.bounds, instance)).is_some());
            runs.flat_map(|run| run.triangles.clone()).filter_map(move |index| met(index, &|p| instance.apply(p)))
        });
        let objects = scene.procedurals.iter().filter_map(|object| {
            let [enter, _] = depths(around(object.corners()))?;
            range.contains(&enter).then_some(Nearest { depth: enter, material: object.material, normal: None })
        });
        flat.chain(of_instances).chain(objects).min_by(|a, b| a.depth.total_cmp(&b.depth))
    }
}

/// The runs of some triangles of a scene.
fn runs(scene: &Scene, triangles: Range<usize>) -> Vec<Run> {
    let run = |start: usize| {
        let triangles = start..(start + RUN_LENGTH).min(triangles.end);
        Run { bounds: around(triangles.clone().flat_map(|index| scene.triangle_positions(index))), triangles }
    };
    triangles.clone().into_par_iter().step_by(RUN_LENGTH).map(run).collect()
}

/// The box around points.
fn around(points: impl IntoIterator<Item = Vec3>) -> Box3 {
    let grown = |[lower, upper]: Box3, point: Vec3| [lower.min(point), upper.max(point)];
    points.into_iter().fold([Vec3::INFINITY, Vec3::NEG_INFINITY], grown)
}

/// The box around an instance of what `bounds` is around.
fn placed(bounds: Box3, instance: &Instance) -> Box3 {
    around(box_corners(bounds.map(|end| end.as_dvec3())).map(|corner| instance.apply(corner.as_vec3())))
}

/// The multiples of `way` at which a ray enters and leaves a box.
fn box_depths([lower, upper]: Box3, origin: DVec3, way: DVec3) -> Option<[f64; 2]> {
    let (a, b) = ((lower.as_dvec3() - origin) / way, (upper.as_dvec3() - origin) / way);
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

#[cfg(test)]
mod tests {
    use glam::{Mat3, Vec4};

    use super::*;
    use crate::scene::{Material, NO_LIGHT, SharedMesh, Triangle, Vertex};

    /// Numbers from -1 to 1 (Steele and Vigna's SplitMix64).
    struct Numbers(u64);

    impl Numbers {
        fn next(&mut self) -> f64 {
            self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
            let z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
            let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
            ((z ^ (z >> 31)) >> 11) as f64 / (1_u64 << 52) as f64 - 1.0
        }

        fn point(&mut self) -> Vec3 {
            DVec3::new(self.next(), self.next(), self.next()).as_vec3()
        }
    }

    /// The nearest depth by the method of Moller and Trumbore, over all triangles.
    fn oracle(triangles: &[[DVec3; 3]], origin: DVec3, way: DVec3, range: &RangeInclusive<f64>) -> Option<f64> {
        let depth = |[a, b, c]: &[DVec3; 3]| {
            let (ab, ac, from) = (b - a, c - a, origin - a);
            let p = way.cross(ac);
            let inverse = 1.0 / ab.dot(p);
            let q = from.cross(ab);
            let (u, v, depth) = (from.dot(p) * inverse, way.dot(q) * inverse, ac.dot(q) * inverse);
            (u >= 0.0 && v >= 0.0 && u + v <= 1.0 && range.contains(&depth)).then_some(depth)
        };
        triangles.iter().filter_map(depth).min_by(f64::total_cmp)
    }

    /// Each ray meets what it meets if all triangles are tested: with numbers of triangles around the length of a run,
    /// in the scene and in a mesh with two instances.
    #[test]
    fn a_search_by_runs_finds_what_all_triangles_have() {
        let mut numbers = Numbers(7);
        let (mut hits, mut misses) = (0, 0);
        for (flat, shared) in [(0, 0), (1, 0), (31, 1), (32, 31), (33, 32), (65, 33), (500, 100)] {
            let corners: Vec<Vec3> = (0..flat + shared)
                .flat_map(|_| {
                    let centre = numbers.point();
                    [0; 3].map(|_| centre + 0.6 * numbers.point())
                })
                .collect();
            let vertex = |position: &Vec3| Vertex { position: *position, colour: Vec4::ONE, ..Vertex::default() };
            let indices = |i: u32| [3 * i, 3 * i + 1, 3 * i + 2];
            let instances = [(0.5, 0.3), (-0.7, 0.9)].map(|(x, size)| Instance {
                mesh: 0,
                linear: Mat3::from_rotation_z(x) * size,
                origin: Vec3::splat(x),
            });
            let mesh = SharedMesh { triangles: flat..flat + shared, vertices: 3 * flat..3 * (flat + shared) };
            let scene = Scene {
                vertices: corners.iter().map(vertex).collect::<Vec<_>>().into(),
                triangles: (0..(flat + shared) as u32)
                    .map(|i| Triangle { vertices: indices(i), material: i, light: NO_LIGHT })
                    .collect(),
                materials: vec![Material::default(); flat + shared],
                shared_meshes: if shared > 0 { vec![mesh] } else { Vec::new() },
                instances: if shared > 0 { instances.to_vec() } else { Vec::new() },
                ..Scene::default()
            };
            let own = (0..flat).map(|i| scene.triangle_positions(i));
            let placed = scene.instance_triangles().map(|(_, corners)| corners);
            let all: Vec<_> = own.chain(placed).map(|corners| corners.map(|corner| corner.as_dvec3())).collect();
            let search = SurfaceSearch::new(&scene);
            let mut lacking = SurfaceSearch::new(&scene);
            lacking.flat.truncate(lacking.flat.len().saturating_sub(2));
            let mut faults = 0;
            for range in [0.0..=f64::MAX, 0.3..=0.6] {
                for _ in 0..300 {
                    let (origin, way) = (numbers.point().as_dvec3(), numbers.point().as_dvec3());
                    let expected = oracle(&all, origin, way, &range);
                    let depth =
                        |search: &SurfaceSearch<'_>| search.nearest(origin, way, &range).map(|found| found.depth);
                    // Two formulas in double precision, of triangles that may be slender.
                    let is_same = |found: Option<f64>| match (found, expected) {
                        (Some(found), Some(expected)) => (found - expected).abs() <= 1e-9 * expected.abs().max(1.0),
                        (found, expected) => found == expected,
                    };
                    *if expected.is_some() { &mut hits } else { &mut misses } += 1;
                    assert!(is_same(depth(&search)), "{flat} and {shared} triangles, {range:?}: not {expected:?}");
                    faults += u32::from(!is_same(depth(&lacking)));
                }
            }
            assert!(faults > 0 || flat <= RUN_LENGTH, "{flat} triangles, without the last two runs");
        }
        assert!(hits > 500 && misses > 500, "{hits} hits, {misses} misses");
    }
}
