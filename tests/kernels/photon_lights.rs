//! Pass `photons` for every kind of light, with numbers of rays around the size of a workgroup, against f64 lines
//! through all triangles along the same rays; and the probability with which the limit per ray keeps a shadow photon.

use std::f32::consts::FRAC_1_SQRT_2;

use glam::{DVec3, Vec3, Vec4};
use kernel_kit::{Gpu, Resources, kernel_test};
use penumbra::internal::kernels::compose_source;
use penumbra::internal::passes::grid::Photon;
use penumbra::internal::passes::photons::{Photons, Traced};
use penumbra::internal::scene::{LightKind, Scene};
use penumbra::settings::Technique;

use crate::kit::new_kernel;
use crate::light::square;
use crate::octahedral::oct_decode;
use crate::path::{camera, scene, surface};
use crate::stage::{Crossing, Stage, crossings};
use crate::statistics::chi_square;

const SEED: u32 = 9;

/// A photon that must be stored.
#[derive(Clone, Copy, Debug)]
struct Expected {
    position: DVec3,
    normal: DVec3,
    light: u32,
    shadow: bool,
    /// Rounding error of the position, which is larger if the ray grazes the surface.
    tolerance: f64,
    /// Whether rounding decides if it is stored, or its kind.
    doubtful: bool,
}

/// Planted faults that the comparison must detect.
#[derive(Clone, Copy, PartialEq)]
enum Fault {
    None,
    /// The backs of single-sided surfaces store photons.
    Backs,
    /// A coplanar twin of a hit also stores a photon.
    Twins,
    /// All photons are illumination photons.
    Kinds,
    /// Normals are those of the front, even where the ray hits the back.
    Normals,
}

fn stage(gpu: &Gpu, scene: Scene) -> Stage {
    let view = camera(DVec3::new(0.0, 0.0, 2.0), DVec3::NEG_Z, 1.0);
    Stage::new(gpu, scene, &view, [8, 8], Technique::SHADOW_PHOTONS, |features| features)
}

/// A floor, panels that face up, down and both ways, two panels in one plane, and a light of each kind above.
fn panels() -> Scene {
    let level = |x: f64, y: f64, z: f64, half: f64| square(DVec3::new(x, y, z), DVec3::Z * half, DVec3::X * half);
    let down = |x: f64, y: f64, z: f64, half: f64| square(DVec3::new(x, y, z), DVec3::X * half, DVec3::Z * half);
    // Its front faces down, so that most rays hit its back.
    let tilted = square(DVec3::new(-0.1, -0.2, 0.35), DVec3::new(0.2, -0.02, 0.0), DVec3::new(0.05, 0.1, 0.1));
    let double_sided = |material: penumbra::internal::scene::Material| penumbra::internal::scene::Material {
        double_sided: true,
        ..material
    };
    let meshes = [
        (level(0.0, -0.5, 0.0, 0.6), surface(0.5, 0.0)),
        ([level(-0.3, 0.0, -0.2, 0.2), level(-0.3, -0.3, -0.1, 0.15)].concat(), surface(0.5, 0.0)),
        (down(0.2, 0.1, 0.0, 0.2), surface(0.5, 0.0)),
        (tilted, double_sided(surface(0.5, 0.0))),
        // Coplanar, one of them larger.
        (level(0.25, -0.1, 0.3, 0.2), surface(0.5, 0.0)),
        (level(0.25, -0.1, 0.3, 0.15), surface(0.4, 0.0)),
        (down(0.0, 0.5, 0.0, 0.15), surface(0.0, 4.0)),
        (
            vec![[DVec3::new(0.4, 0.3, 0.1), DVec3::new(0.5, 0.45, 0.1), DVec3::new(0.45, 0.3, -0.2)]],
            double_sided(surface(0.0, 3.0)),
        ),
    ];
    let intensity = Vec3::ONE;
    let position = Vec3::new(-0.2, 0.4, 0.1);
    let punctual = vec![
        LightKind::Point { position, intensity, range: f32::INFINITY },
        LightKind::Spot {
            position: Vec3::new(0.2, 0.45, 0.25),
            direction: Vec3::new(0.1, -1.0, 0.05).normalize(),
            intensity,
            cos_inner: 0.95,
            cos_outer: FRAC_1_SQRT_2,
            range: 3.0,
        },
        LightKind::Directional { direction: Vec3::new(0.2, -1.0, 0.3).normalize(), irradiance: Vec3::ONE },
    ];
    scene(&meshes, punctual)
}

fn trace(gpu: &Gpu, stage: &Stage, lights: u32, rays: u32, cap: u32, seed: u32) -> (Traced, Vec<Photon>) {
    let pass = Photons::new(gpu, &stage.features, &stage.gpu_scene.constants(), cap).unwrap();
    let traced = pass.trace(gpu, &stage.gpu_scene, lights, rays, seed, 5).unwrap();
    let photons = gpu.read(&traced.photons, traced.count as usize).unwrap();
    (traced, photons)
}

/// The rays of a light: origin and direction.
fn emitted(gpu: &Gpu, stage: &Stage, light: u32, rays: u32) -> Vec<[DVec3; 2]> {
    let source = include_str!("shaders/emitted.wgsl");
    let composed = compose_source("emitted", source, &stage.features).unwrap();
    let constants = [("light", f64::from(light)), ("seed", f64::from(SEED)), ("count", f64::from(rays))];
    let kernel = new_kernel(gpu, &composed, &composed.overrides(&constants), &["rays"]).unwrap();
    let buffer = gpu.poisoned::<[Vec4; 2]>("test/rays", rays as usize).unwrap();
    let bound = kernel.bind(gpu, "emit", &[&Resources::new().with("rays", &buffer), &stage.gpu_scene]).unwrap();
    let mut frame = gpu.frame("test");
    frame.run(&bound, rays, &[0u32; 0]);
    frame.submit().unwrap();
    let rays: Vec<[Vec4; 2]> = gpu.read(&buffer, rays as usize).unwrap();
    rays.into_iter().map(|ray| ray.map(|v| v.truncate().as_dvec3())).collect()
}

/// The photons of a ray.
fn follow(scene: &Scene, light: u32, [origin, direction]: [DVec3; 2], fault: Fault) -> Vec<Expected> {
    let all = crossings(scene, origin, direction);
    let ahead: Vec<Crossing> = all.into_iter().filter(|c| c.t > 0.0 && (c.inside > 0.0 || c.doubtful())).collect();
    let doubtful = ahead.iter().any(Crossing::doubtful);
    let mut photons = Vec::new();
    for (rank, crossing) in ahead.iter().enumerate() {
        let front = crossing.normal.dot(direction) < 0.0;
        let material = scene.triangles[crossing.triangle].material as usize;
        let twin = ahead[..rank].iter().any(|c| crossing.t - c.t < 1e-6 * c.t);
        let stores = front || scene.materials[material].double_sided || fault == Fault::Backs;
        if !stores || (twin && fault != Fault::Twins) {
            continue;
        }
        photons.push(Expected {
            position: origin + direction * crossing.t,
            normal: if front || fault == Fault::Normals { crossing.normal } else { -crossing.normal },
            light,
            shadow: rank > 0 && fault != Fault::Kinds,
            // A few roundings of coordinates of unit size across the ray; more along a surface that the ray grazes.
            tolerance: 2e-6 / crossing.normal.dot(direction).abs().max(1e-3),
            doubtful,
        });
    }
    photons
}

/// The number of photons that are stored but not expected, or expected but not stored.
fn differences(got: &[Photon], expected: &[Expected]) -> usize {
    // Sorted along a direction that no surface is perpendicular to.
    let along = |p: DVec3| p.dot(DVec3::new(0.531, 0.713, 0.458));
    let mut sorted: Vec<(f64, DVec3, u32)> = got
        .iter()
        .map(|photon| (Vec3::from(photon.position).as_dvec3(), photon.word))
        .map(|(p, word)| (along(p), p, word))
        .collect();
    sorted.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut taken = vec![false; sorted.len()];
    let mut missing = 0;
    let mut sure_first: Vec<&Expected> = expected.iter().collect();
    sure_first.sort_by_key(|e| e.doubtful);
    for e in sure_first {
        let key = along(e.position);
        let from = sorted.partition_point(|p| p.0 < key - e.tolerance);
        let same = |p: &(f64, DVec3, u32)| {
            let word = p.2;
            p.1.distance(e.position) <= e.tolerance
                && (word >> 14 & 0x7ff) == e.light
                && (word >> 25 & 0x3f) == 0
                && (e.doubtful || (word >> 31 == 1) == e.shadow)
                // Half a step of 1/63 a coordinate, stretched threefold.
                && oct_decode(word, 7).dot(e.normal) > 0.036f64.cos()
        };
        let found = (from..sorted.len())
            .take_while(|i| sorted[*i].0 <= key + e.tolerance)
            .find(|i| !taken[*i] && same(&sorted[*i]));
        match found {
            Some(i) => taken[i] = true,
            None => missing += usize::from(!e.doubtful),
        }
    }
    missing + taken.iter().filter(|taken| !**taken).count()
}

/// Compares all photons of all lights, and their counts by kind. Returns the photons, and the rays of each light.
fn compare(gpu: &Gpu, stage: &Stage, rays: u32) -> (Vec<Photon>, Vec<Vec<[DVec3; 2]>>) {
    let lights = stage.scene.lights.len() as u32;
    // No ray of these scenes reaches this limit.
    let (traced, photons) = trace(gpu, stage, lights, rays, 32, SEED);
    let by_light: Vec<_> = (0..lights).map(|light| emitted(gpu, stage, light, rays)).collect();
    let expected = expected(stage, &by_light, Fault::None);
    assert_eq!(differences(&photons, &expected), 0, "{rays} rays");
    let doubtful = expected.iter().filter(|e| e.doubtful).count();
    assert!(doubtful * 200 <= expected.len() + 200, "rounding decides {doubtful} of {}", expected.len());
    for light in 0..lights {
        let own = photons.iter().filter(|p| p.light() == light);
        let [lit, shadowed] = own.fold([0, 0], |[i, s], p| if p.word >> 31 == 0 { [i + 1, s] } else { [i, s + 1] });
        assert_eq!(traced.stored[light as usize], [lit, shadowed], "{rays} rays of light {light}");
    }
    (photons, by_light)
}

fn expected(stage: &Stage, by_light: &[Vec<[DVec3; 2]>], fault: Fault) -> Vec<Expected> {
    let follow_all = |(light, rays): (usize, &Vec<[DVec3; 2]>)| -> Vec<Expected> {
        rays.iter().flat_map(|ray| follow(&stage.scene, light as u32, *ray, fault)).collect()
    };
    by_light.iter().enumerate().flat_map(follow_all).collect()
}

/// Photons of every kind of light lie where its rays cross surfaces: illumination photons at first hits, shadow photons
/// at later ones, none on the back of a single-sided surface (which still blocks light) and none on a coplanar twin.
#[kernel_test("PENUMBRA_DEVICE")]
fn photons_lie_where_the_rays_pass(gpu: &Gpu) {
    let stage = stage(gpu, panels());
    for rays in [1, 63, 64, 65] {
        compare(gpu, &stage, rays);
    }
    let (photons, by_light) = compare(gpu, &stage, 2000);
    for fault in [Fault::Backs, Fault::Twins, Fault::Kinds, Fault::Normals] {
        let found = differences(&photons, &expected(&stage, &by_light, fault));
        assert!(found > 50, "{found} differences for fault {}", fault as u32);
    }
    let (_, others) = trace(gpu, &stage, by_light.len() as u32, 2000, 32, SEED + 1);
    assert!(differences(&others, &expected(&stage, &by_light, Fault::None)) > 1000, "rays of another seed");
}

/// No photons and no error result from no rays, or from rays that hit nothing.
#[kernel_test("PENUMBRA_DEVICE")]
fn rays_that_hit_nothing_leave_no_photons(gpu: &Gpu) {
    let away = LightKind::Spot {
        position: Vec3::ZERO,
        direction: Vec3::Y,
        intensity: Vec3::ONE,
        cos_inner: 0.9,
        cos_outer: 0.5,
        range: f32::INFINITY,
    };
    let floor = square(DVec3::NEG_Y * 0.5, DVec3::Z * 0.5, DVec3::X * 0.5);
    let missed = scene(&[(floor, surface(0.5, 0.0))], vec![away]);
    for (scene, lights, rays) in [(panels(), 5, 0), (missed, 1, 65)] {
        let (traced, photons) = trace(gpu, &stage(gpu, scene), lights, rays, 10, SEED);
        assert_eq!((traced.count, photons.len()), (0, 0));
        assert_eq!(traced.stored, vec![[0, 0]; lights as usize]);
    }
}

/// A ray through 10,000 layers stores exactly the maximum number of shadow photons, from all depths with the same
/// probability. Their weights compensate for the others.
#[kernel_test("PENUMBRA_DEVICE")]
fn a_ray_through_ten_thousand_layers_keeps_its_cap(gpu: &Gpu) {
    const LAYERS: usize = 10_000;
    const RAYS: u32 = 321;
    let layer = |i: usize| square(DVec3::Z * (i as f64 / LAYERS as f64 - 0.5), DVec3::X * 0.5, DVec3::Y * 0.5);
    let sheets = (0..LAYERS).flat_map(layer).collect();
    let light = LightKind::Directional { direction: Vec3::NEG_Z, irradiance: Vec3::ONE };
    let stage = stage(gpu, scene(&[(sheets, surface(0.5, 0.0))], vec![light]));
    for cap in [1u32, 10] {
        let (traced, photons) = trace(gpu, &stage, 1, RAYS, cap, SEED);
        let [lit, shadowed] = traced.stored[0];
        assert!(lit > 80, "{lit} rays are no test");
        assert_eq!([shadowed, photons.len() as u32], [cap * lit, (cap + 1) * lit]);
        let mut rays = std::collections::BTreeMap::<[u32; 2], [u32; 2]>::new();
        let mut depths = [0u64; 10];
        // The number of hits that each photon represents, rounded to a power of 2^(1/4).
        let exponent = (4.0 * (f64::from(LAYERS as u32 - 1) / f64::from(cap)).log2()).round() as u32;
        for photon in &photons {
            let shadow = photon.word >> 31;
            // Rays go straight down: all photons of a ray have the same x and y, to a few roundings.
            let column = [0, 1].map(|c| (photon.position[c] * 1e4).round() as i32 as u32);
            rays.entry(column).or_default()[shadow as usize] += 1;
            assert_eq!(photon.word >> 25 & 0x3f, if shadow == 1 { exponent } else { 0 });
            let depth = (0.5 - f64::from(photon.position[2])).clamp(0.0, 0.999_999);
            if shadow == 1 {
                depths[(depth * 10.0) as usize] += 1;
            } else {
                // The first layer is 1 / LAYERS from the front.
                assert!(depth < 2.0 / LAYERS as f64, "an illumination photon at depth {depth}");
            }
        }
        let whole = rays.values().filter(|counts| **counts == [1, cap]).count();
        // Rounding divides the columns within 1e-7 of a border.
        assert!(whole * 100 >= lit as usize * 97, "{whole} of {lit} rays have one photon and {cap}");
        let even = [f64::from(shadowed) / 10.0; 10];
        chi_square(&depths, &even, 2).unwrap();
        depths[0] += u64::from(shadowed) / 5 + 60;
        depths[9] = 0;
        chi_square(&depths, &even, 2).expect_err("shadow photons that gather on the first layers");
    }
}
