//! Irradiance filtering (Kontkanen, Räsänen and Keller 2004): a record is averaged with nearby records that differ from
//! it by no more than noise. All samples of a pixel share the noise of its records, so more samples do not remove it,
//! and denoisers of the image cannot see it.

use glam::{DVec3, DVec4, Vec4Swizzles};
use rayon::prelude::*;

use super::noisy_records::{Member, NoisyRecords, irradiance_of, set_irradiance};
use super::record_tree::{RecordTree, weight};
use crate::passes::gather::RecordHead;

/// How far a record finds others, in radii and in pixels. Less leaves more noise, and more blurs light that changes
/// unevenly (docs/decisions.md, "Filtered records").
const REACH_RADII: f32 = 4.0;
const REACH_PIXELS: f32 = 44.0;

/// How far, in pixels, a record finds others to share outliers with, and among how many records of the view: a wide
/// mean needs few of them (docs/decisions.md, "Filtered records").
const OUTLIER_REACH_PIXELS: f32 = 96.0;
const OUTLIER_RECORDS: usize = 768;

/// Outliers are spread in part above the first of these numbers, and fully above the second. They are compared with a
/// measure of how unequal the variances of records are: the mean variance over the square of the mean standard
/// deviation. It is 1 if all are equal, and n if one record in n has all of the noise. If the rays of all records find
/// the same light it is 1.05 to 1.4 (`scenes/box.glb`), and there wide means blur slopes: up to 1.6 times the error. If
/// few rays find most of the light it is 1.5 to 6 (`scenes/door.glb`).
const OUTLIERS: [f64; 2] = [1.5, 2.25];

/// The same two limits for the variance over the squared irradiance. Below the first, wide means would lose more by
/// blurred slopes than the noise that they remove: `scenes/uplight.glb` with 16 samples had 1.2 times the error.
const NOISE: [f64; 2] = [0.01, 0.03];

/// Squared half-width of the confidence intervals that must overlap, over the variance (docs/experiments.md, "Filtered
/// records").
const INTERVAL: f64 = 1.0;

/// The estimated irradiance of a record or of a mean, and its variance.
#[derive(Clone, Copy)]
struct Known {
    irradiance: DVec3,
    variance: f64,
}

impl NoisyRecords<'_> {
    /// The values, filtered.
    pub fn filtered(&self) -> Vec<f32> {
        let reach = |i: usize| (REACH_RADII * self.radii[i]).min(REACH_PIXELS * self.heads[i].size);
        let tree = RecordTree::new(self.heads);
        let indices = || (0..self.heads.len()).into_par_iter();
        let members: Vec<Vec<Member>> = indices().map(|i| self.members(&tree, i, reach(i))).collect();
        // The variance of one record, from few rays, is a poor estimate, and 0 if the rays missed a small bright
        // surface: it is averaged with its neighbours'.
        let variance = |i: usize| mean(&members[i], |member| f64::from(self.variances[member.index]));
        let of_record = |i: usize| Known { irradiance: self.irradiance(i), variance: variance(i) };
        let known: Vec<Known> = indices().map(of_record).collect();
        // Means of near records are compared, not the records themselves: a record resembles most those that err in the
        // same direction.
        let (means, guides): (Vec<LocalMean>, Vec<Known>) = indices()
            .map(|i| {
                let nearest = nearest(&members[i]);
                let mean = self.local_mean(i, &nearest);
                let variance = variance_of_mean(&nearest, |index| known[index].variance);
                let guide = Known { irradiance: irradiance_of(&mean.values), variance };
                (mean, guide)
            })
            .unzip();
        let resembling = |i: usize| {
            let change = |other: usize| means[i].share * self.change(&means[i].values, i, other);
            resembling(&members[i], &guides, i, change, own_or_less)
        };
        let members: Vec<Vec<Member>> = indices().map(resembling).collect();
        let values: Vec<f32> = indices().flat_map_iter(|i| self.local_mean(i, &members[i]).values).collect();
        let variance = |i: usize| variance_of_mean(&members[i], |index| self.variances[index].into()) as f32;
        let variances: Vec<f32> = indices().map(variance).collect();
        NoisyRecords { variances: &variances, values: &values, ..*self }.with_outliers_spread()
    }

    /// The values of filtered records, with the light of rare bright rays spread much farther than other noise. Around
    /// a record that had one, the mean is a bright disc as wide as the reach, and it is too dark everywhere else.
    fn with_outliers_spread(&self) -> Vec<f32> {
        let reach = |i: usize| OUTLIER_REACH_PIXELS * self.heads[i].size;
        let tree = RecordTree::of_some(self.heads, self.heads.len().div_ceil(OUTLIER_RECORDS).max(1));
        let known_of = |i: usize| Known { irradiance: self.irradiance(i), variance: self.variances[i].into() };
        let known: Vec<Known> = (0..self.heads.len()).map(known_of).collect();
        // Computed once, because each record is a neighbour of hundreds of others.
        let measures_of =
            |known: &Known| DVec4::new(1.0, known.variance, known.variance.sqrt(), known.irradiance.length());
        let measures: Vec<DVec4> = known.iter().map(measures_of).collect();
        let spread = |i: usize| {
            let members = self.members(&tree, i, reach(i));
            let sums: DVec4 = members.iter().map(|member| member.weight * measures[member.index]).sum();
            let [variance, deviation, light] = (sums.yzw() / sums.x).to_array();
            let share = share_of(variance / deviation.powi(2), OUTLIERS) * share_of(variance / light.powi(2), NOISE);
            // Not a number where there is no noise, or no member.
            if share.is_nan() || share == 0.0 {
                return self.values_of(i).to_vec();
            }
            // Both variances explain a difference, so that records without an outlier receive light of those with one:
            // otherwise it would be lost.
            // Slopes are left out, because an outlier has the gradient of its bright ray: it would lose its light.
            let resembling = resembling(&members, &known, i, |_| DVec3::ZERO, |own, other| own + other);
            let wide = self.mean_values(i, &resembling);
            self.values_of(i).iter().zip(wide).map(|(near, wide)| near + share as f32 * (wide - near)).collect()
        };
        (0..self.heads.len()).into_par_iter().flat_map_iter(spread).collect()
    }

    /// The mean of the members' values; the record's own values if it has no members.
    fn mean_values(&self, i: usize, members: &[Member]) -> Vec<f32> {
        if members.is_empty() {
            return self.values_of(i).to_vec();
        }
        let (mut sums, mut irradiance, mut weights) = (vec![0.0; self.count()], DVec3::ZERO, [0.0; 2]);
        for Member { index, weight } in members {
            let of_gradients = weight * self.share_of_gradients(*index, i);
            sums.iter_mut()
                .zip(self.values_of(*index))
                .for_each(|(sum, value)| *sum += of_gradients * f64::from(*value));
            irradiance += *weight * self.irradiance(*index);
            weights = [weights[0] + of_gradients, weights[1] + weight];
        }
        let mut values: Vec<f32> = sums.iter().map(|sum| (sum / weights[0]) as f32).collect();
        set_irradiance(&mut values, irradiance / weights[1]);
        values
    }

    /// The mean of the members at the place of record `i`. On a slope that is not the mean of their irradiance: at an
    /// edge all members are on one side.
    fn local_mean(&self, i: usize, members: &[Member]) -> LocalMean {
        let mut values = self.mean_values(i, members);
        let Slope { mean_change, share } = self.slope(i, members, &values);
        let irradiance = irradiance_of(&values) - share * mean_change;
        set_irradiance(&mut values, irradiance);
        LocalMean { values, share }
    }

    /// The share with which gradients of record `of` count at another one. Near an edge they are steep, and change
    /// within a pixel, so they count only as far as that record finds others itself.
    fn share_of_gradients(&self, of: usize, at: usize) -> f64 {
        let reach = RecordHead { size: REACH_RADII * self.radii[of], ..self.heads[of] };
        weight(&reach, &self.heads[at]).into()
    }

    /// By how much the irradiance of the members changes around record `i` as the gradients of `values` predict. The
    /// share is the slope of a straight line through the members' irradiance over the prediction.
    fn slope(&self, i: usize, members: &[Member], values: &[f32]) -> Slope {
        let (mut weights, mut change, mut irradiance, mut square, mut product) =
            (0.0, DVec3::ZERO, DVec3::ZERO, 0.0, 0.0);
        for Member { index, weight } in members {
            let [expected, found] = [self.change(values, i, *index), self.irradiance(*index)];
            weights += weight;
            change += *weight * expected;
            irradiance += *weight * found;
            square += weight * expected.length_squared();
            product += weight * expected.dot(found);
        }
        let mean_change = change / weights;
        let share = (product - mean_change.dot(irradiance)) / (square - mean_change.dot(change));
        // Without gradients, or without other members, there is no line.
        if share.is_finite() {
            Slope { mean_change, share: share.clamp(0.0, 1.0) }
        } else {
            Slope { mean_change: DVec3::ZERO, share: 0.0 }
        }
    }
}

/// The mean of records at the place of one of them.
struct LocalMean {
    /// As those of a record.
    values: Vec<f32>,
    /// The share of the change by the mean gradients that the records' irradiance confirms.
    share: f64,
}

/// How irradiance changes around a record.
struct Slope {
    /// The mean change to the members, as the gradients predict it.
    mean_change: DVec3,
    /// The share of it that the members' irradiance confirms.
    share: f64,
}

/// The members within half of the reach, where their weight falls to 0.
fn nearest(members: &[Member]) -> Vec<Member> {
    let nearer = |member: &Member| Member { weight: member.weight - 0.5, ..*member };
    members.iter().map(nearer).filter(|member| member.weight > 0.0).collect()
}

/// Weighs the members by how well noise explains the difference of their guide from that of record `i` plus the
/// `change` to the member. `explained` is the squared difference that two variances explain.
fn resembling(
    members: &[Member],
    guides: &[Known],
    i: usize,
    change: impl Fn(usize) -> DVec3,
    explained: impl Fn(f64, f64) -> f64,
) -> Vec<Member> {
    let resembles = |index: usize| {
        let (a, b) = (guides[i].variance, guides[index].variance);
        let expected = guides[i].irradiance + change(index);
        let excess = expected.distance_squared(guides[index].irradiance) - explained(a, b);
        if excess > 0.0 { (-excess / (INTERVAL * (a + b))).exp() } else { 1.0 }
    };
    let weighed = |member: &Member| Member { weight: member.weight * resembles(member.index), ..*member };
    members.iter().map(weighed).collect()
}

/// The variance that explains a difference of two records; the other record's counts at most as much as this one's own
/// (Rousselle, Knaus and Zwicker 2012).
fn own_or_less(own: f64, other: f64) -> f64 {
    own + own.min(other)
}

/// The variance of the mean of members whose noise is independent.
fn variance_of_mean(members: &[Member], variance: impl Fn(usize) -> f64) -> f64 {
    let weights: f64 = members.iter().map(|member| member.weight).sum();
    mean(members, |member| member.weight * variance(member.index)) / weights
}

/// Where a value lies in a range: 0 below it, 1 above it.
fn share_of(value: f64, [from, to]: [f64; 2]) -> f64 {
    ((value - from) / (to - from)).clamp(0.0, 1.0)
}

fn mean(members: &[Member], value: impl Fn(&Member) -> f64) -> f64 {
    let weights: f64 = members.iter().map(|member| member.weight).sum();
    members.iter().map(|member| member.weight * value(member)).sum::<f64>() / weights
}

#[cfg(test)]
mod tests {
    use super::super::noisy_records::plane::{PITCH, Plane, SIDE, noise, uniform};
    use super::*;

    /// As [`Plane::new`], with radii of which the reach is 15 records.
    fn plane_of(record: impl Fn(usize, usize) -> [f32; 2]) -> Plane {
        let mut plane = Plane::new(record);
        plane.radii.fill(15.0 / REACH_RADII * PITCH);
        plane
    }

    /// The irradiance of each record, filtered.
    fn light_of(plane: &Plane) -> Vec<f32> {
        let filtered = plane.records().filtered();
        assert_eq!(filtered.len(), plane.values.len());
        // Gradients stay as they are where all are equal.
        assert!(filtered.chunks(4).all(|texel| texel[..3] == plane.values[..3]));
        filtered.chunks(12).map(|record| record[7]).collect()
    }

    fn mean_and_variance(values: &[f32]) -> [f64; 2] {
        let count = values.len() as f64;
        let mean = values.iter().map(|x| f64::from(*x)).sum::<f64>() / count;
        [mean, values.iter().map(|x| (f64::from(*x) - mean).powi(2)).sum::<f64>() / count]
    }

    /// The mean of a plane of equal light does not change. If all records were members with weights that fall linearly
    /// to 0 at a radius of fifteen records, the variance would fall to 3 / (2 pi 15^2), 1 in 471.
    #[test]
    fn noise_is_averaged() {
        let plane = plane_of(|column, row| [2.0 + noise(row * SIDE + column, 0.1), 0.03]);
        let before: Vec<f32> = plane.values.chunks(12).map(|record| record[3]).collect();
        let ([mean, variance], [filtered_mean, left]) =
            (mean_and_variance(&before), mean_and_variance(&light_of(&plane)));
        assert!((variance / 0.01 - 1.0).abs() < 0.1, "the test's own noise: {variance}");
        // 0.1 over the root of the 1,600 records is the error of the mean.
        assert!((filtered_mean - mean).abs() < 0.0025, "{mean} became {filtered_mean}");
        // Records at the rim have fewer neighbours, and differences that noise seems not to explain exclude some.
        assert!(left > variance / 500.0 && left < variance / 50.0, "{variance} became {left}");
    }

    /// At the end of a slope all neighbours are on one side, but the mean at the end is not theirs, because gradients
    /// know the slope. It is theirs if there are no gradients, or if they point the other way.
    #[test]
    fn slopes_are_followed_where_gradients_know_them() {
        let slope = |column: usize| 1.0 + 0.05 * column as f32;
        let found = |gradient: f32| {
            let mut plane = plane_of(|column, row| [slope(column) + noise(row * SIDE + column, 0.1), 300.0]);
            plane.values.chunks_mut(4).for_each(|texel| texel[0] = gradient / PITCH);
            let filtered = light_of(&plane);
            // The mean over a part of the first column far from its ends.
            (SIDE / 4..3 * SIDE / 4).map(|row| filtered[row * SIDE]).sum::<f32>() / (SIDE / 2) as f32
        };
        // The noise of a mean of some 150 records.
        assert!((found(0.05) - slope(0)).abs() < 0.05, "{}", found(0.05));
        let none = found(0.0);
        // A third of the reach is 5 columns.
        assert!(none > slope(3), "without gradients {none}");
        assert!((found(-0.05) - none).abs() < 0.02, "{} with wrong gradients, and {none} without", found(-0.05));
        // Twice the true gradient: the records show that half of it holds.
        assert!((found(0.1) - slope(0)).abs() < 0.05, "{}", found(0.1));
    }

    /// Steep gradients of small records at an edge do not reach records that have the same light by chance.
    #[test]
    fn steep_gradients_stay_near() {
        let mut plane = plane_of(|_, _| [1.0, 0.03]);
        let is_edge = |i: usize| i % SIDE < 2;
        for i in (0..SIDE * SIDE).filter(|i| is_edge(*i)) {
            plane.radii[i] = PITCH;
            plane.values[12 * i..][..12].chunks_mut(4).for_each(|texel| texel[0] = 100.0);
        }
        let filtered = plane.records().filtered();
        let gradient = |column: usize| filtered[12 * (SIDE / 2 * SIDE + column)];
        // They count up to REACH_RADII columns away.
        assert!(gradient(0) > 50.0 && gradient(3) > 1.0, "{} and {}", gradient(0), gradient(3));
        assert!((6..SIDE).all(|column| gradient(column) == 0.0), "{}", gradient(6));
    }

    /// Records without noise keep their bits, whatever their light.
    #[test]
    fn records_without_noise_stay_as_they_are() {
        let plane = plane_of(|column, row| [uniform(row * SIDE + column), 0.0]);
        let before: Vec<f32> = plane.values.chunks(12).map(|record| record[3]).collect();
        assert_eq!(light_of(&plane), before);
    }

    /// Light on both sides of an edge that noise does not explain stays on its side; a difference of the order of the
    /// noise does not.
    #[test]
    fn edges_stay() {
        let step = |height: f32| plane_of(move |column, _| [if column < SIDE / 2 { 1.0 } else { 1.0 + height }, 3e-4]);
        let at = |filtered: &[f32], column: usize| filtered[SIDE / 2 * SIDE + column];
        let filtered = light_of(&step(0.5));
        assert!((at(&filtered, SIDE / 2 - 1) - 1.0).abs() < 1e-4 && (at(&filtered, SIDE / 2) - 1.5).abs() < 1e-4);
        let filtered = light_of(&step(0.01));
        assert!(at(&filtered, SIDE / 2 - 1) > 1.003, "the filter does nothing");
    }

    /// Other surfaces take no part: neither those that face elsewhere, nor those a little above or below.
    #[test]
    fn surfaces_do_not_mix() {
        let is_even = |column: usize, row: usize| (column + row).is_multiple_of(2);
        let board = || plane_of(|column, row| [if is_even(column, row) { 1.0 } else { 2.0 }, 3.0]);
        assert!(light_of(&board()).iter().all(|x| (x - 1.5).abs() < 0.1), "the test proves nothing");
        for above in [false, true] {
            let mut plane = board();
            let odd = |(i, _): &(usize, &mut RecordHead)| !is_even(i % SIDE, i / SIDE);
            for (_, head) in plane.heads.iter_mut().enumerate().filter(odd) {
                if above {
                    // Offsets count ten times.
                    head.position[2] = 0.03;
                } else {
                    head.normal = [0.5f32.sqrt(), 0.0, 0.5f32.sqrt()];
                }
            }
            for (i, irradiance) in light_of(&plane).iter().enumerate() {
                let own = if is_even(i % SIDE, i / SIDE) { 1.0 } else { 2.0 };
                assert!((irradiance - own).abs() < 1e-5, "record {i}: {irradiance}");
            }
        }
    }

    /// A record with a ray that met something bright keeps at most a thirtieth of its light. Records around it get part
    /// of the rest; without it they would all be too dark. Part is lost, because records farther away take it for the
    /// light of another surface.
    #[test]
    fn the_light_of_a_firefly_is_spread() {
        let middle = SIDE / 2;
        let bright = |column, row| (column, row) == (middle, middle);
        let plane = plane_of(|column, row| if bright(column, row) { [101.0, 3e4] } else { [1.0, 3e-2] });
        let filtered = light_of(&plane);
        let more: f32 = filtered.iter().map(|irradiance| irradiance - 1.0).sum();
        assert!(more > 33.0 && more < 101.0, "{more} of 100");
        let brightest = filtered.iter().copied().fold(0.0, f32::max);
        assert!(brightest < 1.0 + 100.0 / 30.0, "{brightest}");
    }

    /// Two such records leave no bright disc: their light is spread far beyond the reach of other noise. Where all
    /// records are equally noisy, however much, only near ones are averaged.
    #[test]
    fn the_light_of_outliers_goes_far() {
        let place = |column, row| row == SIDE / 2 && (column == SIDE / 4 || column == 3 * SIDE / 4);
        let plane = plane_of(|column, row| if place(column, row) { [101.0, 3e4] } else { [1.0, 3e-2] });
        let filtered = light_of(&plane);
        let [mean, _] = mean_and_variance(&filtered);
        let brightest = filtered.iter().copied().fold(0.0, f32::max);
        // Both bring a mean of 0.125. A disc of the near reach alone has a mean of 0.28, and three times that inside.
        assert!(mean > 1.03 && mean < 1.125 && brightest < 1.28, "mean {mean}, brightest {brightest}");
        let slope = |column: usize| 1.0 + 0.05 * column as f32;
        let at = |filtered: &[f32], column: usize| filtered[SIDE / 2 * SIDE + column];
        let even = light_of(&plane_of(|column, _| [slope(column), 300.0]));
        // Means of the ends of a slope are off by a third of the reach: 5 columns of 15.
        assert!((at(&even, 0) - slope(5)).abs() < 0.1, "{} at the end, not {}", at(&even, 0), slope(5));
    }

    /// Records that are not finite, and those whose noise is unknown, stay as they are, and no other takes their light.
    #[test]
    fn invalid_records_take_no_part() {
        let mut plane = plane_of(|_, _| [1.0, 3.0]);
        for (i, light) in [(0, f32::NAN), (SIDE * 7 + 7, f32::INFINITY), (SIDE * 20 + 20, 1e30)] {
            plane.values[12 * i + 7] = light;
            if light == 1e30 { plane.variances[i] = f32::INFINITY } else { plane.heads[i].size = 0.0 }
        }
        let filtered = light_of(&plane);
        for (i, irradiance) in filtered.iter().enumerate() {
            match i {
                0 => assert!(irradiance.is_nan()),
                287 => assert_eq!(*irradiance, f32::INFINITY),
                820 => assert_eq!(*irradiance, 1e30),
                _ => assert!((irradiance - 1.0).abs() < 1e-6, "record {i}: {irradiance}"),
            }
        }
        let none = NoisyRecords { heads: &[], radii: &[], variances: &[], values: &[] };
        assert!(none.filtered().is_empty());
    }
}
