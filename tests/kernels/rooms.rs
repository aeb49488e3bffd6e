//! Photons and points for the tests of the photon map, computed on the CPU: a room of rectangles under a square light,
//! and the brute-force answers.

use glam::{DVec3, Mat3, Vec3};
use penumbra::internal::kernels::INVALID_POINT;
use penumbra::internal::passes::Point;
use penumbra::internal::passes::grid::Photon;

use crate::octahedral::{oct_decode, oct_encode, oct_encode7};

/// A generator for tests (PCG, Jarzynski and Olano 2020).
pub struct Random(pub u32);

impl Random {
    pub fn word(&mut self) -> u32 {
        self.0 = self.0.wrapping_mul(747_796_405).wrapping_add(2_891_336_453);
        let word = ((self.0 >> ((self.0 >> 28) + 4)) ^ self.0).wrapping_mul(277_803_737);
        (word >> 22) ^ word
    }

    /// 0 to 1, never 1.
    pub fn unit(&mut self) -> f32 {
        (self.word() >> 8) as f32 / 16_777_216.0
    }

    /// -1 to 1.
    pub fn signed(&mut self) -> f32 {
        2.0 * self.unit() - 1.0
    }

    pub fn direction(&mut self) -> Vec3 {
        loop {
            let v = Vec3::new(self.signed(), self.signed(), self.signed());
            if v.length_squared() < 1.0 && v.length_squared() > 1e-3 {
                return v.normalize();
            }
        }
    }
}

/// The word of a photon that represents one hit.
pub fn photon(position: Vec3, normal: Vec3, light: u32, shadow: bool) -> Photon {
    let word = oct_encode7(normal.as_dvec3()) | (light << 14) | (u32::from(shadow) << 31);
    Photon { position: position.to_array(), word }
}

pub fn photon_normal(word: u32) -> DVec3 {
    oct_decode(word, 7)
}

pub fn point(position: Vec3, normal: Vec3) -> Point {
    Point { position: position.to_array(), normal: oct_encode(normal.as_dvec3()) }
}

pub fn point_normal(normal: u32) -> DVec3 {
    oct_decode(normal, 16)
}

/// A one-sided rectangle: a corner, two edges, and their cross product for the normal.
#[derive(Clone, Copy)]
pub struct Rectangle(pub Vec3, pub Vec3, pub Vec3);

impl Rectangle {
    pub fn normal(&self) -> Vec3 {
        self.1.cross(self.2).normalize()
    }

    pub fn area(&self) -> f32 {
        self.1.cross(self.2).length()
    }

    pub fn hit(&self, origin: Vec3, direction: Vec3) -> Option<f32> {
        let n = self.1.cross(self.2);
        let t = (self.0 - origin).dot(n) / direction.dot(n);
        let p = origin + direction * t - self.0;
        let (a, b) = (p.dot(self.1) / self.1.length_squared(), p.dot(self.2) / self.2.length_squared());
        (t > 1e-5 && (0.0..=1.0).contains(&a) && (0.0..=1.0).contains(&b)).then_some(t)
    }
}

/// The sides of a cube of half-edge `half`.
pub fn cube(centre: Vec3, half: f32, rotation: Mat3) -> impl Iterator<Item = Rectangle> {
    let sides = (0..3).flat_map(|axis| [-1.0, 1.0].map(|sign| (axis, sign)));
    sides.map(move |(axis, sign)| {
        let n = Vec3::AXES[axis] * sign * half;
        let (a, b) = (Vec3::AXES[(axis + 1) % 3] * half * sign, Vec3::AXES[(axis + 2) % 3] * half);
        Rectangle(centre + rotation * (n - a - b), rotation * a * 2.0, rotation * b * 2.0)
    })
}

/// The box of the paper at half its size: a room without its front, a rotated cube, and a square light of half-width
/// `light` below the ceiling.
pub struct Room {
    pub rectangles: Vec<Rectangle>,
    pub light: f32,
}

impl Room {
    pub fn new(light: f32) -> Room {
        let v = Vec3::new;
        let mut rectangles = vec![
            Rectangle(v(-0.5, -0.5, -0.5), v(0.0, 0.0, 1.0), v(1.0, 0.0, 0.0)),
            Rectangle(v(-0.5, 0.5, -0.5), v(1.0, 0.0, 0.0), v(0.0, 0.0, 1.0)),
            Rectangle(v(-0.5, -0.5, -0.5), v(1.0, 0.0, 0.0), v(0.0, 1.0, 0.0)),
            Rectangle(v(-0.5, -0.5, -0.5), v(0.0, 1.0, 0.0), v(0.0, 0.0, 1.0)),
            Rectangle(v(0.5, -0.5, -0.5), v(0.0, 0.0, 1.0), v(0.0, 1.0, 0.0)),
        ];
        let rotation = Mat3::from_rotation_y(20f32.to_radians());
        let (centre, half) = (v(0.15, -0.325, 0.05), 0.175);
        rectangles.extend(cube(centre, half, rotation));
        Room { rectangles, light }
    }

    pub fn bounds(&self) -> (Vec3, Vec3) {
        (Vec3::splat(-0.5), Vec3::splat(0.5))
    }

    pub fn area(&self) -> f32 {
        self.rectangles.iter().map(Rectangle::area).sum()
    }

    /// Whether the whole light is behind the point's surface, or emits away from it.
    #[allow(dead_code, reason = "the benchmark uses it, the tests do not")]
    pub fn is_dark(&self, point: &Point) -> bool {
        let x = Vec3::from(point.position);
        let n = point_normal(point.normal).as_vec3();
        let corner = |i: u32| Vec3::new([-1.0, 1.0][i as usize & 1], 0.0, [-1.0, 1.0][i as usize >> 1]) * self.light;
        x.y >= 0.495 || (0..4).all(|i| n.dot(corner(i) + Vec3::Y * 0.495 - x) <= 0.0)
    }

    /// The photons of `rays` rays from the light: first hits, and all hits behind them that face the ray.
    pub fn photons(&self, rays: u32, light: u32, random: &mut Random) -> Vec<Photon> {
        let mut photons = Vec::new();
        for _ in 0..rays {
            let origin = Vec3::new(self.light * random.signed(), 0.495, self.light * random.signed());
            let (r, phi) = (random.unit().sqrt(), std::f32::consts::TAU * random.unit());
            let direction = Vec3::new(r * phi.cos(), -(1.0 - r * r).sqrt(), r * phi.sin());
            let mut hits: Vec<(f32, usize)> = (0..self.rectangles.len())
                .filter_map(|i| self.rectangles[i].hit(origin, direction).map(|t| (t, i)))
                .collect();
            hits.sort_by(|a, b| a.0.total_cmp(&b.0));
            for (rank, (t, i)) in hits.iter().enumerate() {
                let normal = self.rectangles[*i].normal();
                if normal.dot(direction) < 0.0 {
                    photons.push(photon(origin + direction * *t, normal, light, rank > 0));
                }
            }
        }
        photons
    }

    /// The points that a camera before the room sees, row by row.
    pub fn points(&self, width: u32, height: u32) -> Vec<Point> {
        let mut points = Vec::new();
        let eye = Vec3::new(0.0, 0.0, 1.8);
        let half = 20f32.to_radians().tan();
        for y in 0..height {
            for x in 0..width {
                let u = (2.0 * (x as f32 + 0.5) / width as f32 - 1.0) * half;
                let v = (1.0 - 2.0 * (y as f32 + 0.5) / height as f32) * half;
                let direction = Vec3::new(u, v, -1.0).normalize();
                let hit = self
                    .rectangles
                    .iter()
                    .filter(|r| r.normal().dot(direction) < 0.0)
                    .filter_map(|r| r.hit(eye, direction).map(|t| (t, r)))
                    .min_by(|a, b| a.0.total_cmp(&b.0));
                points.push(match hit {
                    Some((t, r)) => point(eye + direction * t, r.normal()),
                    None => Point { position: [0.0; 3], normal: INVALID_POINT },
                });
            }
        }
        points
    }
}

/// The kinds of the nearest k photons of light `light`: (n_i, n_s), or `None` for fewer than k within `reach`; no
/// answer if it depends on rounding.
pub fn nearest_kinds(
    photons: &[Photon],
    point: &Point,
    light: u32,
    k: usize,
    reach: f64,
    normals: bool,
) -> Option<Option<(usize, usize)>> {
    let x = Vec3::from(point.position).as_dvec3();
    let n = point_normal(point.normal);
    let stretch = if normals { 15.0 } else { 0.0 };
    let mut near: Vec<(f64, bool, bool)> = photons
        .iter()
        .filter(|p| (p.word >> 14) & 0x7ff == light)
        .filter_map(|p| {
            let v = Vec3::from(p.position).as_dvec3() - x;
            let d = v.length_squared() + stretch * v.dot(n).powi(2);
            if d > 2.0 * reach * reach {
                return None;
            }
            let excess = if normals { photon_normal(p.word).dot(n) - 0.5f64.sqrt() } else { 1.0 };
            // The cosine of decoded f32 normals is accurate to 1e-6.
            (excess > -1e-5).then_some((d, p.word >> 31 != 0, excess < 1e-5))
        })
        .collect();
    near.sort_by(|a, b| a.0.total_cmp(&b.0));
    // f32 differences of coordinates up to 1 have an error of 1e-7, squares and sums of them slightly more.
    let close = |a: f64, b: f64| (a.sqrt() - b.sqrt()).abs() < 1e-6;
    let limit = reach * reach;
    if near.len() < k || near[k - 1].0 > limit {
        let doubtful = near.get(k - 1).is_some_and(|p| close(p.0, limit)) || near.iter().any(|p| p.2);
        return (!doubtful).then_some(None);
    }
    let (last, next) = (near[k - 1].0, near.get(k));
    if close(last, limit) || near[..k].iter().any(|p| p.2) || next.is_some_and(|p| close(p.0, last)) {
        return None;
    }
    let shadow = near[..k].iter().filter(|p| p.1).count();
    Some(Some((k - shadow, shadow)))
}
