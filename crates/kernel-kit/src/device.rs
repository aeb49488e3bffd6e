//! An open device.

use std::sync::{Arc, Mutex, MutexGuard};

use crate::adapter::{self, DeviceChoice, DeviceInfo};
use crate::error::{Error, Result, one_line};
use crate::pipeline::{Kept, Undispatched};
use crate::timer::Timer;

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
    /// Lanes of a subgroup, where all subgroups have the same number and the device was opened with `SUBGROUP`.
    pub subgroup_size: Option<u32>,
    pub(crate) limits: wgpu::Limits,
    pub(crate) adapter: wgpu::Adapter,
    timer: Mutex<Timer>,
    undispatched: Mutex<Vec<Undispatched>>,
    kept: Mutex<Option<Kept>>,
    fault: Arc<Mutex<Option<Fault>>>,
}

#[derive(Clone, Debug)]
enum Fault {
    Lost(String),
    Memory,
    Other(String),
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(|e| e.into_inner())
}

impl Gpu {
    /// The Vulkan devices of this machine, in the loader's order.
    pub fn list() -> Vec<DeviceInfo> {
        adapter::adapters().iter().map(adapter::describe).collect()
    }

    /// Opens a device.
    ///
    /// # Errors
    /// [`Error::NoDevice`] if none fits the choice or the one that fits lacks what the kit needs.
    pub fn open(choice: &DeviceChoice) -> Result<Gpu> {
        let (adapter, info) = adapter::choose(choice)?;
        let (device, queue) = adapter::request(&adapter)
            .map_err(|e| Error::NoDevice(format!("{} does not open: {}", info.name, one_line(&e.to_string()))))?;
        Ok(Gpu::new(adapter, device, queue, info))
    }

    /// Takes a device that the caller has opened, with the feature `IMMEDIATES` and a `max_immediate_size` that holds
    /// the parameters of the kernels. Passes are timed if it was opened with `TIMESTAMP_QUERY`, and kernels may use
    /// subgroups if with `SUBGROUP`. The device's callbacks for uncaptured errors and for its loss are replaced by the
    /// kit's: [`Gpu::check`] says what they heard.
    ///
    /// # Errors
    /// [`Error::NoDevice`] if the device was opened without `IMMEDIATES`.
    pub fn from_wgpu(adapter: wgpu::Adapter, device: wgpu::Device, queue: wgpu::Queue) -> Result<Gpu> {
        let mut info = adapter::describe(&adapter);
        if !device.features().contains(adapter::REQUIRED) {
            let needed = adapter::REQUIRED;
            return Err(Error::NoDevice(format!("{} was opened without {needed:?}; request them", info.name)));
        }
        info.timestamps = device.features().contains(wgpu::Features::TIMESTAMP_QUERY);
        info.max_binding_bytes = device.limits().max_storage_buffer_binding_size;
        Ok(Gpu::new(adapter, device, queue, info))
    }

    fn new(adapter: wgpu::Adapter, device: wgpu::Device, queue: wgpu::Queue, info: DeviceInfo) -> Gpu {
        let fault = Arc::new(Mutex::new(None));
        let reported = fault.clone();
        device.on_uncaptured_error(Arc::new(move |error: wgpu::Error| {
            let fault = match error {
                wgpu::Error::OutOfMemory { .. } => Fault::Memory,
                other => Fault::Other(other.to_string()),
            };
            lock(&reported).get_or_insert(fault);
        }));
        let reported = fault.clone();
        device.set_device_lost_callback(move |reason, message| {
            if reason != wgpu::DeviceLostReason::Destroyed {
                *lock(&reported) = Some(Fault::Lost(message));
            }
        });
        let timer = Mutex::new(Timer::new(&device, &queue, info.timestamps));
        let texture_loads = info.is_software();
        let subgroup_size = adapter::subgroup_size(&adapter, &device);
        let limits = device.limits();
        let (undispatched, kept) = Default::default();
        Gpu { device, queue, info, texture_loads, subgroup_size, limits, adapter, timer, undispatched, kept, fault }
    }

    /// From now on keeps the kernels of [`Kernel::kept`](crate::Kernel::kept), as long as the device is open: for
    /// programs that need the same kernels for one scene after another.
    pub fn keep_kernels(&self) {
        self.kept().get_or_insert_default();
    }

    /// Number of kernels that are kept.
    pub fn kept_kernels(&self) -> usize {
        self.kept().as_ref().map_or(0, Kept::len)
    }

    /// The kept kernels; none if they are not to be kept.
    pub(crate) fn kept(&self) -> MutexGuard<'_, Option<Kept>> {
        lock(&self.kept)
    }

    /// The entry points that have not been dispatched.
    pub(crate) fn undispatched(&self) -> MutexGuard<'_, Vec<Undispatched>> {
        lock(&self.undispatched)
    }

    /// The times of passes.
    pub(crate) fn timer(&self) -> MutexGuard<'_, Timer> {
        lock(&self.timer)
    }

    /// What went wrong on the device since it was opened, if anything did. `at` names what was under way.
    ///
    /// # Errors
    /// [`Error::DeviceLost`], [`Error::OutOfMemory`], or [`Error::Kernel`] for misuse of the device.
    pub fn check(&self, at: &str) -> Result<()> {
        let fault = lock(&self.fault).clone();
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
        *lock(&self.fault) = Some(Fault::Lost("it was lost on purpose".to_owned()));
    }
}
