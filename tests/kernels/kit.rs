//! Code that kernel tests share: the device, its features, and kernels with Penumbra's structs.

use kernel_kit::{Bindings, Composed, Declared, Gpu, Host, Kernel, KernelTable, Resources, TableFormat};
use penumbra::internal::passes::SHARED;
use penumbra::internal::specialisation;
use penumbra::internal::specialisation::features::{Feature, Features};

/// The features that the device adds, and light tags, which work for one light as well as for several.
pub fn device_features(gpu: &Gpu) -> Features {
    specialisation::device_features(gpu, Features::default()).with(Feature::LightTags, true)
}

/// Compiles a kernel that keeps its data in Penumbra's structs and must have the variables `required`.
pub fn new_kernel(
    gpu: &Gpu,
    composed: &Composed,
    constants: &[(&str, f64)],
    required: &'static [&'static str],
) -> Result<Kernel, kernel_kit::Error> {
    let own = &[Declared { required, optional: &[] }];
    // Surfaces of these tests are Lambertian and flat: albedo and normal alone.
    let opaque = &[("VisibleSurface", size_of::<[f32; 4]>())];
    Kernel::new(gpu, composed, &Host { constants, shared: SHARED, opaque, own, common: None, late: &[] })
}

/// Runs an entry point of a test kernel. Returns its `results`: `per_item` vectors for each of `count` items, all of
/// which must be finite. `inputs` are its other bindings.
pub fn results(
    gpu: &Gpu,
    kernel: &Kernel,
    entry: &str,
    inputs: &[&dyn Bindings],
    count: usize,
    per_item: usize,
) -> Vec<[f32; 4]> {
    let results = gpu.poisoned::<[f32; 4]>("test/results", count * per_item).unwrap();
    let own = Resources::new().with("results", &results);
    let sets: Vec<&dyn Bindings> = inputs.iter().copied().chain([&own as &dyn Bindings]).collect();
    let bound = kernel.bind(gpu, entry, &sets).unwrap();
    let mut frame = gpu.frame("test");
    frame.run(&bound, count as u32, &[0u32; 0]);
    frame.submit().unwrap();
    let got = gpu.read::<[f32; 4]>(&results, count * per_item).unwrap();
    assert!(got.iter().flatten().all(|v| v.is_finite()), "poison or worse in the results of {entry}");
    got
}

/// A table of records, as if a kernel had written and published them.
pub fn published<T: bytemuck::Pod>(gpu: &Gpu, label: &str, records: &[T]) -> KernelTable {
    let table = gpu.table_of(gpu.upload(label, records).unwrap(), TableFormat::Uint).unwrap();
    let mut frame = gpu.frame("test");
    frame.publish(&table, (size_of_val(records) / 16) as u32);
    frame.submit().unwrap();
    table
}
