//! Pass `shadow` against f64 lines to the same light points.

use glam::{DVec3, Vec3};
use kernel_kit::{Gpu, POISON, kernel_test};
use penumbra::internal::kernels::Class;
use penumbra::internal::passes::grid::Photon;
use penumbra::internal::passes::shadow::{Repairs, Shadow, ShadowBuffers, ShadowParameters};
use penumbra::internal::passes::{Point, Tile, TileBuffers};
use penumbra::internal::scene::{LightKind, Scene};
use penumbra::internal::specialisation::features::Feature;
use penumbra::internal::statistics::Counter;
use penumbra::settings::Technique;

use crate::kit::published;
use crate::light::square;
use crate::octahedral::{oct_decode, oct_encode};
use crate::path::{camera, scene, surface};
use crate::random::{Random, RandomInput as _};
use crate::stage::{Candidates, LightPoint, Stage, whole};

/// Initial value of the counters: kernels add to them.
const BEFORE: u32 = 1000;

const LIT: u32 = Class::Lit as u32;
const SHADOWED: u32 = Class::Shadowed as u32;
const BOUNDARY: u32 = Class::Boundary as u32;

/// A floor, two panels over it, a panel above the lights, and lights of every kind.
fn room() -> Scene {
    let level = |x: f64, y: f64, z: f64, half: f64| square(DVec3::new(x, y, z), DVec3::Z * half, DVec3::X * half);
    let down = |x: f64, y: f64, z: f64, half: f64| square(DVec3::new(x, y, z), DVec3::X * half, DVec3::Z * half);
    let plain = surface(0.5, 0.0);
    let above = [
        level(0.0, -0.5, 0.0, 0.6),
        level(-0.2, -0.1, 0.1, 0.2),
        level(0.3, 0.0, -0.2, 0.15),
        level(0.1, 0.6, 0.0, 0.3),
    ];
    let meshes = [(above.concat(), plain), (down(0.0, 0.45, 0.0, 0.2), surface(0.0, 3.0))];
    let position = Vec3::new(0.15, 0.4, 0.1);
    let direction = Vec3::new(0.2, -1.0, -0.3).normalize();
    let intensity = Vec3::ONE;
    let punctual = vec![
        LightKind::Point { position, intensity, range: f32::INFINITY },
        LightKind::Spot { position, direction, intensity, cos_inner: 0.95, cos_outer: 0.8, range: 3.0 },
        LightKind::Directional { direction, irradiance: Vec3::ONE },
    ];
    scene(&meshes, punctual)
}

/// Points on the floor and on the panels, facing up; every seventh faces down.
fn points(count: usize) -> Vec<Point> {
    let mut random = Random(21);
    let point = |i: usize| {
        let p = random.point();
        let position = match i % 5 {
            0 => DVec3::new(-0.2 + 0.19 * p.x, -0.1, 0.1 + 0.19 * p.z),
            1 => DVec3::new(0.3 + 0.14 * p.x, 0.0, -0.2 + 0.14 * p.z),
            _ => DVec3::new(0.58 * p.x, -0.5, 0.58 * p.z),
        };
        let normal = if i % 7 == 3 { DVec3::NEG_Y } else { DVec3::Y };
        Point { position: position.as_vec3().to_array(), normal: oct_encode(normal) }
    };
    (0..count).map(point).collect()
}

/// A run of one of the two entries, or both.
struct Setup {
    candidates: Candidates,
    repair_capacity: u32,
}

struct Outcome {
    visibility: Vec<u32>,
    counters: Vec<u32>,
    repair_photons: Vec<Photon>,
    repair_count: u32,
}

/// More photons than any test here adds.
const REPAIR_ROOM: usize = 2000;

impl Setup {
    fn new(gpu: &Gpu, chunk: [u32; 2], samples: u32) -> Setup {
        let view = camera(DVec3::new(0.0, 0.0, 2.0), DVec3::NEG_Z, 1.0);
        let stage = Stage::new(gpu, room(), &view, [65, 2], Technique::SHADOW_PHOTONS, |features| {
            // Fine cells are tested on their own.
            features.with(Feature::FineCells, false)
        });
        // Two later samples of each pixel.
        let tile = Tile { first_sample: 5, ..whole([65, 2], 2) };
        let points = points(tile.point_count as usize);
        Setup { candidates: Candidates { stage, tile, points, chunk, samples }, repair_capacity: 0 }
    }

    /// Whether a ray is traced to the light point.
    fn traced(&self, candidate: usize, sampled: &LightPoint) -> bool {
        let normal = oct_decode(self.candidates.points[candidate % self.candidates.points.len()].normal, 16);
        sampled.pdf > 0.0 && sampled.direction.dot(normal) > 0.0
    }

    fn run(&self, gpu: &Gpu, classes: &[u32], boundary: &[u32], audits: &[u32]) -> Outcome {
        let Stage { features, gpu_scene, .. } = &self.candidates.stage;
        let pass = Shadow::new(gpu, features, &gpu_scene.constants()).unwrap();
        let mut tile = TileBuffers::new(gpu, features, self.candidates.tile.point_count, false).unwrap();
        tile.points = published(gpu, "test/points", &self.candidates.points);
        tile.counters = gpu.upload("test/counters", &[BEFORE; Counter::COUNT]).unwrap();
        let classes = gpu.upload("test/classes", classes).unwrap();
        let boundary_queue = gpu.upload("test/boundary", boundary).unwrap();
        let audit_queue = gpu.upload("test/audits", audits).unwrap();
        let lengths = [0, boundary.len() as u32, audits.len() as u32, 0, 0];
        let queue_lengths = gpu.upload("test/lengths", &lengths).unwrap();
        let words = self.candidates.count() * self.candidates.words();
        let visibility = gpu.poisoned::<u32>("test/visibility", words).unwrap();
        let repairs = Repairs::new(gpu, REPAIR_ROOM as u32).unwrap();
        gpu.write(&repairs.photons, &vec![POISON; 4 * REPAIR_ROOM]);
        let buffers = ShadowBuffers {
            classes: &classes,
            boundary_queue: &boundary_queue,
            audit_queue: &audit_queue,
            queue_lengths: &queue_lengths,
            visibility: &visibility,
            repairs: Some(&repairs),
        };
        let bound = pass.bind(gpu, &tile, &buffers, gpu_scene).unwrap();
        let groups = |queue: &[u32]| (queue.len() as u32).div_ceil(pass.workgroup_size());
        let arguments = gpu.upload("test/arguments", &[groups(boundary), 1, 1, groups(audits), 1, 1]).unwrap();
        let parameters = ShadowParameters {
            tile: self.candidates.tile,
            first_light: self.candidates.chunk[0],
            light_samples: self.candidates.samples,
            visibility_words: self.candidates.words() as u32,
            repair_capacity: self.repair_capacity,
        };
        let mut frame = gpu.frame("test");
        bound.trace(&mut frame, &arguments, 0, &parameters);
        bound.audit(&mut frame, &arguments, 12, &parameters);
        frame.submit().unwrap();
        Outcome {
            visibility: gpu.read(&visibility, words).unwrap(),
            counters: gpu.read(&tile.counters, Counter::COUNT).unwrap(),
            repair_photons: gpu.read(&repairs.photons, REPAIR_ROOM).unwrap(),
            repair_count: gpu.read(&repairs.count, 1).unwrap()[0],
        }
    }
}

fn counts(added: &[(Counter, u32)]) -> Vec<u32> {
    let mut counters = vec![BEFORE; Counter::COUNT];
    added.iter().for_each(|(counter, count)| counters[*counter as usize] += count);
    counters
}

/// Each queued candidate gets the bits of its light points, other candidates are not changed, and each ray is counted.
#[kernel_test("PENUMBRA_DEVICE")]
fn visibility_bits_are_those_of_the_light_points(gpu: &Gpu) {
    for (chunk, samples) in [([0, 4], 33), ([1, 2], 1), ([0, 1], 32), ([0, 2], 70)] {
        let setup = Setup::new(gpu, chunk, samples);
        let light_points = setup.candidates.light_points(gpu);
        let visible: Vec<Vec<Option<bool>>> = light_points
            .iter()
            .enumerate()
            .map(|(candidate, sampled)| {
                let own = setup.candidates.own_samples(candidate);
                let bit = |(j, p): (usize, &LightPoint)| {
                    let traced = j < own && setup.traced(candidate, p);
                    if traced { p.visible(&setup.candidates.stage.scene) } else { Some(false) }
                };
                sampled.iter().enumerate().map(bit).collect()
            })
            .collect();
        let candidates = setup.candidates.count();
        let mut order: Vec<u32> = (0..candidates as u32).collect();
        // Any order will do; the last candidates are not queued.
        order.sort_by_key(|candidate| candidate.wrapping_mul(0x9e37_79b9) >> 8);
        for length in [0, 1, 63, 64, 65, candidates - 5] {
            let queue = &order[..length];
            let outcome = setup.run(gpu, &vec![3; candidates], queue, &[]);
            let words = setup.candidates.words();
            let bit =
                |candidate: u32, j: usize| outcome.visibility[candidate as usize * words + j / 32] >> (j % 32) & 1 == 1;
            // Number of bits that differ from those of the candidate given by `of`.
            let different = |of: &dyn Fn(u32) -> u32| -> usize {
                let differing = |candidate: &u32| {
                    let differs =
                        |j: &usize| visible[of(*candidate) as usize][*j].is_some_and(|v| v != bit(*candidate, *j));
                    (0..samples as usize).filter(differs).count()
                };
                queue.iter().map(differing).sum()
            };
            assert_eq!(different(&|candidate| candidate), 0, "{length} candidates of {samples} light points");
            if length > 65 {
                let others = different(&|candidate| (candidate + 1) % candidates as u32);
                assert!(others > length / 20, "the next candidate's light points give {others} differences");
                let doubtful = visible.iter().flatten().filter(|v| v.is_none()).count();
                assert!(doubtful * 200 <= candidates * samples as usize, "{doubtful} bits depend on rounding");
            }
            let mut queued = vec![false; candidates];
            queue.iter().for_each(|candidate| queued[*candidate as usize] = true);
            for (candidate, queued) in queued.iter().enumerate() {
                let found = &outcome.visibility[candidate * words..][..words];
                let past = found[words - 1].checked_shr(samples - 32 * (words as u32 - 1)).unwrap_or(0);
                if *queued {
                    assert_eq!(past, 0, "bits past the last light point of candidate {candidate}");
                } else {
                    assert!(found.iter().all(|word| *word == POISON), "candidate {candidate} was not queued");
                }
            }
            let traced = |candidate: u32| {
                let sampled = &light_points[candidate as usize][..setup.candidates.own_samples(candidate as usize)];
                sampled.iter().filter(|p| setup.traced(candidate as usize, p)).count() as u32
            };
            let visible_bits = |candidate: u32| (0..samples as usize).filter(|j| bit(candidate, *j)).count() as u32;
            let rays = queue.iter().map(|candidate| traced(*candidate)).sum();
            let is_mixed = |c: &&u32| visible_bits(**c) > 0 && visible_bits(**c) < traced(**c);
            let mixed: Vec<u32> = queue.iter().filter(is_mixed).map(|candidate| traced(*candidate)).collect();
            let expected = [
                (Counter::ShadowRays, rays),
                (Counter::PenumbraSeen, mixed.len() as u32),
                (Counter::PenumbraRays, mixed.iter().sum()),
            ];
            assert_eq!(outcome.counters, counts(&expected));
            assert_eq!((outcome.repair_count, outcome.repair_photons[0].word), (0, POISON));
        }
    }
}

/// An audit traces a ray to one light point. If the ray contradicts the class, it is counted and a photon of the other
/// kind is stored at the point, as long as there is room.
#[kernel_test("PENUMBRA_DEVICE")]
fn audits_find_wrong_classes_and_repair_the_map(gpu: &Gpu) {
    let mut setup = Setup::new(gpu, [0, 4], 33);
    let candidates = setup.candidates.count();
    let light_points = setup.candidates.light_points(gpu);
    let mut random = Random(4);
    let classes: Vec<u32> = (0..candidates)
        .map(|_| match (random.uniform() * 7.0) as u32 {
            0 => LIT | 2047 << 21,
            1 => LIT | 2046 << 21,
            2 => SHADOWED,
            3 => SHADOWED | 1 << 21,
            4 => LIT | 2045 << 21,
            5 => SHADOWED | 2 << 21,
            _ => BOUNDARY,
        })
        .collect();
    // Near boundaries by one step of the visibility, in settled cells by two.
    let near = |word: u32| matches!(word >> 21, 1 | 2046);
    let settled = |word: u32| matches!(word >> 21, 2 | 2045);
    for (length, capacity) in
        [(0, 10), (1, 10), (63, 0), (64, 10), (65, 10), (candidates - 5, 10), (candidates - 5, 2000)]
    {
        setup.repair_capacity = capacity;
        // From behind, so that the first candidates are not queued.
        let queue: Vec<u32> = (0..candidates as u32).rev().take(length).collect();
        let outcome = setup.run(gpu, &classes, &[], &queue);
        let mut expected_words = vec![POISON; candidates * setup.candidates.words()];
        let (mut rays, mut wrong, mut wrong_near, mut wrong_settled) = (0, 0, 0, 0);
        let mut repaired: Vec<([u32; 3], u32)> = Vec::new();
        let mut differences = [0, 0];
        // Boundaries that dilation made are left out.
        let audited = queue.iter().map(|candidate| *candidate as usize).filter(|at| classes[*at] != BOUNDARY);
        for candidate in audited {
            let got = outcome.visibility[candidate * setup.candidates.words()] == 1;
            let sampled = light_points[candidate].last().unwrap();
            let traced = setup.traced(candidate, sampled);
            // If the light point faces away, the class remains.
            let lit = classes[candidate] & 7 == LIT;
            let is_visible = if traced { sampled.visible(&setup.candidates.stage.scene).unwrap_or(got) } else { lit };
            let first = &light_points[candidate][0];
            differences[0] += usize::from(is_visible != got);
            differences[1] += usize::from(
                setup.traced(candidate, first) && first.visible(&setup.candidates.stage.scene) == Some(!got),
            );
            expected_words[candidate * setup.candidates.words()] = u32::from(is_visible);
            rays += u32::from(traced);
            if traced && is_visible != lit {
                wrong += 1;
                wrong_near += u32::from(near(classes[candidate]));
                wrong_settled += u32::from(settled(classes[candidate]));
                let point = &setup.candidates.points[candidate % setup.candidates.points.len()];
                // Up or down: the middle of x, and the last or the first of the 127 levels of y.
                let normal = if point.normal == oct_encode(DVec3::Y) { 63 | 126 << 7 } else { 63 };
                let light = (candidate / setup.candidates.points.len()) as u32;
                let kind = u32::from(!is_visible) << 31;
                repaired.push((point.position.map(f32::to_bits), normal | light << 14 | kind));
            }
        }
        assert!(outcome.visibility == expected_words, "{length} audits");
        let expected = [
            (Counter::AuditRays, rays),
            (Counter::AuditsWrong, wrong),
            (Counter::AuditsWrongNear, wrong_near),
            (Counter::AuditsWrongSettled, wrong_settled),
        ];
        assert_eq!(outcome.counters, counts(&expected), "{length} audits");
        assert_eq!(outcome.repair_count, wrong);
        let kept = wrong.min(capacity) as usize;
        let (photons, rest) = outcome.repair_photons.split_at(kept);
        assert!(
            rest.iter().all(|p| p.word == POISON && p.position.iter().all(|x| x.to_bits() == POISON)),
            "past the capacity"
        );
        // In any order, each expected photon at most once.
        repaired.sort_unstable();
        let mut photons: Vec<_> = photons.iter().map(|p| (p.position.map(f32::to_bits), p.word)).collect();
        photons.sort_unstable();
        if kept == wrong as usize {
            assert_eq!(photons, repaired);
        } else {
            photons.iter().for_each(|photon| assert!(repaired.binary_search(photon).is_ok(), "{photon:?}"));
            photons.dedup();
            assert_eq!(photons.len(), kept);
        }
        if length > 65 {
            let (near, settled) = (wrong_near, wrong_settled);
            assert!(wrong > 100 && near > 50 && settled > 50, "{wrong} wrong, {near} near, {settled} settled: no test");
            assert_eq!(differences[0], 0);
            assert!(differences[1] > 10, "the light points of shadow rays give {} differences", differences[1]);
        }
    }
}
