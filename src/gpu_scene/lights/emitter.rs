//! How emitter triangles of large mesh lights are sampled: in pairs that face opposite ways, and from afar by what they
//! send in the direction of the position.

use std::collections::HashMap;

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use super::layout::NEAR_LIGHT;
use crate::gpu_scene::cumulative::{cumulative, texels_of};
use crate::gpu_scene::oct_unwrap;
use crate::gpu_scene::receivers::ReceiverBounds;

/// Whether the mesh is convex: no corner lies above the plane of any triangle.
pub(super) fn is_convex(triangles: &[[Vec3; 3]], radius: f64) -> bool {
    triangles.iter().all(|[a, b, c]| {
        let normal = (*b - *a).cross(*c - *a).as_dvec3().normalize_or_zero();
        let above = |corner: &Vec3| (*corner - *a).as_dvec3().dot(normal) > 1e-3 * radius;
        !triangles.iter().flatten().any(above)
    })
}

/// A convex lamp as it is seen from afar.
pub(super) struct ConvexLamp<'a> {
    pub triangles: &'a [[Vec3; 3]],
    /// The share of each triangle in the lamp's power.
    pub powers: &'a [f64],
    /// A point within the lamp.
    pub centre: Vec3,
    pub radius: f32,
}

/// A direction from the centre of a lamp, and 1 over the distance at which receivers are expected there.
struct View {
    direction: DVec3,
    inverse_distance: f64,
}

/// A triangle's unit normal, and its centroid relative to the centre of the lamp.
struct Facet {
    normal: DVec3,
    centroid: DVec3,
}

impl ConvexLamp<'_> {
    /// For each of `side` x `side` cells of the octahedral map of directions, row by row: the cumulative probabilities
    /// of the triangles, by how much light each sends towards the receivers; four to a texel, padded with 1. The light
    /// that a triangle sends in a cell is the mean over the cell's corners. If `side` is even, a triangle that is
    /// visible from a cell is visible from one of its corners, because the folds of the map then lie along sides and
    /// diagonals of cells.
    pub fn cumulative_views(&self, side: u32, receivers: Option<ReceiverBounds>) -> Vec<[f32; 4]> {
        let facets = self.facets();
        let corners = side + 1;
        // Margin for rounded directions, and the minimum weight of a triangle that may be visible.
        let least = 0.25 / f64::from(side);
        let sent: Vec<f64> = (0..corners * corners)
            .into_par_iter()
            .flat_map_iter(|corner| {
                let at = |i: u32| 2.0 * f64::from(i) / f64::from(side) - 1.0;
                let view = self.view(oct_unwrap(at(corner % corners), at(corner / corners)), receivers);
                let powers = facets.iter().zip(self.powers);
                powers.map(|(facet, power)| power * facet.sends(&view, least)).collect::<Vec<_>>()
            })
            .collect();
        let cells = (0..side * side).into_par_iter().flat_map_iter(|cell| {
            let first = (cell / side) * corners + cell % side;
            let at_corners = [first, first + 1, first + corners, first + corners + 1]
                .map(|corner| &sent[corner as usize * facets.len()..][..facets.len()]);
            let weights: Vec<f64> = (0..facets.len()).map(|i| at_corners.iter().map(|sent| sent[i]).sum()).collect();
            texels_of(&cumulative(&weights)).collect::<Vec<_>>()
        });
        cells.collect()
    }

    fn facets(&self) -> Vec<Facet> {
        let facet = |[a, b, c]: &[Vec3; 3]| Facet {
            normal: (*b - *a).cross(*c - *a).as_dvec3().normalize_or_zero(),
            centroid: (a.as_dvec3() + b.as_dvec3() + c.as_dvec3()) / 3.0 - self.centre.as_dvec3(),
        };
        self.triangles.iter().map(facet).collect()
    }

    fn view(&self, direction: DVec3, receivers: Option<ReceiverBounds>) -> View {
        let distance = receivers.and_then(|bounds| bounds.middle_distance(self.centre, direction));
        // Nearer positions have no views.
        let inverse_distance = distance.map_or(0.0, |d| 1.0 / d.max(NEAR_LIGHT * f64::from(self.radius)));
        View { direction, inverse_distance }
    }
}

impl Facet {
    /// The light that a triangle of unit area sends to the receiver of a view, over what it would send from the lamp's
    /// centre if it faced the receiver. It is not below `least` if any position in the direction may see the triangle,
    /// else 0.
    fn sends(&self, view: &View, least: f64) -> f64 {
        // The centre lies below the plane of every triangle. So a triangle that is visible from any position in a
        // direction from it is visible from infinity in that direction.
        if self.normal.dot(view.direction) <= -least {
            return 0.0;
        }
        let to_receiver = view.direction - view.inverse_distance * self.centroid;
        (self.normal.dot(to_receiver) / to_receiver.length().powi(3)).max(least)
    }
}

/// The partner of each triangle: one that faces nearly the opposite way. Partners are mutual. A triangle for which none
/// is left is its own partner.
pub(super) fn partners(triangles: &[[Vec3; 3]]) -> Vec<u32> {
    /// Buckets per unit of a normal's coordinates: about 15 degrees each. With narrower ones, more triangles would have
    /// no partner; with wider ones, both partners would face away from more positions.
    const STEPS: f32 = 4.0;
    let bucket = |n: Vec3| (n * STEPS).round().as_ivec3().to_array();
    let normals: Vec<Vec3> = triangles.iter().map(|[a, b, c]| (b - a).cross(c - a).normalize_or_zero()).collect();
    let mut waiting: HashMap<[i32; 3], Vec<u32>> = HashMap::new();
    let mut partners: Vec<u32> = (0..triangles.len() as u32).collect();
    for (i, normal) in normals.iter().enumerate() {
        match waiting.get_mut(&bucket(-*normal)).and_then(Vec::pop) {
            Some(other) => {
                partners[i] = other;
                partners[other as usize] = i as u32;
            }
            None => waiting.entry(bucket(*normal)).or_default().push(i as u32),
        }
    }
    partners
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gpu_scene::bounds::{centre_of_area, sphere_about};
    use crate::random::r2;

    /// The triangles of an octahedron whose corners lie on a sphere, each divided into four, `times` times.
    fn ball(times: u32) -> Vec<[Vec3; 3]> {
        let [x, y, z] = [Vec3::X, Vec3::Y, Vec3::Z];
        let octants = (0..8).map(|i| [i & 1, i >> 1 & 1, i >> 2].map(|bit| 1.0 - 2.0 * bit as f32));
        let mut triangles: Vec<_> = octants
            .map(|[a, b, c]| if a * b * c > 0.0 { [a * x, b * y, c * z] } else { [a * x, c * z, b * y] })
            .collect();
        for _ in 0..times {
            let divided = triangles.iter().flat_map(|[a, b, c]| {
                let [ab, bc, ca] = [*a + *b, *b + *c, *c + *a].map(Vec3::normalize);
                [[*a, ab, ca], [ab, *b, bc], [ca, bc, *c], [ab, bc, ca]]
            });
            triangles = divided.collect();
        }
        triangles
    }

    /// The corner that the plane through the unit vectors cuts off a cube.
    fn cut_corner() -> Vec<[Vec3; 3]> {
        let [o, x, y, z] = [Vec3::ZERO, Vec3::X, Vec3::Y, Vec3::Z];
        vec![[o, y, x], [o, x, z], [o, z, y], [x, y, z]]
    }

    /// Triangles that have probability 0 in the cell of a direction, but are visible in that direction: from infinity,
    /// or from as near as views are used. `centre` is that of the lamp.
    fn missed(triangles: &[[Vec3; 3]], centre: Vec3, side: u32) -> usize {
        let powers = vec![1.0 / triangles.len() as f64; triangles.len()];
        let (centre, radius) = sphere_about(centre, triangles.iter().flatten().copied());
        let lamp = ConvexLamp { triangles, powers: &powers, centre, radius };
        let receivers = ReceiverBounds { centre: Vec3::new(0.5, -3.0, 1.0), radius: 6.0 };
        let views = lamp.cumulative_views(side, Some(receivers)).into_flattened();
        let stride = triangles.len().next_multiple_of(4);
        let facets = lamp.facets();
        // Points of the map that fill it evenly, and lie in its folds too.
        const COUNT: u32 = 4096;
        let points = (0..COUNT).map(r2);
        let in_folds = (0..COUNT).map(|i| [0.5, f64::from(i) / f64::from(COUNT)]);
        let mut missed = 0;
        for [u, v] in points.chain(in_folds) {
            let direction = oct_unwrap(2.0 * u - 1.0, 2.0 * v - 1.0);
            let nearest = direction * NEAR_LIGHT * f64::from(radius);
            let cell = |u: f64| ((u * f64::from(side)) as usize).min(side as usize - 1);
            let view = &views[(cell(v) * side as usize + cell(u)) * stride..][..facets.len()];
            let below = std::iter::once(0.0).chain(view.iter().copied());
            let is_visible =
                |facet: &Facet| facet.normal.dot(direction) > 0.0 || facet.normal.dot(nearest - facet.centroid) > 0.0;
            missed += facets
                .iter()
                .zip(view.iter().zip(below))
                .filter(|(facet, (end, start))| is_visible(facet) && *end <= start)
                .count();
        }
        missed
    }

    /// A triangle that light may come from has a probability, or the image would lack its light.
    #[test]
    fn every_visible_triangle_may_be_sampled() {
        let (ball, corner) = (ball(3), cut_corner());
        for side in [16, 18, 30, 48] {
            for lamp in [&ball, &corner] {
                assert_eq!(missed(lamp, centre_of_area(lamp), side), 0, "{side} cells a side");
            }
        }
        // The folds of the map cross the middle of cells.
        assert!(missed(&ball, Vec3::ZERO, 17) > 0);
        // The centre of the box lies outside of the lamp.
        assert!(missed(&corner, Vec3::splat(0.5), 48) > 0);
    }
}
