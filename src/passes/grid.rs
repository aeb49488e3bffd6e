//! Pass `grid`: photons sorted by light and cell, and verdicts on whole cells.
//!
//! A counting sort: count (each photon takes its rank in its cell), scan, scatter. Nothing is dropped. Then each
//! cell that holds photons is judged: where the nearest k of every point on its surface are of one kind, a query
//! there is one look-up.

use std::rc::Rc;

use glam::{UVec3, Vec3};

use crate::gpu::buffer::{TableFormat, whole_rows};
use crate::gpu::{Bindings, BoundKernel, Buffer, Features, Frame, Gpu, Kernel, Resources, Table};
use crate::{Error, Result, bindings, shared_struct};

use super::kernel;

shared_struct! {
    /// A photon of the visibility map or the global map.
    pub struct Photon {
        /// Where it hit, in normalised space.
        pub position: [f32; 3],
        /// Bits 0-13 normal on the side that it came to (octahedral, 7 bits a coordinate), 31 shadow photon. In the
        /// visibility map 14-24 light, 25-30 weight exponent (it stands for 2^(w/4) hits); in the global map 14-28 flux in
        /// red, green and blue, 29-30 its exponent.
        pub word: u32,
    }
}

impl Photon {
    /// The light that sent it.
    pub fn light(&self) -> u32 {
        (self.word >> 14) & (MAX_LIGHTS - 1)
    }
}

/// Lights of a photon map: a photon's word has eleven bits for its light.
pub const MAX_LIGHTS: u32 = 2048;

/// Most photons asked for: a class word has nine bits for each count.
pub const MAX_NEAREST: u32 = 511;

/// The largest search radius in cells: with [`PHOTONS_PER_CELL`] it finds k photons where they are 32 times sparser than
/// on the mean of the surfaces; sparser places are unknown. Six cells would take two thirds of the time, most of which
/// goes into searches that find nothing, but leave seven times as many points of the paper's box unknown.
pub const REACH_CELLS: u32 = 8;

/// Photons that a cell on an evenly covered surface holds, as a share of k. Measured on the box: half of it doubles
/// the cells to be judged and the rows of a search, and settles no more points; twice settles 1 % of them less.
pub const PHOTONS_PER_CELL: f32 = 0.16;

/// Most cells of a map, all lights together: 20 bytes each, and once more where tables are textures.
const MAX_CELLS: f64 = (1u32 << 22) as f64;

shared_struct! {
    /// The grid of one light; all lights' are alike. Cells are cubes, x runs fastest.
    pub struct GridShape {
        /// Least corner.
        pub origin: [f32; 3],
        /// Edge of a cell.
        pub cell: f32,
        /// Cells along each axis, at least 1.
        pub size: [u32; 3],
        /// 1 / `cell`.
        pub inverse_cell: f32,
    }
}

impl GridShape {
    /// A grid over `bounds` (least and greatest corner) for `photons` photons of one of `lights` lights on surfaces
    /// of area `area`, of which queries want the nearest `nearest`.
    pub fn new(bounds: (Vec3, Vec3), area: f32, photons: u32, lights: u32, nearest: u32) -> GridShape {
        Self::with_cells_of(PHOTONS_PER_CELL * nearest as f32, bounds, area, photons, lights)
    }

    /// As [`GridShape::new`]: a cell on an evenly covered surface holds `per_cell` photons, at least 1.
    pub fn with_cells_of(per_cell: f32, bounds: (Vec3, Vec3), area: f32, photons: u32, lights: u32) -> GridShape {
        // Cells beyond twice the photons would be empty, most of them.
        let most = (MAX_CELLS / f64::from(lights.max(1))).min(2.0 * f64::from(photons));
        Self::with_most_cells(per_cell, bounds, area, photons, most)
    }

    /// The same, of no more than `most` cells, all lights together.
    pub fn with_most_cells(per_cell: f32, bounds: (Vec3, Vec3), area: f32, photons: u32, most: f64) -> GridShape {
        // A border keeps photons on the scene's hull off the grid's.
        let border = 1e-3f32.max((bounds.1 - bounds.0).max_element() * 1e-3);
        let (low, high) = (bounds.0 - border, bounds.1 + border);
        let extent = (high - low).as_dvec3();
        let per_cell = f64::from(per_cell.max(1.0));
        let mut cell = (f64::from(area) * per_cell / f64::from(photons.max(1))).sqrt();
        let most = most.max(1.0);
        cell = cell.clamp(extent.max_element() / 2048.0, extent.max_element());
        let size = |cell: f64| (extent / cell).ceil().max(glam::DVec3::ONE);
        while size(cell).element_product() > most && cell < extent.max_element() {
            cell *= 1.02;
        }
        GridShape {
            origin: low.to_array(),
            cell: cell as f32,
            size: size(f64::from(cell as f32)).as_uvec3().max(UVec3::ONE).to_array(),
            inverse_cell: 1.0 / cell as f32,
        }
    }

    /// Cells of one light.
    pub fn cells(&self) -> u32 {
        self.size.iter().product()
    }

    /// The largest search radius: points with fewer than k photons within it are unknown.
    pub fn reach(&self) -> f32 {
        REACH_CELLS as f32 * self.cell
    }
}

shared_struct! {
    /// Parameters of the grid's kernels.
    pub struct GridParameters {
        grid: GridShape,
        photon_count: u32,
        cell_count: u32,
        scan_blocks: u32,
        padding: u32,
    }
}

bindings! {
    /// What sorting writes, and the photons it reads.
    struct GridBindings {
        photons, cell_counts, photon_ranks, block_sums, starts, sorted_photons, occupied_cells,
    }
}

/// Cells that an invocation of the scan takes in turn, as the kernel has it.
const SCAN_SERIAL: u32 = 64;

/// The pass.
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

impl Bindings for SortedPhotons {
    fn get(&self, name: &str) -> Option<crate::gpu::Binding<'_>> {
        match name {
            "photon_table" => Some((&self.photon_table).into()),
            "cell_starts" => Some((&self.cell_starts).into()),
            _ => None,
        }
    }
}

/// The visibility map: photons sorted by light and cell, with the verdicts on their cells.
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
    cell_records: Table,
    asked: AskedCells,
}

/// Cells that points asked about for which the photons' own verdicts do not hold; see `shaders/lib/grid.wgsl`. A
/// cell's verdict is the same whoever asks, and stays.
struct AskedCells {
    codes: Buffer,
    places: Buffer,
    cells: Buffer,
    lengths: Buffer,
    judge: JudgeAsked,
}

impl AskedCells {
    fn buffers(&self) -> [&Buffer; 4] {
        [&self.codes, &self.places, &self.cells, &self.lengths]
    }
}

shared_struct! {
    /// A cell that is asked about.
    pub struct AskedCell {
        cell: u32,
        low: u32,
        high: u32,
        spread: u32,
        verdict: [u32; 2],
    }
}

/// Most cells that can be asked about: 6 MiB. Points in others are searched for one by one.
const MAX_ASKED: usize = 1 << 18;

/// The part of the pass that runs after points were classified by the verdicts there are.
#[derive(Clone)]
pub struct JudgeAsked {
    arrange: BoundKernel,
    judge: BoundKernel,
    arguments: Rc<Buffer>,
    parameters: GridParameters,
}

impl JudgeAsked {
    /// Records the verdicts on the cells that were newly asked about.
    pub fn record(&self, frame: &mut Frame<'_>) {
        frame.run(&self.arrange, 1, &self.parameters);
        frame.run_indirect(&self.judge, &self.arguments, 0, &self.parameters);
    }
}

impl PhotonGrid {
    /// The cells that were asked about, as words. Which verdict decides a point decides how its photons were counted, and
    /// so the noise of what shadow rays add.
    ///
    /// # Errors
    /// As [`Gpu::read`].
    pub fn asked_state(&self, gpu: &Gpu) -> Result<Vec<u32>> {
        let mut words = Vec::new();
        for buffer in self.asked.buffers() {
            words.extend(gpu.read::<u32>(buffer, buffer.bytes as usize / 4)?);
        }
        Ok(words)
    }

    /// Puts back what [`PhotonGrid::asked_state`] gave; false, and nothing done, where it is not of this grid's size.
    pub fn restore_asked(&self, gpu: &Gpu, mut words: &[u32]) -> bool {
        let buffers = self.asked.buffers();
        if words.len() as u64 * 4 != buffers.iter().map(|buffer| buffer.bytes).sum::<u64>() {
            return false;
        }
        // How many workgroups are launched hangs on these: asked about, judged, judged before.
        let [.., asked, judged, before] = *words else { return false };
        let room = self.asked.cells.bytes / size_of::<AskedCell>() as u64;
        if u64::from(asked) > self.asked.codes.bytes / 4
            || judged > asked
            || u64::from(judged) > room
            || before > judged
        {
            return false;
        }
        for buffer in buffers {
            let (own, rest) = words.split_at(buffer.bytes as usize / 4);
            gpu.write(buffer, own);
            words = rest;
        }
        true
    }

    /// The verdicts on the cells that points ask about.
    pub fn judge_asked(&self) -> JudgeAsked {
        self.asked.judge.clone()
    }
}

impl Bindings for PhotonGrid {
    fn get(&self, name: &str) -> Option<crate::gpu::Binding<'_>> {
        match name {
            "photon_table" => Some((&self.photon_table).into()),
            "cell_starts" => Some((&self.cell_starts).into()),
            "cell_records" => Some((&self.cell_records).into()),
            "asked_codes" => Some((&self.asked.codes).into()),
            "asked_places" => Some((&self.asked.places).into()),
            "asked_cells" => Some((&self.asked.cells).into()),
            "asked_lengths" => Some((&self.asked.lengths).into()),
            _ => None,
        }
    }
}

impl Grid {
    /// Makes the pass for the visibility map. `nearest` is k, at most [`MAX_NEAREST`].
    ///
    /// # Errors
    /// As [`Kernel::new`]; [`Error::Setting`] for a `nearest` out of range.
    pub fn new(gpu: &Gpu, features: &Features, nearest: u32) -> Result<Grid> {
        if !(1..=MAX_NEAREST).contains(&nearest) {
            return Err(Error::setting(
                "visibility_map.nearest",
                format!("is {nearest}; it must be from 1 to {MAX_NEAREST}"),
            ));
        }
        let features = features.clone().with("visibility_map", true);
        Ok(Grid { kernel: kernel(gpu, "grid", &features, &[("nearest", f64::from(nearest))], GridBindings::NAMES)? })
    }

    /// Makes the pass for the global map: it sorts, and judges nothing.
    ///
    /// # Errors
    /// As [`Kernel::new`].
    pub fn sorting_only(gpu: &Gpu, features: &Features) -> Result<Grid> {
        let features = features.clone().with("visibility_map", false).with("light_tags", false);
        Ok(Grid { kernel: kernel(gpu, "grid", &features, &[], GridBindings::NAMES)? })
    }

    /// Sorts the first `count` of `photons`, whose lights are below `lights`.
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
        Ok(self.sort_cells(gpu, photons, count, lights, shape)?.0)
    }

    /// As [`Grid::sort`]; also the cells that hold photons, and the parameters of the kernels.
    fn sort_cells(
        &self,
        gpu: &Gpu,
        photons: &Buffer,
        count: u32,
        lights: u32,
        shape: GridShape,
    ) -> Result<(SortedPhotons, Buffer, GridParameters)> {
        if !(1..=MAX_LIGHTS).contains(&lights) {
            return Err(Error::Usage(format!("a photon map is for 1 to {MAX_LIGHTS} lights, not {lights}")));
        }
        let cells = shape.cells() as usize * lights as usize;
        let blocks = (cells as u32).div_ceil(SCAN_SERIAL);
        let cell_counts = gpu.buffer::<u32>("grid/cell_counts", cells)?;
        let photon_ranks = gpu.buffer::<u32>("grid/photon_ranks", count as usize)?;
        let block_sums = gpu.buffer::<u32>("grid/block_sums", blocks as usize)?;
        let starts = gpu.buffer::<[u32; 4]>("grid/cell_starts", whole_rows((cells + 1).div_ceil(4)))?;
        let sorted_photons = gpu.buffer::<Photon>("grid/photon_table", whole_rows(count as usize))?;
        let occupied_cells = gpu.buffer::<u32>("grid/occupied_cells", 1 + cells.min(count as usize))?;
        let own = GridBindings {
            photons,
            cell_counts: &cell_counts,
            photon_ranks: &photon_ranks,
            block_sums: &block_sums,
            starts: &starts,
            sorted_photons: &sorted_photons,
            occupied_cells: &occupied_cells,
        };
        let parameters = GridParameters {
            grid: shape,
            photon_count: count,
            cell_count: cells as u32,
            scan_blocks: blocks,
            padding: 0,
        };
        let entry = |name: &str| -> Result<BoundKernel> { self.kernel.bind(gpu, name, &[&own]) };
        let mut frame = gpu.frame("grid");
        frame.run(&entry("count")?, count, &parameters);
        frame.run(&entry("sum")?, blocks, &parameters);
        frame.run(&entry("scan")?, 1, &parameters);
        frame.run(&entry("start")?, blocks, &parameters);
        frame.run(&entry("scatter")?, count, &parameters);
        let bytes = sorted_photons.bytes + starts.bytes;
        let sorted = SortedPhotons {
            shape,
            lights,
            count,
            bytes,
            photon_table: gpu.kernel_table(&mut frame, sorted_photons.clone(), TableFormat::Uint)?,
            cell_starts: gpu.kernel_table(&mut frame, starts, TableFormat::Uint)?,
            sorted: sorted_photons,
        };
        frame.submit()?;
        Ok((sorted, occupied_cells, parameters))
    }

    /// Sorts the first `count` of `photons`, whose lights are below `lights`, and judges the cells.
    ///
    /// # Errors
    /// As [`Grid::sort`].
    pub fn build(&self, gpu: &Gpu, photons: &Buffer, count: u32, lights: u32, shape: GridShape) -> Result<PhotonGrid> {
        let (sorted, occupied_cells, parameters) = self.sort_cells(gpu, photons, count, lights, shape)?;
        let cells = parameters.cell_count as usize;
        let judge_arguments = gpu.buffer::<u32>("grid/judge_arguments", 4)?;
        let judged_cells = gpu.buffer::<[u32; 4]>("grid/cell_records", whole_rows(cells))?;
        let [codes, places] = ["grid/asked_codes", "grid/asked_places"].map(|label| gpu.buffer::<u32>(label, cells));
        let (codes, places) = (codes?, places?);
        let asked_cells = gpu.buffer::<AskedCell>("grid/asked_cells", cells.min(MAX_ASKED))?;
        let lengths = gpu.buffer::<u32>("grid/asked_lengths", 3)?;
        let arguments = Rc::new(gpu.buffer::<u32>("grid/asked_arguments", 3)?);
        let own = Resources::new()
            .with("occupied_cells", &occupied_cells)
            .with("judge_arguments", &judge_arguments)
            .with("judged_cells", &judged_cells)
            .with("asked_codes", &codes)
            .with("asked_cells", &asked_cells)
            .with("asked_lengths", &lengths)
            .with("asked_arguments", &*arguments);
        let entry = |name: &str| -> Result<BoundKernel> { self.kernel.bind(gpu, name, &[&own, &sorted]) };
        let mut frame = gpu.frame("grid");
        frame.run(&entry("arrange")?, 1, &parameters);
        frame.run_indirect(&entry("judge")?, &judge_arguments, 0, &parameters);
        let judge =
            JudgeAsked { arrange: entry("arrange_asked")?, judge: entry("judge_asked")?, arguments, parameters };
        let gpu_scene = [&judged_cells, &codes, &places, &asked_cells].map(|buffer| buffer.bytes);
        let cell_records = gpu.kernel_table(&mut frame, judged_cells, TableFormat::Uint)?;
        frame.submit()?;
        Ok(PhotonGrid {
            shape,
            lights,
            photons: count,
            bytes: sorted.bytes + gpu_scene.iter().sum::<u64>(),
            photon_table: sorted.photon_table,
            cell_starts: sorted.cell_starts,
            cell_records,
            asked: AskedCells { codes, places, cells: asked_cells, lengths, judge },
        })
    }
}
