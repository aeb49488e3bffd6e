//! The device that the kernel tests run on, and the kit itself: poison, layouts, bindings.

use std::time::Instant;

use penumbra::internal::gpu::buffer::{POISON, TableFormat};
use penumbra::internal::gpu::{DeviceChoice, Features, Gpu, Kernel, Resources, compose};

pub use crate::device::gpu;

/// What the device adds to a kernel's features; and light tags, which serve one light as well as several.
pub fn device_features(gpu: &Gpu) -> Features {
    Features::default()
        .with("texture_loads", gpu.texture_loads)
        .with("interleave", gpu.texture_loads)
        .with("light_tags", true)
}

const SQUARES: &str = "
import package::lib::dispatch::group_index;
override factor: u32;
@group(0) @binding(0) var<storage, read> numbers: array<u32>;
@group(0) @binding(1) var<storage, read_write> squares: array<u32>;
@compute @workgroup_size(64)
fn square(@builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u, @builtin(local_invocation_index) lane: u32) {
    let i = group_index(group, groups) * 64u + lane;
    if i < arrayLength(&numbers) { squares[i] = numbers[i] * numbers[i] * factor; }
}";

/// Every item is worked on once, at the edges of the workgroup and past 65,535 groups; words past the end stay
/// as they were.
#[test]
fn dispatches_cover_every_item_once() {
    let gpu = gpu();
    let composed = compose::compose_source("squares", SQUARES, &device_features(gpu)).unwrap();
    let kernel = Kernel::new(gpu, &composed, &[("factor", 3.0)], &["numbers", "squares"]).unwrap();
    for count in [4usize, 63, 64, 65, 4_194_304 + 65] {
        let numbers: Vec<u32> = (0..count as u32).collect();
        let input = gpu.upload("test/numbers", &numbers).unwrap();
        let output = gpu.poisoned::<u32>("test/squares", count + 7).unwrap();
        let sets = Resources::new().with("numbers", &input).with("squares", &output);
        let bound = kernel.bind(gpu, "square", &[&sets]).unwrap();
        let mut frame = gpu.frame("test");
        frame.run(&bound, count as u32, &[0u32; 0]);
        frame.submit().unwrap();
        let got: Vec<u32> = gpu.read(&output, count + 7).unwrap();
        let expected = numbers.iter().map(|n| n.wrapping_mul(*n).wrapping_mul(3)).chain([POISON; 7]);
        assert!(got.iter().copied().eq(expected), "{count} items");
    }
}

const SUMS: &str = "
import package::lib::dispatch::group_index;
@if(texture_loads) @group(0) @binding(0) var table: texture_storage_2d<rgba32uint, read>;
@if(!texture_loads) @group(0) @binding(0) var<storage, read> table: array<vec4u>;
@group(0) @binding(1) var<storage, read_write> sums: array<u32>;
fn word(i: u32) -> u32 {
    @if(texture_loads) { return textureLoad(table, vec2u(i, 0u)).x; }
    @if(!texture_loads) { return table[i].x; }
}
@compute @workgroup_size(64)
fn sum(@builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u, @builtin(local_invocation_index) lane: u32) {
    let i = group_index(group, groups) * 64u + lane;
    var total = 0u;
    for (var j = 0u; j < 100u; j++) { total += word((i + j) & 1023u); }
    sums[i] = total;
}";

/// Kernels that were compiled ahead give what they should, and the device's clock goes on telling how long they take. (Where
/// what stands in for their tables was cleared by the device, every pass seemed to take next to no time.)
#[test]
fn kernels_compiled_ahead_run_and_are_timed() {
    let gpu = Gpu::open(&DeviceChoice::Name(gpu().info.name.clone())).unwrap();
    let composed = compose::compose_source("sums", SUMS, &device_features(&gpu)).unwrap();
    let kernel = Kernel::new(&gpu, &composed, &[], &["sums"]).unwrap();
    gpu.compile_ahead(&Resources::new()).unwrap();
    let records: Vec<[u32; 4]> = (0..1024).map(|i| [i, 0, 0, 0]).collect();
    let table = gpu.table("test/table", &records, TableFormat::Uint).unwrap();
    let count = 1 << 19;
    let sums = gpu.poisoned::<u32>("test/sums", count).unwrap();
    let sets = Resources::new().with("table", &table).with("sums", &sums);
    let bound = kernel.bind(&gpu, "sum", &[&sets]).unwrap();
    let start = Instant::now();
    let mut frame = gpu.frame("test");
    frame.run(&bound, count as u32, &[0u32; 0]);
    frame.submit().unwrap();
    gpu.wait("test").unwrap();
    let passed = start.elapsed().as_secs_f64();
    if gpu.info.timestamps {
        let told = gpu.pass_times().unwrap()["sums/sum"];
        // Recording and waiting take less than a millisecond of the tens that the pass takes.
        assert!(told > 0.25 * passed && told <= passed, "{told} s of {passed} s");
    }
    let got: Vec<u32> = gpu.read(&sums, count).unwrap();
    let wrong =
        got.iter().enumerate().position(|(i, got)| *got != (0..100).map(|j| (i as u32 + j) & 1023).sum::<u32>());
    assert_eq!(wrong, None);
}

/// A forgotten binding, a misspelt override and a binding that the kernel lacks are named, not ignored.
#[test]
fn wrong_bindings_are_named() {
    let gpu = gpu();
    let composed = compose::compose_source("squares", SQUARES, &device_features(gpu)).unwrap();
    let error = |r: penumbra::Result<Kernel>| r.err().expect("must fail").to_string();
    assert!(error(Kernel::new(gpu, &composed, &[("faktor", 1.0)], &[])).contains("'faktor'"));
    assert!(error(Kernel::new(gpu, &composed, &[("factor", 1.0)], &["cubes"])).contains("'cubes'"));
    let kernel = Kernel::new(gpu, &composed, &[("factor", 1.0)], &[]).unwrap();
    let input = gpu.upload("test/numbers", &[1u32]).unwrap();
    let problem = kernel.bind(gpu, "square", &[&Resources::new().with("numbers", &input)]).err().unwrap().to_string();
    assert!(problem.contains("squares/square") && problem.contains("'squares'"), "{problem}");
}

/// A struct whose members differ from the host's fails by name, also when the sizes agree.
#[test]
fn swapped_members_are_found() {
    penumbra::shared_struct! { struct Pair { first: f32, second: u32 } }
    let source = |members: &str| {
        format!(
            "struct Pair {{ {members} }} @group(0) @binding(0) var<storage, read_write> pairs: array<Pair>;
             @compute @workgroup_size(1) fn touch() {{ pairs[0].second = pairs[0].second; }}"
        )
    };
    let check = |members: &str| {
        let composed = compose::compose_source("pairs", &source(members), &Features::default()).unwrap();
        penumbra::internal::gpu::layout::check_against(&composed, &[&Pair::SHARED])
    };
    check("first: f32, second: u32").unwrap();
    let problem = check("second: u32, first: f32").unwrap_err().to_string();
    assert!(problem.contains("struct Pair: member 0"), "{problem}");
    assert!(check("first: f32, second: u32, third: u32").is_err());
}

/// An `@if` on a feature that does not exist fails: a misspelt feature would silently leave code out.
#[test]
fn unknown_features_fail_to_compose() {
    let source = "@compute @workgroup_size(1) fn nothing() { @if(texture_lods) { return; } }";
    assert!(compose::compose_source("typo", source, &Features::default()).is_err());
}
