//! Devices, which stay open from one render to the next.

use std::cell::Cell;
use std::ops::{Deref, DerefMut};
use std::process;
use std::sync::{Arc, Mutex, MutexGuard, OnceLock};

use penumbra::{Device, DeviceChoice};
use pyo3::exceptions::PyTypeError;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::error::{error, of_library};

/// A device that renders take turns to use.
pub type Shared = Arc<Mutex<Device>>;

/// An open device, and the choice that opened it.
struct Open {
    choice: DeviceChoice,
    device: Shared,
}

static OPEN: Mutex<Vec<Open>> = Mutex::new(Vec::new());

/// The process that used the library first.
static PROCESS: OnceLock<u32> = OnceLock::new();

/// Does `work` without the interpreter's lock.
///
/// # Errors
/// If another process used the library, and this one was forked from it: a fork has neither the threads of its parent
/// nor its devices, and would wait for them for ever.
pub fn detached<T: Send>(py: Python<'_>, work: impl FnOnce() -> T + Send) -> PyResult<T> {
    if *PROCESS.get_or_init(process::id) != process::id() {
        return Err(error(
            "this process was forked from one that had used penumbra, and lacks its threads and devices: call \
             multiprocessing.set_start_method('spawn') before starting processes",
        ));
    }
    Ok(py.detach(work))
}

/// What a mutex guards. A render that panicked has left nothing half-done in a device.
pub fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(|poisoned| poisoned.into_inner())
}

thread_local! {
    /// Whether a render of this thread has a device: what its callback begins would wait for it for ever.
    static RENDERS: Cell<bool> = const { Cell::new(false) };
}

/// A device while a render uses it.
pub struct Turn<'a>(MutexGuard<'a, Device>);

impl<'a> Turn<'a> {
    /// Waits for the renders of other threads. A device that failed in one of them is replaced: one that lacked memory
    /// once refuses all later work.
    pub fn take(device: &'a Shared, choice: &DeviceChoice) -> penumbra::Result<Turn<'a>> {
        if RENDERS.get() {
            let problem = "a progress callback cannot use a device: its render holds one until the callback returns";
            return Err(penumbra::Error::Usage(problem.into()));
        }
        let mut guard = lock(device);
        if guard.check("device").is_err() {
            *guard = open_anew(choice)?;
        }
        RENDERS.set(true);
        Ok(Turn(guard))
    }
}

impl Drop for Turn<'_> {
    fn drop(&mut self) {
        RENDERS.set(false);
    }
}

impl Deref for Turn<'_> {
    type Target = Device;

    fn deref(&self) -> &Device {
        &self.0
    }
}

impl DerefMut for Turn<'_> {
    fn deref_mut(&mut self) -> &mut Device {
        &mut self.0
    }
}

/// The choice that a user makes by a name or an index.
pub fn choice(value: Option<&Bound<'_, PyAny>>) -> PyResult<DeviceChoice> {
    let Some(value) = value else { return Ok(DeviceChoice::Best) };
    let text = match value.extract::<u32>() {
        Ok(index) => index.to_string(),
        Err(_) => value.extract().map_err(|_| PyTypeError::new_err("device must be a name or an index"))?,
    };
    match text.parse::<DeviceChoice>() {
        Ok(choice) => Ok(choice),
    }
}

/// The device of that choice, which keeps its kernels: notebooks render the same scene again and again.
pub fn open(choice: &DeviceChoice) -> penumbra::Result<Shared> {
    let mut all = lock(&OPEN);
    if let Some(open) = all.iter().find(|open| open.choice == *choice) {
        return Ok(open.device.clone());
    }
    let device = Arc::new(Mutex::new(open_anew(choice)?));
    all.push(Open { choice: choice.clone(), device: device.clone() });
    Ok(device)
}

/// A device of its own.
pub fn open_anew(choice: &DeviceChoice) -> penumbra::Result<Device> {
    let device = Device::open(choice)?;
    device.keep_kernels();
    // The program's folder of kernels.
    if let Some(folder) = dirs::cache_dir() {
        device.keep_composed(folder.join("penumbra").join("kernels"));
    }
    Ok(device)
}

/// The Vulkan devices of this machine: a dict each, in the order of their indices.
#[pyfunction]
pub fn devices(py: Python<'_>) -> PyResult<Vec<Bound<'_, PyDict>>> {
    let found = detached(py, Device::list)?;
    if found.is_empty() {
        // The error says how to get a driver.
        detached(py, || Device::open(&DeviceChoice::Best).map(drop).map_err(penumbra::Error::from))?
            .map_err(of_library)?;
    }
    found.iter().map(|device| crate::result::dict(py, device)).collect()
}
