//! An open device.

use std::fmt;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError, RwLock};

use crate::adapted;
use crate::adapter::{self, DeviceChoice, DeviceInfo, DeviceLimits};
use crate::compose::{Composed, Composer};
use crate::error::{Error, Result, one_line};
use crate::feature::{Feature, Features};
use crate::kernel_folder::KernelFolder;
use crate::pace::Pace;
use crate::pipeline::{Kept, Waiting};
use crate::slices::Slicer;
use crate::subgroups::subgroup_size;
use crate::timer::Timer;

/// An open device with its queue.
pub struct Gpu {
    /// The device.
    pub device: wgpu::Device,
    /// Its queue.
    pub queue: wgpu::Queue,
    /// Description of the device.
    pub info: DeviceInfo,
    /// Kernels read tables through textures here, not storage buffers: on a software device a divergent
    /// storage load costs five to eight texture loads, and some devices allow few storage buffers.
    pub texture_loads: bool,
    /// Lanes of a subgroup, where the device was opened with `SUBGROUP`, all subgroups have the same number, and
    /// consecutive invocations of a workgroup are the lanes of one.
    pub subgroup_size: Option<u32>,
    pub(crate) limits: wgpu::Limits,
    pub(crate) adapter: wgpu::Adapter,
    /// The limits that were requested.
    pub(crate) requested: DeviceLimits,
    /// Features that kernels must avoid.
    pub(crate) adaptation: adapted::Device,
    pace: Mutex<Pace>,
    slicer: OnceLock<Slicer>,
    timer: Mutex<Timer>,
    undispatched: Mutex<Waiting>,
    kept: Mutex<Option<Kept>>,
    folder: OnceLock<KernelFolder>,
    watch: Mutex<Option<Watch>>,
    fault: Arc<Mutex<Option<Fault>>>,
    /// Locked for reading by a submission, and for writing while nothing may be submitted.
    submissions: RwLock<()>,
}

/// Tables are buffers only where a shader stage may have at least this many storage buffers: those of the kernel
/// itself, and a dozen tables.
const TABLE_BUFFERS: u32 = 24;

/// How many kernels the driver has translated.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Compilation {
    /// So many so far.
    pub done: usize,
    /// So many there are.
    pub all: usize,
}

impl fmt::Display for Compilation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "compiling {} of {} kernels", self.done, self.all)
    }
}

/// Hears how far the driver is.
pub(crate) type Watch = Arc<dyn Fn(Compilation) + Send + Sync>;

#[derive(Clone, Debug)]
enum Fault {
    Lost(String),
    Memory,
    Other(String),
}

pub(crate) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(|e| e.into_inner())
}

impl Gpu {
    /// The Vulkan devices of this machine, in the loader's order.
    pub fn list() -> Vec<DeviceInfo> {
        adapter::adapters(&adapter::instance()).iter().map(adapter::describe).collect()
    }

    /// Opens a device.
    ///
    /// # Errors
    /// [`Error::NoDevice`] if none fits the choice or the one that fits lacks what the kit needs.
    pub fn open(choice: &DeviceChoice) -> Result<Gpu> {
        Gpu::open_with(choice, DeviceLimits::Own)
    }

    /// As [`Gpu::open`], with other limits.
    ///
    /// # Errors
    /// As [`Gpu::open`].
    pub fn open_with(choice: &DeviceChoice, limits: DeviceLimits) -> Result<Gpu> {
        Gpu::open_in(&adapter::instance(), choice, limits)
    }

    /// As [`Gpu::open_with`], among the devices of an [`instance`](crate::instance): those that can show its windows.
    ///
    /// # Errors
    /// As [`Gpu::open`].
    pub fn open_in(instance: &wgpu::Instance, choice: &DeviceChoice, limits: DeviceLimits) -> Result<Gpu> {
        let (adapter, info) = adapter::choose(instance, choice)?;
        let (device, queue) = adapter::request(&adapter, limits)
            .map_err(|e| Error::NoDevice(format!("{} does not open: {}", info.name, one_line(&e.to_string()))))?;
        Ok(Gpu::new(adapter, device, queue, limits))
    }

    /// Takes a device that the caller has opened. The parameters of kernels are immediates if it was opened with the
    /// feature `IMMEDIATES`, whose `max_immediate_size` must hold them; else they are in a uniform buffer. Passes are
    /// timed if it was opened with `TIMESTAMP_QUERY`, and kernels may use subgroups if it was opened with `SUBGROUP`.
    /// The kit replaces the device's callbacks for uncaptured errors and for its loss: [`Gpu::check`] returns the
    /// errors that they received.
    pub fn from_wgpu(adapter: wgpu::Adapter, device: wgpu::Device, queue: wgpu::Queue) -> Gpu {
        Gpu::new(adapter, device, queue, DeviceLimits::Own)
    }

    fn new(adapter: wgpu::Adapter, device: wgpu::Device, queue: wgpu::Queue, requested: DeviceLimits) -> Gpu {
        let mut info = adapter::describe(&adapter);
        let features = device.features();
        info.timestamps = features.contains(wgpu::Features::TIMESTAMP_QUERY);
        info.max_binding_bytes = device.limits().max_storage_buffer_binding_size;
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
        let subgroup_size = subgroup_size(&adapter.get_info(), &device, &queue);
        let limits = device.limits();
        let texture_loads = requested != DeviceLimits::Gpu
            && (info.is_software() || limits.max_storage_buffers_per_shader_stage < TABLE_BUFFERS);
        let adaptation = adapted::Device {
            without_immediates: !features.contains(wgpu::Features::IMMEDIATES),
            // No watchdog resets a software device.
            sliced: !info.is_software() || requested != DeviceLimits::Own,
            max_storage_textures: limits.max_storage_textures_per_shader_stage,
        };
        Gpu {
            device,
            queue,
            info,
            texture_loads,
            subgroup_size,
            limits,
            adapter,
            requested,
            adaptation,
            pace: Mutex::default(),
            slicer: OnceLock::new(),
            timer,
            undispatched: Mutex::default(),
            kept: Mutex::default(),
            folder: OnceLock::new(),
            watch: Mutex::default(),
            fault,
            submissions: RwLock::default(),
        }
    }

    /// It runs on the CPU, and is not used as a GPU ([`DeviceLimits::Gpu`]).
    pub fn is_software(&self) -> bool {
        self.info.is_software() && self.requested != DeviceLimits::Gpu
    }

    /// The formats of a window's surface, the preferred one first; empty if the device cannot show the window.
    pub fn surface_formats(&self, surface: &wgpu::Surface<'_>) -> Vec<wgpu::TextureFormat> {
        surface.get_capabilities(&self.adapter).formats
    }

    /// Submits commands to the queue. All threads that share the device submit by this method, so that
    /// [`Gpu::configure`] can hold them up.
    pub fn submit(&self, commands: impl IntoIterator<Item = wgpu::CommandBuffer>) {
        let _shared = self.submissions.read().unwrap_or_else(PoisonError::into_inner);
        self.queue.submit(commands);
    }

    /// Configures a window's surface after all work that was submitted. wgpu refuses that if another thread submits
    /// more meanwhile; such threads wait here.
    pub fn configure(&self, surface: &wgpu::Surface<'_>, config: &wgpu::SurfaceConfiguration) {
        let _alone = self.submissions.write().unwrap_or_else(PoisonError::into_inner);
        surface.configure(&self.device, config);
    }

    /// From now on keeps the kernels of [`Kernel::kept`](crate::Kernel::kept), as long as the device is open: for
    /// programs that need the same kernels for one scene after another.
    pub fn keep_kernels(&self) {
        self.kept().get_or_insert_default();
    }

    /// From now on [`Gpu::compose`] keeps what it composes in a folder, for later processes. The first folder stays.
    pub fn keep_composed(&self, folder: impl Into<PathBuf>) {
        self.folder.get_or_init(|| KernelFolder::new(folder.into()));
    }

    /// As [`Composer::compose`], from the device's folder if it has one and the kernel is there
    /// ([`Gpu::keep_composed`]).
    ///
    /// # Errors
    /// As [`Composer::compose`].
    pub fn compose<F: Feature>(&self, composer: &Composer, kernel: &str, features: &Features<F>) -> Result<Composed> {
        match self.folder.get() {
            Some(folder) => folder.compose(composer, kernel, features),
            None => composer.compose(kernel, features),
        }
    }

    /// From now on, [`Gpu::compile_ahead`] calls `watch`, from any thread, with the number of kernels that the driver
    /// has translated. It makes no call if the driver's cache on disk has all of them.
    pub fn watch_compilation(&self, watch: impl Fn(Compilation) + Send + Sync + 'static) {
        *lock(&self.watch) = Some(Arc::new(watch));
    }

    /// The watcher of compilation.
    pub(crate) fn watch(&self) -> Option<Watch> {
        lock(&self.watch).clone()
    }

    /// Number of kept kernels. Waits for those that other threads are making.
    pub fn kept_kernels(&self) -> usize {
        let kept: Vec<_> = self.kept().iter().flat_map(Kept::values).cloned().collect();
        kept.iter().filter(|kernel| lock(kernel).is_some()).count()
    }

    /// The kept kernels; `None` if kernels are not kept.
    pub(crate) fn kept(&self) -> MutexGuard<'_, Option<Kept>> {
        lock(&self.kept)
    }

    /// The pace of passes.
    pub(crate) fn pace(&self) -> MutexGuard<'_, Pace> {
        lock(&self.pace)
    }

    /// The kernel that slices indirect dispatches.
    pub(crate) fn slicer(&self) -> &Slicer {
        self.slicer.get_or_init(|| Slicer::new(&self.device))
    }

    /// From now on passes are sliced as if they took `factor` times as long as they do: for tests.
    pub fn pretend_slower(&self, factor: f64) {
        self.pace().pretend_slower(factor);
    }

    /// Number of slices so far. Passes that take long are divided into several dispatches, by the times that they took
    /// before. This is done on devices that a driver may reset if they are busy for long, and with limits other than
    /// [`DeviceLimits::Own`].
    pub fn slices(&self) -> u64 {
        self.pace().sliced()
    }

    /// The entry points that have not been dispatched.
    pub(crate) fn undispatched(&self) -> MutexGuard<'_, Waiting> {
        lock(&self.undispatched)
    }

    /// The times of passes.
    pub(crate) fn timer(&self) -> MutexGuard<'_, Timer> {
        lock(&self.timer)
    }

    /// What went wrong on the device since it was opened, if anything did. `at` names the operation in progress.
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
        // wgpu calls the device's callback and then panics if the driver reports a lost device while it waits.
        let poll = || self.device.poll(wgpu::PollType::wait_indefinitely());
        let outcome = std::panic::catch_unwind(std::panic::AssertUnwindSafe(poll));
        self.check(at)?;
        self.pace().end();
        let lost = |problem: String| Error::DeviceLost { at: at.to_owned(), problem };
        match outcome {
            Ok(polled) => polled.map(drop).map_err(|e| lost(e.to_string())),
            Err(_) => Err(lost("waiting for it failed".to_owned())),
        }
    }

    /// Loses the device, whatever is under way, as when a driver resets it: for tests of what follows.
    pub fn lose(&self) {
        self.device.destroy();
        *lock(&self.fault) = Some(Fault::Lost("it was lost on purpose".to_owned()));
    }
}
