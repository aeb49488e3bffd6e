//! Pass `light_buffer`: the classes of points by the light buffers of Haines and Greenberg (1986).

use kernel_kit::{Bindings, BoundKernel, Buffer, Frame, Gpu, Kernel, Table, TableFormat, bindings, shared_struct};

use super::classify::Chunk;
use super::{Tile, TileBuffers, kernel};
use crate::Result;
use crate::gpu_scene::light_buffer::{BufferedLight, LightBuffers};
use crate::specialisation::features::Features;

shared_struct! {
    /// Immediates of the pass; see `shaders/light_buffer.wgsl`.
    pub struct LightBufferParameters {
        tile: Tile,
        first_light: u32,
        candidate_count: u32,
    }
}

bindings! {
    /// Buffers of the classification.
    struct ClassBindings {
        pub classes: &Buffer,
        pub buffered_lights: &Buffer,
        pub buffer_cells: &Buffer,
        pub occluder_lists: &Table,
        pub occluder_planes: &Table,
    }
}

/// The pass; see `shaders/light_buffer.wgsl`.
pub struct LightBufferPass(Kernel);

impl LightBufferPass {
    /// Compiles the kernel.
    ///
    /// # Errors
    /// As [`Kernel::new`].
    pub fn new(gpu: &Gpu, features: &Features, constants: &[(&str, f64)]) -> Result<LightBufferPass> {
        Ok(LightBufferPass(kernel(gpu, "light_buffer", features, constants, &[ClassBindings::DECLARED])?))
    }

    /// Uploads the light buffers, and binds the classification of a tile's points.
    ///
    /// # Errors
    /// As [`Gpu::table`] and [`Kernel::bind`].
    pub fn bind(
        &self,
        gpu: &Gpu,
        tile: &TileBuffers,
        buffers: &LightBuffers,
        classes: &Buffer,
        scene: &dyn Bindings,
    ) -> Result<BoundLightBuffer> {
        let own = ClassBindings {
            classes,
            buffered_lights: &gpu.upload::<BufferedLight>("penumbra/light_buffer/lights", &buffers.lights)?,
            buffer_cells: &gpu.upload("penumbra/light_buffer/cells", &buffers.cells)?,
            occluder_lists: &gpu.table("penumbra/light_buffer/lists", &buffers.lists, TableFormat::Uint)?,
            occluder_planes: &gpu.table("penumbra/light_buffer/planes", &buffers.planes, TableFormat::Float)?,
        };
        Ok(BoundLightBuffer(self.0.bind(gpu, "classify_by_buffer", &[&own, tile, scene])?))
    }
}

/// The pass, bound.
pub struct BoundLightBuffer(BoundKernel);

impl BoundLightBuffer {
    /// Writes the class words of a tile's points for a chunk of lights.
    pub fn record(&self, frame: &mut Frame<'_>, tile: &Tile, chunk: &Chunk) {
        let candidate_count = tile.point_count * chunk.lights;
        let first_light = chunk.first_light;
        frame.run(&self.0, candidate_count, &LightBufferParameters { tile: *tile, first_light, candidate_count });
    }
}
