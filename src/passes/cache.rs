//! Pass `cache`: which points need an irradiance record of their own, and the light of all others from the records there
//! are.

use crate::gpu::buffer::{TableFormat, whole_rows};
use crate::gpu::{Binding, Bindings, BoundKernel, Buffer, Features, Frame, Gpu, Kernel, Resources, Table};
use crate::{Result, shared_struct};

use super::gather::RecordHead;
use super::{Tile, TileBuffers, kernel};

shared_struct! {
    /// Immediates of the pass; see `shaders/cache.wgsl`.
    pub struct CacheParameters {
        tile: Tile,
        blocks: [f32; 2],
        block_columns: u32,
        block_rows: u32,
    }
}

/// The records of a view as the kernels look them up: by block of the image; see `shaders/lib/record.wgsl`.
pub struct RecordTables {
    blocks: [f32; 2],
    columns: u32,
    rows: u32,
    heads: Table,
    values: Table,
    starts: Table,
    records: Table,
}

/// Pixels of a block's side: neighbouring points read the same records, and few that do not reach them.
const BLOCK: u32 = 8;

impl RecordTables {
    /// Tables of records for an image of that size. `heads` have radii, `reach` gives the part of the image (low and high
    /// corner, 0 to 1) that a record reaches, `values` what pass `gather` wrote.
    ///
    /// # Errors
    /// As [`Gpu::table`].
    pub fn new(
        gpu: &Gpu,
        heads: &[RecordHead],
        values: &Buffer,
        size: [u32; 2],
        reach: impl Fn(&RecordHead) -> Option<[[f32; 2]; 2]>,
    ) -> Result<RecordTables> {
        let [columns, rows] = size.map(|side| side.div_ceil(BLOCK));
        let blocks = size.map(|side| side as f32 / BLOCK as f32);
        // Blocks that a record reaches: columns from, to, and rows.
        let spans: Vec<[[u32; 2]; 2]> = heads
            .iter()
            .map(|head| match reach(head) {
                Some([low, high]) => [0, 1].map(|axis| {
                    let block = |at: f32| (at * blocks[axis]).clamp(0.0, [columns, rows][axis] as f32) as u32;
                    [block(low[axis]), (block(high[axis]) + 1).min([columns, rows][axis])]
                }),
                None => [[0; 2]; 2],
            })
            .collect();
        let cells = |[[left, right], [top, bottom]]: [[u32; 2]; 2]| {
            (top..bottom).flat_map(move |y| (left..right).map(move |x| (y * columns + x) as usize))
        };
        let mut starts = vec![0u32; (columns * rows + 1) as usize];
        spans.iter().flat_map(|span| cells(*span)).for_each(|cell| starts[cell + 1] += 1);
        for cell in 1..starts.len() {
            starts[cell] += starts[cell - 1];
        }
        let mut records = vec![0u32; starts[starts.len() - 1] as usize];
        let mut ends = starts.clone();
        for (id, span) in spans.iter().enumerate() {
            for cell in cells(*span) {
                records[ends[cell] as usize] = id as u32;
                ends[cell] += 1;
            }
        }
        let four = |mut words: Vec<u32>| -> Vec<[u32; 4]> {
            words.resize(words.len().next_multiple_of(4).max(4), 0);
            words.chunks_exact(4).map(|c| [c[0], c[1], c[2], c[3]]).collect()
        };
        let mut frame = gpu.frame("cache");
        let values = gpu.kernel_table(&mut frame, values.clone(), TableFormat::Float)?;
        frame.submit()?;
        Ok(RecordTables {
            blocks,
            columns,
            rows,
            heads: gpu.table("penumbra/cache/heads", bytemuck::cast_slice::<_, [f32; 4]>(heads), TableFormat::Float)?,
            values,
            starts: gpu.table("penumbra/cache/block_starts", &four(starts), TableFormat::Uint)?,
            records: gpu.table("penumbra/cache/block_records", &four(records), TableFormat::Uint)?,
        })
    }
}

impl Bindings for RecordTables {
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

/// A buffer for the values of `records` records of the kernels of `features`, in whole rows of a table.
///
/// # Errors
/// As [`Gpu::buffer`].
pub fn record_values(gpu: &Gpu, features: &Features, records: u32) -> Result<Buffer> {
    let bent = features.has("smooth_normals") || features.has("normal_maps");
    let vectors = if bent { 6 } else { 3 };
    gpu.buffer::<[f32; 4]>("penumbra/cache/values", whole_rows(records as usize * vectors))
}

/// The pass; see `shaders/cache.wgsl`.
pub struct Cache(Kernel);

/// What the pass writes beside the light of the points.
pub struct CacheBuffers {
    wanted_count: Buffer,
    wanted_points: Buffer,
    /// How many points have light left for paths: no record speaks for them, or they are not Lambertian.
    pub path_count: Buffer,
    /// Which.
    pub path_points: Buffer,
    /// Arguments of a dispatch over them.
    pub path_arguments: Buffer,
}

impl CacheBuffers {
    /// For tiles of `points` points.
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

impl Bindings for CacheBuffers {
    fn get(&self, name: &str) -> Option<Binding<'_>> {
        Some(match name {
            "wanted_count" => (&self.wanted_count).into(),
            "wanted_points" => (&self.wanted_points).into(),
            "path_count" => (&self.path_count).into(),
            "path_points" => (&self.path_points).into(),
            "path_arguments" => (&self.path_arguments).into(),
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
        let own = ["points", "surfaces", "radiance_indirect", "wanted_points", "path_points"];
        Ok(Cache(kernel(gpu, "cache", features, &[], &own)?))
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
        records: &RecordTables,
    ) -> Result<BoundCache> {
        let mut own = Resources::new().with("points", &tile.points).with("surfaces", &tile.surfaces);
        if let Some(indirect) = &tile.radiance_indirect {
            own = own.with("radiance_indirect", indirect);
        }
        let entry = |name: &str| self.0.bind(gpu, name, &[&own, buffers, records]);
        Ok(BoundCache {
            place: entry("place")?,
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
    place: BoundKernel,
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

    /// Lists the points of the tile that want a record.
    pub fn record_place(&self, frame: &mut Frame<'_>, buffers: &CacheBuffers, tile: &Tile) {
        frame.clear(&buffers.wanted_count);
        frame.run(&self.place, tile.point_count, &self.parameters(tile));
    }

    /// Lights the points of the tile, and lists those that have light left for paths.
    pub fn record_interpolate(&self, frame: &mut Frame<'_>, buffers: &CacheBuffers, tile: &Tile) {
        frame.clear(&buffers.path_count);
        frame.run(&self.interpolate, tile.point_count, &self.parameters(tile));
        frame.run(&self.arrange_paths, 1, &self.parameters(tile));
    }
}

/// The points that [`BoundCache::record_place`] listed, in an order that depends on nothing but the points.
///
/// # Errors
/// As [`Gpu::read`].
pub fn wanted(gpu: &Gpu, buffers: &CacheBuffers) -> Result<Vec<u32>> {
    let count = gpu.read::<u32>(&buffers.wanted_count, 1)?[0];
    let mut points = gpu.read::<u32>(&buffers.wanted_points, count as usize)?;
    points.sort_unstable();
    Ok(points)
}
