//! Recording dispatches, and timing them on the device.

use std::collections::BTreeMap;

use bytemuck::Pod;

use crate::Result;

use super::buffer::Buffer;
use super::{BoundKernel, Gpu};

/// Dispatches recorded to be submitted together.
pub struct Frame<'g> {
    gpu: &'g Gpu,
    /// The encoder, for copies between dispatches.
    pub encoder: wgpu::CommandEncoder,
    label: String,
}

/// Most workgroups in one dimension of a dispatch (WebGPU's limit, and lavapipe's).
pub const MAX_GROUPS: u32 = 65_535;

/// The dispatch size for `groups` workgroups: a second dimension where one does not hold them. The kernels'
/// linear group index is `x + y * size.x`; groups past the last are for the kernel to ignore.
pub fn dispatch_size(groups: u32) -> [u32; 3] {
    if groups <= MAX_GROUPS { [groups, 1, 1] } else { [MAX_GROUPS, groups.div_ceil(MAX_GROUPS), 1] }
}

impl Gpu {
    /// Starts a frame. `label` names it in errors.
    pub fn frame(&self, label: &str) -> Frame<'_> {
        let encoder = self.device.create_command_encoder(&wgpu::CommandEncoderDescriptor { label: Some(label) });
        Frame { gpu: self, encoder, label: label.to_owned() }
    }

    /// Seconds spent on the device so far by label of pass; empty where it has no timestamps.
    ///
    /// # Errors
    /// As [`Gpu::check`].
    pub fn pass_times(&self) -> Result<BTreeMap<String, f64>> {
        let mut timer = self.timer.lock().unwrap_or_else(|e| e.into_inner());
        timer.collect(self)?;
        Ok(timer.seconds.clone())
    }

    /// As [`Gpu::pass_times`], as far as they were read before the device was lost.
    pub fn known_pass_times(&self) -> BTreeMap<String, f64> {
        self.timer.lock().unwrap_or_else(|e| e.into_inner()).seconds.clone()
    }
}

impl Frame<'_> {
    /// Runs the kernel with one invocation for each of `items` (rounded up to whole workgroups; kernels check).
    pub fn run(&mut self, kernel: &BoundKernel, items: u32, immediates: &impl Pod) {
        let size = dispatch_size(items.div_ceil(kernel.workgroup_size));
        self.pass(kernel, immediates, |pass| pass.dispatch_workgroups(size[0], size[1], size[2]));
    }

    /// Runs the kernel with the workgroups that `arguments` holds at byte `offset` when its turn comes.
    pub fn run_indirect(&mut self, kernel: &BoundKernel, arguments: &Buffer, offset: u64, immediates: &impl Pod) {
        self.pass(kernel, immediates, |pass| pass.dispatch_workgroups_indirect(&arguments.raw, offset));
    }

    fn pass(&mut self, kernel: &BoundKernel, immediates: &impl Pod, dispatch: impl FnOnce(&mut wgpu::ComputePass<'_>)) {
        let mut timer = self.gpu.timer.lock().unwrap_or_else(|e| e.into_inner());
        let writes = timer.next(&kernel.label);
        let mut pass = self.encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
            label: Some(&kernel.label),
            timestamp_writes: writes.as_ref().map(|(set, begin)| wgpu::ComputePassTimestampWrites {
                query_set: set,
                beginning_of_pass_write_index: Some(*begin),
                end_of_pass_write_index: Some(*begin + 1),
            }),
        });
        pass.set_pipeline(&kernel.pipeline);
        for (index, group) in kernel.groups.iter().enumerate() {
            pass.set_bind_group(index as u32, group, &[]);
        }
        let bytes = bytemuck::bytes_of(immediates);
        if kernel.immediate_bytes > 0 {
            pass.set_immediates(0, &bytes[..kernel.immediate_bytes as usize]);
        }
        dispatch(&mut pass);
    }

    /// Zeroes a buffer.
    pub fn clear(&mut self, buffer: &Buffer) {
        self.encoder.clear_buffer(&buffer.raw, 0, None);
    }

    /// Copies the first `bytes` bytes of a buffer to another, from byte `at` on.
    pub fn copy(&mut self, from: &Buffer, to: &Buffer, at: u64, bytes: u64) {
        self.encoder.copy_buffer_to_buffer(&from.raw, 0, &to.raw, at, bytes);
    }

    /// Copies the first `records` records of a buffer into a table's texture.
    pub fn copy_to_table(&mut self, buffer: &Buffer, texture: &wgpu::Texture) {
        let width = super::buffer::TABLE_WIDTH;
        let rows = (buffer.bytes / u64::from(width * 16)) as u32;
        debug_assert!(rows > 0, "a buffer that is copied to a table is padded to whole rows");
        self.encoder.copy_buffer_to_texture(
            wgpu::TexelCopyBufferInfo {
                buffer: &buffer.raw,
                layout: wgpu::TexelCopyBufferLayout {
                    offset: 0,
                    bytes_per_row: Some(width * 16),
                    rows_per_image: None,
                },
            },
            texture.as_image_copy(),
            wgpu::Extent3d { width, height: rows.min(texture.height()), depth_or_array_layers: 1 },
        );
    }

    /// Submits what was recorded.
    ///
    /// # Errors
    /// As [`Gpu::check`].
    pub fn submit(self) -> Result<()> {
        self.gpu.queue.submit([self.encoder.finish()]);
        let full = self.gpu.timer.lock().unwrap_or_else(|e| e.into_inner()).nearly_full();
        if full {
            self.gpu.pass_times()?;
        }
        self.gpu.check(&self.label)
    }
}

/// Timestamps of passes.
pub(super) struct Timer {
    queries: Option<wgpu::QuerySet>,
    period_s: f64,
    pending: Vec<String>,
    seconds: BTreeMap<String, f64>,
}

/// Passes between two read-backs of the timestamps: half of WebGPU's 4,096 queries to a set.
const PASSES: u32 = 2048;

impl Timer {
    pub(super) fn new(device: &wgpu::Device, queue: &wgpu::Queue, present: bool) -> Self {
        let queries = present.then(|| {
            device.create_query_set(&wgpu::QuerySetDescriptor {
                label: Some("penumbra/timestamps"),
                ty: wgpu::QueryType::Timestamp,
                count: PASSES * 2,
            })
        });
        let period_s = f64::from(queue.get_timestamp_period()) * 1e-9;
        Timer { queries, period_s, pending: Vec::new(), seconds: BTreeMap::new() }
    }

    /// The query set and first index for a pass; none where the device has no timestamps or the set is full (a
    /// frame of more passes than [`PASSES`]: the rest of it goes untimed).
    fn next(&mut self, label: &str) -> Option<(wgpu::QuerySet, u32)> {
        let queries = self.queries.as_ref()?;
        let index = self.pending.len() as u32;
        if index >= PASSES {
            return None;
        }
        self.pending.push(label.to_owned());
        Some((queries.clone(), index * 2))
    }

    fn nearly_full(&self) -> bool {
        self.pending.len() as u32 > PASSES / 2
    }

    fn collect(&mut self, gpu: &Gpu) -> Result<()> {
        let Some(queries) = self.queries.as_ref().filter(|_| !self.pending.is_empty()) else { return Ok(()) };
        let count = self.pending.len() as u32 * 2;
        let bytes = u64::from(count) * 8;
        let buffer = |usage| {
            gpu.device.create_buffer(&wgpu::BufferDescriptor {
                label: Some("penumbra/timestamps"),
                size: bytes,
                usage,
                mapped_at_creation: false,
            })
        };
        let resolved = buffer(wgpu::BufferUsages::QUERY_RESOLVE | wgpu::BufferUsages::COPY_SRC);
        let staging = buffer(wgpu::BufferUsages::MAP_READ | wgpu::BufferUsages::COPY_DST);
        let mut encoder = gpu.device.create_command_encoder(&Default::default());
        encoder.resolve_query_set(queries, 0..count, &resolved, 0);
        encoder.copy_buffer_to_buffer(&resolved, 0, &staging, 0, bytes);
        gpu.queue.submit([encoder.finish()]);
        let labels = std::mem::take(&mut self.pending);
        let (period_s, seconds) = (self.period_s, &mut self.seconds);
        gpu.map(&staging, "timestamps", |view| {
            let ticks: Vec<u64> = bytemuck::pod_collect_to_vec(view);
            for (label, pair) in labels.into_iter().zip(ticks.chunks_exact(2)) {
                *seconds.entry(label).or_default() += pair[1].saturating_sub(pair[0]) as f64 * period_s;
            }
        })
    }
}
