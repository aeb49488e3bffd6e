//! Indexed triangle meshes. Front faces are counter-clockwise.

use std::collections::HashMap;
use std::f64::consts::{PI, TAU};

use glam::{DAffine3, DVec2, DVec3, DVec4};

/// The step of differences is much larger than rounding and much smaller than any feature.
const STEP: f64 = 1e-5;

/// A mesh. Empty attributes are not written to the file.
#[derive(Default)]
pub struct Mesh {
    pub positions: Vec<DVec3>,
    pub normals: Vec<DVec3>,
    pub tangents: Vec<DVec4>,
    pub uvs: Vec<DVec2>,
    /// Linear RGB.
    pub colours: Vec<DVec3>,
    pub triangles: Vec<[u32; 3]>,
}

impl Mesh {
    /// The parallelogram `centre` ± `u` ± `v` with the normal `u` x `v`. Textures are upright, with their u along `u`.
    pub fn quad(centre: DVec3, u: DVec3, v: DVec3) -> Self {
        let corners = [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)];
        Mesh {
            positions: corners.map(|(s, t)| tidy3(centre + s * u + t * v)).into(),
            normals: [tidy3(u.cross(v).normalize()); 4].into(),
            uvs: corners.map(|(s, t)| DVec2::new(0.5 + 0.5 * s, 0.5 - 0.5 * t)).into(),
            triangles: vec![[0, 1, 2], [0, 2, 3]],
            ..Mesh::default()
        }
    }

    /// The cuboid about the origin with half edges `half`. Each face has the whole texture.
    pub fn cuboid(half: DVec3) -> Self {
        let [x, y, z] = [half.x * DVec3::X, half.y * DVec3::Y, half.z * DVec3::Z];
        let mut mesh = Mesh::default();
        for (normal, u, v) in [(x, -z, y), (-x, z, y), (y, x, -z), (-y, x, z), (z, x, y), (-z, -x, y)] {
            mesh.append(Mesh::quad(normal, u, v));
        }
        mesh
    }

    /// A smooth surface of `columns` x `rows` quads. `point` returns the position and the unit normal at (u, v). Seen
    /// from the front, u goes right and v goes down. The last column of a `closed` surface equals the first bit for
    /// bit. Triangles without area, as at poles, are left out.
    pub fn surface(columns: u32, rows: u32, closed: bool, point: impl Fn(f64, f64) -> (DVec3, DVec3)) -> Self {
        let mut mesh = Mesh::default();
        for row in 0..=rows {
            for column in 0..=columns {
                let uv = DVec2::new(f64::from(column) / f64::from(columns), f64::from(row) / f64::from(rows));
                let (position, normal) = point(if closed { uv.x % 1.0 } else { uv.x }, uv.y);
                mesh.positions.push(tidy3(position));
                mesh.normals.push(tidy3(normal));
                mesh.uvs.push(uv);
            }
        }
        for row in 0..rows {
            for column in 0..columns {
                let top = row * (columns + 1) + column;
                let bottom = top + columns + 1;
                for triangle in [[top, bottom, bottom + 1], [top, bottom + 1, top + 1]] {
                    let [a, b, c] = triangle.map(|corner| mesh.positions[corner as usize]);
                    if a != b && b != c && c != a {
                        mesh.triangles.push(triangle);
                    }
                }
            }
        }
        mesh
    }

    /// A surface whose normals are those of differences of `point`. Without `closed`, `point` is only evaluated in 0 to
    /// 1.
    pub fn relief(columns: u32, rows: u32, closed: bool, point: impl Fn(f64, f64) -> DVec3) -> Self {
        Mesh::surface(columns, rows, closed, |u, v| {
            let [left, right] = if closed { [u - STEP, u + STEP] } else { [(u - STEP).max(0.0), (u + STEP).min(1.0)] };
            let right = point(right, v) - point(left, v);
            let down = point(u, (v + STEP).min(1.0)) - point(u, (v - STEP).max(0.0));
            (point(u, v), down.cross(right).normalize())
        })
    }

    /// A sphere about the origin with exact normals and equirectangular texture coordinates.
    pub fn sphere(radius: f64, columns: u32, rows: u32) -> Self {
        Mesh::surface(columns, rows, true, |u, v| {
            let normal = on_sphere(u, v);
            (radius * normal, normal)
        })
    }

    /// The surface of revolution about +y of a `profile` of (distance from the axis, height). With the axis on the
    /// left, the front is to the left of the profile's direction: outside where the profile goes down.
    pub fn lathe(columns: u32, rows: u32, profile: impl Fn(f64) -> DVec2) -> Self {
        Mesh::surface(columns, rows, true, |u, v| {
            let (sin, cos) = (TAU * u).sin_cos();
            let radial = DVec3::new(sin, 0.0, cos);
            let at = profile(v);
            let along = profile((v + STEP).min(1.0)) - profile((v - STEP).max(0.0));
            (at.x * radial + at.y * DVec3::Y, (along.x * DVec3::Y - along.y * radial).normalize())
        })
    }

    /// A sphere about the origin of 20 * 4^`level` flat triangles with their corners on the sphere.
    pub fn icosphere(radius: f64, level: u32) -> Self {
        let golden = (1.0 + 5f64.sqrt()) / 2.0;
        let mut points: Vec<DVec3> = [(-1.0, golden), (1.0, golden), (-1.0, -golden), (1.0, -golden)]
            .into_iter()
            .flat_map(|(a, b)| [DVec3::new(a, b, 0.0), DVec3::new(0.0, a, b), DVec3::new(b, 0.0, a)])
            .map(DVec3::normalize)
            .collect();
        // The faces of the icosahedron: triples of neighbouring corners, counter-clockwise from outside.
        let edge = points.iter().skip(1).map(|p| p.distance(points[0])).fold(f64::INFINITY, f64::min);
        let near = |a: usize, b: usize| points[a].distance(points[b]) < 1.1 * edge;
        let mut triangles = Vec::new();
        for a in 0..points.len() {
            for b in a + 1..points.len() {
                for c in b + 1..points.len() {
                    if near(a, b) && near(b, c) && near(c, a) {
                        let outward = (points[b] - points[a]).cross(points[c] - points[a]).dot(points[a]) > 0.0;
                        triangles.push(if outward { [a, b, c] } else { [a, c, b] });
                    }
                }
            }
        }
        for _ in 0..level {
            let mut middles = HashMap::new();
            let mut middle = |a: usize, b: usize| {
                *middles.entry((a.min(b), a.max(b))).or_insert_with(|| {
                    points.push((points[a] + points[b]).normalize());
                    points.len() - 1
                })
            };
            triangles = triangles
                .into_iter()
                .flat_map(|[a, b, c]| {
                    let [ab, bc, ca] = [middle(a, b), middle(b, c), middle(c, a)];
                    [[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]
                })
                .collect();
        }
        Mesh {
            positions: points.into_iter().map(|point| tidy3(radius * point)).collect(),
            triangles: triangles.into_iter().map(|corners| corners.map(|corner| corner as u32)).collect(),
            ..Mesh::default()
        }
    }

    /// Colours each vertex by its position, in linear RGB.
    pub fn coloured(mut self, colour: impl Fn(DVec3) -> DVec3) -> Self {
        self.colours = self.positions.iter().map(|&position| tidy3(colour(position))).collect();
        self
    }

    /// A copy after a rotation, a uniform scale and a translation.
    pub fn placed(&self, transform: DAffine3) -> Self {
        Mesh {
            positions: self.positions.iter().map(|&p| tidy3(transform.transform_point3(p))).collect(),
            normals: self.normals.iter().map(|&n| tidy3(transform.transform_vector3(n).normalize())).collect(),
            uvs: self.uvs.clone(),
            triangles: self.triangles.clone(),
            ..Mesh::default()
        }
    }

    /// Maps textures by position: each vertex is projected along the axis closest to its normal. A texture is `size`
    /// wide.
    pub fn projected(mut self, size: f64) -> Self {
        let project = |(p, n): (&DVec3, &DVec3)| {
            let n = n.abs();
            let uv = match n.max_element() {
                max if max == n.y => DVec2::new(p.x, p.z),
                max if max == n.x => DVec2::new(p.z, -p.y),
                _ => DVec2::new(p.x, -p.y),
            };
            (uv / size).map(tidy)
        };
        self.uvs = self.positions.iter().zip(&self.normals).map(project).collect();
        self
    }

    /// Repeats textures `times`.
    pub fn repeated(mut self, times: DVec2) -> Self {
        self.uvs.iter_mut().for_each(|uv| *uv = (*uv * times).map(tidy));
        self
    }

    /// Appends a mesh with the same attributes.
    pub fn append(&mut self, other: Mesh) {
        let first = self.positions.len() as u32;
        self.positions.extend(other.positions);
        self.normals.extend(other.normals);
        self.uvs.extend(other.uvs);
        self.triangles.extend(other.triangles.into_iter().map(|corners| corners.map(|corner| first + corner)));
    }

    /// Lower and upper corner of the bounding box of the positions in f32, as in the file.
    pub fn bounds(&self) -> ([f32; 3], [f32; 3]) {
        let low = self.positions.iter().copied().fold(DVec3::INFINITY, DVec3::min);
        let high = self.positions.iter().copied().fold(DVec3::NEG_INFINITY, DVec3::max);
        (low.as_vec3().to_array(), high.as_vec3().to_array())
    }
}

/// The point of the unit sphere at (u, v) of an equirectangular map with +y at the top and +z at the left edge.
pub fn on_sphere(u: f64, v: f64) -> DVec3 {
    let ((sin_azimuth, cos_azimuth), (sin_polar, cos_polar)) = ((TAU * u).sin_cos(), (PI * v).sin_cos());
    DVec3::new(sin_polar * sin_azimuth, cos_polar, sin_polar * cos_azimuth)
}

/// Rounds to 1e-9. This is finer than f32 at the size of these scenes, and coarser than the differences between
/// implementations of sine.
pub fn tidy(x: f64) -> f64 {
    // The sum turns -0 into 0.
    (x * 1e9).round() / 1e9 + 0.0
}

fn tidy3(v: DVec3) -> DVec3 {
    v.map(tidy)
}
