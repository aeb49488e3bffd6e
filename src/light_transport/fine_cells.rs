//! Fine cells: where the map's photons do not decide, the shadow rays of earlier samples are photons that do.

use kernel_kit::{BoundKernel, Gpu};

use super::shared::Shared;
use crate::Result;
use crate::gpu_scene::CameraUniform;
use crate::passes::fine_cells::{FineCell, FineCellBindings, FineCellTable, FineCellView, FineCells};

/// Entries of the table for each pixel that shows a surface, and for each light up to [`COUNTED_LIGHTS`]. A view full
/// of small shadows (`scenes/crowd.glb`, 256 x 256) uses 2.2 a pixel; twice that keeps searches short.
const ENTRIES_PER_PIXEL: u64 = 4;

/// Maximum number of lights by which the table is sized: more lights seldom have boundaries at the same pixels.
const COUNTED_LIGHTS: u64 = 4;

/// Bounds of the number of entries: 40 bytes each. The minimum takes 160 KiB. With the maximum, the cells themselves
/// fill a storage binding of 128 MiB, which all devices offer.
const MIN_ENTRIES: u64 = 1 << 12;
const MAX_ENTRIES: u64 = 1 << 22;

/// Words of a cell in [`FineCellMap::state`]: its entry, its tag, and the cell.
const ENTRY_WORDS: usize = 2 + size_of::<FineCell>() / size_of::<u32>();

pub(crate) struct FineCellMap {
    table: FineCellTable,
    view: FineCellView,
    classify: BoundKernel,
    /// Samples per pixel when the cells were classified last.
    classified_at: u32,
}

impl FineCellMap {
    /// An empty table for the camera's view of `height` pixel rows, `covered` of whose pixels show surfaces.
    pub fn new(
        shared: &Shared<'_>,
        kernel: &FineCells,
        camera: &CameraUniform,
        height: u32,
        covered: u64,
    ) -> Result<FineCellMap> {
        let lights = shared.scene.placed_lights().len() as u64;
        let wanted = ENTRIES_PER_PIXEL * covered * lights.clamp(1, COUNTED_LIGHTS);
        let entries = wanted.next_power_of_two().clamp(MIN_ENTRIES, MAX_ENTRIES) as u32;
        let view = FineCellView::new(camera, height, entries);
        let table = FineCellTable::new(shared.gpu, view)?;
        let classify = kernel.bind(shared.gpu, &table)?;
        Ok(FineCellMap { table, view, classify, classified_at: 0 })
    }

    /// Classifies all cells by their photons, if the number of `samples` per pixel has doubled since the last time.
    pub fn classify(&mut self, gpu: &Gpu, samples: u32) -> Result<()> {
        if self.classified_at > 0 && samples < 2 * self.classified_at {
            return Ok(());
        }
        self.classified_at = samples;
        let count = self.close_if_full(gpu)?;
        let mut frame = gpu.frame("fine cells");
        // Once so that cells find their new neighbours, once so that points find the new classes.
        self.table.publish(&mut frame);
        frame.run(&self.classify, count, &());
        self.table.publish(&mut frame);
        Ok(frame.submit()?)
    }

    /// Closes a table that is more than three quarters full to new cells, so that searches stay short. If cells found
    /// no entry, the table is emptied too, because which ones did depends on the order of invocations. (With a share a
    /// of n entries taken, the longest search is of about ln n / (a - 1 - ln a) entries: in the largest table 930 if
    /// 0.83 are taken, and 1,060, which is beyond FINE_CELL_PROBES, at 0.84.) Returns the number of cells.
    fn close_if_full(&mut self, gpu: &Gpu) -> Result<u32> {
        let entries = self.view.mask + 1;
        let [mut count, without_entry] = self.table.count(gpu)?;
        if self.view.closed == 0 && (count > entries / 4 * 3 || without_entry > 0) {
            self.view.closed = 1;
            gpu.write(&self.table.view, &[self.view]);
            if without_entry > 0 {
                count = 0;
                let mut frame = gpu.frame("fine cells");
                frame.clear(&self.table.cells);
                frame.clear(&self.table.tags);
                frame.submit()?;
            }
        }
        Ok(count)
    }

    /// The table, for the passes that read and fill it.
    pub fn bindings(&self) -> FineCellBindings<'_> {
        self.table.bindings()
    }

    /// The state that samples left: whether the table is closed, the number of samples at the last classification, and
    /// for each cell its entry, its tag and the cell.
    pub fn state(&self, gpu: &Gpu) -> Result<Vec<u32>> {
        let entries = self.view.mask as usize + 1;
        let cells: Vec<FineCell> = gpu.read(&self.table.cells, entries)?;
        let tags: Vec<u32> = gpu.read(&self.table.tags, entries)?;
        let mut state = vec![self.view.closed, self.classified_at];
        for ((entry, cell), tag) in cells.iter().enumerate().zip(&tags).filter(|(_, tag)| **tag != 0) {
            state.extend([entry as u32, *tag]);
            // The order of the list depends on the order of invocations.
            let cell = FineCell { listed: 0, ..*cell };
            state.extend_from_slice(bytemuck::cast_slice(&[cell]));
        }
        Ok(state)
    }

    /// Restores that state; false if it belongs to another table.
    pub fn restore(&mut self, gpu: &Gpu, state: &[u32]) -> Result<bool> {
        let Some(([closed, classified_at], parts)) = state.split_first_chunk() else { return Ok(false) };
        let mut cells = vec![FineCell::default(); self.view.mask as usize + 1];
        let mut tags = vec![0; cells.len()];
        let mut list = Vec::with_capacity(parts.len() / ENTRY_WORDS);
        for part in parts.chunks(ENTRY_WORDS) {
            let entry = part[0] as usize;
            if part.len() != ENTRY_WORDS || entry >= cells.len() {
                return Ok(false);
            }
            tags[entry] = part[1];
            cells[entry] = bytemuck::pod_read_unaligned(bytemuck::cast_slice(&part[2..]));
            list.push(part[0]);
        }
        if list.len() > cells.len() {
            return Ok(false);
        }
        cells.iter_mut().zip(&list).for_each(|(cell, entry)| cell.listed = *entry);
        tags.push(list.len() as u32);
        (self.view.closed, self.classified_at) = (*closed, *classified_at);
        gpu.write(&self.table.view, &[self.view]);
        gpu.write(&self.table.cells, &cells);
        gpu.write(&self.table.tags, &tags);
        let mut frame = gpu.frame("fine cells");
        self.table.publish(&mut frame);
        frame.submit()?;
        Ok(true)
    }

    /// Bytes on the device.
    pub fn bytes(&self) -> u64 {
        self.table.bytes()
    }
}
