//! Which irradiance records are near a position, and how near.

use std::collections::HashMap;

use glam::Vec3;

use crate::kernels::{RECORD_OFF_PLANE, RECORD_PER_NORMAL};
use crate::passes::gather::RecordHead;

/// Records by the cell of a grid that they are in.
pub(super) struct RecordGrid {
    /// Side of a cell.
    side: f32,
    cells: HashMap<[i32; 3], Vec<u32>>,
}

impl RecordGrid {
    /// A grid of all records; see [`RecordGrid::of_some`].
    pub fn new(heads: &[RecordHead], reach: impl Fn(usize) -> f32) -> RecordGrid {
        RecordGrid::of_some(heads, 1, reach)
    }

    /// A grid of every `step`-th record. Its cells are twice as wide as the mean distance that records `reach`, so that
    /// most reach into few cells.
    pub fn of_some(heads: &[RecordHead], step: usize, reach: impl Fn(usize) -> f32) -> RecordGrid {
        let sum: f64 = (0..heads.len()).map(|i| f64::from(reach(i))).sum();
        let side = (2.0 * sum / heads.len().max(1) as f64) as f32;
        let mut grid = RecordGrid { side: side.max(f32::MIN_POSITIVE), cells: HashMap::new() };
        for (index, head) in (0..).zip(heads).step_by(step) {
            grid.cells.entry(grid.cell(Vec3::from(head.position))).or_default().push(index);
        }
        grid
    }

    /// The cell of a position. Positions far away share the last cells.
    fn cell(&self, position: Vec3) -> [i32; 3] {
        position.to_array().map(|x| (x / self.side).floor() as i32)
    }

    /// Calls `found` with the indices of all records within `reach`, and with others.
    pub fn each_near(&self, here: Vec3, reach: f32, mut found: impl FnMut(usize)) {
        // Differences of positions are rounded.
        let reach = reach + 1e-6 * (reach + here.abs().max_element());
        let (low, high) = (self.cell(here - reach), self.cell(here + reach));
        let cells: f64 = (0..3).map(|axis| f64::from(high[axis]) - f64::from(low[axis]) + 1.0).product();
        if cells > self.cells.len() as f64 {
            return self.cells.values().flatten().for_each(|index| found(*index as usize));
        }
        for x in low[0]..=high[0] {
            for y in low[1]..=high[1] {
                for z in low[2]..=high[2] {
                    let there = self.cells.get(&[x, y, z]).into_iter().flatten();
                    there.for_each(|index| found(*index as usize));
                }
            }
        }
    }
}

/// The weight of a record at the place of another one; see `interpolate_records` in `shaders/lib/record.wgsl`.
pub(super) fn weight(of: &RecordHead, at: &RecordHead) -> f32 {
    let (normal, other) = (Vec3::from(of.normal), Vec3::from(at.normal));
    let offset = Vec3::from(at.position) - Vec3::from(of.position);
    // Grids offer many records that are too far away: of these nothing else is needed.
    if offset.length_squared() >= of.size * of.size {
        return 0.0;
    }
    let off_plane = offset.dot(0.5 * (normal + other));
    let distance = (offset.length_squared() + RECORD_OFF_PLANE * off_plane * off_plane).sqrt() / of.size;
    let normal_distance = normal.distance(other) * RECORD_PER_NORMAL;
    (1.0 - distance.max(normal_distance)).max(0.0)
}
