//! Pass `denoise`: filters an image by the estimates of its noise.

use kernel_kit::{Buffer, Gpu, Kernel, KernelTable, Table, TableFormat, bindings, shared_struct, whole_rows};

use super::kernel;
use crate::Result;
use crate::kernels::{DENOISE_BORDER, DENOISE_VECTORS};
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

/// Vectors of a pixel of the input.
pub const PIXEL_VECTORS: usize = DENOISE_VECTORS as usize;

/// Rows above or below on which a pixel's result depends: the sum of the radii of the windows in
/// `shaders/denoise.wgsl`, 1 (spacing), 2 (`restrain`), 2 (`pool`), 1 (`smooth_light`), 3 (`average`), 5 (`regress`)
/// and 2 (`combine`).
pub const REACH: u32 = 16;

bindings! {
    /// Pixels and results of the entry points, without light.
    struct PixelBindings {
        pub pixels: &Buffer,
        pub light_out: &Buffer,
    }
}

bindings! {
    /// The surfaces that `prepare` packs.
    struct SurfaceBindings {
        pub surface_out: &Buffer,
    }
}

bindings! {
    /// The weights that `restrain` keeps of its windows.
    struct WeightBindings {
        pub weights_out: &Buffer,
    }
}

bindings! {
    /// The tables of surfaces and light.
    struct LightBindings {
        pub surface_table: &Table,
        pub light_table: &Table,
        pub guide_table: &Table,
        pub weight_table: &Table,
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
        let own =
            [PixelBindings::DECLARED, SurfaceBindings::DECLARED, WeightBindings::DECLARED, LightBindings::DECLARED];
        Ok(Denoise(kernel(gpu, "denoise", features, &[], &own)?))
    }

    /// Filters an image that is not empty: [`PIXEL_VECTORS`] vectors for each pixel, whose light is about 1. Returns a
    /// vector for each pixel: the colour, and in w 1, or 0 where the pixel must keep its own.
    ///
    /// # Errors
    /// [`crate::Error::Buffer`] where the device has no room, and those of [`Kernel::bind`] and [`Gpu::read`].
    pub fn filter(&self, gpu: &Gpu, image: &DenoiseParameters, pixels: &[[f32; 4]]) -> Result<Vec<[f32; 4]>> {
        let count = (image.width * image.height) as usize;
        // One pixel more than the image has: if the width is odd, the last pixel is processed in a pair with its right
        // neighbour.
        let indices = (image.width + DENOISE_BORDER) * (image.height + 2 * DENOISE_BORDER) + DENOISE_BORDER + 1;
        // Whole rows: a texture that is written completely needs no clearing.
        let records = whole_rows(2 * indices as usize) as u32;
        let input = gpu.upload("penumbra/denoise/pixels", pixels)?;
        let result = gpu.buffer::<[f32; 4]>("penumbra/denoise/result", count)?;
        let table = |name: &str, format| -> Result<KernelTable> {
            let buffer = gpu.buffer::<[u32; 4]>(&format!("penumbra/denoise/{name}"), records as usize)?;
            Ok(gpu.table_of(buffer, format)?)
        };
        let [surfaces, light, other, guide] =
            ["surfaces", "light", "other", "guide"].map(|name| table(name, TableFormat::Float));
        let (surfaces, light, other, guide) = (surfaces?, light?, other?, guide?);
        let weights = table("weights", TableFormat::Uint)?;
        let mut frame = gpu.frame("denoise");
        let read = PixelBindings { pixels: &input, light_out: &light.buffer };
        let bound = self.0.bind(gpu, "prepare", &[&read, &SurfaceBindings { surface_out: &surfaces.buffer }])?;
        frame.run(&bound, count as u32, image);
        frame.publish(&surfaces, records);
        frame.publish(&light, records);
        let bind = |entry: &str, light: &KernelTable, guide: &KernelTable, light_out: &Buffer| {
            let pixels = PixelBindings { pixels: &input, light_out };
            let written = WeightBindings { weights_out: &weights.buffer };
            let tables = LightBindings {
                surface_table: &surfaces.table,
                light_table: &light.table,
                guide_table: &guide.table,
                weight_table: &weights.table,
            };
            self.0.bind(gpu, entry, &[&pixels, &written, &tables])
        };
        frame.run(&bind("restrain", &light, &light, &other.buffer)?, count as u32, image);
        frame.publish(&weights, records);
        frame.publish(&other, records);
        // Each pair of pixels is an item of the passes that compare light.
        let (pixels, pairs) = (count as u32, image.width.div_ceil(2) * image.height);
        let pool = if image.samples < 2 { "pool_single" } else { "pool" };
        let steps = [
            (pool, &other, &other, &light, pixels),
            ("smooth_light", &light, &light, &other, pixels),
            ("average", &light, &other, &guide, pairs),
            ("regress", &light, &guide, &other, pairs),
        ];
        for (entry, light, guide, out, items) in steps {
            frame.run(&bind(entry, light, guide, &out.buffer)?, items, image);
            frame.publish(out, records);
        }
        frame.run(&bind("combine", &light, &other, &result)?, pixels, image);
        frame.submit()?;
        Ok(gpu.read(&result, count)?)
    }
}
