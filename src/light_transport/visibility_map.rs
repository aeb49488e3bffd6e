//! The visibility map: illumination and shadow photons of every light, sorted into a grid, and repaired by audits. The
//! paper keeps them in one map with the photons that carry flux. Here they have a map of their own, because they need
//! no flux, and are looked up by light ([`super::global_map`] has the others).

use kernel_kit::{Buffer, Gpu};

use super::shared::{Shared, count_visibility_photons, extent};
use crate::Result;
use crate::kernels::GridShape;
use crate::passes::grid::{Grid, Photon, PhotonGrid};
use crate::passes::photons::Photons;
use crate::passes::shadow::Repairs;
use crate::settings::Settings;
use crate::specialisation::features::Features;
use crate::statistics::totals::Totals;

/// Maximum number of photons that audits add between two sortings of the map. One in 64 points is audited, and a few in
/// a thousand audits contradict the map. If there are more, it would be random which of them fit, so none is added.
/// They still count as wrong, and later audits find them again.
const REPAIRS_PER_SORT: u32 = 1 << 16;

/// Maximum number of photons that audits add to a map in total. The map keeps 4 MiB of room for them. Beyond it, audits
/// still correct the image, but add no photons.
const MAX_REPAIRS: u32 = 1 << 18;

pub(crate) struct MapKernels {
    photons: Photons,
    grid: Grid,
}

impl MapKernels {
    pub fn new(gpu: &Gpu, features: &Features, constants: &[(&str, f64)], settings: &Settings) -> Result<MapKernels> {
        let (photons, grid) = rayon::join(
            || Photons::new(gpu, features, constants, settings.visibility_map.shadow_photons_per_ray),
            || Grid::new(gpu, features, settings.visibility_map.nearest),
        );
        Ok(MapKernels { photons: photons?, grid: grid? })
    }
}

pub(crate) struct VisibilityMap {
    /// `None` between [`VisibilityMap::take_repairs`] and [`VisibilityMap::sort`].
    grid: Option<PhotonGrid>,
    /// Kept to sort the map again.
    kernel: Grid,
    shape: GridShape,
    lights: u32,
    photons: Buffer,
    count: u32,
    /// Number of photons that audits can still add.
    room: u32,
    /// Photons of audits since the map was sorted, and their number.
    repairs: Repairs,
}

/// The state that samples left in the map, or in adaptive shadow testing.
#[derive(Default)]
pub(crate) struct MapState {
    /// Photons that audits added to the map.
    pub added: Vec<Photon>,
    /// Number of photons that audits found since the map was sorted.
    pub left: u32,
    /// The ones among them that fit in the buffer.
    pub kept: Vec<Photon>,
    /// [`PhotonGrid::requested_cells_state`], empty if no cell was requested yet; or the visible share of each light
    /// ([`super::adaptive_testing`]).
    pub rest: Vec<u32>,
    /// [`super::fine_cells::FineCellMap::state`], empty if there are no fine cells.
    pub fine_cells: Vec<u32>,
}

impl MapState {
    /// Everything but `left`, in order.
    pub fn words(&self) -> Vec<u32> {
        let fine_cells = [self.fine_cells.len() as u32];
        let photons = [bytemuck::cast_slice(&self.added), bytemuck::cast_slice(&self.kept)];
        [photons[0], photons[1], &fine_cells, &self.fine_cells, &self.rest].concat()
    }

    /// Restores the state from [`MapState::words`]. Returns `None` if there are too few words, or more photons than
    /// audits can leave.
    pub fn from_words(words: &[u32], added: usize, left: u32) -> Option<MapState> {
        if added > MAX_REPAIRS as usize {
            return None;
        }
        let size = size_of::<Photon>() / 4;
        let (first, rest) = words.split_at_checked(added * size)?;
        let (then, rest) = rest.split_at_checked(left.min(REPAIRS_PER_SORT) as usize * size)?;
        let (fine_cells, rest) = rest.split_first()?;
        let (fine_cells, rest) = rest.split_at_checked(*fine_cells as usize)?;
        let photons = |words: &[u32]| bytemuck::pod_collect_to_vec(words);
        Some(MapState {
            added: photons(first),
            left,
            kept: photons(then),
            rest: rest.to_vec(),
            fine_cells: fine_cells.to_vec(),
        })
    }
}

impl VisibilityMap {
    /// Traces the photons of every light and sorts them.
    pub fn new(
        shared: &Shared<'_>,
        kernels: MapKernels,
        settings: &Settings,
        totals: &mut Totals,
    ) -> Result<VisibilityMap> {
        let Shared { gpu, scene, gpu_scene, .. } = *shared;
        let lights = scene.placed_lights().len() as u32;
        let rays = settings.photons_of_light(lights as usize);
        let traced = kernels.photons.trace(gpu, gpu_scene, lights, rays, settings.image.seed, MAX_REPAIRS)?;
        count_visibility_photons(scene, &traced, totals);
        let (bounds, area) = extent(scene);
        let shape = GridShape::new(bounds, area, traced.count / lights, lights, settings.visibility_map.nearest);
        let grid = kernels.grid.build(gpu, &traced.photons, traced.count, lights, shape)?;
        let map = VisibilityMap {
            grid: Some(grid),
            kernel: kernels.grid,
            shape,
            lights,
            photons: traced.photons,
            count: traced.count,
            room: MAX_REPAIRS,
            repairs: Repairs::new(gpu, REPAIRS_PER_SORT)?,
        };
        totals.photon_bytes += map.bytes();
        Ok(map)
    }

    /// Bytes on the device.
    pub fn bytes(&self) -> u64 {
        self.photons.bytes + self.grid.as_ref().map_or(0, |grid| grid.bytes)
    }

    /// The map as it was before the first sample: without photons of audits, and with no cell requested.
    pub fn renewed(mut self, gpu: &Gpu) -> Result<VisibilityMap> {
        if let Some(grid) = self.grid.as_ref().filter(|_| self.room == MAX_REPAIRS) {
            let mut frame = gpu.frame("renew");
            grid.forget_requested_cells(&mut frame);
            frame.clear(&self.repairs.count);
            frame.submit()?;
            return Ok(self);
        }
        self.count -= MAX_REPAIRS - self.room;
        self.room = MAX_REPAIRS;
        self.repairs = Repairs::new(gpu, REPAIRS_PER_SORT)?;
        // The old tables are dropped first, so that the device need not hold both.
        self.grid = None;
        self.sort(gpu)?;
        Ok(self)
    }

    /// Adds the photons of audits to the map, if that is `due` or their buffer is nearly full. Returns whether the map
    /// must be sorted again; its tables are then dropped.
    pub fn take_repairs(&mut self, gpu: &Gpu, due: bool, totals: &mut Totals) -> Result<bool> {
        let left = gpu.read::<u32>(&self.repairs.count, 1)?[0];
        if left == 0 || !(due || left > REPAIRS_PER_SORT / 2) {
            return Ok(self.grid.is_none());
        }
        let added = if left > REPAIRS_PER_SORT.min(self.room) { 0 } else { left };
        let mut frame = gpu.frame("repair");
        if added > 0 {
            let photons: Vec<Photon> = gpu.read(&self.repairs.photons, added as usize)?;
            for photon in photons {
                totals.photons[photon.light() as usize].repaired += 1;
            }
            let size = size_of::<Photon>() as u64;
            frame.copy(&self.repairs.photons, &self.photons, u64::from(self.count) * size, u64::from(added) * size);
            self.grid = None;
        }
        frame.clear(&self.repairs.count);
        frame.submit()?;
        self.count += added;
        self.room -= added;
        Ok(self.grid.is_none())
    }

    /// Sorts the map, if [`VisibilityMap::take_repairs`] returned true. Passes must first release the old tables, which
    /// are among the largest buffers of a render.
    pub fn sort(&mut self, gpu: &Gpu) -> Result<()> {
        self.grid = Some(self.kernel.build(gpu, &self.photons, self.count, self.lights, self.shape)?);
        Ok(())
    }

    /// The state that samples left so far.
    pub fn state(&self, gpu: &Gpu) -> Result<MapState> {
        let added = (MAX_REPAIRS - self.room) as usize;
        let left = gpu.read::<u32>(&self.repairs.count, 1)?[0];
        Ok(MapState {
            added: gpu.read_from(&self.photons, self.count as usize - added, added)?,
            left,
            kept: gpu.read(&self.repairs.photons, left.min(REPAIRS_PER_SORT) as usize)?,
            rest: self.grid.as_ref().map_or(Ok(Vec::new()), |grid| grid.requested_cells_state(gpu))?,
            ..MapState::default()
        })
    }

    /// Restores that state in a map without samples; false if it belongs to another map. The map is sorted again, so no
    /// pass may have its tables bound: see [`VisibilityMap::sort`].
    pub fn restore(&mut self, gpu: &Gpu, state: &MapState, totals: &mut Totals) -> Result<bool> {
        let of_this_map = |photon: &Photon| {
            photon.light() < self.lights && photon.position.iter().all(|coordinate| coordinate.is_finite())
        };
        if !state.added.iter().chain(&state.kept).all(of_this_map) {
            return Ok(false);
        }
        for photons in state.added.chunks(REPAIRS_PER_SORT as usize) {
            gpu.write(&self.repairs.photons, photons);
            gpu.write(&self.repairs.count, &[photons.len() as u32]);
            self.take_repairs(gpu, true, totals)?;
        }
        if self.grid.is_none() {
            self.sort(gpu)?;
        }
        gpu.write(&self.repairs.photons, &state.kept);
        gpu.write(&self.repairs.count, &[state.left]);
        Ok(state.rest.is_empty()
            || self.grid.as_ref().is_some_and(|grid| grid.restore_requested_cells(gpu, &state.rest)))
    }

    /// All photons, in any order.
    pub fn photons(&self, gpu: &Gpu) -> Result<Vec<Photon>> {
        Ok(gpu.read(&self.photons, self.count as usize)?)
    }

    /// The largest search radius, in normalised space.
    pub fn reach(&self) -> f32 {
        self.shape.reach()
    }

    /// The sorted photons; `None` while the map must be sorted again.
    pub fn grid(&self) -> Option<&PhotonGrid> {
        self.grid.as_ref()
    }

    /// Maximum number of photons that audits add between two sortings.
    pub fn repair_capacity(&self) -> u32 {
        REPAIRS_PER_SORT
    }

    /// The photons of audits.
    pub fn repairs(&self) -> &Repairs {
        &self.repairs
    }
}
