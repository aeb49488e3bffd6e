//! Pass `gather`: records whose rays find irradiance that is put there by hand, against closed forms of the light, of its
//! gradients and of the distances; and rays that are traced on, in furnaces.

use std::f64::consts::PI;

use glam::{DVec3, Vec3};
use penumbra::internal::gpu::buffer::{POISON, TableFormat, whole_rows};
use penumbra::internal::gpu::{Binding, Bindings, Buffer, Table};
use penumbra::internal::passes::gather::{Gather, GatherSettings, RecordHead};
use penumbra::internal::passes::grid::{Grid, Photon, SortedPhotons};
use penumbra::internal::passes::irradiance::place_grid;
use penumbra::internal::passes::{Point, TileBuffers};
use penumbra::internal::scene::{LightKind, Material, Scene};
use penumbra::internal::statistics::Counter;
use penumbra::settings::Technique;

use crate::irradiance::carrying;
use crate::kit::gpu;
use crate::light::{Corners, cube, form_factor, sphere, square};
use crate::path::{camera, inside_out, scene, surface};
use crate::rooms::point;
use crate::stage::{Stage, oct_encode};
use crate::statistics::{Random, mean_and_error, z_test};

/// Rays of a record, about.
const RAYS: u32 = 256;

/// Height of the image: a pixel's size, which bounds distances from below, is a few ten-thousandths.
const HEIGHT: u32 = 8192;

/// Places with irradiance that is known.
struct Known {
    places: SortedPhotons,
    table: Table,
    shape: Buffer,
}

impl Known {
    /// Irradiance of all channels and radius at positions with their normals.
    fn new(stage: &Stage, places: &[(DVec3, DVec3)], irradiance: f32, radius: f32) -> Known {
        let photons: Vec<Photon> = places.iter().map(|(p, n)| carrying(p.as_vec3(), n.as_vec3(), [0; 3])).collect();
        let shape = place_grid(((Vec3::splat(-1.0), Vec3::splat(1.0)), 1.0), photons.len() as u32);
        let buffer = gpu().upload("test/places", &photons).unwrap();
        let grid = Grid::sorting_only(gpu(), &stage.features).unwrap();
        // Nothing is in the way of look-ups anywhere in the disc.
        let disc = f32::from_bits(radius.to_bits() | 255);
        let values = vec![[irradiance, irradiance, irradiance, disc]; photons.len().max(1)];
        Known {
            places: grid.sort(gpu(), &buffer, photons.len() as u32, 1, shape).unwrap(),
            table: gpu().table("test/irradiances", &values, TableFormat::Float).unwrap(),
            shape: gpu().upload("test/shape", &[shape]).unwrap(),
        }
    }
}

impl Bindings for Known {
    fn get(&self, name: &str) -> Option<Binding<'_>> {
        match name {
            "irradiance_table" => Some((&self.table).into()),
            "irradiance_grid" => Some((&self.shape).into()),
            _ => self.places.get(name),
        }
    }
}

/// The radius of discs that hold two dozen of 20,000 places on a unit of area, so that no point is without one.
const NEAR: f32 = 0.022;

/// Places all over triangles, and their normals.
fn places_on(triangles: &[Corners], count: usize, random: &mut Random) -> Vec<(DVec3, DVec3)> {
    let across = |[a, b, c]: &Corners| (*b - *a).cross(*c - *a);
    let area: f64 = triangles.iter().map(|t| across(t).length()).sum();
    let mut places = Vec::new();
    for t in triangles {
        let share = (count as f64 * across(t).length() / area).ceil() as usize;
        places.extend((0..share).map(|_| {
            let (u, v) = (random.uniform(), random.uniform());
            let (u, v) = if u + v > 1.0 { (1.0 - u, 1.0 - v) } else { (u, v) };
            (t[0] + u * (t[1] - t[0]) + v * (t[2] - t[0]), across(t).normalize())
        }));
    }
    places
}

/// A scene for gathers; `bent` makes records keep rotational gradients.
fn stage(meshes: &[(Vec<Corners>, Material)], bent: bool) -> Stage {
    // Where no mesh is a light a far one is one, weak enough not to count: without any there is nothing to gather.
    let dim = LightKind::Point { position: Vec3::splat(50.0), intensity: Vec3::splat(1e-9), range: f32::INFINITY };
    let scene: Scene = scene(meshes, vec![dim]);
    let view = camera(DVec3::new(0.0, 0.3, 1.0), DVec3::NEG_Z, 1.0);
    Stage::new(scene, &view, [HEIGHT, HEIGHT], Technique::ShadowPhotons, |f| {
        let smooth = bent || f.has("smooth_normals");
        f.with("smooth_normals", smooth)
    })
}

/// A record as the kernels keep it.
#[derive(Clone, Debug, PartialEq)]
struct Record {
    head: RecordHead,
    /// By channel: gradient and irradiance.
    translation: [[f32; 4]; 3],
    rotation: Vec<[f32; 4]>,
}

impl Record {
    fn irradiance(&self) -> f64 {
        f64::from(self.translation[0][3])
    }

    fn along(&self, direction: DVec3) -> f64 {
        let [x, y, z, _] = self.translation[0].map(f64::from);
        DVec3::new(x, y, z).dot(direction)
    }

    fn about(&self, axis: DVec3) -> f64 {
        let [x, y, z, _] = self.rotation[0].map(f64::from);
        DVec3::new(x, y, z).dot(axis)
    }
}

struct Gathering<'a> {
    stage: &'a Stage,
    known: &'a Known,
    max_bounces: u32,
    /// Records that are there before.
    before: u32,
}

impl<'a> Gathering<'a> {
    fn new(stage: &'a Stage, known: &'a Known) -> Self {
        Gathering { stage, known, max_bounces: 64, before: 0 }
    }

    /// Gathers at the points `wanted` of those given, by each seed; the records and the rays that were traced on.
    fn run(&self, points: &[(DVec3, DVec3)], wanted: &[u32], seeds: std::ops::Range<u32>) -> (Vec<Vec<Record>>, u32) {
        let features = &self.stage.features;
        let vectors = if features.has("smooth_normals") { 6 } else { 3 };
        let mut tile = TileBuffers::new(gpu(), features, points.len() as u32, true).unwrap();
        let of_device: Vec<Point> = points.iter().map(|(p, n)| point(p.as_vec3(), n.as_vec3())).collect();
        let surfaces: Vec<[f32; 4]> =
            points.iter().map(|(_, n)| [0.5, 0.5, 0.5, f32::from_bits(oct_encode(*n))]).collect();
        tile.points = gpu().upload("test/points", &of_device).unwrap();
        tile.surfaces = gpu().upload("test/surfaces", &surfaces).unwrap();
        let count = (self.before as usize + wanted.len()) * vectors;
        let values = gpu().poisoned::<[f32; 4]>("test/values", whole_rows(count + 1)).unwrap();
        let pass = Gather::new(gpu(), features, &self.stage.gpu_scene.constants()).unwrap();
        let sets: [&dyn Bindings; 2] = [&self.stage.gpu_scene, self.known];
        let bound = pass.bind(gpu(), &tile, RAYS, &values, &sets).unwrap();
        let records = seeds.map(|seed| {
            let settings = GatherSettings { max_bounces: self.max_bounces, seed, height: HEIGHT };
            let heads = bound.gather(gpu(), wanted, self.before, settings).unwrap();
            let mut values: Vec<[f32; 4]> = gpu().read(&values, count + 1).unwrap();
            let first = self.before as usize * vectors;
            let others = values[..first].iter().chain(&values[count..]);
            assert!(others.flatten().all(|v| v.to_bits() == POISON), "values of other records are written");
            values.truncate(count);
            let values = values.split_off(first);
            assert!(values.iter().flatten().all(|v| v.is_finite()), "poison or worse in a record");
            let record = |(head, values): (&RecordHead, &[[f32; 4]])| Record {
                head: *head,
                translation: [values[0], values[1], values[2]],
                rotation: values[3..].to_vec(),
            };
            heads.iter().zip(values.chunks(vectors)).map(record).collect()
        });
        let records = records.collect();
        let counters: Vec<u32> = gpu().read(&tile.counters, Counter::COUNT).unwrap();
        assert_eq!(counters[Counter::Overrun as usize], 0);
        (records, counters[Counter::GatherRays as usize])
    }
}

const CEILING: f32 = 0.8;
const BRIGHT: f32 = 2.0;

fn ceiling() -> Vec<Corners> {
    square(DVec3::new(0.1, 0.3, 0.0), DVec3::X * 0.25, DVec3::Z * 0.2)
}

/// What a ceiling of known irradiance sends to a place.
fn from_ceiling(position: DVec3, normal: DVec3) -> f64 {
    f64::from(CEILING * BRIGHT) / PI * form_factor(&ceiling(), false, position, normal, true)
}

/// A floor under a bright ceiling: irradiance by Lambert's formula, and both gradients by its central differences. What the
/// gradients themselves may be off: strata are a ninth of the way to the horizon, and an edge of the ceiling moves as if it
/// were between two of them: a tenth of the largest. What a turn tells has no such edge: a fiftieth.
#[test]
fn records_are_closed_forms_of_a_ceiling() {
    let mut random = Random(1);
    let stage = stage(&[(ceiling(), surface(CEILING, 0.0))], true);
    let known = Known::new(&stage, &places_on(&ceiling(), 20_000, &mut random), BRIGHT, NEAR);
    let tilted = DVec3::new(0.3, 0.9, -0.2).normalize();
    let points = [
        (DVec3::new(0.1, 0.0, 0.0), DVec3::Y),
        (DVec3::new(-0.2, 0.0, 0.1), DVec3::Y),
        (DVec3::new(0.35, -0.1, -0.2), DVec3::Y),
        (DVec3::new(-0.1, 0.05, 0.0), tilted),
    ];
    const SEEDS: u32 = 256;
    let (by_seed, followed) = Gathering::new(&stage, &known).run(&points, &[0, 1, 2, 3], 0..SEEDS);
    assert_eq!(followed, 0);
    let of = |i: usize, what: &dyn Fn(&Record) -> f64| {
        let told: Vec<f64> = by_seed.iter().map(|records| what(&records[i])).collect();
        mean_and_error(told.iter().copied())
    };
    for (i, (position, normal)) in points.into_iter().enumerate() {
        let head = &by_seed[0][i].head;
        assert_eq!(Vec3::from(head.position), position.as_vec3());
        assert!(Vec3::from(head.normal).dot(normal.as_vec3()) > 1.0 - 1e-6);
        let (mean, error) = of(i, &|record| record.irradiance());
        let expected = from_ceiling(position, normal);
        println!("{i}: {:.4} +- {:.4}", mean / expected, error / expected);
        z_test(mean, error, expected, 4).unwrap();
        z_test(1.02 * mean, error, expected, 4).expect_err("two percent too much");
        assert!(by_seed[0][i].translation.iter().all(|v| v[3] == by_seed[0][i].translation[0][3]), "a grey scene");
        // Along the surface, and about axes in it.
        let across = normal.cross(DVec3::X).normalize();
        let axes = [across, across.cross(normal)];
        const STEP: f64 = 1e-4;
        let slopes = axes.map(|axis| {
            let at = |step: f64| from_ceiling(position + step * axis, normal);
            (at(STEP) - at(-STEP)) / (2.0 * STEP)
        });
        let turns = axes.map(|axis| {
            let at = |step: f64| from_ceiling(position, glam::DQuat::from_axis_angle(axis, step) * normal);
            (at(STEP) - at(-STEP)) / (2.0 * STEP)
        });
        let size = |values: [f64; 2]| values[0].hypot(values[1]);
        // In the middle both are nothing: a tenth of the irradiance, over the distance, is the scale there.
        let scales = [size(slopes).max(expected / 3.0), size(turns).max(expected * 0.1)];
        for k in 0..2 {
            let (slope, slope_error) = of(i, &|record| record.along(axes[k]));
            let (turn, turn_error) = of(i, &|record| record.about(axes[k]));
            println!(
                "  along {slope:.4} +- {slope_error:.4}, {:.4}; about {turn:.4} +- {turn_error:.4}, {:.4}",
                slopes[k], turns[k]
            );
            for (name, told, error, expected, scale) in [
                ("along", slope, slope_error + 0.1 / 4.0 * scales[0], slopes[k], scales[0]),
                ("about", turn, turn_error + 0.02 / 4.0 * scales[1], turns[k], scales[1]),
            ] {
                z_test(told, error, expected, 16).unwrap_or_else(|e| panic!("{i}, {name} {}: {e}", axes[k]));
                if expected.abs() > 0.5 * scale {
                    z_test(-told, error, expected, 16).expect_err("the other way");
                    z_test(1.3 * told, error, expected, 16).expect_err("three tenths too much");
                }
            }
        }
    }
}

/// Harmonic mean distances: in the middle of a sphere its radius, between wide planes 3/2 of their distance, as the mean of the
/// cosine is 2/3 there. Even light has no gradient.
#[test]
fn distances_are_harmonic_means() {
    let mut random = Random(2);
    let ball = inside_out(sphere(DVec3::ZERO, 0.4, 40));
    let planes = square(DVec3::Y * 0.01, DVec3::X * 0.5, DVec3::Z * 0.5);
    // The planes are nearer to each other than places elsewhere are.
    for (name, mesh, expected, count, radius) in
        [("sphere", ball, 0.4, 40_000, NEAR), ("planes", planes, 0.015, 400_000, 0.3 * NEAR)]
    {
        let stage = stage(&[(mesh.clone(), surface(0.5, 0.0))], false);
        let known = Known::new(&stage, &places_on(&mesh, count, &mut random), 1.0, radius);
        let (by_seed, followed) = Gathering::new(&stage, &known).run(&[(DVec3::ZERO, DVec3::Y)], &[0], 0..64);
        assert_eq!(followed, 0, "{name}: rays that found no place");
        if name == "sphere" {
            for records in &by_seed {
                // What facets send differs by the rounding of their normals' lengths.
                let nothing = |v: &[f32; 4]| v[..3].iter().all(|slope| slope.abs() < 1e-6 * v[3]);
                assert!(records[0].translation.iter().all(nothing), "{:?}", records[0]);
            }
        }
        let told = by_seed.iter().map(|records| 1.0 / f64::from(records[0].head.distance));
        let (mean, error) = mean_and_error(told);
        // Facets of the sphere are up to 0.3 % nearer than its radius; of the planes rays below 1.2 degrees, 0.04 % of the cosine's
        // weight, meet nothing.
        let error = error + 1e-3 / expected;
        z_test(mean, error, 1.0 / expected, 2).unwrap_or_else(|e| panic!("{name}: {e}"));
        z_test(1.05 * mean, error, 1.0 / expected, 2).expect_err("five percent too near");
    }
}

/// In a closed room that emits 1 and reflects a, light of bounces brings pi (a + a^2 + ...) to a wall, up to a^m for m bounces: by
/// places that tell it, by rays that are traced on where there is no place, and where places stand for discs that are wider than the
/// rays are long.
#[test]
fn furnaces_are_white() {
    const ALBEDO: f32 = 0.6;
    let mut random = Random(3);
    let walls = inside_out(cube(DVec3::ZERO, 0.5));
    let stage = stage(&[(walls.clone(), surface(ALBEDO, 1.0))], false);
    let a = f64::from(ALBEDO);
    let everywhere = places_on(&walls, 120_000, &mut random);
    let all = PI / (1.0 - a);
    let points = [(DVec3::new(0.1, -0.5, 0.2), DVec3::Y), (DVec3::new(-0.5, 0.45, 0.1), DVec3::X)];
    for (name, places, radius, max_bounces, follows) in [
        ("told", &everywhere[..], NEAR, 64, false),
        ("no place", &[], NEAR, 64, true),
        ("no place", &[], NEAR, 1, true),
        ("no place", &[], NEAR, 2, true),
        ("too wide", &everywhere[..], 1e3, 64, true),
    ] {
        let known = Known::new(&stage, places, all as f32, radius);
        let gathering = Gathering { max_bounces, ..Gathering::new(&stage, &known) };
        const SEEDS: u32 = 32;
        let (by_seed, rays) = gathering.run(&points, &[0, 1], 0..SEEDS);
        assert_eq!(rays > 0, follows, "{name}: {rays} rays");
        let expected = PI * (1..=max_bounces).map(|k| a.powi(k as i32)).sum::<f64>();
        let told = by_seed.iter().flatten().map(Record::irradiance);
        let (mean, error) = mean_and_error(told);
        println!("{name}, {max_bounces}: {:.4} +- {:.4}", mean / expected, error / expected);
        // Sums of some hundred values in f32.
        let error = error + 1e-5 * expected;
        z_test(mean, error, expected, 5).unwrap_or_else(|e| panic!("{name}, {max_bounces} bounces: {e}"));
        z_test(1.03 * mean, error, expected, 5).expect_err("three percent too much");
    }
}

/// A ray ends in a look-up where it has come as far as the place's disc is wide, and is traced on where it has not.
#[test]
fn near_places_are_not_asked() {
    let mut random = Random(4);
    let ball = inside_out(sphere(DVec3::ZERO, 0.4, 40));
    let stage = stage(&[(ball.clone(), surface(0.5, 0.0))], false);
    let places = places_on(&ball, 40_000, &mut random);
    for (radius, asked) in [(0.395, true), (0.405, false)] {
        let known = Known::new(&stage, &places, 3.0, radius);
        let (by_seed, rays) = Gathering::new(&stage, &known).run(&[(DVec3::ZERO, DVec3::Y)], &[0], 0..1);
        // Traced on, a ray's path comes to places farther off: at its next vertex it asks.
        assert_eq!(rays == 0, asked, "radius {radius}: {rays} rays");
        let told = by_seed[0][0].irradiance();
        // pi times 3 a / pi; half of it after one bounce more.
        let expected = if asked { 1.5 } else { 0.75 };
        assert!((told - expected).abs() < 1e-4, "radius {radius}: {told}");
    }
}

/// A record depends on its point alone: any choice of the points, about a workgroup, more than a dispatch's rays, and behind
/// records before, gives the same bits.
#[test]
fn records_depend_on_their_points_alone() {
    let mut random = Random(5);
    let stage = stage(&[(ceiling(), surface(CEILING, 0.0))], true);
    let known = Known::new(&stage, &places_on(&ceiling(), 5000, &mut random), BRIGHT, NEAR);
    let points: Vec<(DVec3, DVec3)> = (0..1500)
        .map(|_| (random.point() * DVec3::new(0.4, 0.1, 0.4), (DVec3::Y + 0.3 * random.direction()).normalize()))
        .collect();
    let everything: Vec<u32> = (0..1500).collect();
    let all = Gathering::new(&stage, &known).run(&points, &everything, 0..1).0.remove(0);
    for (first, count, before) in [(0u32, 0u32, 0), (7, 1, 3), (100, 63, 0), (30, 64, 1), (1400, 65, 100)] {
        let wanted: Vec<u32> = (first..first + count).rev().collect();
        let gathering = Gathering { before, ..Gathering::new(&stage, &known) };
        let records = gathering.run(&points, &wanted, 0..1).0.remove(0);
        assert_eq!(records.len(), count as usize);
        for (i, record) in wanted.iter().zip(&records) {
            assert!(*record == all[*i as usize], "point {i} of {count}");
            assert!(*record != all[(*i as usize + 1) % 1500], "all records are alike: the test sees nothing");
        }
    }
}
