//! Pass `grid`: sorts photons by light and cell, and classifies whole cells.
//!
//! The sort is a counting sort: count (each photon takes its rank in its cell), scan, scatter. Then each cell that
//! holds photons is classified. Where the nearest k photons are of one kind for every point on the cell's surface, the
//! class of a point is one look-up instead of a search.

use std::rc::Rc;

use kernel_kit::{
    Binding, Bindings, BoundKernel, Buffer, Frame, Gpu, Kernel, Table, TableFormat, bindings, shared_struct, whole_rows,
};

use super::kernel;
use crate::kernels::{GridShape, MAX_LIGHTS, SCAN_SERIAL, photon_word};
use crate::settings::Settings;
use crate::specialisation::features::Features;
use crate::{Error, Result};

shared_struct! {
    /// A photon of the visibility map or the global map.
    pub struct Photon {
        /// Position of the hit, in normalised space.
        pub position: [f32; 3],
        /// Bits 0-13: normal on the side that it hit; bit 31: shadow photon. In the visibility map, bits 14-24: light,
        /// 25-30: weight exponent w (the photon represents 2^(w/4) hits). In the global map, bits 14-28: flux in red,
        /// green and blue, 29-30: exponent of the flux. See [`photon_word`].
        pub word: u32,
    }
}

impl Photon {
    /// The light that emitted it. Photons of the visibility map alone have one.
    pub fn light(&self) -> u32 {
        (self.word >> photon_word::LIGHT_SHIFT) & (MAX_LIGHTS - 1)
    }
}

/// Photons on the device, in a buffer that grows with them, up to the largest that the device can bind.
pub(super) struct PhotonBuffer {
    /// [`Photon`]s.
    pub buffer: Buffer,
    /// Photons in the buffer.
    pub count: usize,
    /// Photons for which the buffer has room.
    pub room: usize,
    label: &'static str,
}

impl PhotonBuffer {
    /// An empty buffer with room for `expected` photons, or as many as the device can bind.
    ///
    /// # Errors
    /// As [`Gpu::buffer`].
    pub fn new(gpu: &Gpu, label: &'static str, expected: usize) -> Result<PhotonBuffer> {
        let room = expected.clamp(1, max_photons(gpu));
        Ok(PhotonBuffer { buffer: gpu.buffer::<Photon>(label, room)?, count: 0, room, label })
    }

    /// Appends the first `count` of `photons`, and keeps room for `spare` more. Returns false, and appends none, if the
    /// device cannot bind a buffer for so many.
    ///
    /// # Errors
    /// As [`Gpu::buffer`].
    pub fn append(&mut self, gpu: &Gpu, photons: &Buffer, count: usize, spare: usize) -> Result<bool> {
        if !self.reserve(gpu, self.count + count + spare)? {
            return Ok(false);
        }
        let mut frame = gpu.frame("photons");
        frame.copy(photons, &self.buffer, photon_bytes(self.count), photon_bytes(count));
        frame.submit()?;
        self.count += count;
        Ok(true)
    }

    /// Makes room for `needed` photons, those in the buffer included. Returns false if the device cannot bind a buffer
    /// for so many.
    ///
    /// # Errors
    /// As [`Gpu::buffer`].
    pub fn reserve(&mut self, gpu: &Gpu, needed: usize) -> Result<bool> {
        if needed > max_photons(gpu) {
            return Ok(false);
        }
        if needed > self.room {
            // Twice the room, so that all copies together move fewer photons than the buffer holds in the end.
            let room = (2 * self.room).max(needed).min(max_photons(gpu));
            let larger = gpu.buffer::<Photon>(self.label, room)?;
            let mut frame = gpu.frame("photons");
            frame.copy(&self.buffer, &larger, 0, photon_bytes(self.count));
            frame.submit()?;
            (self.buffer, self.room) = (larger, room);
        }
        Ok(true)
    }
}

/// Bytes of that many photons.
fn photon_bytes(photons: usize) -> u64 {
    (photons * size_of::<Photon>()) as u64
}

/// The photons of the largest buffer that the device can bind.
fn max_photons(gpu: &Gpu) -> usize {
    (gpu.max_buffer_bytes() / size_of::<Photon>() as u64) as usize
}

/// Checks that a photon map can sort the photons of this many lights.
///
/// # Errors
/// [`Error::Usage`] for a number out of 1 to [`MAX_LIGHTS`].
pub(super) fn check_lights(lights: u32) -> Result<()> {
    if !(1..=MAX_LIGHTS).contains(&lights) {
        return Err(Error::Usage(format!("a photon map is for 1 to {MAX_LIGHTS} lights, not {lights}")));
    }
    Ok(())
}

/// Checks that queries can count `nearest` photons.
///
/// # Errors
/// [`Error::Setting`] for a `nearest` out of 1 to [`Settings::MAX_NEAREST`].
pub(super) fn check_nearest(nearest: u32) -> Result<()> {
    if !(1..=Settings::MAX_NEAREST).contains(&nearest) {
        let max = Settings::MAX_NEAREST;
        return Err(Error::setting("visibility_map.nearest", format!("is {nearest}; it must be from 1 to {max}")));
    }
    Ok(())
}

shared_struct! {
    /// Immediates of the pass; see `shaders/grid.wgsl`.
    pub struct GridParameters {
        grid: GridShape,
        photon_count: u32,
        cell_count: u32,
        scan_blocks: u32,
        padding: u32,
    }
}

impl GridParameters {
    fn new(shape: GridShape, lights: u32, photon_count: u32) -> GridParameters {
        let cell_count = shape.cells().saturating_mul(lights);
        let scan_blocks = cell_count.div_ceil(SCAN_SERIAL);
        GridParameters { grid: shape, photon_count, cell_count, scan_blocks, padding: 0 }
    }
}

bindings! {
    /// Buffers of the sort.
    struct SortBindings {
        pub photons: &Buffer,
        pub cell_counts: &Buffer,
        pub photon_ranks: &Buffer,
        pub block_sums: &Buffer,
        pub starts: &Buffer,
        pub sorted_photons: &Buffer,
        pub occupied_cells: &Buffer,
    }
}

/// The buffers that a sort fills; see [`SortBindings`].
struct SortBuffers {
    cell_counts: Buffer,
    photon_ranks: Buffer,
    block_sums: Buffer,
    starts: Buffer,
    sorted_photons: Buffer,
    occupied_cells: Buffer,
}

impl SortBuffers {
    fn new(gpu: &Gpu, parameters: &GridParameters) -> Result<SortBuffers> {
        let GridParameters { photon_count, cell_count, scan_blocks, .. } = *parameters;
        let [photons, cells, blocks] = [photon_count, cell_count, scan_blocks].map(|count| count as usize);
        Ok(SortBuffers {
            cell_counts: gpu.buffer::<u32>("grid/cell_counts", cells)?,
            photon_ranks: gpu.buffer::<u32>("grid/photon_ranks", photons)?,
            block_sums: gpu.buffer::<u32>("grid/block_sums", blocks)?,
            starts: gpu.buffer::<[u32; 4]>("grid/cell_starts", whole_rows((cells + 1).div_ceil(4)))?,
            sorted_photons: gpu.buffer::<Photon>("grid/photon_table", whole_rows(photons))?,
            occupied_cells: gpu.buffer::<u32>("grid/occupied_cells", 1 + cells.min(photons))?,
        })
    }

    fn bindings<'a>(&'a self, photons: &'a Buffer) -> SortBindings<'a> {
        let SortBuffers { cell_counts, photon_ranks, block_sums, starts, sorted_photons, occupied_cells } = self;
        SortBindings { photons, cell_counts, photon_ranks, block_sums, starts, sorted_photons, occupied_cells }
    }
}

/// Sorted photons, with what the classification of their cells needs besides.
struct SortedCells {
    photons: SortedPhotons,
    /// The number of cells that hold photons, then those cells.
    occupied: Buffer,
    parameters: GridParameters,
}

bindings! {
    /// Buffers of the classification of cells, apart from the sorted photons.
    struct CellClassBindings {
        pub occupied_cells: &Buffer,
        pub classify_arguments: &Buffer,
        pub cell_class_words: &Buffer,
        pub requested_normals: &Buffer,
        pub requested_cells: &Buffer,
        pub request_counts: &Buffer,
        pub request_arguments: &Buffer,
    }
}

/// The pass; see `shaders/grid.wgsl`.
pub struct Grid {
    kernel: Kernel,
}

/// Photons sorted by light and cell.
pub struct SortedPhotons {
    /// Shape of each light's grid.
    pub shape: GridShape,
    /// Lights.
    pub lights: u32,
    /// Photons.
    pub count: u32,
    /// Bytes of its tables on the device.
    pub bytes: u64,
    /// The [`Photon`]s, padded to whole rows of a table.
    pub sorted: Buffer,
    photon_table: Table,
    cell_starts: Table,
}

bindings! {
    /// Sorted photons, as kernels read them.
    pub struct SortedPhotonBindings {
        /// The [`Photon`]s.
        pub photon_table: &Table,
        /// Index of the first photon of each cell, four to a texel; the end follows.
        pub cell_starts: &Table,
    }
}

impl Bindings for SortedPhotons {
    fn get(&self, name: &str) -> Option<Binding<'_>> {
        SortedPhotonBindings { photon_table: &self.photon_table, cell_starts: &self.cell_starts }.find(name)
    }
}

/// The visibility map: photons sorted by light and cell, and the classes of their cells.
pub struct PhotonGrid {
    /// Shape of each light's grid.
    pub shape: GridShape,
    /// Lights.
    pub lights: u32,
    /// Photons.
    pub photons: u32,
    /// Bytes of its tables on the device.
    pub bytes: u64,
    photon_table: Table,
    cell_starts: Table,
    cell_classes: Table,
    requests: Requests,
}

/// Requested cells: cells with points for which the class by the cell's own photons does not hold; see
/// `shaders/lib/cell_class.wgsl`. The class of a requested cell does not depend on the order of requests, and is kept.
struct Requests {
    normals: Buffer,
    indices: Buffer,
    cells: Buffer,
    counts: Buffer,
    classify: ClassifyRequestedCells,
}

impl Requests {
    fn buffers(&self) -> [&Buffer; 4] {
        [&self.normals, &self.indices, &self.cells, &self.counts]
    }
}

shared_struct! {
    /// A requested cell.
    pub struct RequestedCell {
        cell: u32,
        low: u32,
        high: u32,
        spread: u32,
        class_words: [u32; 2],
    }
}

/// Maximum number of requested cells: 6 MiB. If more are requested, none of the new ones gets a class, and their points
/// trace shadow rays: otherwise the order of invocations would decide which cells get one.
const MAX_REQUESTS: usize = 1 << 18;

/// The classification of requested cells, which runs after a sample's requests and before `query` looks the classes up.
#[derive(Clone)]
pub struct ClassifyRequestedCells {
    arrange: BoundKernel,
    classify: BoundKernel,
    arguments: Rc<Buffer>,
    parameters: GridParameters,
}

impl ClassifyRequestedCells {
    /// Records the classification of the newly requested cells.
    pub fn record(&self, frame: &mut Frame<'_>) {
        frame.run(&self.arrange, 1, &self.parameters);
        frame.run_indirect(&self.classify, &self.arguments, 0, &self.parameters);
    }
}

impl PhotonGrid {
    /// The requested cells and their classes, as words. A resumed render needs them: whether a point has the
    /// class of a requested cell or traces shadow rays changes the noise of the image.
    ///
    /// # Errors
    /// As [`Gpu::read`].
    pub fn requested_cells_state(&self, gpu: &Gpu) -> Result<Vec<u32>> {
        let mut words = Vec::new();
        for buffer in self.requests.buffers() {
            words.extend(gpu.read::<u32>(buffer, buffer.bytes as usize / 4)?);
        }
        Ok(words)
    }

    /// Restores what [`PhotonGrid::requested_cells_state`] returned. Does nothing and returns false if `words` is for a
    /// grid of another size.
    pub fn restore_requested_cells(&self, gpu: &Gpu, mut words: &[u32]) -> bool {
        let buffers = self.requests.buffers();
        if words.len() as u64 * 4 != buffers.iter().map(|buffer| buffer.bytes).sum::<u64>() {
            return false;
        }
        // The number of workgroups that are launched depends on these.
        let [.., requested, classified, before] = *words else { return false };
        let room = self.requests.cells.bytes / size_of::<RequestedCell>() as u64;
        let cells = self.requests.normals.bytes / 4;
        let too_many = u64::from(requested) > cells || u64::from(classified) > room;
        if too_many || classified > requested || before > classified {
            return false;
        }
        for buffer in buffers {
            let (own, rest) = words.split_at(buffer.bytes as usize / 4);
            gpu.write(buffer, own);
            words = rest;
        }
        true
    }

    /// Forgets all requests.
    pub fn forget_requested_cells(&self, frame: &mut Frame<'_>) {
        self.requests.buffers().into_iter().for_each(|buffer| frame.clear(buffer));
    }

    /// The classification of the cells that points request.
    pub fn classify_requested_cells(&self) -> ClassifyRequestedCells {
        self.requests.classify.clone()
    }
}

bindings! {
    /// The visibility map as kernels read it, and the requests for cells that they write.
    pub struct PhotonGridBindings {
        /// The [`Photon`]s.
        pub photon_table: &Table,
        /// Index of the first photon of each cell, four to a texel; the end follows.
        pub cell_starts: &Table,
        /// Classes of the cells; see `shaders/lib/cell_class.wgsl`.
        pub cell_classes: &Table,
        /// For each cell, the normals of the points that request it.
        pub requested_normals: &Buffer,
        /// For each cell, its index among the requested cells.
        pub requested_indices: &Buffer,
        /// [`RequestedCell`]s.
        pub requested_cells: &Buffer,
        /// Numbers of requested and of classified cells, and of those classified before.
        pub request_counts: &Buffer,
    }
}

impl Bindings for PhotonGrid {
    fn get(&self, name: &str) -> Option<Binding<'_>> {
        let Requests { normals, indices, cells, counts, .. } = &self.requests;
        let own = PhotonGridBindings {
            photon_table: &self.photon_table,
            cell_starts: &self.cell_starts,
            cell_classes: &self.cell_classes,
            requested_normals: normals,
            requested_indices: indices,
            requested_cells: cells,
            request_counts: counts,
        };
        own.find(name)
    }
}

impl Grid {
    /// Compiles the kernels of the visibility map; `features` must have `visibility_map`. `nearest` is k.
    ///
    /// # Errors
    /// As [`Kernel::new`]; [`Error::Setting`] for a `nearest` out of 1 to [`Settings::MAX_NEAREST`].
    pub fn new(gpu: &Gpu, features: &Features, nearest: u32) -> Result<Grid> {
        check_nearest(nearest)?;
        let names = [SortBindings::DECLARED, CellClassBindings::DECLARED];
        Ok(Grid { kernel: kernel(gpu, "grid", features, &[("nearest", f64::from(nearest))], &names)? })
    }

    /// Compiles only the kernels that sort, for maps whose cells are not classified. `features` must not have
    /// `visibility_map`; it must have `light_tags` where the photons are sorted by light.
    ///
    /// # Errors
    /// As [`Kernel::new`].
    pub fn sorting_only(gpu: &Gpu, features: &Features) -> Result<Grid> {
        Ok(Grid { kernel: kernel(gpu, "grid", features, &[], &[SortBindings::DECLARED])? })
    }

    /// Sorts the first `count` of `photons`. Their lights have indices below `lights`.
    ///
    /// # Errors
    /// [`Error::Buffer`] where the device cannot hold the map, [`Error::Usage`] for too many lights, else as
    /// [`Gpu::check`].
    pub fn sort(
        &self,
        gpu: &Gpu,
        photons: &Buffer,
        count: u32,
        lights: u32,
        shape: GridShape,
    ) -> Result<SortedPhotons> {
        Ok(self.sort_cells(gpu, photons, count, lights, shape)?.photons)
    }

    /// As [`Grid::sort`], for cells that may be classified next.
    fn sort_cells(
        &self,
        gpu: &Gpu,
        photons: &Buffer,
        count: u32,
        lights: u32,
        shape: GridShape,
    ) -> Result<SortedCells> {
        check_lights(lights)?;
        let parameters = GridParameters::new(shape, lights, count);
        let buffers = SortBuffers::new(gpu, &parameters)?;
        let mut frame = gpu.frame("grid");
        self.record_sort(gpu, &mut frame, &buffers.bindings(photons), &parameters)?;
        let SortBuffers { starts, sorted_photons, occupied_cells, .. } = buffers;
        let photons = SortedPhotons {
            shape,
            lights,
            count,
            bytes: sorted_photons.bytes + starts.bytes,
            photon_table: gpu.kernel_table(&mut frame, sorted_photons.clone(), TableFormat::Uint)?,
            cell_starts: gpu.kernel_table(&mut frame, starts, TableFormat::Uint)?,
            sorted: sorted_photons,
        };
        frame.submit()?;
        Ok(SortedCells { photons, occupied: occupied_cells, parameters })
    }

    /// Records the steps of the counting sort.
    fn record_sort(
        &self,
        gpu: &Gpu,
        frame: &mut Frame<'_>,
        buffers: &SortBindings<'_>,
        parameters: &GridParameters,
    ) -> Result<()> {
        let GridParameters { photon_count, scan_blocks, .. } = *parameters;
        let steps = [
            ("count", photon_count),
            ("sum", scan_blocks),
            ("scan", 1),
            ("start", scan_blocks),
            ("scatter", photon_count),
        ];
        for (entry, invocations) in steps {
            frame.run(&self.kernel.bind(gpu, entry, &[buffers])?, invocations, parameters);
        }
        Ok(())
    }

    /// Sorts the first `count` of `photons`, as [`Grid::sort`] does, and classifies the cells.
    ///
    /// # Errors
    /// As [`Grid::sort`].
    pub fn build(&self, gpu: &Gpu, photons: &Buffer, count: u32, lights: u32, shape: GridShape) -> Result<PhotonGrid> {
        let SortedCells { photons: sorted, occupied: occupied_cells, parameters } =
            self.sort_cells(gpu, photons, count, lights, shape)?;
        let cells = parameters.cell_count as usize;
        let classify_arguments = gpu.buffer::<u32>("grid/classify_arguments", 4)?;
        let cell_class_words = gpu.buffer::<[u32; 4]>("grid/cell_class_words", whole_rows(cells))?;
        let normals = gpu.buffer::<u32>("grid/requested_normals", cells)?;
        let indices = gpu.buffer::<u32>("grid/requested_indices", cells)?;
        let requested_cells = gpu.buffer::<RequestedCell>("grid/requested_cells", cells.min(MAX_REQUESTS))?;
        let counts = gpu.buffer::<u32>("grid/request_counts", 3)?;
        let arguments = Rc::new(gpu.buffer::<u32>("grid/request_arguments", 3)?);
        let own = CellClassBindings {
            occupied_cells: &occupied_cells,
            classify_arguments: &classify_arguments,
            cell_class_words: &cell_class_words,
            requested_normals: &normals,
            requested_cells: &requested_cells,
            request_counts: &counts,
            request_arguments: &arguments,
        };
        let entry = |name: &str| -> Result<BoundKernel> { Ok(self.kernel.bind(gpu, name, &[&own, &sorted])?) };
        let mut frame = gpu.frame("grid");
        frame.run(&entry("arrange")?, 1, &parameters);
        frame.run_indirect(&entry("classify_cells")?, &classify_arguments, 0, &parameters);
        let (arrange, classify) = (entry("arrange_requests")?, entry("classify_requested_cells")?);
        let classify = ClassifyRequestedCells { arrange, classify, arguments, parameters };
        let bytes: u64 =
            [&cell_class_words, &normals, &indices, &requested_cells].map(|buffer| buffer.bytes).iter().sum();
        let cell_classes = gpu.kernel_table(&mut frame, cell_class_words, TableFormat::Uint)?;
        frame.submit()?;
        Ok(PhotonGrid {
            shape,
            lights,
            photons: count,
            bytes: sorted.bytes + bytes,
            photon_table: sorted.photon_table,
            cell_starts: sorted.cell_starts,
            cell_classes,
            requests: Requests { normals, indices, cells: requested_cells, counts, classify },
        })
    }
}
