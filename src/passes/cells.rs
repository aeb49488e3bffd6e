//! Pass `cells`: traces shadow rays from the surfaces in each cell of a grid to each light, classifies the cells by
//! them, and gives each point the class of its cell.

use kernel_kit::{Bindings, BoundKernel, Buffer, Frame, Gpu, Kernel, bindings, shared_struct};

use super::classify::Chunk;
use super::{Tile, TileBuffers, kernel};
use crate::kernels::GridShape;
use crate::specialisation::features::Features;
use crate::statistics::Counter;
use crate::{Error, Result};

shared_struct! {
    /// Immediates of the pass; see `shaders/cells.wgsl`.
    pub struct CellParameters {
        grid: GridShape,
        tile: Tile,
        light: u32,
        point_count: u32,
        rays: u32,
        cell_count: u32,
        candidate_count: u32,
        seed: u32,
        padding: [u32; 2],
    }
}

shared_struct! {
    /// A surface point in a cell, from which a shadow ray is traced.
    pub struct CellPoint {
        /// On the triangle.
        pub position: [f32; 3],
        /// Primitive index of the triangle.
        pub triangle: u32,
    }
}

bindings! {
    /// Buffers of `trace`, apart from the scene.
    struct TraceBindings {
        pub cell_points: &Buffer,
        pub cell_counts: &Buffer,
        pub counters: &Buffer,
    }
}

bindings! {
    /// Buffers of the classification of cells.
    struct CellClassBindings {
        pub cell_counts: &Buffer,
        pub cell_words: &Buffer,
    }
}

bindings! {
    /// Buffers of the look-up of the points' classes.
    struct PointClassBindings {
        pub cell_words: &Buffer,
        pub classes: &Buffer,
    }
}

/// Maximum number of rays in a dispatch. It takes some tenths of a second on a software device, too short for a
/// desktop's watchdog to stop it.
pub const DISPATCH_RAYS: u32 = 1 << 18;

/// The pass; see `shaders/cells.wgsl`.
pub struct Cells(Kernel);

/// The cells to classify, and how.
#[derive(Clone, Copy, Debug)]
pub struct CellGrid {
    /// The grid; all lights have the same.
    pub shape: GridShape,
    /// Lights.
    pub lights: u32,
    /// Rays from each cell to each light.
    pub rays: u32,
    /// Seed of the random numbers that sample light points.
    pub seed: u32,
}

/// The classes of all cells.
pub struct CellTable {
    /// The grid; all lights have the same.
    pub shape: GridShape,
    /// Number of rays traced.
    pub rays: u64,
    /// Bytes on the device.
    pub bytes: u64,
    words: Buffer,
}

impl Cells {
    /// Compiles the kernel.
    ///
    /// # Errors
    /// As [`Kernel::new`].
    pub fn new(gpu: &Gpu, features: &Features, constants: &[(&str, f64)]) -> Result<Cells> {
        let names = [TraceBindings::DECLARED, CellClassBindings::DECLARED, PointClassBindings::DECLARED];
        Ok(Cells(kernel(gpu, "cells", features, constants, &names)?))
    }

    /// Traces a ray from each of the points to each light, and classifies the cells. The points come in lists of at
    /// most [`DISPATCH_RAYS`], sorted by cell, with [`CellGrid::rays`] points per cell.
    ///
    /// # Errors
    /// [`Error::Computation`] where a traversal exceeded the loop budget, else as [`Kernel::bind`] and [`Gpu::check`].
    pub fn trace(
        &self,
        gpu: &Gpu,
        scene: &dyn Bindings,
        grid: &CellGrid,
        points: impl Iterator<Item = Vec<CellPoint>>,
    ) -> Result<CellTable> {
        let CellGrid { shape, lights, rays, seed } = *grid;
        let cells = (shape.cells() * lights) as usize;
        let counts = gpu.buffer::<u32>("penumbra/cells/counts", cells)?;
        let words = gpu.buffer::<u32>("penumbra/cells/words", cells)?;
        let counters = gpu.buffer::<u32>("penumbra/cells/counters", Counter::COUNT)?;
        let parameters =
            CellParameters { grid: shape, rays, cell_count: cells as u32, seed, ..CellParameters::default() };
        for points in points {
            let cell_points = gpu.upload("penumbra/cells/points", &points)?;
            let own = TraceBindings { cell_points: &cell_points, cell_counts: &counts, counters: &counters };
            let trace = self.0.bind(gpu, "trace", &[&own, scene])?;
            for light in 0..lights {
                let point_count = points.len() as u32;
                let mut frame = gpu.frame("cells");
                frame.run(&trace, point_count, &CellParameters { light, point_count, ..parameters });
                frame.submit()?;
            }
        }
        let own = CellClassBindings { cell_counts: &counts, cell_words: &words };
        let classify = self.0.bind(gpu, "classify_cells", &[&own, scene])?;
        let mut frame = gpu.frame("cells");
        frame.run(&classify, cells as u32, &parameters);
        frame.submit()?;
        let overruns = gpu.read::<u32>(&counters, Counter::COUNT)?[Counter::Overrun as usize];
        if overruns > 0 {
            let problem = format!("{overruns} rays of cells met more triangles than the device's loop budget allows");
            return Err(Error::Computation { kernel: "cells".to_owned(), problem });
        }
        let traced: Vec<u32> = gpu.read(&counts, cells)?;
        let rays = traced.iter().map(|count| u64::from(count & 0xffff)).sum();
        Ok(CellTable { shape, rays, bytes: counts.bytes + words.bytes, words })
    }

    /// Binds the look-up of points' classes.
    ///
    /// # Errors
    /// As [`Kernel::bind`].
    pub fn bind(
        &self,
        gpu: &Gpu,
        tile: &TileBuffers,
        table: &CellTable,
        classes: &Buffer,
        scene: &dyn Bindings,
    ) -> Result<BoundCells> {
        let own = PointClassBindings { cell_words: &table.words, classes };
        let classify = self.0.bind(gpu, "classify_points", &[&own, tile, scene])?;
        Ok(BoundCells { shape: table.shape, classify })
    }
}

/// The pass, bound.
pub struct BoundCells {
    shape: GridShape,
    classify: BoundKernel,
}

impl BoundCells {
    /// Writes the class words of a tile's points for a chunk of lights, by look-up.
    pub fn record(&self, frame: &mut Frame<'_>, tile: &Tile, chunk: &Chunk) {
        let candidate_count = tile.point_count * chunk.lights;
        let light = chunk.first_light;
        let parameters =
            CellParameters { grid: self.shape, tile: *tile, light, candidate_count, ..CellParameters::default() };
        frame.run(&self.classify, candidate_count, &parameters);
    }
}

impl CellTable {
    /// The class word of each cell, light by light, x fastest; see `shaders/lib/class_word.wgsl`.
    ///
    /// # Errors
    /// As [`Gpu::read`].
    pub fn words(&self, gpu: &Gpu, lights: u32) -> Result<Vec<u32>> {
        Ok(gpu.read(&self.words, (self.shape.cells() * lights) as usize)?)
    }
}
