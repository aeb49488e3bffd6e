//! The environment: look-ups against bilinear interpolation in f64, sampled directions against their density, photons
//! against the irradiance of the panorama.

use std::f64::consts::{PI, TAU};
use std::sync::Arc;

use glam::{DVec2, DVec3};
use kernel_kit::{Gpu, Resources, kernel_test};
use penumbra::internal::gpu_scene::GpuLights;
use penumbra::internal::kernels::compose_source;
use penumbra::internal::scene::{Panorama, Scene};
use penumbra::internal::specialisation::features::{Feature, Features};

use crate::kit::{device_features, new_kernel, results};
use crate::light::cube;
use crate::meshes::{panorama, scene, surface};
use crate::random::{Random, RandomInput as _};
use crate::statistics::{chi_square, mean_and_error, z_test};

/// A cube of edge 0.6 in a panorama.
fn surrounded(panorama: &Panorama, rotation: f64, strength: f32) -> Scene {
    let mut scene = scene(&[(cube(DVec3::new(0.1, 0.0, -0.2), 0.3), surface(0.5, 0.0))], Vec::new());
    scene.set_environment(Arc::new(panorama.clone()), rotation, strength).unwrap();
    scene
}

fn features(gpu: &Gpu) -> Features {
    device_features(gpu).with(Feature::Environment, true)
}

/// Runs an entry of the test kernel: `per_item` vectors for each of `count` items.
fn run(gpu: &Gpu, scene: &Scene, entry: &str, directions: &[DVec3], count: usize, per_item: usize) -> Vec<[f32; 4]> {
    let composed = compose_source("environment", include_str!("shaders/environment.wgsl"), &features(gpu)).unwrap();
    let constants = [("count", count as f64), ("seed", 99.0)];
    let kernel = new_kernel(gpu, &composed, &constants, &["directions", "results"]).unwrap();
    let gpu_scene = GpuLights::new(gpu, scene, None).unwrap();
    let directions: Vec<_> = directions.iter().map(|d| d.as_vec3().extend(0.0)).collect();
    let directions = gpu.upload("test/directions", &directions).unwrap();
    let own = Resources::new().with("directions", &directions);
    results(gpu, &kernel, entry, &[&own, &gpu_scene], count, per_item)
}

fn vector(v: &[f32; 4]) -> DVec3 {
    DVec3::new(v[0].into(), v[1].into(), v[2].into())
}

/// Column and row of a direction in the panorama; the centre of the first texel is at 0.5.
fn texel_of(panorama: &Panorama, rotation: f64, direction: DVec3) -> DVec2 {
    let u = (direction.z.atan2(direction.x) + rotation.to_radians()) / TAU + 0.5;
    let v = direction.normalize().y.acos() / PI;
    DVec2::new(u.rem_euclid(1.0) * f64::from(panorama.width), v * f64::from(panorama.height))
}

fn texel(panorama: &Panorama, x: i64, y: i64) -> DVec3 {
    let x = x.rem_euclid(i64::from(panorama.width)) as usize;
    let y = y.clamp(0, i64::from(panorama.height) - 1) as usize;
    let [r, g, b] = panorama.texels[y * panorama.width as usize + x];
    DVec3::new(r.into(), g.into(), b.into())
}

/// The oracle: bilinear between the centres of texels, periodic in azimuth and clamped at the poles.
fn radiance(panorama: &Panorama, rotation: f64, direction: DVec3) -> DVec3 {
    let at = texel_of(panorama, rotation, direction) - 0.5;
    let (corner, part) = (at.floor(), at - at.floor());
    let (x, y) = (corner.x as i64, corner.y as i64);
    let row = |y| texel(panorama, x, y).lerp(texel(panorama, x + 1, y), part.x);
    row(y).lerp(row(y + 1), part.y)
}

/// The maximum error in f32: that of a position in the panorama is 1e-6 of its width, and that of the radiance follows
/// from the differences between the texels around it.
fn rounding(panorama: &Panorama, rotation: f64, direction: DVec3) -> f64 {
    let corner = (texel_of(panorama, rotation, direction) - 0.5).floor();
    let near = (0..16).map(|i| texel(panorama, corner.x as i64 + i % 4 - 1, corner.y as i64 + i / 4 - 1).max_element());
    (1e-6 + 1e-6 * f64::from(panorama.width.max(8))) * near.fold(0.0, f64::max)
}

/// A panorama of noise, partly black, with one texel far brighter than all others.
fn noisy(width: u32, height: u32) -> Panorama {
    let mut random = Random(u64::from(width * 77 + height));
    let mut panorama = panorama(width, height, |d| if d.x > 0.3 { DVec3::ZERO } else { DVec3::ONE });
    for texel in &mut panorama.texels {
        texel.iter_mut().for_each(|channel| *channel *= (0.1 + random.uniform()) as f32);
    }
    let sun = panorama.texels.len() / 3;
    panorama.texels[sun] = [300.0, 200.0, 100.0];
    panorama
}

/// Sizes: cells of one texel, cells of three texels of which the last is cut off, and a panorama of one texel.
const SIZES: [(u32, u32); 5] = [(32, 16), (5, 3), (1, 1), (2, 1), (2050, 7)];

fn directions(count: usize) -> Vec<DVec3> {
    let mut random = Random(31);
    let poles = [DVec3::Y, DVec3::new(0.0, -1.0, 0.0), DVec3::new(1e-6, 1.0, 0.0), DVec3::new(0.0, -1.0, 1e-6)]
        .map(DVec3::normalize);
    poles.into_iter().chain((0..count - 4).map(|_| random.direction())).collect()
}

/// A panorama is oriented as in Blender and the Khronos viewers, and rotates about +Y: 90 degrees move what was along
/// +X to -Z, the direction of a camera that is not rotated.
#[kernel_test("PENUMBRA_DEVICE")]
fn panoramas_are_turned_as_elsewhere(gpu: &Gpu) {
    // Colours of four quarters: around the centre of the image, to its right, around its edge, to its left.
    let colours = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 1.0, 0.0]];
    let texels = (0..64).map(|i| colours[((i % 16 + 2) / 4 + 2) % 4]).collect();
    let panorama = Panorama { width: 16, height: 4, texels };
    let around = [DVec3::X, DVec3::Z, -DVec3::X, -DVec3::Z];
    for (rotation, first) in [(0.0, 0), (90.0, 1), (-90.0, 3), (180.0, 2), (450.0, 1)] {
        let got = run(gpu, &surrounded(&panorama, rotation, 1.0), "met", &around, 4, 2);
        for (i, [met, _]) in got.as_chunks::<2>().0.iter().enumerate() {
            assert_eq!(met[..3], colours[(i + first) % 4], "rotation {rotation}, direction {}", around[i]);
        }
    }
}

/// Look-ups interpolate bilinearly, for every size, rotation and strength.
#[kernel_test("PENUMBRA_DEVICE")]
fn look_ups_interpolate(gpu: &Gpu) {
    for (width, height) in SIZES {
        let panorama = noisy(width, height);
        for (rotation, strength) in [(0.0, 1.0), (123.4, 2.5)] {
            let directions = directions(2000);
            let got = run(gpu, &surrounded(&panorama, rotation, strength), "met", &directions, directions.len(), 2);
            let wrong = |moved: f64| {
                let off = |(direction, [met, alone]): &(&DVec3, &[[f32; 4]; 2])| {
                    assert_eq!(met[..3], alone[..3]);
                    let expected = radiance(&panorama, rotation + moved, **direction) * f64::from(strength);
                    let tolerance = f64::from(strength) * rounding(&panorama, rotation, **direction);
                    (vector(met) - expected).abs().max_element() > tolerance
                };
                directions.iter().zip(got.as_chunks::<2>().0).filter(off).count()
            };
            assert_eq!(wrong(0.0), 0, "{width} x {height}, rotation {rotation}");
            // The planted fault: a shift by half a texel. It does not change a panorama of one column.
            let aside = wrong(180.0 / f64::from(width));
            assert!(width == 1 || aside > 20, "{width} x {height}: {aside} wrong in a panorama that is moved");
        }
    }
}

/// The cells of the sampling table, computed independently: their size in patches, and for each cell its share of
/// radiance times solid angle, and its solid angle.
struct Cells {
    step: u32,
    columns: u32,
    share: Vec<f64>,
    solid_angle: Vec<f64>,
}

impl Cells {
    fn new(panorama: &Panorama) -> Cells {
        let Panorama { width, height, .. } = *panorama;
        let step = width.div_ceil(1024).max(height.div_ceil(512));
        let [columns, rows] = [width.div_ceil(step), (height + 1).div_ceil(step)];
        let mut cells = Cells {
            step,
            columns,
            share: vec![0.0; (columns * rows) as usize],
            solid_angle: vec![0.0; (columns * rows) as usize],
        };
        let height_of = |row: u32| (PI * ((f64::from(row) - 0.5) / f64::from(height)).clamp(0.0, 1.0)).cos();
        for row in 0..=height {
            for column in 0..width {
                let (x, y) = (i64::from(column), i64::from(row) - 1);
                let corners = [(x, y), (x + 1, y), (x, y + 1), (x + 1, y + 1)];
                let mean = corners.map(|(x, y)| texel(panorama, x, y).element_sum()).iter().sum::<f64>() / 12.0;
                let solid_angle = (height_of(row) - height_of(row + 1)) * TAU / f64::from(width);
                let cell = (row / step * columns + column / step) as usize;
                cells.share[cell] += mean * solid_angle;
                cells.solid_angle[cell] += solid_angle;
            }
        }
        let all: f64 = cells.share.iter().sum();
        cells.share.iter_mut().for_each(|share| *share /= all);
        cells
    }

    /// The cell of a direction. `None` within `margin` patches of the border of a patch, where rounding decides.
    fn of(&self, panorama: &Panorama, rotation: f64, direction: DVec3, margin: f64) -> Option<usize> {
        let at = texel_of(panorama, rotation, direction) + DVec2::new(-0.5, 0.5);
        let patch = DVec2::new(at.x.rem_euclid(f64::from(panorama.width)), at.y);
        let inside = (patch - patch.floor() - 0.5).abs().max_element() < 0.5 - margin;
        let [x, y] = [patch.x as u32, (patch.y as u32).min(panorama.height)];
        inside.then_some((y / self.step * self.columns + x / self.step) as usize)
    }
}

/// Directions are sampled by their density: cells by their share of radiance, and evenly by solid angle within a cell.
/// The look-up of a direction returns the same density, which integrates to 1.
#[kernel_test("PENUMBRA_DEVICE")]
fn samples_follow_their_density(gpu: &Gpu) {
    const N: usize = 1 << 15;
    for (width, height) in SIZES {
        let panorama = noisy(width, height);
        let cells = Cells::new(&panorama);
        let rotation = 77.0;
        let scene = surrounded(&panorama, rotation, 3.0);
        let got = run(gpu, &scene, "sampled", &[], N, 2);
        let mut counts = vec![0u64; cells.share.len()];
        // Quarters of a cell: halves by azimuth and by height.
        let mut quarters = [0u64; 4];
        // Probabilities are f32, and the smallest ones are raised to a millionth of their row.
        let right = |pdf: f32, cell: usize| {
            let expected = cells.share[cell] / cells.solid_angle[cell];
            // A difference of cumulative probabilities is off by 6e-8: 2e-3 of a probability of 3e-5.
            (f64::from(pdf) - expected).abs() <= 2e-3 * expected + 2e-5
        };
        let mut caught = 0;
        for [sample, colour] in got.as_chunks::<2>().0 {
            let (direction, pdf) = (vector(sample), sample[3]);
            // A few roundings of f32.
            assert!((direction.length() - 1.0).abs() < 1e-6 && pdf > 0.0);
            let expected = 3.0 * radiance(&panorama, rotation, direction);
            let tolerance = 3.0 * rounding(&panorama, rotation, direction);
            assert!((vector(colour) - expected).abs().max_element() <= tolerance, "{colour:?}, not {expected}");
            let Some(cell) = cells.of(&panorama, rotation, direction, 0.0) else { continue };
            counts[cell] += 1;
            if cells.of(&panorama, rotation, direction, 1e-3).is_some() {
                assert!(right(pdf, cell), "{width} x {height}: density {pdf} of cell {cell}");
                caught += usize::from(!right(1.01 * pdf, cell));
                if cells.step == 1 {
                    let at = texel_of(&panorama, rotation, direction) + 0.5;
                    let row = at.y.floor();
                    let z = |row: f64| (PI * ((row - 0.5) / f64::from(height)).clamp(0.0, 1.0)).cos();
                    let lower = direction.y < 0.5 * (z(row) + z(row + 1.0));
                    quarters[usize::from(at.x.fract() < 0.5) * 2 + usize::from(lower)] += 1;
                }
            }
        }
        assert!(caught * 2 > N, "{caught} densities that are a hundredth off");
        let expected: Vec<f64> = cells.share.iter().map(|share| share * N as f64).collect();
        if expected.len() > 4 {
            chi_square(&counts, &expected, 10).unwrap_or_else(|e| panic!("{width} x {height}: {e}"));
            let mut shifted = expected.clone();
            shifted.rotate_right(1);
            chi_square(&counts, &shifted, 10).expect_err("cells that are moved by one");
        }
        if cells.step == 1 {
            let even = [quarters.iter().sum::<u64>() as f64 / 4.0; 4];
            chi_square(&quarters, &even, 10).unwrap_or_else(|e| panic!("{width} x {height}, within cells: {e}"));
        }

        // Look-ups over the whole sphere, at the centre of each patch.
        let middle = |patch: u32| {
            let (x, y) = (f64::from(patch % width), f64::from(patch / width));
            let angle = |row: f64| ((row - 0.5) / f64::from(height)).clamp(0.0, 1.0) * PI;
            let below = 0.5 * (angle(y) + angle(y + 1.0));
            let azimuth = (x + 1.0) / f64::from(width) * TAU - PI - rotation.to_radians();
            let direction = DVec3::new(below.sin() * azimuth.cos(), below.cos(), below.sin() * azimuth.sin());
            (direction, (angle(y).cos() - angle(y + 1.0).cos()) * TAU / f64::from(width))
        };
        let middles: Vec<_> = (0..width * (height + 1)).map(middle).collect();
        let directions: Vec<DVec3> = middles.iter().map(|(direction, _)| *direction).collect();
        let met = run(gpu, &scene, "met", &directions, directions.len(), 2);
        let mut sum = 0.0;
        for ((direction, solid_angle), [met, _]) in middles.iter().zip(met.as_chunks::<2>().0) {
            let cell = cells.of(&panorama, rotation, *direction, 0.0).unwrap();
            assert!(right(met[3], cell), "{width} x {height}: density {} along {direction}", met[3]);
            assert!(met[3] > 0.0 || radiance(&panorama, rotation, *direction) == DVec3::ZERO);
            sum += f64::from(met[3]) * solid_angle;
        }
        // Probabilities and solid angles are differences of f32 sums, whose roundings cancel in the integral. Products
        // and quotients are left: a few roundings of 6e-8.
        assert!((sum - 1.0).abs() < 1e-5, "{width} x {height}: the density's integral is {sum}");
    }
}

/// A uniform panorama is sampled uniformly over the sphere, and a black one still has a positive density.
#[kernel_test("PENUMBRA_DEVICE")]
fn even_panoramas_are_sampled_evenly(gpu: &Gpu) {
    for light in [0.0, 1.0] {
        let even = panorama(64, 32, |_| DVec3::splat(light));
        let got = run(gpu, &surrounded(&even, 0.0, 1.0), "sampled", &[], 1 << 12, 2);
        for [sample, colour] in got.as_chunks::<2>().0 {
            // The row at a pole has a probability of 6e-4, a difference of f32 numbers that is off by 6e-8: 1e-4 of it.
            assert!((f64::from(sample[3]) * 4.0 * PI - 1.0).abs() < 1e-3 || light == 0.0, "density {}", sample[3]);
            // Weights of equal texels add up to 1 but for a few roundings.
            assert!(sample[3] > 0.0 && (f64::from(colour[1]) - light).abs() < 1e-6);
        }
    }
}

/// Photons carry the power of the panorama: the mean flux of rays is the integral of radiance times the area of the
/// disc around the scene. They point towards the scene and start evenly over that disc.
#[kernel_test("PENUMBRA_DEVICE")]
fn photons_carry_the_panoramas_power(gpu: &Gpu) {
    const N: usize = 1 << 14;
    let sky = panorama(64, 32, |d| DVec3::new(1.0 + d.y, 1.0 - d.x, 1.0 + 0.5 * d.z));
    let scene = surrounded(&sky, 0.0, 2.0);
    let got = run(gpu, &scene, "emitted", &[], N, 3);
    let rays = got.as_chunks::<3>().0;
    let (centre, radius) = (DVec3::new(0.1, 0.0, -0.2), 0.3 * 3f64.sqrt());
    // The radius in the kernel is a thousandth larger.
    let disc = PI * (1.001 * radius).powi(2);
    for channel in 0..3 {
        let (mean, error) = mean_and_error(rays.iter().map(|ray| f64::from(ray[2][channel])));
        // The mean of each channel over the sphere is 1; interpolation between 32 rows takes about (pi / 32)^2 / 12.
        let expected = 2.0 * 4.0 * PI * disc;
        z_test(mean, error + 1e-3 * expected / 3.0, expected, 6).unwrap_or_else(|e| panic!("channel {channel}: {e}"));
        z_test(1.03 * mean, error + 1e-3 * expected / 3.0, expected, 6).expect_err("three percent too much");
    }
    let mut by_radius = [0u64; 16];
    for ray in rays {
        let (origin, direction) = (vector(&ray[0]) - centre, vector(&ray[1]));
        let along = origin.dot(direction);
        let off = (origin - along * direction).length() / (1.001 * radius);
        // Rays start two radii before the centre. Coordinates near 1 are rounded by 6e-8, over a radius of 0.5.
        assert!(along < -1.9 * radius && off < 1.0 + 1e-5, "a ray that starts beside the scene, or in it");
        by_radius[((off * off * 16.0) as usize).min(15)] += 1;
    }
    chi_square(&by_radius, &[N as f64 / 16.0; 16], 6).unwrap();
    // Light comes from where the sky is bright: red light from above.
    let weights = rays.iter().map(|ray| f64::from(ray[2][0]) * -f64::from(ray[1][1]));
    let (mean, error) = mean_and_error(weights);
    // The mean of y (1 + y) over the sphere is 1/3.
    let expected = 2.0 * 4.0 * PI * disc / 3.0;
    // As above, interpolation takes 8e-4 of the part of the radiance that is proportional to y: of all of this mean.
    z_test(mean, error + 2e-3 * expected, expected, 6).unwrap();
}
