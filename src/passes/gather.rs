//! Pass `gather`: the final gather of irradiance records, with their gradients (Ward and Heckbert 1992), in waves: each
//! adds rays to those that the records have.

use std::ops::Range;

use kernel_kit::{
    Binding, Bindings, BoundKernel, Buffer, Gpu, Kernel, KernelTable, TableFormat, bindings, shared_struct, whole_rows,
};

use super::path::{BoundPath, GatherHit, HitBindings, Path, PathParameters, PathQueue};
use super::{Point, Tile, TileBuffers, VisiblePointBindings, kernel};
use crate::Result;
use crate::gpu_scene::sobol;
use crate::kernels::{RECORD_HEAD_TEXELS, RECORD_VALUE_TEXELS_CURVED, RECORD_VALUE_TEXELS_FLAT};
use crate::specialisation::features::{Feature, Features};
use crate::specialisation::surface_vectors;

shared_struct! {
    /// Immediates of the pass; see `shaders/gather.wgsl`.
    pub struct GatherParameters {
        first_record: u32,
        count: u32,
        rings: u32,
        sectors: u32,
        earlier_rays: u32,
        seed: u32,
        height: u32,
        min_radius: f32,
    }
}

shared_struct! {
    /// Position of a record, and data that its waves share; see `shaders/gather.wgsl`.
    pub struct RecordOrigin {
        position: [f32; 3],
        geometric: u32,
        normal: u32,
        inverse_distance: f32,
        variance: f32,
        padding: u32,
    }
}

bindings! {
    /// Everything that the kernel reads and writes except the scene and the global map.
    struct GatherBindings {
        pub counters: &Buffer,
        pub wanted: &Buffer,
        pub wave_points: &Buffer,
        pub gathered: &Buffer,
        pub path_count: &Buffer,
        pub path_arguments: &Buffer,
        pub path_points: &Buffer,
        pub hit_points: &Buffer,
        pub hit_surfaces: &Buffer,
        pub gather_hits: &Buffer,
        pub record_origins: &Buffer,
        pub record_heads: &Buffer,
        pub record_values: &Buffer,
    }
}

shared_struct! {
    /// Head of an irradiance record; see `shaders/lib/record.wgsl`. Lengths are normalised.
    pub struct RecordHead {
        /// Position.
        pub position: [f32; 3],
        /// As `gather` writes it, the size of a pixel at the position; in the table that points are interpolated from,
        /// the record's radius. 0 marks a record that is not finite, which is not used.
        pub size: f32,
        /// Unit normal.
        pub normal: [f32; 3],
        /// Harmonic mean of the distances of its rays' hits, or less where the gradient brings the irradiance to 0
        /// sooner.
        pub distance: f32,
    }
}

const _: () = assert!(RECORD_HEAD_TEXELS as usize * size_of::<[f32; 4]>() == size_of::<RecordHead>());

/// Maximum number of rays in a dispatch, unless a record has more. Their buffers take some 15 MiB where rays hit
/// Lambertian surfaces, and more at glossy ones. The dispatch is too short for a desktop's watchdog to stop it.
const DISPATCH_RAYS: u32 = 1 << 17;

/// The pass; see `shaders/gather.wgsl`.
pub struct Gather(Kernel);

/// Records on the device.
#[derive(Clone)]
pub struct RecordBuffers {
    /// [`RecordOrigin`]s.
    pub origins: Buffer,
    /// [`RecordHead`]s, as the last wave wrote them.
    pub heads: Buffer,
    /// Irradiance and gradients; see `shaders/lib/record.wgsl`.
    pub values: Buffer,
    /// Points that get a record.
    wanted: Buffer,
    /// Words of the values of a record.
    value_words: usize,
}

/// Words of a [`RecordOrigin`].
const ORIGIN_WORDS: usize = size_of::<RecordOrigin>() / size_of::<u32>();

impl RecordBuffers {
    /// Room for `records` records; values in whole rows of a table. Kernels of `features` with bent normals keep
    /// rotational gradients too.
    ///
    /// # Errors
    /// As [`Gpu::buffer`].
    pub fn new(gpu: &Gpu, features: &Features, records: u32) -> Result<RecordBuffers> {
        let bent = features.has(Feature::SmoothNormals) || features.has(Feature::NormalMaps);
        let texels = if bent { RECORD_VALUE_TEXELS_CURVED } else { RECORD_VALUE_TEXELS_FLAT } as usize;
        let records = records as usize;
        Ok(RecordBuffers {
            origins: gpu.buffer::<RecordOrigin>("penumbra/gather/origins", records)?,
            heads: gpu.buffer::<RecordHead>("penumbra/gather/record_heads", records)?,
            values: gpu.buffer::<[f32; 4]>("penumbra/cache/values", whole_rows(records * texels))?,
            wanted: gpu.buffer::<u32>("penumbra/gather/wanted", records)?,
            value_words: 4 * texels,
        })
    }

    /// Keeps the origins and values of some of `all` records, in their order.
    ///
    /// # Errors
    /// As [`Gpu::read`].
    pub fn keep(&self, gpu: &Gpu, kept: &[usize], all: usize) -> Result<()> {
        for (buffer, size) in [(&self.origins, ORIGIN_WORDS), (&self.values, self.value_words)] {
            let state = gpu.read::<u32>(buffer, size * all)?;
            let some: Vec<u32> = kept.iter().flat_map(|i| &state[size * i..][..size]).copied().collect();
            gpu.write(buffer, &some);
        }
        Ok(())
    }

    /// The variances of `count` records' irradiance, sums of the channels; and their values.
    ///
    /// # Errors
    /// As [`Gpu::read`].
    pub fn read(&self, gpu: &Gpu, count: usize) -> Result<(Vec<f32>, Vec<f32>)> {
        let origins: Vec<RecordOrigin> = gpu.read(&self.origins, count)?;
        let values = gpu.read(&self.values, count * self.value_words)?;
        Ok((origins.iter().map(|origin| origin.variance).collect(), values))
    }

    /// An empty buffer of values, for as many records.
    ///
    /// # Errors
    /// As [`Gpu::buffer`].
    pub fn values_like(&self, gpu: &Gpu) -> Result<Buffer> {
        Ok(gpu.buffer::<u32>("penumbra/cache/filtered_values", self.values.bytes as usize / size_of::<u32>())?)
    }

    /// Bytes of all of them.
    pub fn bytes(&self) -> u64 {
        self.origins.bytes + self.heads.bytes + self.values.bytes + self.wanted.bytes
    }
}

/// Rays that records get together. `rays` is a power of two. `earlier` is 0, or a power of two that is not less than
/// `rays`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Wave {
    /// Rays that each record has.
    pub earlier: u32,
    /// Rays that each gets.
    pub rays: u32,
}

impl Wave {
    /// Numbers of rings and sectors that divide the hemisphere into a stratum for each ray, about as wide as it is high
    /// (Ward and Heckbert 1992: pi times as many sectors as rings): both are powers of two.
    pub fn strata(self) -> [u32; 2] {
        let levels = self.rays.ilog2();
        // Twice or four times as many sectors as rings.
        let rings = (levels.saturating_sub(1)) / 2;
        [1 << rings, 1 << (levels - rings)]
    }

    /// The points of its rays in the unit square, by stratum, as fractions of 2^32: points `earlier` to `earlier +
    /// rays` of the first two dimensions of the Sobol sequence. That is a (0, 2)-sequence (Niederreiter 1987): each
    /// stratum has one point, and together with the points of earlier waves so has each stratum of finer divisions.
    pub fn points(self) -> Vec<[u32; 2]> {
        let directions = sobol::directions();
        let [rings, sectors] = self.strata();
        let mut points = vec![[0; 2]; self.rays as usize];
        for number in self.earlier..self.earlier + self.rays {
            let mut point = [0; 2];
            for bit in (0..32).filter(|bit| number >> bit & 1 == 1) {
                point = [point[0] ^ directions[bit][0], point[1] ^ directions[bit][1]];
            }
            let stratum = |x: u32, strata: u32| ((u64::from(x) * u64::from(strata)) >> 32) as usize;
            points[stratum(point[1], sectors) * rings as usize + stratum(point[0], rings)] = point;
        }
        points
    }
}

/// The pass, bound, with its buffers.
pub struct BoundGather {
    place: BoundKernel,
    gather: BoundKernel,
    arrange_paths: BoundKernel,
    path: BoundPath,
    record: BoundKernel,
    records: RecordBuffers,
    rays: RayBuffers,
    wave: Wave,
}

/// The rays of a dispatch. Buffers for many rays take a while to make, and most waves have few rays. So they grow when
/// necessary, and are kept from wave to wave.
#[derive(Clone)]
pub struct RayBuffers {
    /// For each ray its radiance, and the distance of its hit.
    gathered: Buffer,
    /// The rays that paths continue.
    paths: PathQueue,
    /// Their hits, by index of the ray.
    points: KernelTable,
    surfaces: KernelTable,
    hits: Buffer,
    /// Their capacity, in rays.
    room: u32,
    /// Vectors of a hit's surface.
    surface_vectors: u32,
}

impl Bindings for RayBuffers {
    /// The hits, as pass `path` reads them.
    fn get(&self, name: &str) -> Option<Binding<'_>> {
        let points = VisiblePointBindings { point_table: &self.points.table, surface_table: &self.surfaces.table };
        let found = points.find(name).or_else(|| self.paths.bindings().find(name));
        found.or_else(|| HitBindings { gather_hits: &self.hits }.find(name))
    }
}

impl RayBuffers {
    /// Room for `room` rays, for kernels of these features.
    ///
    /// # Errors
    /// As [`Gpu::buffer`].
    pub fn new(gpu: &Gpu, features: &Features, room: u32) -> Result<RayBuffers> {
        RayBuffers::of(gpu, surface_vectors(features), room)
    }

    fn of(gpu: &Gpu, surface_vectors: u32, room: u32) -> Result<RayBuffers> {
        let (rays, vectors) = (room as usize, surface_vectors as usize);
        let points = gpu.buffer::<Point>("penumbra/gather/hit_points", rays)?;
        let surfaces = gpu.buffer::<[f32; 4]>("penumbra/gather/hit_surfaces", rays * vectors)?;
        Ok(RayBuffers {
            gathered: gpu.buffer::<[f32; 4]>("penumbra/gather/gathered", rays)?,
            paths: PathQueue::new(gpu, "gather", room)?,
            points: gpu.table_of(points, TableFormat::Uint)?,
            surfaces: gpu.table_of(surfaces, TableFormat::Uint)?,
            hits: gpu.buffer::<GatherHit>("penumbra/gather/gather_hits", rays)?,
            room,
            surface_vectors,
        })
    }

    /// Makes room for a wave of `rays` rays of each of `records` records, or for the maximum of a dispatch if that is
    /// less, and in any case for one record. Returns whether it made new buffers.
    ///
    /// # Errors
    /// As [`Gpu::buffer`].
    pub fn grow(&mut self, gpu: &Gpu, records: u32, rays: u32) -> Result<bool> {
        let max = DISPATCH_RAYS.max(rays);
        let needed = records.max(1).saturating_mul(rays).min(max);
        if needed <= self.room {
            return Ok(false);
        }
        *self = RayBuffers::of(gpu, self.surface_vectors, needed.max(2 * self.room).min(max))?;
        Ok(true)
    }

    /// Bytes of all of them.
    pub fn bytes(&self) -> u64 {
        let RayBuffers { gathered, paths, hits, points, surfaces, .. } = self;
        let buffers = [gathered, &paths.points, hits].map(|buffer| buffer.bytes);
        buffers.iter().sum::<u64>() + points.buffer.bytes + surfaces.buffer.bytes
    }
}

impl Gather {
    /// Compiles the kernel.
    ///
    /// # Errors
    /// As [`Kernel::new`].
    pub fn new(gpu: &Gpu, features: &Features, constants: &[(&str, f64)]) -> Result<Gather> {
        Ok(Gather(kernel(gpu, "gather", features, constants, &[GatherBindings::DECLARED])?))
    }

    /// Binds the pass, and pass `path`, which continues paths from its hits, to a tile's buffers, for a wave of rays of
    /// records. The buffers of rays have room for at least one record's rays.
    ///
    /// # Errors
    /// As [`Kernel::bind`] and [`Gpu::buffer`].
    pub fn bind(
        &self,
        gpu: &Gpu,
        path: &Path,
        tile: &TileBuffers,
        wave: Wave,
        (records, rays): (&RecordBuffers, &RayBuffers),
        scene: &[&dyn Bindings],
    ) -> Result<BoundGather> {
        assert!(wave.rays <= rays.room, "no room for the {} rays of a record", wave.rays);
        let own = GatherBindings {
            counters: &tile.counters,
            wanted: &records.wanted,
            wave_points: &gpu.upload("penumbra/gather/wave_points", &wave.points())?,
            gathered: &rays.gathered,
            path_count: &rays.paths.count,
            path_arguments: &rays.paths.arguments,
            path_points: &rays.paths.points,
            hit_points: &rays.points.buffer,
            hit_surfaces: &rays.surfaces.buffer,
            gather_hits: &rays.hits,
            record_origins: &records.origins,
            record_heads: &records.heads,
            record_values: &records.values,
        };
        let mut sets: Vec<&dyn Bindings> = vec![&own, tile];
        sets.extend(scene);
        let entry = |name: &str| self.0.bind(gpu, name, &sets);
        Ok(BoundGather {
            place: entry("place")?,
            gather: entry("gather")?,
            arrange_paths: entry("arrange_paths")?,
            path: path.bind_at_hits(gpu, tile, &rays.gathered, rays, scene)?,
            record: entry("record")?,
            records: records.clone(),
            rays: rays.clone(),
            wave,
        })
    }
}

/// Minimum radius in pixels of records with few rays: denser ones cost more than they improve.
const MAX_MIN_RADIUS: f32 = 3.0;

/// Number of rays of a record above which the minimum radius shrinks. With 64 the box of `scenes/` had 1.08 times the
/// error at 16 samples.
const FEW_RAYS: u32 = 128;

/// Minimum radius in pixels of records with this number of rays. Where surfaces meet, a record has an error
/// proportional to the square of its radius, which more rays do not reduce. So the radius shrinks with the square root
/// of the number of rays: the square of this error then falls faster than the variance.
pub fn min_radius(rays: u32) -> f32 {
    MAX_MIN_RADIUS * (FEW_RAYS as f32 / rays.max(FEW_RAYS) as f32).sqrt()
}

/// Parameters of all gathers of a render.
#[derive(Clone, Copy, Debug)]
pub struct GatherSettings {
    /// Maximum number of bounces of indirect light.
    pub max_bounces: u32,
    /// Seed of the render: the same for all waves, whose rays are stratified together.
    pub seed: u32,
    /// Height of the image in pixels.
    pub height: u32,
}

impl BoundGather {
    /// Rays that each record gets.
    pub fn rays(&self) -> u32 {
        self.wave.rays
    }

    fn parameters(&self, records: &Range<u32>, settings: GatherSettings) -> GatherParameters {
        let ([rings, sectors], earlier_rays) = (self.wave.strata(), self.wave.earlier);
        let GatherSettings { seed, height, .. } = settings;
        let (first_record, count) = (records.start, records.len() as u32);
        let min_radius = min_radius(earlier_rays + self.wave.rays);
        GatherParameters { first_record, count, rings, sectors, earlier_rays, seed, height, min_radius }
    }

    /// Places new records at the tile's points `wanted`, after the `before` earlier ones, and gathers the wave at them.
    /// Returns their heads.
    ///
    /// # Errors
    /// As [`Gpu::check`].
    pub fn place(&self, gpu: &Gpu, wanted: &[u32], before: u32, settings: GatherSettings) -> Result<Vec<RecordHead>> {
        gpu.write(&self.records.wanted, wanted);
        let records = before..before + wanted.len() as u32;
        let mut frame = gpu.frame("gather");
        frame.run(&self.place, wanted.len() as u32, &self.parameters(&records, settings));
        frame.submit()?;
        self.gather(gpu, records, settings)
    }

    /// Gathers the wave at the records, and returns their heads.
    ///
    /// # Errors
    /// As [`Gpu::check`].
    pub fn gather(&self, gpu: &Gpu, records: Range<u32>, settings: GatherSettings) -> Result<Vec<RecordHead>> {
        let records_at_once = (self.rays.room / self.wave.rays).max(1);
        let paths = PathParameters {
            max_bounces: settings.max_bounces,
            // Nothing but paths lights the hits, and records are means of all rays, however bright.
            light_samples: 0,
            max_indirect: f32::MAX,
            from_hits: 1,
            paths_per_point: 1,
            path_number: 0,
            tile: Tile::default(),
        };
        for first in records.clone().step_by(records_at_once as usize) {
            let some = first..(first + records_at_once).min(records.end);
            let parameters = self.parameters(&some, settings);
            let rays = parameters.count * self.wave.rays;
            let mut frame = gpu.frame("gather");
            frame.clear(&self.rays.paths.count);
            frame.run(&self.gather, rays, &parameters);
            frame.run(&self.arrange_paths, 1, &parameters);
            frame.publish(&self.rays.points, rays);
            frame.publish(&self.rays.surfaces, rays * self.rays.surface_vectors);
            self.path.record_queued(&mut frame, &self.rays.paths.arguments, &paths);
            frame.run(&self.record, parameters.count, &parameters);
            frame.submit()?;
        }
        let heads = gpu.read::<RecordHead>(&self.records.heads, records.end as usize)?;
        Ok(heads[records.start as usize..].to_vec())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Four times the rays halve the minimum radius, from 128 on; with fewer it is three pixels.
    #[test]
    fn minimum_radii_shrink_as_rays_come() {
        assert!([1, 16, 127, 128].iter().all(|rays| min_radius(*rays) == 3.0));
        assert_eq!([512, 2048, 8192].map(min_radius), [1.5, 0.75, 0.375]);
        assert!(min_radius(129) < 3.0 && min_radius(u32::MAX) > 0.0);
    }

    /// The number of points in each of the strata that divide the square into `columns` x `rows`.
    fn counts(points: &[[u32; 2]], [columns, rows]: [u32; 2]) -> Vec<u32> {
        let mut counts = vec![0; (columns * rows) as usize];
        for point in points {
            let [x, y] = [(point[0], columns), (point[1], rows)]
                .map(|(x, strata)| ((u64::from(x) * u64::from(strata)) >> 32) as usize);
            counts[y * columns as usize + x] += 1;
        }
        counts
    }

    /// Each stratum of a wave has the point that is listed for it; and each stratum of any division into as many as
    /// there are rays has one point, of this wave and of all waves together.
    #[test]
    fn waves_are_stratified_by_themselves_and_together() {
        let mut all = Vec::new();
        for (earlier, rays) in [(0, 1), (1, 1), (2, 2), (4, 4), (8, 8), (16, 16), (32, 32), (64, 64), (128, 128)] {
            let wave = Wave { earlier, rays };
            let [rings, sectors] = wave.strata();
            assert_eq!(rings * sectors, rays);
            assert!(rays < 4 || (2..=4).contains(&(sectors / rings)), "{rings} x {sectors}");
            let points = wave.points();
            for (stratum, point) in points.iter().enumerate() {
                let alone = counts(&[*point], [rings, sectors]);
                assert_eq!(alone.iter().position(|count| *count == 1), Some(stratum), "{wave:?}");
            }
            all.extend(points.clone());
            for (points, count) in [(&points, rays), (&all, earlier + rays)] {
                for level in 0..=count.ilog2() {
                    let counts = counts(points, [1 << level, count >> level]);
                    assert!(counts.iter().all(|count| *count == 1), "{wave:?}, {} x {}", 1 << level, count >> level);
                }
            }
        }
    }
}
