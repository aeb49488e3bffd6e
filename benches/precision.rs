//! Rounding errors of the kernels' f32 arithmetic against double precision, and the device time of the closed form of a
//! polygonal light.
//!
//! Run it with `cargo bench --bench precision`; the variable `PENUMBRA_DEVICE` names another device than the software
//! one.
//!
//! It prints the table of `docs/stability.md`: for each kernel and family of input the median, the 99.9 % quantile and
//! the largest error, and the bound that the tests hold it to, all in ulp of the named scale. Then it prints
//! nanoseconds for each point for the closed form of two lights.

use glam::DVec3;
use kernel_kit::Gpu;

#[allow(dead_code, unused_imports)]
#[path = "../tests/kernels/cache.rs"]
mod cache;
#[path = "../tests/common/device.rs"]
mod device;
#[allow(dead_code, unused_imports)]
#[path = "../tests/kernels/flux.rs"]
mod flux;
#[allow(dead_code, unused_imports)]
#[path = "../tests/kernels/irradiance.rs"]
mod irradiance;
#[allow(dead_code, unused_imports)]
#[path = "../tests/kernels/kit.rs"]
mod kit;
#[allow(dead_code, unused_imports)]
#[path = "../tests/kernels/light.rs"]
mod light;
#[allow(dead_code, unused_imports)]
#[path = "../tests/common/meshes.rs"]
mod meshes;
#[allow(dead_code)]
#[path = "../tests/common/octahedral.rs"]
mod octahedral;
#[allow(dead_code, unused_imports)]
#[path = "../tests/kernels/path.rs"]
mod path;
#[path = "../tests/kernels/precision.rs"]
mod precision;
#[allow(dead_code)]
#[path = "../tests/common/random.rs"]
mod random;
#[allow(dead_code, unused_imports)]
#[path = "../tests/kernels/rooms.rs"]
mod rooms;
#[allow(dead_code, unused_imports)]
#[path = "../tests/kernels/stage.rs"]
mod stage;
#[allow(dead_code, unused_imports)]
#[path = "../tests/kernels/statistics.rs"]
mod statistics;

use random::{Random, RandomInput as _};

/// Median device time of the closed form, in nanoseconds for each point, for a square light of side `size` at a
/// distance of about 1.
fn closed_form_time(gpu: &Gpu, size: f64) -> f64 {
    const POINTS: usize = 1 << 18;
    const RUNS: usize = 9;
    let light = meshes::square(DVec3::Y, DVec3::X * 0.5 * size, DVec3::Z * 0.5 * size);
    let scene = light::scene(&[(light, false)], &[]);
    let mut random = Random(3);
    let points: Vec<_> =
        (0..POINTS).map(|_| light::Place::new(random.point() * 0.5 - 0.2 * DVec3::Y, random.direction(), 0)).collect();
    let spent = || gpu.pass_times().unwrap().values().sum::<f64>();
    let mut times: Vec<f64> = (0..=RUNS)
        .map(|_| {
            let before = spent();
            light::run(gpu, &scene, "closed", &points, POINTS, 1, 0);
            spent() - before
        })
        .skip(1)
        .collect();
    times.sort_by(f64::total_cmp);
    times[RUNS / 2] / POINTS as f64 * 1e9
}

fn main() {
    let gpu = device::gpu();
    let fused = if precision::fma_is_fused(gpu) { "fused" } else { "a rounded product and a rounded sum" };
    println!("fma on this device: {fused}\n");
    println!("| kernel | input | errors relative to | median | 99.9 % | largest | bound |");
    println!("| --- | --- | --- | --- | --- | --- | --- |");
    for row in precision::rows(gpu) {
        let [median, high, largest] = [0.5, 0.999, 1.0].map(|share| row.quantile(share));
        let precision::Row { kernel, family, scale, bound, .. } = row;
        println!("| {kernel} | {family} | {scale} | {median:.2} | {high:.2} | {largest:.2} | {bound} |");
    }
    println!();
    for size in [1.0, 1e-3] {
        println!("closed form of a square light of size {size}: {:.0} ns a point", closed_form_time(gpu, size));
    }
}
