//! Opening devices, taking an open one, and the errors for devices that do not exist.

use std::sync::{Arc, Mutex};
use std::time::{SystemTime, UNIX_EPOCH};

use kernel_kit::{
    Composer, DeviceChoice, DeviceLimits, Error, Features, Gpu, Host, Kernel, Resources, TableFormat, kernel_test,
    test, wgpu,
};

/// The tests' device, to be opened again.
pub fn same_device() -> DeviceChoice {
    DeviceChoice::Name(test::device(test::VARIABLE).info.name.clone())
}

fn adapter(name: &str) -> wgpu::Adapter {
    let mut descriptor = wgpu::InstanceDescriptor::new_without_display_handle();
    descriptor.backends = wgpu::Backends::VULKAN;
    let adapters = wgpu::Instance::new(descriptor).enumerate_adapters(wgpu::Backends::VULKAN);
    pollster::block_on(adapters).into_iter().find(|adapter| adapter.get_info().name == name).unwrap()
}

fn open(adapter: &wgpu::Adapter, features: wgpu::Features) -> (wgpu::Device, wgpu::Queue) {
    let max_immediate_size = if features.contains(wgpu::Features::IMMEDIATES) { 16 } else { 0 };
    let required_limits = wgpu::Limits { max_immediate_size, ..Default::default() };
    let descriptor = wgpu::DeviceDescriptor { required_features: features, required_limits, ..Default::default() };
    pollster::block_on(adapter.request_device(&descriptor)).unwrap()
}

const ADD: &str = "
@group(0) @binding(0) var<storage, read_write> values: array<u32>;
var<immediate> summand: u32;
@compute @workgroup_size(64) fn add(@builtin(global_invocation_id) id: vec3u) { values[id.x] += summand; }";

/// A device that the caller has opened runs kernels, times them if it can, and reports its own limits.
#[kernel_test]
fn the_callers_device_is_taken(gpu: &Gpu) {
    let adapter = adapter(&gpu.info.name);
    let timed = adapter.features() & wgpu::Features::TIMESTAMP_QUERY;
    // Without immediates, too.
    let immediates = wgpu::Features::IMMEDIATES;
    for (features, more) in
        [(immediates, wgpu::Features::empty()), (immediates, timed), (wgpu::Features::empty(), timed)]
    {
        let (device, queue) = open(&adapter, features | more);
        let gpu = Gpu::from_wgpu(adapter.clone(), device, queue);
        assert_eq!(gpu.info.timestamps, !more.is_empty());
        assert_eq!(gpu.max_buffer_bytes(), wgpu::Limits::default().max_storage_buffer_binding_size);
        let composed = Composer::new().compose_source("add", ADD, &Features::none()).unwrap();
        let kernel = Kernel::new(&gpu, &composed, &Host::default()).unwrap();
        gpu.compile_ahead(&Resources::new()).unwrap();
        let values = gpu.upload("test/values", &[1u32; 64]).unwrap();
        let bound = kernel.bind(&gpu, "add", &[&Resources::new().with("values", &values)]).unwrap();
        let mut frame = gpu.frame("test");
        frame.run(&bound, 64, &41u32);
        frame.submit().unwrap();
        assert_eq!(gpu.read::<u32>(&values, 64).unwrap(), [42; 64]);
        assert_eq!(gpu.pass_times().unwrap().contains_key("add/add"), gpu.info.timestamps);
        let problem = gpu.buffer::<u8>("test/huge", 1 << 28).err().unwrap();
        let limit = gpu.max_buffer_bytes();
        assert_eq!(problem, Error::Buffer { buffer: "test/huge".into(), needed: 1 << 28, limit });
    }
}

/// The largest table that is said to fit can be made, and no larger one. WebGPU's limits give textures a height that is
/// a power of two, which tables avoid.
#[kernel_test]
fn the_largest_table_fits(gpu: &Gpu) {
    let adapter = adapter(&gpu.info.name);
    let (device, queue) = open(&adapter, wgpu::Features::empty());
    let gpu = Gpu::from_wgpu(adapter, device, queue);
    let records = gpu.max_table_records() as usize;
    gpu.empty_table("test/largest", records, TableFormat::Float).unwrap();
    gpu.check("test/largest").unwrap();
    let problem = gpu.empty_table("test/larger", records + 1, TableFormat::Float).err().unwrap();
    assert!(matches!(&problem, Error::Buffer { buffer, .. } if buffer == "test/larger"), "{problem}");
}

/// A watcher of compilation is called for all kernels that the driver has never seen. A late one is left out, and
/// translated with the next ones.
#[kernel_test]
fn compilation_is_watched(gpu: &Gpu) {
    if !gpu.is_software() {
        return;
    }
    let gpu = Gpu::open(&same_device()).unwrap();
    let heard = Arc::new(Mutex::new(Vec::new()));
    let listener = heard.clone();
    gpu.watch_compilation(move |compilation| listener.lock().unwrap().push(compilation));
    // No run before had this constant.
    let salt = SystemTime::now().duration_since(UNIX_EPOCH).unwrap().subsec_nanos();
    let make = |i: u32, late: &[&str]| {
        // Large enough to take longer to translate than to find in the cache.
        let steps: String =
            (0..400).map(|step| format!("x = x * {}u + (x >> 7u);", salt ^ (1000 * i + step))).collect();
        let source = format!(
            "@group(0) @binding(0) var<storage, read_write> values: array<u32>;\n\
             @compute @workgroup_size(64) fn mix(@builtin(global_invocation_id) id: vec3<u32>) {{\n\
             var x = values[id.x]; {steps} values[id.x] = x; }}"
        );
        let composed = Composer::new().compose_source("mix", &source, &Features::none()).unwrap();
        Kernel::new(&gpu, &composed, &Host { late, ..Host::default() }).unwrap()
    };
    let run = |kernel: &Kernel| {
        let values = gpu.upload("test/values", &[1u32; 64]).unwrap();
        let bound = kernel.bind(&gpu, "mix", &[&Resources::new().with("values", &values)]).unwrap();
        let mut frame = gpu.frame("test");
        frame.run(&bound, 64, &());
        frame.submit().unwrap();
        gpu.read::<u32>(&values, 64).unwrap()
    };
    let compile = |expected: usize| {
        gpu.compile_ahead(&Resources::new()).unwrap();
        let mut heard = std::mem::take(&mut *heard.lock().unwrap());
        heard.sort_unstable();
        assert!(heard.iter().all(|compilation| compilation.all == expected), "{heard:?}");
        assert_eq!(heard.last().unwrap().to_string(), format!("compiling {expected} of {expected} kernels"));
        assert!(heard.windows(2).all(|pair| pair[1].done == pair[0].done + 1), "{heard:?}");
    };
    let _first: Vec<Kernel> = (0..6).map(|i| make(i, &[])).collect();
    let (late, dispatched) = (make(6, &["mix"]), make(7, &["mix"]));
    drop(make(8, &["mix"]));
    compile(6);
    // Not before there are other kernels, unless it is dispatched.
    gpu.compile_ahead(&Resources::new()).unwrap();
    assert!(heard.lock().unwrap().is_empty());
    let values = run(&dispatched);
    let _second = [make(9, &[]), make(10, &[])];
    compile(3);
    assert_ne!(run(&late), values);
    assert_eq!(run(&dispatched), values);
}

/// With the least limits, a device reports no more than these.
#[kernel_test]
fn few_limits_are_requested(gpu: &Gpu) {
    let least = Gpu::open_with(&same_device(), DeviceLimits::Least).unwrap();
    assert!((least.device.features() - wgpu::Features::IMMEDIATES).is_empty(), "{:?}", least.device.features());
    assert!(!least.info.timestamps && least.subgroup_size.is_none());
    assert_eq!(least.device.limits().max_storage_buffers_per_shader_stage, 10);
    assert_eq!(least.max_buffer_bytes(), 128 << 20);
    assert_eq!(least.info.name, gpu.info.name);
    let problem = least.buffer::<u8>("test/huge", (128 << 20) + 1).err().unwrap().to_string();
    assert!(problem.contains("test/huge") && problem.contains("134217728"), "{problem}");
    let all = [DeviceLimits::Own, DeviceLimits::Least, DeviceLimits::Gpu];
    assert_eq!(["own", "least", "gpu"].map(|text| text.parse()), all.map(Ok));
}

/// Devices are found by index and by part of a name; the error for any other names the existing ones.
#[kernel_test]
fn devices_are_selected(gpu: &Gpu) {
    let list = Gpu::list();
    let index = list.iter().position(|info| *info == gpu.info).unwrap();
    assert_eq!(Gpu::open(&DeviceChoice::Index(index)).unwrap().info, gpu.info);
    assert_eq!(Gpu::open(&DeviceChoice::Name(gpu.info.name.to_uppercase())).unwrap().info.name, gpu.info.name);
    for wrong in [DeviceChoice::Index(list.len()), DeviceChoice::Name("no such device".into())] {
        let problem = Gpu::open(&wrong).err().unwrap();
        assert!(matches!(&problem, Error::NoDevice(text) if text.contains(&gpu.info.name)), "{problem}");
    }
}

/// An operation on a lost device returns an error, and does not panic.
#[kernel_test]
fn a_lost_device_is_an_error(gpu: &Gpu) {
    let gpu = Gpu::open(&DeviceChoice::Name(gpu.info.name.clone())).unwrap();
    let values = gpu.upload("test/values", &[1u32; 64]).unwrap();
    gpu.lose();
    let problem = gpu.read::<u32>(&values, 64).unwrap_err();
    assert!(matches!(&problem, Error::DeviceLost { at, .. } if at == "test/values"), "{problem}");
    assert!(matches!(gpu.frame("after").submit(), Err(Error::DeviceLost { .. })));
}

/// Text is a choice.
#[test]
fn choices_are_parsed() {
    let parsed = ["", "best", "software", "lavapipe", "1", "radeon"].map(|text| text.parse::<DeviceChoice>().unwrap());
    let (software, name) = (DeviceChoice::Software, DeviceChoice::Name("radeon".into()));
    assert_eq!(
        parsed,
        [DeviceChoice::Best, DeviceChoice::Best, software.clone(), software, DeviceChoice::Index(1), name]
    );
}
