//! Sums of samples in an order that does not depend on how the image is divided: a binary tree over the numbers of the
//! samples.
//!
//! A node of the tree is a range of samples that begins at a multiple of its length, a power of two. Its sum is that of
//! its halves. A piece holds the sums of the largest nodes in its range, at most two of each length. When pieces are
//! put together, halves become nodes, until only the largest nodes of the whole range are left; these are added from
//! the first to the last. So the additions are the same however the samples are divided.
//!
//! Denoisers compare two halves of the samples. The first one is a node: the first half of the first of the largest
//! nodes. That node's halves are then kept apart, but are added in the same order as without denoisers.

use bytemuck::{Pod, Zeroable};
use kernel_kit::{Buffer, Gpu};
use rayon::prelude::*;

use crate::Result;
use crate::passes::film::Sum;
use crate::passes::{Tile, TileBuffers};
use crate::render::picture::Quantity;
use crate::render::tiles::first_half;
use crate::settings::{Denoise, ImageSettings, SampleRange};

/// The sum of some samples of a pixel: about 48 bits in two words of each of x, y and z.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub(in crate::render) struct Total {
    pub value: [f32; 4],
    /// x, y and z: the rounding errors of the values; w: the number of samples that were left out because they were not
    /// finite.
    pub rest: [f32; 4],
}

impl Total {
    fn of(sample: [f32; 4]) -> Total {
        match sample.iter().all(|x| x.is_finite()) {
            true => Total { value: sample, rest: [0.0; 4] },
            false => Total { value: [0.0; 4], rest: [0.0, 0.0, 0.0, 1.0] },
        }
    }

    pub fn plus(self, other: Total) -> Total {
        let mut sum = Total::default();
        for axis in 0..3 {
            let exact = |total: Total| f64::from(total.value[axis]) + f64::from(total.rest[axis]);
            let both = exact(self) + exact(other);
            let value = both as f32;
            sum.value[axis] = value;
            // Nothing is left of a sum that overflows.
            sum.rest[axis] = if value.is_finite() { (both - f64::from(value)) as f32 } else { 0.0 };
        }
        sum.value[3] = self.value[3] + other.value[3];
        sum.rest[3] = self.rest[3] + other.rest[3];
        sum
    }

    /// The film's sum of `samples` samples.
    pub fn sum(self, samples: u32) -> Sum {
        let exact = [0, 1, 2].map(|axis| f64::from(self.value[axis]) + f64::from(self.rest[axis]));
        let [x, y, z] = exact;
        Sum { total: [x, y, z, f64::from(self.value[3])].into(), kept: f64::from(samples) - f64::from(self.rest[3]) }
    }
}

/// The totals of a node of the tree: for each quantity, one for each pixel.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Node {
    pub range: SampleRange,
    pub quantities: Vec<Vec<Total>>,
}

impl Node {
    fn empty(range: SampleRange, quantities: usize, pixels: usize) -> Node {
        Node { range, quantities: vec![vec![Total::default(); pixels]; quantities] }
    }

    /// Whether the two nodes are the first and second half of one node.
    fn is_first_half_with(&self, second: &Node) -> bool {
        let count = self.range.count();
        self.range.end == second.range.first
            && second.range.count() == count
            && self.range.first.is_multiple_of(2 * count)
    }

    fn add(&mut self, other: &Node) {
        for (own, others) in self.quantities.iter_mut().zip(&other.quantities) {
            own.par_iter_mut().zip(others).for_each(|(own, other)| *own = own.plus(*other));
        }
    }
}

/// The largest nodes in a range, in order. A node that begins at 0 has at most `half` samples, if that is given.
pub(super) fn nodes_of(SampleRange { mut first, end }: SampleRange, half: Option<u32>) -> Vec<SampleRange> {
    let mut nodes = Vec::new();
    while first < end {
        let longest = 1 << (end - first).ilog2();
        let aligned = if first == 0 { half.unwrap_or(longest) } else { 1 << first.trailing_zeros() };
        let count = longest.min(aligned);
        nodes.push(SampleRange { first, end: first + count });
        first += count;
    }
    nodes
}

/// A lower bound of the largest number of nodes that a piece of these samples holds at once. No batch passes a multiple
/// of `batch`. When a batch ends at one, the piece holds the nodes before that, and at least one of the next batch.
pub(in crate::render) fn max_nodes(SampleRange { first, end }: SampleRange, half: Option<u32>, batch: u32) -> u64 {
    let nodes = |end: u32| nodes_of(SampleRange { first, end }, half).len() as u64;
    let ends = (first..end).filter(|end| end.is_multiple_of(batch));
    ends.map(|end| nodes(end) + 1).max().unwrap_or(1)
}

/// Puts a node after others, and joins halves, but not the samples 0 to `half` - 1 with the next ones.
pub(super) fn push(nodes: &mut Vec<Node>, node: Node, half: Option<u32>) {
    nodes.push(node);
    while let [.., first, second] = nodes.as_slice()
        && first.is_first_half_with(second)
        && (first.range.first > 0 || Some(first.range.end) != half)
    {
        let end = second.range.end;
        if let (Some(second), Some(first)) = (nodes.pop(), nodes.last_mut()) {
            first.add(&second);
            first.range.end = end;
        }
    }
}

/// The totals of a quantity over nodes, added from the first to the last; `None` without nodes.
pub(super) fn totals(nodes: &[Node], quantity: usize) -> Option<Vec<Total>> {
    let (first, others) = nodes.split_first()?;
    let mut totals = first.quantities[quantity].clone();
    for node in others {
        totals.par_iter_mut().zip(&node.quantities[quantity]).for_each(|(own, other)| *own = own.plus(*other));
    }
    Some(totals)
}

/// The totals of a quantity over the samples 0 to `half` - 1; `None` if there is no such node.
pub(super) fn first_half_totals(nodes: &[Node], quantity: usize, half: u32) -> Option<Vec<Total>> {
    let first = nodes.first().filter(|node| node.range == SampleRange { first: 0, end: half })?;
    Some(first.quantities[quantity].clone())
}

/// The total of `count` samples from number `first`. `sample` returns a sample by its number.
fn total_of_node(sample: &impl Fn(u32) -> [f32; 4], first: u32, count: u32) -> Total {
    match count {
        1 => Total::of(sample(first)),
        _ => total_of_node(sample, first, count / 2).plus(total_of_node(sample, first + count / 2, count / 2)),
    }
}

/// The sums of a piece under way.
pub(in crate::render) struct PieceSums {
    pub(super) quantities: Vec<Quantity>,
    pub(super) range: SampleRange,
    /// See [`nodes_of`].
    half: Option<u32>,
    pixels: usize,
    pub(super) nodes: Vec<Node>,
    /// The nodes of the batch under way.
    batch: Vec<Node>,
}

impl PieceSums {
    /// No samples yet, of those that the tile's buffers have.
    pub fn new(buffers: &TileBuffers, image: &ImageSettings, range: SampleRange) -> PieceSums {
        let half = half_of(image);
        let has = |quantity: &Quantity| match quantity {
            Quantity::Squares => image.aovs.contains(&crate::settings::Aov::Variance),
            Quantity::DirectSquares => half.is_some(),
            Quantity::IndirectSquares => half.is_some() && buffers.radiance_indirect.is_some(),
            quantity => samples_of(buffers, *quantity).is_some(),
        };
        let quantities = Quantity::ALL.into_iter().filter(has).collect();
        let pixels = image.crop_window().pixels() as usize;
        let range = SampleRange { end: range.first, ..range };
        PieceSums { quantities, range, half, pixels, nodes: Vec::new(), batch: Vec::new() }
    }

    /// Begins a batch of samples of all pixels.
    pub fn begin(&mut self, range: SampleRange) {
        let empty = |range| Node::empty(range, self.quantities.len(), self.pixels);
        self.batch = nodes_of(range, self.half).into_iter().map(empty).collect();
    }

    /// Adds the samples of a tile whose first pixel is number `first_pixel` of the piece. Returns how many were left
    /// out because they are not finite.
    pub fn add(&mut self, gpu: &Gpu, buffers: &TileBuffers, first_pixel: usize, tile: &Tile) -> Result<u64> {
        let read = |quantity: Quantity| -> Result<Vec<[f32; 4]>> {
            match samples_of(buffers, quantity) {
                Some(buffer) => Ok(gpu.read(buffer, tile.point_count as usize)?),
                None => Ok(Vec::new()),
            }
        };
        let mut left_out = 0;
        let mut lights = [Vec::new(), Vec::new()];
        for (index, quantity) in self.quantities.iter().enumerate() {
            let samples = match quantity {
                Quantity::Squares => squares(&lights[0], &lights[1]),
                Quantity::DirectSquares => squares(&lights[0], &[]),
                Quantity::IndirectSquares => squares(&lights[1], &[]),
                quantity => read(*quantity)?,
            };
            if samples_of(buffers, *quantity).is_some() {
                left_out += samples.iter().filter(|sample| !sample.iter().all(|x| x.is_finite())).count() as u64;
            }
            let pixels = tile.pixel_count as usize;
            for node in &mut self.batch {
                let SampleRange { first, .. } = node.range;
                let (first, count) = (first - tile.first_sample, node.range.count());
                node.quantities[index][first_pixel..][..pixels].par_iter_mut().enumerate().for_each(
                    |(pixel, total)| {
                        let of_pixel = &samples[pixel * tile.samples_per_pixel as usize..];
                        *total = total_of_node(&|i| of_pixel[(first + i) as usize], 0, count);
                    },
                );
            }
            match quantity {
                Quantity::Direct => lights[0] = samples,
                Quantity::Indirect => lights[1] = samples,
                _ => {}
            }
        }
        Ok(left_out)
    }

    /// Ends the batch.
    pub fn end(&mut self) {
        for node in std::mem::take(&mut self.batch) {
            self.range.end = node.range.end;
            push(&mut self.nodes, node, self.half);
        }
    }

    /// The sums of a quantity over all samples so far; `None` if it was not requested.
    pub fn totals(&self, quantity: Quantity) -> Option<Vec<Sum>> {
        let index = self.quantities.iter().position(|own| *own == quantity)?;
        let samples = self.range.count();
        let totals = totals(&self.nodes, index).unwrap_or_else(|| vec![Total::default(); self.pixels]);
        Some(totals.into_iter().map(|total| total.sum(samples)).collect())
    }

    /// Bytes of the totals.
    pub fn bytes(&self) -> u64 {
        (self.nodes.len() * self.quantities.len() * self.pixels * size_of::<Total>()) as u64
    }

    /// The totals, as words of a checkpoint.
    pub fn words(&self) -> impl Iterator<Item = u32> {
        let totals = self.nodes.iter().flat_map(|node| &node.quantities);
        totals.flat_map(|totals| bytemuck::cast_slice::<Total, u32>(totals).iter().copied())
    }

    /// Restores the sums after `samples` samples of each pixel from [`PieceSums::words`], and removes these from the
    /// front of `words`; `None` if there are too few words.
    pub fn restored(&self, samples: u32, words: &mut &[u32]) -> Option<PieceSums> {
        let range = SampleRange { end: self.range.first.checked_add(samples)?, ..self.range };
        let mut nodes = Vec::new();
        for range in nodes_of(range, self.half) {
            let mut node = Node { range, quantities: Vec::new() };
            for _ in &self.quantities {
                let (own, others) = words.split_at_checked(self.pixels * size_of::<Total>() / size_of::<u32>())?;
                node.quantities.push(bytemuck::pod_collect_to_vec(own));
                *words = others;
            }
            nodes.push(node);
        }
        let (quantities, half, pixels) = (self.quantities.clone(), self.half, self.pixels);
        Some(PieceSums { quantities, range, half, pixels, nodes, batch: Vec::new() })
    }
}

/// The buffer of a quantity's samples.
fn samples_of(buffers: &TileBuffers, quantity: Quantity) -> Option<&Buffer> {
    match quantity {
        Quantity::Direct => Some(&buffers.radiance_direct),
        Quantity::Indirect => buffers.radiance_indirect.as_ref(),
        Quantity::Squares | Quantity::DirectSquares | Quantity::IndirectSquares => None,
        Quantity::GuideAlbedo => buffers.guides.as_ref().map(|guides| &guides.albedo),
        Quantity::GuideNormal => buffers.guides.as_ref().map(|guides| &guides.normal),
        Quantity::GuidePosition => buffers.guides.as_ref().map(|guides| &guides.position),
        Quantity::Albedo => buffers.albedo_samples.as_ref(),
        Quantity::Normal => buffers.normal_samples.as_ref(),
        Quantity::Position => buffers.position_samples.as_ref(),
    }
}

/// The squares of the sum of two lights. The second may be empty.
fn squares(one: &[[f32; 4]], other: &[[f32; 4]]) -> Vec<[f32; 4]> {
    let square = |i: usize| {
        let more = other.get(i).copied().unwrap_or_default();
        [0, 1, 2, 3].map(|axis| (one[i][axis] + more[axis]) * (one[i][axis] + more[axis]))
    };
    (0..one.len()).into_par_iter().map(square).collect()
}

/// The number of samples in the first half of the image, which denoisers compare with the second; `None` without
/// denoisers.
pub(in crate::render) fn half_of(image: &ImageSettings) -> Option<u32> {
    (image.denoise != Denoise::None && image.spp > 1).then(|| first_half(image.spp))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn random(state: &mut u64) -> u32 {
        // Knuth's MMIX.
        *state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (*state >> 33) as u32
    }

    /// A sample with a wide range of exponents, and now and then one that is not finite.
    fn sample(number: u32) -> [f32; 4] {
        let mut state = u64::from(number) + 1;
        random(&mut state);
        let mut value = || (random(&mut state) as f32) * 2f32.powi((random(&mut state) % 80) as i32 - 60);
        match number % 11 {
            7 => [f32::NAN, 1.0, 1.0, 1.0],
            _ => [value(), -value(), value(), 1.0],
        }
    }

    fn node(range: SampleRange) -> Node {
        let total = total_of_node(&|i| sample(range.first + i), 0, range.count());
        Node { range, quantities: vec![vec![total]] }
    }

    /// As many nodes as there are when batches are added one by one.
    #[test]
    fn the_maximum_of_nodes_is_counted() {
        for SampleRange { first, end } in [[0, 1], [0, 8], [0, 64], [0, 255], [0, 256], [0, 257], [3, 77], [64, 128]]
            .map(|[first, end]| SampleRange { first, end })
        {
            for half in [None, (first == 0 && end > 1).then(|| first_half(end))] {
                let most = |batch: u32| {
                    let (mut nodes, mut most, mut sample) = (Vec::new(), 0, first);
                    while sample < end {
                        let next = end.min(sample + batch - sample % batch);
                        let added = nodes_of(SampleRange { first: sample, end: next }, half);
                        most = most.max(nodes.len() + added.len());
                        added.into_iter().for_each(|range| push(&mut nodes, node(range), half));
                        sample = next;
                    }
                    most as u64
                };
                let range = SampleRange { first, end };
                assert_eq!(max_nodes(range, half, 1), most(1), "{first}..{end}, {half:?}");
                assert!((1..=most(8)).contains(&max_nodes(range, half, 8)), "{first}..{end}, {half:?}");
            }
        }
    }

    /// However the samples 0..n are divided, the totals have the same bits as in one piece.
    #[test]
    fn no_cut_changes_a_sum() {
        let mut state = 5;
        for n in [1, 2, 3, 8, 13, 64, 100, 257] {
            let all = SampleRange { first: 0, end: n };
            let whole: Vec<Node> = nodes_of(all, None).into_iter().map(node).collect();
            let expected = totals(&whole, 0).unwrap()[0];
            let half = (n > 1).then(|| first_half(n));
            for _ in 0..50 {
                let (mut nodes, mut halved) = (Vec::new(), Vec::new());
                let mut first = 0;
                while first < n {
                    let end = (first + 1 + random(&mut state) % n).min(n);
                    let part = SampleRange { first, end };
                    nodes_of(part, None).into_iter().for_each(|range| push(&mut nodes, node(range), None));
                    nodes_of(part, half).into_iter().for_each(|range| push(&mut halved, node(range), half));
                    first = end;
                }
                for (nodes, half) in [(&nodes, None), (&halved, half)] {
                    let ranges: Vec<_> = nodes.iter().map(|node| node.range).collect();
                    assert_eq!(ranges, nodes_of(all, half), "{n}");
                    let got = totals(nodes, 0).unwrap()[0];
                    assert_eq!(bytemuck::bytes_of(&got), bytemuck::bytes_of(&expected), "{n}");
                }
                if let Some(half) = half {
                    let got = first_half_totals(&halved, 0, half).unwrap()[0];
                    let expected = node(SampleRange { first: 0, end: half }).quantities[0][0];
                    assert_eq!(bytemuck::bytes_of(&got), bytemuck::bytes_of(&expected), "the first {half} of {n}");
                }
            }
        }
    }

    /// The sums are those of the finite samples in twice the precision.
    #[test]
    fn sums_are_right() {
        let n = 1000;
        let nodes: Vec<Node> = nodes_of(SampleRange { first: 0, end: n }, None).into_iter().map(node).collect();
        let got = totals(&nodes, 0).unwrap()[0].sum(n);
        let kept = (0..n).map(sample).filter(|sample| sample[0].is_finite());
        for axis in 0..4 {
            let (mut exact, mut size) = (0.0, 0.0);
            for sample in kept.clone() {
                exact += f64::from(sample[axis]);
                size += f64::from(sample[axis]).abs();
            }
            // Ten additions, each with an error of 2^-48 of the sum.
            assert!((got.total[axis] - exact).abs() <= size * 10.0 * 2f64.powi(-48), "{axis}: {got:?}, not {exact}");
        }
        assert_eq!(got.kept, kept.count() as f64);
    }

    /// A sum that overflows is infinite, not NaN.
    #[test]
    fn sums_that_overflow_are_infinite() {
        let largest = Total::of([f32::MAX, 0.0, 0.0, 1.0]);
        let sum = largest.plus(largest).plus(largest);
        assert_eq!((sum.value[0], sum.rest[0]), (f32::INFINITY, 0.0));
    }
}
