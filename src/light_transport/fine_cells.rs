//! Fine cells: shadow rays of earlier samples, as photons, decide pieces of surface that the photons of the map leave
//! undecided.

use kernel_kit::{BoundKernel, Gpu};

use super::shared::Shared;
use crate::Result;
use crate::gpu_scene::CameraUniform;
use crate::passes::fine_cells::{FineCell, FineCellBindings, FineCellTable, FineCellView, FineCells};
use crate::settings::Settings;

/// Slots of the table for each pixel and light, of at most four lights: a cell has the area of 16 pixels or more, and
/// the edges of objects divide some. So about a fifth of the slots are in use.
const SLOTS_PER_PIXEL: u64 = 4;
const MOST_LIGHTS: u64 = 4;

/// Bounds of the number of slots: 32 bytes each, at most 128 MiB.
const FEWEST_SLOTS: u64 = 1 << 12;
const MOST_SLOTS: u64 = 1 << 22;

pub(crate) struct FineCellMap {
    table: FineCellTable,
    view: FineCellView,
    classify: BoundKernel,
}

impl FineCellMap {
    /// An empty map for the camera's view.
    pub fn new(
        shared: &Shared<'_>,
        kernel: &FineCells,
        camera: &CameraUniform,
        settings: &Settings,
    ) -> Result<FineCellMap> {
        let pixels = u64::from(settings.image.width) * u64::from(settings.image.height);
        let lights = shared.scene.placed_lights().len() as u64;
        let wanted = SLOTS_PER_PIXEL * pixels * lights.min(MOST_LIGHTS);
        let slots = wanted.clamp(FEWEST_SLOTS, MOST_SLOTS).next_power_of_two() as u32;
        let view = FineCellView::new(camera, settings.image.height, slots);
        let table = FineCellTable::new(shared.gpu, view)?;
        let classify = kernel.bind(shared.gpu, &table)?;
        Ok(FineCellMap { table, view, classify })
    }

    /// Classifies all cells by their photons so far. A table that is half full takes no new cells: how many more it
    /// could take would depend on chance.
    pub fn classify(&mut self, gpu: &Gpu) -> Result<()> {
        let count = gpu.read::<u32>(&self.table.count, 1)?[0];
        if self.view.closed == 0 && count > self.view.mask / 2 {
            self.view.closed = 1;
            gpu.write(&self.table.view, &[self.view]);
        }
        let mut frame = gpu.frame("fine cells");
        if std::env::var("FC").is_ok() { eprintln!("cells {count} of {}", self.view.mask); }
        frame.run(&self.classify, count, &());
        frame.submit()
            .map_err(Into::into)
    }

    /// The table, for the passes that read and fill it.
    pub fn bindings(&self) -> FineCellBindings<'_> {
        self.table.bindings()
    }

    /// The cells, for a checkpoint: slot and words of each.
    pub fn state(&self, gpu: &Gpu) -> Result<Vec<u32>> {
        let cells: Vec<FineCell> = gpu.read(&self.table.cells, self.view.mask as usize + 1)?;
        let used = cells.iter().enumerate().filter(|(_, cell)| cell.tag != 0);
        Ok(used.flat_map(|(slot, cell)| std::iter::once(slot as u32).chain(words(cell))).collect())
    }

    /// Restores that state; false if it belongs to another table.
    pub fn restore(&mut self, gpu: &Gpu, state: &[u32]) -> bool {
        const WORDS: usize = 1 + size_of::<FineCell>() / 4;
        let mut cells = vec![FineCell::default(); self.view.mask as usize + 1];
        for entry in state.chunks(WORDS) {
            let Some(cell) = cells.get_mut(entry[0] as usize).filter(|_| entry.len() == WORDS) else { return false };
            *cell = bytemuck::pod_read_unaligned(bytemuck::cast_slice(&entry[1..]));
        }
        gpu.write(&self.table.cells, &cells);
        gpu.write(&self.table.count, &[(state.len() / WORDS) as u32]);
        true
    }

    /// Bytes on the device.
    pub fn bytes(&self) -> u64 {
        self.table.bytes()
    }
}

fn words(cell: &FineCell) -> impl Iterator<Item = u32> {
    bytemuck::cast_slice::<_, u32>(std::slice::from_ref(cell)).to_vec().into_iter()
}
