//! The visibility map: photons of every light, sorted into a grid, and mended by audits.

use crate::Result;
use crate::gpu::{Buffer, Features, Gpu};
use crate::gpu_scene::GpuScene;
use crate::passes::grid::{Grid, GridShape, Photon, PhotonGrid};
use crate::passes::photons::{Photons, Traced};
use crate::scene::{Light, Scene};
use crate::settings::Settings;
use crate::statistics::{Counter, LightPhotons};

use crate::statistics::totals::Totals;

/// Photons that audits can leave between two sortings of the map. Audits that contradict the map are a few in a
/// thousand of one in 64 points. Where there are more, which of them have a place depends on chance, so none is taken;
/// they are counted as wrong all the same, and found again.
const HEAL_BATCH: u32 = 1 << 16;

/// Photons that audits can add to a map in all.
const HEAL_ROOM: u32 = 1 << 18;

/// Rays of all lights together: what a map of the smallest storage binding that devices offer (128 MiB, eight million
/// photons) holds where rays meet two surfaces on average.
const MAX_RAYS: u32 = 1 << 22;

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
    /// None between [`VisibilityMap::take_healed`] and [`VisibilityMap::sort`].
    grid: Option<PhotonGrid>,
    kernel: Grid,
    shape: GridShape,
    lights: u32,
    photons: Buffer,
    count: u32,
    room: u32,
    heal_photons: Buffer,
    heal_count: Buffer,
}

/// What samples have left in the map.
#[derive(Default)]
pub(crate) struct MapState {
    /// Photons that were added to the map.
    pub added: Vec<Photon>,
    /// Photons that came since.
    pub left: u32,
    /// Those of them that there was room for.
    pub kept: Vec<Photon>,
    /// See [`PhotonGrid::asked_state`], nothing where no point has asked yet; or what stands in for the map has left.
    pub rest: Vec<u32>,
}

impl MapState {
    /// Everything but `left`, in order.
    pub fn words(&self) -> Vec<u32> {
        [bytemuck::cast_slice(&self.added), bytemuck::cast_slice(&self.kept), &self.rest].concat()
    }

    /// From [`MapState::words`]; none where there are too few, or more photons than audits leave.
    pub fn from_words(words: &[u32], added: usize, left: u32) -> Option<MapState> {
        if added > HEAL_ROOM as usize {
            return None;
        }
        let size = size_of::<Photon>() / 4;
        let (first, rest) = words.split_at_checked(added * size)?;
        let (then, rest) = rest.split_at_checked(left.min(HEAL_BATCH) as usize * size)?;
        let photons = |words: &[u32]| bytemuck::pod_collect_to_vec(words);
        Some(MapState { added: photons(first), left, kept: photons(then), rest: rest.to_vec() })
    }
}

impl VisibilityMap {
    /// Traces the photons of every light and sorts them.
    pub fn new(
        gpu: &Gpu,
        kernels: MapKernels,
        scene: &Scene,
        gpu_scene: &GpuScene,
        settings: &Settings,
        totals: &mut Totals,
    ) -> Result<VisibilityMap> {
        let lights = scene.placed_lights().len() as u32;
        let rays = settings.visibility_map.photons_per_light.min(MAX_RAYS / lights);
        let traced = kernels.photons.trace(gpu, gpu_scene, lights, rays, settings.image.seed, HEAL_ROOM)?;
        totals.photon_rays += traced.emitted.iter().map(|n| u64::from(*n)).sum::<u64>();
        totals.count(Counter::Overrun, traced.overruns);
        totals.photons = by_light(scene, &traced);
        let (bounds, area) = extent(scene);
        let shape = GridShape::new(bounds, area, traced.count / lights, lights, settings.visibility_map.nearest);
        let grid = kernels.grid.build(gpu, &traced.photons, traced.count, lights, shape)?;
        totals.photon_bytes += traced.photons.bytes + grid.bytes;
        Ok(VisibilityMap {
            grid: Some(grid),
            kernel: kernels.grid,
            shape,
            lights,
            photons: traced.photons,
            count: traced.count,
            room: HEAL_ROOM,
            heal_photons: gpu.buffer::<Photon>("penumbra/shadow/heal_photons", HEAL_BATCH as usize)?,
            heal_count: gpu.buffer::<u32>("penumbra/shadow/heal_count", 1)?,
        })
    }

    /// Adds the photons that audits left to the map, if that is `due` or there is little room for more; whether the map
    /// is to be sorted anew. Its tables are then gone.
    pub fn take_healed(&mut self, gpu: &Gpu, due: bool, totals: &mut Totals) -> Result<bool> {
        let left = gpu.read::<u32>(&self.heal_count, 1)?[0];
        if left == 0 || !(due || left > HEAL_BATCH / 2) {
            return Ok(self.grid.is_none());
        }
        let added = if left > HEAL_BATCH.min(self.room) { 0 } else { left };
        let mut frame = gpu.frame("heal");
        if added > 0 {
            let words: Vec<Photon> = gpu.read(&self.heal_photons, added as usize)?;
            for photon in words {
                totals.photons[photon.light() as usize].healed += 1;
            }
            let size = size_of::<Photon>() as u64;
            frame.copy(&self.heal_photons, &self.photons, u64::from(self.count) * size, u64::from(added) * size);
            self.grid = None;
        }
        frame.clear(&self.heal_count);
        frame.submit()?;
        self.count += added;
        self.room -= added;
        Ok(self.grid.is_none())
    }

    /// Sorts the map after [`VisibilityMap::take_healed`] has asked for it. Who still has the old tables bound should let
    /// go of them before: they are among the largest things of a render.
    pub fn sort(&mut self, gpu: &Gpu) -> Result<()> {
        self.grid = Some(self.kernel.build(gpu, &self.photons, self.count, self.lights, self.shape)?);
        Ok(())
    }

    /// What samples have left so far.
    pub fn state(&self, gpu: &Gpu) -> Result<MapState> {
        let added = (HEAL_ROOM - self.room) as usize;
        let left = gpu.read::<u32>(&self.heal_count, 1)?[0];
        Ok(MapState {
            added: gpu.read_from(&self.photons, self.count as usize - added, added)?,
            left,
            kept: gpu.read(&self.heal_photons, left.min(HEAL_BATCH) as usize)?,
            rest: self.grid.as_ref().map_or(Ok(Vec::new()), |grid| grid.asked_state(gpu))?,
        })
    }

    /// Puts back what samples had left, in a map that has nothing of it; false where it is not of this map. It is sorted anew, so
    /// nobody should have its tables bound: see [`VisibilityMap::sort`].
    pub fn restore(&mut self, gpu: &Gpu, state: &MapState, totals: &mut Totals) -> Result<bool> {
        let of_this_map = |photon: &Photon| {
            photon.light() < self.lights && photon.position.iter().all(|coordinate| coordinate.is_finite())
        };
        if !state.added.iter().chain(&state.kept).all(of_this_map) {
            return Ok(false);
        }
        for batch in state.added.chunks(HEAL_BATCH as usize) {
            gpu.write(&self.heal_photons, batch);
            gpu.write(&self.heal_count, &[batch.len() as u32]);
            self.take_healed(gpu, true, totals)?;
        }
        if self.grid.is_none() {
            self.sort(gpu)?;
        }
        gpu.write(&self.heal_photons, &state.kept);
        gpu.write(&self.heal_count, &[state.left]);
        Ok(state.rest.is_empty() || self.grid.as_ref().is_some_and(|grid| grid.restore_asked(gpu, &state.rest)))
    }

    pub fn grid(&self) -> Option<&PhotonGrid> {
        self.grid.as_ref()
    }

    pub fn heal_capacity(&self) -> u32 {
        HEAL_BATCH
    }

    pub fn heal_buffers(&self) -> [&Buffer; 2] {
        [&self.heal_photons, &self.heal_count]
    }
}

/// What was traced of each light.
pub(crate) fn by_light(scene: &Scene, traced: &Traced) -> Vec<LightPhotons> {
    let counts = traced.emitted.iter().zip(&traced.stored);
    let of_light = |(light, (emitted, [illumination, shadow])): (&Light, (&u32, &[u32; 2]))| LightPhotons {
        light: light.name.clone(),
        emitted: u64::from(*emitted),
        illumination: u64::from(*illumination),
        shadow: u64::from(*shadow),
        healed: 0,
    };
    scene.placed_lights().iter().zip(counts).map(of_light).collect()
}

/// Bounds and area of the scene's surfaces, of procedural objects those of their boxes.
pub(crate) fn extent(scene: &Scene) -> ((glam::Vec3, glam::Vec3), f32) {
    let mut bounds = (glam::Vec3::INFINITY, glam::Vec3::NEG_INFINITY);
    let mut area = 0.0f64;
    for i in 0..scene.triangles.len() {
        let [a, b, c] = scene.triangle_positions(i);
        bounds = (bounds.0.min(a).min(b).min(c), bounds.1.max(a).max(b).max(c));
        area += f64::from((b - a).cross(c - a).length()) * 0.5;
    }
    for object in &scene.procedurals {
        bounds = object.corners().iter().fold(bounds, |(low, high), p| (low.min(*p), high.max(*p)));
        area += f64::from(object.box_area());
    }
    (bounds, area as f32)
}
