//! Pass `cells` against f64 lines from the same points, and the two methods' classes against the visibility of these
//! lines.

use std::collections::BTreeMap;

use glam::{DVec3, UVec3, Vec3};
use kernel_kit::{Gpu, kernel_test};
use penumbra::internal::kernels::{Class, Classified, GridShape, INVALID_POINT};
use penumbra::internal::passes::cells::{CellGrid, CellPoint, Cells};
use penumbra::internal::passes::classify::{AuditProbabilities, Chunk};
use penumbra::internal::passes::{Point, TileBuffers};
use penumbra::internal::scene::{LightKind, Scene};
use penumbra::settings::Technique;

use crate::kit::published;
use crate::light::square;
use crate::octahedral::oct_encode;
use crate::path::{camera, scene, surface};
use crate::random::{Random, RandomInput as _};
use crate::stage::{LightPoint, Stage, crossings, whole};

/// Cells along the longest side, and rays per cell.
const CELLS: u32 = 9;
const RAYS: u32 = 24;

const POSITION: Vec3 = Vec3::new(0.15, 0.4, 0.1);
const DIRECTION: Vec3 = Vec3::new(0.182_574_19, -0.912_870_9, -0.365_148_37);

/// A floor and two panels over it, under a point light, a directional one and a small square one.
fn room() -> Scene {
    let level = |x: f64, y: f64, z: f64, half: f64| square(DVec3::new(x, y, z), DVec3::Z * half, DVec3::X * half);
    let panels = [level(0.0, -0.5, 0.0, 0.6), level(-0.2, -0.1, 0.1, 0.2), level(0.3, 0.0, -0.2, 0.15)].concat();
    let lamp = square(DVec3::new(0.0, 0.45, 0.0), DVec3::X * 0.15, DVec3::Z * 0.15);
    let punctual = vec![
        LightKind::Point { position: POSITION, intensity: Vec3::ONE, range: f32::INFINITY },
        LightKind::Directional { direction: DIRECTION, irradiance: Vec3::ONE },
    ];
    scene(&[(panels, surface(0.5, 0.0)), (lamp, surface(0.0, 3.0))], punctual)
}

/// The lights of the room in order.
const SQUARE: usize = 0;
const LIGHTS: usize = 3;

fn stage(gpu: &Gpu, technique: Technique) -> Stage {
    let view = camera(DVec3::new(0.0, 0.0, 2.0), DVec3::NEG_Z, 1.0);
    Stage::new(gpu, room(), &view, [8, 8], technique, |features| features)
}

fn cell_of(shape: &GridShape, position: [f32; 3]) -> usize {
    let at = (Vec3::from(position) - Vec3::from(shape.origin)) * shape.inverse_cell;
    let cell = at.floor().as_ivec3().max(glam::IVec3::ZERO).as_uvec3().min(UVec3::from(shape.size) - 1);
    ((cell.z * shape.size[1] + cell.y) * shape.size[0] + cell.x) as usize
}

/// Points on the three panels, `RAYS` in each cell that received at least as many random points.
fn points(scene: &Scene, shape: &GridShape) -> Vec<CellPoint> {
    let mut random = Random(3);
    let mut cells: BTreeMap<usize, Vec<CellPoint>> = BTreeMap::new();
    for _ in 0..20_000 {
        let from = random.point() * DVec3::new(0.6, 0.0, 0.6) + DVec3::Y * 0.3;
        // Lines downwards; those that pass between two triangles are left out.
        for crossing in crossings(scene, from, DVec3::NEG_Y).iter().filter(|c| c.t > 0.0 && !c.doubtful()) {
            let position = (from + DVec3::NEG_Y * crossing.t).as_vec3().to_array();
            let point = CellPoint { position, triangle: crossing.triangle as u32 };
            cells.entry(cell_of(shape, position)).or_default().push(point);
        }
    }
    cells.into_values().filter(|all| all.len() >= RAYS as usize).flat_map(|all| all[..RAYS as usize].to_vec()).collect()
}

/// Whether a punctual light is visible from the point; `None` if that depends on rounding.
fn is_visible(scene: &Scene, light: usize, point: &CellPoint) -> Option<bool> {
    let position = Vec3::from(point.position).as_dvec3();
    let (direction, distance) = match light {
        1 => ((POSITION.as_dvec3() - position).normalize(), (POSITION.as_dvec3() - position).length()),
        _ => (-DIRECTION.as_dvec3().normalize(), 4.0),
    };
    let origin = position + DVec3::Y * 2e-5;
    LightPoint { origin, pdf: 1.0, direction, distance, radiance: DVec3::ONE }.visible(scene)
}

/// For each light and cell: rays that are certainly visible, certainly blocked, and undecided.
fn expected(scene: &Scene, shape: &GridShape, points: &[CellPoint]) -> Vec<[u32; 3]> {
    let cells = shape.cells() as usize;
    let mut counts = vec![[0; 3]; cells * LIGHTS];
    for light in 1..LIGHTS {
        for point in points {
            let kind = match is_visible(scene, light, point) {
                Some(true) => 0,
                Some(false) => 1,
                None => 2,
            };
            counts[light * cells + cell_of(shape, point.position)][kind] += 1;
        }
    }
    counts
}

/// The words of all cells.
fn classified(gpu: &Gpu, stage: &Stage, shape: GridShape, points: &[CellPoint], rays: u32) -> (Vec<Classified>, u64) {
    let pass = Cells::new(gpu, &stage.features, &stage.gpu_scene.constants()).unwrap();
    let grid = CellGrid { shape, lights: LIGHTS as u32, rays, seed: 5 };
    // Two batches.
    let (first, rest) = points.split_at((points.len() / rays as usize / 2) * rays as usize);
    let batches = [first.to_vec(), rest.to_vec()].into_iter().filter(|batch| !batch.is_empty());
    let table = pass.trace(gpu, &stage.gpu_scene, &grid, batches).unwrap();
    (table.words(gpu, LIGHTS as u32).unwrap().into_iter().map(Classified::new).collect(), table.rays)
}

/// Rays to punctual lights, one for each point, agree with f64 lines. A cell is shadowed if no ray reaches the light,
/// else it is a boundary whose visibility is the share of rays that do. Results of another cell are detected.
#[kernel_test("PENUMBRA_DEVICE")]
fn rays_reach_what_lines_reach(gpu: &Gpu) {
    let stage = stage(gpu, Technique::VISIBILITY_CELLS);
    let shape = GridShape::over_scene(&stage.scene, CELLS);
    let points = points(&stage.scene, &shape);
    let (words, rays) = classified(gpu, &stage, shape, &points, RAYS);
    let counts = expected(&stage.scene, &shape, &points);
    let cells = shape.cells() as usize;
    let (mut visible_count, mut mixed, mut off_by_shift) = (0, 0, 0);
    for light in 1..LIGHTS {
        for cell in 0..cells {
            let (got, [visible, blocked, doubtful]) = (words[light * cells + cell], counts[light * cells + cell]);
            assert_eq!(got.n_i + got.n_s, visible + blocked + doubtful, "light {light}, cell {cell}: rays");
            assert!(
                got.n_i >= visible && got.n_s >= blocked,
                "light {light}, cell {cell}: {got:?} {:?}",
                [visible, blocked]
            );
            let class = match (got.n_i, got.n_s) {
                (0, 0) => Class::Unknown,
                (0, _) => Class::Shadowed,
                _ => Class::Boundary,
            };
            assert_eq!(got.class, class);
            if class == Class::Boundary {
                let share = got.n_i as f32 / (got.n_i + got.n_s) as f32;
                // Half a step of a class word's visibility, and its rounding.
                assert!((got.visibility - share).abs() < 0.6 / 2047.0);
            }
            visible_count += visible;
            mixed += u32::from(visible > 0 && blocked > 0);
            // The neighbour has other rays.
            off_by_shift += u32::from(counts[light * cells + (cell + 1) % cells][0] > got.n_i);
        }
    }
    println!("{} points, {rays} rays, {visible_count} visible, {mixed} cells mixed", points.len());
    assert!(mixed > 10 && off_by_shift > 10, "{mixed} mixed cells, {off_by_shift} differ from the next: no test");
    let punctual = 2 * points.len() as u64;
    assert!(rays >= punctual && rays <= punctual + points.len() as u64);
}

/// A voxel keeps its tag only if all its neighbours have the same tag; `visibility-cells` uses each cell alone.
#[kernel_test("PENUMBRA_DEVICE")]
fn tags_stand_where_neighbours_agree(gpu: &Gpu) {
    let [cells_stage, tags_stage] =
        [Technique::VISIBILITY_CELLS, Technique::VOXEL_TAGS].map(|technique| stage(gpu, technique));
    let shape = GridShape::over_scene(&cells_stage.scene, CELLS);
    let points = points(&cells_stage.scene, &shape);
    let (plain, _) = classified(gpu, &cells_stage, shape, &points, RAYS);
    let (tagged, _) = classified(gpu, &tags_stage, shape, &points, RAYS);
    let [width, height, depth] = shape.size;
    let (mut counts, mut alone_differs) = ([0; 5], 0);
    for (index, got) in tagged.iter().enumerate() {
        let (light, cell) = (index as u32 / shape.cells(), index as u32 % shape.cells());
        let at = UVec3::new(cell % width, cell / width % height, cell / (width * height));
        let (mut lit, mut shadowed) = (true, true);
        for (z, y, x) in (0..27).map(|i| (i / 9, i / 3 % 3, i % 3)) {
            let next = at + UVec3::new(x, y, z);
            if next.cmplt(UVec3::ONE).any() || (next - 1).cmpge(UVec3::new(width, height, depth)).any() {
                continue;
            }
            let next = next - 1;
            let near = &plain[(light * shape.cells() + (next.z * height + next.y) * width + next.x) as usize];
            lit &= near.n_s == 0;
            shadowed &= near.n_i == 0;
        }
        let own = &plain[index];
        let class = match (own.n_i + own.n_s, lit, shadowed) {
            (0, ..) => Class::Unknown,
            (_, true, _) => Class::Lit,
            (_, _, true) => Class::Shadowed,
            _ => Class::Boundary,
        };
        assert_eq!(got.class, class, "light {light}, cell {at}");
        counts[class as usize] += 1;
        alone_differs += u32::from(class == Class::Boundary && (own.n_i == 0 || own.n_s == 0));
    }
    println!("{counts:?}, {alone_differs} by their neighbours alone");
    assert!(counts[1..].iter().all(|n| *n > 5) && alone_differs > 10, "{counts:?}, {alone_differs}: no test");
}

/// The share of a cell's rays that reach an area light is that of f64 lines between random points of both.
#[kernel_test("PENUMBRA_DEVICE")]
fn shares_are_visibilities(gpu: &Gpu) {
    let stage = stage(gpu, Technique::VISIBILITY_CELLS);
    let shape = GridShape::over_scene(&stage.scene, CELLS);
    let rays = 480;
    let mut random = Random(9);
    // Under the edge of a panel.
    let (low, high) = (DVec3::new(0.42, -0.5, -0.3), DVec3::new(0.5, -0.5, -0.2));
    let point = |random: &mut Random| low + (high - low) * (random.point() * 0.5 + 0.5);
    let triangle = |p: DVec3| {
        crossings(&stage.scene, p + DVec3::Y * 1e-3, DVec3::NEG_Y).iter().find(|c| c.t > 0.0).map(|c| c.triangle)
    };
    let home = cell_of(&shape, ((low + high) / 2.0).as_vec3().to_array());
    let mut own = Vec::new();
    while own.len() < rays {
        let p = point(&mut random);
        let position = p.as_vec3().to_array();
        if cell_of(&shape, position) == home {
            own.push(CellPoint { position, triangle: triangle(p).unwrap() as u32 });
        }
    }
    let (words, _) = classified(gpu, &stage, shape, &own, rays as u32);
    let got = words[SQUARE * shape.cells() as usize + home];
    let (mut visible, total) = (0.0, 20_000);
    for i in 0..total {
        let from = Vec3::from(own[i % rays].position).as_dvec3();
        let p = random.point();
        let to = DVec3::new(0.15 * p.x, 0.45, 0.15 * p.z);
        // Own surface and that of the light are crossed at the ends, where rounding decides.
        let blocked = crossings(&stage.scene, from, to - from).iter().any(|c| c.t > 1e-4 && c.t < 1.0 - 1e-4);
        visible += f64::from(u8::from(!blocked));
    }
    let (share, expected) = (f64::from(got.n_i) / f64::from(got.n_i + got.n_s), visible / total as f64);
    let error = (expected * (1.0 - expected) / rays as f64).sqrt();
    println!("{share}, expected {expected} +- {error}");
    assert!(expected > 0.1 && expected < 0.9, "{expected}: no test");
    // Four standard errors of 480 independent rays; the 20,000 lines have a sixth of that error.
    assert!(
        got.n_i + got.n_s == rays as u32 && (share - expected).abs() < 4.0 * error,
        "{share}, {expected} +- {error}"
    );
}

/// Points get the word of their cell. Points that face away from the light are dark, and so are invalid points.
#[kernel_test("PENUMBRA_DEVICE")]
fn points_have_the_class_of_their_cell(gpu: &Gpu) {
    let stage = stage(gpu, Technique::VOXEL_TAGS);
    let shape = GridShape::over_scene(&stage.scene, CELLS);
    let own = points(&stage.scene, &shape);
    let pass = Cells::new(gpu, &stage.features, &stage.gpu_scene.constants()).unwrap();
    let grid = CellGrid { shape, lights: LIGHTS as u32, rays: RAYS, seed: 5 };
    let table = pass.trace(gpu, &stage.gpu_scene, &grid, [own.clone()].into_iter()).unwrap();
    let words = table.words(gpu, LIGHTS as u32).unwrap();
    let mut points: Vec<Point> =
        own.iter().map(|p| Point { position: p.position, normal: oct_encode(DVec3::Y) }).collect();
    points.truncate(600);
    points.iter_mut().step_by(7).for_each(|point| point.normal = oct_encode(DVec3::NEG_Y));
    points.iter_mut().step_by(11).for_each(|point| point.normal = INVALID_POINT);
    let tile = whole([points.len() as u32, 1], 1);
    let mut buffers = TileBuffers::new(gpu, &stage.features, tile.point_count, false).unwrap();
    buffers.points = published(gpu, "test/points", &points);
    let candidates = 2 * points.len();
    let classes = gpu.poisoned::<u32>("test/classes", candidates + 3).unwrap();
    let bound = pass.bind(gpu, &buffers, &table, &classes, &stage.gpu_scene).unwrap();
    let mut frame = gpu.frame("test");
    bound.record(
        &mut frame,
        &tile,
        &Chunk { first_light: 1, lights: 2, dilate: 0, audits: AuditProbabilities::default() },
    );
    frame.submit().unwrap();
    let got: Vec<u32> = gpu.read(&classes, candidates + 3).unwrap();
    for (candidate, got) in got[..candidates].iter().enumerate() {
        let (light, point) = (1 + candidate / points.len(), &points[candidate % points.len()]);
        let word = words[light * shape.cells() as usize + cell_of(&shape, point.position)];
        let expected = if point.normal == oct_encode(DVec3::Y) { word } else { Class::Dark as u32 };
        assert_eq!(*got, expected, "candidate {candidate}");
    }
    assert!(got[candidates..].iter().all(|word| *word == kernel_kit::POISON), "past the end");
}
