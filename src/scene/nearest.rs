//! The nearest surface along a ray, for queries of few rays: a picked pixel, the focus of a lens, the empty share of a
//! view.

use std::ops::{Range, RangeInclusive};

use glam::DVec3;
use rayon::prelude::*;

use super::description::Scene;
use super::instance::Instance;
use crate::bvh::{Aabb, BoxTree};
use crate::procedural::box_corners;

/// A surface that a ray meets.
pub struct Nearest {
    /// The multiple of the ray's direction at which it does.
    pub depth: f64,
    /// Index of its material.
    pub material: u32,
    /// Unit normal of the triangle, to either side; `None` for a procedural object, or for a triangle without area.
    pub normal: Option<DVec3>,
}

/// A scene's surfaces, searched by rays on the CPU. Making it reads each triangle once.
pub struct SurfaceSearch<'a> {
    scene: &'a Scene,
    /// The triangles that belong to no shared mesh.
    unshared: Runs,
    /// The triangles of each shared mesh, in its own space.
    shared: Vec<Runs>,
    /// The boxes around instances.
    instances: BoxTree,
}

/// Consecutive triangles, divided into runs. The triangles of a run are mostly neighbours in a mesh.
struct Runs {
    triangles: Range<usize>,
    /// The boxes around the runs.
    boxes: BoxTree,
}

/// Triangles of a run. With fewer, rays are faster, and the tree takes longer to build. With 16, the tree over the runs
/// of `scenes/crowd.glb` takes 8 ms, and the 512 rays of `src/techniques/view_sketch.rs` take 22 ms.
const RUN_LENGTH: usize = 16;

impl<'a> SurfaceSearch<'a> {
    /// A search over all surfaces of `scene`.
    pub fn new(scene: &'a Scene) -> Self {
        let shared: Vec<_> = scene.shared_meshes.iter().map(|mesh| Runs::new(scene, mesh.triangles.clone())).collect();
        let around = |instance: &Instance| placed(shared[instance.mesh].boxes.bounds(), instance);
        let instances = BoxTree::new(scene.instances.par_iter().map(around));
        SurfaceSearch { scene, unshared: Runs::new(scene, 0..scene.unshared_triangles()), shared, instances }
    }

    /// The first surface that a ray meets at a multiple of `direction` in `range`, in normalised space. Materials and
    /// textures that let light pass count as opaque, and procedural objects as their boxes.
    pub fn nearest(&self, origin: DVec3, direction: DVec3, range: &RangeInclusive<f64>) -> Option<Nearest> {
        let scene = self.scene;
        let enters = |bounds: Aabb| {
            let [enter, leave] = box_depths(bounds, origin, direction)?;
            (enter <= *range.end() && leave >= *range.start()).then_some(enter)
        };
        let mut runs: Vec<_> = self.unshared.entered(enters).map(|(enter, run)| (enter, run, None)).collect();
        for (_, index) in self.instances.entered(enters) {
            let instance = &scene.instances[index];
            let entered = self.shared[instance.mesh].entered(|bounds| enters(placed(bounds, instance)));
            runs.extend(entered.map(|(enter, run)| (enter, run, Some(instance))));
        }
        runs.sort_by(|a, b| a.0.total_cmp(&b.0));
        let by_depth = |a: &Nearest, b: &Nearest| a.depth.total_cmp(&b.depth);
        let objects = scene.procedurals.iter().filter_map(|object| {
            let enter = enters(Aabb::of(object.corners()))?;
            range.contains(&enter).then_some(Nearest { depth: enter, material: object.material, normal: None })
        });
        let mut nearest = objects.min_by(by_depth);
        for (enter, run, instance) in runs {
            if nearest.as_ref().is_some_and(|nearest| nearest.depth < enter) {
                break;
            }
            let met = run.filter_map(|index| {
                let place = |corner| instance.map_or(corner, |instance| instance.apply(corner));
                let corners = scene.triangle_positions(index).map(|corner| place(corner).as_dvec3());
                let depth = triangle_depth(corners, origin, direction).filter(|depth| range.contains(depth))?;
                let [a, b, c] = corners;
                let normal = (b - a).cross(c - a).try_normalize();
                Some(Nearest { depth, material: scene.triangles[index].material, normal })
            });
            nearest = nearest.into_iter().chain(met).min_by(by_depth);
        }
        nearest
    }
}

impl Runs {
    /// The runs of some triangles of a scene.
    fn new(scene: &Scene, triangles: Range<usize>) -> Runs {
        let count = triangles.len().div_ceil(RUN_LENGTH);
        let around = |index| Aabb::of(run(&triangles, index).flat_map(|index| scene.triangle_positions(index)));
        Runs { boxes: BoxTree::new((0..count).into_par_iter().map(around)), triangles }
    }

    /// The runs whose box a ray enters, with the distance at which it does, in no order; `enters` returns that distance
    /// for a box.
    fn entered(&self, enters: impl Fn(Aabb) -> Option<f64>) -> impl Iterator<Item = (f64, Range<usize>)> {
        self.boxes.entered(enters).into_iter().map(|(enter, index)| (enter, run(&self.triangles, index)))
    }
}

/// Run `index` of some triangles.
fn run(triangles: &Range<usize>, index: usize) -> Range<usize> {
    let start = triangles.start + RUN_LENGTH * index;
    start..(start + RUN_LENGTH).min(triangles.end)
}

/// The box around an instance of what `bounds` is around.
fn placed(bounds: Aabb, instance: &Instance) -> Aabb {
    let corners = box_corners([bounds.min, bounds.max].map(|end| end.as_dvec3()));
    Aabb::of(corners.map(|corner| instance.apply(corner.as_vec3())))
}

/// The multiples of `direction` at which a ray enters and leaves a box.
fn box_depths(bounds: Aabb, origin: DVec3, direction: DVec3) -> Option<[f64; 2]> {
    let [a, b] = [bounds.min, bounds.max].map(|end| (end.as_dvec3() - origin) / direction);
    // 0 / 0 along an axis: the ray lies in a side of the box, so that this axis does not bound it.
    let is_free = a.is_nan_mask() | b.is_nan_mask();
    let enter = DVec3::select(is_free, DVec3::NEG_INFINITY, a.min(b)).max_element();
    let leave = DVec3::select(is_free, DVec3::INFINITY, a.max(b)).min_element();
    (enter <= leave).then_some([enter, leave])
}

/// The multiple of `direction` at which a ray meets a triangle, from either side. Triangles that share an edge find the
/// same sign for it, so no ray passes between them.
fn triangle_depth([a, b, c]: [DVec3; 3], origin: DVec3, direction: DVec3) -> Option<f64> {
    let (a, b, c) = (a - origin, b - origin, c - origin);
    let sides = DVec3::new(direction.dot(c.cross(b)), direction.dot(a.cross(c)), direction.dot(b.cross(a)));
    if sides.min_element() < 0.0 && sides.max_element() > 0.0 {
        return None;
    }
    let normal = (b - a).cross(c - a);
    let depth = a.dot(normal) / direction.dot(normal);
    depth.is_finite().then_some(depth)
}

#[cfg(test)]
mod tests {
    use glam::{Mat3, Vec3, Vec4};

    use super::*;
    use crate::random::Random;
    use crate::scene::{Material, NO_LIGHT, SharedMesh, Triangle, Vertex};

    fn number(random: &mut Random) -> f64 {
        2.0 * random.uniform() - 1.0
    }

    fn point(random: &mut Random) -> Vec3 {
        DVec3::from_array([(); 3].map(|()| number(random))).as_vec3()
    }

    /// The nearest depth by the method of Moller and Trumbore, over all triangles.
    fn oracle(triangles: &[[DVec3; 3]], origin: DVec3, direction: DVec3, range: &RangeInclusive<f64>) -> Option<f64> {
        let depth = |[a, b, c]: &[DVec3; 3]| {
            let (ab, ac, from) = (b - a, c - a, origin - a);
            let p = direction.cross(ac);
            let inverse = 1.0 / ab.dot(p);
            let q = from.cross(ab);
            let (u, v, depth) = (from.dot(p) * inverse, direction.dot(q) * inverse, ac.dot(q) * inverse);
            (u >= 0.0 && v >= 0.0 && u + v <= 1.0 && range.contains(&depth)).then_some(depth)
        };
        triangles.iter().filter_map(depth).min_by(f64::total_cmp)
    }

    /// Each ray meets what it meets if all triangles are tested: with numbers of triangles around the length of a run,
    /// in the scene and in a mesh with three instances.
    #[test]
    fn a_search_by_runs_finds_what_all_triangles_have() {
        let mut random = Random(7);
        let (mut hits, mut misses) = (0, 0);
        for (unshared, shared) in [(0, 0), (1, 0), (15, 1), (16, 15), (17, 16), (33, 17), (500, 100)] {
            let corners: Vec<Vec3> = (0..unshared + shared)
                .flat_map(|_| {
                    let centre = point(&mut random);
                    [0; 3].map(|_| centre + 0.6 * point(&mut random))
                })
                .collect();
            let vertex = |position: &Vec3| Vertex { position: *position, colour: Vec4::ONE, ..Vertex::default() };
            let indices = |i: u32| [3 * i, 3 * i + 1, 3 * i + 2];
            let instances = [(0.5, 0.3), (-0.7, 0.9), (0.1, 0.2)].map(|(x, size)| Instance {
                mesh: 0,
                linear: Mat3::from_rotation_z(x) * size,
                origin: Vec3::splat(x),
            });
            let mesh =
                SharedMesh { triangles: unshared..unshared + shared, vertices: 3 * unshared..3 * (unshared + shared) };
            let scene = Scene {
                vertices: corners.iter().map(vertex).collect::<Vec<_>>().into(),
                triangles: (0..(unshared + shared) as u32)
                    .map(|i| Triangle { vertices: indices(i), material: i, light: NO_LIGHT })
                    .collect(),
                materials: vec![Material::default(); unshared + shared],
                shared_meshes: if shared > 0 { vec![mesh] } else { Vec::new() },
                instances: if shared > 0 { instances.to_vec() } else { Vec::new() },
                ..Scene::default()
            };
            let own = (0..unshared).map(|i| scene.triangle_positions(i));
            let placed = scene.instance_triangles().map(|(_, corners)| corners);
            let all: Vec<_> = own.chain(placed).map(|corners| corners.map(|corner| corner.as_dvec3())).collect();
            let search = SurfaceSearch::new(&scene);
            let mut lacking = SurfaceSearch::new(&scene);
            lacking.unshared.triangles.end = unshared.saturating_sub(RUN_LENGTH + 1);
            let mut faults = 0;
            for range in [0.0..=f64::MAX, 0.3..=0.6] {
                for _ in 0..300 {
                    let (origin, direction) = (point(&mut random).as_dvec3(), point(&mut random).as_dvec3());
                    let expected = oracle(&all, origin, direction, &range);
                    let depth =
                        |search: &SurfaceSearch<'_>| search.nearest(origin, direction, &range).map(|found| found.depth);
                    // Two formulas in double precision, of triangles that may be slender.
                    let is_same = |found: Option<f64>| match (found, expected) {
                        (Some(found), Some(expected)) => (found - expected).abs() <= 1e-9 * expected.abs().max(1.0),
                        (found, expected) => found == expected,
                    };
                    *if expected.is_some() { &mut hits } else { &mut misses } += 1;
                    assert!(is_same(depth(&search)), "{unshared} and {shared} triangles, {range:?}: not {expected:?}");
                    faults += u32::from(!is_same(depth(&lacking)));
                }
            }
            assert!(faults > 0 || unshared <= RUN_LENGTH, "{unshared} triangles, without the last two runs");
        }
        assert!(hits > 500 && misses > 500, "{hits} hits, {misses} misses");
    }

    /// Rays along an axis meet what has an edge or a face in their plane.
    #[test]
    fn rays_in_a_side_of_a_box_are_met() {
        let corner = |x: f32, y: f32| Vec3::new(x, y, 0.0);
        for shift in [-1.0, 0.0] {
            let corners =
                [corner(shift, -1.0), corner(shift + 1.0, -1.0), corner(shift + 1.0, 1.0), corner(shift, 1.0)];
            let vertex = |position| Vertex { position, colour: Vec4::ONE, ..Vertex::default() };
            let triangle = |vertices| Triangle { vertices, material: 0, light: NO_LIGHT };
            let scene = Scene {
                vertices: corners.map(vertex).to_vec().into(),
                triangles: [[0, 1, 2], [0, 2, 3]].map(triangle).to_vec(),
                materials: vec![Material::default()],
                ..Scene::default()
            };
            let found = SurfaceSearch::new(&scene).nearest(DVec3::Z, DVec3::NEG_Z, &(0.0..=f64::MAX));
            assert_eq!(found.map(|nearest| nearest.depth), Some(1.0), "from x = {shift}");
        }
    }
}
