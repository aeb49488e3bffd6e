//! The one error type of the kit.

/// An error on a device or in a kernel. The display form is one line that names the device, the kernel or the buffer,
/// and the remedy.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum Error {
    /// No usable Vulkan device.
    #[error("no Vulkan device: {0}")]
    NoDevice(String),
    /// The device was lost or timed out while it worked.
    #[error("device lost in {at}: {problem}; open it again, and submit less work at once if it timed out")]
    DeviceLost {
        /// The kernel, buffer or call that was under way.
        at: String,
        /// The driver's message.
        problem: String,
    },
    /// The device has no memory left.
    #[error("out of device memory in {at}; use smaller buffers or choose another device")]
    OutOfMemory {
        /// The buffer, kernel or call that there was none for.
        at: String,
    },
    /// A kernel that does not compose, validate, compile or bind: a defect of the kernel or of its host code.
    #[error("kernel {kernel}: {problem}")]
    Kernel {
        /// The name that the kernel was composed under.
        kernel: String,
        /// The message of the composer, the validator, the driver or the binder.
        problem: String,
    },
    /// A buffer that the device cannot hold.
    #[error(
        "buffer {buffer}: {needed} bytes are needed, but the device allows {limit}; use a smaller one \
         or choose another device"
    )]
    Buffer {
        /// The buffer's label.
        buffer: String,
        /// Bytes needed.
        needed: u64,
        /// Bytes that the device allows.
        limit: u64,
    },
}

impl Error {
    /// An [`Error::Kernel`] for the kernel of that name.
    pub fn kernel(kernel: impl Into<String>, problem: impl std::fmt::Display) -> Self {
        Error::Kernel { kernel: kernel.into(), problem: problem.to_string() }
    }
}

/// The kit's result.
pub type Result<T> = std::result::Result<T, Error>;

/// A diagnostic on one line, without a terminal's colours: errors of wgpu and of the composer are paragraphs.
pub(crate) fn one_line(text: &str) -> String {
    let mut plain = String::new();
    let mut in_escape = false;
    for c in text.chars() {
        match c {
            '\u{1b}' => in_escape = true,
            'm' if in_escape => in_escape = false,
            _ if in_escape => {}
            _ => plain.push(c),
        }
    }
    plain.split_whitespace().collect::<Vec<_>>().join(" ")
}
