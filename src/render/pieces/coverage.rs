//! The samples and pixels that pieces have.

use std::collections::BTreeSet;
use std::fmt;

use crate::settings::{Crop, SampleRange};

/// Samples that no piece has.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MissingSamples {
    /// Their numbers.
    pub samples: SampleRange,
    /// The pixels.
    pub crop: Crop,
}

impl fmt::Display for MissingSamples {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "samples {} of the pixels {}", self.samples, self.crop)
    }
}

/// The samples and the pixels of a piece.
pub(super) type Extent = (SampleRange, Crop);

/// Whether both have samples of the same numbers of some pixel. A piece without pixels or samples has none.
pub(super) fn overlap((a, at): &Extent, (b, there): &Extent) -> bool {
    let both =
        |first: u32, length: u32, second: u32, other: u32| first.max(second) < (first + length).min(second + other);
    both(at.x, at.width, there.x, there.width)
        && both(at.y, at.height, there.y, there.height)
        && both(a.first, a.count(), b.first, b.count())
}

/// The image cut along all edges of pieces, such that each piece has all pixels of a cell or none.
pub(super) struct Cells {
    columns: Vec<u32>,
    rows: Vec<u32>,
}

impl Cells {
    pub fn new([width, height]: [u32; 2], pieces: &[Extent]) -> Cells {
        let edges = |whole: u32, span: &dyn Fn(&Crop) -> [u32; 2]| -> Vec<u32> {
            let of_pieces = pieces.iter().flat_map(|(_, crop)| span(crop));
            of_pieces.chain([0, whole]).collect::<BTreeSet<u32>>().into_iter().collect()
        };
        Cells {
            columns: edges(width, &|crop| [crop.x, crop.x + crop.width]),
            rows: edges(height, &|crop| [crop.y, crop.y + crop.height]),
        }
    }

    /// The cells, row by row.
    pub fn all(&self) -> Vec<Crop> {
        let spans = |edges: &[u32]| edges.windows(2).map(|span| [span[0], span[1] - span[0]]).collect::<Vec<_>>();
        let columns = spans(&self.columns);
        let row = |[y, height]: [u32; 2]| {
            columns.iter().map(move |[x, width]| Crop { x: *x, y, width: *width, height }).collect::<Vec<_>>()
        };
        spans(&self.rows).into_iter().flat_map(row).collect()
    }
}

pub(super) fn is_within(cell: &Crop, crop: &Crop) -> bool {
    let within = |at: u32, first: u32, length: u32| (first..first + length).contains(&at);
    within(cell.x, crop.x, crop.width) && within(cell.y, crop.y, crop.height)
}

/// The samples of an image that pieces without overlap lack.
pub(super) fn missing(size: [u32; 2], samples: u32, pieces: &[Extent]) -> Vec<MissingSamples> {
    let mut missing: Vec<MissingSamples> = Vec::new();
    for cell in Cells::new(size, pieces).all() {
        let covering = pieces.iter().filter(|(_, crop)| is_within(&cell, crop));
        let mut ranges: Vec<SampleRange> = covering.map(|(range, _)| *range).collect();
        ranges.sort_by_key(|range| range.first);
        let mut next = 0;
        for range in ranges.into_iter().chain([SampleRange { first: samples, end: samples }]) {
            if range.first > next {
                note(&mut missing, SampleRange { first: next, end: range.first }, cell);
            }
            next = next.max(range.end);
        }
    }
    // Joins parts that lie below each other, have the same columns and lack the same samples.
    let mut joined: Vec<MissingSamples> = Vec::new();
    for part in missing {
        let above = joined.iter_mut().find(|other| {
            let (a, b) = (&other.crop, &part.crop);
            other.samples == part.samples && (a.x, a.width) == (b.x, b.width) && a.y + a.height == b.y
        });
        match above {
            Some(above) => above.crop.height += part.crop.height,
            None => joined.push(part),
        }
    }
    joined
}

/// Adds a cell. If the cell to its left lacks the same samples, the two are joined.
fn note(missing: &mut Vec<MissingSamples>, samples: SampleRange, cell: Crop) {
    let left = missing.iter_mut().rev().find(|other| {
        let crop = &other.crop;
        other.samples == samples && (crop.y, crop.height) == (cell.y, cell.height) && crop.x + crop.width == cell.x
    });
    match left {
        Some(left) => left.crop.width += cell.width,
        None => missing.push(MissingSamples { samples, crop: cell }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn extent(first: u32, end: u32, [x, y, width, height]: [u32; 4]) -> Extent {
        (SampleRange { first, end }, Crop { x, y, width, height })
    }

    #[test]
    fn what_is_missing_is_named_in_few_parts() {
        let pieces = [extent(0, 4, [0, 0, 8, 6]), extent(4, 8, [0, 0, 8, 2]), extent(4, 8, [5, 2, 3, 4])];
        let expected = MissingSamples {
            samples: SampleRange { first: 4, end: 8 },
            crop: Crop { x: 0, y: 2, width: 5, height: 4 },
        };
        assert_eq!(missing([8, 6], 8, &pieces), [expected]);
        assert_eq!(expected.to_string(), "samples 4..8 of the pixels 0,2,5,4");
        assert_eq!(missing([8, 6], 4, &pieces[..1]), []);
        let all = MissingSamples {
            samples: SampleRange { first: 0, end: 3 },
            crop: Crop { x: 0, y: 0, width: 8, height: 6 },
        };
        assert_eq!(missing([8, 6], 3, &[]), [all]);
    }

    #[test]
    fn pieces_overlap_that_share_a_sample_of_a_pixel() {
        let piece = extent(2, 5, [4, 4, 4, 4]);
        for (other, expected) in [
            (extent(4, 6, [7, 7, 9, 9]), true),
            (extent(5, 6, [4, 4, 4, 4]), false),
            (extent(2, 5, [8, 4, 4, 4]), false),
            (extent(0, 9, [0, 0, 4, 9]), false),
            (extent(0, 3, [0, 0, 5, 5]), true),
            (extent(2, 5, [5, 4, 0, 4]), false),
            (extent(2, 5, [4, 6, 4, 0]), false),
            (extent(3, 3, [4, 4, 4, 4]), false),
        ] {
            assert_eq!(overlap(&piece, &other), expected, "{other:?}");
            assert_eq!(overlap(&other, &piece), expected, "{other:?}");
        }
    }
}
