//! Pass `shade` against the estimator in f64, from the same class words, visibilities and light points; and the mean
//! of many estimates against the true direct light.

use std::f64::consts::{FRAC_1_PI, PI};

use glam::{DVec3, Vec3, Vec4};
use kernel_kit::{Frame, Gpu, POISON, kernel_test};
use penumbra::internal::kernels::{Class, INVALID_POINT, Queue};
use penumbra::internal::passes::classify::AuditProbabilities;
use penumbra::internal::passes::shade::{Shade, ShadeBuffers, ShadeParameters};
use penumbra::internal::passes::{Point, Tile, TileBuffers};
use penumbra::internal::scene::{LightKind, Material, Scene};
use penumbra::internal::specialisation::features::{Feature, Features};
use penumbra::internal::statistics::Counter;
use penumbra::settings::Technique;

use crate::kit::published;
use crate::light::{Corners, form_factor, sphere, square};
use crate::octahedral::{oct_decode, oct_encode};
use crate::path::{camera, scene, surface};
use crate::random::{Random, RandomInput as _};
use crate::stage::{Candidates, LightPoint, Stage, constant, hash, pixel_of, whole};
use crate::statistics::{mean_and_error, z_test};

const DARK: u32 = Class::Dark as u32;
const LIT: u32 = Class::Lit as u32;
const SHADOWED: u32 = Class::Shadowed as u32;
const BOUNDARY: u32 = Class::Boundary as u32;
const UNKNOWN: u32 = Class::Unknown as u32;

/// Planted faults that the comparison must detect.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Fault {
    None,
    /// Audits change nothing.
    Unaudited,
    /// Audits near boundaries have the same weights as elsewhere.
    Weight,
    /// The closed form is used without the correction by light points.
    Uncorrected,
    /// The closed form is used where the light crosses the surface's own horizon.
    Horizon,
    /// The light points are those of the next sample.
    Sample,
}

struct Setup {
    candidates: Candidates,
    /// Albedo and code of the shading normal.
    surfaces: Vec<[f32; 4]>,
    audit_probability: f32,
    kernels: Kernels,
}

struct Outcome {
    radiance: Vec<[f32; 4]>,
    shadow_samples: Vec<[f32; 4]>,
    /// Points that were queued for light points, in order; `None` if there is no queue.
    sampled: Option<Vec<u32>>,
    /// Points that were counted as having terms that do not follow from classes.
    sampled_count: u32,
    /// Points that were counted as not finite.
    not_finite: u32,
}

/// How the points are shaded: by one kernel, with a queue, or by the queue's kernel at once, and with light points in
/// place of missing closed forms beside the closed form or among the other terms.
#[derive(Clone, Copy, Debug)]
struct Kernels {
    few_sampled: bool,
    sampled_forms: bool,
    at_once: bool,
}

const ONE_KERNEL: Kernels = Kernels { few_sampled: false, sampled_forms: true, at_once: false };
const WITH_QUEUE: Kernels = Kernels { few_sampled: true, sampled_forms: true, at_once: false };
const ALL_QUEUED: Kernels = Kernels { few_sampled: true, sampled_forms: false, at_once: false };
const AT_ONCE: Kernels = Kernels { few_sampled: true, sampled_forms: true, at_once: true };

fn stage(gpu: &Gpu, scene: Scene, size: [u32; 2], kernels: Kernels) -> Stage {
    let view = camera(DVec3::new(0.0, 0.0, 2.0), DVec3::NEG_Z, 1.0);
    let features = |f: Features| {
        f.with(Feature::AovShadow, true)
            .with(Feature::FewSampled, kernels.few_sampled)
            .with(Feature::ClosedForms, true)
            .with(Feature::SmoothNormals, true)
            .with(Feature::SampledForms, kernels.sampled_forms)
    };
    Stage::new(gpu, scene, &view, size, Technique::SHADOW_PHOTONS, features)
}

impl Setup {
    fn run(&self, gpu: &Gpu, classes: &[u32], visibility: &[u32], before: &[[f32; 4]]) -> Outcome {
        let Stage { features, gpu_scene, .. } = &self.candidates.stage;
        let pass = Shade::new(gpu, features, &gpu_scene.constants()).unwrap();
        let mut tile = TileBuffers::new(gpu, features, self.candidates.tile.point_count, false).unwrap();
        tile.points = published(gpu, "test/points", &self.candidates.points);
        tile.surfaces = published(gpu, "test/surfaces", &self.surfaces);
        // One extra vector, which must not change.
        let radiance = [before, &[[f32::from_bits(POISON); 4]]].concat();
        tile.radiance_direct = gpu.upload("test/radiance", &radiance).unwrap();
        let classes = gpu.upload("test/classes", classes).unwrap();
        let visibility = gpu.upload("test/visibility", visibility).unwrap();
        let count = self.candidates.count() + 1;
        let samples = gpu.poisoned::<[f32; 4]>("test/shadow_samples", count).unwrap();
        let points = self.candidates.tile.point_count;
        let sampled_points = gpu.poisoned::<u32>("test/sampled_points", points as usize + 1).unwrap();
        let queue_lengths = gpu.upload("test/queue_lengths", &[POISON, POISON, POISON, 0, POISON]).unwrap();
        let buffers = ShadeBuffers {
            classes: &classes,
            visibility: &visibility,
            shadow_samples: Some(&samples),
            sampled_points: &sampled_points,
            queue_lengths: &queue_lengths,
        };
        let bound = pass.bind(gpu, &tile, &buffers, gpu_scene).unwrap();
        let audits = AuditProbabilities::of(self.audit_probability);
        let parameters = ShadeParameters {
            tile: self.candidates.tile,
            first_light: self.candidates.chunk[0],
            lights_in_chunk: self.candidates.chunk[1],
            light_samples: self.candidates.samples,
            visibility_words: self.candidates.words() as u32,
            audit_away: audits.away,
            audit_near: audits.near,
            at_once: self.kernels.at_once.into(),
        };
        let mut frame = gpu.frame("test");
        // As many workgroups as all points would need. Points that are not queued must not change.
        let mut arranged = false;
        let arguments = gpu.upload("test/arguments", &[0, points.div_ceil(64), 1, 1]).unwrap();
        let arrange = |_: &mut Frame<'_>, group: u32| {
            assert_eq!(group, 64);
            arranged = true;
        };
        bound.record(&mut frame, &parameters, arrange, (&arguments, 4));
        frame.submit().unwrap();
        let lengths: Vec<u32> = gpu.read(&queue_lengths, Queue::COUNT).unwrap();
        let mut queue: Vec<u32> = gpu.read(&sampled_points, points as usize + 1).unwrap();
        let rest = queue.split_off(lengths[Queue::Sampled as usize] as usize);
        assert!(rest.iter().all(|word| *word == POISON) && lengths[..3] == [POISON; 3], "past the queue");
        queue.sort_unstable();
        assert_eq!(arranged, self.kernels.few_sampled && !self.kernels.at_once);
        let mut radiance: Vec<[f32; 4]> = gpu.read(&tile.radiance_direct, radiance.len()).unwrap();
        let mut shadow_samples: Vec<[f32; 4]> = gpu.read(&samples, count).unwrap();
        for past in [radiance.pop(), shadow_samples.pop()] {
            assert_eq!(past.unwrap().map(f32::to_bits), [POISON; 4], "past the last point");
        }
        let counters: Vec<u32> = gpu.read(&tile.counters, Counter::COUNT).unwrap();
        let not_finite = counters[Counter::NotFiniteShade as usize];
        let sampled_count = counters[Counter::Sampled as usize];
        Outcome { radiance, shadow_samples, sampled: arranged.then_some(queue), sampled_count, not_finite }
    }

    fn normals(&self, i: usize) -> [DVec3; 2] {
        [self.candidates.points[i].normal, self.surfaces[i][3].to_bits()].map(|code| oct_decode(code, 16))
    }

    /// Unoccluded irradiance of a point from a light with a closed form, and whether all of the light is above the
    /// surface's own horizon.
    fn unshadowed(&self, light: u32, i: usize) -> (DVec3, bool) {
        let position = Vec3::from(self.candidates.points[i].position).as_dvec3();
        let [geometric, shading] = self.normals(i);
        match &self.candidates.stage.scene.lights[light as usize].kind {
            LightKind::Mesh { emitters, .. } => {
                let corners = |t: u32| -> Corners {
                    self.candidates.stage.scene.triangle_positions(t as usize).map(|p| p.as_dvec3())
                };
                let triangles: Vec<Corners> = emitters.iter().map(|e| corners(e.triangle)).collect();
                let factor = form_factor(&triangles, false, position, shading, true);
                let before = triangles.iter().flatten().all(|p| (p - position).dot(geometric) >= 0.0);
                (emitters[0].radiance.as_dvec3() * factor, before)
            }
            LightKind::Point { position: light_position, intensity, .. } => {
                let offset = light_position.as_dvec3() - position;
                let cosine = offset.normalize().dot(shading).max(0.0);
                (intensity.as_dvec3() * cosine / offset.length_squared(), offset.dot(geometric) >= 0.0)
            }
            _ => unreachable!("no such light in these tests"),
        }
    }

    /// Whether a candidate has terms besides those that follow from its class.
    fn is_sampled(&self, candidate: usize, word: u32, bits: u32) -> bool {
        let i = candidate % self.candidates.points.len();
        let light = self.candidates.chunk[0] + (candidate / self.candidates.points.len()) as u32;
        if self.candidates.points[i].normal == INVALID_POINT || word & 7 == DARK {
            return false;
        }
        let flat = self.candidates.points[i].normal == self.surfaces[i][3].to_bits();
        let closed = self.candidates.stage.gpu_scene.lights.lights[light as usize].closed_form
            && (flat || self.unshadowed(light, i).1);
        let decided = matches!(word & 7, LIT | SHADOWED);
        let queued_form = !closed && !self.candidates.stage.features.has(Feature::SampledForms);
        // An audit that agrees with the class adds nothing.
        let contradicted = (bits & 1 == 1) != (word & 7 == LIT) && self.is_audited(i, light, word, Fault::None);
        !decided || (word & 7 == LIT && queued_form) || contradicted
    }

    /// Whether a lit or shadowed candidate is audited.
    fn is_audited(&self, i: usize, light: u32, word: u32, fault: Fault) -> bool {
        let (seed, sample) = pixel_of(&self.candidates.tile, i);
        let uniform = f64::from(hash(&[seed, sample, constant("DIMENSION_AUDIT") + light]) >> 8) / 16_777_216.0;
        uniform < self.probability_of_audit(word, fault)
    }

    /// Sixteen times as large near boundaries, four times where cells are settled.
    fn probability_of_audit(&self, word: u32, fault: Fault) -> f64 {
        let more = match word >> 21 {
            _ if fault == Fault::Weight => 1.0,
            0 | 2047 => 1.0,
            2 | 2045 => 4.0,
            _ => 16.0,
        };
        f64::from(self.audit_probability) * more
    }

    /// Radiance and visibility of a candidate, and the sum of the magnitudes of all terms.
    fn estimate(
        &self,
        candidate: usize,
        word: u32,
        bits: &[u32],
        sampled: &[LightPoint],
        fault: Fault,
    ) -> (DVec3, f64, f64) {
        let i = candidate % self.candidates.points.len();
        let light = self.candidates.chunk[0] + (candidate / self.candidates.points.len()) as u32;
        let [geometric, shading] = self.normals(i);
        let brdf = Vec4::from_array(self.surfaces[i]).truncate().as_dvec3() * FRAC_1_PI;
        let contribution = |p: &LightPoint| {
            let cosine = p.direction.dot(shading);
            let reaches = p.pdf > 0.0 && cosine > 0.0 && p.direction.dot(geometric) > 0.0;
            if reaches { brdf * p.radiance * (cosine / p.pdf) } else { DVec3::ZERO }
        };
        let (class, a) = (word & 7, f64::from(word >> 21) / 2047.0);
        let granted = match class {
            DARK => return (DVec3::ZERO, 0.0, 0.0),
            LIT => 1.0,
            SHADOWED => 0.0,
            _ => f64::from(a > 0.5),
        };
        let decided = class == LIT || class == SHADOWED;
        let (mut radiance, mut size) = (DVec3::ZERO, 0.0);
        let mut add = |term: DVec3| {
            radiance += term;
            size += term.abs().element_sum();
        };
        let mut closed = self.candidates.stage.gpu_scene.lights.lights[light as usize].closed_form;
        if closed {
            let (irradiance, before) = self.unshadowed(light, i);
            closed =
                before || self.candidates.points[i].normal == self.surfaces[i][3].to_bits() || fault == Fault::Horizon;
            if closed {
                add(granted * brdf * irradiance);
            }
        }
        let audit = &sampled[self.candidates.samples as usize];
        let points = &sampled[..self.candidates.own_samples(candidate)];
        let bit = |j: usize| f64::from(bits[j / 32] >> (j % 32) & 1);
        for (j, point) in points.iter().enumerate() {
            let visible = if decided { granted } else { bit(j) };
            let taken = if closed && fault != Fault::Uncorrected { granted } else { 0.0 };
            add((visible - taken) * contribution(point) / points.len() as f64);
        }
        // The visible share of the light points that face the surface point and are above its horizon.
        let could_be_visible = |p: &LightPoint| p.pdf > 0.0 && p.direction.dot(geometric) > 0.0;
        let facing: Vec<usize> = (0..points.len()).filter(|j| could_be_visible(&points[*j])).collect();
        let visible = facing.iter().map(|j| bit(*j)).sum::<f64>() / facing.len().max(1) as f64;
        let mut visibility = if decided { granted } else { visible };
        if decided && fault != Fault::Unaudited && self.is_audited(i, light, word, fault) {
            let error = (bit(0) - granted) / self.probability_of_audit(word, fault).min(1.0);
            add(error * contribution(audit));
            visibility += error;
        }
        (radiance, visibility, size)
    }
}

/// A square light, a round one of too many edges for a closed form, and a point light.
fn lights() -> Scene {
    let emits = |emissive: Vec3| Material { emissive, ..surface(0.0, 0.0) };
    let flat = square(DVec3::new(0.1, 0.45, 0.0), DVec3::X * 0.15, DVec3::Z * 0.2);
    let round = sphere(DVec3::new(-0.3, 0.5, 0.2), 0.1, 8);
    let floor = square(DVec3::NEG_Y * 0.5, DVec3::Z * 0.5, DVec3::X * 0.5);
    let point = LightKind::Point {
        position: Vec3::new(0.3, 0.4, -0.3),
        intensity: Vec3::new(0.3, 0.2, 0.1),
        range: f32::INFINITY,
    };
    let meshes =
        [(floor, surface(0.5, 0.0)), (flat, emits(Vec3::new(1.0, 2.0, 4.0))), (round, emits(Vec3::new(3.0, 1.0, 2.0)))];
    scene(&meshes, vec![point])
}

/// A class word with counts of photons.
fn class_word(class: u32, illumination: u32, shadow: u32, visibility: u32) -> u32 {
    class | illumination << 3 | shadow << 12 | visibility << 21
}

/// A word of any class, in all variants that occur.
fn any_word(random: &mut Random) -> u32 {
    let mut below = |n: f64| (random.uniform() * n) as u32;
    let class = below(5.0);
    let [illumination, shadow, near, any] = [below(512.0), below(512.0), below(3.0), below(2048.0)];
    let visibility = match class {
        DARK => 0,
        LIT => 2047 - near,
        SHADOWED => near,
        _ => any,
    };
    class_word(class, illumination, shadow, visibility)
}

#[kernel_test("PENUMBRA_DEVICE")]
fn shading_follows_the_estimator(gpu: &Gpu) {
    let mut random = Random(31);
    let mut found = Vec::new();
    let cases = [
        (1, 1, [0, 3], 1, 0.25),
        (63, 1, [1, 2], 4, 0.02),
        (32, 2, [0, 3], 33, 0.03),
        (65, 3, [0, 3], 40, 0.25),
        (65, 3, [2, 1], 4, 0.0),
    ];
    let of_all_kernels =
        cases.into_iter().flat_map(|case| [ONE_KERNEL, WITH_QUEUE, ALL_QUEUED, AT_ONCE].map(|kernels| (case, kernels)));
    for ((width, samples_per_pixel, chunk, samples, audit_probability), kernels) in of_all_kernels {
        let of_row = whole([width, 1], samples_per_pixel);
        let tile = Tile { first_sample: u32::from(width == 32), height: 7, first_row: 6, ..of_row };
        let count = tile.point_count as usize;
        let mut points: Vec<Point> = Vec::new();
        let mut surfaces: Vec<[f32; 4]> = Vec::new();
        for i in 0..count {
            // Below all lights, facing anywhere.
            let p = random.point() * 0.45 - DVec3::Y * 0.15;
            let n = random.direction();
            let bent = (n + 0.4 * random.direction()).normalize();
            let normal = if i % 13 == 5 { INVALID_POINT } else { oct_encode(n) };
            let shading = if i % 2 == 0 { normal } else { oct_encode(bent) };
            let mut albedo = || random.uniform() as f32;
            surfaces.push([albedo(), albedo(), albedo(), f32::from_bits(shading)]);
            points.push(Point { position: p.as_vec3().to_array(), normal });
        }
        let setup = Setup {
            candidates: Candidates { stage: stage(gpu, lights(), [width, 7], kernels), tile, points, chunk, samples },
            surfaces,
            audit_probability,
            kernels,
        };
        let closed: Vec<bool> =
            setup.candidates.stage.gpu_scene.lights.lights.iter().map(|light| light.closed_form).collect();
        assert_eq!(closed, [true, false, true], "not the lights that the test is about");
        let classes: Vec<u32> = (0..setup.candidates.count()).map(|_| any_word(&mut random)).collect();
        let visibility: Vec<u32> = (0..setup.candidates.count() * setup.candidates.words())
            .map(|_| (random.uniform() * 4_294_967_296.0) as u32)
            .collect();
        let before: Vec<[f32; 4]> = (0..count).map(|_| [(); 4].map(|()| random.uniform() as f32)).collect();
        let outcome = setup.run(gpu, &classes, &visibility, &before);
        let is_sampled = |i: &u32| {
            let mut candidates = (*i as usize..classes.len()).step_by(count);
            let first_word = |candidate: usize| visibility[candidate * setup.candidates.words()];
            candidates.any(|candidate| setup.is_sampled(candidate, classes[candidate], first_word(candidate)))
        };
        let expected: Vec<u32> = (0..count as u32).filter(is_sampled).collect();
        let counted = if kernels.few_sampled { expected.len() } else { 0 };
        assert_eq!(outcome.sampled_count as usize, counted, "{kernels:?}");
        if let Some(sampled) = &outcome.sampled {
            assert_eq!(*sampled, expected);
            assert!(count < 64 || sampled.len() < count, "a queue of all points is none");
        }
        let light_points = setup.candidates.light_points(gpu);
        // Numbers of points, and of candidates of the AOV, that differ.
        let differences = |fault: Fault| -> [usize; 2] {
            let mut sums: Vec<(DVec3, f64)> = vec![(DVec3::ZERO, 0.0); count];
            let mut wrong = [0, 0];
            for (candidate, word) in classes.iter().enumerate() {
                let i = candidate % count;
                let got = outcome.shadow_samples[candidate];
                if setup.candidates.points[i].normal == INVALID_POINT {
                    wrong[1] += usize::from(got != [0.0; 4]);
                    continue;
                }
                let bits = &visibility[candidate * setup.candidates.words()..][..setup.candidates.words()];
                let of = if fault == Fault::Sample { (candidate + 1) % classes.len() } else { candidate };
                let (radiance, visible, size) = setup.estimate(candidate, *word, bits, &light_points[of], fault);
                sums[i].0 += radiance;
                sums[i].1 += size;
                let class = if pixel_of(&setup.candidates.tile, i).1 == 0 { word & 7 } else { 0 };
                let counts = [class, word >> 3 & 511, word >> 12 & 511].map(|v| v as f32);
                // A quotient of counts, and one by the audit probability: a few roundings of f32.
                let same = [got[0], got[2], got[3]] == counts
                    && (f64::from(got[1]) - visible).abs() <= 1e-5 * (1.0 + visible.abs());
                wrong[1] += usize::from(!same);
            }
            for (i, (sum, size)) in sums.iter().enumerate() {
                let [got, start] = [outcome.radiance[i], before[i]].map(|v| Vec4::from_array(v).as_dvec4());
                let error = (got.truncate() - start.truncate() - sum).abs().max_element();
                // Light points and the closed form use differences of coordinates of unit size, rounded by 6e-8, over
                // distances of a tenth; and f32 sums.
                wrong[0] += usize::from(!(error <= 5e-6 * (1.0 + size) && got.w == start.w));
            }
            wrong
        };
        assert_eq!(differences(Fault::None), [0, 0], "{width} x {samples_per_pixel}, chunk {chunk:?}, {kernels:?}");
        for fault in [Fault::Unaudited, Fault::Weight, Fault::Uncorrected, Fault::Horizon, Fault::Sample] {
            found.push((fault, differences(fault)[0]));
        }
    }
    for fault in [Fault::Unaudited, Fault::Weight, Fault::Uncorrected, Fault::Horizon, Fault::Sample] {
        let all: usize = found.iter().filter(|(f, _)| *f == fault).map(|(_, n)| n).sum();
        assert!(all > 5, "{fault:?}: {all} differences");
    }
}

/// A point whose light is not finite is counted once, whether by the closed form, by light points, by both or by their
/// sum. If it was not finite before, the earlier pass has counted it.
#[kernel_test("PENUMBRA_DEVICE")]
fn what_is_not_finite_is_counted_once(gpu: &Gpu) {
    const POINTS: usize = 64;
    let normal = oct_encode(DVec3::Y);
    let x_of = |i: usize| if i % 4 == 1 { f32::NAN } else { 0.01 * i as f32 - 0.3 };
    for kernels in [ONE_KERNEL, WITH_QUEUE, ALL_QUEUED, AT_ONCE] {
        let point = |i: usize| Point { position: [x_of(i), -0.4, 0.1], normal };
        let albedo = |i: usize| if i % 4 == 2 { f32::INFINITY } else { 0.5 };
        let setup = Setup {
            candidates: Candidates {
                stage: stage(gpu, lights(), [POINTS as u32, 1], kernels),
                tile: whole([POINTS as u32, 1], 1),
                points: (0..POINTS).map(point).collect(),
                chunk: [0, 3],
                samples: 4,
            },
            surfaces: (0..POINTS).map(|i| [albedo(i), 0.5, 0.5, f32::from_bits(normal)]).collect(),
            audit_probability: 1.0,
            kernels,
        };
        let classes = vec![class_word(BOUNDARY, 10, 10, 2047); setup.candidates.count()];
        let before = |i: usize| match i % 8 {
            3 => [f32::INFINITY, 0.0, 0.0, 0.0],
            6 => [0.0, f32::NAN, 0.0, 0.0],
            _ => [0.0; 4],
        };
        let before: Vec<_> = (0..POINTS).map(before).collect();
        let outcome = setup.run(gpu, &classes, &vec![0; setup.candidates.count()], &before);
        let is_finite = |v: &[f32; 4]| v[..3].iter().all(|x| x.is_finite());
        let expected = outcome.radiance.iter().zip(&before).filter(|(now, then)| is_finite(then) && !is_finite(now));
        let expected = expected.count() as u32;
        // A quarter of the points, and those of another quarter that were finite before.
        assert_eq!(expected, 3 * POINTS as u32 / 8, "the test is blind");
        assert_eq!(outcome.not_finite, expected, "{kernels:?}");
    }
}

/// The mean is the true direct light, whether the photons' classes are right or wrong (two-sided z-tests, Sidak's
/// correction).
#[kernel_test("PENUMBRA_DEVICE")]
fn shading_is_unbiased(gpu: &Gpu) {
    const SIDE: u32 = 128;
    const EDGE: f64 = 0.06;
    let position = DVec3::new(0.05, -0.5, 0.1);
    // A blocker halfway whose shadow's edge, visible from the point, crosses the light at x = EDGE.
    let end = position.x + (EDGE - position.x) * 0.5 / 0.95;
    let blocker = square(DVec3::new(0.5 * (end - 0.6), 0.0, 0.0), DVec3::Z * 0.6, DVec3::X * 0.5 * (end + 0.6));
    let lamp = |from: f64| {
        let centre = DVec3::new(0.5 * (from + 0.2), 0.45, 0.0);
        square(centre, DVec3::X * 0.5 * (0.2 - from), DVec3::Z * 0.2)
    };
    let meshes = [(blocker, surface(0.5, 0.0)), (lamp(-0.2), surface(0.0, 3.0))];
    let irradiance = |from: f64| 3.0 * form_factor(&lamp(from), false, position, DVec3::Y, true);
    let truth = 0.8 / PI * irradiance(EDGE);
    let unshadowed = 0.8 / PI * irradiance(-0.2);

    let tile = whole([SIDE, SIDE], 1);
    let count = tile.point_count as usize;
    let normal = oct_encode(DVec3::Y);
    let setup = Setup {
        candidates: Candidates {
            stage: stage(gpu, scene(&meshes, Vec::new()), [SIDE, SIDE], WITH_QUEUE),
            tile,
            points: vec![Point { position: position.as_vec3().to_array(), normal }; count],
            chunk: [0, 1],
            samples: 4,
        },
        surfaces: vec![[0.8, 0.8, 0.8, f32::from_bits(normal)]; count],
        audit_probability: 1.0 / 32.0,
        kernels: WITH_QUEUE,
    };
    let light_points = setup.candidates.light_points(gpu);
    let visible: Vec<Vec<bool>> = light_points
        .iter()
        .map(|sampled| sampled.iter().map(|p| p.visible(&setup.candidates.stage.scene).unwrap_or(true)).collect())
        .collect();
    let mut random = Random(17);
    let families: [(&str, &dyn Fn(u32) -> u32); 8] = [
        ("lit", &|_| class_word(LIT, 20, 0, 2047)),
        ("lit, near", &|_| class_word(LIT, 20, 0, 2046)),
        ("lit, settled", &|_| class_word(LIT, 20, 0, 2045)),
        ("shadowed", &|_| class_word(SHADOWED, 0, 20, 0)),
        ("shadowed, near", &|_| class_word(SHADOWED, 0, 20, 1)),
        ("boundary", &|any| class_word(BOUNDARY, 10, 10, any % 2048)),
        ("unknown", &|any| class_word(UNKNOWN, 0, 0, any % 2048)),
        ("any", &|any| match any % 4 {
            0 => class_word(LIT, 20, 0, 2045 + any / 4 % 3),
            1 => class_word(SHADOWED, 0, 20, any / 4 % 3),
            _ => class_word(BOUNDARY + any % 2, 3, 4, any / 4 % 2048),
        }),
    ];
    for (name, word) in families {
        let classes: Vec<u32> = (0..count).map(|_| word((random.uniform() * 1e9) as u32)).collect();
        let bits = |(word, visible): (&u32, &Vec<bool>)| match word & 7 {
            LIT | SHADOWED => u32::from(visible[setup.candidates.samples as usize]),
            _ => (0..setup.candidates.samples).map(|j| u32::from(visible[j as usize]) << j).sum(),
        };
        let visibility: Vec<u32> = classes.iter().zip(&visible).map(bits).collect();
        let outcome = setup.run(gpu, &classes, &visibility, &vec![[0.0; 4]; count]);
        let (mean, error) = mean_and_error(outcome.radiance.iter().map(|v| f64::from(v[0])));
        z_test(mean, error, truth, 7).unwrap_or_else(|e| panic!("{name}: {e}"));
        assert!(error < 0.15 * truth, "{name}: an error of {error} is no test of {truth}");
        for biased in [unshadowed, 0.0] {
            z_test(mean, error, biased, 7).expect_err(name);
        }
    }
}
