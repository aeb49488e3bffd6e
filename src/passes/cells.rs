//! Pass `cells`: rays from the surfaces in each cell of a grid to each light, and the classes of points by their cells.

use glam::UVec3;

use crate::gpu::{Bindings, BoundKernel, Buffer, Features, Frame, Gpu, Kernel, Resources};
use crate::scene::Scene;
use crate::specialisation::visibility::CellLayout;
use crate::statistics::Counter;
use crate::{Error, Result, shared_struct};

use super::classify::Chunk;
use super::grid::GridShape;
use super::{Tile, TileBuffers, kernel};

shared_struct! {
    /// Immediates of the pass; see `shaders/cells.wgsl`.
    pub struct CellParameters {
        grid: GridShape,
        tile: Tile,
        light: u32,
        point_count: u32,
        rays: u32,
        cell_count: u32,
        slot_count: u32,
        seed: u32,
        padding: [u32; 2],
    }
}

shared_struct! {
    /// A point of a surface that a cell traces a ray from.
    pub struct CellPoint {
        /// On the triangle.
        pub position: [f32; 3],
        /// BVH slot of the triangle.
        pub triangle: u32,
    }
}

/// A grid of cubes over the scene, `cells` of them along its longest side, or fewer where lights are many.
pub fn grid_of(scene: &Scene, cells: u32) -> GridShape {
    let CellLayout { low, cell, size } = CellLayout::of(scene, cells);
    GridShape {
        origin: low.as_vec3().to_array(),
        cell: cell as f32,
        size: size.as_uvec3().max(UVec3::ONE).to_array(),
        inverse_cell: 1.0 / cell as f32,
    }
}

/// Rays of a dispatch: some tenths of a second on a software device, and no danger to a desktop's watchdog.
pub const BATCH_RAYS: u32 = 1 << 18;

/// The pass; see `shaders/cells.wgsl`.
pub struct Cells(Kernel);

/// What is asked of which cells.
#[derive(Clone, Copy, Debug)]
pub struct CellGrid {
    /// The grid; each light's is alike.
    pub shape: GridShape,
    /// Lights.
    pub lights: u32,
    /// Rays from each cell to each light.
    pub rays: u32,
    /// Of the light points.
    pub seed: u32,
}

/// What the rays of all cells have seen.
pub struct CellTable {
    /// The grid; each light's is alike.
    pub shape: GridShape,
    /// Rays that were traced.
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
        let own = ["cell_points", "cell_counts", "cell_words", "counters", "points", "classes"];
        Ok(Cells(kernel(gpu, "cells", features, constants, &own)?))
    }

    /// Traces a ray from each of the points to each light, and judges the cells. They come in batches of no more than
    /// [`BATCH_RAYS`]; in each, every [`CellGrid::rays`] points that follow each other are of one cell.
    ///
    /// # Errors
    /// [`Error::Computation`] where a traversal gave up, else as [`Kernel::bind`] and [`Gpu::check`].
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
        let own = |points: &Buffer| -> Result<[BoundKernel; 2]> {
            let own = Resources::new()
                .with("cell_points", points)
                .with("cell_counts", &counts)
                .with("cell_words", &words)
                .with("counters", &counters);
            Ok([self.0.bind(gpu, "trace", &[&own, scene])?, self.0.bind(gpu, "judge", &[&own, scene])?])
        };
        let parameters =
            CellParameters { grid: shape, rays, cell_count: cells as u32, seed, ..CellParameters::default() };
        for points in points {
            let [trace, _] = own(&gpu.upload("penumbra/cells/points", &points)?)?;
            for light in 0..lights {
                let point_count = points.len() as u32;
                let mut frame = gpu.frame("cells");
                frame.run(&trace, point_count, &CellParameters { light, point_count, ..parameters });
                frame.submit()?;
            }
        }
        let [_, judge] = own(&words)?;
        let mut frame = gpu.frame("cells");
        frame.run(&judge, cells as u32, &parameters);
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

    /// Binds what gives points the classes of their cells.
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
        let own =
            Resources::new().with("points", &tile.points).with("classes", classes).with("cell_words", &table.words);
        Ok(BoundCells { shape: table.shape, look: self.0.bind(gpu, "look", &[&own, scene])? })
    }
}

/// The pass, bound.
pub struct BoundCells {
    shape: GridShape,
    look: BoundKernel,
}

impl BoundCells {
    /// Writes the class words of a tile's points for a chunk of lights.
    pub fn record(&self, frame: &mut Frame<'_>, tile: &Tile, chunk: &Chunk) {
        let slot_count = tile.point_count * chunk.lights;
        let light = chunk.first_light;
        let parameters =
            CellParameters { grid: self.shape, tile: *tile, light, slot_count, ..CellParameters::default() };
        frame.run(&self.look, slot_count, &parameters);
    }
}

impl CellTable {
    /// The class word of each cell, light by light, x fastest; see `shaders/lib/photon.wgsl`.
    ///
    /// # Errors
    /// As [`Gpu::read`].
    pub fn words(&self, gpu: &Gpu, lights: u32) -> Result<Vec<u32>> {
        gpu.read(&self.words, (self.shape.cells() * lights) as usize)
    }
}
