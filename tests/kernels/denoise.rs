//! Pass `denoise` against an oracle in f64, and against closed forms.

use glam::DVec3;
use kernel_kit::{Gpu, kernel_test};
use penumbra::internal::passes::denoise::{Denoise, DenoiseParameters, PIXEL_VECTORS, REACH};
use penumbra::internal::render::denoise::statistical::StatisticalDenoiser;
use penumbra::internal::render::denoise::{self, Component, Guides, Noisy};

use crate::kit::device_features;
use crate::random::{Random, RandomInput as _};

/// An image for the denoiser: mean and variance of direct and of indirect light, albedo, normal, position.
#[derive(Clone)]
struct Input {
    width: usize,
    height: usize,
    samples: u32,
    planes: [Vec<[f32; 3]>; PIXEL_VECTORS],
}

const DIRECT: usize = 0;
const DIRECT_VARIANCE: usize = 1;
const INDIRECT: usize = 2;
const ALBEDO: usize = 4;
const NORMAL: usize = 5;
const POSITION: usize = 6;

impl Input {
    /// A plane seen from above, white and without light.
    fn plane(width: usize, height: usize, samples: u32) -> Input {
        let count = width * height;
        let at = |i: usize| [(i % width) as f32, 0.0, (i / width) as f32];
        let black = vec![[0.0; 3]; count];
        let planes = [
            black.clone(),
            black.clone(),
            black.clone(),
            black,
            vec![[1.0; 3]; count],
            vec![[0.0, 1.0, 0.0]; count],
            (0..count).map(at).collect(),
        ];
        Input { width, height, samples, planes }
    }

    /// Sets the direct light, and its variance, of every pixel (column, row).
    fn light(mut self, mut light: impl FnMut(usize, usize) -> f32, variance: f32) -> Input {
        for i in 0..self.width * self.height {
            self.planes[DIRECT][i] = [light(i % self.width, i / self.width); 3];
            self.planes[DIRECT_VARIANCE][i] = [variance; 3];
        }
        self
    }

    fn vectors(&self) -> Vec<[f32; 4]> {
        let pixel = |i: usize| self.planes.iter().map(move |plane| [plane[i][0], plane[i][1], plane[i][2], 0.0]);
        (0..self.width * self.height).flat_map(pixel).collect()
    }

    fn run(&self, gpu: &Gpu) -> Vec<[f32; 4]> {
        let image = DenoiseParameters { width: self.width as u32, height: self.height as u32, samples: self.samples };
        Denoise::new(gpu, &device_features(gpu)).unwrap().filter(gpu, &image, &self.vectors()).unwrap()
    }

    /// The red channel.
    fn red(&self, gpu: &Gpu) -> Vec<f64> {
        self.run(gpu).iter().map(|v| f64::from(v[0])).collect()
    }

    fn filter(&self, gpu: &Gpu) -> Vec<[f32; 3]> {
        let [direct, direct_variance, indirect, indirect_variance, albedo, normal, position] = self.planes.clone();
        let components = vec![
            Component { mean: direct, variance: direct_variance },
            Component { mean: indirect, variance: indirect_variance },
        ];
        let denoiser = StatisticalDenoiser::new(gpu).unwrap();
        let size = [self.width as u32, self.height as u32];
        denoiser
            .filter(size, self.samples, &denoise::Light { components }, &Guides { albedo, normal, position })
            .unwrap()
    }
}

/// Two surfaces, textured, one of them in part behind nothing, with noise and a firefly.
fn scenery(width: usize, height: usize, samples: u32) -> Input {
    let mut random = Random(3);
    let mut input = Input::plane(width, height, samples);
    for i in 0..width * height {
        let (x, y) = (i % width, i / width);
        let wall = 3 * x > 2 * width;
        if wall {
            input.planes[NORMAL][i] = [2.0, 0.1, 0.0];
            input.planes[POSITION][i] = [0.6 * width as f32, (x as f32) * 0.7, y as f32];
        }
        if x + 2 * y < 9 && i > 0 {
            input.planes[NORMAL][i] = [0.0; 3];
        }
        let tile = if (x / 4 + y / 3) % 2 == 0 { 0.75 } else { 0.25 };
        input.planes[ALBEDO][i] = [tile, 0.5, 0.9 * tile];
        for (light, spread) in [(DIRECT, 0.3), (INDIRECT, 0.1)] {
            let level = tile * if wall { 1.4 } else { 0.8 + 0.02 * x as f32 };
            let firefly = if i == width * height / 2 { 20.0 } else { 0.0 };
            input.planes[light][i] = [0; 3].map(|_| level * (1.0 + spread * random.normal() as f32) + firefly);
            let variance = (level * spread).powi(2) * (0.5 + random.uniform() as f32);
            input.planes[light + 1][i] = [variance + firefly * firefly; 3];
        }
    }
    input
}

/// The filter in f64, written from the description in `shaders/denoise.wgsl`. `None` for a pixel that keeps its own.
struct Oracle {
    width: i64,
    height: i64,
    samples: f64,
    surfaces: Vec<Surface>,
}

#[derive(Clone, Copy)]
struct Surface {
    albedo: DVec3,
    /// As compared: in steps of 1/255.
    coarse_albedo: DVec3,
    normal: DVec3,
    position: DVec3,
    spacing: f64,
}

/// A colour and one more number.
type Light = (DVec3, f64);

impl Oracle {
    fn new(input: &Input) -> Oracle {
        let vector = |plane: usize, i: usize| DVec3::from_array(input.planes[plane][i].map(f64::from));
        let (width, height) = (input.width as i64, input.height as i64);
        let mut surfaces: Vec<Surface> = (0..input.width * input.height)
            .map(|i| {
                let albedo = vector(ALBEDO, i).max(DVec3::splat(0.01));
                let coarse_albedo = (albedo * 255.0).round() / 255.0;
                let normal = vector(NORMAL, i).normalize_or_zero();
                Surface { albedo, coarse_albedo, normal, position: vector(POSITION, i), spacing: 1e30 }
            })
            .collect();
        for i in 0..surfaces.len() {
            let (x, y) = (i as i64 % width, i as i64 / width);
            let nearer = |steps: [(i64, i64); 2]| {
                let inside = steps
                    .into_iter()
                    .map(|(dx, dy)| (x + dx, y + dy))
                    .filter(|&(x, y)| x >= 0 && y >= 0 && x < width && y < height);
                let others = inside.map(|(x, y)| &surfaces[(y * width + x) as usize]);
                let on_surface = others.filter(|other| other.normal != DVec3::ZERO);
                on_surface.map(|other| other.position.distance(surfaces[i].position)).fold(f64::INFINITY, f64::min)
            };
            let both = [nearer([(-1, 0), (1, 0)]), nearer([(0, -1), (0, 1)])];
            let known = both.into_iter().filter(|distance| distance.is_finite());
            surfaces[i].spacing = known.reduce(f64::max).unwrap_or(1e30).max(1e-20);
        }
        Oracle { width, height, samples: f64::from(input.samples), surfaces }
    }

    /// Calls `visit` with offset, index and weight of each pixel around a pixel.
    fn around(&self, i: usize, radius: i64, mut visit: impl FnMut([f64; 2], usize, f64)) {
        let (x, y) = (i as i64 % self.width, i as i64 / self.width);
        for dy in -radius..=radius {
            for dx in -radius..=radius {
                let (column, row) = (x + dx, y + dy);
                if column < 0 || row < 0 || column >= self.width || row >= self.height {
                    continue;
                }
                let j = (row * self.width + column) as usize;
                let apart = ((dx * dx + dy * dy) as f64).sqrt();
                visit([dx as f64, dy as f64], j, self.likeness(i, j, apart));
            }
        }
    }

    fn likeness(&self, i: usize, j: usize, apart: f64) -> f64 {
        let (a, b) = (&self.surfaces[i], &self.surfaces[j]);
        if (a.normal == DVec3::ZERO) != (b.normal == DVec3::ZERO) {
            return 0.0;
        }
        let mut exponent = a.coarse_albedo.distance_squared(b.coarse_albedo) / 0.01;
        if a.normal != DVec3::ZERO {
            let height = (b.position - a.position).dot(a.normal) / (a.spacing * apart.max(1.0));
            exponent += (1.0 - a.normal.dot(b.normal)) / 0.1 + (height / 1.5).powi(2);
        }
        let weight = (-exponent).exp();
        if weight < 0.02 { 0.0 } else { weight }
    }

    fn restrain(&self, light: &[Light]) -> Vec<Light> {
        let pixel = |i: usize| {
            let mut others = Vec::new();
            self.around(i, 2, |_, j, weight| {
                if i != j {
                    others.push((weight, light[j].0));
                }
            });
            let counts = |(weight, _): &&(f64, DVec3)| *weight > 0.3;
            if others.iter().filter(counts).count() < 5 {
                return light[i];
            }
            // All but the brightest.
            let brightness = |(_, light): &(f64, DVec3)| light.element_sum();
            let brightest = others.iter().filter(counts).map(brightness).fold(0.0, f64::max);
            if let Some(at) = others.iter().position(|other| counts(&other) && brightness(other) == brightest) {
                others.remove(at);
            }
            let count = others.iter().filter(counts).count() as f64;
            let weights: f64 = others.iter().map(|(weight, _)| weight).sum();
            let mean = others.iter().map(|(weight, light)| *weight * *light).sum::<DVec3>() / weights;
            let spread: f64 = others.iter().map(|(weight, other)| weight * other.distance_squared(mean)).sum();
            let limit = 9.0 * spread / weights * count / (count - 1.0);
            let distance = light[i].0.distance_squared(mean);
            let explained = self.samples < 2.0 || distance < 4.0 * light[i].1;
            if distance <= limit || !explained {
                return light[i];
            }
            (mean.lerp(light[i].0, (limit / distance).sqrt()), light[i].1 * limit / distance)
        };
        (0..light.len()).map(pixel).collect()
    }

    fn pool(&self, light: &[Light]) -> Vec<Light> {
        let pixel = |i: usize| {
            if self.samples < 2.0 {
                return (light[i].0, self.nugget(light, i));
            }
            let (mut weights, mut variance) = (0.0, 0.0);
            self.around(i, 2, |_, j, weight| {
                weights += weight;
                variance += weight * light[j].1;
            });
            let more = self.samples - 1.0;
            (light[i].0, (4.0 * variance / weights + more * light[i].1) / (4.0 + more))
        };
        (0..light.len()).map(pixel).collect()
    }

    /// The variogram's value at distance 0, by those at 1 and 2 along rows and columns of 5 x 5 pixels.
    fn nugget(&self, light: &[Light], i: usize) -> f64 {
        let mut members = Vec::new();
        self.around(i, 2, |at, j, weight| members.push((at, weight, light[j].0)));
        let [one, two] = [1.0, 2.0].map(|distance| {
            let (mut weights, mut sum) = (0.0, 0.0);
            for (from, weight, light) in &members {
                for (to, other_weight, other) in &members {
                    let step = [to[0] - from[0], to[1] - from[1]];
                    if step == [distance, 0.0] || step == [0.0, distance] {
                        weights += weight * other_weight;
                        sum += weight * other_weight * light.distance_squared(*other);
                    }
                }
            }
            0.5 * sum / f64::max(weights, 1e-10)
        });
        (2.0 * one - two).clamp(0.0, one)
    }

    fn smooth(&self, light: &[Light]) -> Vec<Light> {
        let guide = vec![(DVec3::ZERO, 0.0); light.len()];
        self.average(light, &guide, 1, 1.0)
    }

    fn weight(a: Light, b: Light, interval: f64) -> f64 {
        let excess = (a.0.distance_squared(b.0) - a.1 - a.1.min(b.1)).max(0.0);
        let weight = (-excess / (interval * (1e-10 + a.1 + b.1))).exp();
        if weight < 0.01 { 0.0 } else { weight }
    }

    fn average(&self, light: &[Light], guide: &[Light], radius: i64, interval: f64) -> Vec<Light> {
        let pixel = |i: usize| {
            let (mut weights, mut sum, mut variance) = (0.0, DVec3::ZERO, 0.0);
            self.around(i, radius, |_, j, weight| {
                let weight = weight * Self::weight(guide[i], guide[j], interval);
                weights += weight;
                sum += weight * light[j].0;
                variance += weight * weight * light[j].1;
            });
            (sum / weights, variance / (weights * weights))
        };
        (0..light.len()).map(pixel).collect()
    }

    /// The fit by Gauss and Jordan on the normal equations of 1, x and y.
    fn regress(&self, light: &[Light], guide: &[Light]) -> Vec<Light> {
        let pixel = |i: usize| {
            // A row for each unknown: the matrix, the right-hand side of three channels, and of the pixel's own light.
            let mut rows = [[0.0f64; 7]; 3];
            self.around(i, 5, |[x, y], j, weight| {
                let weight = weight * Self::weight(guide[i], guide[j], 4.0);
                let basis = [1.0, x, y];
                let own = if i == j { 1.0 } else { 0.0 };
                let columns = [1.0, x, y, light[j].0.x, light[j].0.y, light[j].0.z, own];
                for (row, factor) in rows.iter_mut().zip(basis) {
                    row.iter_mut().zip(columns).for_each(|(sum, column)| *sum += weight * factor * column);
                }
            });
            rows[1][1] += 0.5 * rows[0][0];
            rows[2][2] += 0.5 * rows[0][0];
            for pivot in 0..3 {
                let scaled = rows[pivot].map(|value| value / rows[pivot][pivot]);
                rows[pivot] = scaled;
                for (_, row) in rows.iter_mut().enumerate().filter(|(k, _)| *k != pivot) {
                    let factor = row[pivot];
                    row.iter_mut().zip(scaled).for_each(|(value, other)| *value -= factor * other);
                }
            }
            (DVec3::new(rows[0][3], rows[0][4], rows[0][5]), rows[0][6])
        };
        (0..light.len()).map(pixel).collect()
    }

    fn mix(&self, light: &[Light], result: &[Light]) -> Vec<DVec3> {
        let pixel = |i: usize| {
            let (mut explained, mut changed) = (0.0, 0.0);
            self.around(i, 2, |_, j, weight| {
                explained += weight * light[j].1 * (1.0 - result[j].1);
                changed += weight * light[j].0.distance_squared(result[j].0);
            });
            let trust = (explained / f64::max(changed, 1e-30)).clamp(0.0, 1.0);
            light[i].0.lerp(result[i].0, trust)
        };
        (0..light.len()).map(pixel).collect()
    }

    /// The whole filter.
    fn filter(&self, input: &Input) -> Vec<DVec3> {
        let part = |plane: usize| {
            let demodulated = |(i, (mean, variance)): (usize, (&[f32; 3], &[f32; 3]))| {
                let albedo = self.surfaces[i].albedo;
                let variance = DVec3::from_array(variance.map(f64::from)) / (albedo * albedo);
                let known = if self.samples > 1.0 { variance.element_sum() } else { 0.0 };
                (DVec3::from_array(mean.map(f64::from)) / albedo, known)
            };
            let pixels = input.planes[plane].iter().zip(&input.planes[plane + 1]).enumerate();
            let light = self.pool(&self.restrain(&pixels.map(demodulated).collect::<Vec<_>>()));
            let first = self.average(&light, &self.smooth(&light), 3, 1.69);
            self.mix(&light, &self.regress(&light, &first))
        };
        let (direct, indirect) = (part(DIRECT), part(INDIRECT));
        let sum = |i: usize| (direct[i] + indirect[i]) * self.surfaces[i].albedo;
        (0..direct.len()).map(sum).collect()
    }
}

/// The largest difference of any channel of any pixel.
fn difference(got: &[[f32; 4]], expected: &[DVec3]) -> f64 {
    assert_eq!(got.len(), expected.len());
    let pixel = |(g, e): (&[f32; 4], &DVec3)| {
        let d = DVec3::new(g[0].into(), g[1].into(), g[2].into()) - *e;
        if d.is_nan() { f64::INFINITY } else { d.abs().max_element() }
    };
    got.iter().zip(expected).map(pixel).fold(0.0, f64::max)
}

/// One, two and many samples, in images of a pixel, of a row, around the size of a workgroup, and larger than windows.
#[kernel_test("PENUMBRA_DEVICE")]
fn filter_is_that_of_the_oracle(gpu: &Gpu) {
    // Light is about 1 and its noise 0.3. A pixel whose weight is near a threshold (0.02 and 0.01) may count in one of
    // the two only, which moves a mean of a few pixels by that share of the noise.
    let tolerance = 5e-3;
    for (width, height) in [(1, 1), (63, 1), (1, 65), (8, 8), (13, 5), (33, 29)] {
        for samples in [1, 2, 16] {
            let input = scenery(width, height, samples);
            let got = input.run(gpu);
            assert!(got.iter().all(|v| v[3] == 1.0), "{width} x {height}: pixels were kept");
            let found = difference(&got, &Oracle::new(&input).filter(&input));
            assert!(found <= tolerance, "{width} x {height}, {samples} samples: {found}");
        }
    }
    // The comparison must catch a wrong variance, a surface taken for another, and a light that is left out.
    let input = scenery(33, 29, 16);
    let got = input.run(gpu);
    for (plane, pixel, value) in [(DIRECT_VARIANCE, 500, 9.0), (NORMAL, 600, -1.0), (INDIRECT, 300, 0.0)] {
        let mut wrong = input.clone();
        wrong.planes[plane][pixel] = [value; 3];
        let found = difference(&got, &Oracle::new(&wrong).filter(&wrong));
        assert!(found > tolerance, "a change of plane {plane} is not found: {found}");
    }
}

/// Where noise explains every difference, a pixel is the mean of the 11 x 11 around it, so a constant image keeps its
/// mean and loses 120/121 of its variance.
#[kernel_test("PENUMBRA_DEVICE")]
fn noise_is_averaged_over_the_window(gpu: &Gpu) {
    const SIZE: usize = 48;
    let mut random = Random(19);
    // Two values, and a seed with which no pixel is a firefly among its 24 neighbours.
    let mut value = || if random.uniform() < 0.5 { 0.9 } else { 1.1 };
    let noise: Vec<f32> = (0..SIZE * SIZE).map(|_| value()).collect();
    // The variance is a hundred times that of the noise.
    let got = Input::plane(SIZE, SIZE, 16).light(|x, y| noise[y * SIZE + x], 1.0).red(gpu);
    let mut variance = 0.0;
    // Pixels at the border have few neighbours, which may take one of theirs for a firefly.
    for y in 7..SIZE - 7 {
        for x in 7..SIZE - 7 {
            let rows = y - 5..=y + 5;
            let window = rows.flat_map(|row| &noise[row * SIZE + x - 5..=row * SIZE + x + 5]);
            let mean = window.map(|value| f64::from(*value)).sum::<f64>() / 121.0;
            let found = got[y * SIZE + x];
            // The sum of 121 numbers in f32.
            assert!((found - mean).abs() < 1e-5, "({x}, {y}): {found}, not {mean}");
            variance += (found - 1.0).powi(2) / ((SIZE - 14) * (SIZE - 14)) as f64;
        }
    }
    // 34 x 34 pixels have 9 independent windows: the mean of 9 squares of normal numbers is below 3 but for 2e-3, and
    // the seed is fixed.
    assert!(variance < 3.0 * 0.01 / 121.0, "{variance}");
}

/// With the variance that the noise has, the image keeps its mean and loses most of its noise; without any, it keeps
/// every pixel.
#[kernel_test("PENUMBRA_DEVICE")]
fn noise_is_removed_as_far_as_it_is_known(gpu: &Gpu) {
    const SIZE: usize = 48;
    let mut random = Random(18);
    let noise: Vec<f32> = (0..SIZE * SIZE).map(|_| 1.0 + 0.1 * random.normal() as f32).collect();
    let error = |variance: f32| {
        let got = Input::plane(SIZE, SIZE, 16).light(|x, y| noise[y * SIZE + x], variance).red(gpu);
        let mean = got.iter().sum::<f64>() / got.len() as f64;
        // Five standard errors of the mean of 2304 pixels; pixels at the border count more than others.
        assert!((mean - 1.0).abs() < 5.0 * 0.1 / 48.0, "{mean}");
        got.iter().map(|value| (value - 1.0).powi(2)).sum::<f64>() / got.len() as f64
    };
    let (known, unknown) = (error(0.01), error(0.0));
    // Stein's estimate from 25 pixels of 3 equal channels leaves a few hundredths of the variance.
    assert!(known < 0.01 / 8.0, "{known}");
    // The variance of 2304 normal numbers has a standard error of 3 %.
    assert!(unknown > 0.9 * 0.01, "{unknown}");
}

/// For a single sample, noise is distinguished from edges and slopes by how differences grow with distance.
#[kernel_test("PENUMBRA_DEVICE")]
fn single_samples_lose_noise_and_keep_edges(gpu: &Gpu) {
    const SIZE: usize = 32;
    let single = Input::plane(SIZE, SIZE, 1);
    // Two values, in which no pixel is a firefly among its neighbours.
    let mut random = Random(21);
    let noisy = single.clone().light(|_, _| if random.uniform() < 0.5 { 0.9 } else { 1.1 }, 0.0).red(gpu);
    let left = noisy.iter().map(|value| (value - 1.0).powi(2)).sum::<f64>() / noisy.len() as f64;
    // The estimate of the variance from 5 x 5 pixels is noisy itself, and Stein's estimate returns some of the noise.
    assert!(left < 0.01 / 2.0, "{left}");
    let edge = |x: usize, y: usize| if x + y / 3 < SIZE / 2 { 1.0 } else { 2.0 };
    let kept = single.light(edge, 0.0).red(gpu);
    let worst = (0..kept.len()).map(|i| (kept[i] - f64::from(edge(i % SIZE, i / SIZE))).abs()).fold(0.0, f64::max);
    // No pixel is averaged with one beyond the edge. Means of equal values are off by some roundings of 1e-7.
    assert!(worst < 1e-5, "{worst}");
}

/// A texture is kept if the halves show that the variance is below that of independent samples, and is lost if it is
/// not.
#[kernel_test("PENUMBRA_DEVICE")]
fn halves_tell_how_much_is_noise(gpu: &Gpu) {
    const SIZE: usize = 48;
    let mut random = Random(22);
    let texture: Vec<[f32; 3]> =
        (0..SIZE * SIZE).map(|_| if random.uniform() < 0.5 { [0.9; 3] } else { [1.1; 3] }).collect();
    let mut changed = |noise: f32| -> f64 {
        let mut half = || -> Vec<[f32; 3]> {
            let pixel = |[value, ..]: &[f32; 3]| [value + noise * random.normal() as f32; 3];
            texture.iter().map(pixel).collect()
        };
        let means = [half(), half()];
        let mean = |i: usize| [(means[0][i][0] + means[1][i][0]) / 2.0; 3];
        let all: Vec<[f32; 3]> = (0..texture.len()).map(mean).collect();
        // Four times the texture's, and twice that for each half.
        let light = |mean: Vec<[f32; 3]>, variance: f32| {
            let variance = vec![[variance; 3]; mean.len()];
            denoise::Light { components: vec![Component { mean, variance }] }
        };
        let Input { planes, .. } = Input::plane(SIZE, SIZE, 16);
        let [.., albedo, normal, position] = planes;
        let noisy = Noisy {
            size: [SIZE as u32; 2],
            all: light(all.clone(), 0.04),
            halves: Some(means.map(|mean| light(mean, 0.08))),
            half_samples: [8, 8],
            guides: Guides { albedo, normal, position },
            is_clean: vec![false; SIZE * SIZE],
        };
        let filtered = StatisticalDenoiser::new(gpu).unwrap().filter_noisy(&noisy).unwrap();
        assert_eq!(filtered.halves.map(|halves| halves.map(|half| half.len())), Some([all.len(); 2]));
        let squares = filtered.all.iter().zip(&all).map(|(x, y)| f64::from(x[0] - y[0]).powi(2));
        squares.sum::<f64>() / all.len() as f64
    };
    // The halves' noise is a hundredth of what the variance says, then all of it.
    let (stratified, independent) = (changed(0.1 * 0.08f32.sqrt()), changed(0.08f32.sqrt()));
    // A texture that is lost changes pixels by its variance, 0.01.
    assert!(stratified < 0.001, "{stratified}: the texture is lost");
    // Stein's estimate leaves a fifth of the light as it is: light and noise have 1.25 times the variance.
    assert!(independent > 0.04 / 2.0, "{independent}: noise is kept");
}

/// An edge between regions whose intervals do not overlap keeps every pixel on its side; one that noise explains does
/// not.
#[kernel_test("PENUMBRA_DEVICE")]
fn edges_beyond_noise_stay(gpu: &Gpu) {
    const SIZE: usize = 32;
    let mut random = Random(19);
    // Twenty standard deviations apart.
    let mut side = |x: usize| if x < SIZE / 2 { 1.0 } else { 2.0 } + 0.05 * random.normal() as f32;
    let got = Input::plane(SIZE, SIZE, 16).light(|x, _| side(x), 0.0025).red(gpu);
    for (i, value) in got.iter().enumerate() {
        let side = if i % SIZE < SIZE / 2 { 1.0 } else { 2.0 };
        // As far as noise goes in a thousand pixels.
        assert!((value - side).abs() < 4.0 * 0.05, "pixel {i}: {value}");
    }
    let blurred = Input::plane(SIZE, SIZE, 16).light(|x, _| if x < SIZE / 2 { 1.0 } else { 2.0 }, 4.0).red(gpu);
    assert!((blurred[SIZE / 2] - 2.0).abs() > 0.1, "an edge within noise is kept: {}", blurred[SIZE / 2]);
}

/// A firefly changes no other pixel by more than noise does, although its own variance would allow any difference. Nor
/// do two fireflies in one window, although each is among the other's neighbours.
#[kernel_test("PENUMBRA_DEVICE")]
fn a_firefly_does_not_spread(gpu: &Gpu) {
    const SIZE: usize = 32;
    let mut random = Random(20);
    let calm = Input::plane(SIZE, SIZE, 64).light(|_, _| 1.0 + 0.05 * random.normal() as f32, 0.0025);
    let before = calm.red(gpu);
    let first = 16 * SIZE + 16;
    for fireflies in [&[first][..], &[first, first + SIZE + 2]] {
        let mut struck = calm.clone();
        for firefly in fireflies {
            // A single sample of 64 has all of the light.
            struck.planes[DIRECT][*firefly] = [50.0; 3];
            struck.planes[DIRECT_VARIANCE][*firefly] = [2500.0; 3];
        }
        let after = struck.red(gpu);
        let change = |i: usize| if fireflies.contains(&i) { 0.0 } else { (before[i] - after[i]).abs() };
        let worst = (0..SIZE * SIZE).map(change).fold(0.0, f64::max);
        // Spread over a window one would be 50 / 121.
        assert!(worst < 4.0 * 0.05, "{} fireflies: {worst}", fireflies.len());
    }
}

/// A result depends on no row farther than [`REACH`] away, and on those nearer.
#[kernel_test("PENUMBRA_DEVICE")]
fn results_come_from_within_reach(gpu: &Gpu) {
    let input = scenery(20, 40, 4);
    let mut other = input.clone();
    for i in 0..20 {
        other.planes[DIRECT][i] = [0.7; 3];
        other.planes[POSITION][i] = [i as f32, 0.3, 0.0];
    }
    let (a, b) = (input.run(gpu), other.run(gpu));
    let last = (0..a.len()).rfind(|i| a[*i] != b[*i]).unwrap() / 20;
    assert!(last as u32 <= REACH, "row {last}");
    assert!(last >= 10, "row {last}: the change reaches no farther than one window");
}

/// Sizes and values at the ends: none, black, one pixel, huge, tiny, not finite.
#[kernel_test("PENUMBRA_DEVICE")]
fn extremes_are_kept(gpu: &Gpu) {
    assert!(Input::plane(0, 0, 16).filter(gpu).is_empty());
    assert!(Input::plane(5, 0, 16).filter(gpu).is_empty());
    assert!(Input::plane(9, 9, 16).filter(gpu).iter().all(|colour| *colour == [0.0; 3]));
    for samples in [0, 1, 16] {
        let one = Input::plane(1, 1, samples).light(|_, _| 0.3, 0.1).filter(gpu)[0][0];
        // The product of a power of two with a number, and its quotient by the weight.
        assert!((one - 0.3).abs() < 1e-6, "{samples} samples: {one}");
    }
    // Scaled light is scaled output, up to what rounding does to weights near a threshold.
    let plain = scenery(21, 17, 16);
    let expected = plain.filter(gpu);
    for factor in [1e-12f32, 1e12] {
        let mut scaled = plain.clone();
        scaled.planes[..4].iter_mut().enumerate().for_each(|(k, plane)| {
            let factor = if k % 2 == 0 { factor } else { factor * factor };
            plane.iter_mut().flatten().for_each(|value| *value *= factor);
        });
        let got = scaled.filter(gpu);
        let worst = (got.iter().flatten().zip(expected.iter().flatten()))
            .map(|(g, e)| f64::from((g / factor - e).abs()))
            .fold(0.0, f64::max);
        assert!(worst < 5e-3, "times {factor}: {worst}");
    }
    // Samples that say nothing stay as they are, and stay where they are.
    let mut odd = plain.clone();
    for (i, value) in [(40, f32::NAN), (120, f32::INFINITY), (200, 1e30)] {
        odd.planes[DIRECT][i] = [value, 1.0, 1.0];
    }
    odd.planes[POSITION][250] = [f32::NAN; 3];
    odd.planes[NORMAL][251] = [f32::INFINITY; 3];
    let got = odd.filter(gpu);
    assert!(got[40][0].is_nan() && got[120][0] == f32::INFINITY && got[200][0] >= 1e30);
    let others = (0..got.len()).filter(|i| ![40, 120, 200].contains(i));
    let worst = others.map(|i| got[i].into_iter().fold(0.0, |a: f32, b| if b.is_finite() { a.max(b) } else { b }));
    // The brightest pixel has a firefly of 20 in each of two lights; a value of 1e30 that spreads is far above 60.
    assert!(worst.fold(0.0, |a: f32, b| if b.is_finite() { a.max(b) } else { f32::INFINITY }) < 60.0);
}
