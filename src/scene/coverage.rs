//! How much of an image surfaces cover, without tracing a ray.

use glam::{Vec2, Vec3};

use super::camera::{Camera, Projection};
use super::description::Scene;
use super::instance::Instance;
use super::triangle::NO_LIGHT;
use crate::procedural::Procedural;

/// Cells along each side of the image: a share is exact to about one percent, which is enough to weigh costs.
const SIDE: usize = 64;

impl Scene {
    /// The share of the image that surfaces cover, 0 to 1, for an image of this width over height; surfaces of lights
    /// left out. A surface that reaches behind the camera is taken to cover all of it, and instances and procedural
    /// objects to fill their boxes.
    pub fn covered_share(&self, camera: &Camera, aspect: f32) -> f64 {
        let mut cells = Cells { covered: [[false; SIDE]; SIDE], count: 0 };
        let half = Vec2::from(camera.half_extent(aspect));
        let project = |corner| project(camera, half, corner);
        for index in (0..self.unshared_triangles()).filter(|&i| self.triangles[i].light == NO_LIGHT) {
            match self.triangle_positions(index).map(project) {
                [Some(a), Some(b), Some(c)] => cells.cover([a, b, c]),
                [None, None, None] => {}
                _ => return 1.0,
            }
            if cells.count == SIDE * SIDE {
                return 1.0;
            }
        }
        for corners in self.boxes() {
            let seen: Vec<Vec2> = corners.into_iter().filter_map(project).collect();
            if seen.len() == corners.len() {
                let (low, high) = seen.into_iter().fold((Vec2::MAX, Vec2::MIN), |(a, b), p| (a.min(p), b.max(p)));
                cells.cover([low, high, Vec2::new(low.x, high.y)]);
                cells.cover([low, high, Vec2::new(high.x, low.y)]);
            } else if !seen.is_empty() {
                return 1.0;
            }
        }
        cells.count as f64 / (SIDE * SIDE) as f64
    }

    /// The corners of the boxes around instances and procedural objects.
    fn boxes(&self) -> impl Iterator<Item = [Vec3; 8]> {
        let bounds = self.shared_meshes.iter().map(|mesh| {
            let positions = self.vertices[mesh.vertices.clone()].iter().map(|vertex| vertex.position);
            positions.fold((Vec3::MAX, Vec3::MIN), |(low, high), p| (low.min(p), high.max(p)))
        });
        let bounds: Vec<(Vec3, Vec3)> = bounds.collect();
        let of_instance = move |instance: &Instance| {
            let (low, high) = bounds[instance.mesh];
            std::array::from_fn(|i| {
                let upper = [1, 2, 4].map(|bit| i & bit != 0);
                instance.apply(Vec3::select(upper.into(), high, low))
            })
        };
        self.instances.iter().map(of_instance).chain(self.procedurals.iter().map(Procedural::corners))
    }
}

/// Where a point lies in the image, in cells, if `half` is half its extent. `None`: it is not in front of the camera.
fn project(camera: &Camera, half: Vec2, point: Vec3) -> Option<Vec2> {
    let offset = point - camera.position;
    let [right, up, backward] = camera.axes;
    let depth = -offset.dot(backward);
    if depth <= camera.near {
        return None;
    }
    let scale = match camera.projection {
        Projection::Perspective { .. } => depth,
        Projection::Orthographic { .. } => 1.0,
    };
    let at = Vec2::new(offset.dot(right), -offset.dot(up)) / (half * scale);
    Some((0.5 * at + 0.5) * SIDE as f32)
}

struct Cells {
    covered: [[bool; SIDE]; SIDE],
    count: usize,
}

impl Cells {
    /// Marks the cells of a triangle's corners, and those with their centre in it.
    fn cover(&mut self, triangle: [Vec2; 3]) {
        let [a, b, c] = triangle;
        let (low, high) = (a.min(b).min(c), a.max(b).max(c));
        let range = |low: f32, high: f32| low.max(0.0) as usize..(high.min(SIDE as f32 - 1.0) + 1.0) as usize;
        let small = (high - low).max_element() < 1.0;
        for y in range(low.y, high.y) {
            for x in range(low.x, high.x) {
                let corner = Vec2::new(x as f32, y as f32);
                let holds = |p: Vec2| (p - corner).min_element() >= 0.0 && (p - corner).max_element() < 1.0;
                let centre = corner + 0.5;
                let sides = [(a, b), (b, c), (c, a)].map(|(p, q)| (q - p).perp_dot(centre - p));
                let inside = sides.iter().all(|s| *s >= 0.0) || sides.iter().all(|s| *s <= 0.0);
                let seen = &mut self.covered[y][x];
                if !*seen && (inside && !small || triangle.into_iter().any(holds)) {
                    *seen = true;
                    self.count += 1;
                }
            }
        }
    }
}
