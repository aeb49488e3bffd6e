//! Choosing and opening a Vulkan device.

use std::sync::{Arc, Mutex, MutexGuard};

use crate::{Error, Result};

use super::ahead::Undispatched;
use super::frame::Timer;

/// Which device to use.
#[derive(Clone, Debug, PartialEq, Eq, Default)]
pub enum DeviceChoice {
    /// A discrete GPU before an integrated one before a software device.
    #[default]
    Best,
    /// A software device (lavapipe), as the tests use.
    Software,
    /// The device with this index in [`Gpu::list`].
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
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
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

/// An open device with its queue.
pub struct Gpu {
    /// The device.
    pub device: wgpu::Device,
    /// Its queue.
    pub queue: wgpu::Queue,
    /// What it says of itself.
    pub info: DeviceInfo,
    /// Kernels read tables through textures here, not storage buffers: on a software device a divergent
    /// storage load costs five to eight texture loads.
    pub texture_loads: bool,
    pub(super) limits: wgpu::Limits,
    pub(super) timer: Mutex<Timer>,
    pub(super) adapter: wgpu::Adapter,
    undispatched: Mutex<Vec<Undispatched>>,
    fault: Arc<Mutex<Option<Fault>>>,
}

#[derive(Clone, Debug)]
enum Fault {
    Lost(String),
    Memory,
    Other(String),
}

/// What the kernels cannot do without.
const REQUIRED: wgpu::Features = wgpu::Features::IMMEDIATES;
/// What they use where it is there.
const WELCOME: wgpu::Features = wgpu::Features::TIMESTAMP_QUERY;

fn instance() -> wgpu::Instance {
    let mut descriptor = wgpu::InstanceDescriptor::new_without_display_handle();
    descriptor.backends = wgpu::Backends::VULKAN;
    descriptor.flags = wgpu::InstanceFlags::empty();
    wgpu::Instance::new(descriptor)
}

fn adapters() -> Vec<wgpu::Adapter> {
    pollster::block_on(instance().enumerate_adapters(wgpu::Backends::VULKAN))
}

fn describe(adapter: &wgpu::Adapter) -> DeviceInfo {
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

/// A device of the adapter, with what kernels need.
pub(super) fn request(
    adapter: &wgpu::Adapter,
) -> std::result::Result<(wgpu::Device, wgpu::Queue), wgpu::RequestDeviceError> {
    pollster::block_on(adapter.request_device(&wgpu::DeviceDescriptor {
        label: Some("penumbra"),
        required_features: REQUIRED | (adapter.features() & WELCOME),
        required_limits: adapter.limits(),
        ..Default::default()
    }))
}

const REMEDY: &str = "run through scripts/with-vulkan, which installs the software device lavapipe";

impl Gpu {
    /// The Vulkan devices of this machine, in the loader's order.
    pub fn list() -> Vec<DeviceInfo> {
        adapters().iter().map(describe).collect()
    }

    /// Opens a device.
    ///
    /// # Errors
    /// [`Error::NoDevice`] if none fits the choice or the one that fits lacks what the kernels need.
    pub fn open(choice: &DeviceChoice) -> Result<Gpu> {
        let adapters = adapters();
        if adapters.is_empty() {
            return Err(Error::NoDevice(format!("no Vulkan driver was found; {REMEDY}")));
        }
        let infos: Vec<DeviceInfo> = adapters.iter().map(describe).collect();
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
        let (adapter, info) = (&adapters[index], infos[index].clone());
        let features = adapter.features();
        if !features.contains(REQUIRED) {
            return Err(Error::NoDevice(format!("{} lacks {:?}; choose another with --device", info.name, REQUIRED)));
        }
        let (device, queue) =
            request(adapter).map_err(|e| Error::NoDevice(format!("{} does not open: {e}", info.name)))?;

        let fault = Arc::new(Mutex::new(None));
        let seen = fault.clone();
        device.on_uncaptured_error(Arc::new(move |error: wgpu::Error| {
            let fault = match error {
                wgpu::Error::OutOfMemory { .. } => Fault::Memory,
                other => Fault::Other(other.to_string()),
            };
            seen.lock().unwrap_or_else(|e| e.into_inner()).get_or_insert(fault);
        }));
        let seen = fault.clone();
        device.set_device_lost_callback(move |reason, message| {
            if reason != wgpu::DeviceLostReason::Destroyed {
                let fault = Fault::Lost(message);
                *seen.lock().unwrap_or_else(|e| e.into_inner()) = Some(fault);
            }
        });
        let timer = Mutex::new(Timer::new(&device, &queue, info.timestamps));
        let texture_loads = info.is_software();
        let (limits, adapter) = (adapter.limits(), adapter.clone());
        Ok(Gpu { device, queue, info, texture_loads, limits, timer, adapter, undispatched: Mutex::default(), fault })
    }

    /// The entry points that have not been dispatched.
    pub(super) fn undispatched(&self) -> MutexGuard<'_, Vec<Undispatched>> {
        self.undispatched.lock().unwrap_or_else(|e| e.into_inner())
    }

    /// What went wrong on the device since it was opened, if anything did. `at` names what was under way.
    ///
    /// # Errors
    /// [`Error::DeviceLost`], [`Error::OutOfMemory`], or [`Error::Kernel`] for misuse of the device.
    pub fn check(&self, at: &str) -> Result<()> {
        let fault = self.fault.lock().unwrap_or_else(|e| e.into_inner()).clone();
        match fault {
            None => Ok(()),
            Some(Fault::Lost(problem)) => Err(Error::DeviceLost { at: at.to_owned(), problem }),
            Some(Fault::Memory) => Err(Error::OutOfMemory { at: at.to_owned() }),
            Some(Fault::Other(problem)) => Err(Error::kernel(at, problem)),
        }
    }

    /// Waits until everything that was submitted is done.
    ///
    /// # Errors
    /// As [`Gpu::check`].
    pub fn wait(&self, at: &str) -> Result<()> {
        // wgpu panics where the driver tells of a lost device while it waits, after it has told the device's callback.
        let poll = || self.device.poll(wgpu::PollType::wait_indefinitely());
        let outcome = std::panic::catch_unwind(std::panic::AssertUnwindSafe(poll));
        self.check(at)?;
        let lost = |problem: String| Error::DeviceLost { at: at.to_owned(), problem };
        match outcome {
            Ok(polled) => polled.map(drop).map_err(|e| lost(e.to_string())),
            Err(_) => Err(lost("waiting for it failed".to_owned())),
        }
    }

    /// Loses the device, as a driver does that resets it, whatever is under way: for tests of what then follows.
    pub fn lose(&self) {
        self.device.destroy();
        let fault = Fault::Lost("it was lost on purpose".to_owned());
        *self.fault.lock().unwrap_or_else(|e| e.into_inner()) = Some(fault);
    }
}
