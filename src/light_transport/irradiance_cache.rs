//! The irradiance cache ("the irradiance gradient method" of the paper; Ward and Heckbert 1992): irradiance records,
//! placed where the view needs them, from coarse to fine, before the first sample. All samples share them. As samples
//! are added, so are gather rays to each record.

use std::mem;

use glam::Vec3;
use kernel_kit::{Bindings, Buffer, Frame, Gpu};
use rayon::prelude::*;

use super::noisy_records::NoisyRecords;
use super::record_tree::{RecordTree, weight};
use crate::Result;
use crate::gpu_scene::CameraUniform;
use crate::kernels::RECORD_MIN_WEIGHT;
use crate::passes::cache::{BlockGrid, BoundCache, Cache, CacheBuffers, ImageArea, ViewRecords, wanted};
use crate::passes::gather::{
    BoundGather, Gather, GatherSettings, RayBuffers, RecordBuffers, RecordHead, Wave, min_radius,
};
use crate::passes::path::Path;
use crate::passes::primary::BoundPrimary;
use crate::passes::{Tile, TileBuffers};
use crate::settings::{ImageSettings, Settings};
use crate::specialisation::features::Features;
use crate::statistics::Counter;
use crate::statistics::totals::Totals;

/// Distance in pixels of the points that may get a record, from pass to pass. Points of the same pass do not use each
/// other's records, so the steps are small: a factor f makes up to f squared times as many records as needed.
const SPACINGS: [u32; 9] = [32, 22, 16, 11, 8, 6, 4, 3, 2];

/// Spacings when there are records of earlier waves, which leave few points without one: a spacing takes the same time
/// however few records it adds. With all nine, `scenes/crowd.glb` took 1.2 times as long with 4 and with 16 samples. A
/// spacing that is a multiple of another visits the same points: with 8, 4 and 2 `scenes/materials.glb` had 1.15 times
/// the error.
const LATER_SPACINGS: [u32; 3] = [4, 3, 2];

/// How many of the nine spacings a preview uses besides the records of other views; paths light the remaining points.
/// With all nine, `scenes/crowd.glb` had 2.9 pictures a second in the window; with six, 12.
const SPACINGS_BESIDE_KEPT: usize = 6;

/// Gather rays between two readings of the counters. Each may cause as many as 255 further rays before the 32 bits of a
/// count overflow.
const COUNTED_RAYS: u32 = 1 << 24;

/// Maximum radius of a record in pixels. Farther away, gradients miss detail between the records. Other radii were not
/// compared.
const MAX_RADIUS_PIXELS: f32 = 20.0;

pub(crate) struct CacheKernels {
    gather: Gather,
    cache: Cache,
}

impl CacheKernels {
    pub fn new(gpu: &Gpu, features: &Features, constants: &[(&str, f64)]) -> Result<CacheKernels> {
        let (gather, cache) =
            rayon::join(|| Gather::new(gpu, features, constants), || Cache::new(gpu, features, constants));
        Ok(CacheKernels { gather: gather?, cache: cache? })
    }
}

/// The records of a view, ready to light its points.
pub(crate) struct IrradianceCache {
    buffers: CacheBuffers,
    bound: BoundCache,
    records: Records,
}

/// The parts of the render that filling the cache needs.
pub(crate) struct Filling<'a> {
    pub gpu: &'a Gpu,
    pub kernels: &'a CacheKernels,
    pub path: &'a Path,
    pub features: &'a Features,
    pub tile: &'a TileBuffers,
    pub primary: &'a BoundPrimary,
    /// The scene and the global map.
    pub scene: &'a [&'a dyn Bindings],
    pub camera: &'a CameraUniform,
    pub settings: &'a Settings,
}

/// Maximum number of records that are kept from view to view: searching more takes longer than making new ones.
const MAX_KEPT: usize = 1 << 14;

/// The records so far.
pub(crate) struct Records {
    heads: Vec<RecordHead>,
    buffers: RecordBuffers,
    /// Their capacity, in records.
    room: u32,
    ray_buffers: RayBuffers,
    /// Gather rays of each record so far.
    rays: u32,
    /// Maximum radius of each record, as far as the records around it limit it. New records, at the end, have no limit
    /// yet.
    limits: Vec<f32>,
}

impl IrradianceCache {
    /// Places records all over the view, except where records that are `kept` from other views reach, and gathers at
    /// each.
    pub fn new(with: &Filling<'_>, kept: Option<Records>, totals: &mut Totals) -> Result<IrradianceCache> {
        let buffers = CacheBuffers::new(with.gpu, with.tile.capacity())?;
        let (mut records, spacings) = match kept.filter(|kept| kept.heads.len() <= MAX_KEPT) {
            Some(kept) => (kept, &SPACINGS[..SPACINGS_BESIDE_KEPT]),
            None => {
                let buffers = RecordBuffers::new(with.gpu, with.features, 1)?;
                let ray_buffers = RayBuffers::new(with.gpu, with.features, 0)?;
                let (heads, limits) = (Vec::new(), Vec::new());
                (Records { heads, buffers, room: 1, ray_buffers, rays: 0, limits }, SPACINGS.as_slice())
            }
        };
        records.rays = with.settings.gather_rays();
        let bound = records.fill(with, &buffers, spacings, totals)?;
        Ok(IrradianceCache { buffers, bound, records })
    }

    /// Adds gather rays in waves, each of which doubles them, until each record has the number of the settings. More
    /// rays give better distances of surfaces. So it then shrinks records whose gradients do not hold, drops those that
    /// others now cover, and places new ones where coverage is too low. Returns the [`BoundCache`] of the previous
    /// records.
    pub fn add_rays(&mut self, with: &Filling<'_>, totals: &mut Totals) -> Result<BoundCache> {
        let records = &mut self.records;
        let wanted = with.settings.gather_rays();
        if records.rays < wanted {
            // The previous binding keeps the old buffers: the caller compares both.
            records.move_to(with, records.room)?;
            while records.rays < wanted {
                records.add_wave(with, wanted - records.rays, totals)?;
            }
            records.limit_radii(with)?;
            records.leave_out_covered(with)?;
        }
        let bound = records.fill(with, &self.buffers, &LATER_SPACINGS, totals)?;
        Ok(mem::replace(&mut self.bound, bound))
    }

    /// Writes what the records change of the indirect light at the tile's points, compared with those `before`.
    pub fn change(&self, frame: &mut Frame<'_>, before: &BoundCache, tile: &Tile) {
        self.bound.record_change(frame, before, &self.buffers, tile);
    }

    /// The records, for another view.
    pub fn into_records(self) -> Records {
        self.records
    }

    /// Lights the points of the tile by the records.
    pub fn interpolate(&self, frame: &mut Frame<'_>, tile: &Tile) {
        self.bound.record_interpolate(frame, &self.buffers, tile);
    }

    /// Its buffers, and the queue of points that no record covers.
    pub fn buffers(&self) -> &CacheBuffers {
        &self.buffers
    }

    /// Bytes of its buffers for a frame.
    pub fn frame_bytes(&self) -> u64 {
        self.buffers.bytes() + self.records.ray_buffers.bytes()
    }
}

impl Filling<'_> {
    fn gather_settings(&self) -> GatherSettings {
        let (image, max_bounces) = (&self.settings.image, self.settings.indirect.max_bounces);
        GatherSettings { max_bounces, seed: image.seed, height: image.height }
    }
}

impl Records {
    /// Adds records where points have too few, from coarse to fine.
    fn fill(
        &mut self,
        with: &Filling<'_>,
        buffers: &CacheBuffers,
        spacings: &[u32],
        totals: &mut Totals,
    ) -> Result<BoundCache> {
        let mut with_radii = self.with_radii(with);
        let mut bound = None;
        for spacing in spacings {
            let records = match bound.take() {
                Some(records) => records,
                None => bind(with, buffers, &with_radii, &self.buffers.values)?,
            };
            if self.fill_at(with, buffers, &records, *spacing, totals)? {
                with_radii = self.with_radii(with);
            } else {
                bound = Some(records);
            }
        }
        totals.indirect.records = self.heads.len() as u64;
        totals.min_radius_records = self.count_of_min_radius(with.settings.indirect.irradiance_cache.accuracy);
        let values = self.filtered_values(with, &with_radii)?;
        totals.indirect_bytes += self.buffers.bytes() + values.bytes;
        bind(with, buffers, &with_radii, &values)
    }

    /// Adds records where points have too few. There is one point for `spacing` x `spacing` pixels of the image.
    /// Returns whether it added any.
    fn fill_at(
        &mut self,
        with: &Filling<'_>,
        buffers: &CacheBuffers,
        cache: &BoundCache,
        spacing: u32,
        totals: &mut Totals,
    ) -> Result<bool> {
        let Filling { gpu, tile, primary, .. } = *with;
        let image = &with.settings.image;
        let [width, height] = [image.width, image.height].map(|side| side.div_ceil(spacing));
        // All pieces have the same records, which are therefore for the whole image.
        let crop = if image.piece.is_some() { image.whole() } else { image.crop_window() };
        // The pixels of the coarse image that overlap the crop.
        let reach = |first: u32, side: u32| first / spacing..(first + side).div_ceil(spacing);
        let (columns, rows) = (reach(crop.x, crop.width), reach(crop.y, crop.height));
        let column_count = columns.end - columns.start;
        let rows_at_once = (tile.capacity() / column_count).min(rows.end - rows.start);
        let before = self.heads.len();
        let mut gather: Option<BoundGather> = None;
        for first_row in rows.clone().step_by(rows_at_once as usize) {
            let row_count = rows_at_once.min(rows.end - first_row);
            let pixel_count = row_count * column_count;
            let coarse = Tile {
                width,
                height,
                first_column: columns.start,
                first_row,
                columns: column_count,
                rows: row_count,
                pixel_count,
                point_count: pixel_count,
                samples_per_pixel: 1,
                seed: image.seed,
                // Anywhere in one pixel of the image. Centres may all lie exactly on the edge of two surfaces, as on
                // the diagonals of a room seen from the front. Rounding puts such a point on either side of the other
                // surface, and from a record there half of the gather rays see what is behind it.
                centred: 1.0 - 1.0 / spacing as f32,
                ..Tile::default()
            };
            let mut frame = gpu.frame("cache");
            frame.clear(&tile.counters);
            primary.record(&mut frame, &coarse);
            cache.record_requests(&mut frame, buffers, &coarse);
            frame.submit()?;
            let wanted = wanted(gpu, buffers)?;
            if !wanted.is_empty() {
                let bound = self.place(with, &wanted, gather.take(), totals)?;
                gather = Some(bound);
            }
            let counters: Vec<u32> = gpu.read(&tile.counters, Counter::COUNT)?;
            totals.add_gathered(&counters);
            totals.gather_rays += u64::from(pixel_count);
        }
        Ok(self.heads.len() > before)
    }

    /// Places records at the `wanted` points of a tile, and gathers at each. `gather` is the pass that was bound for
    /// earlier points, if there were any; it is bound again if buffers had to grow. Returns the pass for the next
    /// points.
    fn place(
        &mut self,
        with: &Filling<'_>,
        wanted: &[u32],
        gather: Option<BoundGather>,
        totals: &mut Totals,
    ) -> Result<BoundGather> {
        let count = wanted.len() as u32;
        let has_more_rays = self.ray_buffers.grow(with.gpu, count, self.rays)?;
        let has_more_room = self.grow(with, count)?;
        let bound = match gather.filter(|_| !has_more_rays && !has_more_room) {
            Some(bound) => bound,
            None => self.bind_gather(with, Wave { earlier: 0, rays: self.rays })?,
        };
        let first = self.heads.len() as u32;
        self.heads.extend(bound.place(with.gpu, wanted, first, with.gather_settings())?);
        totals.gather_rays += u64::from(count) * u64::from(bound.rays());
        Ok(bound)
    }

    /// Adds a wave of gather rays to each record: as many as it has, but at most `limit`.
    fn add_wave(&mut self, with: &Filling<'_>, limit: u32, totals: &mut Totals) -> Result<()> {
        let Filling { gpu, tile, .. } = *with;
        let wave = Wave { earlier: self.rays, rays: limit.min(self.rays) };
        let all = 0..self.heads.len() as u32;
        self.ray_buffers.grow(gpu, all.end, wave.rays)?;
        let bound = self.bind_gather(with, wave)?;
        totals.gather_rays += u64::from(all.end) * u64::from(wave.rays);
        let counted = (COUNTED_RAYS / wave.rays).max(1);
        let mut heads = Vec::with_capacity(self.heads.len());
        for first in all.step_by(counted as usize) {
            let mut frame = gpu.frame("gather");
            frame.clear(&tile.counters);
            frame.submit()?;
            let some = first..(first + counted).min(self.heads.len() as u32);
            heads.extend(bound.gather(gpu, some, with.gather_settings())?);
            let counters: Vec<u32> = gpu.read(&tile.counters, Counter::COUNT)?;
            totals.add_gathered(&counters);
        }
        self.heads = heads;
        self.rays += wave.rays;
        Ok(())
    }

    /// Binds the pass that gathers a wave at the records.
    fn bind_gather(&self, with: &Filling<'_>, wave: Wave) -> Result<BoundGather> {
        let Filling { gpu, kernels, path, tile, scene, .. } = *with;
        kernels.gather.bind(gpu, path, tile, wave, (&self.buffers, &self.ray_buffers), scene)
    }

    /// Number of records of minimum radius: their surroundings are so near that a smaller radius would be needed.
    fn count_of_min_radius(&self, accuracy: f32) -> u64 {
        let min = min_radius(self.rays);
        let is_smallest = |head: &&RecordHead| accuracy * head.distance <= min * head.size;
        self.heads.iter().filter(is_smallest).count() as u64
    }

    /// Limits radii to where gradients hold.
    fn limit_radii(&mut self, with: &Filling<'_>) -> Result<()> {
        let limits = self.with_noise(with, &self.with_radii(with), |noisy| noisy.limits())?;
        self.limits.resize(self.heads.len(), f32::INFINITY);
        self.limits.iter_mut().zip(limits).for_each(|(limit, now)| *limit = limit.min(now));
        Ok(())
    }

    /// Leaves out records that earlier ones now cover. With few rays, gradients looked steep, so records were small and
    /// close together.
    fn leave_out_covered(&mut self, with: &Filling<'_>) -> Result<()> {
        let kept = uncovered(&self.with_radii(with), with.camera, &with.settings.image);
        if kept.len() < self.heads.len() {
            self.buffers.keep(with.gpu, &kept, self.heads.len())?;
            self.heads = kept.iter().map(|i| self.heads[*i]).collect();
            self.limits = kept.iter().map(|i| self.limits[*i]).collect();
        }
        Ok(())
    }

    /// Makes room for `more` records. Returns whether the buffers had to grow.
    fn grow(&mut self, with: &Filling<'_>, more: u32) -> Result<bool> {
        let needed = self.heads.len() as u32 + more;
        if needed <= self.room {
            return Ok(false);
        }
        // Where the device binds no buffer of twice the size, what is needed may still fit.
        let doubled = (2 * self.room).max(needed);
        self.move_to(with, doubled).or_else(|_| self.move_to(with, needed))?;
        Ok(true)
    }

    /// Moves the records to new buffers with room for `room` of them.
    fn move_to(&mut self, with: &Filling<'_>, room: u32) -> Result<()> {
        let larger = RecordBuffers::new(with.gpu, with.features, room)?;
        let mut frame = with.gpu.frame("cache");
        for (from, to) in [(&self.buffers.origins, &larger.origins), (&self.buffers.values, &larger.values)] {
            frame.copy(from, to, 0, from.bytes);
        }
        frame.submit()?;
        (self.room, self.buffers) = (room, larger);
        Ok(())
    }

    /// The filtered irradiance and gradients, for the points of the view. Later waves add to the unfiltered ones.
    fn filtered_values(&self, with: &Filling<'_>, with_radii: &[RecordHead]) -> Result<Buffer> {
        let values = self.with_noise(with, with_radii, |noisy| noisy.filtered())?;
        let filtered = self.buffers.values_like(with.gpu)?;
        with.gpu.write(&filtered, &values);
        Ok(filtered)
    }

    /// Calls `find` with the records, their radii and their noise.
    fn with_noise<T>(
        &self,
        with: &Filling<'_>,
        with_radii: &[RecordHead],
        find: impl FnOnce(&NoisyRecords<'_>) -> T,
    ) -> Result<T> {
        let radii: Vec<f32> = with_radii.iter().map(|head| head.size).collect();
        let (variances, values) = self.buffers.read(with.gpu, self.heads.len())?;
        Ok(find(&NoisyRecords { heads: &self.heads, radii: &radii, variances: &variances, values: &values }))
    }

    /// The heads with radii in place of pixel sizes. Radii respect the distances of neighbouring records.
    fn with_radii(&self, with: &Filling<'_>) -> Vec<RecordHead> {
        let accuracy = with.settings.indirect.irradiance_cache.accuracy;
        let radius = |distance: f32, pixel: f32| radius(distance, pixel, accuracy, min_radius(self.rays));
        let mut heads = self.heads.clone();
        // A limit shortens the distance, not the radius, so that neighbours, whose distances follow, are limited too.
        for (head, limit) in heads.iter_mut().zip(&self.limits) {
            head.distance = head.distance.min(limit / accuracy);
        }
        let distances = neighbour_distances(&heads, radius);
        for (head, distance) in heads.iter_mut().zip(distances) {
            head.size = radius(distance, head.size);
        }
        heads
    }
}

/// Binds the pass to tables of records, whose heads have radii.
fn bind(with: &Filling<'_>, buffers: &CacheBuffers, heads: &[RecordHead], values: &Buffer) -> Result<BoundCache> {
    let Filling { gpu, camera, .. } = *with;
    let size = [with.settings.image.width, with.settings.image.height];
    let records = ViewRecords::new(gpu, heads, values, size, |head| seen_area(camera, head))?;
    with.kernels.cache.bind(gpu, with.tile, buffers, &records, with.scene)
}

/// The radius of a record, from its distance and the size of a pixel; `min` is the minimum in pixels.
fn radius(distance: f32, pixel: f32, accuracy: f32, min: f32) -> f32 {
    (accuracy * distance).clamp(min * pixel, MAX_RADIUS_PIXELS * pixel)
}

/// Distances of the records such that none exceeds a neighbour's distance plus the distance to that neighbour
/// (neighbour clamping, Krivanek et al. 2006): one record may have hit a surface that another missed between its rays.
fn neighbour_distances(heads: &[RecordHead], radius: impl Fn(f32, f32) -> f32 + Sync) -> Vec<f32> {
    let reach = |head: &RecordHead| radius(head.distance, head.size);
    let tree = RecordTree::new(heads);
    let nearest = |head: &RecordHead| {
        let (here, reach) = (Vec3::from(head.position), reach(head));
        let mut distance = head.distance;
        tree.each_near(here, reach, |i| {
            let other = &heads[i];
            let apart = here.distance(Vec3::from(other.position));
            // The record itself changes nothing.
            if apart < reach {
                distance = distance.min(other.distance + apart);
            }
        });
        distance
    };
    heads.par_iter().map(nearest).collect()
}

/// The indices of the records that earlier ones do not cover, by the same measure that decides whether a point needs a
/// record.
fn uncovered(heads: &[RecordHead], camera: &CameraUniform, image: &ImageSettings) -> Vec<usize> {
    let blocks = BlockGrid::new([image.width, image.height]);
    let mut by_block = vec![Vec::<usize>::new(); blocks.count()];
    let mut kept = Vec::new();
    for (id, head) in heads.iter().enumerate() {
        let centre = seen_area(camera, &RecordHead { size: head.size.min(f32::MIN_POSITIVE), ..*head });
        let around = centre.and_then(|centre| blocks.of(Some(centre)).next());
        let near = around.map_or(&[][..], |block| &by_block[block]);
        let weight: f32 = near.iter().map(|other| weight(&heads[*other], head)).sum();
        if head.size > 0.0 && weight < RECORD_MIN_WEIGHT {
            kept.push(id);
            blocks.of(seen_area(camera, head)).for_each(|block| by_block[block].push(id));
        }
    }
    kept
}

/// The area of the image where the camera may see points within the record's radius (`size`).
fn seen_area(camera: &CameraUniform, head: &RecordHead) -> Option<ImageArea> {
    let offset = Vec3::from(head.position) - Vec3::from(camera.position);
    let depth = -offset.dot(Vec3::from(camera.backward));
    let radius = head.size;
    // An invalid record; see shaders/gather.wgsl.
    if radius <= 0.0 {
        return None;
    }
    let [near, far] = match camera.orthographic {
        0 => [depth - radius, depth + radius],
        _ => [1.0, 1.0],
    };
    if far <= 0.0 {
        return None;
    }
    if near <= 0.0 {
        return Some([[0.0; 2], [1.0; 2]]);
    }
    let seen_range = |axis: [f32; 3], sign: f32| {
        let half = Vec3::from(axis).length();
        let at = sign * offset.dot(Vec3::from(axis)) / half;
        let low = (at - radius) / if at >= radius { far } else { near };
        let high = (at + radius) / if at >= -radius { near } else { far };
        [0.5 + 0.5 * low / half, 0.5 + 0.5 * high / half]
    };
    let [x, y] = [seen_range(camera.right, 1.0), seen_range(camera.up, -1.0)];
    let seen = |[low, high]: [f32; 2]| high >= 0.0 && low <= 1.0;
    (seen(x) && seen(y)).then_some([[x[0], y[0]], [x[1], y[1]]])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Random;

    /// Records on a tilted plane and scattered in space, near and far, some of them invalid, some at one place.
    fn heads(count: u32) -> Vec<RecordHead> {
        let mut random = Random(1);
        let mut xi = || random.uniform() as f32;
        let head = |i: u32| {
            let [x, y, z] = [xi(), xi(), xi()].map(|x| 2.0 * x - 1.0);
            let far = if i.is_multiple_of(50) { 1e4 } else { 1.0 };
            let position = match i % 3 {
                0 => [x, y, 0.3 * x],
                1 => [far * x, far * y, far * z],
                _ => [0.5, 0.5, 0.5 + 1e-3 * z],
            };
            let size = if i.is_multiple_of(17) { 0.0 } else { 1e-3 * far };
            RecordHead { position, size, normal: [0.0, 0.0, 1.0], distance: xi() * far }
        };
        (0..count).map(head).collect()
    }

    /// No record's distance exceeds the distance of another record within its radius plus the length of the way there,
    /// compared with all pairs.
    #[test]
    fn distances_are_those_of_all_pairs() {
        for (count, accuracy) in [(0, 0.25), (1, 0.25), (2000, 0.25), (2000, 10.0)] {
            let heads = heads(count);
            let radius = |distance: f32, pixel: f32| radius(distance, pixel, accuracy, 3.0);
            let expected: Vec<f32> = heads
                .iter()
                .map(|head| {
                    let (here, reach) = (Vec3::from(head.position), radius(head.distance, head.size));
                    let of = |other: &RecordHead| (here.distance(Vec3::from(other.position)), other.distance);
                    let near = heads.iter().map(of).filter(|(apart, _)| *apart < reach);
                    near.fold(head.distance, |least, (apart, distance)| least.min(distance + apart))
                })
                .collect();
            assert_eq!(neighbour_distances(&heads, radius), expected, "{count} records");
            assert!(count < 2 || heads.iter().zip(&expected).any(|(head, distance)| head.distance > *distance));
        }
    }
}
