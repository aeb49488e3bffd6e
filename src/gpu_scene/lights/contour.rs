//! Contours of mesh lights, over which kernels evaluate Lambert's formula.

use std::collections::HashMap;

use glam::{DVec3, Vec3};

/// Maximum number of contour edges of a light with a closed form. With more, the formula costs more than the shadow ray
/// that a light sample needs.
const MAX_CONTOUR_EDGES: usize = 64;

/// Maximum distance, relative to the light's radius, at which a corner counts as in a plane or on an edge:
/// a few roundings of f32 coordinates of a scene of unit size.
const COPLANAR: f64 = 2e-6;

/// A closed chain of edges in a plane, counter-clockwise about its normal; the edges of holes run clockwise.
pub(super) struct Contour {
    pub normal: Vec3,
    pub vertices: Vec<Vec3>,
}

/// The contours of the triangles. Triangles in one plane that face the same way are merged. Returns `None` if there are
/// more than [`MAX_CONTOUR_EDGES`] edges.
pub(super) fn contours(triangles: &[[Vec3; 3]], radius: f64) -> Option<Vec<Contour>> {
    let mut planes: Vec<(DVec3, DVec3, Vec<usize>)> = Vec::new();
    // Large triangles first, because their planes are the most accurate.
    let normal = |[a, b, c]: [Vec3; 3]| (b - a).as_dvec3().cross((c - a).as_dvec3());
    let mut order: Vec<usize> = (0..triangles.len()).collect();
    order.sort_by(|&i, &j| normal(triangles[j]).length_squared().total_cmp(&normal(triangles[i]).length_squared()));
    for i in order {
        let n = normal(triangles[i]).normalize();
        let within = |plane: &(DVec3, DVec3, Vec<usize>)| {
            let near = |corner: Vec3| (corner.as_dvec3() - plane.1).dot(plane.0).abs() <= COPLANAR * radius;
            n.dot(plane.0) > 0.0 && triangles[i].into_iter().all(near)
        };
        match planes.iter().position(within) {
            Some(plane) => planes[plane].2.push(i),
            // Each plane has at least three edges.
            None if planes.len() * 3 >= MAX_CONTOUR_EDGES => return None,
            None => planes.push((n, triangles[i][0].as_dvec3(), vec![i])),
        }
    }
    let mut contours = Vec::new();
    for (normal, _, members) in planes {
        for chain in boundary(members.iter().map(|&i| triangles[i])) {
            let vertices = without_straight_corners(chain, COPLANAR * radius);
            // A chain that returns along its own edges encloses nothing.
            if vertices.len() >= 3 {
                contours.push(Contour { normal: normal.as_vec3(), vertices });
            }
        }
    }
    let edges: usize = contours.iter().map(|contour| contour.vertices.len()).sum();
    (edges <= MAX_CONTOUR_EDGES).then_some(contours)
}

/// The normal of the plane in which all contours lie, if there is one and they all face the same way.
pub(super) fn plane_normal(contours: &[Contour], radius: f64) -> Option<Vec3> {
    let first = contours.first()?;
    let is_in_plane = |contour: &Contour| {
        let height = (contour.vertices[0] - first.vertices[0]).as_dvec3().dot(first.normal.as_dvec3());
        contour.normal == first.normal && height.abs() <= COPLANAR * radius
    };
    contours.iter().all(is_in_plane).then_some(first.normal)
}

type Corner = [u32; 3];

/// The boundary edges of the triangles, joined to closed chains. An edge is interior if another triangle has it in the
/// opposite direction. Any way to join the edges will do, because the closed form sums over edges.
fn boundary(triangles: impl Iterator<Item = [Vec3; 3]>) -> Vec<Vec<Vec3>> {
    // Adding zero makes -0 and 0 the same corner.
    let key = |v: Vec3| (v + Vec3::ZERO).to_array().map(f32::to_bits);
    let mut edges: HashMap<(Corner, Corner), usize> = HashMap::new();
    let mut order: Vec<(Vec3, Vec3)> = Vec::new();
    for [a, b, c] in triangles {
        for (from, to) in [(a, b), (b, c), (c, a)] {
            let back = edges.entry((key(to), key(from))).or_default();
            if *back > 0 {
                *back -= 1;
            } else {
                *edges.entry((key(from), key(to))).or_default() += 1;
                order.push((from, to));
            }
        }
    }
    let mut next: HashMap<Corner, Vec<Vec3>> = HashMap::new();
    let mut starts = Vec::new();
    for (from, to) in order {
        let left = edges.entry((key(from), key(to))).or_default();
        if *left > 0 {
            *left -= 1;
            next.entry(key(from)).or_default().push(to);
            starts.push(from);
        }
    }
    let mut chains = Vec::new();
    for start in starts {
        let mut chain = Vec::new();
        let mut at = start;
        // Every corner has as many outgoing as incoming edges, so a chain ends where it began.
        while let Some(to) = next.get_mut(&key(at)).and_then(Vec::pop) {
            chain.push(at);
            at = to;
        }
        if !chain.is_empty() {
            chains.push(chain);
        }
    }
    chains
}

/// The chain without corners that lie within `tolerance` of the line between their neighbours.
fn without_straight_corners(mut chain: Vec<Vec3>, tolerance: f64) -> Vec<Vec3> {
    let mut i = 0;
    let mut kept = 0;
    // Ends after one round without a corner to drop.
    while chain.len() >= 3 && kept < chain.len() {
        let n = chain.len();
        let [a, b, c] = [(i + n - 1) % n, i % n, (i + 1) % n].map(|k| chain[k].as_dvec3());
        let along = (c - a).try_normalize();
        let off = along.map_or(0.0, |along| (b - a).cross(along).length());
        let between = (b - a).dot(c - b) >= 0.0;
        if off <= tolerance && (between || along.is_none()) {
            chain.remove(i % n);
            kept = 0;
            i %= chain.len();
        } else {
            kept += 1;
            i = (i + 1) % n;
        }
    }
    chain
}
