//! Pass `zones`: light zones, which the paper proposes for scenes of many lights. A zone is a cell of a coarse grid;
//! the pass lists the lights that reach it, by their photons.

use glam::Vec3;
use kernel_kit::{Buffer, Frame, Gpu, Kernel, Table, TableFormat, bindings, shared_struct, whole_rows};

use super::grid::SortedPhotons;
use super::kernel;
use crate::Result;
use crate::kernels::{GridShape, ZONE_LIGHTS};
use crate::specialisation::features::Features;

/// Maximum number of zones: 8 MiB of lists.
const MAX_ZONES: f64 = (1u32 << 15) as f64;

/// Photons of a light that a zone and its neighbours hold on an evenly covered surface, which crosses nine zones.
/// Nearby lights store many times more.
const PHOTONS_PER_LIGHT: f32 = 4.0;

shared_struct! {
    /// Immediates of the pass; see `shaders/zones.wgsl`.
    pub struct ZoneParameters {
        zones: GridShape,
        light_count: u32,
        environment: u32,
        padding: [u32; 2],
    }
}

bindings! {
    /// Buffers of the kernel, apart from the photons.
    struct ZoneBindings {
        pub light_powers: &Buffer,
        pub listed_lights: &Buffer,
    }
}

/// The pass; see `shaders/zones.wgsl`.
pub struct Zones {
    kernel: Kernel,
    /// Invocations in a workgroup. Each zone has one workgroup.
    group: u32,
}

/// The lights of each zone.
pub struct ZoneTable {
    /// Shape of the grid of zones.
    pub shape: GridShape,
    /// Bytes on the device.
    pub bytes: u64,
    /// [`ZONE_LIGHTS`] words per zone, x fastest, padded to whole rows of a table.
    pub lists: Buffer,
    table: Table,
}

bindings! {
    /// The zones' lists, as kernels read them.
    pub struct ZoneListBindings {
        /// [`ZONE_LIGHTS`] words per zone.
        pub zone_lists: &Table,
    }
}

impl ZoneTable {
    /// The zones' lists, as kernels read them.
    pub fn bindings(&self) -> ZoneListBindings<'_> {
        ZoneListBindings { zone_lists: &self.table }
    }
}

/// The grid of zones over `bounds` (lower and upper corner), for `photons` photons of all `lights` lights together on
/// surfaces of area `area`.
pub fn zone_shape(bounds: (Vec3, Vec3), area: f32, photons: u32, lights: u32) -> GridShape {
    let per_zone = PHOTONS_PER_LIGHT * lights as f32 / 9.0;
    GridShape::with_max_cells(per_zone, bounds, area, photons, MAX_ZONES)
}

impl Zones {
    /// Compiles the kernel; `features` must not have `light_tags`, as the photons are sorted by zone alone.
    ///
    /// # Errors
    /// As [`Kernel::new`].
    pub fn new(gpu: &Gpu, features: &Features) -> Result<Zones> {
        let kernel = kernel(gpu, "zones", features, &[], &[ZoneBindings::DECLARED])?;
        let group = kernel.workgroup_size("list").expect("the kernel has this entry point");
        Ok(Zones { kernel, group })
    }

    /// Lists the lights of every zone. `powers` holds the power, in any unit, of each light that has photons. With
    /// `environment`, every list has one more light, which has no photons.
    ///
    /// # Errors
    /// [`crate::Error::Buffer`] where the device has no room, and those of [`Kernel::bind`].
    pub fn list(&self, gpu: &Gpu, photons: &SortedPhotons, powers: &[f64], environment: bool) -> Result<ZoneTable> {
        let largest = powers.iter().copied().fold(f64::MIN_POSITIVE, f64::max);
        let powers: Vec<f32> = powers.iter().map(|power| (power / largest) as f32).collect();
        let light_powers = gpu.upload("penumbra/zones/light_powers", &powers)?;
        let zones = photons.shape.cells();
        let texels = whole_rows((zones * ZONE_LIGHTS / 4) as usize);
        let lists = gpu.buffer::<[u32; 4]>("penumbra/zones/listed_lights", texels)?;
        let own = ZoneBindings { light_powers: &light_powers, listed_lights: &lists };
        let bound = self.kernel.bind(gpu, "list", &[&own, photons])?;
        let parameters = ZoneParameters {
            zones: photons.shape,
            light_count: powers.len() as u32,
            environment: u32::from(environment),
            padding: [0; 2],
        };
        let mut frame: Frame<'_> = gpu.frame("zones");
        frame.run(&bound, zones * self.group, &parameters);
        let table = gpu.kernel_table(&mut frame, lists.clone(), TableFormat::Uint)?;
        frame.submit()?;
        Ok(ZoneTable { shape: photons.shape, bytes: lists.bytes, lists, table })
    }
}
