//! The BSDF against glTF's formulas in f64, reciprocity, energy, and its sampler against its density.

use std::f64::consts::{PI, TAU};

use glam::DVec3;
use penumbra::gpu::{Kernel, Resources, compose};
use penumbra::tables::sobol;

use crate::kit::{device_features, gpu};
use crate::statistics::{Random, chi_square};

/// A surface of one colour, as the kernel gets it.
#[derive(Clone, Copy, Debug)]
struct Tested {
    base: f64,
    roughness: f64,
    metallic: f64,
    view: DVec3,
    /// Angle of the geometric normal to the shading normal, which is +z, in the xz plane.
    tilt: f64,
    glossy: bool,
}

/// Reflectance of glTF's dielectric: index of refraction 1.5.
const DIELECTRIC: f64 = 0.04;

impl Tested {
    fn f0(&self) -> f64 {
        DIELECTRIC + (self.base - DIELECTRIC) * self.metallic
    }

    fn albedo(&self) -> f64 {
        self.base * (1.0 - self.metallic)
    }

    /// glTF 2.0, appendix B, with the dielectric's transmission taken at the lower of the angles to the normal, less of
    /// it grazing where the surface is rough.
    fn value(&self, light: DVec3) -> f64 {
        let schlick = |f0: f64, cosine: f64| f0 + (1.0 - f0) * (1.0 - cosine).powi(5);
        let h = (light + self.view).normalize();
        let alpha = (self.roughness * self.roughness).max(1e-3);
        let (nl, nv, vh) = (light.z, self.view.z, self.view.dot(h));
        // sin^2 of the half vector's angle from its tangent part: 1 - z^2 would cancel.
        let d = alpha * alpha / (PI * (h.x * h.x + h.y * h.y + h.z * h.z * alpha * alpha).powi(2));
        let smith = |a: f64, b: f64| a * (alpha * alpha + (1.0 - alpha * alpha) * b * b).sqrt();
        let visibility = 0.5 / (smith(nl, nv) + smith(nv, nl));
        let grazing = (1.0 - 0.9 * self.roughness.powi(2)).max(DIELECTRIC);
        let through = 1.0 - (DIELECTRIC + (grazing - DIELECTRIC) * (1.0 - nl.min(nv)).powi(5));
        self.albedo() / PI * through + d * visibility * schlick(self.f0(), vh)
    }
}

/// Runs an entry of the test kernel: two vectors for each of `count` items.
fn run(entry: &str, tested: &Tested, directions: &[DVec3], count: usize, stratified: bool) -> Vec<[f32; 4]> {
    let gpu = gpu();
    let source = include_str!("shaders/bsdf.wgsl");
    let composed =
        compose::compose_source("bsdf", source, &device_features(gpu).with("glossy", tested.glossy)).unwrap();
    let constants = [("count", count as f64), ("seed", 4242.0), ("stratified", f64::from(u8::from(stratified)))];
    let kernel = Kernel::new(gpu, &composed, &constants, &[]).unwrap();
    let t = tested;
    let (albedo, f0) = (t.albedo() as f32, t.f0() as f32);
    let view = t.view.as_vec3();
    let surface = [
        [albedo, albedo, albedo, (t.roughness * t.roughness) as f32],
        [f0, f0, f0, 1.0],
        [DIELECTRIC as f32, 1.0, t.tilt.sin() as f32, t.tilt.cos() as f32],
        [0.0, 0.0, 1.0, 0.0],
        [view.x, view.y, view.z, 0.0],
    ];
    let surface = gpu.upload("test/surface", &surface).unwrap();
    let directions: Vec<glam::Vec4> = directions.iter().map(|d| d.as_vec3().extend(0.0)).collect();
    let directions = gpu.upload("test/directions", &directions).unwrap();
    let results = gpu.poisoned::<[f32; 4]>("test/results", count * 2).unwrap();
    let sobol = sobol::upload(gpu).unwrap();
    let sets = Resources::new()
        .with("surface", &surface)
        .with("directions", &directions)
        .with("results", &results)
        .with("sobol_directions", &sobol);
    let bound = kernel.bind(gpu, entry, &[&sets]).unwrap();
    let mut frame = gpu.frame("test");
    frame.run(&bound, count as u32, &[0u32; 0]);
    frame.submit().unwrap();
    let got = gpu.read::<[f32; 4]>(&results, count * 2).unwrap();
    assert!(got.iter().flatten().all(|v| v.is_finite()), "poison or worse in {entry} of {tested:?}");
    got
}

fn view(cosine: f64) -> DVec3 {
    DVec3::new((1.0 - cosine * cosine).sqrt() * 0.8, (1.0 - cosine * cosine).sqrt() * 0.6, cosine)
}

/// Roughness and metallic over their ranges, seen from above and from low down.
fn all_tested(base: f64) -> Vec<Tested> {
    let mut all = Vec::new();
    for roughness in [0.05, 0.2, 0.5, 1.0] {
        for metallic in [0.0, 0.5, 1.0] {
            for cosine in [0.95, 0.25] {
                all.push(Tested { base, roughness, metallic, view: view(cosine), tilt: 0.0, glossy: true });
            }
        }
    }
    all
}

/// Directions all over the upper hemisphere, and near the mirror's.
fn some_directions(tested: &Tested) -> Vec<DVec3> {
    let mut random = Random(5);
    let mirror = DVec3::new(-tested.view.x, -tested.view.y, tested.view.z);
    let all = (0..1000).map(|i| {
        let d = random.direction();
        if i % 2 == 0 { DVec3::new(d.x, d.y, d.z.abs()) } else { (mirror + d * 0.02).normalize() }
    });
    // At grazing angles f32 leaves few digits to a cosine: 1e-7 of 0.02 is 5e-6, which four factors multiply.
    all.filter(|d| d.z > 0.02).collect()
}

/// The value is the formulas', in one piece and in its two parts, and is 0 below the horizon of either normal.
#[test]
fn values_are_those_of_gltf() {
    let (mut worst, mut worst_of_fault) = (0f64, 0f64);
    for tested in all_tested(0.7) {
        let directions = some_directions(&tested);
        let got = run("evaluated", &tested, &directions, directions.len(), false);
        for (direction, got) in directions.iter().zip(got.chunks_exact(2)) {
            // The kernel's directions are f32, 6e-8 off: a lobe as narrow as alpha changes by 4 * 6e-8 / alpha.
            let alpha = tested.roughness * tested.roughness;
            let allowed = 1e-4 + 1e-6 / alpha;
            let exact = tested.value(direction.as_vec3().as_dvec3());
            let off = |v: f32, exact: f64| (f64::from(v) - exact).abs() / (exact * allowed);
            worst = worst.max(off(got[0][0], exact)).max(off(got[1][0], exact));
            worst_of_fault = worst_of_fault.max(off(got[0][0], exact * 1.002));
        }
    }
    assert!(worst <= 1.0, "{worst} of what is allowed");
    assert!(worst_of_fault > 1.0, "an oracle that is 0.2 % off");

    let tilted = Tested { base: 0.7, roughness: 0.5, metallic: 0.0, view: view(0.9), tilt: 0.5, glossy: true };
    let mut random = Random(8);
    let directions: Vec<DVec3> = (0..500).map(|_| random.direction()).collect();
    for glossy in [false, true] {
        let got = run("evaluated", &Tested { glossy, ..tilted }, &directions, directions.len(), false);
        for (d, got) in directions.iter().zip(got.chunks_exact(2)) {
            let over_both = d.z > 0.0 && d.x * 0.5f64.sin() + d.z * 0.5f64.cos() > 0.0;
            assert_eq!(got[0][0] > 0.0, over_both, "{d}");
            assert_eq!(got[0][3] > 0.0, over_both, "{d}");
        }
    }
}

/// Swapping light and view changes nothing.
#[test]
fn reflection_is_reciprocal() {
    for tested in all_tested(0.7) {
        let directions: Vec<DVec3> = some_directions(&tested).into_iter().filter(|d| d.z > 0.1).take(24).collect();
        let there = run("evaluated", &tested, &directions, directions.len(), false);
        for (direction, there) in directions.iter().zip(there.chunks_exact(2)) {
            let back = run("evaluated", &Tested { view: *direction, ..tested }, &[tested.view], 1, false);
            let (there, back) = (f64::from(there[0][0]), f64::from(back[0][0]));
            assert!((there - back).abs() <= 1e-3 * there.max(back), "{tested:?} {direction}: {there} {back}");
        }
    }
    // A Fresnel term of one of the angles only, which is no more wrong than many a renderer's, would be found.
    let tested = Tested { base: 0.7, roughness: 1.0, metallic: 0.0, view: view(0.95), tilt: 0.0, glossy: true };
    let one_sided = |t: &Tested, l: DVec3| t.value(l) * (1.0 - (1.0 - t.view.z).powi(5));
    let (there, back) =
        (one_sided(&tested, view(0.25)), one_sided(&Tested { view: view(0.25), ..tested }, tested.view));
    assert!((there - back).abs() > 1e-3 * there);
}

/// No surface returns more than it gets, from any side; a smooth mirror returns all, and so does a white Lambertian.
#[test]
fn no_surface_makes_light() {
    const N: usize = 1 << 14;
    let albedo = |tested: &Tested| {
        let got = run("sampled", tested, &[], N, true);
        got.chunks_exact(2).map(|s| f64::from(s[1][0])).sum::<f64>() / N as f64
    };
    for roughness in [0.05, 0.2, 0.5, 1.0] {
        for metallic in [0.0, 0.5, 1.0] {
            for cosine in [1.0, 0.7, 0.3, 0.1, 0.02] {
                let tested = Tested { base: 1.0, roughness, metallic, view: view(cosine), tilt: 0.0, glossy: true };
                let a = albedo(&tested);
                assert!((0.05..=1.0 + 1e-3).contains(&a), "{tested:?} returns {a}");
                // Seen from above, a white surface under any layer is still white: a rough layer's masking takes 4 %.
                if metallic == 0.0 && cosine >= 0.7 {
                    assert!(a > 0.93, "{tested:?} returns {a}");
                }
                if metallic == 1.0 && roughness == 0.05 && cosine > 0.2 {
                    // Masking takes a part in 1e-5 at such a roughness: the rest is the sequence's error.
                    assert!(a > 0.998, "{tested:?} returns {a}");
                }
            }
        }
    }
    let white = Tested { base: 1.0, roughness: 1.0, metallic: 0.0, view: view(0.5), tilt: 0.0, glossy: false };
    assert!((albedo(&white) - 1.0).abs() < 1e-6);
}

/// Samples are distributed by the density: counted in cells about the mirror's direction that widen with the distance
/// to it, in which the density is integrated by midpoints. A weight is value times cosine over density.
#[test]
fn samples_follow_their_density() {
    const N: usize = 1 << 14;
    const RADII: usize = 16;
    const SECTORS: usize = 8;
    // Midpoints each way in a cell: the horizon that cuts a cell leaves an error of 1 / 24 of it at most, below the
    // spread of its count.
    const POINTS: usize = 24;
    let least = 1e-4f64;
    let steps = (PI / least).ln();
    let mut all = all_tested(0.7);
    all.push(Tested { tilt: 0.4, ..all[12] });
    all.push(Tested { tilt: 0.4, ..all[13] });
    all.push(Tested { glossy: false, metallic: 0.0, ..all[20] });
    let family = all.len() as u32;
    for tested in &all {
        let mirror = DVec3::new(-tested.view.x, -tested.view.y, tested.view.z);
        let side = mirror.cross(DVec3::X).normalize();
        let up = mirror.cross(side);
        let cell = |d: DVec3| {
            let angle = mirror.cross(d).length().atan2(mirror.dot(d));
            let azimuth = (d.dot(up).atan2(d.dot(side)) / TAU).rem_euclid(1.0);
            let radius = ((angle / least).max(1.0).ln() / steps * RADII as f64) as usize;
            radius.min(RADII - 1) * SECTORS + ((azimuth * SECTORS as f64) as usize).min(SECTORS - 1)
        };
        let mut midpoints = Vec::new();
        let mut solid_angles = Vec::new();
        for r in 0..RADII {
            // The innermost cells go down to 0: their solid angle is in proportion.
            let edge = |k: f64| {
                if r == 0 {
                    least * (steps / RADII as f64).exp() * k
                } else {
                    least * (steps * (r as f64 + k) / RADII as f64).exp()
                }
            };
            for s in 0..SECTORS {
                for i in 0..POINTS {
                    let (from, to) = (edge(i as f64 / POINTS as f64), edge((i + 1) as f64 / POINTS as f64));
                    let angle = (from + to) / 2.0;
                    // cos a - cos b, without cancellation.
                    let ring = 2.0 * angle.sin() * ((to - from) / 2.0).sin() * TAU / (SECTORS * POINTS) as f64;
                    for j in 0..POINTS {
                        let azimuth = TAU * (s as f64 + (j as f64 + 0.5) / POINTS as f64) / SECTORS as f64;
                        let across = side * azimuth.cos() + up * azimuth.sin();
                        midpoints.push(mirror * angle.cos() + across * angle.sin());
                        solid_angles.push(ring);
                    }
                }
            }
        }
        let densities = run("evaluated", tested, &midpoints, midpoints.len(), false);
        let mut expected = vec![0.0; RADII * SECTORS + 1];
        for (i, solid_angle) in solid_angles.iter().enumerate() {
            expected[i / (POINTS * POINTS)] += f64::from(densities[2 * i][3]) * solid_angle * N as f64;
        }
        // Samples that went into the surface.
        let inside: f64 = expected.iter().sum();
        // The integral may exceed 1 by its own error, no more.
        assert!(inside < 1.01 * N as f64, "{tested:?}: the density integrates to {}", inside / N as f64);
        *expected.last_mut().unwrap() = (N as f64 - inside).max(0.0);
        let samples = run("sampled", tested, &[], N, false);
        let mut observed = vec![0u64; RADII * SECTORS + 1];
        let mut directions = Vec::new();
        for s in samples.chunks_exact(2) {
            let d = DVec3::new(s[0][0].into(), s[0][1].into(), s[0][2].into());
            directions.push(d);
            if s[0][3] > 0.0 { observed[cell(d)] += 1 } else { observed[RADII * SECTORS] += 1 }
        }
        // A few in the last cell where the integral's own error says none.
        if expected[RADII * SECTORS] < 5.0 && observed[RADII * SECTORS] < 20 {
            observed.pop();
            expected.pop();
        }
        chi_square(&observed, &expected, family).unwrap_or_else(|e| panic!("{tested:?}: {e}"));
        let shifted: Vec<f64> =
            expected.iter().enumerate().map(|(i, e)| if i % 2 == 0 { e * 1.15 } else { e * 0.85 }).collect();
        chi_square(&observed, &shifted, family).expect_err("cells that are 15 % off");

        let values = run("evaluated", tested, &directions, directions.len(), false);
        for (s, value) in samples.chunks_exact(2).zip(values.chunks_exact(2)) {
            let expected = f64::from(value[0][0]) * f64::from(s[0][2]) / f64::from(s[0][3]);
            // Both are functions of the same f32 direction, computed alike.
            assert!(
                s[0][3] <= 0.0 || (f64::from(s[1][0]) - expected).abs() <= 1e-3 * expected,
                "{tested:?} {s:?} {value:?}"
            );
        }
    }
}
