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

/// What a device says of itself.
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

/// What the kit cannot do without: kernels take their parameters as immediates.
pub(crate) const REQUIRED: wgpu::Features = wgpu::Features::IMMEDIATES;
/// What the kit uses where it is there.
const WELCOME: wgpu::Features = wgpu::Features::TIMESTAMP_QUERY.union(wgpu::Features::SUBGROUP);

const REMEDY: &str = "install a Vulkan driver (Mesa's lavapipe is one that needs no GPU)";

fn instance() -> wgpu::Instance {
    let mut descriptor = wgpu::InstanceDescriptor::new_without_display_handle();
    descriptor.backends = wgpu::Backends::VULKAN;
    descriptor.flags = wgpu::InstanceFlags::empty();
    wgpu::Instance::new(descriptor)
}

/// The Vulkan devices, in the loader's order.
pub(crate) fn adapters() -> Vec<wgpu::Adapter> {
    pollster::block_on(instance().enumerate_adapters(wgpu::Backends::VULKAN))
}

/// What the adapter says of itself.
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

/// Lanes of a subgroup, if kernels can use them and all subgroups have the same number.
pub(crate) fn subgroup_size(adapter: &wgpu::Adapter, device: &wgpu::Device) -> Option<u32> {
    let info = adapter.get_info();
    let one_size = info.subgroup_min_size == info.subgroup_max_size;
    (one_size && device.features().contains(wgpu::Features::SUBGROUP)).then_some(info.subgroup_min_size)
}

fn rank(kind: &str) -> usize {
    ["discrete gpu", "integrated gpu", "virtual gpu", "other", "software"].iter().position(|k| *k == kind).unwrap_or(5)
}

/// The adapter that fits the choice.
///
/// # Errors
/// [`Error::NoDevice`] if none fits, or the one that fits lacks what the kit needs.
pub(crate) fn choose(choice: &DeviceChoice) -> Result<(wgpu::Adapter, DeviceInfo)> {
    let mut adapters = adapters();
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
        return Err(Error::NoDevice(format!("{wanted}; there is: {}", names.join(", "))));
    };
    let (adapter, info) = (adapters.swap_remove(index), infos.swap_remove(index));
    if !adapter.features().contains(REQUIRED) {
        return Err(Error::NoDevice(format!("{} lacks {REQUIRED:?}; choose another device", info.name)));
    }
    Ok((adapter, info))
}

/// A device of the adapter, with what kernels need.
pub(crate) fn request(
    adapter: &wgpu::Adapter,
) -> std::result::Result<(wgpu::Device, wgpu::Queue), wgpu::RequestDeviceError> {
    pollster::block_on(adapter.request_device(&wgpu::DeviceDescriptor {
        label: Some("kernel-kit"),
        required_features: REQUIRED | (adapter.features() & WELCOME),
        required_limits: adapter.limits(),
        ..Default::default()
    }))
}
