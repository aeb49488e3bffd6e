//! Pass `grid` against a sort on the CPU.

use std::collections::HashMap;

use glam::Vec3;
use kernel_kit::{Bindings, Gpu, Resources, kernel_test};
use penumbra::internal::kernels::{GridShape, compose, compose_source};
use penumbra::internal::passes::grid::{Grid, Photon, PhotonGrid};
use penumbra::internal::specialisation::features::{Feature, Features};

use crate::kit::{device_features, new_kernel};
use crate::rooms::{Random, Room, photon};

const DUMP: &str = "
import package::lib::grid::{load_cell_start, load_photon, nearest};
struct DumpParameters { photons: u32, starts: u32 }
@group(0) @binding(0) var<storage, read_write> dumped_photons: array<vec4u>;
@group(0) @binding(1) var<storage, read_write> dumped_starts: array<u32>;
@group(0) @binding(2) var<storage, read> lengths: array<u32, 2>;
@compute @workgroup_size(64)
fn dump(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = (group.x + group.y * groups.x) * 64u + lane;
    if i < lengths[0] { dumped_photons[i] = load_photon(i); }
    if i < lengths[1] { dumped_starts[i] = load_cell_start(i); }
}";

/// The sorted photons and the start of every cell, as kernels see them.
fn dump(gpu: &Gpu, grid: &PhotonGrid) -> (Vec<Photon>, Vec<u32>) {
    let composed = compose_source("dump", DUMP, &device_features(gpu)).unwrap();
    let kernel = new_kernel(gpu, &composed, &[], &[]).unwrap();
    let (photons, starts) = (grid.photons, grid.shape.cells() * grid.lights + 1);
    let dumped_photons = gpu.poisoned::<Photon>("test/photons", photons as usize).unwrap();
    let dumped_starts = gpu.poisoned::<u32>("test/starts", starts as usize).unwrap();
    let lengths = gpu.upload("test/lengths", &[photons, starts]).unwrap();
    let own = Resources::new()
        .with("dumped_photons", &dumped_photons)
        .with("dumped_starts", &dumped_starts)
        .with("lengths", &lengths);
    let bound = kernel.bind(gpu, "dump", &[&own, grid as &dyn Bindings]).unwrap();
    let mut frame = gpu.frame("test");
    frame.run(&bound, photons.max(starts), &[0u32; 0]);
    frame.submit().unwrap();
    (gpu.read(&dumped_photons, photons as usize).unwrap(), gpu.read(&dumped_starts, starts as usize).unwrap())
}

fn key(photon: &Photon, shape: &GridShape) -> u32 {
    let cell = |axis: usize| {
        let at = ((photon.position[axis] - shape.origin[axis]) * shape.inverse_cell).floor();
        (at as i64).clamp(0, i64::from(shape.size[axis]) - 1) as u32
    };
    let light = photon.light();
    ((light * shape.size[2] + cell(2)) * shape.size[1] + cell(1)) * shape.size[0] + cell(0)
}

fn bits(photon: &Photon) -> [u32; 4] {
    let [x, y, z] = photon.position.map(f32::to_bits);
    [x, y, z, photon.word]
}

/// Whether `sorted` with `starts` holds every photon of `photons` once, each in its cell.
fn sorts(photons: &[Photon], shape: &GridShape, sorted: &[Photon], starts: &[u32]) -> bool {
    let mut left: HashMap<[u32; 4], i64> = HashMap::new();
    photons.iter().for_each(|p| *left.entry(bits(p)).or_default() += 1);
    sorted.iter().for_each(|p| *left.entry(bits(p)).or_default() -= 1);
    starts[0] == 0
        && *starts.last().unwrap() as usize == photons.len()
        && left.values().all(|n| *n == 0)
        && starts.windows(2).enumerate().all(|(cell, range)| {
            range[0] <= range[1]
                && sorted[range[0] as usize..range[1] as usize].iter().all(|p| key(p, shape) == cell as u32)
        })
}

fn map_features(gpu: &Gpu) -> Features {
    device_features(gpu).with(Feature::VisibilityMap, true)
}

fn build(gpu: &Gpu, photons: &[Photon], lights: u32, shape: GridShape) -> PhotonGrid {
    let pass = Grid::new(gpu, &map_features(gpu), 50).unwrap();
    let buffer = gpu.upload("test/photons", photons).unwrap();
    pass.build(gpu, &buffer, photons.len() as u32, lights, shape).unwrap()
}

fn scattered(count: usize, lights: u32, random: &mut Random) -> Vec<Photon> {
    (0..count)
        .map(|_| {
            let position = Vec3::new(random.signed(), random.signed(), random.signed()) * 0.5;
            photon(position, random.direction(), random.word() % lights, random.unit() < 0.3)
        })
        .collect()
}

/// No photon is lost or put in a wrong cell: no photons, one photon, numbers around the size of a workgroup, many
/// lights.
#[kernel_test("PENUMBRA_DEVICE")]
fn photons_are_sorted_by_light_and_cell(gpu: &Gpu) {
    let mut random = Random(1);
    for (count, lights) in [(0, 1), (1, 1), (63, 1), (64, 2), (65, 3), (5000, 7), (100_000, 1)] {
        let photons = scattered(count, lights, &mut random);
        let shape = GridShape::new((Vec3::splat(-0.5), Vec3::splat(0.5)), 6.0, count as u32 / lights, lights, 50);
        let (sorted, starts) = dump(gpu, &build(gpu, &photons, lights, shape));
        assert!(sorts(&photons, &shape, &sorted, &starts), "{count} photons of {lights} lights");
    }
}

/// More photons than 65,535 workgroups hold in one dimension.
#[kernel_test("PENUMBRA_DEVICE")]
fn millions_of_photons_are_sorted(gpu: &Gpu) {
    let count = 65_535 * 64 + 77;
    let photons = scattered(count, 2, &mut Random(2));
    // Coarse cells, too full to be classified: this is about sorting.
    let shape = GridShape::new((Vec3::splat(-0.5), Vec3::splat(0.5)), 6.0, 600, 2, 50);
    let (sorted, starts) = dump(gpu, &build(gpu, &photons, 2, shape));
    assert!(sorts(&photons, &shape, &sorted, &starts));
}

/// Clusters, photons on the grid's corners, and all photons in one cell.
#[kernel_test("PENUMBRA_DEVICE")]
fn crowded_cells_keep_every_photon(gpu: &Gpu) {
    let mut random = Random(3);
    let shape = GridShape::new((Vec3::splat(-0.5), Vec3::splat(0.5)), 6.0, 50_000, 1, 50);
    let mut corners = Vec::new();
    for i in 0..8u32 {
        let corner = Vec3::new((i & 1) as f32, (i >> 1 & 1) as f32, (i >> 2) as f32) - 0.5;
        corners.extend((0..100).map(|_| photon(corner, Vec3::Y, 0, false)));
    }
    let one_cell: Vec<Photon> = (0..1_000_000)
        .map(|_| photon(Vec3::new(random.unit(), random.unit(), random.unit()) * 1e-4, Vec3::Y, 0, random.unit() < 0.5))
        .collect();
    let clusters: Vec<Photon> = (0..30_000)
        .map(|i| {
            photon(random.direction() * 0.4 * (i % 3) as f32 * random.unit().powi(8), random.direction(), 0, false)
        })
        .collect();
    for photons in [corners, one_cell, clusters] {
        let (sorted, starts) = dump(gpu, &build(gpu, &photons, 1, shape));
        assert!(sorts(&photons, &shape, &sorted, &starts));
    }
}

/// The check above detects a photon of another light, a dropped photon, and two exchanged cells.
#[kernel_test("PENUMBRA_DEVICE")]
fn the_check_sees_planted_faults(gpu: &Gpu) {
    let photons = scattered(3000, 2, &mut Random(4));
    let shape = GridShape::new((Vec3::splat(-0.5), Vec3::splat(0.5)), 6.0, 1500, 2, 50);
    let (sorted, starts) = dump(gpu, &build(gpu, &photons, 2, shape));
    assert!(sorts(&photons, &shape, &sorted, &starts));
    let mut shifted = sorted.clone();
    shifted[7].word ^= 1 << 14;
    assert!(!sorts(&photons, &shape, &shifted, &starts));
    let mut dropped = sorted.clone();
    *dropped.last_mut().unwrap() = Photon::default();
    assert!(!sorts(&photons, &shape, &dropped, &starts));
    let mut exchanged = sorted.clone();
    exchanged.swap(0, 2999);
    assert!(!sorts(&photons, &shape, &exchanged, &starts));
}

/// Grids of flat, tiny, crowded and empty scenes stay within their bounds.
#[test]
fn shapes_are_bounded() {
    let flat = (Vec3::new(-1.0, 0.0, -1.0), Vec3::new(1.0, 0.0, 1.0));
    let cube = (Vec3::splat(-1.0), Vec3::splat(1.0));
    let dot = (Vec3::ZERO, Vec3::ZERO);
    for bounds in [flat, cube, dot] {
        for (photons, lights) in [(0, 1), (1, 1), (131_072, 1), (8_000_000, 1), (1000, 2048)] {
            for area in [0.0, 4.0, 1e6] {
                let shape = GridShape::new(bounds, area, photons, lights, 50);
                assert!(shape.cells() >= 1 && u64::from(shape.cells()) * u64::from(lights) <= 1 << 22, "{shape:?}");
                let covers = |a: usize| {
                    shape.origin[a] + shape.cell * shape.size[a] as f32 >= bounds.1.to_array()[a]
                        && shape.origin[a] <= bounds.0.to_array()[a]
                };
                assert!((0..3).all(covers), "{shape:?}");
            }
        }
    }
}

/// Too many lights and a k that a class word cannot hold are refused.
#[kernel_test("PENUMBRA_DEVICE")]
fn settings_out_of_range_are_refused(gpu: &Gpu) {
    let features = map_features(gpu);
    for nearest in [0, 512] {
        let problem = Grid::new(gpu, &features, nearest).err().unwrap().to_string();
        assert!(problem.contains(&nearest.to_string()), "{problem}");
    }
    let room = Room::new(0.2);
    let shape = GridShape::new(room.bounds(), room.area(), 1, 1, 50);
    let pass = Grid::new(gpu, &features, 50).unwrap();
    let photons = gpu.buffer::<Photon>("test/photons", 1).unwrap();
    assert!(pass.build(gpu, &photons, 1, 2049, shape).is_err());
}

/// The kernel composes and validates with every reachable set of features.
#[test]
fn every_set_of_features_composes() {
    for texture_loads in [false, true] {
        for paper_counting in [false, true] {
            for light_tags in [false, true] {
                let features = Features::default()
                    .with(Feature::TextureLoads, texture_loads)
                    .with(Feature::PaperCounting, paper_counting)
                    .with(Feature::LightTags, light_tags);
                compose("grid", &features).unwrap();
            }
        }
    }
}
