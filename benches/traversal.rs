//! Speed of the traversal of the hierarchy: camera, shadow and diffuse rays among 36 triangles (a box) and among
//! 200,012: one by one, one by one with the kernels that scenes with needles have, and in packets where the device has
//! them, run by run in turn.
//!
//! Run it with `cargo bench --bench traversal`; the variable `PENUMBRA_DEVICE` names another device than lavapipe.
//!
//! It prints for each scene the time to build the hierarchy and its levels, and for each kernel the median (and the
//! best) of nine runs in millions of rays a second, camera / shadow / diffuse. Times are those of the device.

use std::f32::consts::{PI, TAU};
use std::time::Instant;

use glam::{Mat3, Vec3, vec3};
use kernel_kit::{BoundKernel, Declared, Gpu, Resources, TableFormat};
use penumbra::Result;
use penumbra::internal::bvh::Bvh;
use penumbra::internal::kernels::compose_source;
use penumbra::internal::passes::new_kernel;
use penumbra::internal::specialisation::device_features;
use penumbra::internal::specialisation::features::{Feature, Features};

#[allow(dead_code)]
#[path = "../tests/common/random.rs"]
mod random;

use random::{Random, RandomInput as _};

/// Runs for each time.
const RUNS: usize = 9;
/// Side in pixels of the image whose camera rays are traced.
const SIZE: usize = 1024;
const FAR: f32 = 1e30;

type Triangle = [Vec3; 3];
/// Origin and t_min, direction and t_max.
type Rays = Vec<[f32; 4]>;
/// Median and best seconds of each of [`KERNELS`].
type Times = Vec<[f64; 2]>;

/// The kernels that are compared: names, and the features of those that have one more.
const KERNELS: [(&str, Option<Feature>); 3] =
    [("without needles", None), ("with needles", Some(Feature::Needles)), ("packets", Some(Feature::Packets))];

/// Rays come from a table, which is the cheapest read. Every answer is stored.
const KERNEL: &str = "
import package::kit::group_index;
import package::lib::ray::Ray;
@if(texture_loads) import package::lib::table::table_texel;
import package::lib::bvh::traversal_overrun;
import package::lib::ray::RaySample;
import package::lib::packet::{no_ray, trace_closest_together, trace_occluded_together};
@if(texture_loads) @group(0) @binding(0) var rays: texture_storage_2d<rgba32float, read>;
@if(!texture_loads) @group(0) @binding(0) var<storage, read> rays: array<vec4f>;
@group(0) @binding(1) var<storage, read_write> answers: array<vec4f>;
override ray_count: u32;
fn ray_texel(i: u32) -> vec4f {
    @if(texture_loads) { return textureLoad(rays, table_texel(i)); }
    @if(!texture_loads) { return rays[i]; }
}
fn ray_of(i: u32) -> Ray {
    if i >= ray_count { return no_ray(); }
    let a = ray_texel(2u * i);
    let b = ray_texel(2u * i + 1u);
    return Ray(a.xyz, a.w, b.xyz, b.w);
}
@compute @workgroup_size(64)
fn closest(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = group_index(group, groups) * 64u + lane;
    let hit = trace_closest_together(ray_of(i), RaySample(0u, 0u), lane);
    if i >= ray_count { return; }
    answers[i] = vec4f(hit.t, f32(traversal_overrun), hit.v, bitcast<f32>(hit.triangle));
}
@compute @workgroup_size(64)
fn occluded(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = group_index(group, groups) * 64u + lane;
    let occluded = trace_occluded_together(ray_of(i), RaySample(0u, 0u), lane);
    if i >= ray_count { return; }
    answers[i] = vec4f(f32(occluded), f32(traversal_overrun), 0.0, 0.0);
}";

struct Bench<'a> {
    gpu: &'a Gpu,
    bvh: &'a Bvh,
}

impl Bench<'_> {
    /// Times of the kernels, and the answers of the first.
    fn run(&self, entry: &str, rays: &Rays) -> Result<(Times, Vec<[f32; 4]>)> {
        let gpu = self.gpu;
        let count = rays.len() / 2;
        let nodes = gpu.table("bench/bvh_nodes", &self.bvh.nodes, TableFormat::Uint)?;
        let triangles = gpu.table("bench/bvh_triangles", &self.bvh.triangles, TableFormat::Float)?;
        let packets = gpu.table("bench/packet_nodes", &self.bvh.packet_nodes(), TableFormat::Float)?;
        let rays = gpu.table("bench/rays", rays, TableFormat::Float)?;
        let answers = gpu.poisoned::<[f32; 4]>("bench/answers", count)?;
        let set = Resources::new().with("bvh_nodes", &nodes).with("bvh_triangles", &triangles);
        let set = set.with("rays", &rays).with("answers", &answers).with("packet_nodes", &packets);
        let bind = |feature: Option<Feature>| -> Result<BoundKernel> {
            let features = Features::default()
                .with(Feature::TextureLoads, gpu.texture_loads)
                .with(Feature::Interleave, gpu.texture_loads)
                .with(Feature::ShallowBvh, self.bvh.is_shallow());
            let features = feature.iter().fold(features, |features, feature| features.with(*feature, true));
            let composed = compose_source("traversal", KERNEL, &features)?;
            let kernel = new_kernel(
                gpu,
                &composed,
                &[("ray_count", count as f64)],
                &[Declared { required: &["answers"], optional: &[] }],
            )?;
            Ok(kernel.bind(gpu, entry, &[&set])?)
        };
        let time = |bound: &BoundKernel, items: usize| -> Result<f64> {
            let before = gpu.pass_times()?.get(&bound.label).copied().unwrap_or(0.0);
            let mut frame = gpu.frame("bench");
            frame.run(bound, items as u32, &[0u32; 0]);
            frame.submit()?;
            Ok(gpu.pass_times()?.get(&bound.label).copied().unwrap_or(0.0) - before)
        };
        let mut kernels = Vec::new();
        for (_, feature) in KERNELS {
            if feature != Some(Feature::Packets) || device_features(gpu, Features::default()).has(Feature::Packets) {
                kernels.push((bind(feature)?, Vec::new()));
            }
        }
        for (bound, _) in &kernels {
            time(bound, 1)?;
        }
        for _ in 0..RUNS {
            // The first kernel runs last, so that the answers are its own.
            for (bound, times) in kernels.iter_mut().rev() {
                times.push(time(bound, count)?);
            }
        }
        let answers: Vec<[f32; 4]> = gpu.read(&answers, count)?;
        assert!(answers.iter().all(|answer| answer[1] == 0.0), "a traversal gave up");
        let of_kernel = |(_, mut times): (_, Vec<f64>)| {
            times.sort_by(f64::total_cmp);
            [times[RUNS / 2], times[0]]
        };
        Ok((kernels.into_iter().map(of_kernel).collect(), answers))
    }
}

/// Camera rays in tiles of 8 x 8 pixels, one workgroup each.
fn camera_rays(random: &mut Random) -> Rays {
    let mut rays = Rays::new();
    for i in 0..SIZE * SIZE {
        let (tile, lane) = (i / 64, i % 64);
        let (x, y) = (tile % (SIZE / 8) * 8 + lane % 8, tile / (SIZE / 8) * 8 + lane / 8);
        let at = |pixel: usize, jitter: f32| (pixel as f32 + jitter) / SIZE as f32 - 0.5;
        let direction = vec3(at(x, random.unit()), -at(y, random.unit()), -1.3735).normalize();
        rays.push([0.0, 0.0, 3.6, 0.0]);
        rays.push(direction.extend(FAR).to_array());
    }
    rays
}

/// From each visible point, a shadow ray to a point of the light, and a diffuse ray whose direction has the density of
/// the cosine.
fn secondary_rays(bvh: &Bvh, camera: &Rays, answers: &[[f32; 4]], random: &mut Random) -> (Rays, Rays) {
    let (mut shadow, mut diffuse) = (Rays::new(), Rays::new());
    for (ray, answer) in camera.chunks(2).zip(answers) {
        let primitive = answer[3].to_bits();
        if primitive == u32::MAX {
            continue;
        }
        let corner = |i: usize| Vec3::from_slice(&bvh.triangles[3 * primitive as usize + i][..3]);
        let direction = Vec3::from_slice(&ray[1][..3]);
        let normal = (corner(1) - corner(0)).cross(corner(2) - corner(0)).normalize();
        let normal = if normal.dot(direction) > 0.0 { -normal } else { normal };
        let point = Vec3::from_slice(&ray[0][..3]) + answer[0] * direction + 1e-5 * normal;
        let light = vec3(0.8 * random.unit() - 0.4, 0.99, 0.8 * random.unit() - 0.4);
        shadow.extend([point.extend(0.0).to_array(), (light - point).extend(0.9999).to_array()]);
        let (z, phi) = (2.0 * random.unit() - 1.0, TAU * random.unit());
        let (sin, cos) = phi.sin_cos();
        let sphere = vec3((1.0 - z * z).sqrt() * cos, (1.0 - z * z).sqrt() * sin, z);
        diffuse.extend([point.extend(0.0).to_array(), (normal + sphere).normalize().extend(FAR).to_array()]);
    }
    (shadow, diffuse)
}

fn main() -> Result<()> {
    let device = std::env::var("PENUMBRA_DEVICE").unwrap_or_else(|_| "software".into());
    let gpu = Gpu::open(&device.parse().unwrap_or_default())?;
    println!("{} ({})", gpu.info.name, gpu.info.driver);
    println!("millions of rays a second, median (best) of {RUNS}: camera / shadow / diffuse");
    for triangles in [boxes(), spheres()] {
        let start = Instant::now();
        let bvh = Bvh::build(&triangles)?;
        let build_s = start.elapsed().as_secs_f64();
        let bench = Bench { gpu: &gpu, bvh: &bvh };
        let mut random = Random(1);
        let camera = camera_rays(&mut random);
        let first = bench.run("closest", &camera)?;
        let (shadow, diffuse) = secondary_rays(&bvh, &camera, &first.1, &mut random);
        let results = [
            (camera.len() / 2, first),
            (shadow.len() / 2, bench.run("occluded", &shadow)?),
            (diffuse.len() / 2, bench.run("closest", &diffuse)?),
        ];
        let count = triangles.len();
        println!("{count} triangles, built in {build_s:.3} s, {} levels", bvh.depth);
        for (kernel, (name, _)) in KERNELS.iter().enumerate().take(results[0].1.0.len()) {
            let rates = results.each_ref().map(|(count, (times, _))| {
                let [median, best] = times[kernel].map(|seconds| *count as f64 / seconds * 1e-6);
                format!("{median:.2} ({best:.2})")
            });
            println!("  {name}: {}", rates.join(" / "));
        }
    }
    Ok(())
}

fn quad(a: Vec3, b: Vec3, c: Vec3, d: Vec3) -> [Triangle; 2] {
    [[a, b, c], [a, c, d]]
}

/// Some of the six faces of a box that is rotated about y.
fn cuboid(centre: Vec3, half: Vec3, angle: f32, faces: &[usize]) -> Vec<Triangle> {
    let rotation = Mat3::from_rotation_y(angle);
    let mut triangles = Vec::new();
    for &face in faces {
        let (axis, side) = (face / 2, face as f32 % 2.0 * 2.0 - 1.0);
        let corner = |u: f32, v: f32| {
            let mut p = Vec3::ZERO;
            p[axis] = side;
            p[(axis + 1) % 3] = u;
            p[(axis + 2) % 3] = v;
            centre + rotation * (p * half)
        };
        triangles.extend(quad(corner(-1., -1.), corner(1., -1.), corner(1., 1.), corner(-1., 1.)));
    }
    triangles
}

/// A room without its front, and a light below its ceiling: 12 triangles.
fn room() -> Vec<Triangle> {
    let mut t = cuboid(Vec3::ZERO, Vec3::ONE, 0.0, &[0, 1, 2, 3, 4]);
    t.extend(quad(vec3(-0.4, 0.99, -0.4), vec3(0.4, 0.99, -0.4), vec3(0.4, 0.99, 0.4), vec3(-0.4, 0.99, 0.4)));
    t
}

/// The room with two boxes in it.
fn boxes() -> Vec<Triangle> {
    let mut t = room();
    t.extend(cuboid(vec3(0.3, -0.65, 0.1), Vec3::splat(0.35), 0.35, &[0, 1, 2, 3, 4, 5]));
    t.extend(cuboid(vec3(-0.4, -0.4, -0.4), vec3(0.3, 0.6, 0.3), -0.3, &[0, 1, 2, 3, 4, 5]));
    t
}

/// The room with twenty bumpy spheres of 10,000 triangles.
fn spheres() -> Vec<Triangle> {
    let mut t = room();
    let mut random = Random(7);
    for i in 0..20 {
        let centre = vec3(random.unit() * 1.6 - 0.8, random.unit() * 1.5 - 0.8, random.unit() * 1.6 - 0.8);
        let radius = 0.1 + 0.15 * random.unit();
        let (rows, columns) = (50, 100);
        let point = |row: usize, column: usize| {
            let (theta, phi) = (PI * row as f32 / rows as f32, TAU * (column % columns) as f32 / columns as f32);
            let n = vec3(theta.sin() * phi.cos(), theta.cos(), theta.sin() * phi.sin());
            let bump = (n * 9.0 + i as f32).map(f32::sin).element_product();
            centre + n * radius * (1.0 + 0.15 * bump)
        };
        for row in 0..rows {
            for column in 0..columns {
                let (a, b, c, d) =
                    (point(row, column), point(row + 1, column), point(row + 1, column + 1), point(row, column + 1));
                t.extend([[a, b, c], [a, c, d]]);
            }
        }
    }
    t
}
