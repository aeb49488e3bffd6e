//! Recording dispatches, and timing them on the device.

use std::collections::BTreeMap;

use bytemuck::Pod;

use crate::buffer::{Buffer, KernelTable, TABLE_WIDTH, Table, TableFormat};
use crate::compose::MAX_GROUPS;
use crate::device::Gpu;
use crate::error::Result;
use crate::kernel::BoundKernel;
use crate::slices::arguments_of;
use crate::uniforms::{First, GROUP, Uniforms};

/// Dispatches recorded to be submitted together.
pub struct Frame<'g> {
    gpu: &'g Gpu,
    /// The encoder, for copies between dispatches.
    pub encoder: wgpu::CommandEncoder,
    label: String,
    uniforms: Uniforms,
}

/// The dispatch size for `groups` workgroups: a second dimension where one does not hold them. Kernels find the
/// linear group index with `group_index` of `package::kit`; groups past the last are theirs to ignore.
pub fn dispatch_size(groups: u32) -> [u32; 3] {
    if groups <= MAX_GROUPS { [groups, 1, 1] } else { [MAX_GROUPS, groups.div_ceil(MAX_GROUPS), 1] }
}

impl Gpu {
    /// Starts a frame. `label` names it in errors.
    pub fn frame(&self, label: &str) -> Frame<'_> {
        let uniforms = Uniforms::default();
        Frame { gpu: self, encoder: self.encoder(label), label: label.to_owned(), uniforms }
    }

    fn encoder(&self, label: &str) -> wgpu::CommandEncoder {
        self.device.create_command_encoder(&wgpu::CommandEncoderDescriptor { label: Some(label) })
    }

    fn send(&self, recorded: wgpu::CommandEncoder, uniforms: &mut Uniforms) {
        uniforms.write(&self.queue);
        self.pace().begin();
        self.submit([recorded.finish()]);
    }

    /// Runs a kernel once, in a frame of its own, without waiting for it; as [`Frame::run`].
    ///
    /// # Errors
    /// As [`Gpu::check`].
    ///
    /// # Panics
    /// As [`Frame::run`].
    pub fn run(&self, kernel: &BoundKernel, items: u32, immediates: &impl Pod) -> Result<()> {
        let mut frame = self.frame(&kernel.label);
        frame.run(kernel, items, immediates);
        frame.submit()
    }

    /// Seconds spent on the device so far by label of pass; empty where it has no timestamps.
    ///
    /// # Errors
    /// As [`Gpu::check`].
    pub fn pass_times(&self) -> Result<BTreeMap<String, f64>> {
        let mut timer = self.timer();
        if let Some((copy, timestamps)) = timer.resolve(&self.device) {
            self.submit([copy]);
            let staging = timestamps.staging.clone();
            self.map(&staging, "timestamps", |bytes| timer.add(timestamps, bytes))?;
        }
        Ok(timer.seconds().clone())
    }

    /// As [`Gpu::pass_times`], as far as they were read before the device was lost.
    pub fn known_pass_times(&self) -> BTreeMap<String, f64> {
        self.timer().seconds().clone()
    }

    /// A table of what kernels wrote into `buffer`, which is whole rows of [`TABLE_WIDTH`] records: copied into a
    /// texture where tables are textures.
    ///
    /// # Errors
    /// As [`Gpu::table_texture`].
    pub fn kernel_table(&self, frame: &mut Frame<'_>, buffer: Buffer, format: TableFormat) -> Result<Table> {
        if !self.texture_loads {
            return Ok(Table::Buffer(buffer));
        }
        let texture = self.table_texture(&buffer.label, (buffer.bytes / 16) as usize, format)?;
        frame.copy_to_table(&buffer, &texture);
        Ok(Table::Texture(texture.create_view(&Default::default())))
    }
}

impl Frame<'_> {
    /// Runs the kernel with one invocation for each of `items` (rounded up to whole workgroups; kernels check).
    /// `immediates` are its parameters: `&()` for a kernel that has none.
    ///
    /// # Panics
    /// If the kernel takes more bytes of immediates than there are.
    pub fn run(&mut self, kernel: &BoundKernel, items: u32, immediates: &impl Pod) {
        let groups = items.div_ceil(kernel.interface.workgroup_size);
        let sliced = kernel.interface.sliced;
        let most = if sliced { self.gpu.pace().groups_of_slice(&kernel.label, groups) } else { groups };
        if groups <= most {
            let size = dispatch_size(groups);
            self.pass(kernel, immediates, First::Group(0), |pass| {
                pass.dispatch_workgroups(size[0], size[1], size[2]);
            });
            return self.submit_if_due();
        }
        // Rows of workgroups would overlap the next slice.
        let most = most.min(MAX_GROUPS);
        for first in (0..groups).step_by(most as usize) {
            let count = most.min(groups - first);
            self.pass(kernel, immediates, First::Group(first), |pass| pass.dispatch_workgroups(count, 1, 1));
            self.submit_so_far();
        }
    }

    /// Runs the kernel with the workgroups that `arguments` holds at byte `offset` when the device comes to it.
    ///
    /// # Panics
    /// As [`Frame::run`].
    pub fn run_indirect(&mut self, kernel: &BoundKernel, arguments: &Buffer, offset: u64, immediates: &impl Pod) {
        let offset = arguments.first_byte + offset;
        let slices = if kernel.interface.sliced { self.gpu.pace().slices(&kernel.label) } else { 1 };
        if slices == 1 {
            self.pass(kernel, immediates, First::Group(0), |pass| {
                pass.dispatch_workgroups_indirect(&arguments.raw, offset);
            });
            return self.submit_if_due();
        }
        let slicer = self.gpu.slicer();
        let sliced = slicer.record(&self.gpu.device, &mut self.encoder, &arguments.raw, offset, slices);
        for slice in 0..slices {
            self.pass(kernel, immediates, First::Entry(&sliced, slice), |pass| {
                pass.dispatch_workgroups_indirect(&sliced, arguments_of(slice));
            });
            self.submit_so_far();
        }
    }

    fn pass(
        &mut self,
        kernel: &BoundKernel,
        immediates: &impl Pod,
        first: First<'_>,
        dispatch: impl FnOnce(&mut wgpu::ComputePass<'_>),
    ) {
        self.gpu.translate_if_late(kernel);
        let interface = &kernel.interface;
        let (given, needed) = (bytemuck::bytes_of(immediates), interface.immediate_bytes as usize);
        let label = &kernel.label;
        assert!(given.len() >= needed, "kernel {label} takes {needed} bytes of immediates, {} are given", given.len());
        let given = &given[..needed];
        let mut timer = self.gpu.timer();
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
        if interface.takes_uniforms() {
            pass.set_bind_group(GROUP, &self.uniforms.bind(&self.gpu.device, first, given), &[]);
        }
        if needed > 0 && !interface.uniform_parameters {
            pass.set_immediates(0, given);
        }
        dispatch(&mut pass);
    }

    /// Submits what was recorded so far, if it takes as long as a watchdog allows.
    fn submit_if_due(&mut self) {
        if self.gpu.pace().is_due() {
            self.submit_so_far();
        }
    }

    /// Submits what was recorded so far.
    fn submit_so_far(&mut self) {
        let next = self.gpu.encoder(&self.label);
        let recorded = std::mem::replace(&mut self.encoder, next);
        self.gpu.send(recorded, &mut self.uniforms);
    }

    /// Zeroes a buffer.
    pub fn clear(&mut self, buffer: &Buffer) {
        self.encoder.clear_buffer(&buffer.raw, buffer.first_byte, Some(buffer.bytes));
    }

    /// Copies the first `bytes` bytes of a buffer to another, from byte `at` on.
    pub fn copy(&mut self, from: &Buffer, to: &Buffer, at: u64, bytes: u64) {
        self.encoder.copy_buffer_to_buffer(&from.raw, from.first_byte, &to.raw, to.first_byte + at, bytes);
    }

    /// Copies the whole rows that a buffer has, or as many as the texture has, into a table's texture.
    pub fn copy_to_table(&mut self, buffer: &Buffer, texture: &wgpu::Texture) {
        let rows = (buffer.bytes / u64::from(TABLE_WIDTH * 16)) as u32;
        debug_assert!(rows > 0, "a buffer that is copied to a table is padded to whole rows");
        self.copy_to_texture(buffer, texture, 0, [TABLE_WIDTH, rows.min(texture.height())]);
    }

    /// Copies records from a buffer, which begins at the table's first row, to a rectangle of the table's texture.
    fn copy_to_texture(&mut self, buffer: &Buffer, texture: &wgpu::Texture, first_row: u32, [width, rows]: [u32; 2]) {
        self.encoder.copy_buffer_to_texture(
            wgpu::TexelCopyBufferInfo {
                buffer: &buffer.raw,
                layout: wgpu::TexelCopyBufferLayout {
                    offset: buffer.first_byte + u64::from(first_row) * u64::from(TABLE_WIDTH * 16),
                    bytes_per_row: Some(TABLE_WIDTH * 16),
                    rows_per_image: None,
                },
            },
            wgpu::TexelCopyTextureInfo {
                origin: wgpu::Origin3d { x: 0, y: first_row, z: 0 },
                ..texture.as_image_copy()
            },
            wgpu::Extent3d { width, height: rows, depth_or_array_layers: 1 },
        );
    }

    /// Makes the first `records` records that kernels have written readable as a table.
    ///
    /// # Panics
    /// If the table has fewer.
    pub fn publish(&mut self, written: &KernelTable, records: u32) {
        assert!(u64::from(records) * 16 <= written.buffer.bytes, "{} has fewer records", written.buffer.label);
        let Table::Texture(view) = &written.table else { return };
        let (rows, rest) = (records / TABLE_WIDTH, records % TABLE_WIDTH);
        if rows > 0 {
            self.copy_to_texture(&written.buffer, view.texture(), 0, [TABLE_WIDTH, rows]);
        }
        if rest > 0 {
            self.copy_to_texture(&written.buffer, view.texture(), rows, [rest, 1]);
        }
    }

    /// Copies a buffer into a table of as many records, which are whole rows of [`TABLE_WIDTH`].
    pub fn fill_table(&mut self, from: &Buffer, to: &Table) {
        match to {
            Table::Texture(view) => self.copy_to_table(from, view.texture()),
            Table::Buffer(buffer) => self.copy(from, buffer, 0, from.bytes.min(buffer.bytes)),
        }
    }

    /// Submits what was recorded.
    ///
    /// # Errors
    /// As [`Gpu::check`].
    pub fn submit(mut self) -> Result<()> {
        self.gpu.send(self.encoder, &mut self.uniforms);
        let full = self.gpu.timer().nearly_full();
        if full {
            self.gpu.pass_times()?;
        }
        self.gpu.check(&self.label)
    }
}
