//! What the kernels' f32 arithmetic loses against double precision: the table of `docs/stability.md`, and how long the
//! closed form takes.

#[allow(dead_code)]
#[path = "../tests/common/device.rs"]
mod device;
#[allow(dead_code)]
#[path = "../tests/kernels/kit.rs"]
mod kit;
#[allow(dead_code, unused_imports)]
#[path = "../tests/kernels/light.rs"]
mod light;
#[allow(dead_code)]
#[path = "../tests/common/meshes.rs"]
mod meshes;
#[path = "../tests/kernels/precision.rs"]
mod precision;
#[allow(dead_code)]
#[path = "../tests/kernels/statistics.rs"]
mod statistics;

fn main() {
    let fused = if precision::fma_is_fused() { "fused" } else { "a rounded product and a rounded sum" };
    println!("fma on this device: {fused}\n");
    println!("| kernel | input | errors relative to | median | 99.9 % | largest | bound |");
    println!("| --- | --- | --- | --- | --- | --- | --- |");
    for row in precision::rows() {
        let [median, most, largest] = [0.5, 0.999, 1.0].map(|share| row.quantile(share));
        let precision::Row { kernel, family, scale, bound, .. } = row;
        println!("| {kernel} | {family} | {scale} | {median:.2} | {most:.2} | {largest:.2} | {bound} |");
    }
}
