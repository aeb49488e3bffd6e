//! Rounding errors of the kernels that matter for an image: f32 arithmetic against double precision on the same random
//! and adversarial input. `cargo bench --bench precision` prints the table of `docs/stability.md`.

use std::f64::consts::PI;

use glam::{DVec3, Vec3};
use kernel_kit::{Gpu, Resources, kernel_test};
use penumbra::internal::kernels::compose_source;
use penumbra::internal::passes::Tile;
use penumbra::internal::passes::film::{Film, Inputs};
use penumbra::internal::scene::Scene;
use penumbra::internal::specialisation::features::Feature;
use penumbra::internal::statistics::Counter;

use crate::kit::{device_features, new_kernel};
use crate::light::{self, Corners, Place, square};
use crate::random::{Random, RandomInput as _};
use crate::{cache, irradiance};

/// One unit in the last place (ulp) of numbers from 1 to 2. Errors are in ulp of the scale that a row names.
const ULP: f64 = 1.0 / (1 << 23) as f64;

/// Errors of a kernel over a family of input.
pub struct Row {
    pub kernel: &'static str,
    pub family: String,
    /// What the errors are relative to.
    pub scale: &'static str,
    /// In ulp, sorted.
    pub errors: Vec<f64>,
    /// Maximum error allowed, in ulp.
    pub bound: f64,
}

impl Row {
    fn new(kernel: &'static str, family: impl Into<String>, scale: &'static str, bound: f64, errors: Vec<f64>) -> Row {
        let mut errors: Vec<f64> = errors.into_iter().map(|error| error / ULP).collect();
        errors.sort_by(f64::total_cmp);
        Row { kernel, family: family.into(), scale, errors, bound }
    }

    /// The quantile of the errors at the given share.
    pub fn quantile(&self, share: f64) -> f64 {
        self.errors[((self.errors.len() - 1) as f64 * share) as usize]
    }
}

/// All rows.
pub fn rows(gpu: &Gpu) -> Vec<Row> {
    [intersection(gpu), angles(gpu), closed_form(gpu), photons_and_records(gpu), film(gpu)]
        .into_iter()
        .flatten()
        .collect()
}

// ---- Intersection and offset

/// A ray and a triangle that it hits.
type Meeting = [Vec3; 5];

fn run(gpu: &Gpu, entry: &str, items: &[Meeting], needles: bool) -> Vec<[[f32; 4]; 3]> {
    let source = include_str!("shaders/precision.wgsl");
    let features = device_features(gpu).with(Feature::Needles, needles);
    let composed = compose_source("precision", source, &features).unwrap();
    let kernel = new_kernel(gpu, &composed, &[("count", items.len() as f64)], &["items", "results"]).unwrap();
    let words: Vec<[f32; 4]> = items.iter().flatten().map(|v| v.extend(0.0).to_array()).collect();
    let items_buffer = gpu.upload("test/items", &words).unwrap();
    let results = gpu.poisoned::<[[f32; 4]; 3]>("test/results", items.len()).unwrap();
    let own = Resources::new().with("items", &items_buffer).with("results", &results);
    let bound = kernel.bind(gpu, entry, &[&own]).unwrap();
    let mut frame = gpu.frame("test");
    frame.run(&bound, items.len() as u32, &[0u32; 0]);
    frame.submit().unwrap();
    gpu.read(&results, items.len()).unwrap()
}

/// Whether the device's fma rounds once.
pub fn fma_is_fused(gpu: &Gpu) -> bool {
    let x = Vec3::new(1.0 + f32::EPSILON, 1.0 - f32::EPSILON, 0.0);
    run(gpu, "fused", &[[x; 5]], false)[0][0][0] != 0.0
}

/// Rays towards a point inside triangles with edges of about `size` and a height of `size / aspect`, at the given
/// cosine to the normal.
fn meetings(size: f64, aspect: f64, cosine: f64) -> Vec<Meeting> {
    let mut random = Random(31);
    (0..20_000)
        .map(|_| {
            let normal = random.direction();
            let (s, t) = normal.any_orthonormal_pair();
            let centre = random.point() * 0.5;
            let flat = [(-1.0, -0.6), (1.0, -0.5), (0.1, 1.0)];
            let corners = flat.map(|(x, y)| (centre + size * (x * s + y / aspect * t)).as_vec3());
            let (u, v) = (0.05 + 0.45 * random.uniform(), 0.05 + 0.45 * random.uniform());
            let [a, b, c] = corners.map(|corner| corner.as_dvec3());
            let met = a + u * (b - a) + v * (c - a);
            let angle = 2.0 * PI * random.uniform();
            let towards = cosine * normal + (1.0 - cosine * cosine).sqrt() * (angle.cos() * s + angle.sin() * t);
            let origin = (met + towards * (0.3 + random.uniform())).as_vec3();
            let direction = (met - origin.as_dvec3()).normalize().as_vec3();
            [origin, direction, corners[0], corners[1], corners[2]]
        })
        .collect()
}

fn intersection(gpu: &Gpu) -> Vec<Row> {
    let families = [
        // Eight half-units across the ray, as in tests/kernels/traverse.rs, and three more for the sum. The edge
        // functions of a sliver are as large as those of a wide triangle, and round accordingly. Where products are not
        // fused, this error over the sliver's height moves t along it. The point given by u and v stays on its plane.
        ("triangles of unit size", 1.0, 1.0, 0.7, 6.0, false),
        ("of size 1e-3", 1e-3, 1.0, 0.7, 6.0, false),
        ("slivers, 1 to 1e3", 1.0, 1e3, 0.7, 500.0, false),
        // In scenes with needles, t is corrected along their planes. The remaining error is that of any triangle, until
        // the squares of the weights' errors exceed it.
        ("slivers, 1 to 1e3, as needles", 1.0, 1e3, 0.7, 6.0, true),
        ("slivers, 1 to 1e4, as needles", 1.0, 1e4, 0.7, 6.0, true),
        ("slivers, 1 to 1e5, as needles", 1.0, 1e5, 0.7, 100.0, true),
        ("grazing, cosine 1e-2", 1.0, 1.0, 1e-2, 6.0, false),
    ];
    let mut rows = Vec::new();
    for (family, size, aspect, cosine, bound, needles) in families {
        let items = meetings(size, aspect, cosine);
        let results = run(gpu, "intersect", &items, needles);
        let (mut distances, mut weights, mut planes, mut heights) = (vec![], vec![], vec![], vec![]);
        for (item, [hit, point, leaving]) in items.iter().zip(&results) {
            let [o, d, a, b, c] = item.map(|v| v.as_dvec3());
            let of = |v: &[f32; 4]| DVec3::new(v[0].into(), v[1].into(), v[2].into());
            let across = (b - a).cross(c - a);
            let normal = across.normalize();
            let t = normal.dot(a - o) / normal.dot(d);
            // A coordinate relative to the origin is off by half an ulp of itself. So is the plane, and t by as much
            // along the ray.
            let reach = [a, b, c].map(|corner| corner.distance(o)).into_iter().fold(0.0, f64::max);
            let along = reach / normal.dot(d).abs();
            assert!(hit[0] < 1e30, "{family}: a ray that meets the triangle well inside misses it");
            distances.push((f64::from(hit[0]) - t).abs() / along);
            // The barycentric coordinates are off by that over the triangle's height across the ray.
            let met = o + t * d - a;
            let exact = [met.cross(c - a), (b - a).cross(met)].map(|v| v.dot(across) / across.length_squared());
            let widest = [b - a, c - b, a - c].map(|edge| edge.reject_from(d).length()).into_iter().fold(0.0, f64::max);
            let height = across.dot(d).abs() / widest;
            let off = (0..2).map(|i| (f64::from(hit[i + 1]) - exact[i]).abs()).fold(0.0, f64::max);
            weights.push(off * height / reach);
            let largest = a.abs().max(b.abs()).max(c.abs()).max_element();
            planes.push(normal.dot(of(point) - a).abs() / largest);
            // Distance of the origin from the plane, over an ulp of the point's largest coordinate; positive on the
            // ray's side.
            let side = -normal.dot(d).signum() * normal;
            heights.push(side.dot(of(leaving) - a) / of(point).abs().max_element().max(1.0 / 32.0));
        }
        rows.push(Row::new("intersection", format!("t, {family}"), "farthest corner / cosine", bound, distances));
        rows.push(Row::new("intersection", format!("u and v, {family}"), "farthest corner / height", 6.0, weights));
        // Three products and sums for each coordinate.
        rows.push(Row::new("hit point", format!("off its plane, {family}"), "largest coordinate", 2.0, planes));
        // Here the smallest height counts. It is reported negative, so that it is the largest.
        let lost = heights.iter().map(|height| -height).collect();
        // A coordinate of 1/32 moves by 256 of its units, which are 8 of one near 1. Smaller ones move farther.
        rows.push(Row::new("offset", format!("-height of the origin, {family}"), "largest coordinate", -8.0, lost));
    }
    rows
}

// ---- Angles

/// Bounds hold on any Vulkan device: sums and products may be rounded towards 0, a division may be 2.5 ulp off, and
/// the device's own sine and arc tangent, which may be 4096 ulp off, are not used.
fn angles(gpu: &Gpu) -> Vec<Row> {
    let mut random = Random(7);
    // Around and beyond the circle, with all eighths of it, and down to tiny angles.
    let around = (0..=32).map(|i| f64::from(i) / 8.0 - 2.0);
    let around: Vec<f64> = around.chain((0..20_000).map(|_| 4.0 * random.uniform() - 2.0)).collect();
    let small: Vec<f64> = (0..20_000).map(|_| 0.25 * 10f64.powf(-30.0 * random.uniform())).collect();
    let points = |turns: &[f64]| -> Vec<[f64; 3]> {
        let items: Vec<Meeting> = turns.iter().map(|t| [Vec3::new(*t as f32, 1.0, 1.0); 5]).collect();
        let results = run(gpu, "angles", &items, false);
        let point = |(item, [found, ..]): (&Meeting, &[[f32; 4]; 3])| {
            [2.0 * PI * f64::from(item[0].x), found[0].into(), found[1].into()]
        };
        items.iter().zip(&results).map(point).collect()
    };
    let around = points(&around);
    let off = around.iter().map(|[angle, x, y]| (x - angle.cos()).abs().max((y - angle.sin()).abs()));
    let long = around.iter().map(|[_, x, y]| (x.hypot(*y) - 1.0).abs());
    let fine = points(&small).into_iter().map(|[angle, _, y]| (y / angle.sin() - 1.0).abs());
    let directions: Vec<Meeting> = (0..20_000)
        .map(|_| {
            let angle = PI * random.uniform() * if random.uniform() < 0.5 { 1.0 } else { 1e-6 };
            [Vec3::new(0.0, angle.sin() as f32, angle.cos() as f32); 5]
        })
        .collect();
    let turned = run(gpu, "angles", &directions, false)
        .into_iter()
        .zip(&directions)
        .map(|([found, ..], [v, ..])| (f64::from(found[2]) / f64::from(v.y).atan2(f64::from(v.z)) - 1.0).abs());
    vec![
        // The polynomial's last sum and its product with the angle, 2; its other terms, which are at most half as
        // large, 2.3; rounded coefficients, 0.5; the angle's distance from a quarter turn, 0.5.
        Row::new("angle", "point of the unit circle", "radius", 6.0, off.collect()),
        Row::new("angle", "its distance from the centre", "radius", 6.0, long.collect()),
        Row::new("angle", "sine down to 1e-30", "sine", 6.0, fine.collect()),
        // A quotient of two sums, 4.5; the polynomial's terms, 0.5; the sums with eighths of the circle, 3.
        Row::new("angle", "of a vector", "angle", 8.0, turned.collect()),
    ]
}

// ---- Closed form

/// The irradiance over the radiance of a light that faces the position: Lambert's formula by arc tangents, which stay
/// precise where angles are small.
fn lambert(triangles: &[Corners], position: DVec3, normal: DVec3) -> f64 {
    let mut sum = 0.0;
    for t in triangles.iter().filter(|t| light::height_over(t, position) > 0.0) {
        let polygon = light::clipped(&t.map(|v| v - position), normal);
        let terms = polygon.iter().enumerate().map(|(i, a)| {
            let b = polygon[(i + 1) % polygon.len()];
            let across = a.cross(b - a);
            let sine = across.length();
            if sine == 0.0 { 0.0 } else { sine.atan2(a.dot(b)) * across.dot(normal) / sine }
        });
        sum -= terms.sum::<f64>() / 2.0;
    }
    sum
}

/// Lights, and receiving points, of a family.
struct Lit {
    family: &'static str,
    scale: &'static str,
    bound: f64,
    light: Vec<Corners>,
    receiver: fn(&mut Random, &[Corners]) -> (DVec3, DVec3),
}

/// A point of a square light, and its normal.
fn on_light(random: &mut Random, light: &[Corners]) -> (DVec3, DVec3) {
    let [a, b, c] = light[0];
    let d = a + (c - b);
    let (u, v) = (random.uniform(), random.uniform());
    (a + u * (b - a) + v * (d - a), (b - a).cross(c - a).normalize())
}

/// A point in front of the light at that distance, facing roughly towards it.
fn before(random: &mut Random, light: &[Corners], distance: f64) -> (DVec3, DVec3) {
    let (point, normal) = on_light(random, light);
    (point + normal * distance, (-normal + 0.5 * random.point()).normalize())
}

/// A point away from the light in any direction in which it emits.
fn afar(random: &mut Random, light: &[Corners]) -> (DVec3, DVec3) {
    let (point, normal) = on_light(random, light);
    let way = (normal + random.direction()).normalize();
    let way = if way.dot(normal) > 0.2 { way } else { normal };
    (point + way * (0.5 + random.uniform()), (-way + 0.7 * random.direction()).normalize())
}

fn families() -> Vec<Lit> {
    let (x, y, z) = (DVec3::X, DVec3::Y, DVec3::Z);
    let about = |size: f64| {
        let tilted = DVec3::new(0.3, 0.8, -0.2).normalize();
        let across = tilted.cross(x).normalize();
        square(0.1 * x + 0.3 * y, tilted * 0.5 * size, across * 0.5 * size)
    };
    // Far from the light's plane the terms have similar size: a dozen roundings for each of four edges. Near the plane
    // an edge may be in line with the position, whose distance from the edge's line is rounded as the vertices are:
    // 2e-5 at most.
    let of = |family, bound, size, receiver| Lit { family, scale: "irradiance", bound, light: about(size), receiver };
    vec![
        of("light of size 1", 40.0, 1.0, afar),
        of("light of size 1e-1", 40.0, 1e-1, afar),
        of("light of size 1e-2", 40.0, 1e-2, afar),
        of("light of size 1e-3", 40.0, 1e-3, afar),
        of("light of size 1e-4", 40.0, 1e-4, afar),
        of("light of size 1e-5", 40.0, 1e-5, afar),
        of("at 1e-2 of the light", 200.0, 1.0, |r, l| before(r, l, 1e-2)),
        of("at 1e-3", 200.0, 1.0, |r, l| before(r, l, 1e-3)),
        of("at 1e-4", 200.0, 1.0, |r, l| before(r, l, 1e-4)),
        Lit {
            family: "horizon across the light",
            // An arbitrarily small part of the light may be above the horizon, so a relative error has no bound.
            scale: "irradiance of the whole light, facing it",
            bound: 40.0,
            light: square(0.9 * y, 0.3 * x, 0.4 * z),
            receiver: |random, light| {
                let (position, _) = afar(random, light);
                let to = (on_light(random, light).0 - position).normalize();
                (position, to.cross(random.direction()).normalize())
            },
        },
    ]
}

fn closed_form(gpu: &Gpu) -> Vec<Row> {
    let families = families();
    let scene: Scene = light::scene(&families.iter().map(|f| (f.light.clone(), false)).collect::<Vec<_>>(), &[]);
    let mut random = Random(17);
    let mut points = Vec::new();
    for (i, family) in families.iter().enumerate() {
        for _ in 0..4000 {
            let (position, normal) = (family.receiver)(&mut random, &family.light);
            points.push(Place::new(position, normal, i));
        }
    }
    let got = light::run(gpu, &scene, "closed", &points, points.len(), 1, 0);
    families
        .iter()
        .enumerate()
        .map(|(i, family)| {
            let (triangles, _) = light::triangles_of(&scene, i);
            let errors = points.iter().zip(&got).filter(|(point, _)| point.light == i).map(|(point, got)| {
                let (position, normal) = (point.position.as_dvec3(), point.normal.as_dvec3());
                let exact = lambert(&triangles, position, normal);
                let scale = match family.scale {
                    "irradiance" => exact,
                    _ => lambert(&triangles, position, (on_light(&mut Random(1), &triangles).0 - position).normalize()),
                };
                (f64::from(got[0]) - exact).abs() / scale
            });
            Row::new("closed form", family.family, family.scale, family.bound, errors.collect())
        })
        .collect()
}

// ---- Density estimate and interpolation

fn photons_and_records(gpu: &Gpu) -> Vec<Row> {
    vec![
        // Sums of flux are integers: only a square, two products and two quotients are rounded.
        Row::new("density estimate", "open floor, 20,000 photons", "irradiance", 6.0, irradiance::rounding(gpu)),
        // The record's weight contains the length of the normals' difference, whose terms cancel where they agree to
        // 1e-3.
        Row::new(
            "interpolation",
            "500 records of all radii",
            "light, coordinates over the smallest radius",
            40.0,
            cache::rounding(gpu),
        ),
    ]
}

// ---- Film

fn film(gpu: &Gpu) -> Vec<Row> {
    const PIXELS: usize = 64;
    const SAMPLES: usize = 65_536;
    let mut random = Random(5);
    let mut sample = || [random.uniform() as f32, 10f64.powf(8.0 * random.uniform() - 4.0) as f32, 0.1, 1.0];
    let samples: Vec<[f32; 4]> = (0..PIXELS * SAMPLES).map(|_| sample()).collect();
    let buffer = gpu.upload("test/samples", &samples).unwrap();
    let counters = gpu.buffer::<u32>("test/counters", Counter::COUNT).unwrap();
    let pass = Film::new(gpu, &device_features(gpu)).unwrap();
    let plane = pass.plane(gpu, PIXELS as u32, &buffer, Inputs { counters: &counters, sampled_pixels: None }).unwrap();
    // No invocation takes more iterations than a software device allows.
    const BATCH: u32 = 1 << 14;
    for batch in 0..SAMPLES as u32 / BATCH {
        let tile = Tile { pixel_count: PIXELS as u32, samples_per_pixel: BATCH, ..Tile::default() };
        let mut frame = gpu.frame("test");
        plane.record_from(&mut frame, &tile, batch * PIXELS as u32 * BATCH);
        frame.submit().unwrap();
    }
    let got = plane.means(gpu, &|_| SAMPLES as u32).unwrap();
    let names = ["uniform samples", "samples over eight decades", "0.1 each"];
    (0..3)
        .map(|c| {
            let errors = (0..PIXELS).map(|pixel| {
                let of_pixel = samples.chunks(BATCH as usize).skip(pixel).step_by(PIXELS).flatten();
                let exact = of_pixel.map(|s| f64::from(s[c])).sum::<f64>();
                (got[pixel][c] / (exact / SAMPLES as f64) - 1.0).abs()
            });
            // The sum of value and compensation is taken in f64.
            Row::new("film", format!("65,536 of {}", names[c]), "mean", 1.0, errors.collect())
        })
        .collect()
}

/// No rounding error exceeds the bound of its row.
#[kernel_test("PENUMBRA_DEVICE")]
fn roundings_are_bounded(gpu: &Gpu) {
    println!("fma is fused: {}", fma_is_fused(gpu));
    for row in rows(gpu) {
        let (high, worst) = (row.quantile(0.999), row.quantile(1.0));
        let half = row.quantile(0.5);
        let Row { kernel, family, scale, bound, .. } = row;
        println!("| {kernel} | {family} | {scale} | {half:.2} | {high:.2} | {worst:.2} | {bound} |");
        assert!(worst <= bound, "{kernel}, {family}: {worst} ulp of the {scale} (99.9 %: {high}), {bound} are allowed");
    }
}
