//! Buffers and tables: data in the device's memory.

/// A storage buffer with its label, or a part of one. Clones are the same buffer.
#[derive(Clone)]
pub struct Buffer {
    pub(crate) raw: wgpu::Buffer,
    /// Where it begins in `raw`.
    pub(crate) first_byte: u64,
    /// Names the buffer in errors and in the driver's tools, such as `<pass>/<buffer>`.
    pub label: String,
    /// Size in bytes, a multiple of 4 and at least 16.
    pub bytes: u64,
}

impl Buffer {
    /// The buffer itself, for what the kit does not do; of a part, the whole that it is of.
    pub fn raw(&self) -> &wgpu::Buffer {
        &self.raw
    }

    /// `bytes` of the buffer from `first_byte` on, for a kernel that needs no more. Devices allow few bindings: a
    /// kernel that needs all parts can bind the whole buffer as one. A dispatch cannot write one part and only read
    /// another.
    ///
    /// # Panics
    /// If the part does not lie in the buffer, or begins where bindings cannot: at no multiple of [`PART_ALIGNMENT`].
    #[must_use]
    pub fn part(&self, label: &str, first_byte: u64, bytes: u64) -> Buffer {
        assert!(
            first_byte + bytes <= self.bytes && first_byte.is_multiple_of(PART_ALIGNMENT),
            "{label} is no part of a buffer"
        );
        Buffer { raw: self.raw.clone(), first_byte: self.first_byte + first_byte, label: label.to_owned(), bytes }
    }
}

/// Where parts of buffers may begin, in bytes: the coarsest alignment that WebGPU lets a device require.
pub const PART_ALIGNMENT: u64 = 256;

/// Read-only records of four 32-bit words that kernels look up at random: a texture of width
/// [`TABLE_WIDTH`] where [`Gpu::texture_loads`](crate::Gpu::texture_loads), a storage buffer elsewhere. Clones are the
/// same table.
#[derive(Clone)]
pub enum Table {
    /// Texel i is at (i % width, i / width), or in layers ([`Gpu::layered_table`](crate::Gpu::layered_table)).
    Texture(wgpu::TextureView),
    /// Word quadruple i.
    Buffer(Buffer),
}

/// Records that kernels write to a buffer, and that kernels read from a table after
/// [`Frame::publish`](crate::Frame::publish). Where tables are buffers, the table is the buffer.
#[derive(Clone)]
pub struct KernelTable {
    /// The buffer that kernels write.
    pub buffer: Buffer,
    /// The table that kernels read.
    pub table: Table,
}

/// The type of a table's words.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TableFormat {
    /// `texture_storage_2d<rgba32float, read>` or `array<vec4f>`.
    Float,
    /// `texture_storage_2d<rgba32uint, read>` or `array<vec4u>`.
    Uint,
}

/// Rows of a layer of a layered table: 64 MiB. Devices have 256 layers, and Vulkan promises 2 GiB to an image.
pub const TABLE_LAYER_ROWS: u32 = 1024;

/// Width of a table's texture in texels. Kernels find texel i at `(i & (TABLE_WIDTH - 1), i >> TABLE_WIDTH_LOG2)`, and
/// the row of a layered table by [`TABLE_LAYER_ROWS`]; the module `package::kit` has these constants. WebGPU promises
/// textures of twice this width.
pub const TABLE_WIDTH: u32 = 4096;

/// Records of a buffer that is to become a table of `records`: whole rows.
pub fn whole_rows(records: usize) -> usize {
    records.next_multiple_of(TABLE_WIDTH as usize).max(TABLE_WIDTH as usize)
}

/// Rows of the texture of a table with `rows` rows of records. The height is never a power of two: drivers on the CPU
/// (llvmpipe) translate a kernel once more for textures of such a height.
pub(crate) fn table_rows(rows: u32) -> u32 {
    match rows {
        0..3 => 3,
        _ => rows + u32::from(rows.is_power_of_two()),
    }
}

/// Rows of records of the largest table whose texture has at most `max_height` rows.
pub(crate) fn max_record_rows(max_height: u32) -> u32 {
    (0..=max_height).rev().find(|rows| table_rows(*rows) <= max_height).unwrap_or(0)
}

/// Value that fills buffers before a kernel under test runs. It is not a small count and, read as a float, it is NaN,
/// so a word that the kernel did not write shows.
pub const POISON: u32 = 0xffff_dead;

/// Bytes of the smallest buffer that is not empty: a `vec4` is 16 bytes.
pub(crate) const MIN_BYTES: u64 = 16;

/// Bytes of a buffer of no elements. A binding must have room for one element, and the structs in arrays of kernels are
/// smaller than this.
pub(crate) const EMPTY_BYTES: u64 = 256;
