//! How far a record's gradients hold. They account for how the surfaces that the record sees move past each other, but
//! not for light behind glass or in mirrors, nor for gradients that change. So each record is compared with those
//! around it: where they differ by more than noise from what its gradients predict, its radius shrinks, and points get
//! records of their own. Gather rays reduce the noise, so more rays bring more and smaller records, and interpolation
//! leaves no error in a long render.

use rayon::prelude::*;

use super::noisy_records::{Member, NoisyRecords};
use super::record_tree::RecordTree;

/// Squared error at a record's radius that is allowed, over the variance of its irradiance. First-order gradients err
/// in proportion to the square of the distance. The mean of its fourth power over a disc, by the weights of a record's
/// points, is a seventh: so within the radius the error is as large as the noise.
const ALLOWED: f64 = 7.0;

/// Relative error at the radius that is always allowed: far below what an image shows, and far above rounding.
const ALWAYS_ALLOWED: f64 = 1e-3;

/// A radius is at most halved at a time, because no record has shown yet what lies nearer.
const MIN_SHARE: f64 = 0.5;

/// How far gradients are off, from pairs of records.
#[derive(Clone, Copy, Default)]
struct Residual {
    /// Sums of squared differences that noise does not explain, and of fourth powers of distances over the radius.
    excess: f64,
    powers: f64,
    /// Sums of the error that is allowed, and the number of pairs.
    allowed: f64,
    pairs: f64,
}

impl NoisyRecords<'_> {
    /// The radius at which the error of each record's gradients is as large as allowed; infinite if that is beyond its
    /// present radius, or if no record shows it.
    pub fn limits(&self) -> Vec<f32> {
        let tree = RecordTree::new(self.heads);
        let indices = || (0..self.heads.len()).into_par_iter();
        let members: Vec<Vec<Member>> = indices().map(|i| self.members(&tree, i, self.radii[i])).collect();
        let residuals: Vec<Residual> = indices().map(|i| self.residual(i, &members[i])).collect();
        // Members are pooled, because few pairs estimate the error badly: the noise of their differences exceeds the
        // allowed error.
        let limit = |i: usize| {
            let Residual { excess, powers, allowed, pairs } =
                members[i].iter().fold(Residual::default(), |sum, member| sum.plus(residuals[member.index]));
            let (error, allowed) = (excess / powers, allowed / pairs);
            // Without a pair neither is a number.
            if error > allowed {
                self.radii[i] * (allowed / error).sqrt().sqrt().max(MIN_SHARE) as f32
            } else {
                f32::INFINITY
            }
        };
        indices().map(limit).collect()
    }

    /// How far the gradients of a record are off at the members around it.
    fn residual(&self, i: usize, members: &[Member]) -> Residual {
        let others = members.iter().filter(|member| member.index != i);
        others.fold(Residual::default(), |sum, member| {
            let noise = f64::from(self.variances[i]) + f64::from(self.variances[member.index]);
            let irradiance = self.irradiance(member.index);
            let extrapolated = self.irradiance(i) + self.change(self.values_of(i), i, member.index);
            sum.plus(Residual {
                excess: extrapolated.distance_squared(irradiance) - noise,
                powers: (1.0 - member.weight).powi(4),
                allowed: ALLOWED * 0.5 * noise + ALWAYS_ALLOWED.powi(2) * irradiance.length_squared(),
                pairs: 1.0,
            })
        })
    }
}

impl Residual {
    fn plus(self, other: Residual) -> Residual {
        Residual {
            excess: self.excess + other.excess,
            powers: self.powers + other.powers,
            allowed: self.allowed + other.allowed,
            pairs: self.pairs + other.pairs,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::noisy_records::plane::{PITCH, Plane, RADIUS, SIDE, noise};
    use super::*;
    use crate::passes::gather::RecordHead;

    /// The record in the middle.
    const MIDDLE: usize = SIDE / 2 * SIDE + SIDE / 2;

    /// Records with irradiance and slope by the number of columns from the middle, and noise of a variance.
    fn records(light: impl Fn(f32) -> f32, slope: impl Fn(f32) -> f32, variance: f32) -> Plane {
        let from_middle = |column: usize| column as f32 - (SIDE / 2) as f32;
        // All channels have the same noise, and the variance is their sum.
        let noise = |i: usize| noise(i, (variance / 3.0).sqrt());
        let mut plane = Plane::new(|column, row| [light(from_middle(column)) + noise(row * SIDE + column), variance]);
        for (i, texel) in plane.values.chunks_mut(4).enumerate() {
            texel[0] = slope(from_middle(i / 3 % SIDE)) / PITCH;
        }
        plane
    }

    /// A parabola differs from its tangent by its coefficient times the squared distance along the columns: a squared
    /// error in proportion to the fourth power of the distance.
    #[test]
    fn radii_shrink_to_where_curved_light_is_known() {
        let curvature = 0.002;
        let plane = |variance| {
            records(|x| 1.0 + curvature * x * x, |x| 2.0 * curvature * x, variance).records().limits()[MIDDLE]
        };
        // At the radius, of 5 columns: of three channels, and 3/8 is the mean of the fourth power of a cosine.
        let error = 3.0 * (curvature * 25.0).powi(2) * 3.0 / 8.0;
        for share in [0.6f32, 0.75, 0.9] {
            // The error that is always allowed is less than 1 % of this.
            let limit = plane(error * share.powi(4) / ALLOWED as f32);
            // A disc of 69 records is no circle, and their thousands of pairs leave some noise: 10 % of the error are
            // 2.5 % of the radius.
            assert!((limit / (share * RADIUS) - 1.0).abs() < 0.025, "{limit} of {RADIUS}, not {share} of it");
        }
        assert_eq!(plane(2.0 * error / ALLOWED as f32), f32::INFINITY);
        assert_eq!(plane(1e-9), RADIUS * MIN_SHARE as f32);
    }

    /// Light that follows its slope limits no radius, with noise or without: rounding is no error. With a slope of 0 it
    /// limits every record, unless the noise hides it.
    #[test]
    fn straight_light_limits_nothing() {
        for variance in [0.0, 1e-4, 1e-2] {
            let unlimited = |slope: f32| {
                let limits = records(|x| 1.0 + 0.02 * x, |_| slope, variance).records().limits();
                limits.iter().filter(|limit| limit.is_infinite()).count()
            };
            let all = SIDE * SIDE;
            // The pairs of a record and of those around it leave less noise than the error that is allowed.
            assert!(unlimited(0.02) >= all * 99 / 100, "{} of {all} with a variance of {variance}", unlimited(0.02));
            assert!(variance > 1e-4 || unlimited(0.0) == 0, "{} without a slope", unlimited(0.0));
        }
    }

    /// At an edge, radii shrink to a half at once. Away from it, beyond the records that find others across the edge
    /// and their neighbours, nothing changes.
    #[test]
    fn edges_limit_those_that_see_them() {
        let limits = records(|x| if x < 0.0 { 1.0 } else { 2.0 }, |_| 0.0, 1e-4).records().limits();
        let row = &limits[SIDE / 2 * SIDE..][..SIDE];
        assert!(row[SIDE / 2 - 4..SIDE / 2 + 4].iter().all(|limit| *limit == RADIUS * MIN_SHARE as f32), "{row:?}");
        let (left, right) = (&row[..SIDE / 2 - 10], &row[SIDE / 2 + 10..]);
        assert!(left.iter().chain(right).all(|limit| limit.is_infinite()), "{row:?}");
    }

    /// Turned normals follow the rotational gradient.
    #[test]
    fn turned_normals_follow_their_gradient() {
        let of = |gradient: f32| {
            let head =
                |x: f32, normal: [f32; 3]| RecordHead { position: [x, 0.0, 0.0], size: 0.01, normal, distance: 1.0 };
            let (sine, cosine) = 0.1f32.sin_cos();
            let heads = [head(0.0, [0.0, 0.0, 1.0]), head(0.05, [sine, 0.0, cosine])];
            let values = |irradiance: f32| {
                let translation = [0.0, 0.0, 0.0, irradiance].repeat(3);
                [translation, [0.0, gradient, 0.0, 0.0].repeat(3)].concat()
            };
            // Normal z turns to x about y.
            let values = [values(1.0), values(1.0 + 0.5 * sine)].concat();
            let known = NoisyRecords { heads: &heads, radii: &[0.1; 2], variances: &[1e-6; 2], values: &values };
            known.limits()[0]
        };
        assert_eq!(of(0.5), f32::INFINITY);
        assert!(of(-0.5).is_finite() && of(0.0).is_finite());
    }

    #[test]
    fn invalid_records_take_no_part() {
        let mut plane = records(|_| 1.0, |_| 0.0, 0.0);
        for (i, light) in [(0, f32::NAN), (SIDE * 7 + 7, f32::INFINITY), (MIDDLE, 1e30)] {
            plane.values[12 * i + 7] = light;
            if light == 1e30 { plane.variances[i] = f32::INFINITY } else { plane.heads[i].size = 0.0 }
        }
        assert!(plane.records().limits().iter().all(|limit| *limit == f32::INFINITY));
        // Records at one position show nothing about gradients if noise explains their difference.
        let mut plane = Plane::new(|_, _| [1.0, 1e-4]);
        plane.heads.iter_mut().for_each(|head| head.position = [0.0; 3]);
        assert!(plane.records().limits().iter().all(|limit| *limit == f32::INFINITY));
        let none = NoisyRecords { heads: &[], radii: &[], variances: &[], values: &[] };
        assert!(none.limits().is_empty());
    }
}
