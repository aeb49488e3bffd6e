//! Pass `light_buffer` against f64 lines: points classified lit see all of the light, points classified shadowed see
//! none of it.

use glam::{DVec3, Vec3};
use kernel_kit::{Gpu, POISON, kernel_test};
use penumbra::internal::gpu_scene::light_buffer::LightBuffers;
use penumbra::internal::gpu_scene::lights::LightInfo;
use penumbra::internal::kernels::{Class, Classified, INVALID_POINT, occluder};
use penumbra::internal::passes::classify::{AuditProbabilities, Chunk};
use penumbra::internal::passes::light_buffer::LightBufferPass;
use penumbra::internal::passes::{Point, TileBuffers};
use penumbra::internal::scene::{AlphaMode, LightKind, Material, Panorama, Scene};
use penumbra::settings::Technique;

use crate::kit::published;
use crate::light::{sphere, square};
use crate::octahedral::{oct_decode, oct_encode};
use crate::path::{camera, scene, surface};
use crate::random::Random;
use crate::stage::{EDGE, Stage, crossings, whole};

const POSITION: Vec3 = Vec3::new(0.15, 0.38, 0.1);
const SPOT: Vec3 = Vec3::new(-0.3, 0.3, 0.3);
const DIRECTION: Vec3 = Vec3::new(0.182_574_19, -0.912_870_9, -0.365_148_37);

/// Cells along a side, points, and lines from a point to a light that has a surface.
const CELLS: u32 = 20;
const POINTS: usize = 1500;
const LINES: usize = 24;

/// Alpha of a panel that lets all light through: below the cutoff of its mask.
const CLEAR: f32 = 0.2;

/// A floor, panels, a ball and a panel that lets light through, in a room; under a lamp at the ceiling, a ball lamp, a
/// lamp that shines from both sides, a point, a spot and a directional light, and an environment.
fn room() -> Scene {
    let level = |x: f64, y: f64, z: f64, half: f64| square(DVec3::new(x, y, z), DVec3::Z * half, DVec3::X * half);
    let panels = [level(0.0, -0.5, 0.0, 0.6), level(-0.2, -0.1, 0.1, 0.2), level(0.3, 0.0, -0.2, 0.15)].concat();
    let ceiling = square(DVec3::new(0.0, 0.45, 0.0), DVec3::X * 0.6, DVec3::Z * 0.6);
    let clear = Material { alpha: AlphaMode::Mask { cutoff: 0.5 }, ..surface(0.5, 0.0) };
    let clear = Material { base_colour: clear.base_colour.truncate().extend(CLEAR), ..clear };
    let lamp = square(DVec3::new(0.1, 0.45, 0.0), DVec3::X * 0.05, DVec3::Z * 0.05);
    let sign = square(DVec3::new(-0.4, 0.1, -0.2), DVec3::X * 0.05, DVec3::Y * 0.05);
    let both = Material { double_sided: true, ..surface(0.0, 3.0) };
    let (range, intensity) = (f32::INFINITY, Vec3::ONE);
    let (position, direction) = (SPOT, Vec3::NEG_Y);
    let punctual = vec![
        LightKind::Point { position: POSITION, intensity, range },
        LightKind::Spot { position, direction, intensity, cos_inner: 0.6, cos_outer: 0.4, range },
        LightKind::Directional { direction: DIRECTION, irradiance: Vec3::ONE },
    ];
    let meshes = [
        (panels, surface(0.5, 0.0)),
        (ceiling, surface(0.5, 0.0)),
        (sphere(DVec3::new(0.3, -0.3, 0.25), 0.15, 4), surface(0.5, 0.0)),
        (level(0.0, 0.2, 0.0, 0.06), clear),
        (lamp, surface(0.0, 3.0)),
        (sphere(DVec3::new(0.35, 0.25, 0.2), 0.04, 2), surface(0.0, 3.0)),
        (sign, both),
    ];
    let mut scene = scene(&meshes, punctual);
    let panorama = Panorama { width: 1, height: 1, texels: vec![[1.0; 3]] };
    scene.set_environment(std::sync::Arc::new(panorama), 0.0, 1.0).unwrap();
    scene
}

fn is_clear(scene: &Scene, triangle: usize) -> bool {
    scene.materials[scene.triangles[triangle].material as usize].alpha != AlphaMode::Opaque
}

/// A uniform point of a triangle.
fn point_of(scene: &Scene, triangle: usize, random: &mut Random) -> (DVec3, DVec3) {
    let [a, b, c] = scene.triangle_positions(triangle).map(|p| p.as_dvec3());
    let (root, v) = (random.uniform().sqrt(), random.uniform());
    (a + (b - a) * (root * (1.0 - v)) + (c - a) * (root * v), (b - a).cross(c - a).normalize())
}

/// Points on both sides of surfaces; the large ones have more, and every eleventh lies nowhere.
fn points(scene: &Scene) -> Vec<Point> {
    let mut random = Random(3);
    let large = |i: &usize| {
        let [a, b, c] = scene.triangle_positions(*i).map(|p| p.as_dvec3());
        (b - a).cross(c - a).length() > 0.01
    };
    let triangles: Vec<usize> = (0..scene.triangles.len()).collect();
    let large: Vec<usize> = triangles.iter().copied().filter(large).collect();
    (0..POINTS)
        .map(|i| {
            let from = if i % 2 == 0 { &triangles } else { &large };
            let triangle = from[(random.uniform() * from.len() as f64) as usize];
            let (position, normal) = point_of(scene, triangle, &mut random);
            let normal = if random.uniform() < 0.3 { -normal } else { normal };
            let normal = if i % 11 == 10 { INVALID_POINT } else { oct_encode(normal) };
            Point { position: position.as_vec3().to_array(), normal }
        })
        .collect()
}

/// Ends of lines to a light, on the parts that shine towards the position.
fn light_points(scene: &Scene, light: usize, position: DVec3, random: &mut Random) -> Vec<DVec3> {
    match &scene.lights[light].kind {
        LightKind::Mesh { material, emitters } => (0..LINES)
            .filter_map(|_| {
                let emitter = emitters[(random.uniform() * emitters.len() as f64) as usize];
                let (end, normal) = point_of(scene, emitter.triangle as usize, random);
                let faces = normal.dot(position - end) > 1e-4 || scene.materials[*material as usize].double_sided;
                faces.then_some(end)
            })
            .collect(),
        LightKind::Point { position, .. } | LightKind::Spot { position, .. } => vec![position.as_dvec3()],
        LightKind::Directional { direction, .. } => vec![position - 4.0 * direction.as_dvec3()],
        LightKind::Environment { .. } => Vec::new(),
    }
}

/// Counts of lines from a point to a light: how many reach it, how many do not, how many depend on rounding.
fn lines(scene: &Scene, light: usize, point: &Point, random: &mut Random) -> [u32; 3] {
    let (position, normal) = (Vec3::from(point.position).as_dvec3(), oct_decode(point.normal, 16));
    let mut counts = [0; 3];
    for end in light_points(scene, light, position, random) {
        if normal.dot(end - position) < 1e-4 {
            continue;
        }
        let all = crossings(scene, position, end - position);
        let near = all.iter().filter(|c| !is_clear(scene, c.triangle) && c.t > -1e-4 && c.t < 1.0001);
        let blocked = near.clone().any(|c| c.inside >= EDGE && c.t > 1e-4 && c.t < 0.9999);
        // Own surfaces, and that of the light, are crossed at the ends.
        let doubtful = near.filter(|c| c.t > 1e-4 && c.t < 0.9999).any(|c| c.doubtful());
        counts[if blocked {
            1
        } else if doubtful {
            2
        } else {
            0
        }] += 1;
    }
    counts
}

struct Setup {
    stage: Stage,
    points: Vec<Point>,
    /// By light and point.
    lines: Vec<[u32; 3]>,
}

impl Setup {
    fn new(gpu: &Gpu) -> Setup {
        let view = camera(DVec3::new(0.0, 0.0, 2.0), DVec3::NEG_Z, 1.0);
        let stage = Stage::new(gpu, room(), &view, [8, 8], Technique::LIGHT_BUFFER, |features| features);
        let points = points(&stage.scene);
        let mut random = Random(5);
        let of_light = |light: usize| {
            let of_point = |point: &Point| match point.normal {
                INVALID_POINT => [0; 3],
                _ => lines(&stage.scene, light, point, &mut random),
            };
            points.iter().map(of_point).collect::<Vec<_>>()
        };
        let lines = (0..stage.scene.lights.len()).flat_map(of_light).collect();
        Setup { stage, points, lines }
    }

    fn lights(&self) -> &[LightInfo] {
        &self.stage.gpu_scene.lights.lights
    }

    /// The classes of all candidates by these light buffers, light by light.
    fn classes(&self, gpu: &Gpu, buffers: &LightBuffers) -> Vec<Class> {
        let Setup { stage, points, .. } = self;
        let pass = LightBufferPass::new(gpu, &stage.features, &stage.gpu_scene.constants()).unwrap();
        let tile = whole([points.len() as u32, 1], 1);
        let mut tile_buffers = TileBuffers::new(gpu, &stage.features, tile.point_count, false).unwrap();
        tile_buffers.points = published(gpu, "test/points", points);
        let mut all = Vec::new();
        // In chunks of two lights.
        let all_lights = stage.scene.lights.len() as u32;
        for first_light in (0..all_lights).step_by(2) {
            let lights = (all_lights - first_light).min(2);
            let candidates = lights as usize * points.len();
            let classes = gpu.poisoned::<u32>("test/classes", candidates + 3).unwrap();
            let bound = pass.bind(gpu, &tile_buffers, buffers, &classes, &stage.gpu_scene).unwrap();
            let mut frame = gpu.frame("test");
            bound.record(
                &mut frame,
                &tile,
                &Chunk { first_light, lights, dilate: 0, audits: AuditProbabilities::default() },
            );
            frame.submit().unwrap();
            let words: Vec<u32> = gpu.read(&classes, candidates + 3).unwrap();
            assert!(words[candidates..].iter().all(|word| *word == POISON), "past the end");
            let words = words[..candidates].iter().map(|word| Classified::new(*word));
            all.extend(words.map(|word| {
                assert_eq!(word.visibility, if word.class == Class::Lit { 1.0 } else { 0.0 }, "{word:?}");
                word.class
            }));
        }
        all
    }

    /// Candidates whose class a line contradicts.
    fn wrong(&self, classes: &[Class]) -> usize {
        let contradicts = |(class, [seen, hidden, _]): &(&Class, &[u32; 3])| match class {
            Class::Lit => *hidden > 0,
            Class::Shadowed => *seen > 0,
            Class::Dark | Class::Boundary | Class::Unknown => false,
        };
        classes.iter().zip(&self.lines).filter(contradicts).count()
    }
}

/// No line contradicts a class, and few candidates are left open: of a light without a surface only those near the
/// edges of shadows, and those that several triangles hide.
#[kernel_test("PENUMBRA_DEVICE")]
fn classes_are_what_lines_find(gpu: &Gpu) {
    let setup = Setup::new(gpu);
    let scene = &setup.stage.scene;
    let buffers = LightBuffers::new(scene, setup.lights(), CELLS);
    let classes = setup.classes(gpu, &buffers);
    assert_eq!(setup.wrong(&classes), 0);
    for (light, (classes, lines)) in classes.chunks(POINTS).zip(setup.lines.chunks(POINTS)).enumerate() {
        let mut counts = [0; Class::COUNT];
        // Of these, candidates that all lines reach, and those that one triangle hides or none does.
        let (mut open_seen, mut seen) = (0, 0);
        for (class, [reach, hidden, doubtful]) in classes.iter().zip(lines) {
            counts[*class as usize] += 1;
            let all_seen = *reach > 0 && hidden + doubtful == 0;
            seen += u32::from(all_seen);
            open_seen += u32::from(all_seen && matches!(class, Class::Boundary | Class::Unknown));
        }
        let kind = &scene.lights[light].kind;
        println!("light {light}: {counts:?}, {open_seen} of {seen} open though all lines reach the light");
        assert!(counts[Class::Dark as usize] >= POINTS as u32 / 11 - 1);
        if matches!(kind, LightKind::Environment { .. }) {
            assert!(counts[1..4].iter().all(|count| *count == 0), "the environment has no cells: {counts:?}");
            continue;
        }
        // The sphere around a light is a loose bound: up to a third are left open. Of lights without a surface it is
        // some beside the panel that lets light through.
        let limit = if matches!(kind, LightKind::Mesh { .. }) { seen / 2 } else { seen / 20 };
        assert!(open_seen <= limit && counts[Class::Lit as usize] > 50, "light {light}: {open_seen} of {seen} open");
        assert!(counts[Class::Shadowed as usize] > 20, "light {light}: no triangle hides it: {counts:?}");
    }
}

/// Faults are found: bounds that leave out the size of lights, triangles with holes that count as whole, and lists
/// without their last surfaces.
#[kernel_test("PENUMBRA_DEVICE")]
fn planted_faults_are_found(gpu: &Gpu) {
    let setup = Setup::new(gpu);
    let scene = &setup.stage.scene;
    let buffers = || LightBuffers::new(scene, setup.lights(), CELLS);
    let wrong = |buffers: &LightBuffers| setup.wrong(&setup.classes(gpu, buffers));

    let mut small = buffers();
    small.lights.iter_mut().for_each(|light| light.radius = 0.0);
    let mut whole = buffers();
    whole.lists.iter_mut().for_each(|texel| {
        for word in [0, 2].into_iter().filter(|i| texel[*i] != occluder::ANYTHING).collect::<Vec<_>>() {
            texel[word] &= !occluder::POROUS;
        }
    });
    let mut short = buffers();
    short.cells.iter_mut().for_each(|cell| *cell -= u32::from(*cell & ((1 << occluder::COUNT_BITS) - 1) > 0));
    let mut far = buffers();
    far.lists.iter_mut().for_each(|texel| texel[1] = (f32::from_bits(texel[1]) + 0.3).to_bits());
    for (what, fault) in [("small", small), ("whole", whole), ("short", short), ("far", far)] {
        let wrong = wrong(&fault);
        println!("{what}: {wrong} contradicted");
        assert!(wrong > 5, "{what}: {wrong} contradicted");
    }
}

/// More surfaces than a list has room for leave points behind them unknown, and never lit; more lights than there is
/// room for have larger cells.
#[kernel_test("PENUMBRA_DEVICE")]
fn full_lists_decide_nothing(gpu: &Gpu) {
    let leaves = 50;
    let level = |y: f64, half: f64| square(DVec3::new(0.0, y, 0.0), DVec3::Z * half, DVec3::X * half);
    let stack: Vec<_> = (0..leaves).flat_map(|i| level(0.002 * f64::from(i), 0.02)).collect();
    let meshes = [(level(-0.5, 0.5), surface(0.5, 0.0)), (stack, surface(0.5, 0.0))];
    let light = LightKind::Point { position: Vec3::Y * 0.4, intensity: Vec3::ONE, range: f32::INFINITY };
    let view = camera(DVec3::new(0.0, 0.0, 2.0), DVec3::NEG_Z, 1.0);
    let lights = |count: usize| {
        let scene = scene(&meshes, vec![light.clone(); count]);
        Stage::new(gpu, scene, &view, [8, 8], Technique::LIGHT_BUFFER, |features| features)
    };
    let stage = lights(1);
    let point = |x: f32| Point { position: [x, -0.5, 0.0], normal: oct_encode(DVec3::Y) };
    // Under the middle, beside the edge of the shadow, and far from it.
    let setup = Setup { stage, points: vec![point(0.001), point(0.06), point(0.4)], lines: Vec::new() };
    // A single cell a face: all of the stack is in the one that has the floor.
    let buffers = LightBuffers::new(&setup.stage.scene, setup.lights(), 1);
    let classes = |buffers: &LightBuffers| setup.classes(gpu, buffers);
    assert_eq!(classes(&buffers)[1..], [Class::Unknown; 2], "of one cell");
    let fine = LightBuffers::new(&setup.stage.scene, setup.lights(), 64);
    assert_eq!(classes(&fine)[2], Class::Lit, "of 64 cells");

    let many = lights(900);
    let buffers = LightBuffers::new(&many.scene, &many.gpu_scene.lights.lights, 64);
    let (side, cells) = (buffers.lights[0].side, buffers.cells.len());
    println!("{side} cells a side, {cells} cells");
    assert!(side > 4 && side < 64 && cells <= 1 << 19, "{side} cells a side, {cells} cells");
}
