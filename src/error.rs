//! The one error type of the library. Every variant names what is at fault and what to do.
//!
//! Messages put the names of settings between backticks, as paths of fields: `` `visibility_map.nearest` ``. A program
//! that has other names for settings can replace these; the command line does. Names and other texts from files are
//! between double quotes instead, so that a camera `time` keeps its name.

use std::path::{Path, PathBuf};

use crate::input::printable;

/// Everything that can go wrong. The display form is one line for users.
///
/// ```
/// use penumbra::{Error, Settings};
///
/// let error = Settings::builder().audit(2.0).build().unwrap_err();
/// assert!(matches!(error, Error::Setting { name: "visibility_map.audit", .. }));
/// assert_eq!(error.to_string(), "`visibility_map.audit` is 2; it must be from 0 to 1");
/// ```
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// An input file that cannot be used: missing, damaged, unsupported or out of its own limits.
    #[error("{}: {}{problem}", file.display(), place(location))]
    Input {
        /// The file at fault, as the user named it.
        file: PathBuf,
        /// Where in the file: a JSON pointer (`/accessors/3`), an EXR channel, or `file` for the whole file, which the
        /// display form then leaves out.
        location: String,
        /// The problem, and the remedy where it is not obvious.
        problem: String,
    },
    /// An output file that cannot be written.
    #[error("{}: cannot write: {problem}", file.display())]
    Output {
        /// The file at fault, as the user named it.
        file: PathBuf,
        /// The message of the system or the encoder.
        problem: String,
    },
    /// A setting that is out of its range or contradicts another.
    #[error("`{name}` {problem}")]
    Setting {
        /// The setting, as the path of its field in [`crate::Settings`]: `visibility_map.nearest`. Or a field of
        /// [`crate::ImportOptions`].
        name: &'static str,
        /// The problem, and the setting's range.
        problem: String,
    },
    /// Wrong use of a function in another way, such as a name that does not exist.
    #[error("{0}")]
    Usage(String),
    /// No usable Vulkan device.
    #[error("no Vulkan device: {0}")]
    NoDevice(String),
    /// No display for a window.
    #[error("no display: {0}")]
    NoDisplay(String),
    /// The device was lost or timed out while it worked.
    #[error("device lost in {at}: {problem}")]
    DeviceLost {
        /// The pass or call that was under way.
        at: String,
        /// The message of the driver.
        problem: String,
    },
    /// The device has no memory left.
    #[error("out of device memory in {at}; render a smaller image, with fewer photons, or choose another device")]
    OutOfMemory {
        /// The buffer, pass or call that needed more.
        at: String,
    },
    /// The machine has too little memory for an image.
    #[error(
        "an image of {} x {} pixels needs at least {:.1} GB of memory, and {:.1} GB are available; {remedy}",
        size[0], size[1], *needed as f64 * 1e-9, *available as f64 * 1e-9
    )]
    Memory {
        /// Width and height in pixels of what is rendered: the image, or the part that is requested.
        size: [u32; 2],
        /// Bytes needed at least.
        needed: u64,
        /// Bytes available.
        available: u64,
        /// The remedy.
        remedy: String,
    },
    /// A kernel that does not compose, validate or bind. A defect of Penumbra, never of a scene.
    #[error("kernel {kernel}: {problem}")]
    Kernel {
        /// The stem of the kernel's file in `shaders/`.
        kernel: String,
        /// The message of the composer, the validator or the binder.
        problem: String,
    },
    /// A buffer that the device cannot hold.
    #[error("buffer {buffer}: {needed} bytes are needed, but the device allows {limit}; {remedy}")]
    Buffer {
        /// The buffer's label.
        buffer: String,
        /// Bytes needed.
        needed: u64,
        /// Bytes allowed by the device.
        limit: u64,
        /// The remedy.
        remedy: String,
    },
    /// A counter that a kernel raised: its result cannot be trusted.
    #[error("kernel {kernel}: {problem}")]
    Computation {
        /// The stem of the kernel's file in `shaders/`.
        kernel: String,
        /// The limit that was exceeded, how often, and what to do.
        problem: String,
    },
}

impl Error {
    /// An [`Error::Input`] at `location` in `file`.
    pub fn input(file: impl AsRef<Path>, location: impl Into<String>, problem: impl std::fmt::Display) -> Self {
        // Both may quote the file.
        let (location, problem) = (printable(&location.into()), printable(&problem.to_string()));
        Error::Input { file: file.as_ref().to_owned(), location, problem }
    }

    /// An [`Error::Setting`] for the field `name` of [`crate::Settings`] or [`crate::ImportOptions`]. `problem` starts
    /// with a verb.
    pub fn setting(name: &'static str, problem: impl Into<String>) -> Self {
        Error::Setting { name, problem: problem.into() }
    }

    /// An [`Error::Output`] for `file`.
    pub fn output(file: impl AsRef<Path>, problem: impl std::fmt::Display) -> Self {
        Error::Output { file: file.as_ref().to_owned(), problem: problem.to_string() }
    }

    /// An [`Error::Kernel`] for the kernel with that stem.
    pub fn kernel(kernel: impl Into<String>, problem: impl std::fmt::Display) -> Self {
        Error::Kernel { kernel: kernel.into(), problem: problem.to_string() }
    }

    /// The exit code of a process that ends with this error: 1 render failed, 2 usage, 3 bad input or output, 4 no
    /// device or display.
    pub fn exit_code(&self) -> u8 {
        match self {
            Error::Input { .. } | Error::Output { .. } => 3,
            Error::Setting { .. } | Error::Usage(_) => 2,
            Error::NoDevice(_) | Error::NoDisplay(_) | Error::DeviceLost { .. } => 4,
            Error::OutOfMemory { .. }
            | Error::Memory { .. }
            | Error::Kernel { .. }
            | Error::Buffer { .. }
            | Error::Computation { .. } => 1,
        }
    }
}

/// The kit has no photons and no scenes, so remedies for users of the renderer are added here.
impl From<kernel_kit::Error> for Error {
    fn from(error: kernel_kit::Error) -> Self {
        match error {
            kernel_kit::Error::NoDevice(problem) => Error::NoDevice(problem),
            kernel_kit::Error::DeviceLost { at, problem } => Error::DeviceLost { at, problem },
            kernel_kit::Error::OutOfMemory { at } => Error::OutOfMemory { at },
            kernel_kit::Error::Kernel { kernel, problem } => Error::Kernel { kernel, problem },
            kernel_kit::Error::Buffer { buffer, needed, limit } => Error::Buffer {
                buffer,
                needed,
                limit,
                remedy: "render with fewer photons or a smaller scene, or choose another device".to_owned(),
            },
        }
    }
}

/// The library's result.
pub type Result<T> = std::result::Result<T, Error>;

/// How [`Error::Input`] names a location. Problems of the whole file say so themselves.
fn place(location: &str) -> String {
    if location == "file" { String::new() } else { format!("{location}: ") }
}
