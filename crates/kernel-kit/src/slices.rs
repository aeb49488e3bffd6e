//! Slices of indirect dispatches: a kernel makes the arguments of one into those of several.

use crate::compose::MAX_GROUPS;
use crate::pace::MAX_SLICES;
use crate::pipeline::own_pipeline;
use crate::uniforms::ENTRY_BYTES;

/// Makes `count` slices of the dispatch whose arguments begin at word `first_word`. A slice is an entry of 256 bytes:
/// its first workgroup, which the kit's uniforms bind, then its arguments. Rows of workgroups would overlap the next
/// slice: only the last one has several.
const KERNEL: &str = "
struct Request { first_word: u32, count: u32, max_groups: u32 }
@group(0) @binding(0) var<storage, read> arguments: array<u32>;
@group(0) @binding(1) var<storage, read_write> slices: array<array<u32, 64>>;
@group(0) @binding(2) var<uniform> request: Request;
@compute @workgroup_size(64)
fn slice(@builtin(local_invocation_index) i: u32) {
    if i >= request.count { return; }
    let word = request.first_word;
    let groups = arguments[word] * arguments[word + 1u] * arguments[word + 2u];
    let share = min((groups + request.count - 1u) / request.count, request.max_groups);
    let first = min(i * share, groups);
    let rest = groups - first;
    let own = select(min(share, rest), rest, i + 1u == request.count);
    slices[i][0] = first;
    slices[i][1] = min(own, request.max_groups);
    slices[i][2] = (own + request.max_groups - 1u) / request.max_groups;
    slices[i][3] = 1u;
}";

const _: () = assert!(MAX_SLICES <= 64 && ENTRY_BYTES == 256);

/// The kernel.
pub(crate) struct Slicer {
    pipeline: wgpu::ComputePipeline,
}

impl Slicer {
    pub(crate) fn new(device: &wgpu::Device) -> Slicer {
        Slicer { pipeline: own_pipeline(device, "kernel-kit/slice", KERNEL) }
    }

    /// Records the slicing of a dispatch whose arguments begin at byte `first_byte` of `arguments`. Slice i has its
    /// arguments at byte [`arguments_of`] (i) of the result.
    pub(crate) fn record(
        &self,
        device: &wgpu::Device,
        encoder: &mut wgpu::CommandEncoder,
        arguments: &wgpu::Buffer,
        first_byte: u64,
        count: u32,
    ) -> wgpu::Buffer {
        let buffer = |size, usage, mapped_at_creation| {
            device.create_buffer(&wgpu::BufferDescriptor {
                label: Some("kernel-kit/slices"),
                size,
                usage,
                mapped_at_creation,
            })
        };
        use wgpu::BufferUsages as U;
        let slices = buffer(u64::from(count) * ENTRY_BYTES, U::STORAGE | U::UNIFORM | U::INDIRECT, false);
        let request = buffer(16, U::UNIFORM, true);
        // A lost device gives a buffer that cannot be mapped; what comes of it is not read.
        if let Ok(mut view) = request.get_mapped_range_mut(..) {
            let words = [(first_byte / 4) as u32, count, MAX_GROUPS, 0];
            view.slice(..).copy_from_slice(bytemuck::bytes_of(&words));
        }
        request.unmap();
        let group = device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("kernel-kit/slice"),
            layout: &self.pipeline.get_bind_group_layout(0),
            entries: &[(0, arguments), (1, &slices), (2, &request)]
                .map(|(binding, buffer)| wgpu::BindGroupEntry { binding, resource: buffer.as_entire_binding() }),
        });
        let mut pass = encoder.begin_compute_pass(&Default::default());
        pass.set_pipeline(&self.pipeline);
        pass.set_bind_group(0, &group, &[]);
        pass.dispatch_workgroups(1, 1, 1);
        drop(pass);
        slices
    }
}

/// Where the arguments of a slice are.
pub(crate) fn arguments_of(slice: u32) -> u64 {
    u64::from(slice) * ENTRY_BYTES + 4
}
