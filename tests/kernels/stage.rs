//! A small scene on the device, prepared as for a render, and f64 lines against all of its triangles.

use glam::DVec3;
use kernel_kit::{Gpu, Resources};
use penumbra::internal::bvh::Bvh;
use penumbra::internal::gpu_scene::GpuScene;
use penumbra::internal::kernels::compose_source;
use penumbra::internal::passes::{Point, Tile};
use penumbra::internal::scene::{Camera, LightKind, Scene};
use penumbra::internal::specialisation::Specialisation;
use penumbra::internal::specialisation::features::Features;
use penumbra::settings::{Settings, Technique};

use crate::kit::{device_features, new_kernel};

/// A scene, its triangles in the order of the BVH, and its tables.
pub struct Stage {
    pub scene: Scene,
    pub features: Features,
    pub gpu_scene: GpuScene,
}

impl Stage {
    /// Uploads a scene for the passes of a technique. `changed` may modify the features.
    pub fn new(
        gpu: &Gpu,
        scene: Scene,
        camera: &Camera,
        size: [u32; 2],
        technique: Technique,
        changed: impl Fn(Features) -> Features,
    ) -> Stage {
        let settings = Settings::default().with(|s| {
            s.image.width = size[0];
            s.image.height = size[1];
            s.technique = technique;
            // Images so small would have no photons unless their number is requested.
            s.visibility_map.photons_per_light = Some(4096);
        });
        Stage::of_settings(gpu, scene, camera, &settings, changed)
    }

    /// As [`Stage::new`], for the passes of these settings.
    pub fn of_settings(
        gpu: &Gpu,
        mut scene: Scene,
        camera: &Camera,
        settings: &Settings,
        changed: impl Fn(Features) -> Features,
    ) -> Stage {
        let positions: Vec<_> = (0..scene.triangles.len()).map(|i| scene.triangle_positions(i)).collect();
        let bvh = Bvh::build(&positions).unwrap();
        scene.reorder_triangles(&bvh.order);
        let needed = changed(Specialisation::new(&scene, None, settings).features);
        let features = device_features(gpu).iter().fold(needed, |features, feature| features.with(feature, true));
        let size = [settings.image.width, settings.image.height];
        let gpu_scene = GpuScene::new(gpu, &scene, bvh, camera, size, &features).unwrap();
        Stage { scene, features, gpu_scene }
    }
}

/// A tile that covers a whole image.
pub fn whole([width, height]: [u32; 2], samples_per_pixel: u32) -> Tile {
    let pixel_count = width * height;
    let point_count = pixel_count * samples_per_pixel;
    let of_image = Tile { width, height, columns: width, rows: height, ..Tile::default() };
    Tile { pixel_count, samples_per_pixel, point_count, seed: 3, ..of_image }
}

/// The crossing of a line with a triangle, or one outside it by at most [`EDGE`].
#[derive(Clone, Copy, Debug)]
pub struct Crossing {
    pub triangle: usize,
    pub t: f64,
    /// Barycentric coordinates of corners 1 and 2.
    pub u: f64,
    pub v: f64,
    /// The smallest barycentric coordinate, negative outside.
    pub inside: f64,
    /// Unit normal of the front.
    pub normal: DVec3,
}

/// Barycentric distance from an edge below which the answer depends on rounding: coordinates of unit size have an error
/// of 1e-7, and the triangles of these tests are larger than a twentieth.
pub const EDGE: f64 = 1e-5;

impl Crossing {
    /// Whether it is so near to an edge that rounding decides.
    pub fn doubtful(&self) -> bool {
        self.inside.abs() < EDGE
    }
}

/// All crossings of a line, before its origin too, by distance.
pub fn crossings(scene: &Scene, origin: DVec3, direction: DVec3) -> Vec<Crossing> {
    let cross = |triangle: usize| {
        let [a, b, c] = scene.triangle_positions(triangle).map(|p| p.as_dvec3());
        let (e1, e2) = (b - a, c - a);
        let across = e1.cross(e2);
        let t = (a - origin).dot(across) / direction.dot(across);
        let p = origin + direction * t - a;
        let u = p.cross(e2).dot(across) / across.length_squared();
        let v = e1.cross(p).dot(across) / across.length_squared();
        let inside = u.min(v).min(1.0 - u - v);
        (inside > -EDGE).then(|| Crossing { triangle, t, u, v, inside, normal: across.normalize() })
    };
    let mut found: Vec<Crossing> = (0..scene.triangles.len()).filter_map(cross).collect();
    found.sort_by(|a, b| a.t.total_cmp(&b.t));
    found
}

/// A sampled point of a light.
#[derive(Clone, Copy, Debug)]
pub struct LightPoint {
    /// Origin of its shadow ray.
    pub origin: DVec3,
    pub pdf: f64,
    pub direction: DVec3,
    pub distance: f64,
    pub radiance: DVec3,
}

impl LightPoint {
    /// Whether the shadow ray is unoccluded; `None` if that depends on rounding.
    pub fn visible(&self, scene: &Scene) -> Option<bool> {
        // As in the pass, the ray ends before the light's own surface.
        let end = self.distance * (1.0 - 1e-4);
        let all = crossings(scene, self.origin, self.direction);
        // Distances of up to 4 are rounded by 2.4e-7.
        let near: Vec<&Crossing> = all.iter().filter(|c| c.t > 0.0 && c.t < end + 1e-6).collect();
        if near.iter().any(|c| c.inside >= EDGE && c.t < end - 1e-6) {
            return Some(false);
        }
        let doubtful = near.iter().any(|c| c.doubtful() || c.t > end - 1e-6);
        (!doubtful).then_some(true)
    }
}

/// The candidates (point and light) of a tile's points and a chunk of lights, with `samples` light points each.
pub struct Candidates {
    pub stage: Stage,
    pub tile: Tile,
    pub points: Vec<Point>,
    /// First light and number of lights.
    pub chunk: [u32; 2],
    pub samples: u32,
}

impl Candidates {
    pub fn count(&self) -> usize {
        (self.tile.point_count * self.chunk[1]) as usize
    }

    /// Words of visibilities of a candidate.
    pub fn words(&self) -> usize {
        self.samples.div_ceil(32) as usize
    }

    /// The light points that a candidate samples: one of a light that comes from a single direction.
    pub fn own_samples(&self, candidate: usize) -> usize {
        let light = self.chunk[0] as usize + candidate / self.points.len();
        match self.stage.scene.lights[light].kind {
            LightKind::Point { .. } | LightKind::Spot { .. } | LightKind::Directional { .. } => 1,
            _ => self.samples as usize,
        }
    }

    /// The light points of each candidate, `samples` of them, and last the one that an audit traces.
    pub fn light_points(&self, gpu: &Gpu) -> Vec<Vec<LightPoint>> {
        let points = gpu.upload("test/points", &self.points).unwrap();
        let composed =
            compose_source("light_points", include_str!("shaders/light_points.wgsl"), &self.stage.features).unwrap();
        let candidates = self.count() as u32;
        let constants = [
            ("first_light", f64::from(self.chunk[0])),
            ("candidates", f64::from(candidates)),
            ("samples", f64::from(self.samples)),
        ];
        let kernel = new_kernel(gpu, &composed, &constants, &["points", "sampled"]).unwrap();
        let count = (candidates * (self.samples + 1)) as usize;
        let sampled = gpu.poisoned::<[[f32; 4]; 3]>("test/sampled", count).unwrap();
        let own = Resources::new().with("points", &points).with("sampled", &sampled);
        let bound = kernel.bind(gpu, "sample_light_points", &[&own, &self.stage.gpu_scene]).unwrap();
        let mut frame = gpu.frame("test");
        frame.run(&bound, candidates, &self.tile);
        frame.submit().unwrap();
        let sampled: Vec<[[f32; 4]; 3]> = gpu.read(&sampled, count).unwrap();
        let light_point = |[a, b, c]: &[[f32; 4]; 3]| {
            let vector = |v: &[f32; 4]| glam::Vec4::from_array(*v).truncate().as_dvec3();
            LightPoint {
                origin: vector(a),
                pdf: f64::from(a[3]),
                direction: vector(b),
                distance: f64::from(b[3]),
                radiance: vector(c),
            }
        };
        sampled.chunks(self.samples as usize + 1).map(|candidate| candidate.iter().map(light_point).collect()).collect()
    }
}

/// The kernels' hash of one word (PCG; Jarzynski and Olano 2020).
pub fn hash1(x: u32) -> u32 {
    let state = x.wrapping_mul(747_796_405).wrapping_add(2_891_336_453);
    let word = ((state >> ((state >> 28) + 4)) ^ state).wrapping_mul(277_803_737);
    (word >> 22) ^ word
}

/// The hash of several words, the first one outermost.
pub fn hash(words: &[u32]) -> u32 {
    words.iter().rev().copied().reduce(|inner, word| word.wrapping_add(hash1(inner))).map_or(0, hash1)
}

/// A number of the scrambled van der Corput sequence, the first dimension of the scrambled Sobol sequence (Burley
/// 2020).
pub fn sobol1(index: u32, seed: u32) -> f64 {
    // Vegdahl's variant of the scramble of Laine and Karras (2011), of reversed bits.
    let scramble = |bits: u32, seed: u32| {
        let mut x = bits ^ bits.wrapping_mul(0x3d20_adea);
        x = x.wrapping_add(seed).wrapping_mul((seed >> 16) | 1);
        x ^= x.wrapping_mul(0x0552_6c56);
        x ^ x.wrapping_mul(0x53a2_2864)
    };
    let shuffled = scramble(index.reverse_bits(), hash1(seed)).reverse_bits();
    f64::from(scramble(shuffled, hash(&[seed, 1])).reverse_bits() >> 8) / 16_777_216.0
}

/// A constant that host and kernels share.
pub fn constant(name: &str) -> u32 {
    penumbra::internal::kernels::constant(name).unwrap()
}

/// Seed and sample index of a point of a tile.
pub fn pixel_of(tile: &Tile, i: usize) -> (u32, u32) {
    let i = i as u32;
    let pixel = tile.first_row * tile.width + i / tile.samples_per_pixel;
    (hash(&[pixel, tile.seed]), tile.first_sample + i % tile.samples_per_pixel)
}
