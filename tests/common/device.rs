//! The device that tests run on.

use std::sync::OnceLock;

use penumbra::gpu::Gpu;

/// The device of the tests: lavapipe, unless `PENUMBRA_DEVICE` names another. Panics if there is none, so tests fail
/// rather than skip.
pub fn gpu() -> &'static Gpu {
    static GPU: OnceLock<Gpu> = OnceLock::new();
    GPU.get_or_init(|| {
        let choice = std::env::var("PENUMBRA_DEVICE").unwrap_or_else(|_| "software".to_owned());
        let gpu = Gpu::open(&choice.parse().unwrap()).unwrap_or_else(|e| panic!("{e}"));
        println!("device: {} ({}, {})", gpu.info.name, gpu.info.kind, gpu.info.driver);
        gpu
    })
}
