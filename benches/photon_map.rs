//! Times of the visibility map's passes in the paper's box: grids of 131,072 and of a million photons, and the
//! classification of a million camera points.
//!
//! Run it with `cargo bench --bench photon_map`; the variable `PENUMBRA_DEVICE` names another device than the software
//! one.
//!
//! It prints milliseconds, medians of [`RUNS`] runs: for each step the wall time of the whole, and below it the device
//! time of each kernel, where the device has timestamps. For each grid it also prints the shares of points by class.

use std::time::Instant;

use kernel_kit::{Gpu, Resources, TableFormat};
use penumbra::internal::kernels::{Class, Classified, GridShape, INVALID_POINT};
use penumbra::internal::passes::classify::{AuditProbabilities, Chunk, Classify, ClassifyBuffers};
use penumbra::internal::passes::grid::Grid;
use penumbra::internal::passes::{Tile, TileBuffers};
use penumbra::internal::specialisation::features::{Feature, Features};

#[allow(dead_code)]
#[path = "../tests/common/octahedral.rs"]
mod octahedral;
#[allow(dead_code)]
#[path = "../tests/kernels/rooms.rs"]
mod rooms;

/// Runs for each time, after one that compiles.
const RUNS: usize = 9;

fn median(mut times: Vec<f64>) -> f64 {
    times.sort_by(f64::total_cmp);
    times[times.len() / 2]
}

/// Runs `work` once to compile, and [`RUNS`] times more; prints the median wall time, and the median device time of
/// each kernel.
fn measure(gpu: &Gpu, name: &str, mut work: impl FnMut()) {
    work();
    let mut walls = Vec::new();
    let mut kernels: std::collections::BTreeMap<String, Vec<f64>> = Default::default();
    for _ in 0..RUNS {
        let before = gpu.pass_times().unwrap();
        let start = Instant::now();
        work();
        gpu.wait(name).unwrap();
        walls.push(start.elapsed().as_secs_f64() * 1e3);
        for (label, seconds) in gpu.pass_times().unwrap() {
            let spent = seconds - before.get(&label).copied().unwrap_or(0.0);
            kernels.entry(label).or_default().push(spent * 1e3);
        }
    }
    println!("{name:<48} {:8.1} ms", median(walls));
    for (label, times) in kernels {
        let time = median(times);
        if time > 0.0 {
            println!("    {label:<44} {time:8.1} ms");
        }
    }
}

fn main() {
    let device = std::env::var("PENUMBRA_DEVICE").unwrap_or_else(|_| "software".to_owned());
    let gpu = &Gpu::open(&device.parse().unwrap()).unwrap_or_else(|e| panic!("{e}"));
    println!("device: {} ({}, {})", gpu.info.name, gpu.info.kind, gpu.info.driver);
    let features = Features::default()
        .with(Feature::TextureLoads, gpu.texture_loads)
        .with(Feature::Interleave, gpu.texture_loads)
        .with(Feature::VisibilityMap, true);
    let k = 50;
    let room = rooms::Room::new(0.2);
    let grid = Grid::new(gpu, &features, k).unwrap();
    let mut random = rooms::Random(1);
    let mut photons = Vec::new();
    while photons.len() < 1_000_000 {
        photons.extend(room.photons(100_000, 0, &mut random));
    }
    photons.truncate(1_000_000);
    let mut points = room.points(1000, 1000);
    // The renderer makes no photon query at dark points.
    let dark: Vec<usize> = (0..points.len()).filter(|i| room.is_dark(&points[*i])).collect();
    dark.iter().for_each(|i| points[*i].normal = INVALID_POINT);
    for count in [131_072, 1_000_000] {
        let photons = gpu.upload("bench/photons", &photons[..count]).unwrap();
        let shape = GridShape::new(room.bounds(), room.area(), count as u32, 1, k);
        println!("{count} photons, cells {:?}", shape.size);
        measure(gpu, &format!("grid of {count} photons"), || {
            grid.build(gpu, &photons, count as u32, 1, shape).unwrap();
        });
        let built = grid.build(gpu, &photons, count as u32, 1, shape).unwrap();
        let mut buffers = TileBuffers::new(gpu, &features, 1_000_000, false).unwrap();
        buffers.points = gpu.table_of(gpu.upload("bench/points", &points).unwrap(), TableFormat::Uint).unwrap();
        let mut frame = gpu.frame("bench");
        frame.publish(&buffers.points, 1_000_000);
        frame.submit().unwrap();
        let candidates = ClassifyBuffers::new(gpu, 1_000_000).unwrap();
        let tile = Tile {
            width: 1000,
            height: 1000,
            columns: 1000,
            pixel_count: 1_000_000,
            samples_per_pixel: 1,
            point_count: 1_000_000,
            ..Tile::default()
        };
        let chunk = Chunk { first_light: 0, lights: 1, dilate: 0, audits: AuditProbabilities::default() };
        for exact_counts in [true, false] {
            let classify = Classify::new(gpu, &features.clone().with(Feature::ExactCounts, exact_counts), k).unwrap();
            let bound = classify.bind(gpu, &buffers, Some(&built), &candidates, &Resources::new()).unwrap();
            let label = format!("a million points, {}", if exact_counts { "exact counts" } else { "cell classes" });
            measure(gpu, &label, || {
                let mut frame = gpu.frame("bench");
                bound.classify(&mut frame, &candidates, &tile, &chunk);
                bound.look_up(&mut frame, &candidates, &tile, &chunk);
                bound.classify_requested_cells(&mut frame);
                bound.query(&mut frame, &candidates, &tile, &chunk);
                frame.submit().unwrap();
            });
        }
        let queued = gpu.read::<u32>(&candidates.queue_lengths, 4).unwrap()[0];
        let words: Vec<u32> = gpu.read(&candidates.classes, points.len()).unwrap();
        let share = |class| words.iter().filter(|w| Classified::new(**w).class == class).count() as f64 / 1e4;
        println!(
            "    searched {:.1} %; dark {:.1} %, lit {:.1} %, shadowed {:.1} %, boundary {:.1} %, unknown {:.1} %",
            f64::from(queued) / 1e4,
            share(Class::Dark),
            share(Class::Lit),
            share(Class::Shadowed),
            share(Class::Boundary),
            share(Class::Unknown)
        );
    }
}
