//! Lights against an oracle in f64: polygon arrays clipped one plane at a time, Lambert's formula by arc cosines,
//! solid angles by Van Oosterom and Strackee, and statistics of the samplers.

use std::f64::consts::{PI, TAU};
use std::iter;

use glam::{DVec3, Vec3, Vec4};
use kernel_kit::{Gpu, Resources, kernel_test};
use penumbra::internal::gpu_scene::{GpuLights, ReceiverBounds};
use penumbra::internal::kernels::{compose, compose_source};
use penumbra::internal::scene::{EmitterTriangle, LightKind, Material, NO_LIGHT, Scene};
use penumbra::internal::specialisation::features::{Feature, Features};
use penumbra::internal::specialisation::lights::{has_many_emitters, is_closed};

use crate::kit::{device_features, new_kernel, results};
use crate::meshes::surface;
use crate::random::{Random, RandomInput as _};
use crate::statistics::{chi_square, z_test};

pub use crate::meshes::{Corners, cube, sphere, square};

/// Radiance of the mesh lights: the channels differ; the tests compare red, and its ratio to the others.
const RADIANCE: Vec3 = Vec3::new(1.0, 2.0, 4.0);

pub fn material(double_sided: bool) -> Material {
    Material { name: "light".into(), metallic: 0.0, emissive: RADIANCE, double_sided, ..Material::default() }
}

/// A scene of mesh lights given as triangles, and punctual ones. A dark triangle comes first, so that indices of
/// triangles and of emitters differ.
pub fn scene(meshes: &[(Vec<Corners>, bool)], punctual: &[LightKind]) -> Scene {
    let dark = [DVec3::NEG_ONE, DVec3::new(1.0, -1.0, -1.0), DVec3::new(1.0, -1.0, 1.0)];
    let lamps = meshes.iter().map(|(triangles, two_sided)| (triangles.clone(), material(*two_sided)));
    let all: Vec<_> = iter::once((vec![dark], surface(0.5, 0.0))).chain(lamps).collect();
    crate::meshes::scene(&all, punctual.to_vec())
}

fn features(gpu: &Gpu, scene: &Scene) -> Features {
    let any = |has: fn(&LightKind) -> bool| scene.lights.iter().any(|light| has(&light.kind));
    device_features(gpu)
        .with(Feature::MeshLights, any(|kind| matches!(kind, LightKind::Mesh { .. })))
        .with(Feature::PointLights, any(|kind| matches!(kind, LightKind::Point { .. })))
        .with(Feature::SpotLights, any(|kind| matches!(kind, LightKind::Spot { .. })))
        .with(Feature::DirectionalLights, any(|kind| matches!(kind, LightKind::Directional { .. })))
        .with(Feature::ManyEmitters, scene.lights.iter().any(has_many_emitters))
        .with(
            Feature::EmitterPairs,
            scene.lights.iter().any(|light| has_many_emitters(light) && is_closed(scene, light)),
        )
}

/// A position and a normal in the kernel's format, and the index of the light.
#[derive(Clone, Copy, Debug)]
pub struct Place {
    pub position: Vec3,
    pub normal: Vec3,
    pub light: usize,
}

impl Place {
    pub fn new(position: DVec3, normal: DVec3, light: usize) -> Place {
        Place { position: position.as_vec3(), normal: normal.as_vec3(), light }
    }
}

/// Runs an entry of the test kernel: `per_item` vectors for each of `count` items.
pub fn run(
    gpu: &Gpu,
    scene: &Scene,
    entry: &str,
    places: &[Place],
    count: usize,
    per_item: usize,
    samples: u32,
) -> Vec<[f32; 4]> {
    run_with(gpu, (&features(gpu, scene), &gpu_scene(gpu, scene, None)), entry, places, count, per_item, samples)
}

/// A ray that leaves a light.
pub struct Emitted {
    pub origin: DVec3,
    pub direction: DVec3,
    /// Flux of the first channel.
    pub flux: f64,
}

/// Rays that a light emits: towards the receivers if they are given, else in all directions.
pub fn emit(gpu: &Gpu, scene: &Scene, receivers: Option<ReceiverBounds>, light: usize, rays: usize) -> Vec<Emitted> {
    let place = [Place::new(DVec3::ZERO, DVec3::Z, light)];
    let got = run_with(gpu, (&features(gpu, scene), &gpu_scene(gpu, scene, receivers)), "emitted", &place, rays, 3, 0);
    let vector = |v: [f32; 4]| DVec3::new(v[0].into(), v[1].into(), v[2].into());
    let rays = got.chunks_exact(3);
    rays.map(|ray| Emitted { origin: vector(ray[0]), direction: vector(ray[1]), flux: ray[1][3].into() }).collect()
}

fn gpu_scene(gpu: &Gpu, scene: &Scene, receivers: Option<ReceiverBounds>) -> GpuLights {
    GpuLights::new(gpu, scene, receivers).unwrap()
}

/// As [`run`], composed with other features.
fn run_with(
    gpu: &Gpu,
    (features, gpu_scene): (&Features, &GpuLights),
    entry: &str,
    places: &[Place],
    count: usize,
    per_item: usize,
    samples: u32,
) -> Vec<[f32; 4]> {
    let source = include_str!("shaders/light.wgsl");
    let composed = compose_source("light", source, features).unwrap();
    let constants = [("count", count as f64), ("seed", 1234567.0), ("samples", f64::from(samples))];
    let kernel = new_kernel(gpu, &composed, &constants, &["places", "results"]).unwrap();
    let records: Vec<Vec4> =
        places.iter().flat_map(|p| [p.position.extend(p.light as f32), p.normal.extend(0.0)]).collect();
    let places = gpu.upload("test/places", &records).unwrap();
    let own = Resources::new().with("places", &places);
    results(gpu, &kernel, entry, &[&own, gpu_scene], count, per_item)
}

fn grid(centre: DVec3, half: DVec3, other: DVec3, n: usize, keep: impl Fn(usize, usize) -> bool) -> Vec<Corners> {
    // Corners are computed once each and in f32, so that neighbours share them bit by bit.
    let corner = |i: usize, j: usize| {
        let f = |k: usize| 2.0 * k as f64 / n as f64 - 1.0;
        (centre + half * f(i) + other * f(j)).as_vec3().as_dvec3()
    };
    let cells = (0..n * n).map(|k| (k / n, k % n)).filter(|(i, j)| keep(*i, *j));
    cells
        .flat_map(|(i, j)| {
            let [a, b, c, d] = [corner(i, j), corner(i + 1, j), corner(i + 1, j + 1), corner(i, j + 1)];
            [[a, b, c], [a, c, d]]
        })
        .collect()
}

/// The mesh lights that the tests use, by name.
fn meshes() -> Vec<(&'static str, Vec<Corners>, bool)> {
    let (x, y, z) = (DVec3::X, DVec3::Y, DVec3::Z);
    let tilted = DVec3::new(0.3, 0.8, -0.2).normalize();
    let across = tilted.cross(x).normalize();
    vec![
        ("square facing down", square(DVec3::new(0.1, 0.9, 0.0), x * 0.3, z * 0.4), false),
        (
            "two-sided triangle",
            vec![[DVec3::new(0.0, 0.2, 0.0), DVec3::new(0.5, 0.1, 0.2), DVec3::new(0.1, 0.6, 0.3)]],
            true,
        ),
        ("L", grid(DVec3::new(-0.2, 0.3, 0.1), tilted * 0.3, across * 0.3, 2, |i, j| i + j < 2), false),
        ("square with a hole", grid(y * 0.5, x * 0.45, z * 0.45, 3, |i, j| (i, j) != (1, 1)), false),
        ("fine grid", grid(y * 0.7, x * 0.4, z * 0.4, 16, |_, _| true), false),
        ("cube", cube(DVec3::new(0.2, 0.1, -0.1), 0.2), false),
        ("small square", square(DVec3::new(0.3, 0.8, 0.2), z * 0.01, x * 0.01), false),
        ("sphere", sphere(DVec3::new(-0.3, 0.5, 0.2), 0.15, 12), false),
    ]
}

fn mesh_scene() -> Scene {
    scene(&meshes().into_iter().map(|(_, t, two_sided)| (t, two_sided)).collect::<Vec<_>>(), &[])
}

/// The triangles of a light as the kernel has them: rounded to f32.
pub fn triangles_of(scene: &Scene, light: usize) -> (Vec<Corners>, bool) {
    let LightKind::Mesh { material, emitters } = &scene.lights[light].kind else { panic!("no mesh light") };
    let corners = |e: &EmitterTriangle| {
        scene.triangles[e.triangle as usize].vertices.map(|v| scene.vertices[v as usize].position.as_dvec3())
    };
    (emitters.iter().map(corners).collect(), scene.materials[*material as usize].double_sided)
}

/// Height of the position over the triangle's plane: positive in front.
pub fn height_over(t: &Corners, position: DVec3) -> f64 {
    let n = (t[1] - t[0]).cross(t[2] - t[0]).normalize();
    n.dot(position - t[0])
}

/// The part of a polygon with n . v > 0.
pub fn clipped(polygon: &[DVec3], n: DVec3) -> Vec<DVec3> {
    let mut kept = Vec::new();
    for (i, a) in polygon.iter().enumerate() {
        let b = polygon[(i + 1) % polygon.len()];
        let (ha, hb) = (n.dot(*a), n.dot(b));
        if ha >= 0.0 {
            kept.push(*a);
        }
        if (ha > 0.0 && hb < 0.0) || (ha < 0.0 && hb > 0.0) {
            kept.push(a.lerp(b, ha / (ha - hb)));
        }
    }
    kept
}

/// The oracle: the sum over triangles of Lambert's formula, each clipped at the horizon.
pub fn form_factor(triangles: &[Corners], two_sided: bool, position: DVec3, normal: DVec3, clip: bool) -> f64 {
    let mut sum = 0.0;
    for t in triangles {
        let side = height_over(t, position);
        if side == 0.0 || (side < 0.0 && !two_sided) {
            continue;
        }
        let seen = t.map(|v| v - position);
        let polygon = if clip { clipped(&seen, normal) } else { seen.to_vec() };
        let mut part = 0.0;
        for (i, a) in polygon.iter().enumerate() {
            let b = polygon[(i + 1) % polygon.len()];
            let angle = a.normalize().dot(b.normalize()).clamp(-1.0, 1.0).acos();
            if let Some(across) = a.cross(b).try_normalize() {
                part += angle * across.dot(normal);
            }
        }
        sum += (part / 2.0).abs();
    }
    sum
}

/// The same by brute force: midpoints of a fine subdivision.
fn form_factor_by_sum(triangles: &[Corners], position: DVec3, normal: DVec3, n: usize) -> f64 {
    let mut sum = 0.0;
    for [a, b, c] in triangles {
        let across = (b - a).cross(c - a);
        let area = across.length() / 2.0 / (n * n) as f64;
        for i in 0..n {
            for j in 0..n {
                // Two small triangles to each cell below the diagonal, one on it.
                for third in [1.0 / 3.0, 2.0 / 3.0] {
                    let (u, v) = ((i as f64 + third) / n as f64, (j as f64 + third) / n as f64);
                    if u + v >= 1.0 {
                        continue;
                    }
                    let d = a + (b - a) * u + (c - a) * v - position;
                    let cosines = d.dot(normal).max(0.0) * (-d.dot(across.normalize())).max(0.0);
                    sum += area * cosines / d.length_squared().powi(2);
                }
            }
        }
    }
    sum
}

/// Solid angle of the front-facing triangles (Van Oosterom and Strackee 1983).
fn solid_angle(triangles: &[Corners], two_sided: bool, position: DVec3) -> f64 {
    let seen = triangles.iter().filter(|t| two_sided || height_over(t, position) > 0.0);
    seen.map(|t| {
        let [a, b, c] = t.map(|v| (v - position).normalize());
        2.0 * a.dot(b.cross(c)).abs().atan2(1.0 + a.dot(b) + b.dot(c) + c.dot(a))
    })
    .sum()
}

/// Random positions for each light, and difficult ones: at a distance of 1e-4, in its plane beside it and under its
/// centre, with normals parallel to its plane, at its horizon, in the far corner of the scene.
fn places(scene: &Scene) -> Vec<Place> {
    let mut random = Random(7);
    let mut places = Vec::new();
    for light in 0..scene.lights.len() {
        for _ in 0..400 {
            places.push(Place::new(random.point(), random.direction(), light));
        }
        let (triangles, _) = triangles_of(scene, light);
        for t in triangles.iter().take(8) {
            let n = (t[1] - t[0]).cross(t[2] - t[0]).normalize();
            let middle = (t[0] + t[1] + t[2]) / 3.0;
            let along = (t[1] - t[0]).normalize();
            for normal in [-n, n, along, (along - n).normalize(), (along - n * 1e-3).normalize(), random.direction()] {
                for position in [
                    middle + n * 1e-4,
                    middle - n * 1e-4,
                    t[0] + n * 1e-4,
                    middle + n * 0.1,
                    t[0] + (t[0] - middle) * 3.0,
                    t[0] + (t[0] - middle) * 3.0 + n * 1e-4,
                    middle + (DVec3::ONE - middle) * 0.98,
                ] {
                    places.push(Place::new(position, normal, light));
                }
            }
        }
    }
    // The oracle takes the same unit normals as the kernel: f32 ones, whose length is 1 to within rounding.
    places
}

/// The largest difference between kernel and oracle over all positions with a closed form, in units of the tolerance of
/// f32. Coordinates of unit size have a rounding error of 2^-24, so the error of a position is about 1e-7. At height h
/// over the light's plane, irradiance over radiance changes by at most 1 / h per length (the gradient for a half-plane
/// is a bound). The sums over edges have an error of 1e-6 of the angle, which is at most pi.
fn worst(gpu: &Gpu, scene: &Scene, oracle: impl Fn(&[Corners], bool, DVec3, DVec3) -> f64) -> (f64, Place) {
    let places = places(scene);
    let got = run(gpu, scene, "closed", &places, places.len(), 1, 0);
    let mut worst = (0.0, places[0]);
    for (place, got) in places.iter().zip(&got) {
        let (triangles, two_sided) = triangles_of(scene, place.light);
        if got[3] as u32 & 2 == 0 {
            continue;
        }
        let (position, normal) = (place.position.as_dvec3(), place.normal.as_dvec3());
        let height = triangles.iter().map(|t| height_over(t, position).abs()).fold(f64::INFINITY, f64::min);
        // In the plane itself the answer jumps from 0 to pi; both are right.
        if height < 1e-6 {
            continue;
        }
        let exact = oracle(&triangles, two_sided, position, normal);
        let allowed = 4e-6 + 1e-7 / height;
        let off = (f64::from(got[0]) - exact).abs() / allowed;
        if off > worst.0 {
            worst = (off, *place);
        }
        // The radiances are powers of two, so the channels may differ by the last bits only.
        assert!((got[1] - 2.0 * got[0]).abs() <= 1e-6 * got[1] && (got[2] - 4.0 * got[0]).abs() <= 1e-6 * got[2]);
    }
    worst
}

/// The closed form equals the oracle: at and below the horizon, almost touching the light, grazing, and in the light's
/// plane. Faults planted in the oracle are found.
#[kernel_test("PENUMBRA_DEVICE")]
fn closed_form_is_lamberts(gpu: &Gpu) {
    let scene = mesh_scene();
    let (off, place) = worst(gpu, &scene, |t, two, p, n| form_factor(t, two, p, n, true));
    assert!(off <= 1.0, "{off} of what is allowed at {place:?} ({})", meshes()[place.light].0);
    let (off, _) = worst(gpu, &scene, |t, two, p, n| form_factor(t, two, p, n, false));
    assert!(off > 100.0, "an oracle without horizon");
    let (off, _) = worst(gpu, &scene, |t, _, p, n| form_factor(t, true, p, n, true));
    assert!(off > 100.0, "an oracle without sides");
    let (off, _) = worst(gpu, &scene, |t, two, p, n| form_factor(t, two, p + DVec3::new(0.0, 1e-4, 0.0), n, true));
    assert!(off > 3.0, "an oracle that is 1e-4 off: {off}");
}

/// The oracle equals the integral of both cosines over the squared distance.
#[test]
fn the_oracle_is_the_integral() {
    let mut random = Random(3);
    for (name, triangles, _) in meshes().into_iter().filter(|m| !m.2 && m.1.len() < 20) {
        for _ in 0..5 {
            let (position, normal) = (random.point() - DVec3::Y, random.direction());
            let exact = form_factor(&triangles, false, position, normal, true);
            let summed = form_factor_by_sum(&triangles, position, normal, 200);
            // The horizon cuts cells of 1/200 of a side. The error is that of the cells along it.
            assert!((exact - summed).abs() < 2e-3 * exact + 1e-5, "{name}: {exact} {summed}");
        }
    }
}

/// Coplanar triangles are merged into contours that keep their holes; a light of many planes has no closed form.
#[kernel_test("PENUMBRA_DEVICE")]
fn contours_are_those_of_the_shape(gpu: &Gpu) {
    let gpu_scene = gpu_scene(gpu, &mesh_scene(), None);
    let edges: Vec<usize> = gpu_scene.lights.iter().map(|l| l.contour_edges).collect();
    assert_eq!(edges, [4, 3, 6, 8, 4, 24, 4, 0]);
    let closed: Vec<bool> = gpu_scene.lights.iter().map(|l| l.closed_form).collect();
    assert_eq!(closed, [true, true, true, true, true, true, true, false]);
    // One plane, of which one side emits.
    let has_axis: Vec<bool> = gpu_scene.lights.iter().map(|l| l.emission.axis.is_some()).collect();
    assert_eq!(has_axis, [true, false, true, true, true, false, true, false]);
    // Power is pi times area times radiance for each emitting side. 7/3 is the mean of the channels.
    let square = 0.6 * 0.8 * PI * 7.0 / 3.0;
    // Corners are rounded to f32: a few parts of 6e-8.
    assert!((gpu_scene.lights[0].power - square).abs() < 1e-6 * square);
    let [a, b, c] = meshes()[1].1[0];
    let triangle = (b - a).cross(c - a).length() / 2.0 * 2.0 * PI * 7.0 / 3.0;
    assert!((gpu_scene.lights[1].power - triangle).abs() < 1e-6 * triangle);
}

/// A light with a closed form is dark exactly where no part of it both faces the position and is above the surface's
/// plane. For other lights the test is conservative: a dark light is never a visible one.
#[kernel_test("PENUMBRA_DEVICE")]
fn dark_is_exact(gpu: &Gpu) {
    let scene = mesh_scene();
    let places = places(&scene);
    let got = run(gpu, &scene, "closed", &places, places.len(), 1, 0);
    let (mut dark_ones, mut said, mut wrong_without_sides) = (0, 0, 0);
    for (place, got) in places.iter().zip(&got) {
        let (triangles, two_sided) = triangles_of(&scene, place.light);
        let (position, normal) = (place.position.as_dvec3(), place.normal.as_dvec3());
        let heights = |t: &Corners| t.map(|v| normal.dot(v - position)).into_iter().fold(f64::NEG_INFINITY, f64::max);
        // A sign that f32 cannot decide: a few roundings of coordinates of unit size.
        let unsure = |x: f64| x.abs() < 1e-6;
        if triangles.iter().any(|t| unsure(heights(t)) || unsure(height_over(t, position))) {
            continue;
        }
        let dark =
            |sides: bool| !triangles.iter().any(|t| heights(t) > 0.0 && (sides || height_over(t, position) > 0.0));
        let bits = got[3] as u32;
        assert_eq!(bits & 4, 0);
        let is_dark = bits & 1 == 1;
        if bits & 2 != 0 {
            assert_eq!(is_dark, dark(two_sided), "{place:?} {}", meshes()[place.light].0);
            dark_ones += usize::from(is_dark);
        } else {
            assert!(!is_dark || dark(two_sided), "{place:?} {}", meshes()[place.light].0);
            said += usize::from(is_dark);
        }
        wrong_without_sides += usize::from(is_dark != dark(true));
    }
    // Guards: both kinds of lights are dark at some places, and at some only by their sides.
    assert!(dark_ones > 500 && said > 50 && wrong_without_sides > 100, "{dark_ones} {said} {wrong_without_sides}");
}

/// No light spans more than the bound of its solid angle, which is that of its bounding sphere. From afar a cube spans
/// at least a quarter of it.
#[kernel_test("PENUMBRA_DEVICE")]
fn no_light_spans_more_than_its_bound(gpu: &Gpu) {
    let scene = mesh_scene();
    let places = places(&scene);
    let got = run(gpu, &scene, "solid_angles", &places, places.len(), 1, 0);
    let (mut widest, mut over_half) = (0f64, 0);
    for (place, got) in places.iter().zip(&got) {
        let (triangles, two_sided) = triangles_of(&scene, place.light);
        let exact = solid_angle(&triangles, two_sided, place.position.as_dvec3());
        let bound = f64::from(got[0]);
        // A dozen roundings of f32: differences of positions, squares, a root and quotients.
        assert!(exact <= bound * (1.0 + 1e-5), "{place:?} {}: {exact} of {bound}", meshes()[place.light].0);
        // The rounding of pi.
        assert!(bound <= 4.0 * PI * (1.0 + 1e-6));
        widest = widest.max(exact / bound);
        over_half += usize::from(exact > 0.5 * bound);
    }
    assert!(widest > 0.25 && over_half > 0, "a bound {} times too high", 1.0 / widest);
}

/// The mean of light samples is the oracle's irradiance for each light, with or without a closed form, and the mean of
/// 1 / pdf is the solid angle of the light.
#[kernel_test("PENUMBRA_DEVICE")]
fn samples_converge_to_the_closed_form(gpu: &Gpu) {
    // A search among 512 triangles takes some ten of the 65,535 iterations that lavapipe allows for all loops together.
    const SAMPLES: u32 = 2048;
    let scene = mesh_scene();
    let mut random = Random(99);
    let mut places = Vec::new();
    for light in 0..scene.lights.len() {
        let (triangles, two_sided) = triangles_of(&scene, light);
        while places.len() < (light + 1) * 4 {
            let (position, normal) = (random.point(), random.direction());
            let exact = form_factor(&triangles, two_sided, position, normal, true);
            let near = triangles.iter().any(|t| t.iter().any(|v| v.distance(position) < 0.3));
            // Near the light the distribution of samples has long tails. A test of their mean would need many more
            // samples.
            if exact > 1e-5 && !near {
                places.push(Place::new(position, normal, light));
            }
        }
    }
    let family = 2 * places.len() as u32;
    let got = run(gpu, &scene, "sampled", &places, places.len(), 1, SAMPLES);
    let mut caught = 0;
    for (place, got) in places.iter().zip(&got) {
        let (triangles, two_sided) = triangles_of(&scene, place.light);
        let exact = |clip| form_factor(&triangles, two_sided, place.position.as_dvec3(), place.normal.as_dvec3(), clip);
        let (mean, square) = (f64::from(got[0]), f64::from(got[3]));
        // f32 sums of thousands of terms: 1e-5 of the mean beside the spread.
        let error = ((square - mean * mean).max(0.0) / f64::from(SAMPLES)).sqrt() + 1e-5 * mean;
        z_test(mean, error, exact(true), family)
            .unwrap_or_else(|e| panic!("{} {place:?}: {e}", meshes()[place.light].0));
        caught += usize::from(z_test(mean, error, exact(true) * 1.2, family).is_err());
    }
    assert!(caught > places.len() / 2, "a fifth too much is seen at {caught} of {} places only", places.len());
    for (i, place) in places.iter().enumerate().step_by(4) {
        let (triangles, two_sided) = triangles_of(&scene, place.light);
        let got = run(gpu, &scene, "listed", &places[i..=i], SAMPLES as usize, 2, 0);
        let angles = got.chunks_exact(2).map(|s| if s[0][3] > 0.0 { 1.0 / f64::from(s[0][3]) } else { 0.0 });
        let (mean, error) = crate::statistics::mean_and_error(angles);
        let exact = solid_angle(&triangles, two_sided, place.position.as_dvec3());
        z_test(mean, error + 1e-5 * mean, exact, family).unwrap_or_else(|e| panic!("{place:?}: {e}"));
        // Each sample lies on the light: its point satisfies the plane of some triangle.
        for s in got.chunks_exact(2).filter(|s| s[0][3] > 0.0) {
            let direction = DVec3::new(s[0][0].into(), s[0][1].into(), s[0][2].into());
            let point = place.position.as_dvec3() + direction * f64::from(s[1][3]);
            // A direction and a distance of up to 3.5, with a few roundings of 6e-8 each: 1e-6.
            assert!(triangles.iter().any(|t| height_over(t, point).abs() < 1e-5), "{point} is off the light");
        }
    }
}

/// The share of the sampled points of a light that are visible from a position, and the spread of what these send: the
/// standard deviation of 1 / pdf (by solid angle) over its mean.
fn visible_and_spread(gpu: &Gpu, (features, lights): (&Features, &GpuLights), place: Place) -> (f64, f64) {
    const N: usize = 1 << 12;
    let got = run_with(gpu, (features, lights), "listed", &[place], N, 2, 0);
    let angles = got.chunks_exact(2).map(|s| f64::from(s[0][3])).filter(|pdf| *pdf > 0.0).map(|pdf| 1.0 / pdf);
    let angles: Vec<f64> = angles.collect();
    let mean = angles.iter().sum::<f64>() / angles.len() as f64;
    let square = angles.iter().map(|a| (a - mean).powi(2)).sum::<f64>() / angles.len() as f64;
    (angles.len() as f64 / N as f64, square.sqrt() / mean)
}

/// From afar all sampled points of a sphere contribute about the same: they spread by less than a tenth. With points
/// sampled by power alone, contributions vary as the cosine at the sphere, by 58 %.
#[kernel_test("PENUMBRA_DEVICE")]
fn points_of_a_lamp_bring_the_same_light(gpu: &Gpu) {
    let scene = scene(&[(sphere(DVec3::ZERO, 0.1, 12), false)], &[]);
    let mut random = Random(17);
    let mut spreads = Vec::new();
    for distance in [0.22, 0.5, 4.0] {
        let position = random.direction() * distance;
        for specialisation in [features(gpu, &scene), features(gpu, &scene).with(Feature::EmitterPairs, false)] {
            let lights = gpu_scene(gpu, &scene, None);
            spreads.push(visible_and_spread(gpu, (&specialisation, &lights), Place::new(position, DVec3::Z, 0)));
        }
    }
    println!("share that is visible, and spread, with emitter pairs and without: {spreads:.3?}");
    for both in spreads.chunks_exact(2) {
        let [(seen, spread), (unpaired, unviewed)] = [both[0], both[1]];
        assert!(unpaired < 0.5 && unviewed > 0.5, "{spreads:?}");
        assert!(seen > 0.75 && spread < 0.75 * unviewed, "{spreads:?}");
    }
    let (seen, spread) = spreads[4];
    assert!(seen > 0.99 && spread < 0.1, "from afar: {spreads:?}");
}

/// Receivers at a known distance see a little less of a lamp than those infinitely far away: the light that its points
/// send spreads less if the views take the distance into account.
#[kernel_test("PENUMBRA_DEVICE")]
fn views_are_for_the_distance_of_the_receivers(gpu: &Gpu) {
    let scene = scene(&[(sphere(DVec3::ZERO, 0.1, 12), false)], &[]);
    let specialisation = features(gpu, &scene);
    // Ten radii away, which is the middle of the way to the other end of the bounds.
    let place = || Place::new(DVec3::new(0.6, -0.64, 0.48), DVec3::Z, 0);
    let receivers = ReceiverBounds { centre: Vec3::ZERO, radius: 2.0 };
    let spread = |receivers| {
        let lights = gpu_scene(gpu, &scene, receivers);
        let (seen, spread) = visible_and_spread(gpu, (&specialisation, &lights), place());
        // Points that are not seen spread most.
        ((spread * spread + 1.0) / seen - 1.0).sqrt()
    };
    let (known, unknown) = (spread(Some(receivers)), spread(None));
    println!("spread {known:.3} where the distance is known, else {unknown:.3}");
    assert!(known < 0.7 * unknown, "{known} {unknown}");
}

/// Many lamps share the memory of the views: each has fewer of them, and its points still bring about the same.
#[kernel_test("PENUMBRA_DEVICE")]
fn many_lamps_share_room(gpu: &Gpu) {
    let lamps = |count: u32| -> Vec<_> {
        (0..count).map(|i| (sphere(DVec3::new(f64::from(i), 0.0, 0.0), 0.1, 12), false)).collect()
    };
    let bytes = |count| gpu_scene(gpu, &scene(&lamps(count), &[]), None).bytes;
    let scene = scene(&lamps(40), &[]);
    let lights = gpu_scene(gpu, &scene, None);
    // A ninth of the views, and all of the triangles.
    println!("bytes of one lamp {}, of 40 {}", bytes(1), lights.bytes);
    assert!(lights.bytes < 40 * bytes(1) / 8, "{} {}", bytes(1), lights.bytes);
    let place = Place::new(DVec3::new(39.0, 2.0, 3.4), DVec3::Z, 39);
    let (seen, spread) = visible_and_spread(gpu, (&features(gpu, &scene), &lights), place);
    assert!(seen > 0.97 && spread < 0.2, "{seen} {spread}");
}

/// Where all positions are far from a convex lamp, the code for that alone samples the same points. Near the lamp it
/// does not.
#[kernel_test("PENUMBRA_DEVICE")]
fn far_positions_sample_the_same_points(gpu: &Gpu) {
    const N: usize = 1 << 8;
    let scene = scene(&[(sphere(DVec3::ZERO, 0.1, 12), false)], &[]);
    let mut random = Random(19);
    for (distance, far) in [(0.15, false), (0.201, true), (0.5, true), (4.0, true)] {
        let place = [Place::new(random.direction() * distance, DVec3::Z, 0)];
        let listed =
            |features: &Features| run_with(gpu, (features, &gpu_scene(gpu, &scene, None)), "listed", &place, N, 2, 0);
        let general = listed(&features(gpu, &scene));
        let special = listed(&features(gpu, &scene).with(Feature::FarEmitters, true));
        assert_eq!(general == special, far, "at {distance}");
    }
}

/// Points within each light, near it and far from it.
fn points_around(scene: &Scene) -> Vec<Place> {
    let mut random = Random(31);
    let mut places = Vec::new();
    for light in 0..scene.lights.len() {
        let (triangles, _) = triangles_of(scene, light);
        let corners = || triangles.iter().flatten();
        let centre = corners().sum::<DVec3>() / corners().count() as f64;
        let radius = corners().map(|c| c.distance(centre)).fold(0.0, f64::max);
        for radii in [0.1, 0.5, 1.0, 1.5, 3.0, 10.0] {
            places.push(Place::new(centre + random.direction() * (radii * radius), DVec3::Z, light));
        }
    }
    places
}

/// The density for a ray that hits a triangle, by solid angle, is the triangle's probability over its solid angle, and
/// 0 for a triangle that emits nothing. Near a light of few triangles their probabilities are in proportion to their
/// solid angles, so that the density is one over the solid angle of the light.
#[kernel_test("PENUMBRA_DEVICE")]
fn densities_are_those_of_the_sampler(gpu: &Gpu) {
    let scene = mesh_scene();
    let gpu_scene = gpu_scene(gpu, &scene, None);
    let mut queries = Vec::new();
    for place in points_around(&scene) {
        let LightKind::Mesh { emitters, .. } = &scene.lights[place.light].kind else { unreachable!() };
        for emitter in emitters.iter().take(12) {
            queries.push(Place { normal: Vec3::new(emitter.triangle as f32, 0.0, 0.0), ..place });
        }
        queries.push(Place { normal: Vec3::ZERO, ..place });
    }
    // Without pairs: the next test compares them with the sampler.
    let unpaired = features(gpu, &scene).with(Feature::EmitterPairs, false);
    let got = run_with(gpu, (&unpaired, &gpu_scene), "densities", &queries, queries.len(), 1, 0);
    let (mut near, mut far, mut wrong) = (0, 0, 0);
    for (query, got) in queries.iter().zip(&got) {
        let triangle = query.normal.x as usize;
        let pdf = f64::from(got[0]);
        if scene.triangles[triangle].light == NO_LIGHT {
            assert_eq!(pdf, 0.0);
            continue;
        }
        assert_eq!(got[1] as usize, query.light);
        let (triangles, two_sided) = triangles_of(&scene, query.light);
        let position = query.position.as_dvec3();
        let own = scene.triangle_positions(triangle).map(|v| v.as_dvec3());
        let height = height_over(&own, position);
        // This close to the plane, rounding decides the side and changes the angle.
        if height.abs() < 1e-3 {
            continue;
        }
        let info = &gpu_scene.lights[query.light];
        let close = position.distance(info.centre.as_dvec3()) < 2.0 * f64::from(info.radius);
        let all = triangles.len() <= 4 || (close && triangles.len() < 16);
        let facing = two_sided || height > 0.0;
        // Radiance is the same over each light: power is area.
        let area = |t: &Corners| (t[1] - t[0]).cross(t[2] - t[0]).length() / 2.0;
        let share = area(&own) / triangles.iter().map(area).sum::<f64>();
        let expected = match all {
            // No ray from there hits the front of a triangle that faces away.
            _ if !facing => continue,
            true => 1.0 / solid_angle(&triangles, two_sided, position),
            false => share / solid_angle(&[own], two_sided, position),
        };
        // Probabilities are differences of f32 below 1: of 512 triangles each is off by 2^-24 * 512. Solid angles have
        // the error that the test of sampling states, and more where the point lies almost in the light's plane.
        let sure = triangles.iter().all(|t| height_over(t, position).abs() > 1e-3);
        if sure || !all {
            assert!((pdf - expected).abs() <= 2e-4 * expected, "{query:?}: {pdf} {expected}");
        }
        near += usize::from(all);
        far += usize::from(!all);
        wrong += usize::from((pdf - share / solid_angle(&[own], two_sided, position)).abs() > 0.1 * pdf);
    }
    // Guards: triangles are sampled both ways, and the two differ.
    assert!(near > 20 && far > 100 && wrong > 20, "{near} {far} {wrong}");
}

/// A sampled light point and a ray that hits the light there have the same density, emitter pairs included.
#[kernel_test("PENUMBRA_DEVICE")]
fn rays_have_the_density_of_light_points(gpu: &Gpu) {
    const SAMPLES: usize = 64;
    let scene = mesh_scene();
    let mut compared = 0;
    for place in points_around(&scene) {
        let (triangles, _) = triangles_of(&scene, place.light);
        let LightKind::Mesh { emitters, .. } = &scene.lights[place.light].kind else { unreachable!() };
        let got = run(gpu, &scene, "listed", &[place], SAMPLES, 2, 0);
        let mut queries = Vec::new();
        for s in got.chunks_exact(2).filter(|s| s[0][3] > 0.0) {
            let direction = DVec3::new(s[0][0].into(), s[0][1].into(), s[0][2].into());
            // Triangles that the ray hits well inside their edges, at the sample's distance.
            let mut met = (0..triangles.len()).filter(|&i| {
                let t = triangles[i].map(|v| v - place.position.as_dvec3());
                let volumes = [(0, 1), (1, 2), (2, 0)].map(|(i, j)| t[i].cross(t[j]).dot(direction));
                let sum: f64 = volumes.iter().sum();
                let at = t[0].cross(t[1]).dot(t[2]) / sum;
                volumes.iter().all(|v| v / sum > 1e-3) && (at / f64::from(s[1][3]) - 1.0).abs() < 1e-3
            });
            if let (Some(i), None) = (met.next(), met.next()) {
                let triangle = Vec3::new(emitters[i].triangle as f32, 0.0, 0.0);
                queries.push((Place { normal: triangle, ..place }, s[0][3]));
            }
        }
        if queries.is_empty() {
            continue;
        }
        let places: Vec<Place> = queries.iter().map(|q| q.0).collect();
        let densities = run(gpu, &scene, "densities", &places, places.len(), 1, 0);
        for ((place, pdf), density) in queries.iter().zip(&densities) {
            // The same sums, compiled twice.
            assert!((pdf - density[0]).abs() <= 1e-5 * pdf, "{place:?}: {pdf} and {}", density[0]);
            compared += 1;
        }
    }
    // A guard: many sampled points are compared.
    assert!(compared > 1500, "{compared}");
}

/// All sampled points of a square, and of a nearby cube, contribute the same: 1 / pdf is the solid angle of the light.
/// A distant cube is sampled by power, and the contributions of its points differ.
#[kernel_test("PENUMBRA_DEVICE")]
fn points_of_few_triangles_bring_the_same_light(gpu: &Gpu) {
    const N: usize = 1 << 10;
    let lamp = square(DVec3::ZERO, DVec3::X * 0.5, DVec3::Z * 0.5);
    let scene = scene(&[(lamp, true), (cube(DVec3::ZERO, 0.3), false)], &[]);
    for (light, position, same) in [
        (0, DVec3::new(0.1, 1e-3, 0.3), true),
        (0, DVec3::new(0.45, 0.05, -0.45), true),
        (0, DVec3::new(0.2, 0.6, 0.3), true),
        (0, DVec3::new(2.0, 0.5, 1.0), true),
        (1, DVec3::new(0.35, 0.4, 0.2), true),
        (1, DVec3::new(0.301, 0.1, 0.2), true),
        (1, DVec3::new(2.0, 0.5, 1.0), false),
    ] {
        let (triangles, two_sided) = triangles_of(&scene, light);
        let exact = solid_angle(&triangles, two_sided, position);
        let got = run(gpu, &scene, "listed", &[Place::new(position, DVec3::Z, light)], N, 2, 0);
        let angles: Vec<f64> = got.chunks_exact(2).map(|s| 1.0 / f64::from(s[0][3])).collect();
        let off = angles.iter().map(|angle| (angle / exact - 1.0).abs()).fold(0.0, f64::max);
        // At a height of a thousandth above the lamp, f32 leaves a relative error of 1e-4 in the height.
        assert_eq!(off < 1e-3, same, "{position}: {off}");
    }
}

/// A mesh light emits photons uniformly over its area and by the cosine law, on both sides if it is two-sided.
#[kernel_test("PENUMBRA_DEVICE")]
fn emission_follows_power_and_cosine(gpu: &Gpu) {
    const N: usize = 1 << 14;
    let scene = mesh_scene();
    let family = 3 * scene.lights.len() as u32;
    for light in 0..scene.lights.len() {
        let (triangles, two_sided) = triangles_of(&scene, light);
        let LightKind::Mesh { emitters, .. } = &scene.lights[light].kind else { unreachable!() };
        let got = run(gpu, &scene, "emitted", &[Place::new(DVec3::ZERO, DVec3::Z, light)], N, 3, 0);
        let areas: Vec<f64> = triangles.iter().map(|t| (t[1] - t[0]).cross(t[2] - t[0]).length() / 2.0).collect();
        let total: f64 = areas.iter().sum();
        // Each triangle in four parts of the same area.
        let mut by_part = vec![0u64; triangles.len() * 4];
        let mut by_cosine = [0u64; 64];
        let mut by_side = [0u64; 2];
        for ray in got.chunks_exact(3) {
            let v = |i: usize| DVec3::new(ray[i][0].into(), ray[i][1].into(), ray[i][2].into());
            let index = emitters.iter().position(|e| e.triangle == ray[0][3] as u32).expect("a triangle of the light");
            let t = &triangles[index];
            by_part[index * 4 + quarter(t, v(0))] += 1;
            let outward = (t[1] - t[0]).cross(t[2] - t[0]).normalize();
            // Three products and sums of coordinates of unit size.
            assert!(height_over(t, v(0)).abs() < 1e-6, "{} is off its triangle", v(0));
            let front = v(2).dot(outward);
            // Lengths of unit vectors in f32, here and below.
            assert!((front.abs() - 1.0).abs() < 1e-6 && (two_sided || front > 0.0));
            by_side[usize::from(front > 0.0)] += 1;
            let cosine = v(1).dot(v(2));
            assert!(cosine >= 0.0 && (v(1).length() - 1.0).abs() < 1e-6);
            // By the cosine law the squared cosine is uniform. Only the half of the azimuth is counted: the sign along
            // an edge.
            let quadrant = usize::from(v(1).dot((t[1] - t[0]).normalize()) > 0.0);
            by_cosine[((cosine * cosine * 32.0) as usize).min(31) * 2 + quadrant] += 1;
        }
        chi_square(&by_cosine, &[N as f64 / 64.0; 64], family).unwrap_or_else(|e| panic!("cosines of {light}: {e}"));
        let expected: Vec<f64> = areas.iter().flat_map(|a| [a / total / 4.0 * N as f64; 4]).collect();
        chi_square(&by_part, &expected, family).unwrap_or_else(|e| panic!("triangles of {light}: {e}"));
        let halves = if two_sided { [N as f64 / 2.0; 2] } else { [0.0, N as f64] };
        let spread = (N as f64 / 4.0).sqrt();
        // Four standard deviations of a binomial.
        assert!((by_side[0] as f64 - halves[0]).abs() < 4.0 * spread, "{by_side:?}");
    }
}

/// The quarter of the triangle's area that contains the point. The quarters are divided by the median through the first
/// corner, and by the parallel to the opposite edge that halves the area.
fn quarter(t: &Corners, p: DVec3) -> usize {
    let across = (t[1] - t[0]).cross(t[2] - t[0]);
    let second = (p - t[0]).cross(t[2] - t[0]).dot(across) / across.length_squared();
    let third = (t[1] - t[0]).cross(p - t[0]).dot(across) / across.length_squared();
    usize::from((second + third).powi(2) > 0.5) * 2 + usize::from(second > third)
}

/// Point, spot and directional lights have the irradiance that KHR_lights_punctual states (inverse squares, ranges and
/// cones), and their photons the same distribution.
#[kernel_test("PENUMBRA_DEVICE")]
fn punctual_lights_follow_the_extension(gpu: &Gpu) {
    const N: usize = 1 << 14;
    let (position, direction) = (Vec3::new(0.2, 0.5, -0.1), Vec3::new(0.6, -0.8, 0.0));
    let (cos_inner, cos_outer) = (0.9f32, 0.7f32);
    let kinds = [
        LightKind::Point { position, intensity: RADIANCE, range: f32::INFINITY },
        LightKind::Point { position, intensity: RADIANCE, range: 0.8 },
        LightKind::Spot { position, direction, intensity: RADIANCE, cos_inner, cos_outer, range: f32::INFINITY },
        LightKind::Directional { direction, irradiance: RADIANCE },
    ];
    let scene = scene(&[], &kinds);
    let mut random = Random(21);
    let places: Vec<Place> =
        (0..2000).map(|i| Place::new(random.point(), random.direction(), i % kinds.len())).collect();
    let closed = run(gpu, &scene, "closed", &places, places.len(), 1, 0);
    let sampled = run(gpu, &scene, "sampled", &places, places.len(), 1, 2);
    let (mut lit, mut dark) = ([0; 4], [0; 4]);
    for ((place, closed), sampled) in places.iter().zip(&closed).zip(&sampled) {
        let d = position.as_dvec3() - place.position.as_dvec3();
        let (mut towards, mut arriving) = (d.normalize(), 1.0 / d.length_squared());
        match place.light {
            1 => arriving *= (1.0 - (d.length() / f64::from(0.8f32)).powi(4)).clamp(0.0, 1.0),
            2 => {
                let c = direction.as_dvec3().dot(-towards);
                let (inner, outer) = (f64::from(cos_inner), f64::from(cos_outer));
                arriving *= ((c - outer) / (inner - outer)).clamp(0.0, 1.0).powi(2);
            }
            3 => (towards, arriving) = (-direction.as_dvec3(), 1.0),
            _ => (),
        }
        let expected = arriving * towards.dot(place.normal.as_dvec3()).max(0.0);
        for got in [closed, sampled] {
            // Range and cone subtract numbers of size 1: a few roundings relative to the difference.
            assert!((f64::from(got[0]) - expected).abs() <= 2e-5 * arriving + 1e-6, "{place:?}: {} {expected}", got[0]);
        }
        let bits = closed[3] as u32;
        assert_eq!(bits & 2, 2, "punctual lights have a closed form");
        // Nearer to the horizon, to the range or to the cone, rounding decides.
        if expected > 1e-5 {
            assert_eq!(bits & 1, 0, "{place:?}");
            lit[place.light] += 1;
        } else if expected == 0.0 && (towards.dot(place.normal.as_dvec3()) < -1e-5 || arriving == 0.0) {
            assert_eq!(bits & 1, 1, "{place:?}");
            dark[place.light] += 1;
        }
    }
    // A guard: each light is seen and dark at some places.
    assert!(lit.iter().chain(&dark).all(|n| *n > 20), "{lit:?} {dark:?}");

    for light in 0..4 {
        let got = run(gpu, &scene, "emitted", &[Place::new(DVec3::ZERO, DVec3::Z, light)], N, 3, 0);
        let mut cells = [0u64; 64];
        for ray in got.chunks_exact(3) {
            let v = |i: usize| DVec3::new(ray[i][0].into(), ray[i][1].into(), ray[i][2].into());
            let axis = direction.as_dvec3();
            let side = axis.cross(DVec3::Z).normalize();
            let azimuth = |p: DVec3| (p.dot(axis.cross(side)).atan2(p.dot(side)) / TAU).rem_euclid(1.0);
            // Coordinates in which the expected distribution is uniform.
            let (a, b) = match light {
                0 | 1 => ((1.0 - v(1).dot(axis)) / 2.0, azimuth(v(1))),
                2 => ((1.0 - v(1).dot(axis)) / (1.0 - f64::from(cos_outer)), azimuth(v(1))),
                _ => {
                    // The scene is one triangle; its bounding sphere is about the middle of its box.
                    let centre = DVec3::new(0.0, -1.0, 0.0);
                    let from_axis = v(0) - centre - axis * axis.dot(v(0) - centre);
                    assert!(axis.dot(v(0) - centre) < -2f64.sqrt(), "starts before the scene");
                    // Roundings of a unit vector in f32.
                    assert!(v(1).distance(axis) < 1e-6);
                    ((from_axis.length() / (2f64.sqrt() * 1.001)).powi(2), azimuth(from_axis))
                }
            };
            // A few roundings of f32, over a height of the cone of 0.3 at least.
            assert!((-1e-5..1.0 + 1e-5).contains(&a), "light {light}: {a}");
            cells[((a * 8.0) as usize).min(7) * 8 + ((b * 8.0) as usize).min(7)] += 1;
            if light < 3 {
                assert_eq!(v(0), position.as_dvec3());
            }
        }
        chi_square(&cells, &[N as f64 / 64.0; 64], 4).unwrap_or_else(|e| panic!("light {light}: {e}"));
    }
}

/// Kernels compose for every set of kinds of lights, and have no code for a kind that is not in the set.
#[test]
fn every_set_of_kinds_composes() {
    let kinds = [
        Feature::MeshLights,
        Feature::PointLights,
        Feature::SpotLights,
        Feature::DirectionalLights,
        Feature::TextureLoads,
    ];
    for set in 0..32u32 {
        let features =
            kinds.iter().enumerate().fold(Features::default(), |f, (i, kind)| f.with(*kind, set >> i & 1 == 1));
        let composed = compose_source("light", include_str!("shaders/light.wgsl"), &features).unwrap();
        let has = |name: &str| composed.module.functions.iter().any(|(_, f)| f.name.as_deref() == Some(name));
        assert_eq!(has("mesh_form_factor"), features.has(Feature::MeshLights));
        assert_eq!(has("punctual_at"), set & 0b1110 != 0);
        let table = composed.module.global_variables.iter().any(|(_, v)| v.name.as_deref() == Some("emitter_texels"));
        assert_eq!(table, features.has(Feature::MeshLights));
    }
    for set in 0..8u32 {
        let kinds = [Feature::Textures, Feature::AlphaTest, Feature::TextureLoads];
        let features =
            kinds.iter().enumerate().fold(Features::default(), |f, (i, kind)| f.with(*kind, set >> i & 1 == 1));
        let features = features.with(Feature::MeshLights, true).with(Feature::EmissiveTextures, set & 1 == 1);
        let features = features.with(Feature::EmissiveAlpha, set & 2 == 2);
        for kernel in ["path", "shadow"] {
            compose(kernel, &features).unwrap();
        }
    }
    // Highlights are for renders without irradiance records.
    let all = Features::all().with(Feature::Highlights, false);
    // Packets and shallow BVHs have no instances.
    compose("path", &all.clone().with(Feature::Instances, false)).unwrap();
    let single = all.with(Feature::Packets, false).with(Feature::ShallowBvh, false);
    compose("path", &single).unwrap();
}
