//! The device and what runs on it: buffers, kernel composition and binding, timing, read-back.
//!
//! This is also the kernel test kit: compose a kernel ([`compose::compose_source`]), make a [`Kernel`],
//! poison its outputs ([`Gpu::poisoned`]), bind them by their WGSL names ([`Resources`]), run it
//! ([`Gpu::frame`]) and read back ([`Gpu::read`]).

mod ahead;
pub mod buffer;
pub mod compose;
pub mod device;
pub mod frame;
pub mod kernel;
pub mod layout;

pub use buffer::{Buffer, Table};
pub use compose::Features;
pub use device::{DeviceChoice, DeviceInfo, Gpu};
pub use frame::Frame;
pub use kernel::{Binding, Bindings, BoundKernel, Kernel, Resources};
