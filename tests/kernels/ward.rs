//! Pass `ward` against Ward's procedure in f64, from the same visibilities.

use glam::{DVec3, Vec3};
use kernel_kit::{Gpu, kernel_test};
use penumbra::internal::kernels::{Class, Classified, INVALID_POINT, Queue};
use penumbra::internal::passes::classify::ClassifyBuffers;
use penumbra::internal::passes::ward::{Ward, WardBuffers, WardParameters};
use penumbra::internal::passes::{Point, Tile, TileBuffers};
use penumbra::internal::scene::{LightKind, Scene};
use penumbra::internal::specialisation::features::Feature;
use penumbra::settings::Technique;

use crate::kit::published;
use crate::light::{Corners, square};
use crate::octahedral::oct_encode;
use crate::path::{camera, scene, surface};
use crate::random::{Random, RandomInput as _};
use crate::stage::{Stage, hash1, whole};

/// More lights than one dispatch of `order` processes.
const LIGHTS: usize = 70;
/// Light points requested; point lights take one.
const ASKED: u32 = 2;
const SAMPLES: u32 = 1;
const ALBEDO: f32 = 0.6;

/// A point light.
pub struct Lamp {
    pub position: DVec3,
    pub intensity: f64,
}

fn lamps() -> Vec<Lamp> {
    let mut random = Random(11);
    let mut lamp = || {
        let p = random.point();
        Lamp { position: DVec3::new(0.5 * p.x, 0.3 + 0.2 * p.y, 0.5 * p.z).as_vec3().as_dvec3(), intensity: 0.0 }
    };
    let mut lamps: Vec<Lamp> = (0..LIGHTS).map(|_| lamp()).collect();
    // From one to a thousand.
    lamps.iter_mut().enumerate().for_each(|(i, lamp)| {
        lamp.intensity = f64::from((10.0f64).powf(3.0 * (i * 37 % LIGHTS) as f64 / LIGHTS as f64) as f32);
    });
    // One below the floor, and one that sends nothing.
    lamps[5].position.y = -0.6;
    lamps[66].intensity = 0.0;
    lamps
}

/// A floor under lamps.
pub fn lit_floor(floor: Vec<Corners>, albedo: f32, lamps: &[Lamp]) -> Scene {
    let punctual = |lamp: &Lamp| LightKind::Point {
        position: lamp.position.as_vec3(),
        intensity: Vec3::splat(lamp.intensity as f32),
        range: f32::INFINITY,
    };
    scene(&[(floor, surface(albedo, 0.0))], lamps.iter().map(punctual).collect())
}

fn room(lamps: &[Lamp]) -> Scene {
    let floor = square(DVec3::new(0.0, -0.5, 0.0), DVec3::Z * 0.6, DVec3::X * 0.6);
    lit_floor(floor, ALBEDO, lamps)
}

/// The visibility bits of a candidate: random, with a different probability for each light.
fn bits(candidate: u32, points: u32) -> u32 {
    let (light, word) = (candidate / points, hash1(candidate));
    // Bits beyond a light's light points are not used.
    let of = |j: u32| u32::from((word >> (8 * j) & 255) < 40 + 3 * light) << j;
    (0..ASKED).map(of).sum()
}

/// Light points of a candidate that its shadow rays reached.
fn reached(candidate: u32, points: u32) -> f64 {
    f64::from((bits(candidate, points) & ((1 << SAMPLES) - 1)).count_ones())
}

/// The procedure's result at one point: the tested lights, the estimates for the others, and whether a decision or the
/// order depends on rounding.
struct Expected {
    tested: Vec<bool>,
    estimates: Vec<f64>,
    doubtful: bool,
}

fn by_hand(point: &Point, index: u32, points: u32, lamps: &[Lamp], rates: &[[f64; 2]], tolerance: f64) -> Expected {
    let position = Vec3::from(point.position).as_dvec3();
    let potential = |lamp: &Lamp| {
        let offset = lamp.position - position;
        let cosine = (offset.y / offset.length()).max(0.0);
        f64::from(ALBEDO) / std::f64::consts::PI * lamp.intensity * cosine / offset.length_squared()
    };
    let mut list: Vec<(f64, usize)> = lamps.iter().map(potential).zip(0..).filter(|(p, _)| *p > 0.0).collect();
    list.sort_by(|a, b| b.0.total_cmp(&a.0));
    let mut doubtful = false;
    let mut rest: f64 = list.iter().map(|(p, _)| p).sum();
    let (mut found, mut visible, mut expected) = (0.0, 0.0, 0.0);
    let mut tested = vec![false; lamps.len()];
    let rate = |light: usize| rates[light][0] / rates[light][1];
    for (rank, (p, light)) in list.iter().enumerate() {
        // Both sums are of keys, which lose up to 2^-12 of a potential, 2.4e-4; f32 rounds sums of 70 by less.
        doubtful |= rest > 0.0 && (rest - tolerance * found).abs() < 2e-3 * rest;
        if rest < tolerance * found {
            // Keys keep twelve bits of a potential, so the order of two similar potentials is not tested.
            doubtful |= list[rank - 1].0 < p * (1.0 + 1e-3);
            break;
        }
        tested[*light] = true;
        rest = (rest - p).max(0.0);
        let share = reached(*light as u32 * points + index, points) / f64::from(SAMPLES);
        found += p * share;
        visible += share;
        expected += rate(*light);
    }
    let here = if expected > 0.0 { visible / expected } else { 0.5 };
    let listed: Vec<usize> = list.iter().map(|(_, light)| *light).collect();
    let estimate = |light| if listed.contains(&light) { (here * rate(light)).min(1.0) } else { 0.0 };
    Expected { estimates: (0..lamps.len()).map(estimate).collect(), tested, doubtful }
}

/// Two tiles in sequence: at every point the pass tests exactly the lights that Ward's procedure tests, and estimates
/// the rest as it does. The second tile uses the statistics of the first. Another tolerance is detected.
#[kernel_test("PENUMBRA_DEVICE")]
fn lights_are_tested_as_ward_does(gpu: &Gpu) {
    let lamps = lamps();
    let view = camera(DVec3::new(0.0, 0.0, 2.0), DVec3::NEG_Z, 1.0);
    let stage = Stage::new(gpu, room(&lamps), &view, [65, 3], Technique::WARD_ADAPTIVE, |features| features);
    assert!(stage.features.has(Feature::Ward));
    let tile: Tile = whole([65, 3], 1);
    let count = tile.point_count;
    let mut random = Random(4);
    let mut points: Vec<Point> = (0..count)
        .map(|_| {
            let p = random.point();
            let position = DVec3::new(0.58 * p.x, -0.5, 0.58 * p.z);
            Point { position: position.as_vec3().to_array(), normal: oct_encode(DVec3::Y) }
        })
        .collect();
    points[64].normal = INVALID_POINT;
    let normal = f32::from_bits(oct_encode(DVec3::Y));
    let mut buffers = TileBuffers::new(gpu, &stage.features, count, false).unwrap();
    buffers.points = published(gpu, "test/points", &points);
    buffers.surfaces = published(gpu, "test/surfaces", &vec![[ALBEDO, ALBEDO, ALBEDO, normal]; count as usize]);
    let candidates = count * LIGHTS as u32;
    let visible: Vec<u32> = (0..candidates).map(|candidate| bits(candidate, count)).collect();
    let visibility = gpu.upload("test/visibility", &visible).unwrap();

    for tolerance in [0.0f32, 0.1, 1.0] {
        let mut classify = ClassifyBuffers::new(gpu, candidates).unwrap();
        classify.classes = gpu.poisoned::<u32>("test/classes", candidates as usize).unwrap();
        let own = WardBuffers::new(gpu, count, LIGHTS as u32).unwrap();
        let pass = Ward::new(gpu, &stage.features, &stage.gpu_scene.constants()).unwrap();
        let bound = pass.bind(gpu, &buffers, &classify, &visibility, &own, &stage.gpu_scene).unwrap();
        let mut rates = vec![[1.0f64; 2]; LIGHTS];
        for round in 0..2 {
            let parameters = WardParameters {
                tile,
                light_count: LIGHTS as u32,
                light_samples: ASKED,
                visibility_words: 1,
                tolerance,
                ..WardParameters::default()
            };
            let mut frame = gpu.frame("test");
            // In the order of `src/techniques/ward_adaptive.rs`. The visibilities are there: nothing is traced.
            bound.order(&mut frame, &parameters);
            (0..LIGHTS).for_each(|_| bound.next(&mut frame, &classify, &parameters));
            bound.estimate(&mut frame, &parameters);
            bound.learn(&mut frame, &parameters);
            frame.submit().unwrap();
            let words: Vec<u32> = gpu.read(&classify.classes, candidates as usize).unwrap();
            let is_tested =
                |light: usize, i: usize| Classified::new(words[light * count as usize + i]).class == Class::Unknown;
            let (mut tests, mut doubtful, mut blind) = (0, 0, 0);
            for (i, point) in points.iter().enumerate() {
                let of = |tolerance| by_hand(point, i as u32, count, &lamps, &rates, f64::from(tolerance));
                let expected = of(tolerance);
                if point.normal == INVALID_POINT {
                    assert!((0..LIGHTS).all(|light| words[light * count as usize + i] == Class::Dark as u32));
                    continue;
                }
                if expected.doubtful && tolerance > 0.0 {
                    doubtful += 1;
                    continue;
                }
                for (light, lamp) in lamps.iter().enumerate() {
                    let got = Classified::new(words[light * count as usize + i]);
                    let what = format!("tolerance {tolerance}, round {round}, point {i}, light {light}: {got:?}");
                    if lamp.position.y < -0.5 || lamp.intensity == 0.0 {
                        assert_eq!(got.class, Class::Dark, "{what}");
                    } else if expected.tested[light] {
                        assert_eq!(got.class, Class::Unknown, "{what}");
                    } else {
                        assert_eq!(got.class, Class::Boundary, "{what}");
                        let estimate = expected.estimates[light];
                        // Half a step of eleven bits.
                        assert!((f64::from(got.visibility) - estimate).abs() < 0.6 / 2047.0, "{what}, {estimate}");
                    }
                }
                let number = expected.tested.iter().filter(|tested| **tested).count();
                tests += number;
                let other = of(tolerance * 1.5);
                blind += usize::from(other.tested.iter().filter(|tested| **tested).count() == number);
            }
            // The statistics include all tests, also those of undecided points.
            for (light, rate) in rates.iter_mut().enumerate() {
                for i in (0..points.len()).filter(|i| is_tested(light, *i)) {
                    rate[0] += reached(light as u32 * count + i as u32, count);
                    rate[1] += f64::from(SAMPLES);
                }
            }
            let learnt: Vec<u32> = own.rates(gpu).unwrap();
            assert!(learnt.iter().map(|n| f64::from(*n)).eq(rates.iter().flatten().copied()), "{learnt:?}");
            println!("tolerance {tolerance}: {tests} tests of {} points, {doubtful} in doubt", points.len());
            let all = (LIGHTS - 2) * (points.len() - 1);
            let checked = points.len() - 1 - doubtful;
            match tolerance {
                0.0 => assert_eq!(tests, all),
                _ => {
                    assert!(checked * 2 > points.len() && tests < all / 2, "{checked} checked, {tests} tests");
                    assert!(blind * 2 < checked, "half as much more tolerance changes nothing at {blind} of {checked}");
                }
            }
        }
        let lengths: Vec<u32> = gpu.read(&classify.queue_lengths, Queue::COUNT).unwrap();
        let last: Vec<u32> = gpu.read(&classify.boundary_queue, lengths[Queue::Boundary as usize] as usize).unwrap();
        assert!(last.len() <= points.len());
    }
}
