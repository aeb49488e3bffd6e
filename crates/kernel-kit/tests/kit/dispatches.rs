//! Every item is worked on once, kernels compiled ahead run and are timed, and what a kernel forgets shows.

use std::sync::Barrier;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use kernel_kit::{
    Composer, DeviceChoice, Error, Features, Gpu, Host, Kernel, MAX_GROUPS, POISON, Resources, TABLE_LAYER_ROWS,
    TABLE_WIDTH, Table, TableFormat, compare, dispatch_size, kernel_test, whole_rows,
};

use crate::composing::{DeviceFeature, device_features};

/// Squares of numbers times a factor.
pub const SQUARES: &str = "
import package::kit::group_index;
override factor: u32;
@group(0) @binding(0) var<storage, read> numbers: array<u32>;
@group(0) @binding(1) var<storage, read_write> squares: array<u32>;
@compute @workgroup_size(64)
fn square(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = group_index(group, groups) * 64u + lane;
    if i < arrayLength(&numbers) { squares[i] = numbers[i] * numbers[i] * factor; }
}";

fn squares(gpu: &Gpu, kernel: &Kernel, count: usize) -> Result<(), compare::Mismatch> {
    let numbers: Vec<u32> = (0..count as u32).collect();
    let input = gpu.upload("test/numbers", &numbers).unwrap();
    let output = gpu.poisoned::<u32>("test/squares", count + 7).unwrap();
    let sets = Resources::new().with("numbers", &input).with("squares", &output);
    let bound = kernel.bind(gpu, "square", &[&sets]).unwrap();
    gpu.run(&bound, count as u32, &()).unwrap();
    let got: Vec<u32> = gpu.read(&output, count + 7).unwrap();
    let expected: Vec<u32> = numbers.iter().map(|n| n.wrapping_mul(*n).wrapping_mul(3)).chain([POISON; 7]).collect();
    compare::exact(&got, &expected, |i| format!("number {i}"))
}

fn square_kernel(gpu: &Gpu, source: &str) -> Kernel {
    let composed = Composer::new().compose_source("squares", source, &Features::none()).unwrap();
    Kernel::new(gpu, &composed, &Host { constants: &[("factor", 3.0)], ..Host::default() }).unwrap()
}

/// A kernel is made once for each key, if the device keeps kernels, and runs as often as it is wanted.
#[kernel_test]
fn kept_kernels_are_made_once(gpu: &Gpu) {
    let gpu = Gpu::open(&DeviceChoice::Name(gpu.info.name.clone())).unwrap();
    let mut made = 0;
    let mut kernel = |key: &str, source: &str| {
        let make = || {
            made += 1;
            Ok::<_, Error>(square_kernel(&gpu, source))
        };
        let kernel = Kernel::kept(&gpu, key, make).unwrap();
        (kernel, made)
    };
    let other = SQUARES.replace("* factor", "+ factor");
    assert_eq!([1, 2].map(|_| kernel("squares", SQUARES).1), [1, 2], "nothing is kept unless it is wanted");
    gpu.keep_kernels();
    for made in [3, 4] {
        let (right, count) = kernel("squares", SQUARES);
        squares(&gpu, &right, 65).unwrap();
        assert_eq!((right.name.as_str(), count), ("squares", made));
        // The planted fault: another key has another kernel.
        compare::must_catch("source", squares(&gpu, &kernel("other", &other).0, 65));
    }
    assert_eq!(gpu.kept_kernels(), 2);
}

/// Threads that want the same kernel at the same time wait for the one that makes it. If that one fails, the next
/// thread makes it.
#[kernel_test]
fn kept_kernels_are_made_by_one_thread(gpu: &Gpu) {
    let gpu = &Gpu::open(&DeviceChoice::Name(gpu.info.name.clone())).unwrap();
    gpu.keep_kernels();
    let (tried, made) = (AtomicUsize::new(0), AtomicUsize::new(0));
    let wanted = Barrier::new(4);
    let make = || {
        if tried.fetch_add(1, Ordering::SeqCst) == 0 {
            return Err(Error::NoDevice("the first one fails".to_owned()));
        }
        // Long enough for all to want it.
        std::thread::sleep(Duration::from_millis(50));
        made.fetch_add(1, Ordering::SeqCst);
        Ok(square_kernel(gpu, SQUARES))
    };
    let want = || {
        wanted.wait();
        Kernel::kept(gpu, "squares", make)
    };
    let kernels = std::thread::scope(|scope| {
        let threads: Vec<_> = (0..4).map(|_| scope.spawn(want)).collect();
        threads.into_iter().map(|thread| thread.join().unwrap()).collect::<Vec<_>>()
    });
    assert_eq!((tried.into_inner(), made.into_inner()), (2, 1));
    let good: Vec<_> = kernels.iter().flatten().collect();
    assert_eq!((good.len(), gpu.kept_kernels()), (3, 1));
    good.iter().for_each(|kernel| squares(gpu, kernel, 65).unwrap());
}

const PAST_ONE_DIMENSION: usize = MAX_GROUPS as usize * 64 + 65;

/// At the edges of the workgroup and past 65,535 groups, words past the end stay as they were. (An empty buffer has
/// room for four words, which the kernel squares.)
#[kernel_test]
fn dispatches_cover_every_item_once(gpu: &Gpu) {
    let kernel = square_kernel(gpu, SQUARES);
    assert_eq!(kernel.workgroup_size("square"), Some(64));
    for count in [4, 63, 64, 65, PAST_ONE_DIMENSION] {
        squares(gpu, &kernel, count).unwrap_or_else(|mismatch| panic!("{count} items: {mismatch}"));
    }
    let forgetful = square_kernel(gpu, &SQUARES.replace("group_index(group, groups)", "group.x"));
    squares(gpu, &forgetful, 65).unwrap();
    let caught = compare::must_catch("rows of groups", squares(gpu, &forgetful, PAST_ONE_DIMENSION)).to_string();
    assert!(caught.starts_with("65 of 4194312 lanes differ") && caught.contains(&POISON.to_string()), "{caught}");
}

/// A dispatch over no items runs the kernel for none, and one over one item runs it once.
#[kernel_test]
fn dispatches_of_none_and_of_one(gpu: &Gpu) {
    let source = "
        @group(0) @binding(0) var<storage, read_write> runs: array<u32>;
        var<immediate> count: u32;
        @compute @workgroup_size(64)
        fn run(@builtin(global_invocation_id) id: vec3u) { if id.x < count { runs[id.x] = 1u; } }";
    let composed = Composer::new().compose_source("runs", source, &Features::none()).unwrap();
    let kernel = Kernel::new(gpu, &composed, &Host::default()).unwrap();
    for count in [0u32, 1] {
        let runs = gpu.poisoned::<u32>("test/runs", 4).unwrap();
        let bound = kernel.bind(gpu, "run", &[&Resources::new().with("runs", &runs)]).unwrap();
        let mut frame = gpu.frame("test");
        frame.run(&bound, count, &count);
        frame.submit().unwrap();
        let expected: Vec<u32> = (0..4).map(|i| if i < count { 1 } else { POISON }).collect();
        compare::exact(&gpu.read::<u32>(&runs, 4).unwrap(), &expected, |i| format!("{count} items, word {i}")).unwrap();
    }
}

/// Parameters that are shorter than the kernel's are named, not read past their end.
#[should_panic(expected = "kernel runs/run takes 4 bytes of immediates, 0 are given")]
#[kernel_test]
fn missing_immediates_are_named(gpu: &Gpu) {
    let source = "var<immediate> count: u32;
        @group(0) @binding(0) var<storage, read_write> runs: array<u32>;
        @compute @workgroup_size(1) fn run() { runs[0] = count; }";
    let composed = Composer::new().compose_source("runs", source, &Features::none()).unwrap();
    let kernel = Kernel::new(gpu, &composed, &Host::default()).unwrap();
    let runs = gpu.poisoned::<u32>("test/runs", 4).unwrap();
    let bound = kernel.bind(gpu, "run", &[&Resources::new().with("runs", &runs)]).unwrap();
    gpu.frame("test").run(&bound, 1, &());
}

/// Arguments of an indirect dispatch that a kernel writes are those of a direct one, and rows of groups have all items.
#[kernel_test]
fn kernels_write_the_arguments_of_dispatches(gpu: &Gpu) {
    let source = "
        import package::kit::dispatch_groups;
        @group(0) @binding(0) var<storage, read_write> arguments: array<u32>;
        var<immediate> items: u32;
        @compute @workgroup_size(1) fn arrange() {
            let size = dispatch_groups(items, 64u);
            arguments[0] = size.x; arguments[1] = size.y; arguments[2] = size.z;
        }";
    let composed = Composer::new().compose_source("arrange", source, &Features::none()).unwrap();
    let kernel = Kernel::new(gpu, &composed, &Host::default()).unwrap();
    let arguments = gpu.poisoned::<u32>("test/arguments", 3).unwrap();
    let bound = kernel.bind(gpu, "arrange", &[&Resources::new().with("arguments", &arguments)]).unwrap();
    for items in [0u32, 1, 64, 65, MAX_GROUPS * 64, MAX_GROUPS * 64 + 1] {
        let mut frame = gpu.frame("test");
        frame.run(&bound, 1, &items);
        frame.submit().unwrap();
        let [x, y, z] = dispatch_size(items.div_ceil(64));
        // A kernel's dispatch over nothing has no row either.
        let expected = [x, if items == 0 { 0 } else { y }, z];
        compare::exact(&gpu.read::<u32>(&arguments, 3).unwrap(), &expected, |_| format!("{items} items")).unwrap();
    }
    arguments_are_followed(gpu, &bound, &arguments);
}

/// Kernels that were compiled ahead give the right results, and the device's clock still measures their times. (If the
/// device had cleared the dummy textures for their tables, every pass seemed to take almost no time.)
#[kernel_test]
fn kernels_compiled_ahead_run_and_are_timed(gpu: &Gpu) {
    let gpu = Gpu::open(&DeviceChoice::Name(gpu.info.name.clone())).unwrap();
    let composed = Composer::new().compose_source("sums", SUMS, &device_features(&gpu)).unwrap();
    let kernel = Kernel::new(&gpu, &composed, &Host::default()).unwrap();
    gpu.compile_ahead(&Resources::new()).unwrap();
    let records: Vec<[u32; 4]> = (0..1024).map(|i| [i, 0, 0, 0]).collect();
    let table = gpu.table("test/table", &records, TableFormat::Uint).unwrap();
    let count = 1 << 19;
    let sums = gpu.poisoned::<u32>("test/sums", count).unwrap();
    let sets = Resources::new().with("table", &table).with("sums", &sums);
    let bound = kernel.bind(&gpu, "sum", &[&sets]).unwrap();
    let start = Instant::now();
    let mut frame = gpu.frame("test");
    frame.run(&bound, count as u32, &());
    frame.submit().unwrap();
    gpu.wait("test").unwrap();
    let passed = start.elapsed().as_secs_f64();
    if gpu.info.timestamps {
        let told = gpu.pass_times().unwrap()["sums/sum"];
        assert_eq!(gpu.known_pass_times()["sums/sum"], told);
        // Recording and waiting take less than a millisecond of the tens that the pass takes.
        assert!(told > 0.25 * passed && told <= passed, "{told} s of {passed} s");
    }
    let expected: Vec<u32> = (0..count as u32).map(|i| (0..100).map(|j| (i + j) & 1023).sum()).collect();
    compare::exact(&gpu.read::<u32>(&sums, count).unwrap(), &expected, |i| format!("item {i}")).unwrap();
}

/// A table of what a kernel wrote is read back as it was written, past the first row, on devices of both kinds.
#[kernel_test]
fn what_kernels_write_is_read_as_a_table(gpu: &Gpu) {
    let features = device_features(gpu);
    let composed = Composer::new().compose_source("look_up", LOOK_UP, &features).unwrap();
    let kernel = Kernel::new(gpu, &composed, &Host::default()).unwrap();
    let count = TABLE_WIDTH as usize + 3;
    let mut records: Vec<[u32; 4]> = (0..count as u32).map(|i| [i, 2 * i, 3 * i, 4 * i]).collect();
    let expected = records.clone();
    records.resize(whole_rows(count), [POISON; 4]);
    let written = gpu.upload("test/records", &records).unwrap();
    let mut frame = gpu.frame("test");
    let table = gpu.kernel_table(&mut frame, written, TableFormat::Uint).unwrap();
    frame.submit().unwrap();
    assert_eq!(matches!(table, Table::Texture(_)), features.has(DeviceFeature::TextureLoads));
    let copies = gpu.poisoned::<[u32; 4]>("test/copies", count).unwrap();
    let bound =
        kernel.bind(gpu, "look_up", &[&Resources::new().with("table", &table).with("copies", &copies)]).unwrap();
    let mut frame = gpu.frame("test");
    frame.run(&bound, count as u32, &(count as u32));
    frame.submit().unwrap();
    assert_eq!(gpu.read::<[u32; 4]>(&copies, count).unwrap(), expected);
    assert_eq!(gpu.read_from::<[u32; 4]>(&copies, count - 1, 1).unwrap(), expected[count - 1..]);
    assert_eq!(gpu.read::<u32>(&copies, 0).unwrap(), []);
}

/// A table that is larger than what is uploaded at once (1024 rows) has each record in its place.
#[kernel_test]
fn a_large_table_is_uploaded_whole(gpu: &Gpu) {
    let composed = Composer::new().compose_source("look_up", LOOK_UP, &device_features(gpu)).unwrap();
    let kernel = Kernel::new(gpu, &composed, &Host::default()).unwrap();
    let part = 1024 * TABLE_WIDTH;
    for count in [part - 1, part, part + 1, part + TABLE_WIDTH + 5] {
        let records: Vec<[u32; 4]> = (0..count).map(|i| [i + 1, !i, i ^ 0x5555, 7]).collect();
        let table = gpu.table("test/table", &records, TableFormat::Uint).unwrap();
        let copies = gpu.poisoned::<[u32; 4]>("test/copies", count as usize).unwrap();
        let sets = Resources::new().with("table", &table).with("copies", &copies);
        let bound = kernel.bind(gpu, "look_up", &[&sets]).unwrap();
        let mut frame = gpu.frame("test");
        frame.run(&bound, count, &count);
        frame.submit().unwrap();
        let read = gpu.read::<[u32; 4]>(&copies, count as usize).unwrap();
        let wrong = read.iter().zip(&records).position(|(a, b)| a != b);
        assert_eq!(wrong, None, "of {count} records");
        let differs = read.iter().zip(&records[1..]).any(|(a, b)| a != b);
        assert!(differs, "records in other places are not found");
    }
}

/// A table in layers (1024 rows each) has each record in its place.
#[kernel_test]
fn a_table_in_layers_has_each_record_at_its_index(gpu: &Gpu) {
    let composed = Composer::new().compose_source("look_up", LOOK_UP_IN_LAYERS, &device_features(gpu)).unwrap();
    let kernel = Kernel::new(gpu, &composed, &Host::default()).unwrap();
    let layer = TABLE_LAYER_ROWS * TABLE_WIDTH;
    for count in [0, 1, layer, layer + 1, layer + TABLE_WIDTH + 5] {
        let records: Vec<[u32; 4]> = (0..count).map(|i| [i + 1, !i, i ^ 0x5555, 7]).collect();
        let table = gpu.layered_table("test/table", &records, TableFormat::Uint).unwrap();
        let copies = gpu.poisoned::<[u32; 4]>("test/copies", count as usize + 1).unwrap();
        let bound = kernel.bind(gpu, "look_up", &[&Resources::new().with("table", &table).with("copies", &copies)]);
        let mut frame = gpu.frame("test");
        frame.run(&bound.unwrap(), count, &count);
        frame.submit().unwrap();
        let mut read = gpu.read::<[u32; 4]>(&copies, count as usize + 1).unwrap();
        assert_eq!(read.pop(), Some([POISON; 4]), "past {count} records");
        let wrong = read.iter().zip(&records).position(|(a, b)| a != b);
        assert_eq!(wrong, None, "of {count} records");
    }
    // Records of no bytes: only their number counts.
    let most = gpu.device.limits().max_texture_array_layers as usize * layer as usize;
    let too_many = gpu.layered_table("test/table", &vec![[(); 4]; most + 1], TableFormat::Uint).err().unwrap();
    let Error::Buffer { buffer, needed, limit } = &too_many else { panic!("{too_many}") };
    assert!(buffer == "test/table" && needed > limit && *limit == 16 * most as u64, "{too_many}");
}

/// Only the published records of a kernel's table are read anew: the rest of the last row is as it was.
#[kernel_test]
fn as_many_records_as_are_published_are_read(gpu: &Gpu) {
    let features = device_features(gpu);
    let composed = Composer::new().compose_source("look_up", LOOK_UP, &features).unwrap();
    let kernel = Kernel::new(gpu, &composed, &Host::default()).unwrap();
    let width = TABLE_WIDTH as usize;
    for count in [0, 1, width - 1, width, width + 1, 2 * width + 5] {
        let records: Vec<[u32; 4]> = (0..count as u32 + 1).map(|i| [i + 1, 2 * i, 3 * i, 4 * i]).collect();
        let written = gpu.table_of(gpu.upload("test/records", &records).unwrap(), TableFormat::Uint).unwrap();
        let copies = gpu.poisoned::<[u32; 4]>("test/copies", count + 1).unwrap();
        let sets = Resources::new().with("table", &written.table).with("copies", &copies);
        let bound = kernel.bind(gpu, "look_up", &[&sets]).unwrap();
        let mut frame = gpu.frame("test");
        frame.publish(&written, count as u32);
        frame.run(&bound, count as u32 + 1, &(count as u32 + 1));
        frame.submit().unwrap();
        let mut expected = records.clone();
        // A buffer that is the table shows all that is written to it.
        if features.has(DeviceFeature::TextureLoads) {
            expected[count] = [0; 4];
        }
        assert_eq!(gpu.read::<[u32; 4]>(&copies, count + 1).unwrap(), expected, "{count} records");
    }
}

fn arguments_are_followed(gpu: &Gpu, bound: &kernel_kit::BoundKernel, arguments: &kernel_kit::Buffer) {
    let kernel = square_kernel(gpu, SQUARES);
    let numbers = gpu.upload("test/numbers", &[5u32; 100]).unwrap();
    let squares = gpu.poisoned::<u32>("test/squares", 100).unwrap();
    let sets = Resources::new().with("numbers", &numbers).with("squares", &squares);
    let square = kernel.bind(gpu, "square", &[&sets]).unwrap();
    let mut frame = gpu.frame("test");
    frame.run(bound, 1, &64u32);
    frame.run_indirect(&square, arguments, 0, &());
    frame.submit().unwrap();
    let expected: Vec<u32> = (0..100).map(|i| if i < 64 { 75 } else { POISON }).collect();
    compare::exact(&gpu.read::<u32>(&squares, 100).unwrap(), &expected, |i| format!("item {i}")).unwrap();
}

const SUBGROUPS: &str = "
@group(0) @binding(0) var<storage, read_write> lanes: array<vec2u>;
@compute @workgroup_size(64)
fn lane(
    @builtin(local_invocation_index) index: u32,
    @builtin(subgroup_size) size: u32,
    @builtin(subgroup_invocation_id) lane: u32,
) {
    lanes[index] = vec2u(size, lane);
}";

/// Subgroups have the size that the device reports. On software devices, whose kernels rely on it, they also follow
/// each other in the workgroup.
#[kernel_test]
fn subgroups_are_as_the_device_says(gpu: &Gpu) {
    let Some(size) = gpu.subgroup_size else {
        assert!(!gpu.info.is_software(), "a software device whose subgroups differ in size");
        return;
    };
    let composed = Composer::new().compose_source("subgroups", SUBGROUPS, &Features::<DeviceFeature>::new()).unwrap();
    let kernel = Kernel::new(gpu, &composed, &Host::default()).unwrap();
    let lanes = gpu.poisoned::<[u32; 2]>("test/lanes", 64).unwrap();
    let bound = kernel.bind(gpu, "lane", &[&Resources::new().with("lanes", &lanes)]).unwrap();
    gpu.run(&bound, 64, &()).unwrap();
    let found: Vec<[u32; 2]> = gpu.read(&lanes, 64).unwrap();
    for (index, [found_size, lane]) in (0..64).zip(found) {
        assert_eq!(found_size, size);
        assert!(!gpu.info.is_software() || lane == index % size, "invocation {index} is lane {lane}");
    }
}

const SUMS: &str = "
import package::kit::group_index;
@if(texture_loads) @group(0) @binding(0) var table: texture_storage_2d<rgba32uint, read>;
@if(!texture_loads) @group(0) @binding(0) var<storage, read> table: array<vec4u>;
@group(0) @binding(1) var<storage, read_write> sums: array<u32>;
fn word(i: u32) -> u32 {
    @if(texture_loads) { return textureLoad(table, vec2u(i, 0u)).x; }
    @if(!texture_loads) { return table[i].x; }
}
@compute @workgroup_size(64)
fn sum(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = group_index(group, groups) * 64u + lane;
    var total = 0u;
    for (var j = 0u; j < 100u; j++) { total += word((i + j) & 1023u); }
    sums[i] = total;
}";

const LOOK_UP: &str = "
import package::kit::{TABLE_WIDTH, TABLE_WIDTH_LOG2, group_index};
@if(texture_loads) @group(0) @binding(0) var table: texture_storage_2d<rgba32uint, read>;
@if(!texture_loads) @group(0) @binding(0) var<storage, read> table: array<vec4u>;
@group(0) @binding(1) var<storage, read_write> copies: array<vec4u>;
var<immediate> count: u32;
@compute @workgroup_size(64)
fn look_up(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = group_index(group, groups) * 64u + lane;
    if i >= count { return; }
    @if(texture_loads) { copies[i] = textureLoad(table, vec2u(i & (TABLE_WIDTH - 1u), i >> TABLE_WIDTH_LOG2)); }
    @if(!texture_loads) { copies[i] = table[i]; }
}";

const LOOK_UP_IN_LAYERS: &str = "
import package::kit::{TABLE_LAYER_ROWS_LOG2, TABLE_WIDTH, TABLE_WIDTH_LOG2, group_index};
@group(0) @binding(0) var table: texture_storage_2d_array<rgba32uint, read>;
@group(0) @binding(1) var<storage, read_write> copies: array<vec4u>;
var<immediate> count: u32;
@compute @workgroup_size(64)
fn look_up(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = group_index(group, groups) * 64u + lane;
    if i >= count { return; }
    let row = i >> TABLE_WIDTH_LOG2;
    let in_layer = vec2u(i & (TABLE_WIDTH - 1u), row & ((1u << TABLE_LAYER_ROWS_LOG2) - 1u));
    copies[i] = textureLoad(table, in_layer, row >> TABLE_LAYER_ROWS_LOG2);
}";
