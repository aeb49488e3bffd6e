//! The Vulkan devices of a machine, and choosing one.

use crate::error::{Error, Result};

/// Which device to use. Parsed from text: `best` or nothing, `software` or `lavapipe`, a number, or part of a name.
#[derive(Clone, Debug, PartialEq, Eq, Default)]
pub enum DeviceChoice {
    /// A discrete GPU before an integrated one before a software device.
    #[default]
    Best,
    /// A software device, such as Mesa's lavapipe.
    Software,
    /// The device with this index in [`Gpu::list`](crate::Gpu::list).
    Index(usize),
    /// The first device whose name contains this text, whatever its case.
    Name(String),
}

impl std::str::FromStr for DeviceChoice {
    type Err = std::convert::Infallible;

    fn from_str(text: &str) -> std::result::Result<Self, Self::Err> {
        Ok(match text {
            "" | "best" => DeviceChoice::Best,
            "software" | "lavapipe" => DeviceChoice::Software,
            _ => text.parse().map(DeviceChoice::Index).unwrap_or_else(|_| DeviceChoice::Name(text.to_owned())),
        })
    }
}

/// Description of a device by its driver.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
pub struct DeviceInfo {
    /// Name.
    pub name: String,
    /// `discrete gpu`, `integrated gpu`, `virtual gpu`, `software` or `other`.
    pub kind: &'static str,
    /// Driver name and version.
    pub driver: String,
    /// Largest storage buffer binding in bytes.
    pub max_binding_bytes: u64,
    /// Passes can be timed on the device.
    pub timestamps: bool,
}

impl DeviceInfo {
    /// The device runs on the CPU.
    pub fn is_software(&self) -> bool {
        self.kind == "software"
    }
}

/// The part of a device's features and limits that is used.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum DeviceLimits {
    /// All that it has.
    #[default]
    Own,
    /// The least that a desktop's Vulkan device has, whatever this one has: no timestamps, no subgroups, no immediates
    /// except on lavapipe, and [`DeviceLimits::least`]. For tests.
    Least,
    /// All of the device's features and limits, and a software device is treated like a GPU: tables are storage
    /// buffers, passes are sliced, [`Gpu::is_software`](crate::Gpu::is_software) is false. For tests.
    Gpu,
}

impl std::str::FromStr for DeviceLimits {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self> {
        match text {
            "own" => Ok(DeviceLimits::Own),
            "least" => Ok(DeviceLimits::Least),
            "gpu" => Ok(DeviceLimits::Gpu),
            _ => Err(Error::NoDevice(format!("limits are 'own', 'least' or 'gpu', not '{text}'"))),
        }
    }
}

impl DeviceLimits {
    /// WebGPU's limits, which browsers require of every desktop device, except that storage buffers are 10 per stage,
    /// not 8. That is what wgpu leaves for kernels on SwiftShader, and what Chrome offers
    /// (github.com/gfx-rs/wgpu/issues/9287). All GPUs that can have WebGPU report 16 or more
    /// (github.com/gpuweb/gpuweb/issues/4235).
    pub const fn least() -> wgpu::Limits {
        wgpu::Limits { max_storage_buffers_per_shader_stage: 10, ..wgpu::Limits::defaults() }
    }
}

/// Optional features that the kit uses if they are there.
const WELCOME: wgpu::Features =
    wgpu::Features::IMMEDIATES.union(wgpu::Features::TIMESTAMP_QUERY).union(wgpu::Features::SUBGROUP);

const REMEDY: &str = "install a Vulkan driver (Mesa's lavapipe is one that needs no GPU)";

/// An instance of wgpu with the backend of the kit, for windows; see [`Gpu::open_in`](crate::Gpu::open_in).
pub fn instance() -> wgpu::Instance {
    let mut descriptor = wgpu::InstanceDescriptor::new_without_display_handle();
    descriptor.backends = wgpu::Backends::VULKAN;
    descriptor.flags = wgpu::InstanceFlags::empty();
    wgpu::Instance::new(descriptor)
}

/// The Vulkan devices, in the loader's order.
pub(crate) fn adapters(instance: &wgpu::Instance) -> Vec<wgpu::Adapter> {
    pollster::block_on(instance.enumerate_adapters(wgpu::Backends::VULKAN))
}

/// The driver's description of the adapter.
pub(crate) fn describe(adapter: &wgpu::Adapter) -> DeviceInfo {
    let info = adapter.get_info();
    DeviceInfo {
        name: info.name,
        kind: match info.device_type {
            wgpu::DeviceType::DiscreteGpu => "discrete gpu",
            wgpu::DeviceType::IntegratedGpu => "integrated gpu",
            wgpu::DeviceType::VirtualGpu => "virtual gpu",
            wgpu::DeviceType::Cpu => "software",
            wgpu::DeviceType::Other => "other",
        },
        driver: format!("{} {}", info.driver, info.driver_info).trim().to_owned(),
        max_binding_bytes: adapter.limits().max_storage_buffer_binding_size,
        timestamps: adapter.features().contains(wgpu::Features::TIMESTAMP_QUERY),
    }
}

fn rank(kind: &str) -> usize {
    ["discrete gpu", "integrated gpu", "virtual gpu", "other", "software"].iter().position(|k| *k == kind).unwrap_or(5)
}

/// The adapter that fits the choice.
///
/// # Errors
/// [`Error::NoDevice`] if none fits.
pub(crate) fn choose(instance: &wgpu::Instance, choice: &DeviceChoice) -> Result<(wgpu::Adapter, DeviceInfo)> {
    let mut adapters = adapters(instance);
    if adapters.is_empty() {
        return Err(Error::NoDevice(format!("no Vulkan driver was found; {REMEDY}")));
    }
    let mut infos: Vec<DeviceInfo> = adapters.iter().map(describe).collect();
    let found = match choice {
        DeviceChoice::Best => (0..infos.len()).min_by_key(|&i| (rank(infos[i].kind), i)),
        DeviceChoice::Software => infos.iter().position(DeviceInfo::is_software),
        DeviceChoice::Index(i) => (*i < infos.len()).then_some(*i),
        DeviceChoice::Name(text) => {
            infos.iter().position(|info| info.name.to_lowercase().contains(&text.to_lowercase()))
        }
    };
    let Some(index) = found else {
        let names: Vec<&str> = infos.iter().map(|info| info.name.as_str()).collect();
        let wanted = match choice {
            DeviceChoice::Software => format!("no software device is installed; {REMEDY}"),
            DeviceChoice::Index(i) => format!("there is no device {i}"),
            DeviceChoice::Name(text) => format!("no device is called '{text}'"),
            DeviceChoice::Best => "none is usable".to_owned(),
        };
        return Err(Error::NoDevice(format!("{wanted}; available: {}", names.join(", "))));
    };
    Ok((adapters.swap_remove(index), infos.swap_remove(index)))
}

/// Features and limits of [`DeviceLimits::Least`]. Lavapipe keeps its immediates: without them, lavapipe of Mesa 22.3
/// crashes in some kernels, and the backtrace points to loops whose ends come from a uniform buffer.
fn min_request(adapter: &wgpu::Adapter) -> (wgpu::Features, wgpu::Limits) {
    let crashes = adapter.get_info().driver == "llvmpipe";
    let kept = if crashes { wgpu::Features::IMMEDIATES } else { wgpu::Features::empty() };
    let max_immediate_size = if crashes { adapter.limits().max_immediate_size } else { 0 };
    (adapter.features() & kept, wgpu::Limits { max_immediate_size, ..DeviceLimits::least() })
}

/// A device of the adapter, with what kernels need.
pub(crate) fn request(
    adapter: &wgpu::Adapter,
    limits: DeviceLimits,
) -> std::result::Result<(wgpu::Device, wgpu::Queue), wgpu::RequestDeviceError> {
    let (required_features, required_limits) = match limits {
        DeviceLimits::Own | DeviceLimits::Gpu => (adapter.features() & WELCOME, adapter.limits()),
        DeviceLimits::Least => min_request(adapter),
    };
    pollster::block_on(adapter.request_device(&wgpu::DeviceDescriptor {
        label: Some("kernel-kit"),
        required_features,
        required_limits,
        ..Default::default()
    }))
}
