//! shade: direct light by the class of each point and light.

use crate::gpu::{Bindings, BoundKernel, Buffer, Features, Frame, Gpu, Kernel, Resources};
use crate::{Result, shared_struct};

use super::{Tile, TileBuffers, kernel};

shared_struct! {
    /// Immediates of the pass; see `shaders/shade.wgsl`.
    pub struct ShadeParameters {
        /// The tile.
        pub tile: Tile,
        /// First light of the chunk.
        pub first_light: u32,
        /// Lights of the chunk.
        pub lights_in_chunk: u32,
        /// Light points of a slot.
        pub light_samples: u32,
        /// Words of visibilities of a slot.
        pub visibility_words: u32,
        /// Probability that a decided point is audited.
        pub audit_probability: f32,
        /// To a multiple of eight bytes.
        pub padding: u32,
    }
}

/// The pass; see `shaders/shade.wgsl`.
pub struct Shade(Kernel);

impl Shade {
    /// Compiles the kernel.
    ///
    /// # Errors
    /// As [`Kernel::new`].
    pub fn new(gpu: &Gpu, features: &Features, constants: &[(&str, f64)]) -> Result<Shade> {
        let own = ["points", "surfaces", "classes", "visibility", "radiance_direct", "counters"];
        Ok(Shade(kernel(gpu, "shade", features, constants, &own)?))
    }

    /// Binds it. `shadow_samples` is written where the AOV is asked for.
    ///
    /// # Errors
    /// As [`Kernel::bind`].
    pub fn bind(
        &self,
        gpu: &Gpu,
        tile: &TileBuffers,
        classes: &Buffer,
        visibility: &Buffer,
        shadow_samples: Option<&Buffer>,
        scene: &dyn Bindings,
    ) -> Result<BoundShade> {
        let mut own = Resources::new()
            .with("points", &tile.points)
            .with("surfaces", &tile.surfaces)
            .with("radiance_direct", &tile.radiance_direct)
            .with("counters", &tile.counters)
            .with("classes", classes)
            .with("visibility", visibility);
        if let Some(samples) = shadow_samples {
            own = own.with("shadow_samples", samples);
        }
        Ok(BoundShade(self.0.bind(gpu, "shade", &[&own, scene])?))
    }
}

/// The pass, bound.
pub struct BoundShade(BoundKernel);

impl BoundShade {
    /// Adds the light of the chunk's lights to every point of the tile.
    pub fn record(&self, frame: &mut Frame<'_>, parameters: &ShadeParameters) {
        frame.run(&self.0, parameters.tile.point_count, parameters);
    }
}
