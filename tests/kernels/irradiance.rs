//! Pass `irradiance`: density estimates against brute force over photons supplied by the test, and against the
//! irradiance that these represent; and the look-up of the nearest irradiance point.

use std::f64::consts::{PI, TAU};

use glam::{DVec3, Mat3, Vec3};
use kernel_kit::{Bindings, Gpu, Kernel, POISON, Resources, kernel_test};
use penumbra::internal::kernels::{GridShape, INVALID_POINT, compose, compose_source};
use penumbra::internal::passes::Point;
use penumbra::internal::passes::grid::{Grid, Photon, SortedPhotons};
use penumbra::internal::passes::irradiance::{
    IRRADIANCE_NEAREST, Irradiance, MAP_PHOTONS_PER_CELL, Shell, irradiance_point_grid,
};
use penumbra::internal::scene::{DiffuseTransmission, Material};
use penumbra::internal::specialisation::features::Feature;
use penumbra::internal::specialisation::kernels::sorting_grid;
use penumbra::internal::statistics::Counter;
use penumbra::settings::Technique;

use crate::flux::steps;
use crate::kit::{new_kernel, published};
use crate::path::{camera, scene, surface};
use crate::rooms::{Random, Rectangle, cube, photon, photon_normal, point, point_normal};
use crate::stage::{Crossing, Stage, crossings, hash};
use crate::statistics::{mean_and_error, z_test};

/// The radius that the kernel writes if there is no estimate.
const FAR: f32 = 1e30;

/// Probes of a disc.
const PROBES: u32 = 16;

/// A photon that carries `flux` steps in each channel, at exponent 0.
pub fn carrying(position: Vec3, normal: Vec3, flux: [u32; 3]) -> Photon {
    let [r, g, b] = flux;
    let photon = photon(position, normal, 0, false);
    Photon { word: photon.word | r << 14 | g << 19 | b << 24, ..photon }
}

/// Rectangles of materials, for kernels with the feature `shown` too.
fn stage(gpu: &Gpu, parts: &[(&[Rectangle], Material)], shown: Option<Feature>) -> Stage {
    let triangles = |Rectangle(p, a, b): &Rectangle| {
        let [p, q, r, s] = [*p, *p + *a, *p + *a + *b, *p + *b].map(|corner| corner.as_dvec3());
        [[p, q, r], [p, r, s]]
    };
    let meshes: Vec<_> = parts
        .iter()
        .map(|(rectangles, material)| (rectangles.iter().flat_map(triangles).collect(), material.clone()))
        .collect();
    let light = penumbra::internal::scene::LightKind::Point {
        position: Vec3::ZERO,
        intensity: Vec3::ONE,
        range: f32::INFINITY,
    };
    let scene = scene(&meshes, vec![light]);
    let view = camera(DVec3::ZERO, DVec3::X, 1.0);
    Stage::new(gpu, scene, &view, [1, 1], Technique::SHADOW_PHOTONS, |features| match shown {
        Some(feature) => features.with(feature, true),
        None => features,
    })
}

/// The kernels, and the scene that probes hit.
struct Bench {
    stage: Stage,
    grid: Grid,
    kernel: Kernel,
}

/// Irradiance points in the order of their cells, and their estimates: irradiance, and the radius of the disc.
struct Estimates {
    points: Vec<Photon>,
    irradiances: Vec<[f32; 4]>,
    /// The part that only focusing surfaces have scattered, with the feature for it.
    caustics: Vec<[f32; 4]>,
    /// The kernel's counts.
    not_finite: u32,
}

impl Bench {
    fn new(gpu: &Gpu, rectangles: &[Rectangle]) -> Bench {
        Bench::with(gpu, rectangles, None)
    }

    fn with(gpu: &Gpu, rectangles: &[Rectangle], shown: Option<Feature>) -> Bench {
        Bench::of(gpu, &[(rectangles, surface(0.5, 0.0))], shown)
    }

    fn of(gpu: &Gpu, parts: &[(&[Rectangle], Material)], shown: Option<Feature>) -> Bench {
        let stage = stage(gpu, parts, shown);
        let composed = compose("irradiance", &stage.features).unwrap();
        let mut constants = stage.gpu_scene.constants().to_vec();
        constants.push(("nearest", f64::from(IRRADIANCE_NEAREST)));
        // Albedo and normal alone.
        constants.push(("surface_vectors", 1.0));
        let kernel = new_kernel(gpu, &composed, &composed.overrides(&constants), &[]).unwrap();
        Bench { grid: Grid::sorting_only(gpu, &sorting_grid(&stage.features)).unwrap(), kernel, stage }
    }

    fn sort(&self, gpu: &Gpu, photons: &[Photon], shape: GridShape) -> SortedPhotons {
        let buffer = gpu.upload("test/photons", photons).unwrap();
        self.grid.sort(gpu, &buffer, photons.len() as u32, 1, shape).unwrap()
    }

    /// Runs only the kernel, on poisoned output. The poison beyond the irradiance points must remain.
    fn estimate(&self, gpu: &Gpu, map: &SortedPhotons, irradiance_points: &SortedPhotons, step: f32) -> Estimates {
        const BEYOND: usize = 5;
        let count = irradiance_points.count as usize;
        let apart = self.stage.features.has(Feature::CausticIrradiance);
        let texels = (1 + usize::from(apart)) * count;
        let irradiances = gpu.poisoned::<[f32; 4]>("test/irradiances", texels + BEYOND).unwrap();
        let counters = gpu.buffer::<u32>("test/counters", Counter::COUNT).unwrap();
        let own = Resources::new()
            .with("irradiance_points", &irradiance_points.sorted)
            .with("irradiances", &irradiances)
            .with("counters", &counters);
        let bound = self.kernel.bind(gpu, "irradiance", &[&own, map, &self.stage.gpu_scene]).unwrap();
        let mut frame = gpu.frame("test");
        frame.run(
            &bound,
            irradiance_points.count,
            &parameters(map, irradiance_points.count, ([step, 1.0], Shell::ALL)),
        );
        frame.submit().unwrap();
        let mut irradiances: Vec<[f32; 4]> = gpu.read(&irradiances, texels + BEYOND).unwrap();
        let beyond = irradiances.split_off(texels);
        assert!(beyond.iter().flatten().all(|v| v.to_bits() == POISON), "written behind {count} irradiance points");
        assert!(irradiances.iter().flatten().all(|v| v.is_finite()), "poison or worse of {count} irradiance points");
        let not_finite = gpu.read::<u32>(&counters, Counter::COUNT).unwrap()[Counter::NotFiniteIrradiance as usize];
        let of_points =
            |first: usize| irradiances.iter().skip(first).step_by(1 + usize::from(apart)).copied().collect();
        let (irradiances, caustics) = (of_points(0), if apart { of_points(1) } else { Vec::new() });
        Estimates { points: gpu.read(&irradiance_points.sorted, count).unwrap(), irradiances, caustics, not_finite }
    }

    /// What an entry point of `shaders/irradiance_near.wgsl` finds at the first `count` points.
    fn look_up(&self, gpu: &Gpu, entry: &str, known: &dyn Bindings, points: &[Point], count: usize) -> Vec<[f32; 4]> {
        let source = include_str!("shaders/irradiance_near.wgsl");
        let composed = compose_source("irradiance_near", source, &self.stage.features).unwrap();
        let kernel = new_kernel(gpu, &composed, &[("count", count as f64)], &[]).unwrap();
        let queries = gpu.upload("test/queries", points).unwrap();
        let found = gpu.poisoned::<[f32; 4]>("test/found", count + 1).unwrap();
        let own = Resources::new().with("queries", &queries).with("found", &found);
        let bound = kernel.bind(gpu, entry, &[&own, known]).unwrap();
        let mut frame = gpu.frame("test");
        frame.run(&bound, count as u32, &[0u32; 0]);
        frame.submit().unwrap();
        let mut found: Vec<[f32; 4]> = gpu.read(&found, count + 1).unwrap();
        assert!(found.pop().unwrap().iter().all(|v| v.to_bits() == POISON));
        found
    }

    /// The output of an entry point at points: `show` over poison, `caustics` on top of 1.
    fn show(
        &self,
        gpu: &Gpu,
        entry: &str,
        map: &SortedPhotons,
        points: &[Point],
        surfaces: &[[f32; 4]],
        of: ([f32; 2], Shell),
    ) -> Vec<[f32; 4]> {
        let count = points.len();
        let mut before = vec![[if entry == "show" { f32::from_bits(POISON) } else { 1.0 }; 4]; count];
        before.push([f32::from_bits(POISON); 4]);
        let radiance = gpu.upload("test/radiance_indirect", &before).unwrap();
        let points = published(gpu, "test/points", points);
        let surfaces = published(gpu, "test/surfaces", surfaces);
        let counters = gpu.buffer::<u32>("test/counters", Counter::COUNT).unwrap();
        let own = Resources::new()
            .with("point_table", &points.table)
            .with("surface_table", &surfaces.table)
            .with("radiance_indirect", &radiance)
            .with("counters", &counters);
        let bound = self.kernel.bind(gpu, entry, &[&own, map, &self.stage.gpu_scene]).unwrap();
        let mut frame = gpu.frame("test");
        frame.run(&bound, count as u32, &parameters(map, count as u32, of));
        frame.submit().unwrap();
        let mut shown: Vec<[f32; 4]> = gpu.read(&radiance, count + 1).unwrap();
        assert!(shown.pop().unwrap().iter().all(|v| v.to_bits() == POISON), "{entry}: written behind {count} points");
        assert!(shown.iter().flatten().all(|v| v.is_finite()), "{entry}: poison or worse of {count} points");
        shown
    }
}

/// Immediates: a step of flux, the radius of a disc over that of a disc with k photons, and the points that count.
fn parameters(map: &SortedPhotons, count: u32, ([step, shrink], shell): ([f32; 2], Shell)) -> [u32; 20] {
    let mut parameters = [0; 20];
    parameters[..8].copy_from_slice(&bytemuck::cast::<GridShape, [u32; 8]>(map.shape));
    parameters[8..11].copy_from_slice(&[count, step.to_bits(), shrink.to_bits()]);
    parameters[12..15].copy_from_slice(&shell.centre.map(f32::to_bits));
    parameters[15..17].copy_from_slice(&[shell.inner, shell.outer].map(f32::to_bits));
    parameters
}

const BOUNDS: (Vec3, Vec3) = (Vec3::splat(-0.5), Vec3::splat(0.5));

/// The estimate by brute force.
struct Expected {
    /// Steps of flux over the disc's area, not yet divided by the share of the disc that is surface.
    density: DVec3,
    /// Whether rounding decides which photons count.
    doubtful: bool,
}

fn cell_at(shape: &GridShape, position: Vec3) -> [i64; 3] {
    [0, 1, 2].map(|axis| {
        let cell = (position[axis] - shape.origin[axis]) * shape.inverse_cell;
        (cell.floor() as i64).clamp(0, i64::from(shape.size[axis]) - 1)
    })
}

/// The radius of the disc at `x`: it would hold k photons at the mean density of 27 cells, nine of which are on a
/// surface; `shrink` times as wide, but at most `max_reach` cells.
fn radius_at(photons: &[Photon], shape: &GridShape, x: Vec3, shrink: f64, max_reach: f64) -> f64 {
    let here = cell_at(shape, x);
    let about = |p: &&Photon| {
        let there = cell_at(shape, Vec3::from(p.position));
        (0..3).all(|axis| (there[axis] - here[axis]).abs() <= 1)
    };
    let crowd = photons.iter().filter(about).count().max(1);
    let reach = (shrink * (f64::from(IRRADIANCE_NEAREST) * 9.0 / (PI * crowd as f64)).sqrt()).min(max_reach);
    reach * f64::from(shape.cell)
}

/// The same at an irradiance point, whose disc is at most four cells wide.
fn radius_of(photons: &[Photon], shape: &GridShape, irradiance_point: &Photon) -> f64 {
    radius_at(photons, shape, Vec3::from(irradiance_point.position), 1.0, 4.0)
}

/// Photons count within an ellipsoid a quarter as high as wide, with normals within 45 degrees, unless `probes` find
/// them hidden by a wall.
fn density(photons: &[Photon], x: Vec3, n: DVec3, radius: f64, probes: Option<&Probes>) -> Expected {
    let mut expected = Expected { density: DVec3::ZERO, doubtful: false };
    for p in photons {
        let v = (Vec3::from(p.position) - x).as_dvec3();
        let distance = (v.length_squared() + 15.0 * v.dot(n).powi(2)).sqrt();
        let excess = photon_normal(p.word).dot(n) - 0.5f64.sqrt();
        // Differences of coordinates up to 1 and normals decoded in f32: within 1e-6.
        expected.doubtful |= (distance - radius).abs() < 2e-6 || (distance < radius && excess.abs() < 1e-5);
        if distance <= radius && excess > 0.0 {
            let hidden = probes.map_or(Some(false), |probes| probes.hide(v));
            expected.doubtful |= hidden.is_none();
            if hidden != Some(true) {
                let sign = if p.word >> 31 == 1 { -1.0 } else { 1.0 };
                expected.density += sign * steps(p.word) / (PI * radius * radius);
            }
        }
    }
    expected
}

/// The estimate at an irradiance point, not yet divided by the share of the disc that is surface.
fn brute_force(photons: &[Photon], irradiance_point: &Photon, radius: f64, probes: Option<&Probes>) -> Expected {
    let (x, n) = (Vec3::from(irradiance_point.position), photon_normal(irradiance_point.word));
    density(photons, x, n, radius, probes)
}

/// What the probes of a disc find.
struct Probes {
    /// The area of the surface in the search ellipsoid over that of the disc.
    share: f64,
    /// The same if surfaces that have no photons were also surface.
    share_of_any: f64,
    /// The clear part of its radius.
    clear: f64,
    /// Where each probe was sent on the disc, from its centre, and the wall that stopped it: its normal, turned to the
    /// centre, and the least product with it of a position that is not behind the wall.
    sent: Vec<(DVec3, Option<(DVec3, f64)>)>,
}

impl Probes {
    /// The walls that hide a part of the disc: the planes of the first stopped probe, and of the first with another.
    fn walls(&self) -> Vec<(DVec3, f64)> {
        let mut walls: Vec<(DVec3, f64)> = Vec::new();
        for (normal, least) in self.sent.iter().filter_map(|(_, wall)| *wall) {
            // SAME_PLANE of the kernel.
            let is_known = |(n, w): &(DVec3, f64)| (*n - normal).abs().max_element().max((w - least).abs()) < 1e-5;
            if walls.len() < 2 && !walls.iter().any(is_known) {
                walls.push((normal, least));
            }
        }
        walls
    }

    /// Whether a wall hides a photon at `v` from the disc's centre; `None` if rounding decides. A wall whose plane a
    /// probe has passed has an end, and hides nothing.
    fn hide(&self, v: DVec3) -> Option<bool> {
        // Positions are within 1e-6.
        let is_behind = |(normal, least): &(DVec3, f64), v: DVec3| {
            let excess = normal.dot(v) - least;
            (excess.abs() > 4e-6).then_some(excess < 0.0)
        };
        let mut hidden = false;
        for wall in self.walls() {
            let mut passed = false;
            for (target, _) in self.sent.iter().filter(|(_, stopped)| stopped.is_none()) {
                passed |= is_behind(&wall, *target)?;
            }
            hidden |= is_behind(&wall, v)? && !passed;
        }
        Some(hidden)
    }
}

/// The probes of the disc of an irradiance point; `None` if rounding decides.
fn probes(stage: &Stage, irradiance_point: &Photon, radius: f64) -> Option<Probes> {
    probes_about(stage, Vec3::from(irradiance_point.position), photon_normal(irradiance_point.word), radius)
}

fn probes_about(stage: &Stage, position: Vec3, n: DVec3, radius: f64) -> Option<Probes> {
    let x = position.as_dvec3();
    // Two tangents (Duff et al. 2017).
    let sign = if n.z >= 0.0 { 1.0 } else { -1.0 };
    let a = -1.0 / (sign + n.z);
    let b = n.x * n.y * a;
    let tangents =
        [DVec3::new(1.0 + sign * n.x * n.x * a, sign * b, -sign * n.x), DVec3::new(b, sign + n.y * n.y * a, -n.y)];
    let [i, j, k] = position.to_array().map(f32::to_bits);
    let rotation = f64::from(hash(&[k, j, i]) >> 8) / f64::from(1 << 24);
    let height = radius / 4.0;
    let (mut found, mut slant, mut any, mut sent) = (0, 0.0, 0, Vec::new());
    for probe in 0..PROBES {
        let part = (f64::from(probe) + 0.5) / f64::from(PROBES);
        let distance = radius * part.sqrt();
        let angle = TAU * (rotation + f64::from(probe) * 0.61803399);
        let across = distance * (angle.cos() * tangents[0] + angle.sin() * tangents[1]);
        let above = x + across + height * n;
        // Rays start 1e-5 to 3e-5 above the surface.
        let origin = x + 2e-5 * n;
        let length = (above - origin).length();
        let towards = (above - origin) / length;
        let there = crossings(&stage.scene, origin, towards);
        let down = crossings(&stage.scene, above, -n);
        // Half the height of the ellipsoid at the probe.
        let half = height * (1.0 - part).sqrt();
        let ways = [(&there, 0.0, length), (&down, height - half, height + half)];
        let hits = ways.map(|(all, start, end)| {
            // Undecided near an end of the segment, and near an edge of a triangle. Triangles are at least a tenth
            // wide.
            let at_end = |c: &Crossing| (c.t - start).abs().min((c.t - end).abs()) < 1e-5;
            let doubtful = |c: &Crossing| at_end(c) || (c.inside.abs() < 1e-4 && c.t > start && c.t < end);
            let first = all.iter().find(|c| c.t > start && c.t < end && c.inside > 0.0);
            if all.iter().any(doubtful) { None } else { Some(first) }
        });
        let [wall, lands] = [hits[0]?, hits[1]?];
        // A thousandth of the radius behind the wall, since photons of the wall itself are not behind it.
        let wall = wall.map(|crossing| {
            let normal = -crossing.normal * crossing.normal.dot(towards).signum();
            (normal, normal.dot(origin + crossing.t * towards - x) - 1e-3 * radius)
        });
        sent.push((across, wall));
        let Some(lands) = lands.filter(|_| wall.is_none()) else { continue };
        let cosine = lands.normal.dot(n).abs();
        if (cosine - 0.5f64.sqrt()).abs() < 1e-5 {
            return None;
        }
        if cosine > 0.5f64.sqrt() {
            any += 1;
            let material = &stage.scene.materials[stage.scene.triangles[lands.triangle].material as usize];
            if !["black", "metal", "unlit"].contains(&material.name.as_str()) {
                found += 1;
                slant += 1.0 / cosine;
            }
        }
    }
    // An estimate of 1 over the share, unbiased but for discs whose surface all probes miss.
    let slant = if found > 0 { slant / f64::from(found) } else { 1.0 };
    let [share, share_of_any] = [found, any].map(|found| slant * f64::from(found + 1) / f64::from(PROBES + 1));
    // The relative radius at which a straight edge cuts off as much as the missing probes and one more.
    let missing = f64::from(PROBES - found + 1) / f64::from(PROBES);
    let clear = if found == PROBES { 0.8 } else { (1.0 - (2.0 * missing).powf(0.63)).max(0.0) };
    Some(Probes { share, share_of_any, clear, sent })
}

/// A floor and a wall at its side, a cube that stands on the floor.
fn corner_and_cube() -> Vec<Rectangle> {
    let v = Vec3::new;
    let mut rectangles = vec![
        Rectangle(v(-0.5, -0.5, -0.5), v(0.0, 0.0, 1.0), v(1.0, 0.0, 0.0)),
        Rectangle(v(-0.5, -0.5, -0.5), v(0.0, 1.0, 0.0), v(0.0, 0.0, 1.0)),
    ];
    let half = 0.15;
    rectangles.extend(cube(v(0.1, -0.5 + half, 0.1), half, Mat3::IDENTITY));
    rectangles
}

fn on(rectangle: &Rectangle, random: &mut Random) -> Vec3 {
    rectangle.0 + rectangle.1 * random.unit() + rectangle.2 * random.unit()
}

/// A point on one of them, and its normal.
fn somewhere(rectangles: &[Rectangle], random: &mut Random) -> (Vec3, Vec3) {
    let rectangle = &rectangles[random.word() as usize % rectangles.len()];
    (on(rectangle, random), rectangle.normal())
}

/// Photons somewhere on the rectangles, with any bits for flux and kind.
fn photons_of_any_flux(rectangles: &[Rectangle], count: usize, random: &mut Random) -> Vec<Photon> {
    let any = |_| {
        let (position, normal) = somewhere(rectangles, random);
        let photon = photon(position, normal, 0, false);
        Photon { word: photon.word | (random.word() & !0x3fff), ..photon }
    };
    (0..count).map(any).collect()
}

/// Relative errors of estimates on an open floor.
pub fn rounding(gpu: &Gpu) -> Vec<f64> {
    let floor = [Rectangle(Vec3::new(-0.5, -0.5, -0.5), Vec3::new(0.0, 0.0, 1.0), Vec3::new(1.0, 0.0, 0.0))];
    let bench = Bench::new(gpu, &floor);
    let mut random = Random(4);
    let mut lying = |flux: bool| {
        let photon = photon(on(&floor[0], &mut random), Vec3::Y, 0, false);
        // All photons have one sign, because differences have larger relative errors.
        Photon { word: photon.word | if flux { random.word() & 0x7fff_c000 } else { 0 }, ..photon }
    };
    let photons: Vec<Photon> = (0..20_000).map(|_| lying(true)).collect();
    let irradiance_points: Vec<Photon> = (0..1000).map(|_| lying(false)).collect();
    let shape = GridShape::with_photons_per_cell(MAP_PHOTONS_PER_CELL, BOUNDS, 1.0, 20_000, 1);
    let estimates = bench.estimate(
        gpu,
        &bench.sort(gpu, &photons, shape),
        &bench.sort(gpu, &irradiance_points, irradiance_point_grid((BOUNDS, 1.0), 1000)),
        1e-4,
    );
    let error = |(irradiance_point, [r, g, b, _]): (&Photon, &[f32; 4])| {
        let radius = radius_of(&photons, &shape, irradiance_point);
        let probes = probes(&bench.stage, irradiance_point, radius)?;
        let expected = brute_force(&photons, irradiance_point, radius, Some(&probes));
        let right = expected.density * f64::from(1e-4f32) / probes.share;
        let value = DVec3::new(f64::from(*r), f64::from(*g), f64::from(*b));
        (!expected.doubtful).then(|| ((value - right).abs() / right).max_element())
    };
    estimates.points.iter().zip(&estimates.irradiances).filter_map(error).collect()
}

/// The kernel's estimates equal brute force. The cases: flux of all words and signs, normals of all directions, numbers
/// of irradiance points around the size of a workgroup, positions on surfaces, at edges, in corners and off surfaces,
/// grids of full and of sparse cells, discs beside surfaces that have no photons, and beside a leaf, which has some
/// below.
#[kernel_test("PENUMBRA_DEVICE")]
fn estimates_are_those_of_brute_force(gpu: &Gpu) {
    let mut rectangles = corner_and_cube();
    // A partition across the floor, with an end.
    rectangles.push(Rectangle(Vec3::new(-0.5, -0.5, -0.25), Vec3::new(0.8, 0.0, 0.0), Vec3::new(0.0, 0.3, 0.0)));
    let lying = |x: f32, z: f32| [Rectangle(Vec3::new(x, -0.498, z), Vec3::Z * 0.2, Vec3::X * 0.2)];
    let named = |name: &str, material: Material| Material { name: name.to_owned(), ..material };
    let metal = Material { metallic: 1.0, ..surface(0.5, 0.0) };
    let leaf = Material { diffuse_transmission: DiffuseTransmission::new(1.0, Vec3::ONE), ..surface(0.5, 0.0) };
    let unlit = Material { unlit: true, ..leaf.clone() };
    let parts = [
        (&rectangles[..], surface(0.5, 0.0)),
        (&lying(-0.45, 0.25), named("black", surface(0.0, 0.0))),
        (&lying(-0.2, 0.25), named("metal", metal)),
        (&lying(0.3, 0.25), named("unlit", unlit)),
        (&lying(-0.45, 0.0), named("leaf", leaf)),
    ];
    let bench = Bench::of(gpu, &parts, None);
    let mut random = Random(2);
    // Some normals differ from those of their surface.
    let tilted = |random: &mut Random| {
        let (position, normal) = somewhere(&rectangles, random);
        let tilt = if random.unit() < 0.7 { 0.0 } else { random.unit() };
        (position, (normal + tilt * random.direction()).normalize())
    };
    let (mut checked, mut doubts, mut partly, mut wide, mut hidden, mut beside) = (0, 0, 0, 0, 0, 0);
    for (photon_count, irradiance_point_count) in
        [(0, 65), (1, 1), (20, 0), (3000, 63), (3000, 64), (3000, 1000), (20_000, 400)]
    {
        let photons: Vec<Photon> = (0..photon_count)
            .map(|_| {
                let (position, normal) = tilted(&mut random);
                let photon = photon(position, normal, 0, false);
                Photon { word: photon.word | (random.word() & !0x3fff), ..photon }
            })
            .collect();
        let irradiance_points: Vec<Photon> = (0..irradiance_point_count)
            .map(|_| {
                let (position, normal) = tilted(&mut random);
                photon(position, normal, 0, false)
            })
            .collect();
        let shape = GridShape::with_photons_per_cell(MAP_PHOTONS_PER_CELL, BOUNDS, 3.0, photon_count, 1);
        let step = 1e-4f32;
        let estimates = bench.estimate(
            gpu,
            &bench.sort(gpu, &photons, shape),
            &bench.sort(gpu, &irradiance_points, irradiance_point_grid((BOUNDS, 3.0), irradiance_point_count)),
            step,
        );
        for (irradiance_point, [r, g, b, radius]) in estimates.points.iter().zip(&estimates.irradiances) {
            checked += 1;
            let expected_radius = radius_of(&photons, &shape, irradiance_point);
            let probes = probes(&bench.stage, irradiance_point, expected_radius);
            let found = probes.map(|probes| {
                let expected = brute_force(&photons, irradiance_point, expected_radius, Some(&probes));
                (probes, expected)
            });
            let Some((probes, expected)) = found.filter(|(_, expected)| !expected.doubtful) else {
                doubts += 1;
                continue;
            };
            let Probes { share, share_of_any, clear, .. } = probes;
            let value = DVec3::new(f64::from(*r), f64::from(*g), f64::from(*b));
            let right = expected.density * f64::from(step) / share;
            // Sums are integers: only a square and some quotients are rounded.
            let agrees = |right: DVec3| (value - right).abs().max_element() <= 1e-6 * right.abs().max_element();
            assert!(agrees(right), "{irradiance_point:?}: {value}, expected {right}");
            // The last eight bits hold the clear part.
            // They are 255 of 2^23 at most: 3e-5.
            assert!((f64::from(*radius) - expected_radius).abs() < 5e-5 * expected_radius);
            assert!(
                (f64::from(radius.to_bits() & 255) / 255.0 - clear).abs() < 1.001 / 255.0,
                "{irradiance_point:?}: {clear}"
            );
            if right != DVec3::ZERO {
                assert!(!agrees(right * 16.0 / 17.0), "a probe more");
                wide += u32::from(expected_radius > 1.5 * f64::from(shape.cell));
                partly += u32::from(!agrees(right * share));
                beside += u32::from(!agrees(right * share / share_of_any));
                let unhidden = brute_force(&photons, irradiance_point, expected_radius, None).density;
                hidden += u32::from(!agrees(unhidden * f64::from(step) / share));
            }
        }
    }
    println!(
        "{checked} irradiance points, {doubts} undecided, {partly} partly covered, {wide} with sparse photons, \
         {hidden} with photons behind walls, {beside} beside surfaces without photons"
    );
    // Guards: rounding leaves few points undecided, and there are points of each kind.
    assert!(doubts * 5 < checked && partly > 50 && wide > 10 && hidden > 10 && beside > 10);
}

/// A floor, a grid of cells a twentieth wide, and 16,000 photons of bright light in one of the cells, with few others.
fn dense_cell() -> (Rectangle, GridShape, Vec<Photon>) {
    let floor = Rectangle(Vec3::new(-0.5, -0.5, -0.5), Vec3::new(0.0, 0.0, 1.0), Vec3::new(1.0, 0.0, 0.0));
    let shape = GridShape { origin: [-0.5; 3], cell: 0.05, size: [20; 3], inverse_cell: 20.0 };
    let mut random = Random(11);
    let mut near = || Vec3::new(0.015 + 0.02 * random.unit(), -0.5, 0.015 + 0.02 * random.unit());
    let photons = (0..16_000).map(|_| carrying(near(), Vec3::Y, [31, 20, 1])).collect();
    (floor, shape, photons)
}

/// Points around the dense cell, two cells from it in x and up to three in z: no photon is in the 27 cells around any
/// of them, so their discs are four cells wide and have all photons of the dense cell.
fn points_around_the_dense_cell() -> Vec<Photon> {
    let position = |i: i32| Vec3::new(0.125, -0.5, 0.025 + 0.05 * i as f32);
    (-3..4).map(|i| photon(position(i), Vec3::Y, 0, false)).collect()
}

/// The lanes of a vector visit a dense row one after the other, where it has another place among the rows of each. On
/// lavapipe they share the iterations of loops, of which all photons of all lanes would take more than there are.
#[kernel_test("PENUMBRA_DEVICE")]
fn dense_cells_are_not_too_dark(gpu: &Gpu) {
    let (floor, shape, photons) = dense_cell();
    let bench = Bench::new(gpu, &[floor]);
    let points = points_around_the_dense_cell();
    let map = bench.sort(gpu, &photons, shape);
    let found = bench.estimate(
        gpu,
        &map,
        &bench.sort(gpu, &points, irradiance_point_grid((BOUNDS, 1.0), points.len() as u32)),
        1e-4,
    );
    let light = |radius: f64| 16_000.0 * 31.0 * 1e-4 / (PI * radius * radius);
    assert_eq!(found.irradiances.len(), 7);
    for (point, [red, ..]) in found.points.iter().zip(&found.irradiances) {
        let radius = radius_of(&photons, &shape, point);
        // Four cells of 0.05, which f32 rounds by 1e-9.
        assert!((radius - 0.2).abs() < 1e-6);
        // One photon of 16,000 is 6e-5: two that are lost are noticed. Sums are whole numbers below 2^24, so exact.
        assert!((f64::from(*red) / light(radius) - 1.0).abs() < 1e-4, "{point:?}: {red}, not {}", light(radius));
    }
}

/// The iterations of the probes leave enough for the photons, or there is no estimate. The probes pass more and more
/// floors at one place, all of which they must test.
#[kernel_test("PENUMBRA_DEVICE")]
fn probes_leave_iterations_for_photons(gpu: &Gpu) {
    let (floor, shape, photons) = dense_cell();
    let (mut known, mut unknown) = (0, 0);
    for floors in [100, 400, 800, 1200, 1380, 1590, 1830, 2100, 2410, 2780, 3200, 3680] {
        let bench = Bench::new(gpu, &vec![floor; floors]);
        let points = points_around_the_dense_cell();
        let map = bench.sort(gpu, &photons, shape);
        let grid = irradiance_point_grid((BOUNDS, 1.0), 1);
        let found = bench.estimate(gpu, &map, &bench.sort(gpu, &points[3..4], grid), 1e-4);
        let [red, _, _, radius] = found.irradiances[0];
        let right = 16_000.0 * 31.0 * 1e-4 / (PI * 0.2 * 0.2);
        println!("{floors} floors: {:.4} of the light, radius {radius}", f64::from(red) / right);
        if radius == FAR {
            assert_eq!(red, 0.0);
            unknown += 1;
        } else {
            // As above: two lost photons of 16,000 are noticed.
            assert!((f64::from(red) / right - 1.0).abs() < 1e-4, "{floors} floors: {red}, not {right}");
            known += 1;
        }
    }
    assert!(known > 0 && unknown > 0, "{known} estimates, {unknown} without");
}

/// A surface uniformly covered with photons, and irradiance points on it.
struct Lit {
    name: &'static str,
    /// The whole scene; photons lie where `lit` accepts a rectangle's number and a position.
    rectangles: Vec<Rectangle>,
    lit: fn(usize, Vec3) -> bool,
    /// The part of the first rectangle where irradiance points lie.
    within: fn(Vec3) -> bool,
    /// Whether a part of their discs is missing.
    cut: bool,
}

/// The mean estimate of photons of a uniform irradiance is that irradiance: in the open, at an edge, in a corner,
/// beside a cube, around the end of a wall, and on a thin wall, also where the disc reaches over the edge. Without the
/// correction for the share of the disc that is surface, it would not be.
#[kernel_test("PENUMBRA_DEVICE")]
fn even_light_is_even(gpu: &Gpu) {
    let v = Vec3::new;
    let floor = Rectangle(v(-0.5, -0.5, -0.5), v(0.0, 0.0, 1.0), v(1.0, 0.0, 0.0));
    let under = Rectangle(v(-0.5, -0.5 - 1e-5, -0.5), v(1.0, 0.0, 0.0), v(0.0, 0.0, 1.0));
    let half_a_wall = Rectangle(v(0.0, -0.5, -0.5), v(0.0, 0.0, 0.5), v(0.0, 0.5, 0.0));
    let outside_cube = |i: usize, p: Vec3| i > 0 || (p.x - 0.1).abs().max((p.z - 0.1).abs()) > 0.15;
    let cases = [
        Lit {
            name: "open floor",
            rectangles: vec![floor],
            lit: |_, _| true,
            within: |p| p.x.abs().max(p.z.abs()) < 0.3,
            cut: false,
        },
        Lit {
            name: "edge",
            rectangles: vec![floor],
            lit: |_, _| true,
            within: |p| p.x > 0.4 && p.z.abs() < 0.3,
            cut: true,
        },
        Lit {
            name: "corner",
            rectangles: corner_and_cube(),
            lit: outside_cube,
            within: |p| p.x < -0.42 && p.z < 0.0,
            cut: true,
        },
        Lit {
            name: "beside a cube",
            rectangles: corner_and_cube(),
            lit: outside_cube,
            within: |p| (0.15..0.22).contains(&(p.x - 0.1).abs().max((p.z - 0.1).abs())),
            cut: true,
        },
        Lit {
            name: "at the end of a wall",
            rectangles: vec![floor, half_a_wall],
            lit: |i, _| i == 0,
            within: |p| p.x.abs() < 0.1 && p.z.abs() < 0.1,
            cut: false,
        },
        Lit {
            name: "lit side of a thin wall",
            rectangles: vec![floor, under],
            lit: |i, _| i == 0,
            within: |p| p.x.abs() < 0.3,
            cut: false,
        },
    ];
    const MAPS: usize = 64;
    const DENSITY: f32 = 3000.0;
    const IRRADIANCE_POINTS: u32 = 256;
    const STEP: f32 = 1e-3;
    let mut random = Random(5);
    for case in cases {
        let bench = Bench::new(gpu, &case.rectangles);
        let area: f32 = case.rectangles.iter().map(Rectangle::area).sum();
        let (mut estimates, mut uncorrected) = (Vec::new(), Vec::new());
        for _ in 0..MAPS {
            let mut photons = Vec::new();
            for (i, rectangle) in case.rectangles.iter().enumerate() {
                let count = (rectangle.area() * DENSITY) as usize;
                let positions = (0..count).map(|_| on(rectangle, &mut random)).filter(|p| (case.lit)(i, *p));
                photons.extend(positions.map(|p| carrying(p, rectangle.normal(), [31, 20, 1])));
            }
            let floor = &case.rectangles[0];
            let tries = std::iter::repeat_with(|| on(floor, &mut random)).filter(|p| (case.within)(*p));
            let irradiance_points: Vec<Photon> =
                tries.take(IRRADIANCE_POINTS as usize).map(|p| photon(p, floor.normal(), 0, false)).collect();
            let shape = GridShape::with_photons_per_cell(MAP_PHOTONS_PER_CELL, BOUNDS, area, photons.len() as u32, 1);
            let map = bench.sort(gpu, &photons, shape);
            let of = bench.estimate(
                gpu,
                &map,
                &bench.sort(gpu, &irradiance_points, irradiance_point_grid((BOUNDS, area), IRRADIANCE_POINTS)),
                STEP,
            );
            let n = f64::from(IRRADIANCE_POINTS);
            estimates.push(of.irradiances.iter().map(|estimates| f64::from(estimates[0])).sum::<f64>() / n);
            if case.cut {
                let density = |irradiance_point| {
                    let radius = radius_of(&photons, &shape, irradiance_point);
                    brute_force(&photons, irradiance_point, radius, None).density.x
                };
                uncorrected.push(of.points.iter().map(density).sum::<f64>() * f64::from(STEP) / n);
            }
        }
        let expected = f64::from(DENSITY) * 31.0 * f64::from(STEP);
        let (mean, error) = mean_and_error(estimates.iter().copied());
        println!("{}: {:.4} +- {:.4}", case.name, mean / expected, error / expected);
        z_test(mean, error, expected, 5).unwrap_or_else(|e| panic!("{}: {e}", case.name));
        z_test(1.05 * mean, error, expected, 5).expect_err("five percent too much");
        if case.cut {
            let (mean, error) = mean_and_error(uncorrected.iter().copied());
            println!("  uncorrected {:.4} +- {:.4}", mean / expected, error / expected);
            z_test(mean, error, expected, 5).expect_err("without the share that is surface");
        }
    }
}

/// The other side of a thin wall is dark: no light leaks through.
#[kernel_test("PENUMBRA_DEVICE")]
fn thin_walls_let_nothing_through(gpu: &Gpu) {
    let v = Vec3::new;
    let top = Rectangle(v(-0.5, 0.0, -0.5), v(0.0, 0.0, 1.0), v(1.0, 0.0, 0.0));
    let under = Rectangle(v(-0.5, -1e-5, -0.5), v(1.0, 0.0, 0.0), v(0.0, 0.0, 1.0));
    let bench = Bench::new(gpu, &[top, under]);
    let mut random = Random(8);
    let photons: Vec<Photon> = (0..3000).map(|_| carrying(on(&top, &mut random), Vec3::Y, [31; 3])).collect();
    let irradiance_points: Vec<Photon> = (0..200)
        .map(|i| {
            let side = if i % 2 == 0 { &top } else { &under };
            photon(on(side, &mut random), side.normal(), 0, false)
        })
        .collect();
    let shape = GridShape::with_photons_per_cell(MAP_PHOTONS_PER_CELL, BOUNDS, 2.0, 3000, 1);
    let estimates = bench.estimate(
        gpu,
        &bench.sort(gpu, &photons, shape),
        &bench.sort(gpu, &irradiance_points, irradiance_point_grid((BOUNDS, 2.0), 200)),
        1.0,
    );
    for (irradiance_point, estimates) in estimates.points.iter().zip(&estimates.irradiances) {
        assert_eq!(
            estimates[0] > 0.0,
            photon_normal(irradiance_point.word).y > 0.0,
            "{irradiance_point:?}: {estimates:?}"
        );
    }
}

/// Of the light on the floor of a bright room next to nothing counts in a dark one, from which a wall without thickness
/// parts it: only photons in the segments that the wall cuts off between the probes. It would be a fifth without the
/// walls that stop probes.
#[kernel_test("PENUMBRA_DEVICE")]
fn no_light_passes_a_wall_between_rooms(gpu: &Gpu) {
    let v = Vec3::new;
    let floor = Rectangle(v(-0.5, -0.5, -0.5), v(0.0, 0.0, 1.0), v(1.0, 0.0, 0.0));
    let wall = Rectangle(v(0.0, -0.5, -0.5), v(0.0, 0.0, 1.0), v(0.0, 0.5, 0.0));
    let bench = Bench::new(gpu, &[floor, wall]);
    let mut random = Random(14);
    let photons: Vec<Photon> = std::iter::repeat_with(|| on(&floor, &mut random))
        .filter(|p| p.x < 0.0)
        .take(3000)
        .map(|p| carrying(p, Vec3::Y, [31; 3]))
        .collect();
    let shape = GridShape::with_photons_per_cell(MAP_PHOTONS_PER_CELL, BOUNDS, 2.0, 3000, 1);
    let irradiance_points: Vec<Photon> = std::iter::repeat_with(|| on(&floor, &mut random))
        .filter(|p| p.x > 1e-3 && p.x < shape.cell && p.z.abs() < 0.3)
        .take(256)
        .map(|p| photon(p, Vec3::Y, 0, false))
        .collect();
    let map = bench.sort(gpu, &photons, shape);
    let estimates =
        bench.estimate(gpu, &map, &bench.sort(gpu, &irradiance_points, irradiance_point_grid((BOUNDS, 2.0), 256)), 1.0);
    // 6,000 photons a unit of area.
    let bright = 6000.0 * 31.0;
    let mean = |values: &mut dyn Iterator<Item = f64>| values.sum::<f64>() / 256.0 / bright;
    let dark = mean(&mut estimates.irradiances.iter().map(|value| f64::from(value[0])));
    let leaked = mean(&mut estimates.points.iter().map(|point| {
        let radius = radius_of(&photons, &shape, point);
        brute_force(&photons, point, radius, None).density.x
    }));
    println!("{dark:.4} of the light, {leaked:.4} by all photons of the discs");
    assert!(dark < 0.01 && leaked > 0.1, "{dark} {leaked}");
}

/// Photons that only focusing surfaces have scattered count twice: as all photons do, and in a part of their own. A
/// look-up finds that part of the nearest irradiance point.
#[kernel_test("PENUMBRA_DEVICE")]
fn focused_light_is_kept_apart(gpu: &Gpu) {
    const STEP: f32 = 1e-4;
    let rectangles = corner_and_cube();
    let bench = Bench::with(gpu, &rectangles, Some(Feature::CausticIrradiance));
    let mut random = Random(13);
    let photons = photons_of_any_flux(&rectangles, 5000, &mut random);
    // The oracle subtracts photons with bit 31.
    let unmarked = |p: &Photon| Photon { word: p.word & !(1 << 31), ..*p };
    let all: Vec<Photon> = photons.iter().map(unmarked).collect();
    let shape = GridShape::with_photons_per_cell(MAP_PHOTONS_PER_CELL, BOUNDS, 3.0, 5000, 1);
    let map = bench.sort(gpu, &photons, shape);
    let pass = Irradiance::new(gpu, &bench.stage.features, &bench.stage.gpu_scene.constants()).unwrap();
    for count in [0u32, 1, 63, 64, 65, 400] {
        let irradiance_points: Vec<Photon> = (0..count)
            .map(|_| {
                let (position, normal) = somewhere(&rectangles, &mut random);
                photon(position, normal, 0, false)
            })
            .collect();
        let sorted = bench.sort(gpu, &irradiance_points, irradiance_point_grid((BOUNDS, 3.0), count));
        let estimates = bench.estimate(gpu, &map, &sorted, STEP);
        assert_eq!((estimates.irradiances.len(), estimates.caustics.len()), (count as usize, count as usize));
        let points: Vec<Point> =
            estimates.points.iter().map(|p| point(Vec3::from(p.position), photon_normal(p.word).as_vec3())).collect();
        let known = pass.precompute(gpu, &bench.stage.gpu_scene, &map, sorted, STEP.into()).unwrap();
        assert_eq!(bench.look_up(gpu, "focused", &known, &points, points.len()), estimates.caustics);
        let mut checked = 0;
        for ((point, value), caustic) in estimates.points.iter().zip(&estimates.irradiances).zip(&estimates.caustics) {
            let radius = radius_of(&all, &shape, point);
            let Some(probes) = probes(&bench.stage, point, radius) else { continue };
            let share = probes.share;
            let found = brute_force(&all, point, radius, Some(&probes));
            if found.doubtful {
                continue;
            }
            // All less those with the mark, less those without it, are twice those with it.
            let without = (found.density + brute_force(&photons, point, radius, Some(&probes)).density) / 2.0;
            let expected = [found.density, found.density - without].map(|density| density * f64::from(STEP) / share);
            let off = |value: &[f32; 4], expected: DVec3| {
                let value = DVec3::new(f64::from(value[0]), f64::from(value[1]), f64::from(value[2]));
                // Sums are whole numbers, some products and quotients are in f32.
                (value - expected).abs().max_element() / (1e-6 * expected.abs().max_element() + 1e-9)
            };
            assert!(off(value, expected[0]) <= 1.0, "{point:?}: {value:?}, expected {}", expected[0]);
            assert!(off(caustic, expected[1]) <= 1.0, "{point:?}: {caustic:?}, expected {}", expected[1]);
            if expected[1].max_element() > 0.0 {
                checked += 1;
                assert!(off(caustic, expected[0] - expected[1]) > 1.0, "the other photons would pass");
            }
        }
        assert!(count < 400 || checked > 200, "{checked} of {count} points have focused light");
    }
}

/// Irradiance points whose irradiance is beyond f32 have no estimate and are counted. Those that no photon reaches are
/// not among them, unless the step itself is infinite.
#[kernel_test("PENUMBRA_DEVICE")]
fn irradiance_that_is_not_finite_gives_no_estimate(gpu: &Gpu) {
    let rectangles = corner_and_cube();
    let bench = Bench::new(gpu, &rectangles);
    let mut random = Random(9);
    let floor = &rectangles[0];
    let photons: Vec<Photon> = (0..2000).map(|_| carrying(on(floor, &mut random), floor.normal(), [31; 3])).collect();
    let irradiance_points: Vec<Photon> = rectangles
        .iter()
        .flat_map(|rectangle| [(); 10].map(|()| photon(on(rectangle, &mut random), rectangle.normal(), 0, false)))
        .collect();
    let shape = GridShape::with_photons_per_cell(MAP_PHOTONS_PER_CELL, BOUNDS, 3.0, 2000, 1);
    let estimate = |step: f32| {
        let sorted =
            bench.sort(gpu, &irradiance_points, irradiance_point_grid((BOUNDS, 3.0), irradiance_points.len() as u32));
        bench.estimate(gpu, &bench.sort(gpu, &photons, shape), &sorted, step)
    };
    let lit = |estimates: &Estimates| estimates.irradiances.iter().filter(|estimates| estimates[0] > 0.0).count();
    let sound = estimate(1e-4);
    assert!(lit(&sound) > 5 && sound.not_finite == 0, "{}", sound.not_finite);
    let beyond = estimate(1e38);
    assert_eq!((lit(&beyond), beyond.not_finite as usize), (0, lit(&sound)));
    assert!(estimate(f32::INFINITY).not_finite > beyond.not_finite);
}

/// The entry points `show` and `caustics` give the estimates of brute force at points on all surfaces, some of them
/// invalid and some black.
#[kernel_test("PENUMBRA_DEVICE")]
fn shown_points_are_those_of_brute_force(gpu: &Gpu) {
    const STEP: f32 = 1e-4;
    let rectangles = corner_and_cube();
    let mut random = Random(11);
    let photons = photons_of_any_flux(&rectangles, 5000, &mut random);
    let shape = GridShape::with_photons_per_cell(MAP_PHOTONS_PER_CELL, BOUNDS, 3.0, 5000, 1);
    let shell = Shell { centre: [0.1, -0.3, 0.05], inner: 0.2, outer: 0.5 };
    for (entry, feature, shrink, shell) in [
        ("show", Feature::PhotonMap, 1.0, Shell::ALL),
        ("caustics", Feature::Caustics, 0.6f32, Shell::ALL),
        ("caustics", Feature::Caustics, 0.6f32, shell),
    ] {
        let bench = Bench::with(gpu, &rectangles, Some(feature));
        let map = bench.sort(gpu, &photons, shape);
        for count in [0usize, 1, 63, 64, 65, 300] {
            let points: Vec<Point> = (0..count)
                .map(|i| match somewhere(&rectangles, &mut random) {
                    (position, _) if i % 7 == 3 => Point { position: position.to_array(), normal: INVALID_POINT },
                    (position, normal) => point(position, normal),
                })
                .collect();
            let surfaces: Vec<[f32; 4]> =
                (0..count).map(|i| [0, 1, 2, 3].map(|_| if i % 11 == 5 { 0.0 } else { random.unit() })).collect();
            let shown = bench.show(gpu, entry, &map, &points, &surfaces, ([STEP, shrink], shell));
            let (mut estimates, mut others) = (0, 0);
            for ((point, [r, g, b, _]), value) in points.iter().zip(&surfaces).zip(&shown) {
                let albedo = DVec3::new(f64::from(*r), f64::from(*g), f64::from(*b));
                let before = if entry == "show" { 0.0 } else { 1.0 };
                let mut expected = DVec3::splat(before);
                let distance = (Vec3::from(point.position) - Vec3::from(shell.centre)).abs().max_element();
                let is_in_shell = distance > shell.inner && distance <= shell.outer;
                others += usize::from(!is_in_shell);
                if point.normal != INVALID_POINT && is_in_shell {
                    let (x, n) = (Vec3::from(point.position), point_normal(point.normal));
                    let radius = radius_at(&photons, &shape, x, f64::from(shrink), 1.0);
                    // Focused light has no probes.
                    let probes = match entry {
                        "show" => match probes_about(&bench.stage, x, n, radius) {
                            Some(probes) => Some(probes),
                            None => continue,
                        },
                        _ => None,
                    };
                    let share = probes.as_ref().map_or(1.0, |probes| probes.share);
                    let found = density(&photons, x, n, radius, probes.as_ref());
                    if found.doubtful {
                        continue;
                    }
                    expected += albedo * found.density * f64::from(STEP) / (PI * share);
                }
                let off = |expected: DVec3| {
                    let value = DVec3::new(f64::from(value[0]), f64::from(value[1]), f64::from(value[2]));
                    // Sums are whole numbers, some products and quotients are in f32; a value added to 1 is rounded
                    // with it.
                    (value - expected).abs().max_element() / (1e-6 * (expected - before).abs().max_element() + 2e-7)
                };
                assert!(off(expected) <= 1.0, "{entry}, {point:?}: {value:?}, expected {expected}");
                if expected != DVec3::splat(before) {
                    estimates += 1;
                    // A sum of both signs may be near 0.
                    let weak = (expected - before).abs().max_element() < 1e-4;
                    assert!(weak || off(before + (expected - before) * 1.01) > 1.0, "a hundredth too much would pass");
                }
            }
            let expected = if shell == Shell::ALL { 150..300 } else { 20..150 };
            assert!(count < 300 || expected.contains(&estimates), "{entry}: {estimates} points have an estimate");
            assert!(count < 300 || (others > 50) == (shell != Shell::ALL), "{others} points outside of {shell:?}");
        }
    }
}

/// More points than a dispatch has groups along one axis, nearly all of them invalid: the last few are estimated.
#[kernel_test("PENUMBRA_DEVICE")]
fn points_beyond_an_axis_of_groups_are_shown(gpu: &Gpu) {
    let rectangles = corner_and_cube();
    let mut random = Random(12);
    let floor = &rectangles[0];
    let photons: Vec<Photon> = (0..2000).map(|_| carrying(on(floor, &mut random), floor.normal(), [31; 3])).collect();
    let shape = GridShape::with_photons_per_cell(MAP_PHOTONS_PER_CELL, BOUNDS, 3.0, 2000, 1);
    let nowhere = Point { position: [0.0; 3], normal: INVALID_POINT };
    let mut points = vec![nowhere; 65_535 * 64 + 100];
    let estimates = points.len() - 50..points.len();
    points[estimates.clone()].fill_with(|| point(on(floor, &mut random), floor.normal()));
    let surfaces = vec![[1.0; 4]; points.len()];
    for (entry, feature, before) in [("show", Feature::PhotonMap, 0.0), ("caustics", Feature::Caustics, 1.0)] {
        let bench = Bench::with(gpu, &rectangles, Some(feature));
        let shown =
            bench.show(gpu, entry, &bench.sort(gpu, &photons, shape), &points, &surfaces, ([1e-4, 1.0], Shell::ALL));
        let changed: Vec<usize> = (0..shown.len()).filter(|&i| shown[i][0] != before).collect();
        assert!(changed.iter().all(|i| estimates.contains(i)), "{entry}: written at invalid points");
        assert!(changed.len() > 40, "{entry}: {} of the last points are estimated", changed.len());
    }
}

/// A look-up returns the value of the nearest irradiance point of the same surface in the 2 x 2 x 2 nearest cells. If
/// they hold none, it takes the nearest within two cells. The table holds what the kernel wrote.
#[kernel_test("PENUMBRA_DEVICE")]
fn look_ups_find_the_nearest_irradiance_point(gpu: &Gpu) {
    let rectangles = corner_and_cube();
    let bench = Bench::new(gpu, &rectangles);
    let mut random = Random(4);
    let photons: Vec<Photon> = (0..5000)
        .map(|_| {
            let (position, normal) = somewhere(&rectangles, &mut random);
            carrying(position, normal, [random.word() % 32, random.word() % 32, random.word() % 32])
        })
        .collect();
    let shape = GridShape::with_photons_per_cell(MAP_PHOTONS_PER_CELL, BOUNDS, 3.0, 5000, 1);
    let map = bench.sort(gpu, &photons, shape);
    let pass = Irradiance::new(gpu, &bench.stage.features, &bench.stage.gpu_scene.constants()).unwrap();
    for (irradiance_point_count, point_count) in [(0u32, 10), (1, 63), (300, 64), (300, 65), (1000, 5000)] {
        let irradiance_points: Vec<Photon> = (0..irradiance_point_count)
            .map(|_| {
                let (position, normal) = somewhere(&rectangles, &mut random);
                photon(position, normal, 0, false)
            })
            .collect();
        let points: Vec<Point> = (0..point_count)
            .map(|_| {
                let (position, normal) = somewhere(&rectangles, &mut random);
                // Points on surfaces, above them, and outside of the grid.
                let off = [0.0, 0.0, 0.05, 0.5][random.word() as usize % 4];
                point(position + off * random.direction(), normal)
            })
            .collect();
        let shape = irradiance_point_grid((BOUNDS, 3.0), irradiance_point_count);
        let estimates = bench.estimate(gpu, &map, &bench.sort(gpu, &irradiance_points, shape), 1.0);
        let by_irradiance_point: std::collections::HashMap<[u32; 4], [f32; 4]> =
            estimates.points.iter().map(|p| bytemuck::cast(*p)).zip(estimates.irradiances.iter().copied()).collect();
        let sorted = bench.sort(gpu, &irradiance_points, shape);
        let sorted_irradiance_points: Vec<[u32; 4]> =
            gpu.read(&sorted.sorted, irradiance_point_count as usize).unwrap();
        let known = pass.precompute(gpu, &bench.stage.gpu_scene, &map, sorted, 1.0).unwrap();
        let read = |entry: &str, count: usize| bench.look_up(gpu, entry, &known, &points, count);
        for (irradiance_point, held) in
            sorted_irradiance_points.iter().zip(read("dump", irradiance_point_count as usize))
        {
            assert_eq!(by_irradiance_point[irradiance_point], held, "{irradiance_point:?}");
        }
        // Without an irradiance point there is no value.
        let mut found = read("near", points.len());
        found
            .iter_mut()
            .filter(|estimates| estimates[3] == FAR)
            .for_each(|estimates| *estimates = [0.0, 0.0, 0.0, FAR]);
        let cell = f64::from(shape.cell);
        // The value of an irradiance point for a position, or none beyond the clear part of its disc; both if rounding
        // decides.
        let reached = |(counted, _, estimates): &(f64, Vec3, [f32; 4])| -> Vec<[f32; 4]> {
            let clear = f64::from(estimates[3]) * f64::from(estimates[3].to_bits() & 255) / 255.0;
            let nothing = [0.0, 0.0, 0.0, FAR];
            // Distances of positions up to 1 apart have a few roundings of 6e-8.
            if (counted - clear).abs() < 1e-6 {
                vec![*estimates, nothing]
            } else {
                vec![if *counted < clear { *estimates } else { nothing }]
            }
        };
        // The permitted values of a point.
        let allowed = |point: &Point| -> Vec<[f32; 4]> {
            let (x, n) = (Vec3::from(point.position).as_dvec3(), point_normal(point.normal));
            let mut near: Vec<(f64, Vec3, [f32; 4])> = irradiance_points
                .iter()
                .filter(|p| photon_normal(p.word).dot(n) > 0.5f64.sqrt())
                .map(|p| {
                    let d = Vec3::from(p.position).as_dvec3() - x;
                    let counted = (d.length_squared() + 15.0 * d.dot(n).powi(2)).sqrt();
                    (counted, p.position.into(), by_irradiance_point[&bytemuck::cast::<Photon, [u32; 4]>(*p)])
                })
                .collect();
            near.sort_by(|a, b| a.0.total_cmp(&b.0));
            let corner = (Vec3::from(point.position) - Vec3::from(shape.origin)) * shape.inverse_cell - 0.5;
            let in_cells = |p: &&(f64, Vec3, [f32; 4])| {
                let cell = cell_at(&shape, p.1);
                (0..3).all(|axis| (0..2).contains(&(cell[axis] - corner[axis].floor() as i64)))
            };
            // Cells of positions up to 20 cells away have a few roundings of 1e-6.
            let doubtful = corner.to_array().iter().any(|x| (x - x.round()).abs() < 1e-5);
            let first_search: Vec<_> = near.iter().filter(in_cells).collect();
            let second_search = near.iter().filter(|p| p.0 < 1.9999 * cell);
            let is_first = !first_search.is_empty();
            let candidates: Vec<_> = if is_first { first_search } else { second_search.collect() };
            match candidates.first() {
                Some((counted, ..)) if !doubtful => {
                    candidates.iter().filter(|p| p.0 < counted + 1e-6).flat_map(|p| reached(p)).collect()
                }
                // The second search also meets some points that are farther than two cells.
                _ => near.iter().flat_map(reached).chain([[0.0, 0.0, 0.0, FAR]]).collect(),
            }
        };
        let wrong = |found: &[[f32; 4]]| {
            points.iter().zip(found).filter(|(p, estimates)| !allowed(p).contains(estimates)).count()
        };
        assert_eq!(wrong(&found), 0, "{irradiance_point_count} irradiance points");
        let certain = points.iter().filter(|p| allowed(p).len() == 1).count();
        if irradiance_point_count == 1000 {
            assert!(certain > points.len() / 3, "{certain} of {} points have a certain value", points.len());
            let mut turned = found.clone();
            turned.rotate_left(1);
            assert!(wrong(&turned) > certain / 2, "answers for the wrong points");
        }
    }
}

/// A look-up among more irradiance points than it may visit finds nothing, so that the path goes on by rays, for which
/// loop iterations must remain. Here a cell holds all points, as where a scene is far larger than its lit part.
#[kernel_test("PENUMBRA_DEVICE")]
fn look_ups_visit_a_limited_number_of_irradiance_points(gpu: &Gpu) {
    const MAX_VISITS: usize = 4096;
    let rectangles = corner_and_cube();
    let bench = Bench::new(gpu, &rectangles);
    let mut random = Random(5);
    let photons = photons_of_any_flux(&rectangles, 5000, &mut random);
    let shape = GridShape::with_photons_per_cell(MAP_PHOTONS_PER_CELL, BOUNDS, 3.0, 5000, 1);
    let map = bench.sort(gpu, &photons, shape);
    let pass = Irradiance::new(gpu, &bench.stage.features, &bench.stage.gpu_scene.constants()).unwrap();
    let lit = Rectangle(Vec3::new(-0.3, -0.5, -0.3), Vec3::Z * 1e-4, Vec3::X * 1e-4);
    let queries: Vec<Point> = (0..64).map(|_| point(on(&lit, &mut random), lit.normal())).collect();
    for count in [1, MAX_VISITS, MAX_VISITS + 1, 70_000] {
        let crowd: Vec<Photon> = (0..count).map(|_| photon(on(&lit, &mut random), lit.normal(), 0, false)).collect();
        let sorted = bench.sort(gpu, &crowd, irradiance_point_grid((BOUNDS, 3.0), count as u32));
        let known = pass.precompute(gpu, &bench.stage.gpu_scene, &map, sorted, 1.0).unwrap();
        let found = bench.look_up(gpu, "near", &known, &queries, queries.len());
        let without = found.iter().filter(|[.., radius]| *radius == FAR).count();
        let expected = if count <= MAX_VISITS { 0 } else { queries.len() };
        assert_eq!(without, expected, "of {} look-ups among {count} irradiance points", queries.len());
    }
}
