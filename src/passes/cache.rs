//! Pass `cache`: the irradiance cache. It lists the points that need an irradiance record of their own, and
//! interpolates the indirect light of the others from existing records.

use kernel_kit::{
    Binding, Bindings, BoundKernel, Buffer, Frame, Gpu, Kernel, Table, TableFormat, bindings, shared_struct,
};

use super::gather::RecordHead;
use super::path::{GatherHit, HitBindings, PathQueue};
use super::{Tile, TileBuffers, kernel};
use crate::Result;
use crate::specialisation::features::Features;

shared_struct! {
    /// Immediates of the pass; see `shaders/cache.wgsl`.
    pub struct CacheParameters {
        tile: Tile,
        blocks: [f32; 2],
        block_columns: u32,
        block_rows: u32,
    }
}

bindings! {
    /// Everything that the kernel reads and writes except the records.
    struct CacheBindings {
        pub wanted_count: &Buffer,
        pub wanted_points: &Buffer,
        pub radiance_indirect: &Buffer,
        pub path_count: &Buffer,
        pub path_points: &Buffer,
        pub path_arguments: &Buffer,
        pub uncovered_count: &Buffer,
        pub uncovered_points: &Buffer,
        pub uncovered_arguments: &Buffer,
    }
}

/// The irradiance records of a view, by block of the image; see `shaders/lib/record.wgsl`.
pub struct ViewRecords {
    blocks: BlockGrid,
    heads: Table,
    values: Table,
    starts: Table,
    records: Table,
}

/// Side of a block in pixels: small enough that most records of a block reach each of its points.
const BLOCK: u32 = 8;

/// An area of an image: its top left and bottom right corners, as fractions of the width and the height.
pub type ImageArea = [[f32; 2]; 2];

impl ViewRecords {
    /// Tables of records for an image of `size` pixels. `heads` hold radii, `values` is what pass `gather` wrote, and
    /// `reach` returns the area of the image within a record's radius.
    ///
    /// # Errors
    /// As [`Gpu::table`].
    pub fn new(
        gpu: &Gpu,
        heads: &[RecordHead],
        values: &Buffer,
        size: [u32; 2],
        reach: impl Fn(&RecordHead) -> Option<ImageArea>,
    ) -> Result<ViewRecords> {
        let blocks = BlockGrid::new(size);
        let spans: Vec<BlockSpan> = heads.iter().map(|head| blocks.span(reach(head))).collect();
        let (starts, records) = sort_by_block(&spans, &blocks);
        let mut frame = gpu.frame("cache");
        let values = gpu.kernel_table(&mut frame, values.clone(), TableFormat::Float)?;
        frame.submit()?;
        Ok(ViewRecords {
            blocks,
            heads: gpu.table("penumbra/cache/heads", bytemuck::cast_slice::<_, [f32; 4]>(heads), TableFormat::Float)?,
            values,
            starts: gpu.table("penumbra/cache/block_starts", &vectors(starts), TableFormat::Uint)?,
            records: gpu.table("penumbra/cache/block_records", &vectors(records), TableFormat::Uint)?,
        })
    }
}

/// A range of columns of blocks, and a range of rows; ends are excluded.
type BlockSpan = [[u32; 2]; 2];

/// The division of an image into blocks, row by row.
#[derive(Clone, Copy)]
pub struct BlockGrid {
    /// The size of the image in blocks.
    size: [f32; 2],
    columns: u32,
    rows: u32,
}

impl BlockGrid {
    /// The blocks of an image of `size` pixels.
    pub fn new(size: [u32; 2]) -> BlockGrid {
        let [columns, rows] = size.map(|side| side.div_ceil(BLOCK));
        BlockGrid { size: size.map(|side| side as f32 / BLOCK as f32), columns, rows }
    }

    /// Their number.
    pub fn count(&self) -> usize {
        (self.columns * self.rows) as usize
    }

    /// The blocks that an area of the image reaches.
    pub fn of(&self, reach: Option<ImageArea>) -> impl Iterator<Item = usize> + use<> {
        self.of_span(self.span(reach))
    }

    fn of_span(&self, [[left, right], [top, bottom]]: BlockSpan) -> impl Iterator<Item = usize> + use<> {
        let columns = self.columns;
        (top..bottom).flat_map(move |y| (left..right).map(move |x| (y * columns + x) as usize))
    }

    fn span(&self, reach: Option<ImageArea>) -> BlockSpan {
        let Some([low, high]) = reach else { return [[0; 2]; 2] };
        let counts = [self.columns, self.rows];
        [0, 1].map(|axis| {
            let block = |at: f32| (at * self.size[axis]).clamp(0.0, counts[axis] as f32) as u32;
            [block(low[axis]), (block(high[axis]) + 1).min(counts[axis])]
        })
    }
}

/// The index of each block's first entry, with the total at the end; and the records, sorted by the blocks that they
/// reach.
fn sort_by_block(spans: &[BlockSpan], blocks: &BlockGrid) -> (Vec<u32>, Vec<u32>) {
    let mut starts = vec![0u32; blocks.count() + 1];
    spans.iter().flat_map(|span| blocks.of_span(*span)).for_each(|block| starts[block + 1] += 1);
    for block in 1..starts.len() {
        starts[block] += starts[block - 1];
    }
    let mut records = vec![0u32; starts[starts.len() - 1] as usize];
    let mut ends = starts.clone();
    for (id, span) in spans.iter().enumerate() {
        for block in blocks.of_span(*span) {
            records[ends[block] as usize] = id as u32;
            ends[block] += 1;
        }
    }
    (starts, records)
}

/// Words as vectors of four, padded with 0; at least one vector.
fn vectors(mut words: Vec<u32>) -> Vec<[u32; 4]> {
    words.resize(words.len().next_multiple_of(4).max(4), 0);
    words.chunks_exact(4).map(|c| [c[0], c[1], c[2], c[3]]).collect()
}

bindings! {
    /// The records as kernels read them.
    pub struct RecordBindings {
        /// [`RecordHead`]s.
        pub head_table: &Table,
        /// Irradiance and gradients of the records.
        pub value_table: &Table,
        /// Index of the first entry of each block in `block_records`, four to a texel; the end follows.
        pub block_starts: &Table,
        /// Indices of the records by block, four to a texel.
        pub block_records: &Table,
    }
}

impl ViewRecords {
    fn bindings(&self) -> RecordBindings<'_> {
        RecordBindings {
            head_table: &self.heads,
            value_table: &self.values,
            block_starts: &self.starts,
            block_records: &self.records,
        }
    }
}

/// The pass; see `shaders/cache.wgsl`.
pub struct Cache(Kernel);

/// The outputs of the pass besides the light at the points.
pub struct CacheBuffers {
    wanted_count: Buffer,
    wanted_points: Buffer,
    /// The points for path tracing that records may cover: those that are not Lambertian, or are seen in mirrors.
    pub paths: PathQueue,
    /// The points for path tracing that no record covers.
    pub uncovered: PathQueue,
    /// A hit that nothing reads: queued points are no hits of gather rays, but pass `path` must have the binding.
    no_hits: Buffer,
}

impl CacheBuffers {
    /// Buffers for tiles of `points` points.
    ///
    /// # Errors
    /// As [`Gpu::buffer`].
    pub fn new(gpu: &Gpu, points: u32) -> Result<CacheBuffers> {
        let words = |name: &str, count: u32| gpu.buffer::<u32>(name, count as usize);
        Ok(CacheBuffers {
            wanted_count: words("penumbra/cache/wanted_count", 1)?,
            wanted_points: words("penumbra/cache/wanted_points", points)?,
            paths: PathQueue::new(gpu, "cache", points)?,
            uncovered: PathQueue::new(gpu, "cache/uncovered", points)?,
            no_hits: gpu.buffer::<GatherHit>("penumbra/cache/no_hits", 1)?,
        })
    }

    /// The points that records may cover, and those that none covers, as pass `path` reads them.
    pub fn queues(&self) -> [impl Bindings + '_; 2] {
        [&self.paths, &self.uncovered].map(|queue| PointQueue { queue, no_hits: &self.no_hits })
    }

    /// Bytes of all of them.
    pub fn bytes(&self) -> u64 {
        self.wanted_points.bytes + self.paths.points.bytes + self.uncovered.points.bytes
    }
}

/// A queue of points of a tile, as pass `path` reads it.
struct PointQueue<'a> {
    queue: &'a PathQueue,
    no_hits: &'a Buffer,
}

impl Bindings for PointQueue<'_> {
    fn get(&self, name: &str) -> Option<Binding<'_>> {
        self.queue.bindings().find(name).or_else(|| HitBindings { gather_hits: self.no_hits }.find(name))
    }
}

impl Cache {
    /// Compiles the kernel.
    ///
    /// # Errors
    /// As [`Kernel::new`].
    pub fn new(gpu: &Gpu, features: &Features, constants: &[(&str, f64)]) -> Result<Cache> {
        Ok(Cache(kernel(gpu, "cache", features, constants, &[CacheBindings::DECLARED])?))
    }

    /// Binds it to the records and to a tile's buffers, which must have one for indirect light.
    ///
    /// # Errors
    /// As [`Kernel::bind`].
    pub fn bind(
        &self,
        gpu: &Gpu,
        tile: &TileBuffers,
        buffers: &CacheBuffers,
        records: &ViewRecords,
        scene: &[&dyn Bindings],
    ) -> Result<BoundCache> {
        let own = CacheBindings {
            wanted_count: &buffers.wanted_count,
            wanted_points: &buffers.wanted_points,
            radiance_indirect: tile.required_indirect("cache")?,
            path_count: &buffers.paths.count,
            path_points: &buffers.paths.points,
            path_arguments: &buffers.paths.arguments,
            uncovered_count: &buffers.uncovered.count,
            uncovered_points: &buffers.uncovered.points,
            uncovered_arguments: &buffers.uncovered.arguments,
        };
        let records_bound = records.bindings();
        let sets: Vec<&dyn Bindings> =
            [&own as &dyn Bindings, tile, &records_bound].into_iter().chain(scene.iter().copied()).collect();
        let entry = |name: &str| self.0.bind(gpu, name, &sets);
        Ok(BoundCache {
            request: entry("request")?,
            interpolate: entry("interpolate")?,
            change: entry("change")?,
            arrange_paths: entry("arrange_paths")?,
            blocks: records.blocks,
        })
    }
}

/// The pass, bound.
pub struct BoundCache {
    request: BoundKernel,
    interpolate: BoundKernel,
    change: BoundKernel,
    arrange_paths: BoundKernel,
    blocks: BlockGrid,
}

impl BoundCache {
    fn parameters(&self, tile: &Tile) -> CacheParameters {
        let BlockGrid { size: blocks, columns: block_columns, rows: block_rows } = self.blocks;
        CacheParameters { tile: *tile, blocks, block_columns, block_rows }
    }

    /// Lists the points of the tile that need a record.
    pub fn record_requests(&self, frame: &mut Frame<'_>, buffers: &CacheBuffers, tile: &Tile) {
        frame.clear(&buffers.wanted_count);
        frame.run(&self.request, tile.point_count, &self.parameters(tile));
    }

    /// Interpolates the light at the tile's points from the records, and lists the points left to path tracing.
    pub fn record_interpolate(&self, frame: &mut Frame<'_>, buffers: &CacheBuffers, tile: &Tile) {
        frame.clear(&buffers.paths.count);
        frame.clear(&buffers.uncovered.count);
        frame.run(&self.interpolate, tile.point_count, &self.parameters(tile));
        frame.run(&self.arrange_paths, 1, &self.parameters(tile));
    }

    /// Replaces the indirect light at the tile's points by its change: the light from these records minus that from the
    /// records of `before`.
    pub fn record_change(&self, frame: &mut Frame<'_>, before: &BoundCache, buffers: &CacheBuffers, tile: &Tile) {
        before.record_interpolate(frame, buffers, tile);
        frame.run(&self.change, tile.point_count, &self.parameters(tile));
    }
}

/// The points that [`BoundCache::record_requests`] listed, sorted: the device lists them in any order.
///
/// # Errors
/// As [`Gpu::read`].
pub fn wanted(gpu: &Gpu, buffers: &CacheBuffers) -> Result<Vec<u32>> {
    let count = gpu.read::<u32>(&buffers.wanted_count, 1)?[0];
    let mut points = gpu.read::<u32>(&buffers.wanted_points, count as usize)?;
    points.sort_unstable();
    Ok(points)
}
