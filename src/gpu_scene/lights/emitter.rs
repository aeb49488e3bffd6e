//! How emitter triangles of large mesh lights are sampled: in pairs that face opposite ways, and by their projected
//! power from afar.

use std::collections::HashMap;

use glam::{DVec3, Vec3};

use super::layout::VIEW_SIDE;
use crate::gpu_scene::oct_unwrap;

/// Whether the triangles are a closed mesh that emits outwards, so that half of them face away from any position. The
/// area vectors of a closed mesh sum to 0.
pub(super) fn is_closed(triangles: &[[Vec3; 3]], two_sided: bool) -> bool {
    let mut sum = Vec3::ZERO;
    let mut area = 0.0;
    for [a, b, c] in triangles {
        let across = (*b - *a).cross(*c - *a);
        sum += across;
        area += across.length();
    }
    // The tolerance of a hundredth lets a mesh with a small hole for a socket count as closed.
    !two_sided && sum.length() < 0.01 * area
}

/// Whether the mesh is convex: no corner lies above the plane of any triangle.
pub(super) fn is_convex(triangles: &[[Vec3; 3]], radius: f64) -> bool {
    triangles.iter().all(|[a, b, c]| {
        let normal = (*b - *a).cross(*c - *a).as_dvec3().normalize_or_zero();
        let above = |corner: &Vec3| (*corner - *a).as_dvec3().dot(normal) > 1e-3 * radius;
        !triangles.iter().flatten().any(above)
    })
}

/// The cumulative probabilities of a light's triangles by power times cosine, for each direction of the octahedral map,
/// row by row; four to a texel, padded with 1.
pub(super) fn cumulative_views(triangles: &[[Vec3; 3]], powers: &[f64]) -> Vec<[f32; 4]> {
    /// Directions along a side of a cell of the map, borders included, over which cosines are averaged.
    const DIRECTIONS: u32 = 5;
    /// Minimum cosine of a triangle that is visible from some direction of the cell.
    const MIN: f64 = 1.0 / 64.0;
    // Margin for directions between the sampled ones.
    let turned = -0.25 / f64::from(VIEW_SIDE);
    let normals: Vec<DVec3> =
        triangles.iter().map(|[a, b, c]| (*b - *a).cross(*c - *a).as_dvec3().normalize_or_zero()).collect();
    let mut texels = Vec::new();
    for cell in 0..VIEW_SIDE * VIEW_SIDE {
        let (column, row) = (cell % VIEW_SIDE, cell / VIEW_SIDE);
        let at = |cell: u32, i: u32| {
            2.0 * (f64::from(cell) + f64::from(i) / f64::from(DIRECTIONS - 1)) / f64::from(VIEW_SIDE) - 1.0
        };
        let directions: Vec<DVec3> = (0..DIRECTIONS * DIRECTIONS)
            .map(|i| oct_unwrap(at(column, i % DIRECTIONS), at(row, i / DIRECTIONS)))
            .collect();
        let shown = normals.iter().zip(powers).map(|(normal, power)| {
            let cosines = directions.iter().map(|direction| direction.dot(*normal));
            let mean = cosines.clone().map(|cosine| cosine.max(0.0)).sum::<f64>() / directions.len() as f64;
            let seen = cosines.fold(-1.0, f64::max) > turned;
            power * if seen { mean.max(MIN) } else { 0.0 }
        });
        let shown: Vec<f64> = shown.collect();
        let total: f64 = shown.iter().sum();
        let mut sum = 0.0;
        let mut cumulative: Vec<f32> = shown
            .iter()
            .map(|shown| {
                sum += shown;
                (sum / total) as f32
            })
            .collect();
        cumulative.resize(cumulative.len().next_multiple_of(4), 1.0);
        if let Some(last) = cumulative.get_mut(triangles.len() - 1) {
            *last = 1.0;
        }
        texels.extend(cumulative.chunks_exact(4).map(|four| [four[0], four[1], four[2], four[3]]));
    }
    texels
}

/// The partner of each triangle: one that faces nearly the opposite way. Partners are mutual. A triangle for which none
/// is left is its own partner.
pub(super) fn partners(triangles: &[[Vec3; 3]]) -> Vec<u32> {
    /// Buckets per unit of a normal's coordinates: about 15 degrees each.
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
