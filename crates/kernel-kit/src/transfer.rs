//! Making buffers and tables, and reading them back.

use std::borrow::Cow;

use bytemuck::{Pod, Zeroable};

use crate::buffer::{
    Buffer, EMPTY_BYTES, KernelTable, MIN_BYTES, POISON, TABLE_LAYER_ROWS, TABLE_WIDTH, Table, TableFormat,
    max_record_rows, table_rows,
};
use crate::device::Gpu;
use crate::error::{Error, Result, one_line};

impl Gpu {
    /// A zeroed buffer for `count` values of `T` (room for at least one).
    ///
    /// # Errors
    /// [`Error::Buffer`] if it exceeds what the device can bind.
    pub fn buffer<T: Pod>(&self, label: &str, count: usize) -> Result<Buffer> {
        let bytes = self.checked_bytes(label, (count * size_of::<T>()) as u64)?;
        let raw = self.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some(label),
            size: bytes,
            usage: usages(),
            mapped_at_creation: false,
        });
        self.check(label)?;
        Ok(Buffer { raw, first_byte: 0, label: label.to_owned(), bytes })
    }

    /// A buffer that holds `data`.
    ///
    /// # Errors
    /// As [`Gpu::buffer`].
    pub fn upload<T: Pod>(&self, label: &str, data: &[T]) -> Result<Buffer> {
        let bytes = self.checked_bytes(label, size_of_val(data) as u64)?;
        let data: &[u8] = bytemuck::cast_slice(data);
        let raw = self.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some(label),
            size: bytes,
            usage: usages(),
            mapped_at_creation: true,
        });
        // A lost device and one without memory give a buffer that cannot be mapped.
        match raw.get_mapped_range_mut(..) {
            Ok(mut view) => view.slice(..data.len()).copy_from_slice(data),
            Err(problem) => {
                self.check(label)?;
                return Err(Error::DeviceLost { at: label.to_owned(), problem: one_line(&problem.to_string()) });
            }
        }
        raw.unmap();
        Ok(Buffer { raw, first_byte: 0, label: label.to_owned(), bytes })
    }

    /// A buffer for `count` values of `T`, every word of it [`POISON`].
    ///
    /// # Errors
    /// As [`Gpu::buffer`].
    pub fn poisoned<T: Pod>(&self, label: &str, count: usize) -> Result<Buffer> {
        self.upload(label, &vec![POISON; (count * size_of::<T>()).div_ceil(4)])
    }

    /// Overwrites the start of `buffer`.
    pub fn write<T: Pod>(&self, buffer: &Buffer, data: &[T]) {
        self.queue.write_buffer(&buffer.raw, buffer.first_byte, bytemuck::cast_slice(data));
    }

    /// Reads the first `count` values of `buffer`, waiting for all submitted work.
    ///
    /// # Errors
    /// As [`Gpu::check`].
    pub fn read<T: Pod + Zeroable>(&self, buffer: &Buffer, count: usize) -> Result<Vec<T>> {
        self.read_from(buffer, 0, count)
    }

    /// Reads `count` values of `buffer` from number `first` on, whose offset must be a multiple of four bytes; as
    /// [`Gpu::read`].
    ///
    /// # Errors
    /// As [`Gpu::check`].
    pub fn read_from<T: Pod + Zeroable>(&self, buffer: &Buffer, first: usize, count: usize) -> Result<Vec<T>> {
        let bytes = (count * size_of::<T>()) as u64;
        if bytes == 0 {
            return Ok(Vec::new());
        }
        let staging = self.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("kernel-kit/read-back"),
            size: bytes.next_multiple_of(4),
            usage: wgpu::BufferUsages::MAP_READ | wgpu::BufferUsages::COPY_DST,
            mapped_at_creation: false,
        });
        let mut encoder = self.device.create_command_encoder(&Default::default());
        let at = buffer.first_byte + (first * size_of::<T>()) as u64;
        encoder.copy_buffer_to_buffer(&buffer.raw, at, &staging, 0, bytes.next_multiple_of(4));
        self.submit([encoder.finish()]);
        let mut data = vec![T::zeroed(); count];
        self.map(&staging, &buffer.label, |view| {
            bytemuck::cast_slice_mut(&mut data).copy_from_slice(&view[..bytes as usize])
        })?;
        Ok(data)
    }

    /// Maps a read-back buffer and hands its bytes to `use_bytes`.
    pub(crate) fn map(&self, staging: &wgpu::Buffer, at: &str, use_bytes: impl FnOnce(&[u8])) -> Result<()> {
        staging.map_async(wgpu::MapMode::Read, .., |_| ());
        self.wait(at)?;
        let lost = |e: wgpu::MapRangeError| Error::DeviceLost { at: at.to_owned(), problem: one_line(&e.to_string()) };
        use_bytes(&staging.get_mapped_range(..).map_err(lost)?);
        staging.unmap();
        Ok(())
    }

    /// A table that holds `records`.
    ///
    /// # Errors
    /// As [`Gpu::buffer`], for a texture's height too.
    pub fn table<T: Pod>(&self, label: &str, records: &[[T; 4]], format: TableFormat) -> Result<Table> {
        match self.texture_loads {
            true => self.texture_table(label, records, format),
            false => Ok(Table::Buffer(self.upload(label, records)?)),
        }
    }

    /// As [`Gpu::table`], in a texture on every device.
    ///
    /// # Errors
    /// As [`Gpu::table`].
    pub fn texture_table<T: Pod>(&self, label: &str, records: &[[T; 4]], format: TableFormat) -> Result<Table> {
        let texture = self.table_texture(label, records.len(), format)?;
        self.upload_table(label, &texture, bytemuck::cast_slice(records))?;
        Ok(Table::Texture(texture.create_view(&Default::default())))
    }

    /// Like [`Gpu::texture_table`], for more records than a texture has rows for, or a storage buffer bytes: in layers
    /// of [`TABLE_LAYER_ROWS`] rows. Kernels read it as a `texture_storage_2d_array`.
    ///
    /// # Errors
    /// [`Error::Buffer`] if the device has no texture with this many layers, and those of [`Gpu::check`] if it has no
    /// room.
    pub fn layered_table<T: Pod>(&self, label: &str, records: &[[T; 4]], format: TableFormat) -> Result<Table> {
        let layers = records.len().div_ceil((TABLE_LAYER_ROWS * TABLE_WIDTH) as usize).max(1) as u64;
        let most = u64::from(self.limits.max_texture_array_layers);
        if layers > most {
            let bytes = |layers: u64| layers * u64::from(TABLE_LAYER_ROWS * TABLE_WIDTH) * 16;
            return Err(Error::Buffer { buffer: label.to_owned(), needed: bytes(layers), limit: bytes(most) });
        }
        let texture = self.texture_of(label, [TABLE_LAYER_ROWS, layers as u32], format);
        self.check(label)?;
        self.upload_table(label, &texture, bytemuck::cast_slice(records))?;
        let dimension = Some(wgpu::TextureViewDimension::D2Array);
        Ok(Table::Texture(texture.create_view(&wgpu::TextureViewDescriptor { dimension, ..Default::default() })))
    }

    /// Uploads the records of a table, as many rows at a time as a layer has, so that few bytes are in memory twice.
    fn upload_table(&self, label: &str, texture: &wgpu::Texture, bytes: &[u8]) -> Result<()> {
        const ROW_BYTES: usize = TABLE_WIDTH as usize * 16;
        let rows = texture.height() * texture.depth_or_array_layers();
        for first in (0..rows).step_by(TABLE_LAYER_ROWS as usize) {
            let height = TABLE_LAYER_ROWS.min(rows - first);
            let begin = first as usize * ROW_BYTES;
            let end = begin + height as usize * ROW_BYTES;
            // The last rows, of which some may be empty.
            let padded = || {
                let mut rest = bytes[begin.min(bytes.len())..].to_vec();
                rest.resize(end - begin, 0);
                Cow::Owned(rest)
            };
            let part = bytes.get(begin..end).map_or_else(padded, Cow::Borrowed);
            self.queue.write_texture(
                wgpu::TexelCopyTextureInfo {
                    origin: wgpu::Origin3d { x: 0, y: first % texture.height(), z: first / texture.height() },
                    ..texture.as_image_copy()
                },
                &part,
                wgpu::TexelCopyBufferLayout { offset: 0, bytes_per_row: Some(ROW_BYTES as u32), rows_per_image: None },
                wgpu::Extent3d { width: TABLE_WIDTH, height, depth_or_array_layers: 1 },
            );
            if rows > TABLE_LAYER_ROWS {
                // wgpu keeps its copy of the part until the device has it.
                self.submit([]);
                self.wait(label)?;
            }
        }
        Ok(())
    }

    /// A table of `count` zeros, for [`Frame::fill_table`](crate::Frame::fill_table).
    ///
    /// # Errors
    /// As [`Gpu::table`].
    pub fn empty_table(&self, label: &str, count: usize, format: TableFormat) -> Result<Table> {
        if !self.texture_loads {
            return Ok(Table::Buffer(self.buffer::<[u32; 4]>(label, count)?));
        }
        Ok(Table::Texture(self.table_texture(label, count, format)?.create_view(&Default::default())))
    }

    /// The table of the records that kernels write to `buffer`.
    ///
    /// # Errors
    /// As [`Gpu::table`].
    pub fn table_of(&self, buffer: Buffer, format: TableFormat) -> Result<KernelTable> {
        let table = match self.texture_loads {
            true => self.empty_table(&buffer.label, (buffer.bytes / 16) as usize, format)?,
            false => Table::Buffer(buffer.clone()),
        };
        Ok(KernelTable { buffer, table })
    }

    /// The texture of a table of `count` records, for kernels' results that are copied into it.
    ///
    /// # Errors
    /// [`Error::Buffer`] if the device has no texture of that height.
    pub fn table_texture(&self, label: &str, count: usize, format: TableFormat) -> Result<wgpu::Texture> {
        let rows = count.div_ceil(TABLE_WIDTH as usize);
        let height = u32::try_from(rows).map_or(rows as u64, |rows| u64::from(table_rows(rows)));
        if height > u64::from(self.limits.max_texture_dimension_2d) {
            return Err(Error::Buffer {
                buffer: label.to_owned(),
                needed: height * u64::from(TABLE_WIDTH) * 16,
                limit: u64::from(self.limits.max_texture_dimension_2d) * u64::from(TABLE_WIDTH) * 16,
            });
        }
        Ok(self.texture_of(label, [height as u32, 1], format))
    }

    fn texture_of(&self, label: &str, [height, layers]: [u32; 2], format: TableFormat) -> wgpu::Texture {
        self.device.create_texture(&wgpu::TextureDescriptor {
            label: Some(label),
            size: wgpu::Extent3d { width: TABLE_WIDTH, height, depth_or_array_layers: layers },
            mip_level_count: 1,
            sample_count: 1,
            dimension: wgpu::TextureDimension::D2,
            format: match format {
                TableFormat::Float => wgpu::TextureFormat::Rgba32Float,
                TableFormat::Uint => wgpu::TextureFormat::Rgba32Uint,
            },
            // Kernels read them as storage textures, or as sampled ones where the device has few of those.
            usage: wgpu::TextureUsages::STORAGE_BINDING
                | wgpu::TextureUsages::TEXTURE_BINDING
                | wgpu::TextureUsages::COPY_DST,
            view_formats: &[],
        })
    }

    /// Records of the largest table without layers.
    pub fn max_table_records(&self) -> u64 {
        match self.texture_loads {
            true => u64::from(max_record_rows(self.limits.max_texture_dimension_2d)) * u64::from(TABLE_WIDTH),
            false => self.max_buffer_bytes() / 16,
        }
    }

    /// Bytes of the largest buffer that kernels can bind.
    pub fn max_buffer_bytes(&self) -> u64 {
        self.limits.max_storage_buffer_binding_size.min(self.limits.max_buffer_size)
    }

    fn checked_bytes(&self, label: &str, bytes: u64) -> Result<u64> {
        let bytes = if bytes == 0 { EMPTY_BYTES } else { bytes.next_multiple_of(4).max(MIN_BYTES) };
        let limit = self.max_buffer_bytes();
        if bytes > limit {
            return Err(Error::Buffer { buffer: label.to_owned(), needed: bytes, limit });
        }
        Ok(bytes)
    }
}

fn usages() -> wgpu::BufferUsages {
    use wgpu::BufferUsages as U;
    U::STORAGE | U::COPY_SRC | U::COPY_DST | U::INDIRECT | U::UNIFORM
}
