//! Volumes within volumes: which surfaces lie in the volume (KHR_materials_volume) of another object.
//!
//! glTF has no word for it, so geometry decides: a primitive lies in the smallest closed volume that encloses it. Light
//! is then refracted from that volume into its own, and absorbed on the way to it. Kernels need no stack of volumes: a
//! ray may begin anywhere. Primitives that are only partly inside count as outside. So do instances, and lamps, because
//! kernels do not absorb their light on its way to the surfaces that sample it. The inner wall of a hollow volume has
//! its normals towards the hollow, and encloses air.

use std::collections::HashMap;
use std::ops::Range;
use std::sync::atomic::{AtomicU64, Ordering};

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use super::geometry::{Geometry, PlacedPrimitives, joined};
use super::material::{Material, Medium};
use super::notes::Notes;
use super::triangle::Triangle;
use crate::bvh::{Aabb, BoxTree};

/// Maximum number of triangles that are tested for crossings: some seconds.
const MAX_TESTS: u64 = 2_000_000_000;

/// Directions of the rays that count crossings, which are along no edges of usual models. The majority decides, so that
/// a ray through an edge does no harm.
const DIRECTIONS: [DVec3; 3] =
    [DVec3::new(0.8372, 0.3391, 0.4291), DVec3::new(-0.2713, 0.9137, 0.3027), DVec3::new(0.1549, -0.4213, 0.8936)];

/// Number of points of a primitive that are tested, spread over its triangles; all must be inside. Each takes as many
/// tests as the volume has triangles and [`DIRECTIONS`]: with eight, [`MAX_TESTS`] is reached by a hundred stones in
/// water of 800,000 triangles.
const POINTS: usize = 8;

/// How far points are drawn towards the primitive's middle, as a share of the way: an object may stand on the floor of
/// the volume.
const DRAWN: f64 = 1e-3;

/// Maximum length of the sum of a closed surface's area vectors, over its area. It is 0 but for gaps and rounding.
const CLOSED: f64 = 1e-3;

/// A primitive, placed.
struct Placed {
    triangles: Range<usize>,
    material: u32,
    bounds: [DVec3; 2],
    /// It is the inner wall of a hollow volume.
    is_hollow: bool,
}

/// Gives the primitives that lie in volumes copies of their materials with [`Material::medium`] set.
pub(super) fn immerse(geometry: &mut Geometry, materials: &mut Vec<Material>, notes: &mut Notes) {
    if !materials.iter().any(Material::encloses_volume) {
        return;
    }
    let PlacedPrimitives { world, triangles, ranges } = geometry.placed_primitives();
    let mut primitives: Vec<Placed> =
        ranges.par_iter().filter_map(|range| Placed::new(range, world, triangles)).collect();
    primitives
        .par_iter_mut()
        .filter(|primitive| materials[primitive.material as usize].encloses_volume())
        .for_each(|vessel| vessel.is_hollow = vessel.faces_inwards(world, triangles));
    let mut vessels: Vec<&Placed> =
        primitives.iter().filter(|primitive| materials[primitive.material as usize].encloses_volume()).collect();
    vessels.sort_by(|a, b| a.size().total_cmp(&b.size()));
    let to_unit = to_unit_box(&vessels);
    let tree = BoxTree::new(vessels.par_iter().map(|vessel| vessel.unit_bounds(&to_unit)));
    let tests = |primitive: &Placed| (primitive.triangles.len() * POINTS * DIRECTIONS.len()) as u64;
    let all_tests = AtomicU64::new(0);
    // From the smallest.
    let candidates = |primitive: &Placed| -> Vec<&Placed> {
        let lamp = materials[primitive.material as usize].emissive != Vec3::ZERO;
        if lamp || primitive.is_hollow || all_tests.load(Ordering::Relaxed) > MAX_TESTS {
            return Vec::new();
        }
        let bounds = primitive.unit_bounds(&to_unit);
        let contains = |outer: Aabb| outer.min.cmple(bounds.min).all() && outer.max.cmpge(bounds.max).all();
        let mut found: Vec<usize> = tree.entered(|outer| contains(outer).then_some(0.0)).iter().map(|f| f.1).collect();
        found.sort_unstable();
        let around: Vec<&Placed> =
            found.iter().map(|i| vessels[*i]).filter(|vessel| vessel.may_enclose(primitive)).collect();
        all_tests.fetch_add(around.iter().map(|vessel| tests(vessel)).sum(), Ordering::Relaxed);
        around
    };
    let pairs: Vec<(&Placed, Vec<&Placed>)> =
        primitives.par_iter().map(|primitive| (primitive, candidates(primitive))).collect();
    if all_tests.into_inner() > MAX_TESTS {
        notes.push("too many objects may lie in volumes of others: all of them count as lying in air");
        return;
    }
    let around = |(primitive, vessels): &(&Placed, Vec<&Placed>)| {
        let enclosing = vessels.iter().find(|vessel| vessel.encloses(primitive, world, triangles));
        let vessel = enclosing.filter(|vessel| !vessel.is_hollow)?;
        Some((primitive.triangles.clone(), primitive.material, vessel.material))
    };
    let immersed: Vec<(Range<usize>, u32, u32)> = pairs.par_iter().filter_map(around).collect();
    let mut copies = HashMap::new();
    for (range, material, vessel) in immersed {
        let copy = *copies.entry((material, vessel)).or_insert_with(|| {
            let Material { ior, volume, .. } = materials[vessel as usize];
            let medium = volume.map(|volume| Medium { ior: if ior > 0.0 { ior } else { 1.0 }, volume });
            materials.push(Material { medium, ..materials[material as usize].clone() });
            materials.len() as u32 - 1
        });
        triangles[range].iter_mut().for_each(|triangle| triangle.material = copy);
    }
}

impl Placed {
    fn new(range: &Range<usize>, world: &[DVec3], triangles: &[Triangle]) -> Option<Placed> {
        let corners = || triangles[range.clone()].iter().flat_map(|t| t.vertices).map(|v| world[v as usize]);
        let bounds = [corners().reduce(DVec3::min)?, corners().reduce(DVec3::max)?];
        let material = triangles[range.start].material;
        Some(Placed { triangles: range.clone(), material, bounds, is_hollow: false })
    }

    fn middle(&self) -> DVec3 {
        0.5 * self.bounds[0] + 0.5 * self.bounds[1]
    }

    /// Whether the surface is closed and its normals point into what it encloses: the volume is negative.
    fn faces_inwards(&self, world: &[DVec3], triangles: &[Triangle]) -> bool {
        let scale = self.size();
        let (mut area, mut vector, mut volume) = (0.0, DVec3::ZERO, 0.0);
        for triangle in &triangles[self.triangles.clone()] {
            let [a, b, c] = triangle.vertices.map(|v| (world[v as usize] - self.middle()) / scale);
            let normal = (b - a).cross(c - a);
            area += normal.length();
            vector += normal;
            volume += a.dot(normal);
        }
        volume < 0.0 && vector.length() < CLOSED * area
    }

    /// Diagonal of its bounding box.
    fn size(&self) -> f64 {
        (self.bounds[1] - self.bounds[0]).length()
    }

    /// Its bounding box in f32, of coordinates that `to_unit` brings into a range where these are finite. Rounding
    /// keeps the order of numbers: what is within a box stays there.
    fn unit_bounds(&self, to_unit: &impl Fn(DVec3) -> DVec3) -> Aabb {
        Aabb::of(self.bounds.map(|corner| to_unit(corner).as_vec3()))
    }

    /// Whether the other's bounding box is within its own, which is larger.
    fn may_enclose(&self, other: &Placed) -> bool {
        let within = self.bounds[0].cmple(other.bounds[0]).all() && self.bounds[1].cmpge(other.bounds[1]).all();
        within && self.bounds != other.bounds
    }

    fn encloses(&self, other: &Placed, world: &[DVec3], triangles: &[Triangle]) -> bool {
        let count = other.triangles.len();
        let middle = |i: usize| {
            let corners = triangles[other.triangles.start + i].vertices.map(|v| world[v as usize]);
            ((corners[0] + corners[1] + corners[2]) / 3.0).lerp(other.middle(), DRAWN)
        };
        let inside = |point: DVec3| {
            let rays = DIRECTIONS.iter().filter(|direction| {
                let crosses = |t: &&Triangle| crosses(point, **direction, t.vertices.map(|v| world[v as usize]));
                triangles[self.triangles.clone()].iter().filter(crosses).count() % 2 == 1
            });
            2 * rays.count() > DIRECTIONS.len()
        };
        (0..POINTS).all(|i| inside(middle(i * (count - 1) / (POINTS - 1))))
    }
}

/// Maps the box around all vessels to the unit box. Halves are subtracted, because sums may overflow.
fn to_unit_box(vessels: &[&Placed]) -> impl Fn(DVec3) -> DVec3 + Sync + use<> {
    let [low, high] = vessels.iter().map(|vessel| vessel.bounds).reduce(joined).unwrap_or_default();
    let extent = (0.5 * high - 0.5 * low).max(DVec3::splat(f64::MIN_POSITIVE));
    move |point| (0.5 * point - 0.5 * low) / extent
}

/// Whether the ray crosses the triangle (Moller and Trumbore 1997).
fn crosses(origin: DVec3, direction: DVec3, [a, b, c]: [DVec3; 3]) -> bool {
    let (e1, e2, from) = (b - a, c - a, origin - a);
    let (p, q) = (direction.cross(e2), from.cross(e1));
    let determinant = e1.dot(p);
    let [u, v, t] = [from.dot(p), direction.dot(q), e2.dot(q)].map(|x| x / determinant);
    // With a determinant of 0 they are not finite, or NaN, and the comparisons fail.
    u >= 0.0 && v >= 0.0 && u + v <= 1.0 && t > 0.0
}
