//! Dispatches that take long are sliced where a watchdog may reset the device, and the slices are the whole.

use kernel_kit::{
    BoundKernel, Buffer, Composer, DeviceLimits, Features, Gpu, Host, Kernel, MAX_GROUPS, Resources, compare,
    dispatch_size, kernel_test,
};

use crate::devices::same_device;

/// Counts the runs of each item.
const COUNT: &str = "
import package::kit::group_index;
@group(0) @binding(0) var<storage, read_write> runs: array<atomic<u32>>;
var<immediate> items: u32;
@compute @workgroup_size(64)
fn count(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = group_index(group, groups) * 64u + lane;
    if i < items { atomicAdd(&runs[i], 1u); }
}";

/// Each of `items` items, with one that none is dispatched for, runs once in a dispatch whose size the host knows, and
/// once in one whose size is in a buffer.
fn run_twice(gpu: &Gpu, bound: &BoundKernel, runs: &Buffer, items: u32) -> Result<(), compare::Mismatch> {
    let [x, y, z] = dispatch_size(items.div_ceil(64));
    let arguments = gpu.upload("test/arguments", &[7, 7, 7, x, y, z]).unwrap();
    let mut frame = gpu.frame("test");
    frame.clear(runs);
    frame.run(bound, items, &items);
    frame.run_indirect(bound, &arguments, 12, &items);
    frame.submit().unwrap();
    let got: Vec<u32> = gpu.read(runs, items as usize + 1).unwrap();
    let expected: Vec<u32> = (0..=items).map(|item| if item < items { 2 } else { 0 }).collect();
    compare::exact(&got, &expected, |i| format!("item {i} of {items}"))
}

/// Dispatches of unknown and of slow passes are sliced, those of fast ones are not; either way each item runs once.
#[kernel_test]
fn slices_are_the_whole(_: &Gpu) {
    let gpu = Gpu::open_with(&same_device(), DeviceLimits::Least).unwrap();
    let composed = Composer::new().compose_source("count", COUNT, &Features::none()).unwrap();
    let kernel = Kernel::new(&gpu, &composed, &Host::default()).unwrap();
    gpu.compile_ahead(&Resources::new()).unwrap();
    let most = MAX_GROUPS * 64 + 65;
    let runs = gpu.buffer::<u32>("test/runs", most as usize + 1).unwrap();
    let bound = kernel.bind(&gpu, "count", &[&Resources::new().with("runs", &runs)]).unwrap();
    let run_all = || {
        for items in [0, 1, 64, 65, 100_000, most] {
            run_twice(&gpu, &bound, &runs, items).unwrap();
        }
    };
    // As if no time passed.
    gpu.pretend_slower(0.0);
    run_twice(&gpu, &bound, &runs, 100_000).unwrap();
    // 1563 workgroups are sliced by 256; a dispatch whose size the host does not know is sliced into sixteen.
    assert_eq!(gpu.slices(), 7 + 16, "unknown passes");
    run_all();
    assert_eq!(gpu.slices(), 7 + 16, "fast passes");
    // As if each dispatch took minutes.
    gpu.pretend_slower(1e5);
    run_twice(&gpu, &bound, &runs, 1000).unwrap();
    let before = gpu.slices();
    for items in [0, 1, 64, 65, 1000] {
        run_twice(&gpu, &bound, &runs, items).unwrap();
    }
    // Of the last one, 16 workgroups one by one.
    assert!(gpu.slices() >= before + 16 + 64, "slow passes: {} slices, then {}", before, gpu.slices());
    // A kernel that does not use `group_index` is not sliced: it would run once for each slice.
    let whole = COUNT.replace("group_index(group, groups)", "(group.x + group.y * groups.x)");
    let composed = Composer::new().compose_source("whole", &whole, &Features::none()).unwrap();
    let kernel = Kernel::new(&gpu, &composed, &Host::default()).unwrap();
    let bound = kernel.bind(&gpu, "count", &[&Resources::new().with("runs", &runs)]).unwrap();
    let before = gpu.slices();
    run_twice(&gpu, &bound, &runs, 100_000).unwrap();
    assert_eq!(gpu.slices(), before);
    // One that counts from the beginning of a slice misses all others.
    let lost = COUNT.replace("group_index(group, groups)", "(group_index(group, groups) % 16u)");
    let composed = Composer::new().compose_source("lost", &lost, &Features::none()).unwrap();
    let kernel = Kernel::new(&gpu, &composed, &Host::default()).unwrap();
    let bound = kernel.bind(&gpu, "count", &[&Resources::new().with("runs", &runs)]).unwrap();
    compare::must_catch("the place in the slice", run_twice(&gpu, &bound, &runs, 100_000));
}

/// Sums of six tables, one read at a place that another tells.
const SUMS: &str = "
@group(0) @binding(5) var a: texture_storage_2d<rgba32uint, read>;
@group(0) @binding(4) var b: texture_storage_2d<rgba32uint, read>;
@group(0) @binding(2) var c: texture_storage_2d<rgba32uint, read>;
@group(0) @binding(3) var d: texture_storage_2d<rgba32float, read>;
@group(0) @binding(0) var e: texture_storage_2d<rgba32float, read>;
@group(0) @binding(1) var f: texture_storage_2d<rgba32float, read>;
@group(0) @binding(6) var<storage, read_write> sums: array<vec4f>;
@compute @workgroup_size(64)
fn sum(@builtin(global_invocation_id) id: vec3u) {
    let at = vec2u(id.x, 0u);
    let elsewhere = vec4f(textureLoad(b, vec2u(textureLoad(a, at).x, 0u)));
    sums[id.x] = vec4f(textureLoad(c, at)) + elsewhere + textureLoad(d, at) + textureLoad(e, at) + textureLoad(f, at);
}";

/// A kernel with more tables than the device has storage textures reads them as sampled ones.
#[kernel_test]
fn kernels_sample_where_storage_textures_are_few(_: &Gpu) {
    let gpu = Gpu::open_with(&same_device(), DeviceLimits::Least).unwrap();
    assert!(gpu.texture_loads);
    let composed = Composer::new().compose_source("sums", SUMS, &Features::none()).unwrap();
    assert_eq!(composed.taken()[0].storage_textures, 6);
    let kernel = Kernel::new(&gpu, &composed, &Host::default()).unwrap();
    gpu.compile_ahead(&Resources::new()).unwrap();
    let mirrored: Vec<[u32; 4]> = (0..64).map(|i| [63 - i, 0, 0, 0]).collect();
    let counted: Vec<[u32; 4]> = (0..64).map(|i| [i, 2 * i, 3 * i, 100]).collect();
    let halves: Vec<[f32; 4]> = (0..64).map(|i| [0.5 * i as f32, 0.0, 1.0, 0.25]).collect();
    let uint = |records: &[[u32; 4]]| gpu.table("test/table", records, kernel_kit::TableFormat::Uint).unwrap();
    let float = |records: &[[f32; 4]]| gpu.table("test/table", records, kernel_kit::TableFormat::Float).unwrap();
    let (a, b, c) = (uint(&mirrored), uint(&counted), uint(&counted));
    let (d, e, f) = (float(&halves), float(&halves), float(&halves));
    let sums = gpu.poisoned::<[f32; 4]>("test/sums", 64).unwrap();
    let tables = Resources::new().with("a", &a).with("b", &b).with("c", &c).with("d", &d).with("e", &e).with("f", &f);
    let bound = kernel.bind(&gpu, "sum", &[&tables.with("sums", &sums)]).unwrap();
    gpu.run(&bound, 64, &()).unwrap();
    let got: Vec<[f32; 4]> = gpu.read(&sums, 64).unwrap();
    for (i, got) in (0..64u32).zip(got) {
        let (here, there) = (i as f32, (63 - i) as f32);
        let expected = [there + here + 1.5 * here, 2.0 * (there + here), 3.0 * (there + here) + 3.0, 200.75];
        assert_eq!(got, expected, "record {i}");
    }
}
