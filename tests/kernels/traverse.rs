//! Traversal in `shaders/lib/bvh.wgsl` against a loop over all triangles in double precision.

use glam::{DVec2, DVec3, Vec3, vec3};
use kernel_kit::{Bindings, Gpu, Kernel, POISON, Resources, Table, TableFormat, kernel_test};
use penumbra::internal::bvh::Bvh;
use penumbra::internal::kernels::compose_source;
use penumbra::internal::specialisation::features::{Feature, Features};

use crate::kit::{device_features, new_kernel};

pub const NO_HIT: u32 = u32::MAX;

/// `t_max` of rays without an end.
pub const FAR: f32 = 1e30;

pub type Triangle = [Vec3; 3];

#[derive(Clone, Copy, Debug)]
pub struct Ray {
    pub origin: Vec3,
    pub direction: Vec3,
    pub t_max: f32,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Answer {
    pub t: f32,
    pub u: f32,
    pub v: f32,
    pub primitive: u32,
}

pub fn ray(origin: Vec3, direction: Vec3) -> Ray {
    Ray { origin, direction, t_max: FAR }
}

/// A BVH on the device, and how kernels read it.
struct Traced {
    bvh: Bvh,
    packet_nodes: Vec<[f32; 4]>,
    features: Features,
}

/// The nodes and the triangles of a BVH, in the tables that the features select.
pub fn tables(gpu: &Gpu, bvh: &Bvh, features: &Features) -> [Table; 2] {
    if features.has(Feature::LayeredTexels) {
        let nodes = gpu.layered_table("test/nodes", &bvh.nodes, TableFormat::Uint);
        [nodes, gpu.layered_table("test/triangles", &bvh.triangles, TableFormat::Float)].map(Result::unwrap)
    } else if features.has(Feature::TextureLoads) {
        let nodes = gpu.texture_table("test/nodes", &bvh.nodes, TableFormat::Uint);
        [nodes, gpu.texture_table("test/triangles", &bvh.triangles, TableFormat::Float)].map(Result::unwrap)
    } else {
        let nodes = gpu.upload("test/nodes", &bvh.nodes);
        [nodes, gpu.upload("test/triangles", &bvh.triangles)].map(|buffer| Table::Buffer(buffer.unwrap()))
    }
}

/// The answers of an entry point for each ray, in `words` vectors. `tables` are the tables that the kernel reads.
pub fn trace(
    gpu: &Gpu,
    kernel: &Kernel,
    entry: &str,
    rays: &[Ray],
    words: usize,
    tables: &dyn Bindings,
) -> Vec<[u32; 4]> {
    let texels: Vec<[f32; 4]> = rays
        .iter()
        .flat_map(|ray| [ray.origin.extend(0.0).to_array(), ray.direction.extend(ray.t_max).to_array()])
        .collect();
    let rays_buffer = gpu.upload("test/rays", &texels).unwrap();
    let answers = gpu.poisoned::<[u32; 4]>("test/answers", words * rays.len() + 1).unwrap();
    let set = Resources::new().with("rays", &rays_buffer).with("answers", &answers);
    let bound = kernel.bind(gpu, entry, &[&set, tables]).unwrap();
    let mut frame = gpu.frame("test");
    frame.run(&bound, rays.len() as u32, &[0u32; 0]);
    frame.submit().unwrap();
    let mut words: Vec<[u32; 4]> = gpu.read(&answers, words * rays.len() + 1).unwrap();
    assert_eq!(words.pop(), Some([POISON; 4]), "{entry} wrote past its last ray");
    assert!(words.iter().all(|words| !words.contains(&POISON)), "{entry} left an answer out");
    words
}

impl Traced {
    fn new(gpu: &Gpu, triangles: &[Triangle]) -> Self {
        let bvh = Bvh::build(triangles).unwrap();
        let features = device_features(gpu).with(Feature::ShallowBvh, bvh.is_shallow());
        Traced { packet_nodes: bvh.packet_nodes(), bvh, features }
    }

    fn run(&self, gpu: &Gpu, entry: &str, rays: &[Ray]) -> Vec<[u32; 4]> {
        let composed = compose_source("traverse", include_str!("shaders/traverse.wgsl"), &self.features).unwrap();
        let constants = [("ray_count", rays.len() as f64), ("primitive_count", self.bvh.order.len() as f64)];
        let kernel = new_kernel(gpu, &composed, &constants, &["rays", "answers"]).unwrap();
        let [nodes, triangles] = tables(gpu, &self.bvh, &self.features);
        let packets = gpu.texture_table("test/packet_nodes", &self.packet_nodes, TableFormat::Float).unwrap();
        let set = Resources::new().with("bvh_nodes", &nodes).with("bvh_triangles", &triangles);
        trace(gpu, &kernel, entry, rays, 1, &set.with("packet_nodes", &packets))
    }

    fn closest_by(&self, gpu: &Gpu, entry: &str, rays: &[Ray]) -> Vec<Answer> {
        self.run(gpu, entry, rays).into_iter().map(answer).collect()
    }

    /// The answers of rays traced one by one. In packets, where the device has them, each ray has the same bits.
    fn closest(&self, gpu: &Gpu, rays: &[Ray]) -> Vec<Answer> {
        let answers = self.closest_by(gpu, "closest", rays);
        let together = self.closest_by(gpu, "closest_together", rays);
        let differing = answers.iter().zip(&together).position(|(a, b)| a != b);
        assert!(differing.is_none(), "in packets: {:?}", differing.map(|i| (rays[i], answers[i], together[i])));
        answers
    }

    fn occluded(&self, gpu: &Gpu, rays: &[Ray]) -> Vec<[u32; 4]> {
        let occluded = self.run(gpu, "occluded", rays);
        assert_eq!(occluded, self.run(gpu, "occluded_together", rays), "in packets");
        occluded
    }

    fn lines(&self, gpu: &Gpu, rays: &[Ray]) -> Vec<[u32; 4]> {
        let lines = self.run(gpu, "line", rays);
        assert_eq!(lines, self.run(gpu, "line_together", rays), "in packets");
        lines
    }

    fn corners(&self, primitive: u32) -> [DVec3; 3] {
        let texels = &self.bvh.triangles[3 * primitive as usize..][..3];
        std::array::from_fn(|i| Vec3::from_slice(&texels[i][..3]).as_dvec3())
    }
}

pub fn answer([t, u, v, primitive]: [u32; 4]) -> Answer {
    Answer { t: f32::from_bits(t), u: f32::from_bits(u), v: f32::from_bits(v), primitive }
}

/// Intersection of a ray with a triangle in double precision.
pub struct Meeting {
    pub t: f64,
    /// Distance of the ray from the nearest edge, measured perpendicular to the ray; negative outside the triangle.
    pub inside: f64,
    /// Maximum error of t, given that of points.
    pub t_slack: f64,
    /// Maximum error of the kernel across the ray: each coordinate relative to the origin is rounded once and sheared
    /// with two roundings, and an edge's distance has as many again; eight half-units in the last place cover them.
    pub slack: f64,
}

pub fn meeting(ray: &Ray, corners: [DVec3; 3]) -> Meeting {
    let d = ray.direction.as_dvec3();
    let (x, y) = d.normalize().any_orthonormal_pair();
    let relative = corners.map(|corner| corner - ray.origin.as_dvec3());
    let flat = relative.map(|q| DVec2::new(q.dot(x), q.dot(y)));
    let normal = (relative[1] - relative[0]).cross(relative[2] - relative[0]);
    let orientation = (flat[1] - flat[0]).perp_dot(flat[2] - flat[0]).signum();
    let inside = (0..3)
        .map(|i| {
            let (a, b) = (flat[i], flat[(i + 1) % 3]);
            orientation * (b - a).perp_dot(-a) / (b - a).length()
        })
        .fold(f64::INFINITY, f64::min);
    let reach = relative.iter().map(|q| q.length()).fold(0.0, f64::max);
    let slack = reach * 8.0 * 2f64.powi(-24);
    // Three roundings of a sum of three products, on top of the points' own errors.
    let t_slack = 2.0 * slack * normal.length() / normal.dot(d).abs();
    Meeting { t: normal.dot(relative[0]) / normal.dot(d), inside, t_slack, slack }
}

/// Compares the answers with a loop over all triangles: the triangle hit lies where the kernel says and none is nearer,
/// as far as roundings allow. Returns what is wrong, and the number of answers that rounding leaves undecided.
fn compare(traced: &Traced, rays: &[Ray], answers: &[Answer]) -> (Vec<String>, usize) {
    let all: Vec<_> = (0..traced.bvh.order.len() as u32).map(|primitive| traced.corners(primitive)).collect();
    let mut wrong = Vec::new();
    let mut unsure = 0;
    for (i, (ray, answer)) in rays.iter().zip(answers).enumerate() {
        if answer.primitive != NO_HIT {
            let met = meeting(ray, all[answer.primitive as usize]);
            let off = (f64::from(answer.t) - met.t).abs();
            if !(met.inside >= -met.slack && off <= met.t_slack && answer.t <= ray.t_max) {
                wrong.push(format!("ray {i}: {answer:?} lies {} outside, t is off by {off}", -met.inside));
            }
        }
        let mut nearer_unsure = false;
        for (primitive, corners) in all.iter().enumerate() {
            let met = meeting(ray, *corners);
            let before = |slack: f64| met.t + slack < f64::from(answer.t.min(ray.t_max)) && met.t - slack > 0.0;
            if met.inside > met.slack && before(2.0 * met.t_slack) {
                wrong.push(format!("ray {i}: {answer:?}, but primitive {primitive} is met at {}", met.t));
            }
            nearer_unsure |= met.inside.abs() <= met.slack && before(0.0);
        }
        unsure += usize::from(nearer_unsure);
    }
    (wrong, unsure)
}

/// A generator of numbers in 0..1 (Knuth's MMIX constants; the upper bits are the good ones).
pub struct Random(pub u64);

impl Random {
    pub fn number(&mut self) -> f32 {
        self.0 = self.0.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        (self.0 >> 40) as f32 / (1u64 << 24) as f32
    }

    /// In -1..1.
    pub fn point(&mut self) -> Vec3 {
        vec3(self.number(), self.number(), self.number()) * 2.0 - 1.0
    }

    pub fn direction(&mut self) -> Vec3 {
        loop {
            let p = self.point();
            if (0.01..1.0).contains(&p.length_squared()) {
                return p.normalize();
            }
        }
    }
}

pub fn soup(count: usize, size: f32) -> Vec<Triangle> {
    let mut random = Random(count as u64);
    (0..count)
        .map(|_| {
            let centre = random.point();
            std::array::from_fn(|_| centre + size * random.point())
        })
        .collect()
}

pub fn random_rays(count: usize) -> Vec<Ray> {
    let mut random = Random(99);
    (0..count).map(|_| ray(1.5 * random.point(), random.direction())).collect()
}

/// Twelve triangles around the box from -half to half.
pub fn closed_box(half: f32) -> Vec<Triangle> {
    let corner =
        |i: usize| half * vec3((i & 1) as f32 * 2. - 1., (i >> 1 & 1) as f32 * 2. - 1., (i >> 2) as f32 * 2. - 1.);
    [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
        .iter()
        .flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]])
        .map(|triangle| triangle.map(corner))
        .collect()
}

/// The closest hit is that of a loop over all triangles in f64, in random soups of 1 to 5,000 triangles. Packets and
/// rays one by one, textures and storage buffers, small stacks and stacks for the deepest BVHs, and the kernel's own
/// loop over all triangles give the same bits.
#[kernel_test("PENUMBRA_DEVICE")]
fn closest_hits_are_those_of_all_triangles(gpu: &Gpu) {
    let rays = random_rays(2000);
    let mut depths = Vec::new();
    for (count, size) in [(1, 1.0), (2, 1.0), (3, 1.0), (5, 0.8), (64, 0.5), (200, 0.3), (5000, 0.1)] {
        let mut traced = Traced::new(gpu, &soup(count, size));
        depths.push(traced.bvh.depth);
        let answers = traced.closest(gpu, &rays);
        let (wrong, unsure) = compare(&traced, &rays, &answers);
        assert!(wrong.is_empty(), "{count} triangles: {}", wrong.join("\n"));
        assert!(unsure < 20, "{count} triangles: {unsure} of 2000 answers are undecided");
        let hits = answers.iter().filter(|answer| answer.primitive != NO_HIT).count();
        assert!((20..1980).contains(&hits), "{count} triangles: {hits} hits prove nothing");
        let exhaustive: Vec<_> = traced.run(gpu, "exhaustive", &rays).into_iter().map(answer).collect();
        assert_eq!(answers, exhaustive, "{count} triangles");
        traced.features = traced.features.clone().with(Feature::ShallowBvh, false);
        assert_eq!(answers, traced.closest(gpu, &rays), "{count} triangles, a stack for any depth");
        let other_table = !traced.features.has(Feature::TextureLoads);
        let features = traced.features.clone().with(Feature::Packets, false);
        traced.features = features.with(Feature::TextureLoads, other_table);
        assert_eq!(answers, traced.closest(gpu, &rays), "{count} triangles, the other kind of table");
        traced.features = traced.features.clone().with(Feature::LayeredTexels, true);
        assert_eq!(answers, traced.closest(gpu, &rays), "{count} triangles, tables in layers");
    }
    let deepest_of_registers = depths.iter().filter(|depth| **depth <= 5).max();
    assert_eq!(deepest_of_registers, Some(&5), "{depths:?}: registers are never full");
}

/// The comparison finds a stack that overflows: the registers for a shallow BVH are too few for a deep one.
#[kernel_test("PENUMBRA_DEVICE")]
fn a_stack_that_overflows_is_found(gpu: &Gpu) {
    let rays = random_rays(2000);
    let mut traced = Traced::new(gpu, &soup(20_000, 0.2));
    assert!(!traced.bvh.is_shallow());
    traced.features = traced.features.clone().with(Feature::ShallowBvh, true);
    for entry in ["closest", "closest_together"] {
        let answers = traced.closest_by(gpu, entry, &rays);
        assert!(!compare(&traced, &rays, &answers).0.is_empty(), "{entry}");
    }
}

/// The comparison finds a wrong triangle, a missed hit, and a distance that is off by a thousandth.
#[kernel_test("PENUMBRA_DEVICE")]
fn planted_faults_are_found(gpu: &Gpu) {
    let rays = random_rays(2000);
    let traced = Traced::new(gpu, &soup(64, 0.5));
    let answers = traced.closest(gpu, &rays);
    let hit = answers.iter().position(|answer| answer.primitive != NO_HIT).unwrap();
    let faults: [fn(&mut Answer); 3] = [
        |a| a.primitive = (a.primitive + 1) % 64,
        |a| *a = Answer { t: FAR, u: 0.0, v: 0.0, primitive: NO_HIT },
        |a| a.t *= 1.001,
    ];
    for (number, fault) in faults.iter().enumerate() {
        let mut answers = answers.clone();
        fault(&mut answers[hit]);
        assert!(!compare(&traced, &rays, &answers).0.is_empty(), "fault {number} is not found");
    }
}

/// The comparison finds the hits that are lost if one box of the BVH is too small.
#[kernel_test("PENUMBRA_DEVICE")]
fn a_shrunk_box_is_found(gpu: &Gpu) {
    let rays = random_rays(2000);
    let mut traced = Traced::new(gpu, &soup(5000, 0.1));
    // Word 6 holds the upper x planes of the root's children.
    traced.bvh.nodes[1][2] =
        traced.bvh.nodes[1][2].to_le_bytes().map(|q| q - q / 8).iter().rev().fold(0, |w, &q| w << 8 | u32::from(q));
    // Those of packets.
    traced.packet_nodes[4..8].iter_mut().for_each(|upper| upper[0] -= 0.1);
    for entry in ["closest", "closest_together"] {
        let answers = traced.closest_by(gpu, entry, &rays);
        assert!(!compare(&traced, &rays, &answers).0.is_empty(), "{entry}");
    }
}

/// In a scene without triangles no ray hits anything, and no traversal reports an overrun.
#[kernel_test("PENUMBRA_DEVICE")]
fn an_empty_scene_blocks_no_ray(gpu: &Gpu) {
    let rays = random_rays(65);
    let traced = Traced::new(gpu, &[]);
    assert!(traced.closest(gpu, &rays).iter().all(|answer| answer.primitive == NO_HIT && answer.t == FAR));
    assert!(traced.occluded(gpu, &rays).iter().all(|answer| *answer == [0; 4]));
    assert!(traced.lines(gpu, &rays).iter().all(|answer| *answer == [0; 4]));
}

/// A ray is occluded exactly if it hits a triangle before its end, for directions of any length, and a line counts all
/// triangles along it.
#[kernel_test("PENUMBRA_DEVICE")]
fn occlusion_and_lines_are_those_of_all_triangles(gpu: &Gpu) {
    let traced = Traced::new(gpu, &soup(1000, 0.3));
    let mut rays = random_rays(4000);
    for (i, ray) in rays.iter_mut().enumerate() {
        // Unit directions with an end, and directions that reach to a point, with the end at 1.
        if i % 2 == 0 {
            ray.t_max = 1.0;
        } else {
            *ray = Ray { direction: 0.3 * ray.direction, t_max: 1.0, ..*ray };
        }
    }
    let occluded = traced.occluded(gpu, &rays);
    let lines = traced.lines(gpu, &rays);
    let (mut checked, mut stopped) = (0, 0);
    for ((ray, occluded), line) in rays.iter().zip(&occluded).zip(&lines) {
        let meetings: Vec<_> = (0..1000).map(|primitive| meeting(ray, traced.corners(primitive))).collect();
        let certain = |m: &Meeting| {
            m.inside.abs() > m.slack && m.t.abs() > m.t_slack && (m.t - f64::from(ray.t_max)).abs() > m.t_slack
        };
        if !meetings.iter().all(certain) {
            continue;
        }
        let met =
            meetings.iter().enumerate().filter(|(_, m)| m.inside > 0.0 && m.t > 0.0 && m.t <= f64::from(ray.t_max));
        let (count, sum) = met.fold((0u32, 0u32), |(count, sum), (primitive, _)| (count + 1, sum + primitive as u32));
        assert_eq!(*occluded, [u32::from(count > 0), 0, 0, 0], "{ray:?}");
        assert_eq!(*line, [count, sum, 0, 0], "{ray:?}");
        checked += 1;
        stopped += u32::from(count > 0);
    }
    assert!(checked > 3600 && (400..checked - 400).contains(&stopped), "{checked} rays checked, {stopped} stopped");
}

/// No ray leaves nested closed boxes from inside the innermost one, even if it points, as exactly as floats allow, at
/// corners, edges or the faces' diagonals.
#[kernel_test("PENUMBRA_DEVICE")]
fn closed_boxes_are_watertight(gpu: &Gpu) {
    let inner = closed_box(0.5);
    let triangles: Vec<_> = [0.5, 0.50001, 0.7, 1.0].into_iter().flat_map(closed_box).collect();
    let traced = Traced::new(gpu, &triangles);
    let mut random = Random(5);
    let mut rays = Vec::new();
    for i in 0..20_000 {
        let origin = if i % 4 == 0 { Vec3::ZERO } else { 0.49 * random.point() };
        let [a, b, c] = inner[i % inner.len()];
        let (from, to) = [(a, b), (b, c), (c, a)][i / 12 % 3];
        let target = if i % 5 == 0 { from } else { from.lerp(to, random.number()) };
        rays.push(ray(origin, (target - origin).normalize()));
        rays.push(Ray { origin, direction: 4.0 * (target - origin), t_max: 1.0 });
    }
    let answers = traced.closest(gpu, &rays);
    let escaped =
        answers.iter().filter(|answer| answer.primitive == NO_HIT || traced.bvh.order[answer.primitive as usize] >= 12);
    assert_eq!(escaped.count(), 0);
    assert!(traced.occluded(gpu, &rays).iter().all(|answer| answer[0] == 1));
    let endless: Vec<_> = rays.iter().copied().step_by(2).collect();
    let lines = traced.lines(gpu, &endless);
    // From inside, a line crosses each of the four boxes once, or more often where triangles touch.
    assert!(lines.iter().all(|line| line[0] >= 4 && line[2] == 0));
}

/// Rays along the axes (other components 0 and -0) hit a grid of triangles at its corners and edges, rim included, and
/// never if they run within its plane.
#[kernel_test("PENUMBRA_DEVICE")]
fn rays_along_axes_meet_grids_at_their_corners(gpu: &Gpu) {
    let cells = 16i32;
    let at = |i: i32| i as f32 / cells as f32 * 2.0 - 1.0;
    for axis in 0..3 {
        let point = |u: f32, v: f32, w: f32| {
            let mut p = Vec3::ZERO;
            p[axis] = w;
            p[(axis + 1) % 3] = u;
            p[(axis + 2) % 3] = v;
            p
        };
        let mut triangles = Vec::new();
        for (i, j) in (0..cells * cells).map(|k| (k % cells, k / cells)) {
            let corner = |di: i32, dj: i32| point(at(i + di), at(j + dj), 0.25);
            triangles.push([corner(0, 0), corner(1, 0), corner(1, 1)]);
            triangles.push([corner(0, 0), corner(1, 1), corner(0, 1)]);
        }
        let traced = Traced::new(gpu, &triangles);
        let (mut through, mut within) = (Vec::new(), Vec::new());
        for (i, j) in (0..=2 * cells).flat_map(|i| (0..=2 * cells).map(move |j| (i, j))) {
            // Every other ray goes to the middle of an edge.
            let (u, v) = (i as f32 / cells as f32 - 1.0, j as f32 / cells as f32 - 1.0);
            for (zero, side) in [(0.0, 1.0), (-0.0, 1.0), (0.0, -1.0), (-0.0, -1.0)] {
                through.push(ray(point(u, v, -side), point(zero, zero, side)));
                within.push(ray(point(-2.0 * side, v, 0.25), point(side, zero, zero)));
            }
        }
        for (ray, answer) in through.iter().zip(traced.closest(gpu, &through)) {
            let expected = if ray.direction[axis] > 0.0 { 1.25 } else { 0.75 };
            assert!(answer.primitive != NO_HIT && answer.t == expected, "{ray:?}: {answer:?}");
        }
        assert!(traced.closest(gpu, &within).iter().all(|answer| answer.primitive == NO_HIT));
    }
}

/// Among coincident triangles, the one with the lowest primitive index is hit, whichever the traversal reaches first.
#[kernel_test("PENUMBRA_DEVICE")]
fn coplanar_duplicates_go_to_the_lowest_primitive_index(gpu: &Gpu) {
    let triangles: Vec<Triangle> = soup(40, 0.5).into_iter().flat_map(|triangle| [triangle; 9]).collect();
    let traced = Traced::new(gpu, &triangles);
    let rays = random_rays(2000);
    let answers = traced.closest(gpu, &rays);
    let mut hits = 0;
    for answer in answers.iter().filter(|answer| answer.primitive != NO_HIT) {
        let twins = |primitive: u32| traced.corners(primitive) == traced.corners(answer.primitive);
        assert_eq!((0..360).find(|&primitive| twins(primitive)), Some(answer.primitive));
        hits += 1;
    }
    assert!(hits > 200, "{hits} hits prove nothing");
}

/// Slivers up to a million times as long as wide, side by side, leave no gaps: a ray between their ends hits one of
/// them, with finite coordinates.
#[kernel_test("PENUMBRA_DEVICE")]
fn slivers_leave_no_gaps(gpu: &Gpu) {
    for width in [2f32.powi(-20), 2f32.powi(-10)] {
        let count = 512;
        let triangles: Vec<Triangle> = (0..count)
            .flat_map(|i| {
                let (x0, x1) = (i as f32 * width, (i + 1) as f32 * width);
                let (a, b, c, d) = (vec3(x0, -0.5, 0.0), vec3(x1, -0.5, 0.0), vec3(x1, 0.5, 0.0), vec3(x0, 0.5, 0.0));
                [[a, b, c], [a, c, d]]
            })
            .collect();
        let mut traced = Traced::new(gpu, &triangles);
        let mut random = Random(3);
        let rays: Vec<_> = (0..5000)
            .map(|_| {
                // A sixteenth of the band away from each rim: 32 slivers, far more than the rounding of a target.
                let across = (0.0625 + 0.875 * random.number()) * count as f32 * width;
                let target = vec3(across, 0.9 * random.number() - 0.45, 0.0);
                let origin = vec3(random.number(), random.number(), 0.5 + random.number());
                ray(origin, (target - origin).normalize())
            })
            .collect();
        let found = traced.closest(gpu, &rays);
        traced.features = traced.features.clone().with(Feature::Needles, true);
        let on_planes = traced.closest(gpu, &rays);
        for ((ray, answer), on_plane) in rays.iter().zip(found).zip(on_planes) {
            let t = f64::from(ray.origin.z) / -f64::from(ray.direction.z);
            assert!(answer.primitive != NO_HIT, "{ray:?} passes between slivers of width {width}");
            // The two quotients and their sum are rounded.
            assert!(answer.u >= 0.0 && answer.v >= 0.0 && answer.u + answer.v <= 1.000001, "{answer:?}");
            // Coordinates relative to the ray are below 1, so the three edge functions are off by 2^-21 in all, and
            // the barycentric coordinates by that over the determinant, 2 area = width: t moves so much of a
            // sliver's length, which is 1. For the thinnest slivers this only bounds t between the corners.
            let slack = 2f64.powi(-21) / f64::from(width);
            assert!((f64::from(answer.t) - t).abs() < slack, "{ray:?}: {answer:?} instead of {t}");
            // With t moved along the plane, whose inclination has the same relative error, the square of that error and
            // a few roundings remain.
            assert!(on_plane.primitive != NO_HIT, "{ray:?}");
            let slack = slack * slack + 2f64.powi(-20);
            assert!((f64::from(on_plane.t) - t).abs() < slack, "{ray:?}: {on_plane:?} instead of {t}");
        }
    }
}

/// Traversal gives right hits in a BVH of 100,000 triangles that share one centroid.
#[kernel_test("PENUMBRA_DEVICE")]
fn identical_centroids_are_traced(gpu: &Gpu) {
    let mut random = Random(11);
    let triangles: Vec<Triangle> = (0..100_000)
        .map(|_| {
            let (a, b) = (random.direction(), random.direction());
            [a, b, -a - b].map(|corner| 0.3 * corner)
        })
        .collect();
    let traced = Traced::new(gpu, &triangles);
    let rays = random_rays(60);
    let answers = traced.closest(gpu, &rays);
    let (wrong, _) = compare(&traced, &rays, &answers);
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
    assert!(answers.iter().any(|answer| answer.primitive != NO_HIT));
}

/// A traversal that needs more iterations than the device allows reports an overrun, unless its answer is right.
#[kernel_test("PENUMBRA_DEVICE")]
fn a_traversal_that_gives_up_says_so(gpu: &Gpu) {
    let count = 200_000u32;
    let sheet = [vec3(-1.0, -1.0, 0.0), vec3(1.0, -1.0, 0.0), vec3(0.0, 1.0, 0.0)];
    let traced = Traced::new(gpu, &vec![sheet; count as usize]);
    let rays = [ray(vec3(0.0, 0.0, 1.0), vec3(0.0, 0.0, -1.0)), ray(vec3(5.0, 0.0, 1.0), vec3(0.0, 0.0, -1.0))];
    let lines = traced.run(gpu, "line", &rays);
    assert!(lines[0][0] == count || lines[0][2] == 1, "{lines:?}");
    assert_eq!(lines[1], [0; 4]);
    let together = traced.run(gpu, "line_together", &rays);
    assert!(together[0][0] == count || together[0][2] == 1, "{together:?}");
    // Through the corner of all boxes, where no triangle is.
    let beside = [ray(vec3(0.9, 0.9, 1.0), vec3(0.0, 0.0, -1.0)); 9];
    assert_eq!(traced.occluded(gpu, &beside), [[0, 1, 0, 0]; 9]);
}

/// An offset origin is above its surface, on the normal's side, by at least the error of a hit point and by not much
/// more.
#[kernel_test("PENUMBRA_DEVICE")]
fn offset_origins_clear_their_surface(gpu: &Gpu) {
    let mut random = Random(23);
    let rays: Vec<_> =
        (0..4000).map(|i| ray(random.point() * [1.0, 1e-3, 1e-8, 0.0][i % 4], random.direction())).collect();
    for (ray, words) in rays.iter().zip(traced_offsets(gpu, &rays)) {
        let moved = words.as_dvec3() - ray.origin.as_dvec3();
        let along = moved.dot(ray.direction.as_dvec3());
        // A hit point computed from barycentric coordinates at unit scale is off by up to about 2^-22.
        assert!(along > 2f64.powi(-21), "{ray:?} moved {along} along its normal");
        // 256 units in the last place at unit scale, 2^-15, in each of three coordinates.
        assert!(moved.length() < 2f64.powi(-15) * 3f64.sqrt(), "{ray:?} moved {moved}");
    }
}

fn traced_offsets(gpu: &Gpu, rays: &[Ray]) -> Vec<Vec3> {
    let words = Traced::new(gpu, &[]).run(gpu, "offset", rays);
    words.into_iter().map(|w| Vec3::new(f32::from_bits(w[0]), f32::from_bits(w[1]), f32::from_bits(w[2]))).collect()
}
