//! Pass `fine_cells` and the table of fine cells, against a map of cells on the CPU.

use std::collections::BTreeMap;

use bytemuck::{Pod, Zeroable};
use glam::{DVec3, Vec3};
use kernel_kit::{Buffer, Gpu, Kernel, Resources, kernel_test};
use penumbra::internal::kernels::{Class, Classified, Queue, compose_source};
use penumbra::internal::passes::classify::{AuditProbabilities, Chunk, Classify, ClassifyBuffers};
use penumbra::internal::passes::fine_cells::{FineCell, FineCellTable, FineCellView, FineCells};
use penumbra::internal::passes::{Point, Tile, TileBuffers};
use penumbra::internal::specialisation::features::{Feature, Features};
use penumbra::internal::statistics::Counter;

use crate::kit::{device_features, new_kernel, published};
use crate::random::Random;
use crate::rooms::point;
use crate::stage::whole;

const NEAREST: u32 = 20;
const VIEW: FineCellView =
    FineCellView { eye: [0.0, 0.0, 1.5], slope: 0.004, width: 0.0, mask: (1 << 15) - 1, closed: 0, padding: 0 };

/// A point whose shadow rays are stored: position and word (rays that reached the light in bits 0-7, those that did not
/// in bits 8-15, the light above), and normal.
#[derive(Clone, Copy, Pod, Zeroable)]
#[repr(C)]
struct Rays {
    position: [f32; 3],
    word: u32,
    normal: [f32; 3],
    padding: u32,
}

fn features(gpu: &Gpu) -> Features {
    device_features(gpu).with(Feature::FineCells, true)
}

/// A cell on the CPU: light, side, axis, exponent of its width, how often it was divided, place.
type Key = (u32, bool, usize, i32, u32, [i64; 3]);

#[derive(Clone, Copy, Default)]
struct Cell {
    photons: [u32; 2],
    class: Option<Class>,
    /// It has many photons, all of one kind.
    many: bool,
}

#[derive(Default)]
struct Oracle {
    cells: BTreeMap<Key, Cell>,
    /// A fault: cells are classified without those around them.
    alone: bool,
    /// Photons that are many, over k: 2, or a fault.
    many: u32,
}

/// The cell of the width 2^`exponent`, and how far the position is from its faces, in widths.
fn cell_at(rays: &Rays, exponent: i32, level: u32) -> (Key, f64) {
    let normal = Vec3::from(rays.normal).as_dvec3();
    let size = normal.abs();
    let axis = if size.z > size.x.max(size.y) { 2 } else { usize::from(size.y > size.x) };
    let offset = DVec3::new(0.3173, 0.2719, 0.4142);
    let mut scale = DVec3::splat((-f64::from(exponent)).exp2());
    scale[axis] /= 4.0;
    let at = (Vec3::from(rays.position).as_dvec3() + offset) * scale;
    let place = at.floor().to_array().map(|x| x as i64);
    let margin = (at - at.round()).abs().min_element();
    ((rays.word >> 16, normal[axis] < 0.0, axis, exponent, level, place), margin)
}

/// The exponent of the width of the coarsest cell, and how far it is from the next.
fn coarsest(rays: &Rays) -> (i32, f64) {
    let distance = (Vec3::from(rays.position) - Vec3::from(VIEW.eye)).as_dvec3().length();
    let log = (4.0 * f64::from(VIEW.slope) * distance).log2();
    (log.ceil() as i32, (log - log.round()).abs())
}

/// The point's cells from coarse to fine; `None` if they depend on rounding.
fn cells_of(rays: &Rays) -> Option<Vec<Key>> {
    let (exponent, margin) = coarsest(rays);
    let cells: Vec<_> = (0..5).map(|level| cell_at(rays, exponent - level as i32, level)).collect();
    // The finest cells are 2^-10 wide: a coordinate of unit size is rounded by 1024 * 6e-8 = 6e-5 of one. A logarithm
    // of a distance with a few roundings is off by 1e-6.
    let clear = margin > 1e-5 && cells.iter().all(|(_, margin)| *margin > 1e-3);
    clear.then(|| cells.into_iter().map(|(key, _)| key).collect())
}

impl Oracle {
    /// The point's cell that is not divided, and how often its parents were.
    fn find(&self, cells: &[Key]) -> (Cell, usize) {
        for (level, key) in cells.iter().enumerate() {
            match self.cells.get(key) {
                Some(Cell { class: Some(Class::Boundary), .. }) => (),
                other => return (other.copied().unwrap_or_default(), level),
            }
        }
        (Cell { class: Some(Class::Boundary), ..Cell::default() }, cells.len())
    }

    fn store(&mut self, rays: &Rays) {
        let cells = cells_of(rays).unwrap();
        let level = self.find(&cells).1;
        let counts = [rays.word & 255, (rays.word >> 8) & 255];
        if level < cells.len() && counts != [0, 0] {
            let cell = self.cells.entry(cells[level]).or_default();
            for (photons, count) in cell.photons.iter_mut().zip(counts) {
                *photons += count.min(1);
            }
        }
    }

    fn classify(&mut self) {
        let before = self.cells.clone();
        for (key, cell) in self.cells.iter_mut().filter(|(_, cell)| cell.class != Some(Class::Boundary)) {
            let mut photons = [0; 2];
            for i in 0..9 {
                let mut near = *key;
                let [u, v] = [[1, 2], [0, 2], [0, 1]][key.2];
                near.5[u] += i % 3 - 1;
                near.5[v] += i / 3 - 1;
                if let Some(other) = before.get(&near).filter(|_| i == 4 || !self.alone) {
                    photons = [photons[0] + other.photons[0], photons[1] + other.photons[1]];
                }
            }
            let enough = if key.4 > 0 { NEAREST.div_ceil(2) } else { NEAREST };
            let [lit, shadowed] = photons.map(|count| count > 0);
            cell.class = Some(match (lit, shadowed) {
                (true, true) => Class::Boundary,
                _ if photons[0] + photons[1] < enough => Class::Unknown,
                (lit, _) => [Class::Shadowed, Class::Lit][usize::from(lit)],
            });
            cell.many = lit != shadowed && key.4 > 0 && photons[0] + photons[1] >= self.many * NEAREST;
        }
    }
}

/// Points of three surfaces, each with an edge of a shadow of each of two lights.
fn points(random: &mut Random, count: usize) -> Vec<Rays> {
    let normals = [DVec3::new(0.1, 0.98, 0.05), DVec3::new(-0.7, 0.2, 0.6), DVec3::new(0.3, 0.4, -0.8)];
    let mut points = Vec::new();
    while points.len() < count {
        let which = points.len() % 3;
        let normal = normals[which].normalize();
        let (u, v) = normal.any_orthonormal_pair();
        let [a, b] = [random.uniform() * 0.3, random.uniform() * 0.3];
        let position = (normal * (0.3 + 0.2 * which as f64) + u * a + v * b).as_vec3().to_array();
        let light = points.len() as u32 / 3 % 2;
        let edge = if light == 0 { a - 0.13 } else { b - 0.5 * a - 0.08 };
        // Within 0.01 of the edge some of four rays reach the light.
        let visible = ((edge / 0.01).clamp(0.0, 1.0) * 4.0).round() as u32;
        let word = light << 16 | (4 - visible) << 8 | visible;
        let rays = Rays { position, word, normal: normal.as_vec3().to_array(), padding: 0 };
        if cells_of(&rays).is_some() {
            points.push(rays);
        }
    }
    points
}

/// The device's table, and the kernels for it.
struct Device<'a> {
    gpu: &'a Gpu,
    table: FineCellTable,
}

impl<'a> Device<'a> {
    fn new(gpu: &'a Gpu, view: FineCellView) -> Device<'a> {
        Device { gpu, table: FineCellTable::new(gpu, view).unwrap() }
    }

    fn run(&self, entry: &str, rays: &[Rays], count: usize) -> Vec<u32> {
        let composed =
            compose_source("fine_cells_test", include_str!("shaders/fine_cells.wgsl"), &features(self.gpu)).unwrap();
        let kernel: Kernel = new_kernel(self.gpu, &composed, &[("count", count as f64)], &["rays"]).unwrap();
        let input = self.gpu.upload("test/rays", rays).unwrap();
        let found: Buffer = self.gpu.poisoned::<u32>("test/found", rays.len()).unwrap();
        let own = Resources::new().with("rays", &input).with("found", &found);
        let bound = kernel.bind(self.gpu, entry, &[&own, &self.table.bindings()]).unwrap();
        let mut frame = self.gpu.frame("test");
        frame.run(&bound, count as u32, &());
        frame.submit().unwrap();
        self.gpu.read(&found, rays.len()).unwrap()
    }

    fn count(&self) -> u32 {
        self.table.count(self.gpu).unwrap()[0]
    }

    /// Searches that found neither their cell nor an entry.
    fn without_entry(&self) -> u32 {
        self.table.count(self.gpu).unwrap()[1]
    }

    fn classify(&self) {
        let bound =
            FineCells::new(self.gpu, &features(self.gpu), NEAREST).unwrap().bind(self.gpu, &self.table).unwrap();
        let mut frame = self.gpu.frame("test");
        self.table.publish(&mut frame);
        frame.run(&bound, self.count(), &());
        self.table.publish(&mut frame);
        frame.submit().unwrap();
    }

    fn cells(&self) -> Vec<FineCell> {
        let entries = (self.table.cells.bytes / 32) as usize;
        let cells: Vec<FineCell> = self.gpu.read(&self.table.cells, entries).unwrap();
        let tags: Vec<u32> = self.gpu.read(&self.table.tags, entries).unwrap();
        cells.into_iter().zip(tags).filter(|(_, tag)| *tag != 0).map(|(cell, _)| cell).collect()
    }
}

#[derive(Default)]
struct Compared {
    /// Points that differ from the oracle after each round.
    wrong: usize,
    /// Points of each class at the end, and those whose cells have many photons of one kind.
    classes: [usize; Class::COUNT],
    settled: usize,
}

/// Compares device and oracle after each of six rounds of stored points.
fn compare(gpu: &Gpu, alone: bool, many: u32) -> Compared {
    let (device, mut oracle) = (Device::new(gpu, VIEW), Oracle { alone, many, ..Oracle::default() });
    let mut random = Random(7);
    let mut compared = Compared::default();
    for round in 0..6 {
        let points = points(&mut random, 4000 << round.min(3));
        device.run("store", &points, points.len());
        points.iter().for_each(|rays| oracle.store(rays));
        let mut expected: Vec<_> = oracle.cells.values().map(|cell| cell.photons).collect();
        let mut photons: Vec<_> = device.cells().iter().map(|cell| [cell.illumination, cell.shadow]).collect();
        expected.sort();
        photons.sort();
        if !alone {
            assert_eq!(device.count() as usize, expected.len(), "round {round}: cells");
            assert_eq!(photons, expected, "round {round}: photons of the cells");
        }
        device.classify();
        oracle.classify();
        compared.classes = [0; Class::COUNT];
        compared.settled = 0;
        for (rays, found) in points.iter().zip(device.run("look_up", &points, points.len())) {
            let (cell, level) = oracle.find(&cells_of(rays).unwrap());
            let class = cell.class.unwrap_or(Class::Unknown);
            let place = if level > 0 { 1 + u32::from(cell.many) } else { 0 };
            compared.wrong += usize::from(found != class as u32 | place << 3);
            compared.classes[class as usize] += 1;
            compared.settled += usize::from(cell.many);
        }
    }
    compared
}

/// Every cell has its photons, and every point the class of its cell, from the coarsest to the finest. Cells that are
/// classified without those around them are detected.
#[kernel_test("PENUMBRA_DEVICE")]
fn cells_decide_as_their_photons_tell(gpu: &Gpu) {
    let Compared { wrong, classes, settled } = compare(gpu, false, 2);
    println!("classes {classes:?}, settled {settled}");
    assert_eq!(wrong, 0);
    let [_, lit, shadowed, boundary, unknown] = classes;
    assert!(lit > 1000 && shadowed > 1000 && boundary > 1000 && unknown > 100, "{classes:?}: no test");
    assert!(settled > 500, "{settled} settled: no test");
    assert!(compare(gpu, true, 2).wrong > 100, "a planted fault");
    assert!(compare(gpu, false, 3).wrong > 100, "a planted fault");
}

/// Pass `classify` counts candidates near boundaries and in settled cells apart. With the audit probability of 1 near
/// boundaries, a quarter of the settled ones are audited.
#[kernel_test("PENUMBRA_DEVICE")]
fn candidates_count_by_the_nearness_of_their_cells(gpu: &Gpu) {
    let device = Device::new(gpu, VIEW);
    let mut random = Random(7);
    for _ in 0..5 {
        let rays = points(&mut random, 16_000);
        device.run("store", &rays, rays.len());
        device.classify();
    }
    let points: Vec<Point> =
        points(&mut random, 20_001).iter().map(|rays| point(rays.position.into(), rays.normal.into())).collect();
    let tile = Tile { seed: 0, ..whole([points.len() as u32, 1], 1) };
    let chunk = Chunk { first_light: 0, lights: 2, dilate: 0, audits: AuditProbabilities { away: 0.5, near: 1.0 } };
    let candidates = 2 * points.len();
    let mut tile_buffers = TileBuffers::new(gpu, &features(gpu), tile.point_count, false).unwrap();
    tile_buffers.points = published(gpu, "test/points", &points);
    let mut buffers = ClassifyBuffers::new(gpu, candidates as u32).unwrap();
    buffers.classes = gpu.poisoned::<u32>("test/classes", candidates).unwrap();
    let pass = Classify::new(gpu, &features(gpu), NEAREST).unwrap();
    let bound = pass.bind(gpu, &tile_buffers, None, &buffers, &device.table.bindings()).unwrap();
    let mut frame = gpu.frame("test");
    bound.classify(&mut frame, &buffers, &tile, &chunk);
    frame.submit().unwrap();
    let words: Vec<u32> = gpu.read(&buffers.classes, candidates).unwrap();
    let counters: Vec<u32> = gpu.read(&tile_buffers.counters, Counter::COUNT).unwrap();
    let lengths: Vec<u32> = gpu.read(&buffers.queue_lengths, Queue::COUNT).unwrap();
    let audited: Vec<u32> = gpu.read(&buffers.audit_queue, lengths[Queue::Audit as usize] as usize).unwrap();
    // The visibility of a decided candidate is this many steps from its class.
    let nearness = |word: u32| {
        let is_decided = matches!(Classified::new(word).class, Class::Lit | Class::Shadowed);
        is_decided.then(|| (word >> 21).min(2047 - (word >> 21)))
    };
    let count = |words: &mut dyn Iterator<Item = u32>, steps: u32| {
        words.filter(|word| nearness(*word) == Some(steps)).count() as u32
    };
    let all = [1, 2].map(|steps| count(&mut words.iter().copied(), steps));
    let of_audited = [0, 1, 2].map(|steps| count(&mut audited.iter().map(|c| words[*c as usize]), steps));
    let counter = |counter: Counter| counters[counter as usize];
    assert_eq!([counter(Counter::Near), counter(Counter::Settled)], all);
    assert_eq!([counter(Counter::NearAudited), counter(Counter::SettledAudited)], of_audited[1..]);
    assert_eq!(counter(Counter::Audited), of_audited.iter().sum::<u32>());
    let [near, settled] = all;
    assert!(near > 500 && settled > 500, "{near} near, {settled} settled: no test");
    assert_eq!(of_audited[1], near);
    // Five standard deviations of a binomial.
    let deviation = f64::from(of_audited[2]) - 0.25 * f64::from(settled);
    assert!(deviation.abs() < 5.0 * (f64::from(settled) * 0.25 * 0.75).sqrt(), "{deviation} of {settled}");
}

/// Points of more than 65,535 workgroups all count, as few do.
#[kernel_test("PENUMBRA_DEVICE")]
fn all_points_count(gpu: &Gpu) {
    let point = points(&mut Random(3), 1);
    for count in [0, 1, 63, 64, 65, 65_536 * 64 + 1] {
        let device = Device::new(gpu, VIEW);
        device.run("store", &point, count);
        let cells = device.cells();
        let total: u32 = cells.iter().map(|cell| cell.illumination.max(cell.shadow)).sum();
        assert_eq!((cells.len(), total), (count.min(1), count as u32), "{count} points");
    }
}

/// A closed table takes no new cell. A full one loses cells, and counts the searches for those.
#[kernel_test("PENUMBRA_DEVICE")]
fn full_and_closed_take_nothing(gpu: &Gpu) {
    // Each stores one photon.
    let mut points = points(&mut Random(5), 5000);
    points.retain(|rays| rays.word & 255 == 0 || (rays.word >> 8) & 255 == 0);
    let closed = Device::new(gpu, FineCellView { closed: 1, ..VIEW });
    closed.run("store", &points, points.len());
    assert_eq!((closed.count(), closed.cells().len(), closed.without_entry()), (0, 0, 0));
    let small = Device::new(gpu, FineCellView { mask: 15, ..VIEW });
    small.run("store", &points, points.len());
    assert_eq!((small.count(), small.cells().len()), (16, 16));
    let stored: u32 = small.cells().iter().map(|cell| cell.illumination + cell.shadow).sum();
    assert_eq!(stored + small.without_entry(), points.len() as u32);
}
