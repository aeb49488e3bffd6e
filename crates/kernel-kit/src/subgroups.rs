//! The size of subgroups on a device.

use crate::pipeline::own_pipeline;

/// Writes for each invocation its lane and the lanes of its subgroup.
const KERNEL: &str = "
@group(0) @binding(0) var<storage, read_write> found: array<vec2u, 128>;
@compute @workgroup_size(64)
fn probe(
    @builtin(workgroup_id) group: vec3u,
    @builtin(local_invocation_index) index: u32,
    @builtin(subgroup_invocation_id) lane: u32,
    @builtin(subgroup_size) size: u32,
) {
    found[64u * group.x + index] = vec2u(lane, size);
}";

/// Invocations of two workgroups, eight bytes each.
const BYTES: u64 = 128 * 8;

/// Lanes of a subgroup, if kernels can use subgroups, all have the same number, and consecutive invocations of a
/// workgroup are the lanes of one subgroup, which Vulkan does not guarantee: a kernel tests it.
pub(crate) fn subgroup_size(info: &wgpu::AdapterInfo, device: &wgpu::Device, queue: &wgpu::Queue) -> Option<u32> {
    let size = info.subgroup_min_size;
    let usable = device.features().contains(wgpu::Features::SUBGROUP) && size == info.subgroup_max_size;
    let found = if usable { probe(device, queue)? } else { return None };
    found.iter().zip(0..).all(|(found, index)| *found == [index % size, size]).then_some(size)
}

/// The result of [`KERNEL`]; `None` if the device cannot run it.
fn probe(device: &wgpu::Device, queue: &wgpu::Queue) -> Option<Vec<[u32; 2]>> {
    let pipeline = own_pipeline(device, "kernel-kit/subgroups", KERNEL);
    use wgpu::BufferUsages as U;
    let [found, staging] = [U::STORAGE | U::COPY_SRC, U::MAP_READ | U::COPY_DST].map(|usage| {
        let label = Some("kernel-kit/subgroups");
        device.create_buffer(&wgpu::BufferDescriptor { label, size: BYTES, usage, mapped_at_creation: false })
    });
    let group = device.create_bind_group(&wgpu::BindGroupDescriptor {
        label: Some("kernel-kit/subgroups"),
        layout: &pipeline.get_bind_group_layout(0),
        entries: &[wgpu::BindGroupEntry { binding: 0, resource: found.as_entire_binding() }],
    });
    let mut encoder = device.create_command_encoder(&Default::default());
    let mut pass = encoder.begin_compute_pass(&Default::default());
    pass.set_pipeline(&pipeline);
    pass.set_bind_group(0, &group, &[]);
    pass.dispatch_workgroups(2, 1, 1);
    drop(pass);
    encoder.copy_buffer_to_buffer(&found, 0, &staging, 0, BYTES);
    queue.submit([encoder.finish()]);
    staging.map_async(wgpu::MapMode::Read, .., |_| ());
    device.poll(wgpu::PollType::wait_indefinitely()).ok()?;
    let bytes = staging.get_mapped_range(..).ok()?;
    Some(bytemuck::pod_collect_to_vec(&bytes))
}
