//! The device that tests run on.

use std::sync::OnceLock;

use penumbra::internal::gpu::Gpu;

/// The device of the tests: lavapipe unless `PENUMBRA_DEVICE` names another. No device is a failure, not a skip.
pub fn gpu() -> &'static Gpu {
    static GPU: OnceLock<Gpu> = OnceLock::new();
    GPU.get_or_init(|| {
        let choice = std::env::var("PENUMBRA_DEVICE").unwrap_or_else(|_| "software".to_owned());
        let gpu = Gpu::open(&choice.parse().unwrap()).unwrap_or_else(|e| panic!("{e}"));
        println!("device: {} ({}, {})", gpu.info.name, gpu.info.kind, gpu.info.driver);
        gpu
    })
}
