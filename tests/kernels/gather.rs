//! Pass `gather`: records whose rays look up irradiance supplied by the test, against closed forms of irradiance,
//! gradients and distances; and rays continued by paths, in furnace tests.

use std::f64::consts::PI;

use glam::{DVec3, Vec3};
use kernel_kit::{Binding, Bindings, Buffer, Gpu, POISON, Table, TableFormat, kernel_test, whole_rows};
use penumbra::internal::passes::gather::{Gather, GatherSettings, RayBuffers, RecordBuffers, RecordHead, Wave};
use penumbra::internal::passes::grid::{Grid, Photon, SortedPhotons};
use penumbra::internal::passes::irradiance::irradiance_point_grid;
use penumbra::internal::passes::path::Path;
use penumbra::internal::passes::{Point, TileBuffers};
use penumbra::internal::scene::{LightKind, Material, Scene};
use penumbra::internal::specialisation::features::Feature;
use penumbra::internal::specialisation::kernels::sorting_grid;
use penumbra::internal::statistics::Counter;
use penumbra::settings::Technique;

use crate::irradiance::carrying;
use crate::kit::published;
use crate::light::{Corners, cube, form_factor, sphere, square};
use crate::octahedral::oct_encode;
use crate::path::{camera, inside_out, scene, surface};
use crate::random::{Random, RandomInput as _};
use crate::rooms::point;
use crate::stage::Stage;
use crate::statistics::{mean_and_error, z_test};

/// The waves of a record with 256 rays.
const AT_ONCE: &[Wave] = &[Wave { earlier: 0, rays: 256 }];
const IN_WAVES: &[Wave] =
    &[Wave { earlier: 0, rays: 64 }, Wave { earlier: 64, rays: 64 }, Wave { earlier: 128, rays: 128 }];

/// Height of the image. The size of a pixel, the lower bound of distances, is then a few ten-thousandths.
const HEIGHT: u32 = 8192;

/// Irradiance points with values that the test supplies.
struct Known {
    points: SortedPhotons,
    table: Table,
    shape: Buffer,
}

/// The whole disc is clear.
fn clear_disc(radius: f32) -> f32 {
    f32::from_bits(radius.to_bits() | 255)
}

impl Known {
    /// Irradiance points at the given positions with normals, all with the same irradiance in every channel and the
    /// same radius.
    fn new(gpu: &Gpu, stage: &Stage, points: &[(DVec3, DVec3)], irradiance: f32, radius: f32) -> Known {
        Known::with(gpu, stage, points, &[[irradiance, irradiance, irradiance, clear_disc(radius)]])
    }

    /// Irradiance points that all have the same texels.
    fn with(gpu: &Gpu, stage: &Stage, points: &[(DVec3, DVec3)], texels: &[[f32; 4]]) -> Known {
        let photons: Vec<Photon> = points.iter().map(|(p, n)| carrying(p.as_vec3(), n.as_vec3(), [0; 3])).collect();
        let shape = irradiance_point_grid(((Vec3::splat(-1.0), Vec3::splat(1.0)), 1.0), photons.len() as u32);
        let buffer = gpu.upload("test/irradiance_points", &photons).unwrap();
        let grid = Grid::sorting_only(gpu, &sorting_grid(&stage.features)).unwrap();
        let values = texels.repeat(photons.len().max(1));
        Known {
            points: grid.sort(gpu, &buffer, photons.len() as u32, 1, shape).unwrap(),
            table: gpu.table("test/irradiances", &values, TableFormat::Float).unwrap(),
            shape: gpu.upload("test/shape", &[shape]).unwrap(),
        }
    }
}

impl Bindings for Known {
    fn get(&self, name: &str) -> Option<Binding<'_>> {
        match name {
            "irradiance_table" => Some((&self.table).into()),
            "irradiance_grid" => Some((&self.shape).into()),
            _ => self.points.get(name),
        }
    }
}

/// Radius of discs that hold two dozen of 20,000 irradiance points on a unit of area, so that every position is near
/// one.
const NEAR: f32 = 0.022;

/// Positions distributed over triangles, and their normals.
fn positions_on(triangles: &[Corners], count: usize, random: &mut Random) -> Vec<(DVec3, DVec3)> {
    let across = |[a, b, c]: &Corners| (*b - *a).cross(*c - *a);
    let area: f64 = triangles.iter().map(|t| across(t).length()).sum();
    let mut positions = Vec::new();
    for t in triangles {
        let share = (count as f64 * across(t).length() / area).ceil() as usize;
        positions.extend((0..share).map(|_| {
            let (u, v) = (random.uniform(), random.uniform());
            let (u, v) = if u + v > 1.0 { (1.0 - u, 1.0 - v) } else { (u, v) };
            (t[0] + u * (t[1] - t[0]) + v * (t[2] - t[0]), across(t).normalize())
        }));
    }
    positions
}

/// A scene for gathers; with `bent` records have rotational gradients.
fn stage(gpu: &Gpu, meshes: &[(Vec<Corners>, Material)], bent: bool) -> Stage {
    // A distant light, too weak to matter, because a scene without lights gathers nothing.
    let dim = LightKind::Point { position: Vec3::splat(50.0), intensity: Vec3::splat(1e-9), range: f32::INFINITY };
    let scene: Scene = scene(meshes, vec![dim]);
    let view = camera(DVec3::new(0.0, 0.3, 1.0), DVec3::NEG_Z, 1.0);
    Stage::new(gpu, scene, &view, [HEIGHT, HEIGHT], Technique::SHADOW_PHOTONS, |f| {
        let smooth = bent || f.has(Feature::SmoothNormals);
        f.with(Feature::SmoothNormals, smooth)
    })
}

/// A record as the kernels keep it.
#[derive(Clone, Debug, PartialEq)]
struct Record {
    head: RecordHead,
    /// By channel: gradient and irradiance.
    translation: [[f32; 4]; 3],
    rotation: Vec<[f32; 4]>,
    variance: f32,
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
    /// Number of earlier records.
    before: u32,
    waves: &'static [Wave],
}

impl<'a> Gathering<'a> {
    fn new(stage: &'a Stage, known: &'a Known) -> Self {
        Gathering { stage, known, max_bounces: 64, before: 0, waves: AT_ONCE }
    }

    /// Gathers at the points `wanted` with each seed. Returns the records, and the number of rays that paths continued.
    fn run(
        &self,
        gpu: &Gpu,
        points: &[(DVec3, DVec3)],
        wanted: &[u32],
        seeds: std::ops::Range<u32>,
    ) -> (Vec<Vec<Record>>, u32) {
        let features = &self.stage.features;
        let vectors = if features.has(Feature::SmoothNormals) { 6 } else { 3 };
        let mut tile = TileBuffers::new(gpu, features, points.len() as u32, true).unwrap();
        let of_device: Vec<Point> = points.iter().map(|(p, n)| point(p.as_vec3(), n.as_vec3())).collect();
        let surfaces: Vec<[f32; 4]> =
            points.iter().map(|(_, n)| [0.5, 0.5, 0.5, f32::from_bits(oct_encode(*n))]).collect();
        tile.points = published(gpu, "test/points", &of_device);
        tile.surfaces = published(gpu, "test/surfaces", &surfaces);
        let count = (self.before as usize + wanted.len()) * vectors;
        let end = self.before + wanted.len() as u32;
        let mut buffers = RecordBuffers::new(gpu, features, end + 1).unwrap();
        buffers.values = gpu.poisoned::<[f32; 4]>("test/values", whole_rows(count + 1)).unwrap();
        let constants = self.stage.gpu_scene.constants();
        let pass = Gather::new(gpu, features, &constants).unwrap();
        let path = Path::new(gpu, features, &constants).unwrap();
        let sets: [&dyn Bindings; 2] = [&self.stage.gpu_scene, self.known];
        let mut ray_buffers = RayBuffers::new(gpu, features, 0).unwrap();
        for wave in self.waves {
            ray_buffers.grow(gpu, wanted.len() as u32, wave.rays).unwrap();
        }
        let bind = |wave: &Wave| pass.bind(gpu, &path, &tile, *wave, (&buffers, &ray_buffers), &sets).unwrap();
        let bound: Vec<_> = self.waves.iter().map(bind).collect();
        let records = seeds.map(|seed| {
            let settings = GatherSettings { max_bounces: self.max_bounces, seed, height: HEIGHT };
            let mut heads = bound[0].place(gpu, wanted, self.before, settings).unwrap();
            for later in &bound[1..] {
                heads = later.gather(gpu, self.before..end, settings).unwrap();
            }
            let mut values: Vec<[f32; 4]> = gpu.read(&buffers.values, count + 1).unwrap();
            let first = self.before as usize * vectors;
            let others = values[..first].iter().chain(&values[count..]);
            assert!(others.flatten().all(|v| v.to_bits() == POISON), "values of other records are written");
            values.truncate(count);
            let values = values.split_off(first);
            assert!(values.iter().flatten().all(|v| v.is_finite()), "poison or worse in a record");
            let variances = buffers.read(gpu, end as usize).unwrap().0.split_off(self.before as usize);
            let record = |((head, values), variance): ((&RecordHead, &[[f32; 4]]), f32)| Record {
                head: *head,
                translation: [values[0], values[1], values[2]],
                rotation: values[3..].to_vec(),
                variance,
            };
            heads.iter().zip(values.chunks(vectors)).zip(variances).map(record).collect()
        });
        let records = records.collect();
        let counters: Vec<u32> = gpu.read(&tile.counters, Counter::COUNT).unwrap();
        assert_eq!(counters[Counter::Overrun as usize], 0);
        (records, counters[Counter::GatherRays as usize])
    }
}

const CEILING: f32 = 0.8;
const BRIGHT: f32 = 2.0;

fn ceiling() -> Vec<Corners> {
    square(DVec3::new(0.1, 0.3, 0.0), DVec3::X * 0.25, DVec3::Z * 0.2)
}

/// Irradiance from a ceiling of known irradiance.
fn from_ceiling(position: DVec3, normal: DVec3) -> f64 {
    f64::from(CEILING * BRIGHT) / PI * form_factor(&ceiling(), false, position, normal, true)
}

/// A floor under a bright ceiling: irradiance by Lambert's formula, and both gradients by its central differences. The
/// tolerance of the translational gradient is nine tenths of a ring of strata, whose width is a part of the way to the
/// horizon: an edge of the ceiling moves as if it lay between two of them. The rotational gradient does not depend on
/// such edges, and has a tolerance of a fiftieth.
#[kernel_test("PENUMBRA_DEVICE")]
fn records_are_closed_forms_of_a_ceiling(gpu: &Gpu) {
    let mut random = Random(1);
    let stage = stage(gpu, &[(ceiling(), surface(CEILING, 0.0))], true);
    let known = Known::new(gpu, &stage, &positions_on(&ceiling(), 20_000, &mut random), BRIGHT, NEAR);
    let tilted = DVec3::new(0.3, 0.9, -0.2).normalize();
    let points = [
        (DVec3::new(0.1, 0.0, 0.0), DVec3::Y),
        (DVec3::new(-0.2, 0.0, 0.1), DVec3::Y),
        (DVec3::new(0.35, -0.1, -0.2), DVec3::Y),
        (DVec3::new(-0.1, 0.05, 0.0), tilted),
    ];
    const SEEDS: u32 = 256;
    for waves in [AT_ONCE, IN_WAVES] {
        let gathering = Gathering { waves, ..Gathering::new(&stage, &known) };
        let (by_seed, followed) = gathering.run(gpu, &points, &[0, 1, 2, 3], 0..SEEDS);
        assert_eq!(followed, 0);
        // The part of the way to the horizon that a ring takes, on average over all rays.
        let of_wave = |wave: &Wave| f64::from(wave.rays) / f64::from(wave.strata()[0]);
        let all: u32 = waves.iter().map(|wave| wave.rays).sum();
        let ring = waves.iter().map(of_wave).sum::<f64>() / f64::from(all);
        are_closed_forms_of_a_ceiling(&by_seed, &points, ring);
        if waves == AT_ONCE {
            variances_are_those_of_neighbours(&by_seed, &points);
        }
    }
}

/// The variance by a single wave, against that by the parts of the strata that the ceiling covers: independent points
/// of strata a and b, of which parts p and q are covered, differ with probability p (1 - q) + q (1 - p). Points of the
/// sequence are not quite independent, which made it 2 to 10 % larger: a tolerance of 15 %. And it is no less than what
/// the seeds spread by.
fn variances_are_those_of_neighbours(by_seed: &[Vec<Record>], points: &[(DVec3, DVec3)]) {
    let [rings, sectors] = AT_ONCE[0].strata().map(|count| count as usize);
    let rays = (rings * sectors) as f64;
    for (i, (position, normal)) in points.iter().copied().enumerate() {
        const STEPS: usize = 16;
        let side = normal.any_orthonormal_vector();
        let covered = |ring: usize, sector: usize| {
            let is_hit = |step: usize| {
                let part = |first: usize, step: usize, count: usize| {
                    (first as f64 + (step as f64 + 0.5) / STEPS as f64) / count as f64
                };
                let (x, angle) = (part(ring, step % STEPS, rings), 2.0 * PI * part(sector, step / STEPS, sectors));
                let across = angle.cos() * side + angle.sin() * normal.cross(side);
                let direction = x.sqrt() * across + (1.0 - x).sqrt() * normal;
                let at = position + (0.3 - position.y) / direction.y * direction;
                direction.y > 0.0 && (at.x - 0.1).abs() < 0.25 && at.z.abs() < 0.2
            };
            (0..STEPS * STEPS).filter(|step| is_hit(*step)).count() as f64 / (STEPS * STEPS) as f64
        };
        let parts: Vec<Vec<f64>> = (0..sectors).map(|k| (0..rings).map(|j| covered(j, k)).collect()).collect();
        let differs = |p: f64, q: f64| p * (1.0 - q) + q * (1.0 - p);
        let mut sum = 0.0;
        for (k, j) in (0..sectors).flat_map(|k| (0..rings).map(move |j| (k, j))) {
            sum += differs(parts[k][j], parts[(k + 1) % sectors][j]);
            sum += if j > 0 { differs(parts[k][j], parts[k][j - 1]) } else { 0.0 };
        }
        let pairs = 2.0 * rays - sectors as f64;
        let light = f64::from(CEILING * BRIGHT) / PI;
        let expected = 3.0 * 0.5 * sum / pairs * light * light * PI * PI / rays;
        let (variance, _) = mean_and_error(by_seed.iter().map(|records| f64::from(records[i].variance)));
        let (_, error) = mean_and_error(by_seed.iter().map(|records| records[i].irradiance()));
        let spread = 3.0 * error * error * by_seed.len() as f64;
        println!(
            "{i}: variance {:.3} of the expected one, {:.3} of the spread",
            variance / expected,
            variance / spread
        );
        assert!((variance / expected - 1.0).abs() < 0.15 && variance > spread, "{i}: {variance}, not {expected}");
    }
}

fn are_closed_forms_of_a_ceiling(by_seed: &[Vec<Record>], points: &[(DVec3, DVec3)], ring: f64) {
    let of = |i: usize, what: &dyn Fn(&Record) -> f64| {
        let measured: Vec<f64> = by_seed.iter().map(|records| what(&records[i])).collect();
        mean_and_error(measured.iter().copied())
    };
    for (i, (position, normal)) in points.iter().copied().enumerate() {
        let head = &by_seed[0][i].head;
        assert_eq!(Vec3::from(head.position), position.as_vec3());
        // A code of 16 bits is 7e-5 off, which takes 3e-9 of the cosine: a few roundings of f32 remain.
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
        let rotations = axes.map(|axis| {
            let at = |step: f64| from_ceiling(position, glam::DQuat::from_axis_angle(axis, step) * normal);
            (at(STEP) - at(-STEP)) / (2.0 * STEP)
        });
        let size = |values: [f64; 2]| values[0].hypot(values[1]);
        // In the middle both gradients are 0. Their scale there is a tenth of the irradiance over the distance.
        let scales = [size(slopes).max(expected / 3.0), size(rotations).max(expected * 0.1)];
        for k in 0..2 {
            let (slope, slope_error) = of(i, &|record| record.along(axes[k]));
            let (rotation, rotation_error) = of(i, &|record| record.about(axes[k]));
            println!(
                "  along {slope:.4} +- {slope_error:.4}, {:.4}; about {rotation:.4} +- {rotation_error:.4}, {:.4}",
                slopes[k], rotations[k]
            );
            for (name, measured, error, expected, scale) in [
                // Over 4: of 16 tests, z_test allows four standard errors.
                ("along", slope, slope_error + 0.9 * ring / 4.0 * scales[0], slopes[k], scales[0]),
                ("about", rotation, rotation_error + 0.02 / 4.0 * scales[1], rotations[k], scales[1]),
            ] {
                z_test(measured, error, expected, 16).unwrap_or_else(|e| panic!("{i}, {name} {}: {e}", axes[k]));
                if expected.abs() > 0.5 * scale {
                    z_test(-measured, error, expected, 16).expect_err("the other way");
                    z_test((1.0 + 3.0 * ring) * measured, error, expected, 16).expect_err("much too much");
                }
            }
        }
    }
}

/// Rays whose footprint is narrower than the discs continue as paths, which meet no light here. They take the light
/// that only focusing surfaces have scattered from the irradiance points, once: all other light of these is wrong by
/// far.
#[kernel_test("PENUMBRA_DEVICE")]
fn narrow_rays_take_focused_light_from_irradiance_points(gpu: &Gpu) {
    let mut random = Random(5);
    // A mirror that nothing sees makes light focus.
    let mirror = Material { metallic: 1.0, roughness: 0.0, ..surface(0.0, 0.0) };
    let aside = square(DVec3::Y * -0.5, DVec3::X * 0.1, DVec3::Z * 0.1);
    let stage = stage(gpu, &[(ceiling(), surface(CEILING, 0.0)), (aside, mirror)], false);
    assert!(stage.features.has(Feature::CausticIrradiance));
    let texels = [[1e3, 1e3, 1e3, clear_disc(50.0)], [BRIGHT, BRIGHT, BRIGHT, 0.0]];
    let known = Known::with(gpu, &stage, &positions_on(&ceiling(), 20_000, &mut random), &texels);
    // Surfaces of glossy scenes have more texels, but the first is all that the first point needs.
    for point in [(DVec3::new(0.1, 0.0, 0.0), DVec3::Y), (DVec3::new(-0.2, 0.0, 0.1), DVec3::Y)] {
        let (by_seed, followed) = Gathering::new(&stage, &known).run(gpu, &[point], &[0], 0..64);
        // A guard: paths continue rays.
        assert!(followed > 1000, "{followed}");
        let (mean, error) = mean_and_error(by_seed.iter().map(|records| records[0].irradiance()));
        let expected = from_ceiling(point.0, point.1);
        z_test(mean, error, expected, 2).unwrap_or_else(|e| panic!("{point:?}: {e}"));
        z_test(1.05 * mean, error, expected, 2).expect_err("a twentieth too much");
    }
}

/// A mirror shows gather rays what lies before it: a bright square behind the point lights it from behind the mirror,
/// at the mirrored place. So paths leave hits in the right direction.
#[kernel_test("PENUMBRA_DEVICE")]
fn gather_rays_are_mirrored(gpu: &Gpu) {
    let mut random = Random(8);
    let mirror = Material { metallic: 1.0, roughness: 0.0, ..surface(1.0, 0.0) };
    let above = square(DVec3::Y * 0.3, DVec3::X * 0.6, DVec3::Z * 0.6);
    let bright = square(DVec3::new(0.1, -0.2, 0.0), DVec3::Z * 0.2, DVec3::X * 0.25);
    let stage = stage(gpu, &[(above, mirror), (bright.clone(), surface(CEILING, 0.0))], false);
    let texels = [[BRIGHT, BRIGHT, BRIGHT, clear_disc(NEAR)], [0.0; 4]];
    let known = Known::with(gpu, &stage, &positions_on(&bright, 20_000, &mut random), &texels);
    let image = |height: f64| square(DVec3::new(0.1, height, 0.0), DVec3::X * 0.25, DVec3::Z * 0.2);
    for x in [0.1, -0.2] {
        let point = (DVec3::new(x, 0.0, 0.0), DVec3::Y);
        let (by_seed, followed) = Gathering::new(&stage, &known).run(gpu, &[point], &[0], 0..256);
        // A guard: paths continue rays.
        assert!(followed > 1000, "{followed}");
        let (mean, error) = mean_and_error(by_seed.iter().map(|records| records[0].irradiance()));
        let from =
            |height: f64| f64::from(CEILING * BRIGHT) / PI * form_factor(&image(height), false, point.0, point.1, true);
        println!("{x}: {:.4} +- {:.4}", mean / from(0.8), error / from(0.8));
        z_test(mean, error, from(0.8), 2).unwrap_or_else(|e| panic!("{x}: {e}"));
        z_test(mean, error, from(0.7), 2).expect_err("another height");
    }
}

/// Harmonic mean distances: in the middle of a sphere its radius; between wide planes 3/2 of their distance, as the
/// mean of the cosine is 2/3 there. Uniform light has no gradient, and neither has darkness: its records are as large.
#[kernel_test("PENUMBRA_DEVICE")]
fn distances_are_harmonic_means(gpu: &Gpu) {
    let mut random = Random(2);
    let ball = inside_out(sphere(DVec3::ZERO, 0.4, 40));
    let planes = square(DVec3::Y * 0.01, DVec3::X * 0.5, DVec3::Z * 0.5);
    // The planes are closer to each other than irradiance points are in other tests.
    for (name, mesh, expected, count, radius, light) in [
        ("sphere", ball.clone(), 0.4, 40_000, NEAR, 1.0),
        ("dark sphere", ball, 0.4, 40_000, NEAR, 0.0),
        ("planes", planes, 0.015, 400_000, 0.22 * NEAR, 1.0),
    ] {
        let stage = stage(gpu, &[(mesh.clone(), surface(0.5, 0.0))], false);
        let known = Known::new(gpu, &stage, &positions_on(&mesh, count, &mut random), light, radius);
        let (by_seed, followed) = Gathering::new(&stage, &known).run(gpu, &[(DVec3::ZERO, DVec3::Y)], &[0], 0..64);
        assert_eq!(followed, 0, "{name}: rays that found no irradiance point");
        if name != "planes" {
            for records in &by_seed {
                // The light of facets differs by the rounding of their normals' lengths.
                let nothing = |v: &[f32; 4]| v[..3].iter().all(|slope| slope.abs() <= 1e-6 * v[3]);
                assert!(records[0].translation.iter().all(nothing), "{:?}", records[0]);
            }
        }
        let measured = by_seed.iter().map(|records| 1.0 / f64::from(records[0].head.distance));
        let (mean, error) = mean_and_error(measured);
        // Facets of the sphere are up to 0.3 % nearer than its radius. Between the planes, rays below 1.2 degrees hit
        // nothing: 0.04 % of the cosine's weight.
        let error = error + 1e-3 / expected;
        z_test(mean, error, 1.0 / expected, 2).unwrap_or_else(|e| panic!("{name}: {e}"));
        z_test(1.05 * mean, error, 1.0 / expected, 2).expect_err("five percent too near");
    }
}

/// In a closed room that emits 1 and has albedo a, the indirect irradiance of a wall is pi (a + a^2 + ...), up to a^m
/// for m bounces. It comes from look-ups; from paths if there are no irradiance points; and from paths if discs are
/// wider than rays are long.
#[kernel_test("PENUMBRA_DEVICE")]
fn furnaces_are_white(gpu: &Gpu) {
    const ALBEDO: f32 = 0.6;
    let mut random = Random(3);
    let walls = inside_out(cube(DVec3::ZERO, 0.5));
    let stage = stage(gpu, &[(walls.clone(), surface(ALBEDO, 1.0))], false);
    let a = f64::from(ALBEDO);
    let everywhere = positions_on(&walls, 120_000, &mut random);
    let all = PI / (1.0 - a);
    let points = [(DVec3::new(0.1, -0.5, 0.2), DVec3::Y), (DVec3::new(-0.5, 0.45, 0.1), DVec3::X)];
    for (name, positions, radius, max_bounces, follows) in [
        ("look-ups", &everywhere[..], NEAR, 64, false),
        ("no irradiance point", &[], NEAR, 64, true),
        ("no irradiance point", &[], NEAR, 1, true),
        ("no irradiance point", &[], NEAR, 2, true),
        ("too wide", &everywhere[..], 1e3, 64, true),
    ] {
        let known = Known::new(gpu, &stage, positions, all as f32, radius);
        let gathering = Gathering { max_bounces, ..Gathering::new(&stage, &known) };
        const SEEDS: u32 = 32;
        let (by_seed, rays) = gathering.run(gpu, &points, &[0, 1], 0..SEEDS);
        assert_eq!(rays > 0, follows, "{name}: {rays} rays");
        let expected = PI * (1..=max_bounces).map(|k| a.powi(k as i32)).sum::<f64>();
        let measured = by_seed.iter().flatten().map(Record::irradiance);
        let (mean, error) = mean_and_error(measured);
        println!("{name}, {max_bounces}: {:.4} +- {:.4}", mean / expected, error / expected);
        // Sums of some hundred values in f32.
        let error = error + 1e-5 * expected;
        z_test(mean, error, expected, 5).unwrap_or_else(|e| panic!("{name}, {max_bounces} bounces: {e}"));
        z_test(1.03 * mean, error, expected, 5).expect_err("three percent too much");
    }
}

/// A ray ends in a look-up if its length is at least twice the radius of the disc; otherwise a path continues it.
#[kernel_test("PENUMBRA_DEVICE")]
fn near_points_are_not_looked_up(gpu: &Gpu) {
    let mut random = Random(4);
    let ball = inside_out(sphere(DVec3::ZERO, 0.4, 40));
    let stage = stage(gpu, &[(ball.clone(), surface(0.5, 0.0))], false);
    let positions = positions_on(&ball, 40_000, &mut random);
    for (radius, looked_up) in [(0.1975, true), (0.2025, false)] {
        let known = Known::new(gpu, &stage, &positions, 3.0, radius);
        let (by_seed, rays) = Gathering::new(&stage, &known).run(gpu, &[(DVec3::ZERO, DVec3::Y)], &[0], 0..1);
        // The path that continues a ray reaches more distant irradiance points, and ends in a look-up at its next
        // vertex.
        assert_eq!(rays == 0, looked_up, "radius {radius}: {rays} rays");
        let measured = by_seed[0][0].irradiance();
        // pi times 3 a / pi; half of it after one more bounce. Two of 256 rays may be so short again that there is a
        // third bounce, which halves what they bring.
        let (expected, off) = if looked_up { (1.5, 1e-4) } else { (0.75, 0.75 * 2.0 / 512.0 + 1e-4) };
        // 1e-4: a sum of 256 values of 1.5 in f32 is off by 256 * 6e-8 * 1.5 = 2e-5 at most.
        assert!((measured - expected).abs() < off, "radius {radius}: {measured}");
    }
}

/// One ray does not tell its variance; two waves of one ray do.
#[kernel_test("PENUMBRA_DEVICE")]
fn the_variance_of_a_single_ray_is_unknown(gpu: &Gpu) {
    const ONE: &[Wave] = &[Wave { earlier: 0, rays: 1 }];
    const TWO: &[Wave] = &[Wave { earlier: 0, rays: 1 }, Wave { earlier: 1, rays: 1 }];
    let mut random = Random(3);
    let stage = stage(gpu, &[(ceiling(), surface(CEILING, 0.0))], true);
    let known = Known::new(gpu, &stage, &positions_on(&ceiling(), 20_000, &mut random), BRIGHT, NEAR);
    let points = [(DVec3::ZERO, DVec3::Y)];
    for (waves, is_known) in [(ONE, false), (TWO, true)] {
        let gathering = Gathering { waves, ..Gathering::new(&stage, &known) };
        let (by_seed, _) = gathering.run(gpu, &points, &[0], 0..8);
        assert!(by_seed.iter().all(|records| records[0].variance.is_finite() == is_known), "{} waves", waves.len());
    }
}

/// A wave counts by its rays: earlier values, which the test puts in the place of those of the first wave, have their
/// share, for light and distances.
#[kernel_test("PENUMBRA_DEVICE")]
fn waves_add_up(gpu: &Gpu) {
    let mut random = Random(6);
    let ball = inside_out(sphere(DVec3::ZERO, 0.4, 40));
    let stage = stage(gpu, &[(ball.clone(), surface(0.5, 0.0))], true);
    let known = Known::new(gpu, &stage, &positions_on(&ball, 40_000, &mut random), 3.0, NEAR);
    let (features, point_count) = (&stage.features, 65);
    let mut tile = TileBuffers::new(gpu, features, point_count, true).unwrap();
    tile.points = published(gpu, "test/points", &vec![point(Vec3::ZERO, Vec3::Y); point_count as usize]);
    let surface = [0.5, 0.5, 0.5, f32::from_bits(oct_encode(DVec3::Y))];
    tile.surfaces = published(gpu, "test/surfaces", &vec![surface; point_count as usize]);
    let buffers = RecordBuffers::new(gpu, features, point_count).unwrap();
    let pass = Gather::new(gpu, features, &stage.gpu_scene.constants()).unwrap();
    let path = Path::new(gpu, features, &stage.gpu_scene.constants()).unwrap();
    let sets: [&dyn Bindings; 2] = [&stage.gpu_scene, &known];
    // Room for the rays of some records at a time.
    let ray_buffers = RayBuffers::new(gpu, features, 1000).unwrap();
    let bind = |wave: &Wave| pass.bind(gpu, &path, &tile, *wave, (&buffers, &ray_buffers), &sets).unwrap();
    let settings = GatherSettings { max_bounces: 64, seed: 7, height: HEIGHT };
    let wanted: Vec<u32> = (0..point_count).collect();
    bind(&IN_WAVES[0]).place(gpu, &wanted, 0, settings).unwrap();
    let mut expected = 9.0;
    gpu.write(&buffers.values, &vec![[0.0f32, 0.0, 0.0, expected as f32]; 6 * point_count as usize]);
    for wave in &IN_WAVES[1..] {
        let heads = bind(wave).gather(gpu, 0..point_count, settings).unwrap();
        // pi times 3 a / pi of the wave's own rays.
        let share = f64::from(wave.rays) / f64::from(wave.earlier + wave.rays);
        let before = expected;
        expected += share * (1.5 - expected);
        let variance = 3.0 * share * (1.0 - share) * (1.5 - before).powi(2);
        for found in buffers.read(gpu, point_count as usize).unwrap().0.into_iter().map(f64::from) {
            // A mean is off by up to 1e-5 (below), and differs from 1.5 by 3.75 or more: twice that share.
            assert!((found / variance - 1.0).abs() < 1e-5, "variance {found}, not {variance}");
        }
        let values: Vec<[f32; 4]> = gpu.read(&buffers.values, 6 * point_count as usize).unwrap();
        for (head, values) in heads.iter().zip(values.chunks(6)) {
            for channel in &values[..3] {
                // A sum of 128 values of 1.5 in f32 is off by 128 * 6e-8 * 1.5 = 1e-5; a few roundings of 9 follow.
                let close = |to: f64| (f64::from(channel[3]) - to).abs() < 1e-4;
                assert!(close(expected), "{channel:?}, not {expected}");
                assert!(!close(before) && !close(before + 0.4 * (1.5 - before)), "another share would do");
            }
            // Facets are up to 0.3 % nearer than the sphere.
            assert!((head.distance - 0.4).abs() < 0.003 * 0.4, "{head:?}");
        }
    }
}

/// Records that are left out leave the others as they are, in their order.
#[kernel_test("PENUMBRA_DEVICE")]
fn kept_records_keep_their_values(gpu: &Gpu) {
    let stage = stage(gpu, &[(ceiling(), surface(CEILING, 0.0))], true);
    for (all, kept) in [(0usize, vec![]), (1, vec![0]), (5, vec![]), (200, vec![0, 1, 77, 199])] {
        let buffers = RecordBuffers::new(gpu, &stage.features, all.max(1) as u32).unwrap();
        let words = |size: usize| -> Vec<u32> { (0..(size * all) as u32).map(|word| word * 2_654_435_761).collect() };
        let of = |words: &[u32], size: usize| -> Vec<u32> {
            kept.iter().flat_map(|i| words[i * size..][..size].to_vec()).collect()
        };
        let (origins, values) = (words(8), words(24));
        gpu.write(&buffers.origins, &origins);
        gpu.write(&buffers.values, &values);
        buffers.keep(gpu, &kept, all).unwrap();
        assert_eq!(gpu.read::<u32>(&buffers.origins, 8 * kept.len()).unwrap(), of(&origins, 8), "{all}");
        assert_eq!(gpu.read::<u32>(&buffers.values, 24 * kept.len()).unwrap(), of(&values, 24), "{all}");
    }
}

/// A record depends only on its point. Any selection of points gives the same bits: around the size of a workgroup,
/// with more rays than a dispatch, and after earlier records.
#[kernel_test("PENUMBRA_DEVICE")]
fn records_depend_on_their_points_alone(gpu: &Gpu) {
    let mut random = Random(5);
    let stage = stage(gpu, &[(ceiling(), surface(CEILING, 0.0))], true);
    let known = Known::new(gpu, &stage, &positions_on(&ceiling(), 5000, &mut random), BRIGHT, NEAR);
    let points: Vec<(DVec3, DVec3)> = (0..1500)
        .map(|_| (random.point() * DVec3::new(0.4, 0.1, 0.4), (DVec3::Y + 0.3 * random.direction()).normalize()))
        .collect();
    let everything: Vec<u32> = (0..1500).collect();
    let all = Gathering::new(&stage, &known).run(gpu, &points, &everything, 0..1).0.remove(0);
    for (first, count, before) in [(0u32, 0u32, 0), (7, 1, 3), (100, 63, 0), (30, 64, 1), (1400, 65, 100)] {
        let wanted: Vec<u32> = (first..first + count).rev().collect();
        let gathering = Gathering { before, ..Gathering::new(&stage, &known) };
        let records = gathering.run(gpu, &points, &wanted, 0..1).0.remove(0);
        assert_eq!(records.len(), count as usize);
        for (i, record) in wanted.iter().zip(&records) {
            assert!(*record == all[*i as usize], "point {i} of {count}");
            assert!(*record != all[(*i as usize + 1) % 1500], "all records are equal: the test proves nothing");
        }
    }
}
