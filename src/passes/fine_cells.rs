//! Pass `fine_cells`: classifies areas of surface a few pixels wide by the shadow rays of earlier samples.

use kernel_kit::{BoundKernel, Buffer, Frame, Gpu, Kernel, Table, TableFormat, bindings, shared_struct, whole_rows};

use super::kernel;
use crate::Result;
use crate::gpu_scene::CameraUniform;
use crate::specialisation::features::Features;

shared_struct! {
    /// The view for which cells are a few pixels wide, and the size of their table; see `shaders/lib/fine_cell.wgsl`.
    pub struct FineCellView {
        /// Position of the camera, in normalised space.
        pub eye: [f32; 3],
        /// Width of a pixel at unit distance from the eye; 0 in an orthographic view.
        pub slope: f32,
        /// Width of a pixel in an orthographic view, else 0.
        pub width: f32,
        /// Entries of the table, a power of two, less one.
        pub mask: u32,
        /// 1 if the table takes no new cells.
        pub closed: u32,
        /// To a multiple of 16 bytes.
        pub padding: u32,
    }
}

shared_struct! {
    /// A fine cell, or an empty entry of their table; see `shaders/lib/fine_cell.wgsl`.
    pub struct FineCell {
        /// Position along each axis, in widths of a cell.
        pub index: [i32; 3],
        /// Light, side of the surface, and size.
        pub kind: u32,
        /// Points with a shadow ray that reached the light.
        pub illumination: u32,
        /// Points with one that did not.
        pub shadow: u32,
        /// In entry i of the table, the entry of the i-th cell that was added: together, a list of all cells.
        pub listed: u32,
        /// To a multiple of 16 bytes.
        pub padding: u32,
    }
}

impl FineCellView {
    /// The view of a camera whose image has `height` pixel rows, and a table of `entries` entries, a power of two.
    pub fn new(camera: &CameraUniform, height: u32, entries: u32) -> FineCellView {
        let half = glam::Vec3::from(camera.up).length();
        let pixel = 2.0 * half / height as f32;
        let (slope, width) = if camera.orthographic == 1 { (0.0, pixel) } else { (pixel, 0.0) };
        FineCellView { eye: camera.position, slope, width, mask: entries - 1, closed: 0, padding: 0 }
    }
}

bindings! {
    /// The table for passes that look up cells and add photons; empty if there are no fine cells.
    #[derive(Default)]
    pub struct FineCellBindings {
        /// [`FineCellTable::view`].
        pub fine_cell_view: Option<&Buffer>,
        /// [`FineCellTable::cells`].
        pub fine_cells: Option<&Buffer>,
        /// [`FineCellTable::tags`].
        pub fine_cell_tags: Option<&Buffer>,
        /// [`FineCellTable::tag_table`].
        pub fine_cell_tag_table: Option<&Table>,
    }
}

/// The pass; see `shaders/fine_cells.wgsl`.
pub struct FineCells(Kernel);

/// The table of fine cells.
pub struct FineCellTable {
    /// [`FineCellView`].
    pub view: Buffer,
    /// [`FineCell`]s.
    pub cells: Buffer,
    /// For each entry, a hash of its cell with the [`crate::kernels::Class`]; 0 if the entry is empty. Then the words
    /// of [`FineCellTable::count`], and padding.
    pub tags: Buffer,
    /// The tags when [`FineCellTable::publish`] copied them last.
    pub tag_table: Table,
    entries: usize,
}

impl FineCells {
    /// Compiles the kernel; `nearest` is k, the photons that decide a cell.
    ///
    /// # Errors
    /// As [`Kernel::new`].
    pub fn new(gpu: &Gpu, features: &Features, nearest: u32) -> Result<FineCells> {
        Ok(FineCells(kernel(gpu, "fine_cells", features, &[("nearest", f64::from(nearest))], &[])?))
    }

    /// Binds the pass to a table.
    ///
    /// # Errors
    /// As [`Kernel::bind`].
    pub fn bind(&self, gpu: &Gpu, table: &FineCellTable) -> Result<BoundKernel> {
        Ok(self.0.bind(gpu, "classify_fine_cells", &[&table.bindings()])?)
    }
}

impl FineCellTable {
    /// An empty table with the view's number of entries.
    ///
    /// # Errors
    /// As [`Gpu::buffer`].
    pub fn new(gpu: &Gpu, view: FineCellView) -> Result<FineCellTable> {
        let entries = view.mask as usize + 1;
        let records = whole_rows((entries + 2).div_ceil(4));
        Ok(FineCellTable {
            view: gpu.upload("penumbra/fine_cells/view", &[view])?,
            cells: gpu.buffer::<FineCell>("penumbra/fine_cells/cells", entries)?,
            tags: gpu.buffer::<[u32; 4]>("penumbra/fine_cells/tags", records)?,
            tag_table: gpu.empty_table("penumbra/fine_cells/tag_table", records, TableFormat::Uint)?,
            entries,
        })
    }

    /// The table's buffers, by their names.
    pub fn bindings(&self) -> FineCellBindings<'_> {
        FineCellBindings {
            fine_cell_view: Some(&self.view),
            fine_cells: Some(&self.cells),
            fine_cell_tags: Some(&self.tags),
            fine_cell_tag_table: Some(&self.tag_table),
        }
    }

    /// Number of cells in the table, and of searches that found neither their cell nor an entry for it.
    ///
    /// # Errors
    /// As [`Gpu::read`].
    pub fn count(&self, gpu: &Gpu) -> Result<[u32; 2]> {
        let counts = gpu.read_from::<u32>(&self.tags, self.entries, 2)?;
        Ok([counts[0], counts[1]])
    }

    /// Lets look-ups find the cells and their classes as they are now.
    pub fn publish(&self, frame: &mut Frame<'_>) {
        frame.fill_table(&self.tags, &self.tag_table);
    }

    /// Bytes on the device.
    pub fn bytes(&self) -> u64 {
        // The tags twice: the table has a copy.
        self.view.bytes + self.cells.bytes + 2 * self.tags.bytes
    }
}
