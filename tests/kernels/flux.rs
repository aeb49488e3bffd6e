//! Pass `flux`: photons carry exactly the power of the lights to the surfaces, and their encoding keeps the mean.

use std::f64::consts::PI;
use std::sync::Arc;

use glam::{DVec3, Vec3, Vec4};
use kernel_kit::{Gpu, POISON, Resources, kernel_test};
use penumbra::internal::kernels::{compose, compose_source};
use penumbra::internal::passes::flux::{Flux, FluxSettings};
use penumbra::internal::passes::grid::Photon;
use penumbra::internal::scene::{LightKind, Material, Scene, Transmission};
use penumbra::settings::Technique;

use crate::kit::{device_features, new_kernel};
use crate::light::{Corners, cube, form_factor, sphere, square};
use crate::path::{camera, inside_out, scene, surface};
use crate::random::Random;
use crate::stage::Stage;
use crate::statistics::{chi_square, z_test};

const SEED: u32 = 7;

fn stage(gpu: &Gpu, scene: Scene) -> Stage {
    Stage::new(gpu, scene, &camera(DVec3::ZERO, DVec3::X, 1.0), [1, 1], Technique::SHADOW_PHOTONS, |features| features)
}

/// A room of edge 1 with walls of the given albedo.
fn room(albedo: f32) -> (Vec<Corners>, Material) {
    (inside_out(cube(DVec3::ZERO, 0.5)), surface(albedo, 0.0))
}

fn point_light(position: Vec3, intensity: Vec3) -> LightKind {
    LightKind::Point { position, intensity, range: f32::INFINITY }
}

/// Steps of flux in a photon's word, by channel.
pub fn steps(word: u32) -> DVec3 {
    DVec3::from([14, 19, 24].map(|at| f64::from((word >> at & 31) << (3 * (word >> 29 & 3)))))
}

struct Traced {
    photons: Vec<Photon>,
    emitted: u32,
    rays: u64,
    step: f64,
}

impl Traced {
    fn new(gpu: &Gpu, stage: &Stage, rays: u32, max_bounces: u32) -> Traced {
        Traced::with(gpu, stage, FluxSettings { rays, max_bounces, seed: SEED, caustics_only: false })
    }

    fn with(gpu: &Gpu, stage: &Stage, settings: FluxSettings) -> Traced {
        let pass = Flux::new(gpu, &stage.features, &stage.gpu_scene.constants()).unwrap();
        let traced = pass.trace(gpu, &stage.gpu_scene, &stage.gpu_scene.lights, settings).unwrap();
        assert_eq!(traced.clipped, 0);
        let photons = gpu.read(&traced.photons, traced.count as usize).unwrap();
        Traced { photons, emitted: traced.emitted, rays: traced.rays, step: traced.step }
    }

    /// Power of the photons at the positions that `within` accepts, by channel.
    fn power(&self, within: impl Fn(DVec3) -> bool) -> DVec3 {
        let photons = self.photons.iter().filter(|p| within(Vec3::from(p.position).as_dvec3()));
        photons.map(|p| steps(p.word)).sum::<DVec3>() * self.step
    }

    /// Standard error of a sum by the rounding of flux: at most half a step, where steps are 8 times larger for up to 8
    /// units.
    fn rounding(&self) -> f64 {
        (self.photons.len() as f64).sqrt() * 4.0 * self.step
    }
}

/// In a closed room of albedo a, the walls absorb (1 - a) of the flux of the photons, which is the power that the light
/// emits: a box and a sphere, lit by a point light and by the walls themselves. A path has n bounces with probability
/// a^n (1 - a), so the standard deviation of a ray's share is sqrt(a).
#[kernel_test("PENUMBRA_DEVICE")]
fn closed_rooms_keep_their_energy(gpu: &Gpu) {
    let ball = |albedo, emission| (inside_out(sphere(DVec3::ZERO, 0.5, 8)), surface(albedo, emission));
    let light = || vec![point_light(Vec3::new(0.1, 0.2, -0.1), Vec3::ONE)];
    // With albedo 0.99 a ray has a hundred bounces, so fewer rays are enough.
    for (albedo, rays) in [(0.5, 1 << 15), (0.9, 1 << 15), (0.99, 1 << 13)] {
        let glowing = (room(albedo).0, surface(albedo, 0.3));
        for (name, scene) in [
            ("box", scene(&[room(albedo)], light())),
            ("sphere", scene(&[ball(albedo, 0.0)], light())),
            ("glowing box", scene(&[glowing], Vec::new())),
        ] {
            let stage = stage(gpu, scene);
            let emitted = stage.gpu_scene.lights.lights[0].power;
            // A path has more than 4000 bounces with probability 1e-18.
            let traced = Traced::new(gpu, &stage, rays, 4000);
            assert_eq!(traced.emitted, rays);
            assert_eq!(traced.rays, traced.photons.len() as u64, "{name}, {albedo}: rays that left the room");
            let absorbed = (1.0 - f64::from(albedo)) * traced.power(|_| true);
            let error = emitted * (f64::from(albedo) / f64::from(rays)).sqrt();
            for channel in 0..3 {
                z_test(absorbed[channel], error, emitted, 27).unwrap_or_else(|e| panic!("{name}, {albedo}: {e}"));
            }
            z_test(1.06 * absorbed.x, error, emitted, 27).expect_err("six percent too much");
        }
    }
}

/// Walls with a different albedo in each channel. Each channel keeps its energy, although the strongest one decides
/// Russian roulette. All flux of a channel of albedo 0 is in the first photons.
#[kernel_test("PENUMBRA_DEVICE")]
fn colours_keep_their_energy(gpu: &Gpu) {
    let albedo = Vec3::new(0.0, 0.5, 0.9);
    let (walls, mut material) = room(0.0);
    material.base_colour = albedo.extend(1.0);
    let stage = stage(gpu, scene(&[(walls, material)], vec![point_light(Vec3::ZERO, Vec3::ONE)]));
    let emitted = stage.gpu_scene.lights.lights[0].power;
    let traced = Traced::new(gpu, &stage, 1 << 15, 4000);
    let absorbed = (DVec3::ONE - albedo.as_dvec3()) * traced.power(|_| true);
    let survival = f64::from(albedo.z);
    for channel in 0..3 {
        // A path has N > k photons with probability p^k, and the k-th carries r^k: the sum is (1 - r^N) / (1 - r), or
        // N.
        let a = f64::from(albedo[channel]);
        let r = a / survival;
        let power_mean = |r: f64| r * (1.0 - survival) / (1.0 - survival * r);
        let variance = match channel {
            2 => survival,
            _ => ((1.0 - a) / (1.0 - r)).powi(2) * (power_mean(r * r) - power_mean(r).powi(2)),
        };
        let error = emitted * (variance / f64::from(traced.emitted)).sqrt() + traced.rounding();
        z_test(absorbed[channel], error, emitted, 3).unwrap_or_else(|e| panic!("channel {channel}: {e}"));
        z_test(0.97 * absorbed[channel], error, emitted, 3).expect_err("three percent too little");
    }
}

/// Walls of a black or an unlit material store no photons, and end the path. Walls that are black only by their
/// vertices' colours store photons before the path ends, so that the density of photons does not depend on colours.
#[kernel_test("PENUMBRA_DEVICE")]
fn black_materials_store_nothing(gpu: &Gpu) {
    let (walls, black) = room(0.0);
    let unlit = Material { unlit: true, ..surface(0.8, 0.0) };
    for (material, colour, stored) in [(black, 1.0, 0), (unlit, 1.0, 0), (surface(0.8, 0.0), 0.0, 1000)] {
        let mut scene = scene(&[(walls.clone(), material)], vec![point_light(Vec3::ZERO, Vec3::ONE)]);
        for vertex in Arc::make_mut(&mut scene.vertices) {
            vertex.colour = Vec3::splat(colour).extend(1.0);
        }
        let traced = Traced::new(gpu, &stage(gpu, scene), 1000, 64);
        assert_eq!((traced.photons.len(), traced.emitted, traced.rays), (stored, 1000, 1000));
    }
}

/// Metal and glass store no photons, and reflect all of them or let them pass.
#[kernel_test("PENUMBRA_DEVICE")]
fn metal_and_glass_store_nothing(gpu: &Gpu) {
    let (walls, _) = room(0.0);
    let metal = Material { metallic: 1.0, ..surface(1.0, 0.0) };
    let glass = Material { transmission: Transmission::with_factor(1.0), roughness: 0.0, ..surface(1.0, 0.0) };
    for material in [metal, glass] {
        let stage = stage(gpu, scene(&[(walls.clone(), material)], vec![point_light(Vec3::ZERO, Vec3::ONE)]));
        let traced = Traced::new(gpu, &stage, 1000, 2);
        assert_eq!((traced.photons.len(), traced.emitted), (0, 1000));
        assert!(traced.rays > 1500, "{} rays", traced.rays);
    }
}

/// There are at most `max_bounces` bounces before a photon: with 0, one photon per ray; in general, a ray stores the
/// sum of a^k photons on average.
#[kernel_test("PENUMBRA_DEVICE")]
fn bounces_are_bounded(gpu: &Gpu) {
    const ALBEDO: f32 = 0.9;
    let stage = stage(gpu, scene(&[room(ALBEDO)], vec![point_light(Vec3::ZERO, Vec3::ONE)]));
    let a = f64::from(ALBEDO);
    for max_bounces in [0, 1, 3] {
        let traced = Traced::new(gpu, &stage, 1 << 14, max_bounces);
        let n = f64::from(traced.emitted);
        let count = traced.photons.len() as f64;
        assert!(count <= n * f64::from(max_bounces + 1) && traced.rays == traced.photons.len() as u64);
        let sum = |term: fn(f64) -> f64| (0..=max_bounces).map(|k| term(f64::from(k)) * a.powi(k as i32)).sum::<f64>();
        let (mean, square) = (sum(|_| 1.0), sum(|k| 2.0 * k + 1.0));
        if max_bounces == 0 {
            assert_eq!(traced.photons.len() as u32, traced.emitted);
        } else {
            let error = (n * (square - mean * mean)).sqrt();
            z_test(count, error, n * mean, 2).unwrap();
            z_test(count - n * a.powi(max_bounces as i32), error, n * mean, 2).expect_err("one bounce less");
        }
    }
}

/// Three lights of one colour each, with powers in the ratio of 1 to 40: the first hits carry each light's power by its
/// closed form, and each side of a mesh half of that.
#[kernel_test("PENUMBRA_DEVICE")]
fn every_light_sends_its_power(gpu: &Gpu) {
    // It reflects, so photons of the other lights are stored there.
    let lamp = Material { emissive: Vec3::X * 0.5, double_sided: true, ..surface(0.5, 0.0) };
    let panel = square(DVec3::new(0.0, 0.1, 0.0), DVec3::Z * 0.1, DVec3::X * 0.2);
    let (inner, outer) = (0.9f32, 0.6f32);
    let spot = LightKind::Spot {
        position: Vec3::new(0.3, 0.3, 0.3),
        direction: Vec3::new(-0.6, 0.0, -0.8),
        intensity: Vec3::Z * 2.0,
        cos_inner: inner,
        cos_outer: outer,
        range: f32::INFINITY,
    };
    let point = point_light(Vec3::new(-0.2, 0.3, 0.1), Vec3::Y * 0.8);
    let scene = scene(&[(panel, lamp), room(0.5)], vec![point, spot]);
    let traced = Traced::new(gpu, &stage(gpu, scene), 1 << 16, 0);
    let arrived = traced.power(|_| true);
    // Radiance times pi times area, both sides; intensity over the sphere; and over the spot's cone, between the cones
    // the square of a ramp in the cosine.
    let (i, o) = (f64::from(inner), f64::from(outer));
    let cone = [3.0, 5.0].map(|power| ((1.0 - i) + (i - o) / power) / (1.0 - o));
    let expected = [2.0 * 0.5 * PI * 0.08, 0.8 * 4.0 * PI, 2.0 * 2.0 * PI * (1.0 - o) * cone[0]];
    for (channel, expected) in expected.into_iter().enumerate() {
        let sent = traced.photons.iter().filter(|p| steps(p.word)[channel] > 0.0).count() as f64;
        assert!(sent > 200.0, "{sent} photons are no test");
        // All rays of a mesh of one radiance and of a point light carry the same, those of a spot light by its falloff.
        let spread = if channel == 2 { (cone[1] / cone[0].powi(2) - 1.0).sqrt() } else { 0.0 };
        let error = expected * spread / sent.sqrt() + 8.0 * 0.5 * traced.step * sent.sqrt();
        z_test(arrived[channel], error, expected, 4).unwrap_or_else(|e| panic!("channel {channel}: {e}"));
        z_test(1.06 * arrived[channel], error, expected, 4).expect_err("six percent too much");
        if channel == 0 {
            let above = traced.power(|p| p.y > 0.1)[0];
            let error = expected * 0.5 / sent.sqrt() + error;
            z_test(above, error, expected / 2.0, 4).unwrap();
            z_test(expected, error, expected / 2.0, 4).expect_err("all of it on one side");
        }
    }
}

/// A point light in the middle of a room whose corners are out of its range: the flux is its windowed irradiance,
/// integrated over the walls.
#[kernel_test("PENUMBRA_DEVICE")]
fn ranges_take_their_part(gpu: &Gpu) {
    let range = 0.7;
    let light = LightKind::Point { position: Vec3::ZERO, intensity: Vec3::ONE, range: range as f32 };
    let traced = Traced::new(gpu, &stage(gpu, scene(&[room(0.5)], vec![light])), 1 << 15, 0);
    const N: usize = 200;
    let at = |k: usize| (k as f64 + 0.5) / N as f64 - 0.5;
    let irradiance = |k: usize| {
        let d = DVec3::new(at(k % N), at(k / N), 0.5).length();
        (1.0 - (d / range).powi(4)).max(0.0) * 0.5 / d.powi(3)
    };
    let expected = 6.0 * (0..N * N).map(irradiance).sum::<f64>() / (N * N) as f64;
    // Shares from 0 to 1 have a standard deviation of at most a half.
    let error = 4.0 * PI * 0.5 / f64::from(traced.emitted).sqrt() + traced.rounding();
    z_test(traced.power(|_| true).x, error, expected, 1).unwrap();
    z_test(4.0 * PI, error, expected, 1).expect_err("no window");
}

/// A slanted sun on a floor: irradiance times area times cosine.
#[kernel_test("PENUMBRA_DEVICE")]
fn suns_send_their_irradiance(gpu: &Gpu) {
    let direction = DVec3::new(0.3, -0.8, 0.1).normalize();
    let light = LightKind::Directional { direction: direction.as_vec3(), irradiance: Vec3::splat(3.0) };
    let floor = square(DVec3::ZERO, DVec3::Z * 0.4, DVec3::X * 0.3);
    let traced = Traced::new(gpu, &stage(gpu, scene(&[(floor, surface(0.5, 0.0))], vec![light])), 1 << 15, 4);
    let expected = 3.0 * 0.48 * -direction.y;
    let hits = traced.photons.len() as f64;
    let missed = 1.0 - hits / f64::from(traced.emitted);
    let error = expected * (missed / hits).sqrt() + traced.rounding();
    z_test(traced.power(|_| true).y, error, expected, 1).unwrap();
    z_test(traced.power(|_| true).y * 1.05, error, expected, 1).expect_err("five percent too much");
}

/// Photons of a square light are distributed over the floor as the irradiance by Lambert's formula. There are none on
/// the ceiling behind it.
#[kernel_test("PENUMBRA_DEVICE")]
fn photons_lie_as_light_does(gpu: &Gpu) {
    let panel = square(DVec3::new(0.1, 0.3, 0.0), DVec3::X * 0.15, DVec3::Z * 0.1);
    let stage = stage(gpu, scene(&[(panel.clone(), surface(0.0, 1.0)), room(0.5)], Vec::new()));
    let traced = Traced::new(gpu, &stage, 1 << 16, 0);
    assert_eq!(traced.photons.len() as u32, traced.emitted);
    assert!(traced.photons.iter().all(|p| p.position[1] < 0.3), "photons behind the light");
    const CELLS: usize = 10;
    let mut counts = vec![0u64; CELLS * CELLS];
    for photon in traced.photons.iter().filter(|p| p.position[1] < -0.499) {
        let cell = |x: f32| ((x + 0.5) * CELLS as f32).clamp(0.0, CELLS as f32 - 1.0) as usize;
        counts[cell(photon.position[2]) * CELLS + cell(photon.position[0])] += 1;
    }
    let expected = |moved: f64| -> Vec<f64> {
        let light = panel.iter().map(|t| t.map(|corner| corner + DVec3::X * moved)).collect::<Vec<_>>();
        // Means over a cell by midpoints; flux of all is pi times the area 0.06.
        let at = |k: usize, n: usize| (k as f64 + 0.5) / n as f64 - 0.5;
        let mean = |cell: usize| {
            let position = |k: usize| {
                let x = at(cell % CELLS * 4 + k % 4, 4 * CELLS);
                DVec3::new(x, -0.5, at(cell / CELLS * 4 + k / 4, 4 * CELLS))
            };
            (0..16).map(|k| form_factor(&light, false, position(k), DVec3::Y, true)).sum::<f64>() / 16.0
        };
        let all = f64::from(traced.emitted) / (PI * 0.06 * (CELLS * CELLS) as f64);
        (0..CELLS * CELLS).map(|cell| mean(cell) * all).collect()
    };
    chi_square(&counts, &expected(0.0), 1).unwrap();
    chi_square(&counts, &expected(0.1), 1).expect_err("a light that is moved");
}

/// A panel with bent shading normals receives and reflects light as paths see it: a spot light shines on it, and it
/// shines on a board above. With the cosines to its triangles in place of those to its shading normals, the light would
/// be another (Veach 1997, section 5.3). A path sees a normal that faces away from it bent towards it, just to the
/// horizon: a board behind the shading normal is lit too.
#[kernel_test("PENUMBRA_DEVICE")]
fn shading_normals_reflect_as_in_paths(gpu: &Gpu) {
    const ALBEDO: f64 = 0.9;
    const HALF: f64 = 0.1;
    const BOARD_HALF: f64 = 0.15;
    let (lamp, intensity) = (DVec3::new(-0.3, 0.3, 0.0), 5.0);
    let (floor, board) = (DVec3::new(0.0, -0.3, 0.0), DVec3::new(0.15, 0.3, 0.1));
    let towards = (floor - lamp).normalize();
    let light = LightKind::Spot {
        position: lamp.as_vec3(),
        direction: towards.as_vec3(),
        intensity: Vec3::splat(intensity as f32),
        // All of the panel is within the inner cone: its corners are 0.14 from its middle, which is 0.67 away.
        cos_inner: 0.96,
        cos_outer: 0.955,
        range: f32::INFINITY,
    };
    // Bent by 53, 69 and 79 degrees, so that rays leave the triangle itself and not a smooth surface above it. The
    // first turns away from the lamp, the second from the board, and the board is behind the third.
    let normals = [DVec3::new(0.7, 0.6, -0.39), DVec3::new(-0.7, 0.3, 0.39), DVec3::new(-1.0, 0.2, 0.0)];
    for bent in normals.map(DVec3::normalize) {
        let panel = (square(floor, DVec3::Z * HALF, DVec3::X * HALF), surface(ALBEDO as f32, 0.0));
        let above = (square(board, DVec3::X * BOARD_HALF, DVec3::Z * BOARD_HALF), surface(0.5, 0.0));
        let mut scene = scene(&[panel, above, room(0.0)], vec![light.clone()]);
        for triangle in scene.triangles.iter().filter(|triangle| triangle.material == 0) {
            for vertex in triangle.vertices {
                Arc::make_mut(&mut scene.vertices)[vertex as usize].normal = bent.as_vec3();
            }
        }
        let stage = stage(gpu, scene);
        let arrived = Traced::new(gpu, &stage, 1 << 18, 0);
        let reflected = Traced::new(gpu, &stage, 1 << 18, 1);
        // Midpoints of a grid, in each of which light changes by a few percent.
        const N: usize = 12;
        let at = |k: usize| 2.0 * (k as f64 + 0.5) / N as f64 - 1.0;
        let grid = |half: f64| (0..N * N).map(move |k| DVec3::new(at(k % N), 0.0, at(k / N)) * half);
        let area = |half: f64| (2.0 * half / N as f64).powi(2);
        // Irradiance of the panel by a normal, times the area of a piece.
        let irradiance = |x: DVec3, normal: DVec3| {
            let to = lamp - x;
            intensity * to.normalize().dot(normal).max(0.0) / to.length_squared() * area(HALF)
        };
        // The normal as a viewer sees it: at the horizon if it faces away.
        let seen_from = |view: DVec3| (bent - bent.dot(view).min(0.0) * view).normalize();
        // Power that reaches the panel; and by way of it the board, if viewers see the normal that `seen` has.
        let on_panel = |normal| grid(HALF).map(|x| irradiance(floor + x, normal)).sum::<f64>();
        let on_board = |seen: &dyn Fn(DVec3) -> DVec3| {
            let pieces = grid(HALF).flat_map(|x| grid(BOARD_HALF).map(move |y| (floor + x, board + y)));
            let carried = pieces.map(|(x, y)| {
                let d = (y - x).normalize();
                let form = d.y * d.y / (y - x).length_squared() * area(BOARD_HALF);
                irradiance(x, seen(d)) * ALBEDO / PI * form
            });
            carried.sum::<f64>()
        };
        // Photons are stored for viewers in all directions: a spiral with equal areas of the projected hemisphere.
        const VIEWS: usize = 400;
        let views = (0..VIEWS).map(|k| {
            let (r, angle) = (((k as f64 + 0.5) / VIEWS as f64).sqrt(), 2.39996 * k as f64);
            DVec3::new(r * angle.cos(), (1.0 - r * r).sqrt(), r * angle.sin())
        });
        let stored = views.map(|view| on_panel(seen_from(view))).sum::<f64>() / VIEWS as f64;
        let check = |power: f64, photons: usize, error: f64, expected: f64, planted: f64| {
            assert!(photons > 500, "{photons} photons are no test");
            z_test(power, error, expected, 4).unwrap_or_else(|e| panic!("{bent}: {e}"));
            z_test(power, error, planted, 4).expect_err("the cosine to the triangle");
        };
        let is_low = |p: &Photon| p.position[1] < 0.0;
        let squares = |photons: &[Photon], low: bool| {
            let fluxes = photons.iter().filter(|p| is_low(p) == low).map(|p| steps(p.word).x);
            (fluxes.clone().count(), fluxes.map(|f| f * f).sum::<f64>().sqrt())
        };
        // The variance of a sum of independent photons is at most the sum of their squares.
        let (count, spread) = squares(&arrived.photons, true);
        let power = arrived.power(|p| p.y < 0.0).x;
        check(power, count, spread * arrived.step, stored, on_panel(DVec3::Y));
        // The lamp does not shine on the board, so all of its photons come from the panel.
        let (count, spread) = squares(&reflected.photons, false);
        let power = reflected.power(|p| p.y > 0.0).x;
        check(power, count, spread * reflected.step, on_board(&seen_from), on_board(&|_| DVec3::Y));
    }
}

/// A mirror above a point light marks what it reflects: photons of the light's image behind it, with the power that the
/// light sends to the mirror. Photons that walls have scattered have no mark, though the mirror reflects them too. The
/// caustic map has those with a mark, and no others.
#[kernel_test("PENUMBRA_DEVICE")]
fn only_focused_photons_are_marked(gpu: &Gpu) {
    let (half, height, lamp) = (0.2, 0.3, DVec3::new(0.05, 0.1, -0.02));
    let mirror = Material { metallic: 1.0, roughness: 0.0, base_colour: Vec4::ONE, ..surface(0.0, 0.0) };
    let centre = DVec3::new(lamp.x, height, lamp.z);
    let panel = square(centre, DVec3::X * half, DVec3::Z * half);
    let light = point_light(lamp.as_vec3(), Vec3::ONE);
    let stage = stage(gpu, scene(&[room(0.5), (panel, mirror)], vec![light]));
    let traced = Traced::new(gpu, &stage, 1 << 17, 16);
    let (marked, others): (Vec<&Photon>, Vec<&Photon>) = traced.photons.iter().partition(|p| p.word >> 31 == 1);
    let image = DVec3::new(lamp.x, 2.0 * height - lamp.y, lamp.z);
    let behind = |p: &&&Photon| {
        let from_image = Vec3::from(p.position).as_dvec3() - image;
        let at = image + from_image * ((height - image.y) / from_image.y);
        // Even the smoothest surfaces have a roughness, which moves a few reflections by a fiftieth.
        from_image.y < 0.0 && (at - centre).abs().max_element() < half + 0.02
    };
    let through = marked.iter().filter(behind).count();
    assert_eq!((through, marked.len() > 5000, others.len() > 100_000), (marked.len(), true, true));
    // A square seen from above its middle, as a part of all directions.
    let (a, d) = (half * half, (height - lamp.y).powi(2));
    let share = (a / (a + d)).asin() / PI;
    let power = marked.iter().map(|p| steps(p.word).x).sum::<f64>() * traced.step;
    // Rays are stratified, which only makes the error smaller.
    let error = 4.0 * PI * (share * (1.0 - share) / f64::from(1 << 17)).sqrt() + traced.rounding();
    z_test(power, error, 4.0 * PI * share, 1).unwrap();
    z_test(1.05 * power, error, 4.0 * PI * share, 1).expect_err("a twentieth too much");
    let settings = FluxSettings { rays: 1 << 17, max_bounces: 16, seed: SEED, caustics_only: true };
    let mut caustics: Vec<[u32; 4]> = bytemuck::cast_slice(&Traced::with(gpu, &stage, settings).photons).to_vec();
    let mut marked: Vec<[u32; 4]> = marked.into_iter().map(|photon| bytemuck::cast(*photon)).collect();
    caustics.sort_unstable();
    marked.sort_unstable();
    assert!(caustics == marked, "{} photons of the caustic map, {} with a mark", caustics.len(), marked.len());
    marked[0][3] ^= 1;
    assert!(caustics != marked, "a photon of another flux");
}

/// Rays of the kernel alone.
struct Request {
    first: u32,
    count: u32,
    max_bounces: u32,
    inverse_unit: f32,
    stored: u32,
    room: usize,
}

/// Runs the kernel with `rays` rays on a scene of one light: photons, appended to earlier ones in a poisoned buffer,
/// and counts.
fn run(gpu: &Gpu, stage: &Stage, rays: u32, request: &Request) -> (Vec<[u32; 4]>, [u32; 5]) {
    let composed = compose("flux", &stage.features).unwrap();
    let constants = composed.overrides(&stage.gpu_scene.constants());
    let kernel = new_kernel(gpu, &composed, &constants, &[]).unwrap();
    let photons = gpu.poisoned::<[u32; 4]>("test/photons", request.room).unwrap();
    let counts = gpu.buffer::<[u32; 5]>("test/counts", 1).unwrap();
    let ray_table = gpu.upload("test/rays", &[0, rays]).unwrap();
    let own =
        Resources::new().with("flux_photons", &photons).with("flux_counts", &counts).with("flux_rays", &ray_table);
    let bound = kernel.bind(gpu, "flux", &[&own, &stage.gpu_scene]).unwrap();
    let Request { first, count, max_bounces, inverse_unit, stored, .. } = *request;
    let mut frame = gpu.frame("test");
    frame.run(&bound, count, &[first, count, 1, SEED, max_bounces, stored, inverse_unit.to_bits(), 0]);
    frame.submit().unwrap();
    let counts = gpu.read::<[u32; 5]>(&counts, 1).unwrap()[0];
    assert_eq!(counts[1], 0, "traversals that gave up");
    (gpu.read(&photons, request.room).unwrap(), counts)
}

/// Photons depend only on their rays. Batches of no rays, one ray and about a workgroup of rays, each appended to
/// earlier photons, give the same photons as the pass's own batches, for which it must grow its buffer. Nothing else is
/// written.
#[kernel_test("PENUMBRA_DEVICE")]
fn batches_do_not_show(gpu: &Gpu) {
    let stage = stage(gpu, scene(&[room(0.9)], vec![point_light(Vec3::new(0.2, 0.1, 0.3), Vec3::ONE)]));
    // Two batches of the pass. The first buffer has room for four photons per ray, but there are ten.
    let rays = (1 << 15) + 77;
    let traced = Traced::new(gpu, &stage, rays, 64);
    assert!(traced.photons.len() > 8 * rays as usize);
    let unit = stage.gpu_scene.lights.lights[0].power / f64::from(rays);
    let room = 14 * rays as usize;
    let mut request =
        Request { first: 0, count: 0, max_bounces: 64, inverse_unit: (1.0 / unit) as f32, stored: 0, room };
    let mut collected = Vec::new();
    for count in [0, 1, 63, 64, 65, 1000, 30_001, rays - 31_194] {
        request.count = count;
        let (photons, [stored, _, _, clipped, not_finite]) = run(gpu, &stage, rays, &request);
        assert_eq!((clipped, not_finite), (0, 0));
        let (first, end) = (request.stored as usize, (request.stored + stored) as usize);
        assert!(stored >= count && photons[first..end].iter().flatten().all(|word| *word != POISON));
        let others = photons[..first].iter().chain(&photons[end..]);
        assert!(others.flatten().all(|word| *word == POISON), "{count} rays wrote elsewhere");
        collected.extend_from_slice(&photons[first..end]);
        request.first += count;
        request.stored += stored;
    }
    assert_eq!(request.first, rays);
    let mut by_pass: Vec<[u32; 4]> = bytemuck::cast_slice(&traced.photons).to_vec();
    by_pass.sort_unstable();
    collected.sort_unstable();
    assert!(by_pass == collected, "{} photons of the pass, {} of the batches", by_pass.len(), collected.len());
    collected.pop();
    assert!(by_pass != collected, "a photon that is lost");
}

/// All rays are traced, also more than fit in 65,535 workgroups. The kernel counts photons that do not fit, photons
/// whose flux is clipped to the range of the word, and photons whose flux is not finite.
#[kernel_test("PENUMBRA_DEVICE")]
fn what_has_no_room_is_counted(gpu: &Gpu) {
    let stage = stage(gpu, scene(&[room(0.5)], vec![point_light(Vec3::ZERO, Vec3::ONE)]));
    let count = 65_535 * 64 + 65;
    let power = stage.gpu_scene.lights.lights[0].power;
    // A thousand units per photon.
    let inverse_unit = (1000.0 * f64::from(count) / power) as f32;
    let request = Request { first: 0, count, max_bounces: 0, inverse_unit, stored: 0, room: 1000 };
    let (photons, counts) = run(gpu, &stage, count, &request);
    assert_eq!(counts, [count, 0, count, count, 0]);
    assert!(photons.iter().all(|photon| steps(photon[3]) == DVec3::splat(31.0 * 512.0)));
    let request = Request { inverse_unit: inverse_unit / 4.0, count: 64, ..request };
    let (photons, counts) = run(gpu, &stage, count, &request);
    assert_eq!(counts, [64, 0, 64, 0, 0]);
    assert!(photons[..64].iter().all(|photon| steps(photon[3]).x < 31.0 * 512.0));
    // Photons whose flux is not finite are stored nowhere.
    let (photons, counts) = run(gpu, &stage, 64, &Request { inverse_unit: f32::INFINITY, ..request });
    assert_eq!(counts, [0, 0, 64, 0, 64]);
    assert!(photons.iter().flatten().all(|word| *word == POISON));
}

/// A word holds the flux in steps of 1/31 of the smallest power of 8 that is large enough, rounded at random so that
/// the mean over xi is the flux itself. Normal and sign are unchanged.
#[kernel_test("PENUMBRA_DEVICE")]
fn words_keep_the_mean_of_flux(gpu: &Gpu) {
    const RANDOM_NUMBERS: usize = 64;
    let mut random = Random(3);
    // The ends of the exponents, and fluxes of all sizes; the other channels are weaker.
    let largest = [0.0, 1e-9, 0.03, 1.0, 1.0001, 8.0, 8.001, 64.0, 64.01, 511.0, 512.0];
    let mut fluxes: Vec<DVec3> = largest.map(|f| DVec3::new(f, f, f * 0.5)).to_vec();
    fluxes.extend((0..1000).map(|_| {
        let size = 512.0 * (-9.0 * random.uniform()).exp();
        DVec3::new(size * random.uniform(), size, size * random.uniform().powi(4))
    }));
    let items = fluxes.len() * RANDOM_NUMBERS;
    let xi = |i: usize| ((i % RANDOM_NUMBERS) as f32 + 0.5) / RANDOM_NUMBERS as f32;
    let inputs: Vec<Vec4> = (0..items).map(|i| fluxes[i / RANDOM_NUMBERS].as_vec3().extend(xi(i))).collect();
    // The code of a normal, and whether it is a shadow photon.
    let marks: Vec<[u32; 2]> =
        (0..items).map(|i| [(random.uniform() * 16384.0) as u32, (i / RANDOM_NUMBERS % 2) as u32]).collect();
    let source = include_str!("shaders/flux_word.wgsl");
    let composed = compose_source("flux_word", source, &device_features(gpu)).unwrap();
    let kernel = new_kernel(gpu, &composed, &[("count", items as f64)], &[]).unwrap();
    let inputs = gpu.upload("test/fluxes", &inputs).unwrap();
    let marked = gpu.upload("test/marks", &marks).unwrap();
    let words = gpu.poisoned::<[u32; 4]>("test/words", items).unwrap();
    let own = Resources::new().with("fluxes", &inputs).with("marks", &marked).with("words", &words);
    let bound = kernel.bind(gpu, "encode", &[&own]).unwrap();
    let mut frame = gpu.frame("test");
    frame.run(&bound, items as u32, &[0u32; 0]);
    frame.submit().unwrap();
    let words: Vec<[u32; 4]> = gpu.read(&words, items).unwrap();
    // Half of the step between values of xi, and a quotient, a product and a sum of up to 32 in f32: each is off by
    // 1e-6 at most.
    const MAX_ERROR: f64 = 0.5 / RANDOM_NUMBERS as f64 + 3e-6;
    let mut blind = 0;
    for (flux, (words, marks)) in fluxes.iter().zip(words.chunks(RANDOM_NUMBERS).zip(marks.chunks(RANDOM_NUMBERS))) {
        let flux = flux.as_vec3().as_dvec3();
        let scale = [1.0, 8.0, 64.0, 512.0].into_iter().find(|scale| flux.max_element() <= *scale).unwrap();
        let exact = flux * 31.0 / scale;
        for (word, mark) in words.iter().zip(marks) {
            assert_eq!((word[0] & 0x3fff, word[0] >> 31), (mark[0], mark[1]));
            let decoded = steps(word[0]);
            let sign = if mark[1] == 1 { -1.0 } else { 1.0 };
            assert_eq!(DVec3::from([1, 2, 3].map(|c| f64::from(word[c] as i32))), decoded * sign);
            let off = (decoded / scale - exact).abs();
            assert!(off.max_element() < 1.0 + 4e-6, "{flux}: {decoded}");
        }
        let off = |words: &[[u32; 4]]| {
            let mean = words.iter().map(|word| steps(word[0]) / scale).sum::<DVec3>() / words.len() as f64;
            (mean - exact).abs().max_element()
        };
        assert!(off(words) <= MAX_ERROR, "{flux}: the mean is off by {} steps", off(words));
        blind += usize::from(off(&words[RANDOM_NUMBERS / 2..=RANDOM_NUMBERS / 2]) <= MAX_ERROR);
    }
    assert!(blind < fluxes.len() / 5, "{blind} words to the nearest step pass for a mean");
}
