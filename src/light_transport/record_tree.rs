//! Which irradiance records are near a position, and how near.

use std::ops::Range;

use glam::Vec3;

use crate::bvh::Aabb;
use crate::kernels::{RECORD_OFF_PLANE, RECORD_PER_NORMAL};
use crate::passes::gather::RecordHead;

/// Maximum number of records in a leaf. With 32, the filter takes as long.
const LEAF: usize = 16;

/// A tree over records. Distances between them are in proportion to the size of a pixel, so the cells of a grid would
/// hold too many records near the camera, or too few far away.
pub(super) struct RecordTree {
    /// In pre-order.
    nodes: Vec<Node>,
    /// Positions and indices of records, in the order of the leaves.
    records: Vec<(Vec3, usize)>,
}

struct Node {
    bounds: Aabb,
    /// Where its records are among those of the tree.
    records: Range<usize>,
    /// The index of the first node that is not below this one.
    next: usize,
}

impl RecordTree {
    /// A tree of all records; see [`RecordTree::of_some`].
    pub fn new(heads: &[RecordHead]) -> RecordTree {
        RecordTree::of_some(heads, 1)
    }

    /// A tree of every `step`-th record, except those whose position is not finite.
    pub fn of_some(heads: &[RecordHead], step: usize) -> RecordTree {
        let records = heads.iter().enumerate().step_by(step);
        let records = records.map(|(index, head)| (Vec3::from(head.position), index));
        let mut tree = RecordTree { nodes: Vec::new(), records: records.filter(|(p, _)| p.is_finite()).collect() };
        tree.divide(0..tree.records.len());
        tree
    }

    /// Adds the nodes of some records, which it sorts.
    fn divide(&mut self, range: Range<usize>) {
        let records = &mut self.records[range.clone()];
        let bounds = Aabb::of(records.iter().map(|(position, _)| *position));
        let at = self.nodes.len();
        self.nodes.push(Node { bounds, records: range.clone(), next: at + 1 });
        if records.len() > LEAF {
            let axis = (bounds.max - bounds.min).max_position();
            let half = records.len() / 2;
            // By index where positions are equal, so that sums over records are the same from run to run.
            records.select_nth_unstable_by(half, |a, b| a.0[axis].total_cmp(&b.0[axis]).then(a.1.cmp(&b.1)));
            self.divide(range.start..range.start + half);
            self.divide(range.start + half..range.end);
            self.nodes[at].next = self.nodes.len();
        }
    }

    /// Calls `found` with the indices of all records within `reach`, and of some a little farther away.
    pub fn each_near(&self, here: Vec3, reach: f32, mut found: impl FnMut(usize)) {
        // Differences of positions are rounded.
        let reach = reach + 1e-6 * (reach + here.abs().max_element());
        let is_near = |position: Vec3| position.distance_squared(here) <= reach * reach;
        let mut at = 0;
        while let Some(Node { bounds, records, next }) = self.nodes.get(at) {
            let is_leaf = *next == at + 1;
            let nearest = here.max(bounds.min).min(bounds.max);
            if !is_near(nearest) {
                at = *next;
                continue;
            }
            if is_leaf {
                let near = self.records[records.clone()].iter().filter(|(position, _)| is_near(*position));
                near.for_each(|(_, index)| found(*index));
            }
            at += 1;
        }
    }
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
