//! Pass `classify` against brute force on the CPU.

use std::collections::{HashMap, HashSet};

use glam::Vec3;
use kernel_kit::{Gpu, Resources, kernel_test};
use penumbra::internal::kernels::{
    CLASSIFY_CANDIDATES, CellKind, Class, Classified, GridShape, INVALID_POINT, Queue, ShownCell,
};
use penumbra::internal::passes::classify::{AuditProbabilities, Chunk, Classify, ClassifyBuffers, ShowCells};
use penumbra::internal::passes::grid::{Grid, Photon};
use penumbra::internal::passes::{Point, Tile, TileBuffers};
use penumbra::internal::specialisation::features::{Feature, Features};
use penumbra::internal::statistics::Counter;

use crate::kit::{device_features, published};
use crate::rooms::{Random, Room, nearest_kinds, point_normal};
use crate::stage::whole;

struct Outcome {
    words: Vec<u32>,
    /// The cells of the points; empty if they are not shown.
    cells: Vec<ShownCell>,
    counters: Vec<u32>,
    boundary_queue: Vec<u32>,
    audit_queue: Vec<u32>,
    arguments: Vec<u32>,
}

struct Setup<'a> {
    photons: &'a [Photon],
    points: &'a [Point],
    lights: u32,
    shape: GridShape,
    nearest: u32,
    exact_counts: bool,
    shows_cells: bool,
    paper_counting: bool,
    visibility_estimate: bool,
    tile: Tile,
    /// The pixels of the tile's rows that get samples, if not all do.
    listed: Option<Vec<u32>>,
    chunk: Chunk,
}

impl<'a> Setup<'a> {
    fn new(photons: &'a [Photon], points: &'a [Point], shape: GridShape, nearest: u32) -> Self {
        let tile = Tile { seed: 0, ..whole([points.len() as u32, 1], 1) };
        let chunk = Chunk { first_light: 0, lights: 1, dilate: 0, audits: AuditProbabilities::default() };
        Setup {
            photons,
            points,
            lights: 1,
            shape,
            nearest,
            exact_counts: true,
            shows_cells: false,
            paper_counting: false,
            visibility_estimate: false,
            tile,
            listed: None,
            chunk,
        }
    }

    fn run(&self, gpu: &Gpu) -> Outcome {
        let features: Features = device_features(gpu)
            .with(Feature::PaperCounting, self.paper_counting)
            .with(Feature::ExactCounts, self.exact_counts)
            .with(Feature::VisibilityEstimate, self.visibility_estimate)
            .with(Feature::AdaptiveSampling, self.listed.is_some())
            .with(Feature::VisibilityMap, true);
        let photons = gpu.upload("test/photons", self.photons).unwrap();
        let mut tile = TileBuffers::new(gpu, &features, self.tile.point_count, false).unwrap();
        tile.points = published(gpu, "test/points", self.points);
        if let (Some(sampled), Some(list)) = (&tile.sampled_pixels, &self.listed) {
            // As after a tile of more rows.
            sampled.set_all(gpu);
            sampled.set(gpu, list, (self.tile.columns * self.tile.rows) as usize);
        }
        let grid = Grid::new(gpu, &features, self.nearest)
            .unwrap()
            .build(gpu, &photons, self.photons.len() as u32, self.lights, self.shape)
            .unwrap();
        let candidates = self.tile.point_count * self.chunk.lights;
        let mut buffers = ClassifyBuffers::new(gpu, candidates).unwrap();
        buffers.classes = gpu.poisoned::<u32>("test/classes", candidates as usize).unwrap();
        let pass = Classify::new(gpu, &features, self.nearest).unwrap();
        let bound = pass.bind(gpu, &tile, Some(&grid), &buffers, &Resources::new()).unwrap();
        let mut frame = gpu.frame("test");
        // In the order of `src/techniques/shadow_photons.rs`.
        bound.classify(&mut frame, &buffers, &self.tile, &self.chunk);
        bound.look_up(&mut frame, &buffers, &self.tile, &self.chunk);
        bound.classify_requested_cells(&mut frame);
        bound.query(&mut frame, &buffers, &self.tile, &self.chunk);
        bound.dilate(&mut frame, &buffers, &self.tile, &self.chunk);
        for queue in [Queue::Boundary, Queue::Audit] {
            bound.record_arguments(&mut frame, &self.tile, &self.chunk, queue, 128);
        }
        frame.submit().unwrap();
        let lengths: Vec<u32> = gpu.read(&buffers.queue_lengths, Queue::COUNT).unwrap();
        let words = gpu.read(&buffers.classes, candidates as usize).unwrap();
        let mut cells = Vec::new();
        if self.shows_cells {
            let show = ShowCells::new(gpu, &features, self.nearest).unwrap();
            let bound = show.bind(gpu, &tile, Some(&grid), &buffers, &Resources::new()).unwrap();
            let mut frame = gpu.frame("test");
            bound.record(&mut frame, &self.tile, self.chunk.first_light);
            frame.submit().unwrap();
            let words: Vec<u32> = gpu.read(&buffers.classes, self.points.len()).unwrap();
            cells = words.into_iter().map(ShownCell::new).collect();
        }
        Outcome {
            words,
            cells,
            counters: gpu.read(&tile.counters, Counter::COUNT).unwrap(),
            boundary_queue: gpu.read(&buffers.boundary_queue, lengths[Queue::Boundary as usize] as usize).unwrap(),
            audit_queue: gpu.read(&buffers.audit_queue, lengths[Queue::Audit as usize] as usize).unwrap(),
            arguments: gpu.read(&buffers.queue_arguments, 16).unwrap(),
        }
    }

    /// Compares every `step`-th candidate with brute force over `photons`. Those whose answer depends on rounding are
    /// left out, and are few.
    fn compare(&self, gpu: &Gpu, photons: &[Photon], step: usize) -> Comparison {
        let outcome = self.run(gpu);
        let mut result = Comparison::default();
        let (mut checked, mut doubtful) = (0, 0);
        for candidate in (0..outcome.words.len()).step_by(step) {
            let point = &self.points[candidate % self.points.len()];
            let got = Classified::new(outcome.words[candidate]);
            result.counts[got.class as usize] += 1;
            if point.normal == INVALID_POINT {
                assert_eq!(got.class, Class::Dark);
                continue;
            }
            let light = self.chunk.first_light + (candidate / self.points.len()) as u32;
            let reach = f64::from(self.shape.reach());
            let k = self.nearest as usize;
            let Some(expected) = nearest_kinds(photons, point, light, k, reach, !self.paper_counting) else {
                doubtful += 1;
                continue;
            };
            checked += 1;
            let class = match expected {
                None => Class::Unknown,
                Some((_, 0)) => Class::Lit,
                Some((0, _)) => Class::Shadowed,
                Some(_) => Class::Boundary,
            };
            // A cell decides for all of its points or for none.
            // Cells that the visit budget is too small for leave their points unknown.
            let by_cell = !self.exact_counts && matches!(got.class, Class::Boundary | Class::Unknown);
            let undecided = by_cell && matches!(class, Class::Lit | Class::Shadowed);
            result.undecided += usize::from(undecided);
            // A ball of the paper's counting may reach another surface, with more photons than the budget is for.
            let by_ball = self.exact_counts && self.paper_counting;
            let over_budget = (by_cell || by_ball) && got.class == Class::Unknown;
            result.over_budget += usize::from(by_ball && over_budget && expected.is_some());
            let mut wrong = got.class != class && !undecided && !over_budget;
            if let Some((n_i, n_s)) = expected
                && self.exact_counts
                && !over_budget
            {
                wrong |= (got.n_i as usize, got.n_s as usize) != (n_i, n_s);
                // Half a step of eleven bits; a whole one marks a decided point near a boundary.
                let step = if got.class == Class::Boundary { 0.6 } else { 1.1 };
                wrong |= (f64::from(got.visibility) - n_i as f64 / k as f64).abs() >= step / 2047.0;
            }
            if wrong {
                result.wrong.push(format!("candidate {candidate}, {point:?}: {got:?}, expected {expected:?}"));
            }
        }
        // Relative errors of 1e-6 in the k-th distance: about k candidates per million have a photon within them.
        assert!(doubtful * 100 <= checked, "{doubtful} of {checked} candidates are in doubt");
        result
    }
}

#[derive(Default)]
struct Comparison {
    /// Candidates by class.
    counts: [usize; 5],
    /// Boundary and unknown candidates whose nearest photons are of one kind.
    undecided: usize,
    /// Candidates that the paper's counting should decide and does not.
    over_budget: usize,
    /// Candidates whose class or counts are not those of brute force.
    wrong: Vec<String>,
}

/// The box of the paper, camera points: classes and counts are those of brute force, with and without normals, with
/// exact counts and without. Missing photons are found.
#[kernel_test("PENUMBRA_DEVICE")]
fn a_room_is_classified_as_by_brute_force(gpu: &Gpu) {
    let room = Room::new(0.05);
    let photons = room.photons(60_000, 0, &mut Random(5));
    // Without every eighth photon.
    let fewer: Vec<Photon> = photons.chunks(8).flat_map(|eight| &eight[1..]).copied().collect();
    let points = room.points(128, 128);
    for (nearest, paper_counting, exact_counts) in [
        (50, false, true),
        (50, false, false),
        (50, true, true),
        (50, true, false),
        (1, false, true),
        (200, false, false),
    ] {
        let shape = GridShape::new(room.bounds(), room.area(), photons.len() as u32, 1, nearest);
        let mut setup = Setup::new(&photons, &points, shape, nearest);
        setup.paper_counting = paper_counting;
        setup.exact_counts = exact_counts;
        let Comparison { counts, undecided, over_budget, wrong } = setup.compare(gpu, &photons, 5);
        println!("k {nearest}, paper {paper_counting}: {counts:?}, {undecided} undecided, {over_budget} over budget");
        // One was: shadow rays decide there.
        assert!(over_budget <= points.len() / 5 / 1000, "{over_budget} points over the budget");
        assert!(wrong.is_empty(), "{} wrong, the first: {}", wrong.len(), wrong[0]);
        // Of 200 photons few neighbourhoods are all in the shadow.
        let min_count = if nearest <= 50 { 10 } else { 1 };
        assert!([Class::Lit, Class::Shadowed].iter().all(|c| counts[*c as usize] >= min_count), "{counts:?}");
        // The disc of the nearest k is 2.8 cells wide, so a boundary is about as wide, and a cell wider on each side.
        // (Balls of the paper's counting reach other surfaces, and 200 of 60,000 photons half of the room.)
        let is_measured = nearest == 50 && !paper_counting;
        assert!(!is_measured || undecided <= counts[Class::Boundary as usize] / 2, "{counts:?}, {undecided}");
        if exact_counts && nearest > 1 {
            setup.photons = &fewer;
            assert!(!setup.compare(gpu, &photons, 31).wrong.is_empty(), "missing photons are not found");
        }
    }
}

/// Shown cells are those of the grid, and by brute force their classes hold for each of their points. Missing photons
/// are found.
#[kernel_test("PENUMBRA_DEVICE")]
fn shown_cells_are_those_that_decide(gpu: &Gpu) {
    let room = Room::new(0.05);
    let photons = room.photons(60_000, 0, &mut Random(5));
    let mut points = room.points(96, 96);
    points[77].normal = INVALID_POINT;
    let shape = GridShape::new(room.bounds(), room.area(), photons.len() as u32, 1, 50);
    let mut setup = Setup::new(&photons, &points, shape, 50);
    (setup.exact_counts, setup.shows_cells) = (false, true);
    let wrong = |cells: &[ShownCell]| -> usize {
        let decided = |cell: &ShownCell| matches!(cell.class, Class::Lit | Class::Shadowed);
        let candidates = points.iter().zip(cells).step_by(5).filter(|(_, cell)| decided(cell));
        let is_wrong = |(point, cell): &(&Point, &ShownCell)| {
            let found = nearest_kinds(&photons, point, 0, 50, shape.reach().into(), true);
            // Rounding decides the others.
            found.is_some_and(|kinds| {
                kinds.is_none_or(|(n_i, n_s)| (n_i == 0) == (cell.class == Class::Lit) || n_s * n_i > 0)
            })
        };
        candidates.filter(is_wrong).count()
    };
    let cells = setup.run(gpu).cells;
    assert_eq!(wrong(&cells), 0);
    assert_eq!((cells[77].class, cells[77].kind), (Class::Dark, CellKind::None));
    let count = |class| cells.iter().filter(|cell| cell.class == class).count();
    // The shadow is small: 9,216 points see the room.
    let counts = [Class::Lit, Class::Shadowed, Class::Boundary].map(count);
    // A guard: each class occurs.
    assert!(counts.iter().all(|count| *count > 5), "{counts:?}");
    assert!(cells.iter().any(|cell| cell.kind == CellKind::Requested), "no cell was requested");
    let mut hashes = HashMap::new();
    for (point, cell) in points.iter().zip(&cells).filter(|(_, cell)| cell.kind != CellKind::None) {
        let units = (Vec3::from(point.position) - Vec3::from(shape.origin)) * shape.inverse_cell;
        // A point at a face may be in either cell.
        // A side has at most 161 cells (2^22 in all): a coordinate is rounded by 161 * 6e-8 = 1e-5 of a cell.
        if (units - units.round()).abs().min_element() > 1e-3 {
            let known = *hashes.entry(units.floor().as_ivec3()).or_insert(cell.hash);
            assert_eq!((known, cell.level), (cell.hash, 0), "{point:?}");
        }
    }
    let distinct: HashSet<u32> = hashes.values().copied().collect();
    assert!(distinct.len() == hashes.len() && distinct.len() > 100, "{} of {} cells", distinct.len(), hashes.len());
    let fewer: Vec<Photon> = photons.iter().filter(|photon| photon.word >> 31 == 0).copied().collect();
    setup.photons = &fewer;
    assert!(wrong(&setup.run(gpu).cells) > 0, "missing photons are not found");
}

/// Boundaries are dilated by one pixel on the same surface; counters and queues agree with the words, and the audited
/// share is as set. The queue of audits may keep candidates of which dilation made boundaries.
#[kernel_test("PENUMBRA_DEVICE")]
fn queues_hold_what_the_classes_say(gpu: &Gpu) {
    let room = Room::new(0.05);
    let photons = room.photons(20_000, 0, &mut Random(6));
    let (width, height) = (150, 100);
    let mut points = room.points(width, height);
    points[77].normal = INVALID_POINT;
    let shape = GridShape::new(room.bounds(), room.area(), photons.len() as u32, 1, 50);
    let mut setup = Setup::new(&photons, &points, shape, 50);
    let undilated = setup.run(gpu).words;
    setup.tile = Tile { width, height, columns: width, rows: height, ..setup.tile };
    setup.chunk.audits = AuditProbabilities::of(0.25);
    for dilate in [0, 1] {
        setup.chunk.dilate = dilate;
        let outcome = setup.run(gpu);
        let traced = |word: u32| matches!(Classified::new(word).class, Class::Boundary | Class::Unknown);
        for candidate in 0..points.len() as i32 {
            let word = undilated[candidate as usize];
            let (x, y) = (candidate % width as i32, candidate / width as i32);
            let near = (-1..=1).flat_map(|dy| (-1..=1).map(move |dx| (x + dx, y + dy)));
            let mut inside = near.filter(|(x, y)| (0..width as i32).contains(x) && (0..height as i32).contains(y));
            let widened = dilate == 1
                && matches!(Classified::new(word).class, Class::Lit | Class::Shadowed)
                && inside.any(|(x, y)| {
                    let other = (x + y * width as i32) as usize;
                    // In the room one surface is one plane: the same normal, and no offset along it.
                    let (a, b) = (&points[candidate as usize], &points[other]);
                    let n = point_normal(a.normal).as_vec3();
                    let offset = (Vec3::from(b.position) - Vec3::from(a.position)).dot(n);
                    // Coordinates have roundings of 6e-8; the next plane with that normal is 0.35 away.
                    traced(undilated[other]) && a.normal == b.normal && offset.abs() < 1e-3
                });
            let expected = if widened { (word & !7) | Class::Boundary as u32 } else { word };
            assert_eq!(outcome.words[candidate as usize], expected, "pixel {x}, {y}, dilation {dilate}");
        }
        let mut classes = [0; 5];
        let valid = |candidate: usize| points[candidate].normal != INVALID_POINT;
        for candidate in (0..points.len()).filter(|s| valid(*s)) {
            classes[Classified::new(outcome.words[candidate]).class as usize] += 1;
        }
        let first = Counter::Dark as usize;
        assert_eq!(outcome.counters[first..first + 5], classes);
        let mut queue = outcome.boundary_queue.clone();
        queue.sort_unstable();
        let expected = (0..points.len()).filter(|s| valid(*s) && traced(outcome.words[*s]));
        assert!(queue.iter().map(|s| *s as usize).eq(expected));
        assert_eq!(outcome.arguments[4..7], [(queue.len() as u32).div_ceil(128), 1, 1]);
        assert_eq!(outcome.arguments[8..11], [(outcome.audit_queue.len() as u32).div_ceil(128), 1, 1]);
        let certain =
            |s: &u32| matches!(Classified::new(outcome.words[*s as usize]).class, Class::Lit | Class::Shadowed);
        let audited = outcome.audit_queue.iter().filter(|s| certain(s)).count();
        assert!(dilate == 1 || audited == outcome.audit_queue.len());
        assert_eq!(outcome.counters[Counter::Audited as usize] as usize, audited);
        // Near boundaries audits are sixteen times as frequent: all of those here. Of the others a quarter, within five
        // standard deviations of a binomial.
        let is_near = |word: u32| !matches!(word >> 21, 0 | 2047);
        let decided = (0..points.len() as u32).filter(|s| valid(*s as usize) && certain(s));
        let near = decided.filter(|s| is_near(outcome.words[*s as usize])).count();
        assert_eq!(outcome.counters[Counter::Near as usize] as usize, near);
        assert_eq!(outcome.counters[Counter::NearAudited as usize] as usize, near);
        assert!(near > 20, "{near} near boundaries: no test");
        let n = f64::from(classes[1] + classes[2]) - near as f64;
        let deviation = (audited - near) as f64 - 0.25 * n;
        assert!(deviation.abs() < 5.0 * (n * 0.25 * 0.75).sqrt(), "{deviation} of {n}");
    }
}

/// Candidates are classified and queued once each, whatever number of them the invocations and workgroups divide.
#[kernel_test("PENUMBRA_DEVICE")]
fn every_number_of_candidates_is_queued(gpu: &Gpu) {
    let room = Room::new(0.05);
    let photons = room.photons(20_000, 0, &mut Random(6));
    let points = room.points(50, 50);
    let shape = GridShape::new(room.bounds(), room.area(), photons.len() as u32, 1, 50);
    let all = Setup::new(&photons, &points, shape, 50).run(gpu).words;
    let group = 64 * CLASSIFY_CANDIDATES as usize;
    let each = CLASSIFY_CANDIDATES as usize;
    for count in [1, each - 1, each, each + 1, group - 1, group, group + 1] {
        let mut setup = Setup::new(&photons, &points[..count], shape, 50);
        setup.chunk.audits = AuditProbabilities::of(1.0);
        let outcome = setup.run(gpu);
        assert_eq!(outcome.words, all[..count], "{count} candidates");
        let in_class = |classes: [Class; 2]| {
            let all = outcome.words.iter().enumerate();
            let of_class = all.filter(move |(_, word)| classes.contains(&Classified::new(**word).class));
            of_class.map(|(candidate, _)| candidate as u32).collect::<Vec<_>>()
        };
        let sorted = |queue: &[u32]| {
            let mut queue = queue.to_vec();
            queue.sort_unstable();
            queue
        };
        assert_eq!(sorted(&outcome.boundary_queue), in_class([Class::Boundary, Class::Unknown]), "{count} candidates");
        assert_eq!(sorted(&outcome.audit_queue), in_class([Class::Lit, Class::Shadowed]), "{count} candidates");
        let both = !outcome.boundary_queue.is_empty() && !outcome.audit_queue.is_empty();
        assert!(both || count < group - 1, "an empty queue is no test");
    }
}

/// Where some pixels get samples, boundaries are dilated to those of their neighbours that do, in the same sample.
#[kernel_test("PENUMBRA_DEVICE")]
fn dilation_finds_the_neighbours_that_get_samples(gpu: &Gpu) {
    const SAMPLES: u32 = 2;
    let room = Room::new(0.05);
    let photons = room.photons(20_000, 0, &mut Random(6));
    let (width, height) = (150u32, 100u32);
    let points = room.points(width, height);
    let shape = GridShape::new(room.bounds(), room.area(), photons.len() as u32, 1, 50);
    let undilated = Setup::new(&photons, &points, shape, 50).run(gpu).words;
    // Two thirds of the pixels, the last one first. The second sample of a pixel lies where the next pixel's does.
    let index_of = |pixel: u32, sample: u32| (pixel + sample) as usize % points.len();
    let list: Vec<u32> = (0..width * height).rev().filter(|pixel| !(pixel * 7 / 3).is_multiple_of(3)).collect();
    let samples: Vec<(u32, u32)> =
        list.iter().flat_map(|pixel| (0..SAMPLES).map(move |sample| (*pixel, sample))).collect();
    let listed: Vec<Point> = samples.iter().map(|(pixel, sample)| points[index_of(*pixel, *sample)]).collect();
    let mut setup = Setup::new(&photons, &listed, shape, 50);
    let pixel_count = list.len() as u32;
    let of_image = Tile { width, height, columns: width, rows: height, ..setup.tile };
    setup.tile = Tile { pixel_count, samples_per_pixel: SAMPLES, ..of_image };
    setup.listed = Some(list.clone());
    setup.chunk.dilate = 1;
    let traced = |word: u32| matches!(Classified::new(word).class, Class::Boundary | Class::Unknown);
    let is_listed: HashSet<u32> = list.iter().copied().collect();
    let expected: Vec<u32> = samples
        .iter()
        .map(|&(pixel, sample)| {
            let word = undilated[index_of(pixel, sample)];
            let (x, y) = ((pixel % width) as i32, (pixel / width) as i32);
            let near = (-1..=1).flat_map(|dy| (-1..=1).map(move |dx| (x + dx, y + dy)));
            let mut inside = near.filter(|(x, y)| (0..width as i32).contains(x) && (0..height as i32).contains(y));
            let widened = matches!(Classified::new(word).class, Class::Lit | Class::Shadowed)
                && inside.any(|(x, y)| {
                    let other = (x + y * width as i32) as u32;
                    is_listed.contains(&other) && {
                        let (a, b) = (&points[index_of(pixel, sample)], &points[index_of(other, sample)]);
                        let n = point_normal(a.normal).as_vec3();
                        let offset = (Vec3::from(b.position) - Vec3::from(a.position)).dot(n);
                        // As above: roundings of 6e-8, and the next such plane is 0.35 away.
                        traced(undilated[index_of(other, sample)]) && a.normal == b.normal && offset.abs() < 1e-3
                    }
                });
            if widened { (word & !7) | Class::Boundary as u32 } else { word }
        })
        .collect();
    let found = setup.run(gpu).words;
    assert!(found == expected, "{} differ", found.iter().zip(&expected).filter(|(a, b)| a != b).count());
    // With the list of other pixels, neighbours are others.
    setup.listed = Some((0..pixel_count).collect());
    assert!(setup.run(gpu).words != expected, "the list does not matter");
}

/// If visibility is estimated from the photons, boundaries trace no shadow rays: only points without photons do.
#[kernel_test("PENUMBRA_DEVICE")]
fn the_estimate_traces_only_where_there_are_no_photons(gpu: &Gpu) {
    let room = Room::new(0.05);
    let mut photons = room.photons(20_000, 0, &mut Random(8));
    // A part of the room that no photon reaches.
    photons.retain(|photon| photon.position[0] < 0.3);
    let points = room.points(150, 100);
    let shape = GridShape::new(room.bounds(), room.area(), photons.len() as u32, 1, 50);
    let mut setup = Setup::new(&photons, &points, shape, 50);
    let every = setup.run(gpu);
    setup.visibility_estimate = true;
    let outcome = setup.run(gpu);
    assert!(outcome.words == every.words, "the classes are others");
    assert_eq!(outcome.counters, every.counters);
    let traced = |word: u32| {
        let found = Classified::new(word);
        found.class == Class::Unknown && found.n_i + found.n_s == 0
    };
    let mut queue = outcome.boundary_queue;
    queue.sort_unstable();
    let expected: Vec<u32> =
        (0..points.len() as u32).filter(|candidate| traced(outcome.words[*candidate as usize])).collect();
    assert!(expected.len() > 100 && every.boundary_queue.len() > expected.len() + 100, "nothing to tell apart");
    assert_eq!(queue, expected);
    assert_eq!(outcome.arguments[4..7], [(queue.len() as u32).div_ceil(128), 1, 1]);
}
