//! Pass `irradiance`: density estimates on the global map, precomputed at places all over the scene (Christensen 1999), so
//! that a ray of the final gather costs one look-up.

use crate::Result;
use crate::gpu::buffer::{TableFormat, whole_rows};
use crate::gpu::{Bindings, BoundKernel, Buffer, Features, Frame, Gpu, Kernel, Resources, Table};
use crate::statistics::Counter;
use crate::{bindings, shared_struct};

use super::grid::{GridShape, SortedPhotons};
use super::{Tile, TileBuffers, kernel};

shared_struct! {
    /// Immediates of the pass; see `shaders/irradiance.wgsl`.
    pub struct IrradianceParameters {
        grid: GridShape,
        count: u32,
        step: f32,
        shrink: f32,
        padding: u32,
    }
}

bindings! {
    /// What the kernel reads and writes beside the scene and the global map.
    struct IrradianceBindings { places, irradiances, counters }
}

/// Photons of an estimate (k). At 64 the noise of one is an eighth; a gather takes the mean of some hundred of them.
pub const IRRADIANCE_NEAREST: u32 = 64;

/// Photons that a cell of the global map holds on an evenly covered surface: the disc of an estimate, of radius
/// sqrt(k / (pi density)), must not be wider than a cell: k / pi, and a tenth more.
pub const MAP_PHOTONS_PER_CELL: f32 = 0.35 * IRRADIANCE_NEAREST as f32;

/// Rays of the global map for one whose photons are the places: four places lie in a disc, and more would say nearly the
/// same. Photons of the map itself would not do: they keep their distance from each other, so that about a photon there are
/// fewer than elsewhere (1 % in the box of the paper).
pub const RAYS_PER_PLACE_RAY: u32 = 16;

/// Places in a cell of their grid, on an evenly covered surface. Look-ups ask 2 x 2 cells of it.
const PLACES_PER_CELL: f32 = 3.0;

/// The pass; see `shaders/irradiance.wgsl`.
pub struct Irradiance {
    kernel: Kernel,
}

/// Irradiance at places all over the scene; see `shaders/lib/irradiance.wgsl`.
pub struct IrradianceMap {
    /// The places, sorted by cell.
    pub places: SortedPhotons,
    irradiances: Table,
    shape: Buffer,
    /// Bytes on the device.
    pub bytes: u64,
    /// Places whose irradiance is not finite: no path ends there.
    pub not_finite: u64,
}

impl Bindings for IrradianceMap {
    fn get(&self, name: &str) -> Option<crate::gpu::Binding<'_>> {
        match name {
            "irradiance_table" => Some((&self.irradiances).into()),
            "irradiance_grid" => Some((&self.shape).into()),
            _ => self.places.get(name),
        }
    }
}

impl Irradiance {
    /// Compiles the kernel.
    ///
    /// # Errors
    /// As [`Kernel::new`].
    pub fn new(gpu: &Gpu, features: &Features, constants: &[(&str, f64)]) -> Result<Irradiance> {
        let mut constants = constants.to_vec();
        constants.push(("nearest", f64::from(IRRADIANCE_NEAREST)));
        Ok(Irradiance { kernel: kernel(gpu, "irradiance", features, &constants, IrradianceBindings::NAMES)? })
    }

    /// Estimates the irradiance at the positions of `places` by the photons of `map`, whose words count flux in steps of `step`.
    ///
    /// # Errors
    /// As [`Gpu::buffer`] and [`Kernel::bind`].
    pub fn precompute(
        &self,
        gpu: &Gpu,
        scene: &dyn Bindings,
        map: &SortedPhotons,
        places: SortedPhotons,
        step: f64,
    ) -> Result<IrradianceMap> {
        let irradiances =
            gpu.buffer::<[f32; 4]>("penumbra/irradiance/irradiances", whole_rows(places.count as usize))?;
        let counters = gpu.buffer::<u32>("penumbra/irradiance/counters", Counter::COUNT)?;
        let own = IrradianceBindings { places: &places.sorted, irradiances: &irradiances, counters: &counters };
        let bound = self.kernel.bind(gpu, "irradiance", &[&own, map, scene])?;
        let parameters =
            IrradianceParameters { grid: map.shape, count: places.count, step: step as f32, shrink: 1.0, padding: 0 };
        let mut frame = gpu.frame("irradiance");
        frame.run(&bound, places.count, &parameters);
        let bytes = places.bytes + irradiances.bytes;
        let irradiances = gpu.kernel_table(&mut frame, irradiances, TableFormat::Float)?;
        frame.submit()?;
        let not_finite = gpu.read::<u32>(&counters, Counter::COUNT)?[Counter::NotFiniteIrradiance as usize];
        Ok(IrradianceMap {
            not_finite: u64::from(not_finite),
            shape: gpu.upload("penumbra/irradiance/grid", &[places.shape])?,
            places,
            irradiances,
            bytes,
        })
    }
}

/// Entry point `show` or `caustics`, bound to a tile.
pub struct BoundShow {
    kernel: BoundKernel,
    shape: GridShape,
    step: f32,
    shrink: f32,
}

impl Irradiance {
    /// Binds `show` to a tile's buffers and a global map; as [`Irradiance::precompute`].
    ///
    /// # Errors
    /// As [`Kernel::bind`].
    pub fn bind_show(
        &self,
        gpu: &Gpu,
        tile: &TileBuffers,
        scene: &dyn Bindings,
        map: &SortedPhotons,
        step: f64,
    ) -> Result<BoundShow> {
        self.bind_entry(gpu, "show", tile, scene, map, [step, 1.0])
    }

    /// Binds `caustics` likewise; the radius of a disc is `shrink` times that of one that holds [`IRRADIANCE_NEAREST`] photons.
    ///
    /// # Errors
    /// As [`Kernel::bind`].
    pub fn bind_caustics(
        &self,
        gpu: &Gpu,
        tile: &TileBuffers,
        scene: &dyn Bindings,
        map: &SortedPhotons,
        step: f64,
        shrink: f64,
    ) -> Result<BoundShow> {
        self.bind_entry(gpu, "caustics", tile, scene, map, [step, shrink])
    }

    fn bind_entry(
        &self,
        gpu: &Gpu,
        entry: &str,
        tile: &TileBuffers,
        scene: &dyn Bindings,
        map: &SortedPhotons,
        [step, shrink]: [f64; 2],
    ) -> Result<BoundShow> {
        let mut own = Resources::new()
            .with("points", &tile.points)
            .with("surfaces", &tile.surfaces)
            .with("counters", &tile.counters);
        if let Some(indirect) = &tile.radiance_indirect {
            own = own.with("radiance_indirect", indirect);
        }
        let kernel = self.kernel.bind(gpu, entry, &[&own, map, scene])?;
        Ok(BoundShow { kernel, shape: map.shape, step: step as f32, shrink: shrink as f32 })
    }
}

impl BoundShow {
    /// The light that the map tells at the tile's points.
    pub fn record(&self, frame: &mut Frame<'_>, tile: &Tile) {
        let count = tile.point_count;
        let Self { shape: grid, step, shrink, .. } = *self;
        let parameters = IrradianceParameters { grid, count, step, shrink, padding: 0 };
        frame.run(&self.kernel, count, &parameters);
    }
}

/// The grid of `count` places on surfaces of those bounds and that area.
pub fn place_grid((bounds, area): ((glam::Vec3, glam::Vec3), f32), count: u32) -> GridShape {
    GridShape::with_photons_per_cell(PLACES_PER_CELL, bounds, area, count, 1)
}
