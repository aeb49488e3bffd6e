#![doc = include_str!("../README.md")]
#![warn(missing_docs)]

// Macros name the crate from inside it as users do.
extern crate self as kernel_kit;

mod adapted;
mod adapter;
mod ahead;
mod binding;
mod buffer;
pub mod compare;
mod compose;
mod device;
mod digest;
mod error;
mod feature;
mod frame;
mod kernel;
mod kernel_folder;
mod layout;
mod pace;
mod pipeline;
mod slices;
mod subgroups;
pub mod test;
mod timer;
mod transfer;
mod uniforms;

pub use adapter::{DeviceChoice, DeviceInfo, DeviceLimits, instance};
pub use binding::{Binding, Bindings, Declared, Resources};
pub use buffer::{
    Buffer, KernelTable, PART_ALIGNMENT, POISON, TABLE_LAYER_ROWS, TABLE_WIDTH, Table, TableFormat, whole_rows,
};
pub use compose::{Composed, Composer, MAX_GROUPS, Taken, constants_module};
pub use device::{Compilation, Gpu};
pub use error::{Error, Result};
pub use feature::{Feature, Features, NoFeature};
#[doc(hidden)]
pub use feature::{snake as __snake, snake_length as __snake_length};
pub use frame::{Frame, dispatch_size};
pub use kernel::{BoundKernel, Host, Kernel};
pub use layout::{Member, OpaqueStruct, SharedStruct, check_layouts};

/// Makes a test of a function that takes the tests' device, `fn name(gpu: &Gpu)`, with its attributes and what it
/// returns.
///
/// The environment variable [`test::VARIABLE`] chooses the device, or the one in the attribute:
/// `#[kernel_test("MY_DEVICE")]`. A machine without such a device fails the test. In code that is not built for tests
/// (a doc test) the function is a plain one without parameters.
///
/// ```
/// use kernel_kit::{Gpu, kernel_test};
///
/// /// The device is open.
/// #[kernel_test]
/// fn device_is_open(gpu: &Gpu) {
///     gpu.check("test").unwrap();
/// }
/// # fn main() { device_is_open(); }
/// ```
pub use kernel_kit_macros::kernel_test;

// What the macros expand to, and what users need in the same version.
pub use bytemuck;
pub use include_dir;
pub use wgpu;
