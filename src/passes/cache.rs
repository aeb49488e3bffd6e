//! Pass `cache`: the irradiance cache. Lists the points that need an irradiance record of their own, and interpolates
//! the indirect light of all others from the records there are.

use kernel_kit::{
    Binding, Bindings, BoundKernel, Buffer, Frame, Gpu, Kernel, Table, TableFormat, bindings, shared_struct, whole_rows,
};

use super::gather::RecordHead;
use super::{Tile, TileBuffers, kernel};
use crate::Result;
use crate::kernels::{RECORD_VALUE_TEXELS_CURVED, RECORD_VALUE_TEXELS_FLAT};
use crate::specialisation::features::{Feature, Features};

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
        pub points: &Buffer,
        pub surfaces: &Buffer,
        pub wanted_count: &Buffer,
        pub wanted_points: &Buffer,
        pub radiance_indirect: &Buffer,
        pub path_count: &Buffer,
        pub path_points: &Buffer,
        pub path_arguments: &Buffer,
    }
}

/// The irradiance records of a view, by block of the image; see `shaders/lib/record.wgsl`.
pub struct ViewRecords {
    blocks: [f32; 2],
    columns: u32,
    rows: u32,
    heads: Table,
    values: Table,
    starts: Table,
    records: Table,
}

/// Side of a block in pixels. Neighbouring points read the same records, few of which do not reach them.
const BLOCK: u32 = 8;

/// A part of an image: low and high corner, 0 to 1 from the left and from the top.
pub type ImageArea = [[f32; 2]; 2];

impl ViewRecords {
    /// Tables of records for an image of `size` pixels. `heads` have radii, `values` is what pass `gather` wrote, and
    /// `reach` gives the part of the image that a record reaches.
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
        let counts = size.map(|side| side.div_ceil(BLOCK));
        let [columns, rows] = counts;
        let blocks = size.map(|side| side as f32 / BLOCK as f32);
        let spans: Vec<BlockSpan> = heads.iter().map(|head| block_span(reach(head), blocks, counts)).collect();
        let (starts, records) = sort_by_block(&spans, counts);
        let mut frame = gpu.frame("cache");
        let values = gpu.kernel_table(&mut frame, values.clone(), TableFormat::Float)?;
        frame.submit()?;
        Ok(ViewRecords {
            blocks,
            columns,
            rows,
            heads: gpu.table("penumbra/cache/heads", bytemuck::cast_slice::<_, [f32; 4]>(heads), TableFormat::Float)?,
            values,
            starts: gpu.table("penumbra/cache/block_starts", &vectors(starts), TableFormat::Uint)?,
            records: gpu.table("penumbra/cache/block_records", &vectors(records), TableFormat::Uint)?,
        })
    }
}

/// First and end of the columns of blocks, and of their rows.
type BlockSpan = [[u32; 2]; 2];

/// The blocks that a record reaches; `blocks` is the size of the image in blocks, `counts` the number of blocks that
/// cover it.
fn block_span(reach: Option<ImageArea>, blocks: [f32; 2], counts: [u32; 2]) -> BlockSpan {
    let Some([low, high]) = reach else { return [[0; 2]; 2] };
    [0, 1].map(|axis| {
        let block = |at: f32| (at * blocks[axis]).clamp(0.0, counts[axis] as f32) as u32;
        [block(low[axis]), (block(high[axis]) + 1).min(counts[axis])]
    })
}

/// The records in the order of the blocks that they reach, and the index of each block's first one; the end follows.
fn sort_by_block(spans: &[BlockSpan], [columns, rows]: [u32; 2]) -> (Vec<u32>, Vec<u32>) {
    let blocks_of = |[[left, right], [top, bottom]]: BlockSpan| {
        (top..bottom).flat_map(move |y| (left..right).map(move |x| (y * columns + x) as usize))
    };
    let mut starts = vec![0u32; (columns * rows + 1) as usize];
    spans.iter().flat_map(|span| blocks_of(*span)).for_each(|block| starts[block + 1] += 1);
    for block in 1..starts.len() {
        starts[block] += starts[block - 1];
    }
    let mut records = vec![0u32; starts[starts.len() - 1] as usize];
    let mut ends = starts.clone();
    for (id, span) in spans.iter().enumerate() {
        for block in blocks_of(*span) {
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

impl Bindings for ViewRecords {
    fn get(&self, name: &str) -> Option<Binding<'_>> {
        Some(match name {
            "head_table" => (&self.heads).into(),
            "value_table" => (&self.values).into(),
            "block_starts" => (&self.starts).into(),
            "block_records" => (&self.records).into(),
            _ => return None,
        })
    }
}

/// A buffer for the values of `records` records, in whole rows of a table. Kernels of `features` with bent normals keep
/// rotational gradients too.
///
/// # Errors
/// As [`Gpu::buffer`].
pub fn record_values(gpu: &Gpu, features: &Features, records: u32) -> Result<Buffer> {
    let bent = features.has(Feature::SmoothNormals) || features.has(Feature::NormalMaps);
    let texels = if bent { RECORD_VALUE_TEXELS_CURVED } else { RECORD_VALUE_TEXELS_FLAT };
    Ok(gpu.buffer::<[f32; 4]>("penumbra/cache/values", whole_rows(records as usize * texels as usize))?)
}

/// The pass; see `shaders/cache.wgsl`.
pub struct Cache(Kernel);

/// What the pass writes besides the light of the points.
pub struct CacheBuffers {
    wanted_count: Buffer,
    wanted_points: Buffer,
    /// Number of points for path tracing: those that no record covers, and those that are not Lambertian.
    pub path_count: Buffer,
    /// Their indices.
    pub path_points: Buffer,
    /// Arguments of a dispatch over them.
    pub path_arguments: Buffer,
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
            path_count: words("penumbra/cache/path_count", 1)?,
            path_points: words("penumbra/cache/path_points", points)?,
            path_arguments: words("penumbra/cache/path_arguments", 3)?,
        })
    }

    /// Bytes of all of them.
    pub fn bytes(&self) -> u64 {
        self.wanted_points.bytes + self.path_points.bytes
    }
}

/// For the kernels that read the queue for path tracing.
impl Bindings for CacheBuffers {
    fn get(&self, name: &str) -> Option<Binding<'_>> {
        Some(match name {
            "path_count" => (&self.path_count).into(),
            "path_points" => (&self.path_points).into(),
            _ => return None,
        })
    }
}

impl Cache {
    /// Compiles the kernel.
    ///
    /// # Errors
    /// As [`Kernel::new`].
    pub fn new(gpu: &Gpu, features: &Features) -> Result<Cache> {
        Ok(Cache(kernel(gpu, "cache", features, &[], &[CacheBindings::DECLARED])?))
    }

    /// Binds it to a tile's buffers, which must have one for indirect light, and to the records there are.
    ///
    /// # Errors
    /// As [`Kernel::bind`].
    pub fn bind(
        &self,
        gpu: &Gpu,
        tile: &TileBuffers,
        buffers: &CacheBuffers,
        records: &ViewRecords,
    ) -> Result<BoundCache> {
        let own = CacheBindings {
            points: &tile.points,
            surfaces: &tile.surfaces,
            wanted_count: &buffers.wanted_count,
            wanted_points: &buffers.wanted_points,
            radiance_indirect: tile.required_indirect("cache")?,
            path_count: &buffers.path_count,
            path_points: &buffers.path_points,
            path_arguments: &buffers.path_arguments,
        };
        let entry = |name: &str| self.0.bind(gpu, name, &[&own, records]);
        Ok(BoundCache {
            request: entry("request")?,
            interpolate: entry("interpolate")?,
            arrange_paths: entry("arrange_paths")?,
            blocks: records.blocks,
            columns: records.columns,
            rows: records.rows,
        })
    }
}

/// The pass, bound.
pub struct BoundCache {
    request: BoundKernel,
    interpolate: BoundKernel,
    arrange_paths: BoundKernel,
    blocks: [f32; 2],
    columns: u32,
    rows: u32,
}

impl BoundCache {
    fn parameters(&self, tile: &Tile) -> CacheParameters {
        CacheParameters { tile: *tile, blocks: self.blocks, block_columns: self.columns, block_rows: self.rows }
    }

    /// Lists the points of the tile that are to get a record.
    pub fn record_requests(&self, frame: &mut Frame<'_>, buffers: &CacheBuffers, tile: &Tile) {
        frame.clear(&buffers.wanted_count);
        frame.run(&self.request, tile.point_count, &self.parameters(tile));
    }

    /// Lights the points of the tile from the records, and lists those left to path tracing.
    pub fn record_interpolate(&self, frame: &mut Frame<'_>, buffers: &CacheBuffers, tile: &Tile) {
        frame.clear(&buffers.path_count);
        frame.run(&self.interpolate, tile.point_count, &self.parameters(tile));
        frame.run(&self.arrange_paths, 1, &self.parameters(tile));
    }
}

/// The points that [`BoundCache::record_requests`] listed, in an order that depends on nothing but the points.
///
/// # Errors
/// As [`Gpu::read`].
pub fn wanted(gpu: &Gpu, buffers: &CacheBuffers) -> Result<Vec<u32>> {
    let count = gpu.read::<u32>(&buffers.wanted_count, 1)?[0];
    let mut points = gpu.read::<u32>(&buffers.wanted_points, count as usize)?;
    points.sort_unstable();
    Ok(points)
}
