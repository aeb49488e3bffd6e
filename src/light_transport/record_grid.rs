//! Which irradiance records are near a position, and how near.

use std::collections::HashMap;
use std::ops::Range;

use glam::Vec3;

use crate::kernels::{RECORD_OFF_PLANE, RECORD_PER_NORMAL};
use crate::passes::gather::RecordHead;

/// Records by the cell of a grid that they are in.
pub(super) struct RecordGrid {
    /// Side of a cell.
    side: f32,
    /// Where the records of each cell are in `records`.
    cells: HashMap<[i32; 3], Range<usize>>,
    /// Positions and indices of records, those of a cell one after the other.
    records: Vec<(Vec3, usize)>,
}

impl RecordGrid {
    /// A grid of all records; see [`RecordGrid::of_some`].
    pub fn new(heads: &[RecordHead], reach: impl Fn(usize) -> f32) -> RecordGrid {
        RecordGrid::of_some(heads, 1, reach)
    }

    /// A grid of every `step`-th record. Its cells are twice as wide as the mean `reach` of the records, so that most
    /// records reach into few cells.
    pub fn of_some(heads: &[RecordHead], step: usize, reach: impl Fn(usize) -> f32) -> RecordGrid {
        let sum: f64 = (0..heads.len()).map(|i| f64::from(reach(i))).sum();
        let side = ((2.0 * sum / heads.len().max(1) as f64) as f32).max(f32::MIN_POSITIVE);
        let records = heads.iter().enumerate().step_by(step);
        let mut records: Vec<_> = records.map(|(index, head)| (Vec3::from(head.position), index)).collect();
        records.sort_by_cached_key(|(position, _)| cell(*position, side));
        let mut cells = HashMap::new();
        let mut first = 0;
        for of_cell in records.chunk_by(|(a, _), (b, _)| cell(*a, side) == cell(*b, side)) {
            cells.insert(cell(of_cell[0].0, side), first..first + of_cell.len());
            first += of_cell.len();
        }
        RecordGrid { side, cells, records }
    }

    /// Calls `found` with the indices of all records within `reach`, and of some a little farther away.
    pub fn each_near(&self, here: Vec3, reach: f32, mut found: impl FnMut(usize)) {
        // Differences of positions are rounded.
        let reach = reach + 1e-6 * (reach + here.abs().max_element());
        let mut search = |records: &[(Vec3, usize)]| {
            let near = records.iter().filter(|(position, _)| position.distance_squared(here) <= reach * reach);
            near.for_each(|(_, index)| found(*index));
        };
        let (low, high) = (cell(here - reach, self.side), cell(here + reach, self.side));
        let cells: f64 = (0..3).map(|axis| f64::from(high[axis]) - f64::from(low[axis]) + 1.0).product();
        if cells > self.cells.len() as f64 {
            return search(&self.records);
        }
        for x in low[0]..=high[0] {
            for y in low[1]..=high[1] {
                for z in low[2]..=high[2] {
                    self.cells.get(&[x, y, z]).into_iter().for_each(|range| search(&self.records[range.clone()]));
                }
            }
        }
    }
}

/// The cell of a position. Positions far away share the last cells.
fn cell(position: Vec3, side: f32) -> [i32; 3] {
    position.to_array().map(|x| (x / side).floor() as i32)
}

/// The weight of a record at the place of another one; see `interpolate_records` in `shaders/lib/record.wgsl`.
pub(super) fn weight(of: &RecordHead, at: &RecordHead) -> f32 {
    let (normal, other) = (Vec3::from(of.normal), Vec3::from(at.normal));
    let offset = Vec3::from(at.position) - Vec3::from(of.position);
    // Of records that are too far away nothing else is needed.
    if offset.length_squared() >= of.size * of.size {
        return 0.0;
    }
    let off_plane = offset.dot(0.5 * (normal + other));
    let distance = (offset.length_squared() + RECORD_OFF_PLANE * off_plane * off_plane).sqrt() / of.size;
    let normal_distance = normal.distance(other) * RECORD_PER_NORMAL;
    (1.0 - distance.max(normal_distance)).max(0.0)
}
