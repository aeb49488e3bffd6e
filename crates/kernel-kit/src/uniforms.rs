//! The uniform buffers of the kit: the parameters of kernels on devices without immediates, and the first workgroups of
//! sliced dispatches.

use std::num::NonZeroU64;

/// The group of these bindings: the last that every device has.
pub(crate) const GROUP: u32 = 3;
/// The first workgroup of a slice.
pub(crate) const FIRST_GROUP_BINDING: u32 = 0;
/// A kernel's parameters.
pub(crate) const PARAMETER_BINDING: u32 = 1;

/// Bytes of an entry: the coarsest alignment that WebGPU lets a device require, and more than immediates have.
pub(crate) const ENTRY_BYTES: u64 = 256;
/// Bytes of the binding of a first workgroup.
const FIRST_BYTES: u64 = 16;
/// Entries of a buffer, which then has 16 KiB.
const ENTRIES: u64 = 64;

/// Where the first workgroup of a dispatch is found.
#[derive(Clone, Copy)]
pub(crate) enum First<'a> {
    /// A number that the host supplies.
    Group(u32),
    /// A kernel wrote it to this entry of a buffer.
    Entry(&'a wgpu::Buffer, u32),
}

/// The layout of the group. wgpu makes equal layouts one.
pub(crate) fn layout(device: &wgpu::Device) -> wgpu::BindGroupLayout {
    let entry = |binding| wgpu::BindGroupLayoutEntry {
        binding,
        visibility: wgpu::ShaderStages::COMPUTE,
        ty: wgpu::BindingType::Buffer {
            ty: wgpu::BufferBindingType::Uniform,
            has_dynamic_offset: false,
            min_binding_size: None,
        },
        count: None,
    };
    let entries = [entry(FIRST_GROUP_BINDING), entry(PARAMETER_BINDING)];
    device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor { label: Some("kernel-kit"), entries: &entries })
}

/// The uniforms of the dispatches of a frame. They are written before these are submitted.
#[derive(Default)]
pub(crate) struct Uniforms {
    full: Vec<Chunk>,
    open: Option<Chunk>,
}

struct Chunk {
    buffer: wgpu::Buffer,
    bytes: Vec<u8>,
}

impl Uniforms {
    /// The group with these parameters.
    ///
    /// # Panics
    /// For more than [`ENTRY_BYTES`] bytes of parameters.
    pub(crate) fn bind(&mut self, device: &wgpu::Device, first: First<'_>, parameters: &[u8]) -> wgpu::BindGroup {
        if let Some(full) = self.open.take_if(|chunk| chunk.bytes.len() as u64 > (ENTRIES - 2) * ENTRY_BYTES) {
            self.full.push(full);
        }
        let chunk = self.open.get_or_insert_with(|| Chunk::new(device));
        let parameters = chunk.push(parameters);
        let first = match first {
            First::Group(first) => {
                let offset = chunk.push(&first.to_ne_bytes());
                (&chunk.buffer, offset)
            }
            First::Entry(buffer, index) => (buffer, u64::from(index) * ENTRY_BYTES),
        };
        group(device, first, (&chunk.buffer, parameters))
    }

    /// Writes what was bound, for the next submission.
    pub(crate) fn write(&mut self, queue: &wgpu::Queue) {
        for chunk in self.full.drain(..).chain(self.open.take()) {
            queue.write_buffer(&chunk.buffer, 0, &chunk.bytes);
        }
    }
}

impl Chunk {
    fn new(device: &wgpu::Device) -> Chunk {
        let buffer = device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("kernel-kit/uniforms"),
            size: ENTRIES * ENTRY_BYTES,
            usage: wgpu::BufferUsages::UNIFORM | wgpu::BufferUsages::COPY_DST,
            mapped_at_creation: false,
        });
        Chunk { buffer, bytes: Vec::new() }
    }

    fn push(&mut self, bytes: &[u8]) -> u64 {
        assert!(bytes.len() as u64 <= ENTRY_BYTES, "{} bytes of parameters", bytes.len());
        let offset = self.bytes.len();
        self.bytes.extend_from_slice(bytes);
        self.bytes.resize(offset + ENTRY_BYTES as usize, 0);
        offset as u64
    }
}

/// A group of buffers from these bytes on.
fn group(device: &wgpu::Device, first: (&wgpu::Buffer, u64), parameters: (&wgpu::Buffer, u64)) -> wgpu::BindGroup {
    let entry = |binding, (buffer, offset), size| wgpu::BindGroupEntry {
        binding,
        resource: wgpu::BindingResource::Buffer(wgpu::BufferBinding { buffer, offset, size: NonZeroU64::new(size) }),
    };
    let entries = [entry(FIRST_GROUP_BINDING, first, FIRST_BYTES), entry(PARAMETER_BINDING, parameters, ENTRY_BYTES)];
    let layout = &layout(device);
    device.create_bind_group(&wgpu::BindGroupDescriptor { label: Some("kernel-kit"), layout, entries: &entries })
}
