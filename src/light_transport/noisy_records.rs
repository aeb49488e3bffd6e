//! Irradiance records with their noise, and which of them are on one surface near each other.

use glam::{DVec3, Vec3};

use super::record_tree::{RecordTree, weight};
use crate::passes::gather::RecordHead;

/// Irradiance records, as pass `gather` left them.
pub(super) struct NoisyRecords<'a> {
    /// `size` is the size of a pixel at the record, not the record's radius.
    pub heads: &'a [RecordHead],
    pub radii: &'a [f32],
    /// Variances of their irradiance, sums of the channels; not finite where they are unknown.
    pub variances: &'a [f32],
    /// Irradiance and gradients, an equal number of values for each record; see `shaders/lib/record.wgsl`.
    pub values: &'a [f32],
}

/// A record near another one.
pub(super) struct Member {
    pub index: usize,
    /// As in the interpolation at points: 1 at the record, 0 at the end of the reach.
    pub weight: f64,
}

/// Where the irradiance of each channel is among the values of a record.
const IRRADIANCES: [usize; 3] = [3, 7, 11];

/// The irradiance among the values of a record.
pub(super) fn irradiance_of(values: &[f32]) -> DVec3 {
    let [red, green, blue] = IRRADIANCES;
    DVec3::new(values[red].into(), values[green].into(), values[blue].into())
}

/// Sets the irradiance among the values of a record.
pub(super) fn set_irradiance(values: &mut [f32], irradiance: DVec3) {
    IRRADIANCES.iter().zip(irradiance.to_array()).for_each(|(place, channel)| values[*place] = channel as f32);
}

impl NoisyRecords<'_> {
    /// How many values a record has.
    pub fn count(&self) -> usize {
        self.values.len() / self.heads.len()
    }

    pub fn irradiance(&self, i: usize) -> DVec3 {
        irradiance_of(self.values_of(i))
    }

    /// Whether the record is valid and its noise is known.
    fn is_valid(&self, i: usize) -> bool {
        self.heads[i].size > 0.0 && self.variances[i].is_finite()
    }

    /// The values of a record.
    pub fn values_of(&self, i: usize) -> &[f32] {
        &self.values[i * self.count()..][..self.count()]
    }

    /// The change of irradiance from one record to another by the gradients of `values`, which are those of a record at
    /// the first; see `weighted_irradiance` in `shaders/lib/record.wgsl`.
    pub fn change(&self, values: &[f32], from: usize, to: usize) -> DVec3 {
        let (here, there) = (&self.heads[from], &self.heads[to]);
        let offset = Vec3::from(there.position) - Vec3::from(here.position);
        let axis = Vec3::from(here.normal).cross(Vec3::from(there.normal));
        let texels = values.as_chunks::<4>().0;
        let channel = |c: usize| {
            let [x, y, z, irradiance] = texels[c];
            // Only records of curved surfaces have a rotational gradient.
            let turned = texels.get(3 + c).map_or(0.0, |[x, y, z, _]| Vec3::new(*x, *y, *z).dot(axis));
            f64::from((Vec3::new(x, y, z).dot(offset) + turned).max(-irradiance).min(irradiance))
        };
        DVec3::new(channel(0), channel(1), channel(2))
    }

    /// The records of the tree on the same surface within `reach` of a record, and the record itself.
    pub fn members(&self, tree: &RecordTree, i: usize, reach: f32) -> Vec<Member> {
        let mut members = Vec::new();
        if self.is_valid(i) {
            let here = RecordHead { size: reach, ..self.heads[i] };
            members.push(Member { index: i, weight: 1.0 });
            tree.each_near(Vec3::from(here.position), reach, |index| {
                let weight = f64::from(weight(&here, &self.heads[index]));
                if weight > 0.0 && index != i && self.is_valid(index) {
                    members.push(Member { index, weight });
                }
            });
        }
        members
    }
}

/// Records for tests.
#[cfg(test)]
pub(super) mod plane {
    use super::*;

    pub const SIDE: usize = 40;

    /// Distance of neighbours.
    pub const PITCH: f32 = 0.02;

    /// Radius of all records: five neighbours.
    pub const RADIUS: f32 = 5.0 * PITCH;

    /// Records on a square of SIDE x SIDE, two pixels apart, of flat surfaces.
    pub struct Plane {
        pub heads: Vec<RecordHead>,
        pub radii: Vec<f32>,
        pub values: Vec<f32>,
        pub variances: Vec<f32>,
    }

    impl Plane {
        /// A plane of records with the irradiance and variance that `record` returns for a column and row, without
        /// slopes.
        pub fn new(record: impl Fn(usize, usize) -> [f32; 2]) -> Plane {
            let radii = vec![RADIUS; SIDE * SIDE];
            let mut plane = Plane { heads: Vec::new(), radii, values: Vec::new(), variances: Vec::new() };
            for (column, row) in (0..SIDE * SIDE).map(|i| (i % SIDE, i / SIDE)) {
                let position = [PITCH * column as f32, PITCH * row as f32, 0.0];
                let head = RecordHead { position, size: 0.5 * PITCH, normal: [0.0, 0.0, 1.0], distance: 1.0 };
                let [irradiance, variance] = record(column, row);
                plane.heads.push(head);
                plane.values.extend([0.0, 0.0, 0.0, irradiance].repeat(3));
                plane.variances.push(variance);
            }
            plane
        }

        pub fn records(&self) -> NoisyRecords<'_> {
            let Plane { heads, radii, values, variances } = self;
            NoisyRecords { heads, radii, variances, values }
        }
    }

    /// The numbers of a sequence that is uniform in [0, 1), by index.
    pub fn uniform(i: usize) -> f32 {
        let mut state = (i as u32).wrapping_mul(0x9e37_79b9) ^ 0x85eb_ca6b;
        for _ in 0..3 {
            state = (state ^ (state >> 15)).wrapping_mul(0x2c1b_3c6d);
        }
        (state >> 8) as f32 / (1 << 24) as f32
    }

    /// Noise with a mean of 0 and this standard deviation.
    pub fn noise(i: usize, deviation: f32) -> f32 {
        (uniform(i) - 0.5) * 12f32.sqrt() * deviation
    }
}
