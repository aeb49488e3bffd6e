//! Pass `irradiance`: density estimation on the global map and the caustic map. It precomputes the irradiance at
//! irradiance points all over the scene (Christensen 1999), so that a ray of the final gather costs one look-up. It
//! visualises the global map at the points of a tile, and adds the light of the caustic map there.

use kernel_kit::{
    Binding, Bindings, BoundKernel, Buffer, Frame, Gpu, Kernel, Table, TableFormat, bindings, shared_struct, whole_rows,
};

use super::grid::SortedPhotons;
use super::{Tile, TileBuffers, kernel};
use crate::Result;
use crate::kernels::{GridShape, UNSHADOWED_LIGHTS};
use crate::specialisation::features::{Feature, Features};
use crate::statistics::Counter;

shared_struct! {
    /// Immediates of the pass; see `shaders/irradiance.wgsl`.
    pub struct IrradianceParameters {
        grid: GridShape,
        count: u32,
        step: f32,
        shrink: f32,
        first_light: u32,
        centre: [f32; 3],
        inner: f32,
        outer: f32,
        /// To a multiple of 16 bytes.
        padding: u32,
        more_padding: [u32; 2],
    }
}

bindings! {
    /// Everything that the entry point `irradiance` reads and writes except the scene and the global map.
    struct IrradianceBindings {
        pub irradiance_points: &Buffer,
        pub irradiances: &Buffer,
        pub counters: &Buffer,
    }
}

bindings! {
    /// Everything that the entry points `show` and `caustics` read and write except the scene and the map.
    struct ShowBindings {
        pub radiance_indirect: &Buffer,
        pub counters: &Buffer,
    }
}

/// Photons of an estimate (k). With 64 its relative noise is an eighth, and a gather averages some hundred estimates.
pub const IRRADIANCE_NEAREST: u32 = 64;

/// Photons in a cell of the global map, on an evenly covered surface. There the radius of an estimate's disc, sqrt(k /
/// (pi density)), must not exceed the side of a cell: this takes k / pi photons in a cell, and a tenth more for safety.
/// Where photons are sparse, discs are larger (MAX_REACH_WHERE_SPARSE in `shaders/irradiance.wgsl`).
pub const MAP_PHOTONS_PER_CELL: f32 = 0.35 * IRRADIANCE_NEAREST as f32;

/// Rays of the global map for each ray whose photons become irradiance points. A disc then holds eight irradiance
/// points. Their values are nearly equal, but the clear parts of the discs (without edges, walls or gaps) must cover
/// the surface: rays that hit none continue as paths. Four discs would leave out a thirteenth of an open surface, eight
/// leave out a hundredth. Irradiance points come from rays of their own. The rays of the map are stratified, so the
/// density around its photons is too low (by 1 % in the paper's box).
pub const RAYS_PER_IRRADIANCE_POINT_RAY: u32 = 8;

/// Irradiance points in a cell of their grid, on an evenly covered surface. A look-up reads 2 x 2 cells of the surface.
const POINTS_PER_CELL: f32 = 3.0;

/// The pass; see `shaders/irradiance.wgsl`.
pub struct Irradiance {
    kernel: Kernel,
    /// Texels of an irradiance point; IRRADIANCE_TEXELS in `shaders/lib/irradiance.wgsl`.
    texels: usize,
}

/// Precomputed irradiance over the whole scene; see `shaders/lib/irradiance.wgsl`.
pub struct IrradianceMap {
    /// The irradiance points, sorted by cell.
    pub points: SortedPhotons,
    irradiances: Table,
    shape: Buffer,
    /// Bytes on the device.
    pub bytes: u64,
    /// Irradiance points whose irradiance is not finite. No path ends at them.
    pub not_finite: u64,
}

bindings! {
    /// What paths and gathers read of the irradiance, besides the sorted irradiance points.
    pub struct IrradianceMapBindings {
        /// Irradiance at the points, and the radius of the disc over which it is the mean.
        pub irradiance_table: &Table,
        /// The [`GridShape`] of the points.
        pub irradiance_grid: &Buffer,
    }
}

impl Bindings for IrradianceMap {
    fn get(&self, name: &str) -> Option<Binding<'_>> {
        let own = IrradianceMapBindings { irradiance_table: &self.irradiances, irradiance_grid: &self.shape };
        own.find(name).or_else(|| self.points.get(name))
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
        let shown = features.has(Feature::PhotonMap) || features.has(Feature::Caustics);
        let mut own = vec![IrradianceBindings::DECLARED];
        own.extend(shown.then_some(ShowBindings::DECLARED));
        let texels = 1 + usize::from(features.has(Feature::CausticIrradiance));
        Ok(Irradiance { kernel: kernel(gpu, "irradiance", features, &constants, &own)?, texels })
    }

    /// Estimates the irradiance at `points` from the photons of `map`, whose words hold flux in units of `step`.
    ///
    /// # Errors
    /// As [`Gpu::buffer`] and [`Kernel::bind`].
    pub fn precompute(
        &self,
        gpu: &Gpu,
        scene: &dyn Bindings,
        map: &SortedPhotons,
        points: SortedPhotons,
        step: f64,
    ) -> Result<IrradianceMap> {
        let texels = whole_rows(self.texels * points.count as usize);
        let irradiances = gpu.buffer::<[f32; 4]>("penumbra/irradiance/irradiances", texels)?;
        let counters = gpu.buffer::<u32>("penumbra/irradiance/counters", Counter::COUNT)?;
        let own =
            IrradianceBindings { irradiance_points: &points.sorted, irradiances: &irradiances, counters: &counters };
        let bound = self.kernel.bind(gpu, "irradiance", &[&own, map, scene])?;
        let parameters = IrradianceParameters {
            grid: map.shape,
            count: points.count,
            step: step as f32,
            shrink: 1.0,
            ..IrradianceParameters::default()
        };
        let mut frame = gpu.frame("irradiance");
        frame.run(&bound, points.count, &parameters);
        let bytes = points.bytes + irradiances.bytes;
        let irradiances = gpu.kernel_table(&mut frame, irradiances, TableFormat::Float)?;
        frame.submit()?;
        let not_finite = gpu.read::<u32>(&counters, Counter::COUNT)?[Counter::NotFiniteIrradiance as usize];
        Ok(IrradianceMap {
            not_finite: u64::from(not_finite),
            shape: gpu.upload("penumbra/irradiance/grid", &[points.shape])?,
            points,
            irradiances,
            bytes,
        })
    }
}

/// Photons that an estimate at the points of a tile uses.
pub struct ShownMap<'a> {
    /// The global map or the caustic map.
    pub map: &'a SortedPhotons,
    /// Power of one step of a photon's encoded flux.
    pub step: f64,
    /// Factor on the radius of the disc that would hold [`IRRADIANCE_NEAREST`] photons.
    pub shrink: f64,
    /// Number of lights, from the first one on, whose unshadowed light is added.
    pub unshadowed: u32,
    /// The points of the tile that use the caustic map.
    pub shell: Shell,
}

/// The points between two cubes around a centre, in normalised space.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Shell {
    /// The centre.
    pub centre: [f32; 3],
    /// Distance of the inner cube's faces from it; points on these are in the cube. Negative if there is no inner cube.
    pub inner: f32,
    /// Distance of the outer cube's faces.
    pub outer: f32,
}

impl Shell {
    /// All points.
    pub const ALL: Shell = Shell { centre: [0.0; 3], inner: -1.0, outer: f32::MAX };
}

/// Entry point `show` or `caustics`, bound to a tile.
pub struct BoundShow {
    kernel: BoundKernel,
    /// Without the points of a tile and the first light.
    parameters: IrradianceParameters,
    unshadowed: u32,
}

impl Irradiance {
    /// Binds `show` to a tile's buffers and the global map.
    ///
    /// # Errors
    /// As [`Kernel::bind`].
    pub fn bind_show(
        &self,
        gpu: &Gpu,
        tile: &TileBuffers,
        scene: &dyn Bindings,
        shown: &ShownMap<'_>,
    ) -> Result<BoundShow> {
        self.bind_entry(gpu, "show", tile, scene, shown)
    }

    /// Binds `caustics` to a tile's buffers and the caustic map.
    ///
    /// # Errors
    /// As [`Kernel::bind`].
    pub fn bind_caustics(
        &self,
        gpu: &Gpu,
        tile: &TileBuffers,
        scene: &dyn Bindings,
        shown: &ShownMap<'_>,
    ) -> Result<BoundShow> {
        self.bind_entry(gpu, "caustics", tile, scene, shown)
    }

    fn bind_entry(
        &self,
        gpu: &Gpu,
        entry: &str,
        tile: &TileBuffers,
        scene: &dyn Bindings,
        shown: &ShownMap<'_>,
    ) -> Result<BoundShow> {
        let own = ShowBindings { radiance_indirect: tile.required_indirect("irradiance")?, counters: &tile.counters };
        let kernel = self.kernel.bind(gpu, entry, &[&own, tile, shown.map, scene])?;
        let ShownMap { map, step, shrink, unshadowed, shell: Shell { centre, inner, outer } } = *shown;
        let (step, shrink) = (step as f32, shrink as f32);
        let others = IrradianceParameters::default();
        let parameters = IrradianceParameters { grid: map.shape, step, shrink, centre, inner, outer, ..others };
        Ok(BoundShow { kernel, parameters, unshadowed })
    }
}

impl BoundShow {
    /// Estimates the light of the map at the tile's points.
    pub fn record(&self, frame: &mut Frame<'_>, tile: &Tile) {
        let count = tile.point_count;
        for first_light in (0..self.unshadowed.max(1)).step_by(UNSHADOWED_LIGHTS as usize) {
            let parameters = IrradianceParameters { count, first_light, ..self.parameters };
            frame.run(&self.kernel, count, &parameters);
        }
    }
}

/// The grid for `count` irradiance points on surfaces of the given bounds and area, both normalised.
pub fn irradiance_point_grid((bounds, area): ((glam::Vec3, glam::Vec3), f32), count: u32) -> GridShape {
    GridShape::with_photons_per_cell(POINTS_PER_CELL, bounds, area, count, 1)
}
