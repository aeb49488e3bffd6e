//! Pass `denoise`: filters an image by what is known of its noise.

use kernel_kit::{Buffer, Gpu, Kernel, Table, TableFormat, bindings, shared_struct, whole_rows};

use super::kernel;
use crate::Result;
use crate::specialisation::features::Features;

shared_struct! {
    /// Immediates of the pass; see `shaders/denoise.wgsl`.
    pub struct DenoiseParameters {
        /// Width of the image in pixels.
        pub width: u32,
        /// Height of the image in pixels.
        pub height: u32,
        /// Samples of each pixel; the variance of a single one is unknown, and estimated from its neighbours.
        pub samples: u32,
    }
}

/// Vectors of a pixel of the input: mean and variance of direct light, then of indirect light, albedo, normal,
/// position.
pub const PIXEL_VECTORS: usize = 7;

/// Rows above or below from which a pixel's result comes: by the radii of the windows in `shaders/denoise.wgsl`, 1
/// (spacing), 2 (`restrain`), 2 (`pool`), 1 (`smooth_light`), 3 (`average`), 5 (`regress`) and 2 (`combine`).
pub const REACH: u32 = 16;

bindings! {
    /// What the passes read and write, light apart.
    struct PixelBindings {
        pub pixels: &Buffer,
        pub light_out: &Buffer,
    }
}

bindings! {
    /// What `prepare` makes of the surfaces.
    struct SurfaceBindings {
        pub surface_out: &Buffer,
    }
}

bindings! {
    /// The tables of surfaces and light.
    struct LightBindings {
        pub surface_table: &Table,
        pub light_table: &Table,
        pub guide_table: &Table,
    }
}

/// The pass; see `shaders/denoise.wgsl`.
pub struct Denoise(Kernel);

impl Denoise {
    /// Compiles the kernel.
    ///
    /// # Errors
    /// As [`Kernel::new`].
    pub fn new(gpu: &Gpu, features: &Features) -> Result<Denoise> {
        let own = [PixelBindings::DECLARED, SurfaceBindings::DECLARED, LightBindings::DECLARED];
        Ok(Denoise(kernel(gpu, "denoise", features, &[], &own)?))
    }

    /// Filters an image that is not empty: [`PIXEL_VECTORS`] vectors for each pixel, whose light is about 1. Returns a
    /// vector for each pixel: the colour, and in w 1, or 0 where the pixel must keep its own.
    ///
    /// # Errors
    /// [`crate::Error::Buffer`] where the device has no room, and those of [`Kernel::bind`] and [`Gpu::read`].
    pub fn filter(&self, gpu: &Gpu, image: &DenoiseParameters, pixels: &[[f32; 4]]) -> Result<Vec<[f32; 4]>> {
        let count = (image.width * image.height) as usize;
        let rows = whole_rows(2 * count);
        let input = gpu.upload("penumbra/denoise/pixels", pixels)?;
        let vectors = |name: &str| gpu.buffer::<[f32; 4]>(&format!("penumbra/denoise/{name}"), rows);
        let (surfaces, light) = (vectors("surfaces")?, vectors("light")?);
        let read = PixelBindings { pixels: &input, light_out: &light };
        let bound = self.0.bind(gpu, "prepare", &[&read, &SurfaceBindings { surface_out: &surfaces }])?;
        let mut frame = gpu.frame("denoise");
        frame.run(&bound, count as u32, image);
        let surface_table = gpu.kernel_table(&mut frame, surfaces, TableFormat::Float)?;
        let prepared = gpu.kernel_table(&mut frame, light, TableFormat::Float)?;
        frame.submit()?;
        let run = |entry: &str, light_table: &Table, guide_table: &Table| -> Result<Buffer> {
            let out = vectors(entry)?;
            let tables = LightBindings { surface_table: &surface_table, light_table, guide_table };
            let bound = self.0.bind(gpu, entry, &[&PixelBindings { pixels: &input, light_out: &out }, &tables])?;
            gpu.run(&bound, count as u32, image)?;
            Ok(out)
        };
        let table = |buffer: Buffer| -> Result<Table> {
            let mut frame = gpu.frame("denoise");
            let table = gpu.kernel_table(&mut frame, buffer, TableFormat::Float)?;
            frame.submit()?;
            Ok(table)
        };
        let pool = if image.samples < 2 { "pool_single" } else { "pool" };
        let restrained = table(run("restrain", &prepared, &prepared)?)?;
        let light = table(run(pool, &restrained, &restrained)?)?;
        let mut guide = table(run("smooth_light", &light, &light)?)?;
        for entry in ["average", "regress"] {
            guide = table(run(entry, &light, &guide)?)?;
        }
        Ok(gpu.read(&run("combine", &light, &guide)?, count)?)
    }
}
