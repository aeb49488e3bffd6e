//! Pass `irradiance`: density estimates on the global map, precomputed at some of its photons (Christensen 1999), so that
//! a ray of the final gather costs one look-up.

use crate::Result;
use crate::gpu::buffer::{TABLE_WIDTH, TableFormat};
use crate::gpu::{Bindings, Buffer, Features, Gpu, Kernel, Resources, Table};
use crate::{bindings, shared_struct};

use super::grid::{Grid, GridShape, Photon, SortedPhotons};
use super::kernel;

shared_struct! {
    /// Immediates of the pass; see `shaders/irradiance.wgsl`.
    pub struct IrradianceParameters {
        grid: GridShape,
        count: u32,
        share: u32,
        step: f32,
        padding: u32,
    }
}

bindings! {
    /// What the kernel reads and writes beside the scene and the global map.
    struct IrradianceBindings { flux_photons, places, place_count, sorted_places, irradiances }
}

/// Photons of an estimate (k). At 64 the noise of one is an eighth; a gather takes the mean of some hundred of them.
pub const IRRADIANCE_NEAREST: u32 = 64;

/// Photons that a cell of the global map holds on an evenly covered surface: the disc of an estimate, of radius
/// sqrt(k / (pi density)), must not be wider than a cell: k / pi, and a tenth more.
pub const MAP_PHOTONS_PER_CELL: f32 = 0.35 * IRRADIANCE_NEAREST as f32;

/// Photons for one place where irradiance is precomputed: four places in a disc. More of them would say nearly the same.
const PHOTONS_PER_PLACE: f64 = 16.0;

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

    /// Chooses places among the photons of `map`, whose words count flux in steps of `step`, and estimates the irradiance at
    /// each. `extent` is bounds and area of the scene's surfaces.
    ///
    /// # Errors
    /// As [`Grid::sort`] and [`Kernel::bind`].
    pub fn precompute(
        &self,
        gpu: &Gpu,
        scene: &dyn Bindings,
        grid: &Grid,
        map: &SortedPhotons,
        extent: ((glam::Vec3, glam::Vec3), f32),
        step: f64,
    ) -> Result<IrradianceMap> {
        // Half as many again as are expected, and some: the number of chosen ones varies by its root.
        let room = (1.5 * f64::from(map.count) / PHOTONS_PER_PLACE) as usize + 64;
        let places = gpu.buffer::<Photon>("penumbra/irradiance/places", room)?;
        let place_count = gpu.buffer::<u32>("penumbra/irradiance/place_count", 1)?;
        let parameters = |count| IrradianceParameters {
            grid: map.shape,
            count,
            share: (f64::from(u32::MAX) / PHOTONS_PER_PLACE) as u32,
            step: step as f32,
            padding: 0,
        };
        let choose = Resources::new()
            .with("flux_photons", &map.sorted)
            .with("places", &places)
            .with("place_count", &place_count);
        let choose = self.kernel.bind(gpu, "choose", &[&choose])?;
        let mut frame = gpu.frame("irradiance");
        frame.run(&choose, map.count, &parameters(map.count));
        frame.submit()?;
        let count = gpu.read::<u32>(&place_count, 1)?[0].min(room as u32);
        let shape = GridShape::with_cells_of(PLACES_PER_CELL, extent.0, extent.1, count, 1);
        let sorted = grid.sort(gpu, &places, count, 1, shape)?;

        let records = (count as usize).next_multiple_of(TABLE_WIDTH as usize).max(TABLE_WIDTH as usize);
        let irradiances = gpu.buffer::<[f32; 4]>("penumbra/irradiance/irradiances", records)?;
        let own = Resources::new().with("sorted_places", &sorted.sorted).with("irradiances", &irradiances);
        let estimate = self.kernel.bind(gpu, "estimate", &[&own, map, scene])?;
        let mut frame = gpu.frame("irradiance");
        frame.run(&estimate, count, &parameters(count));
        let irradiances = gpu.kernel_table(&mut frame, irradiances, TableFormat::Float)?;
        frame.submit()?;
        Ok(IrradianceMap {
            shape: gpu.upload("penumbra/irradiance/grid", &[shape])?,
            bytes: sorted.bytes + records as u64 * 16,
            places: sorted,
            irradiances,
        })
    }
}
