//! Intel's Open Image Denoise 2, loaded at run time through its C interface (`OpenImageDenoise/oidn.h`). This is the
//! only file of the crate with unsafe code.

use std::ffi::{CStr, c_char, c_int, c_void};
use std::mem::ManuallyDrop;
use std::path::{Path, PathBuf};

use kernel_kit::Gpu;
use libloading::Library;

use super::statistical::typical;
use super::{Colour, Filter, Filtered, Guides, Noisy, on_all_cores};
use crate::{Error, Result};

/// The library's names on the loader's path, on Linux, macOS and Windows.
const NAMES: [&str; 4] =
    ["libOpenImageDenoise.so.2", "libOpenImageDenoise.so", "libOpenImageDenoise.dylib", "OpenImageDenoise.dll"];

/// Constants of `oidn.h`.
const DEVICE_TYPE_CPU: c_int = 1;
const ERROR_NONE: c_int = 0;
const FORMAT_FLOAT3: c_int = 3;
const QUALITY_BALANCED: c_int = 5;
const QUALITY_HIGH: c_int = 6;

/// Versions that have this interface: major * 10,000 + minor * 100 + patch.
const VERSIONS: std::ops::Range<c_int> = 20_000..30_000;

/// Samples of a pixel from which on guides need no filter of their own: in four scenes the error was then the same to
/// within a hundredth, while at 16 samples it was up to 4 % less with filtered guides, and at 2 to 4 up to 60 %.
const CLEAN_SAMPLES: u32 = 64;

type Device = *mut c_void;
type RawFilter = *mut c_void;
type Name = *const c_char;

/// `oidnSetSharedFilterImage`: filter, name, pixels, format, width, height, byte offset, and bytes from pixel to pixel
/// and from row to row, 0 if there are no gaps.
type SetImage = unsafe extern "C" fn(RawFilter, Name, *mut c_void, c_int, usize, usize, usize, usize, usize);

/// The functions of the library that are used here.
struct Functions {
    new_device: unsafe extern "C" fn(c_int) -> Device,
    set_device_bool: unsafe extern "C" fn(Device, Name, bool),
    commit_device: unsafe extern "C" fn(Device),
    release_device: unsafe extern "C" fn(Device),
    device_error: unsafe extern "C" fn(Device, *mut Name) -> c_int,
    device_int: unsafe extern "C" fn(Device, Name) -> c_int,
    new_filter: unsafe extern "C" fn(Device, Name) -> RawFilter,
    set_image: SetImage,
    set_filter_bool: unsafe extern "C" fn(RawFilter, Name, bool),
    set_filter_int: unsafe extern "C" fn(RawFilter, Name, c_int),
    commit_filter: unsafe extern "C" fn(RawFilter),
    execute_filter: unsafe extern "C" fn(RawFilter),
    release_filter: unsafe extern "C" fn(RawFilter),
}

impl Functions {
    /// The functions of the library, or the name of a missing one.
    fn of(library: &Library) -> std::result::Result<Functions, &'static str> {
        macro_rules! function {
            ($name:literal) => {
                // SAFETY: the types of the fields are those of `oidn.h`, and the library is never unloaded.
                *unsafe { library.get(concat!($name, "\0").as_bytes()) }.map_err(|_| $name)?
            };
        }
        Ok(Functions {
            new_device: function!("oidnNewDevice"),
            set_device_bool: function!("oidnSetDeviceBool"),
            commit_device: function!("oidnCommitDevice"),
            release_device: function!("oidnReleaseDevice"),
            device_error: function!("oidnGetDeviceError"),
            device_int: function!("oidnGetDeviceInt"),
            new_filter: function!("oidnNewFilter"),
            set_image: function!("oidnSetSharedFilterImage"),
            set_filter_bool: function!("oidnSetFilterBool"),
            set_filter_int: function!("oidnSetFilterInt"),
            commit_filter: function!("oidnCommitFilter"),
            execute_filter: function!("oidnExecuteFilter"),
            release_filter: function!("oidnReleaseFilter"),
        })
    }
}

/// Seconds of a processor core for a pixel of an image that is filtered: 5.2 s for three images of 512 x 512 pixels
/// (version 2.5.1).
const SECONDS_PER_PIXEL: f64 = 7e-6;

/// The time of a run over guides, over that of a run over colour: 0.13 s and 0.33 s for 256 x 256 pixels.
const GUIDE_RUN: f64 = 0.4;

/// The library, with a device on the CPU, which gives the same bits on every run.
pub struct OpenImageDenoise {
    functions: Functions,
    device: Device,
    /// The file, as it was named or found.
    file: PathBuf,
    /// Kept for as long as the process lives: the library's threads may outlive its device.
    _library: ManuallyDrop<Library>,
}

/// An image that a filter reads or writes.
struct Picture<'a> {
    name: &'static CStr,
    pixels: *mut c_void,
    /// Keeps the pixels for as long as the filter may use them.
    _borrowed: std::marker::PhantomData<&'a [Colour]>,
}

impl<'a> Picture<'a> {
    fn input(name: &'static CStr, pixels: &'a [Colour]) -> Picture<'a> {
        Picture { name, pixels: pixels.as_ptr().cast_mut().cast(), _borrowed: std::marker::PhantomData }
    }
}

impl OpenImageDenoise {
    /// Loads the library `file`, which the loader searches for if it names no folder; or the first of the library's
    /// usual names that the loader finds.
    ///
    /// # Errors
    /// [`Error::Input`] if there is no such library, if it is another one, or another version.
    pub fn load(file: Option<&Path>) -> Result<OpenImageDenoise> {
        let (file, library) = match file {
            Some(file) => (file.to_owned(), open(file).map_err(|problem| unusable(file, &problem))?),
            None => NAMES
                .iter()
                .find_map(|name| Some((PathBuf::from(name), open(Path::new(name)).ok()?)))
                .ok_or_else(|| unusable(Path::new(NAMES[0]), "the loader finds no library of this name"))?,
        };
        let library = ManuallyDrop::new(library);
        let functions = Functions::of(&library)
            .map_err(|name| unusable(&file, &format!("it has no function {name}, which version 2 has")))?;
        // SAFETY: any device type is a valid argument; the result may be null.
        let device = unsafe { (functions.new_device)(DEVICE_TYPE_CPU) };
        let opened = OpenImageDenoise { functions, device, file, _library: library };
        opened.commit_device()?;
        Ok(opened)
    }

    /// Checks the device and its version, and prepares it.
    fn commit_device(&self) -> Result<()> {
        if self.device.is_null() {
            return self.check("device");
        }
        // SAFETY: the device is valid, and the names end with a zero.
        let version = unsafe { (self.functions.device_int)(self.device, c"version".as_ptr()) };
        if !VERSIONS.contains(&version) {
            let version = format!("{}.{}", version / 10_000, version / 100 % 100);
            return Err(unusable(&self.file, &format!("it is version {version}, but version 2 is required")));
        }
        // SAFETY: as above. Threads that are bound to cores would hinder those of the renderer.
        unsafe { (self.functions.set_device_bool)(self.device, c"setAffinity".as_ptr(), false) };
        // SAFETY: as above.
        unsafe { (self.functions.commit_device)(self.device) };
        self.check("device")
    }

    /// The error of a call before, if there was one.
    fn check(&self, at: &str) -> Result<()> {
        let mut message: Name = std::ptr::null();
        // SAFETY: the device is valid or null, which stands for the errors of the thread; `message` is a valid target.
        let code = unsafe { (self.functions.device_error)(self.device, &mut message) };
        if code == ERROR_NONE && !self.device.is_null() {
            return Ok(());
        }
        let text = if message.is_null() {
            format!("error {code}")
        } else {
            // SAFETY: a message is a string that ends with a zero, valid until the next call from this thread.
            unsafe { CStr::from_ptr(message) }.to_string_lossy().into_owned()
        };
        Err(Error::input(&self.file, at, format!("Open Image Denoise failed: {text}")))
    }

    /// Runs the filter `RT` on images of the same size.
    fn execute(
        &self,
        [width, height]: [u32; 2],
        inputs: &[Picture],
        options: &[&'static CStr],
        quality: c_int,
    ) -> Result<Vec<Colour>> {
        let mut output = vec![[0f32; 3]; width as usize * height as usize];
        let functions = &self.functions;
        // SAFETY: the device is valid, and the name ends with a zero.
        let filter = unsafe { (functions.new_filter)(self.device, c"RT".as_ptr()) };
        if filter.is_null() {
            self.check("filter")?;
            return Err(Error::input(
                &self.file,
                "filter",
                "Open Image Denoise failed: it made no filter, and gave no reason",
            ));
        }
        let result = Picture { name: c"output", pixels: output.as_mut_ptr().cast(), _borrowed: Default::default() };
        for Picture { name, pixels, .. } in inputs.iter().chain([&result]) {
            let (width, height) = (width as usize, height as usize);
            // SAFETY: the filter is valid. Callers give as many pixels as the size says, of three floats each, which
            // live until the filter is released below. Inputs are only read.
            unsafe { (functions.set_image)(filter, name.as_ptr(), *pixels, FORMAT_FLOAT3, width, height, 0, 0, 0) };
        }
        for name in options {
            // SAFETY: the filter is valid, and the name ends with a zero.
            unsafe { (functions.set_filter_bool)(filter, name.as_ptr(), true) };
        }
        // SAFETY: as above.
        unsafe { (functions.set_filter_int)(filter, c"quality".as_ptr(), quality) };
        // SAFETY: the filter is valid, and its images are.
        unsafe { (functions.commit_filter)(filter) };
        // SAFETY: as above. The call returns when the output is complete.
        unsafe { (functions.execute_filter)(filter) };
        let outcome = self.check("filter");
        // SAFETY: the filter is valid, and not used again.
        unsafe { (functions.release_filter)(filter) };
        outcome.map(|()| output)
    }

    /// The guides, denoised: they are noisy at edges, and where glass or rough mirrors are seen. The lower
    /// quality takes less than half of the time, and the error of the image stays the same to within 4 %.
    fn denoise_guides(&self, size: [u32; 2], guides: &Guides) -> Result<[Vec<Colour>; 2]> {
        let run = |guide: Picture| self.execute(size, &[guide], &[], QUALITY_BALANCED);
        Ok([run(Picture::input(c"albedo", &guides.albedo))?, run(Picture::input(c"normal", &guides.normal))?])
    }

    /// The colour, denoised with albedo and normals as guides, which the library takes to be free of noise.
    fn denoise(&self, size: [u32; 2], colour: &[Colour], [albedo, normal]: [&[Colour]; 2]) -> Result<Vec<Colour>> {
        let inputs =
            [Picture::input(c"color", colour), Picture::input(c"albedo", albedo), Picture::input(c"normal", normal)];
        self.execute(size, &inputs, &[c"hdr", c"cleanAux"], QUALITY_HIGH)
    }
}

impl Filter for OpenImageDenoise {
    fn name(&self) -> &'static str {
        "oidn"
    }

    fn filter(&self, _: &Gpu, noisy: &Noisy) -> Result<Filtered> {
        let (size, guides) = (noisy.size, &noisy.guides);
        let filtered =
            (noisy.half_samples.iter().sum::<u32>() < CLEAN_SAMPLES).then(|| self.denoise_guides(size, guides));
        let filtered = filtered.transpose()?;
        let [albedo, normal] = filtered.as_ref().map_or([&guides.albedo, &guides.normal], |guides| guides.each_ref());
        let raw = noisy.all.colour();
        // The library takes light far below 1 for black, and returns light that is not there.
        let unit = typical(&raw);
        let run = |colour: Vec<Colour>| -> Result<Vec<Colour>> {
            let scaled = |factor: f32| move |pixel: Colour| pixel.map(|value| value * factor);
            let colour: Vec<Colour> = colour.into_iter().map(scaled(1.0 / unit)).collect();
            let filtered = self.denoise(size, &colour, [albedo, normal])?;
            Ok(filtered.into_iter().map(scaled(unit)).collect())
        };
        let halves = noisy.halves.as_ref().map(|[a, b]| Ok::<_, Error>([run(a.colour())?, run(b.colour())?]));
        Ok(Filtered { all: run(raw)?, halves: halves.transpose()? })
    }

    fn seconds_per_pixel(&self, _: &Gpu, runs: u32) -> f64 {
        // Albedo and normals are filtered too.
        on_all_cores((f64::from(runs) + 2.0 * GUIDE_RUN) * SECONDS_PER_PIXEL)
    }
}

impl Drop for OpenImageDenoise {
    fn drop(&mut self) {
        if !self.device.is_null() {
            // SAFETY: the device is valid, and not used again.
            unsafe { (self.functions.release_device)(self.device) };
        }
    }
}

/// Opens a library, or returns why it cannot be opened.
fn open(file: &Path) -> std::result::Result<Library, String> {
    if file.components().count() > 1 && !file.exists() {
        return Err("there is no such file".into());
    }
    // SAFETY: the library runs its own code when it is loaded. Users name it, or have it on the loader's path.
    unsafe { Library::new(file) }.map_err(|problem| problem.to_string())
}

/// The error of a library that cannot be used.
fn unusable(file: &Path, problem: &str) -> Error {
    let remedy = "install version 2 (https://www.openimagedenoise.org) and name its library with `oidn_library`";
    Error::input(file, "library", format!("cannot be used as Open Image Denoise: {problem}; {remedy}"))
}
