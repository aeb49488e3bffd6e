//! Queries about single pixels of a render: the points that rays through their centres hit, and the cells that decide
//! them. They do not change the image.

use super::photons::SurfacePoint;
use super::renderer::Renderer;
use super::tiles::TileFilm;
use crate::Result;
use crate::gpu_scene::oct_decode16;
use crate::kernels::{INVALID_POINT, ShownCell};
use crate::light_transport::shared::Shared;
use crate::passes::{Point, Tile};

impl Renderer<'_> {
    /// For each pixel, the cell that decides the class of the point at its centre for a light; `None` if there are
    /// neither fine cells nor a visibility map.
    ///
    /// # Errors
    /// As [`kernel_kit::Gpu::read`], and those of a kernel that cannot be compiled.
    pub fn shown_cells(&self, light: u32) -> Result<Option<Vec<ShownCell>>> {
        let (gpu, scene, gpu_scene, tile) = (self.gpu, &self.scene, &self.gpu_scene, &self.view.buffers);
        let shared = Shared { gpu, scene, gpu_scene, tile };
        let nearest = self.settings.visibility_map.nearest;
        let bound = self.view.lighting.bind_shown_cells(&shared, &self.specialisation.features, nearest)?;
        let (Some(bound), Some(direct)) = (bound, &self.view.lighting.direct) else { return Ok(None) };
        let mut cells = Vec::new();
        for film in &self.view.tiles {
            let tile = self.centres(film);
            let mut frame = gpu.frame("cells");
            self.view.primary.record(&mut frame, &tile);
            bound.record(&mut frame, &tile, light);
            frame.submit()?;
            let words: Vec<u32> = gpu.read(&direct.classify_buffers().classes, tile.point_count as usize)?;
            cells.extend(words.into_iter().map(ShownCell::new));
        }
        Ok(Some(cells))
    }

    /// The point that is shaded for the ray through the centre of a pixel; `None` if there is no such point.
    ///
    /// # Errors
    /// As [`kernel_kit::Gpu::read`].
    pub fn surface_point(&self, [x, y]: [u32; 2]) -> Result<Option<SurfacePoint>> {
        let crop = self.settings.image.crop_window();
        let holds = |film: &&TileFilm| film.rows().contains(&y);
        let Some(film) = self.view.tiles.iter().find(holds).filter(|_| x < crop.width) else { return Ok(None) };
        let mut frame = self.gpu.frame("point");
        self.view.primary.record(&mut frame, &self.centres(film));
        frame.submit()?;
        let index = (y - film.rows().start) * crop.width + x;
        let points: Vec<Point> = self.gpu.read_from(&self.view.buffers.points.buffer, index as usize, 1)?;
        let of = |point: &Point| SurfacePoint { position: point.position.into(), normal: oct_decode16(point.normal) };
        Ok(points.first().filter(|point| point.normal != INVALID_POINT).map(of))
    }

    /// One ray through the centre of each pixel of a tile.
    fn centres(&self, film: &TileFilm) -> Tile {
        self.view.buffers.sampled_pixels.iter().for_each(|sampled| sampled.set_all(self.gpu));
        let pixels = film.rows().len() as u32 * self.settings.image.crop_window().width;
        Tile { centred: 1.0, ..film.tile(&self.settings, pixels, 0, 1) }
    }
}
