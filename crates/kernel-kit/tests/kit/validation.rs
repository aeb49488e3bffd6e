//! A fault that nothing but a validation layer finds.

use kernel_kit::{Gpu, kernel_test, wgpu};
use wgpu::hal::api::Vulkan;

/// Two writes to a buffer without a barrier between them, which wgpu does not see. Without a validation layer nothing
/// reports it; a command that runs this test under the layer must fail.
#[kernel_test]
#[ignore = "it has a fault on purpose: under the validation layer its command fails"]
fn a_missing_barrier_is_for_the_validation_layer(gpu: &Gpu) {
    let filled = gpu.device.create_buffer(&wgpu::BufferDescriptor {
        label: Some("test/filled"),
        size: 256,
        usage: wgpu::BufferUsages::COPY_DST,
        mapped_at_creation: false,
    });
    let mut encoder = gpu.device.create_command_encoder(&Default::default());
    // SAFETY: the device and the buffer are used until the device has been waited for. Either word may win: nothing
    // reads them.
    unsafe {
        let device = gpu.device.as_hal::<Vulkan>().unwrap().raw_device().clone();
        let buffer = filled.as_hal::<Vulkan>().unwrap().raw_handle();
        encoder.as_hal_mut::<Vulkan, _, _>(|encoder| {
            let commands = encoder.unwrap().raw_handle();
            device.cmd_fill_buffer(commands, buffer, 0, 256, 1);
            device.cmd_fill_buffer(commands, buffer, 0, 256, 2);
        });
    }
    gpu.queue.submit([encoder.finish()]);
    gpu.wait("test").unwrap();
}
