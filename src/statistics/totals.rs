//! Counts and times of a render, added up from what the kernels count.

use serde::{Deserialize, Serialize};

use crate::statistics::{Audits, Counter, Indirect, LightPhotons, Points, Rays, Stratum};
use crate::{Error, Result};

/// Maximum share of samples that may exceed the loop budget, and of the gather rays and the photons of indirect light.
/// The image is then made of the others. A thousandth does not show, and a scene full of overlapping layers is far
/// above it.
const MAX_OVERRUNS: f64 = 1e-3;

/// Points that are lit or shadowed by class.
#[derive(Clone, Copy, Default)]
pub(crate) struct Decided {
    pub points: u64,
    pub audited: u64,
    /// Audited ones whose shadow ray contradicted the class.
    pub wrong: u64,
}

/// Decided points that are audited with one probability each.
#[derive(Clone, Copy, Default)]
pub(crate) struct DecidedPoints {
    pub near: Decided,
    /// In settled cells, which are near boundaries as well.
    pub settled: Decided,
    pub away: Decided,
}

impl DecidedPoints {
    fn strata(self) -> [Decided; 3] {
        [self.near, self.settled, self.away]
    }

    /// Near boundaries, settled or not, and away from them.
    pub fn near_and_away(self) -> [Decided; 2] {
        let DecidedPoints { near, settled, away } = self;
        let all_near = Decided {
            points: near.points + settled.points,
            audited: near.audited + settled.audited,
            wrong: near.wrong + settled.wrong,
        };
        [all_near, away]
    }
}

/// Audits, and the mistakes that they found; later samples have more weight.
#[derive(Clone, Copy, Default, Serialize, Deserialize)]
pub(crate) struct RecentAudits {
    pub audited: f64,
    pub wrong: f64,
}

/// Sums over all samples so far.
#[derive(Clone, Default, Serialize, Deserialize)]
pub(crate) struct Totals {
    counters: [u64; Counter::COUNT],
    /// Decided points of batches with audits, by [`DecidedPoints::strata`].
    decided: [u64; 3],
    /// Estimated number of these points that have a wrong class.
    wrong: [f64; 3],
    /// Recent audits near boundaries, and away from them.
    recent_audits: [RecentAudits; 2],
    camera_rays: u64,
    pub photons: Vec<LightPhotons>,
    pub photon_rays: u64,
    pub cell_rays: u64,
    pub gather_rays: u64,
    pub indirect: Indirect,
    /// Caustic maps that are counted.
    pub caustic_maps: u32,
    /// Irradiance records of the smallest radius.
    pub min_radius_records: u64,
    /// Points that queried the visibility map, and those among them that found too few photons.
    pub mapped_points: u64,
    pub mapped_unknown: u64,
    /// Rays of visibility photons that exceeded the loop budget and stored nothing. Points without photons trace shadow
    /// rays, so the image is right.
    pub photon_overruns: u64,
    /// Photons of indirect light that were emitted, and those that exceeded the loop budget and are lost from there on.
    pub flux_emitted: u64,
    pub flux_overruns: u64,
    /// Gather rays that exceeded the loop budget, which count as dark.
    gather_overruns: u64,
    pub devices_lost: u64,
    pub bvh_depth: u32,
    pub time_bvh: f64,
    pub time_compile: f64,
    pub time_render: f64,
    /// Of these, up to the end of the first batch of samples; 0 before.
    pub time_first_sample: f64,
    pub scene_bytes: u64,
    pub photon_bytes: u64,
    pub indirect_bytes: u64,
    pub frame_bytes: u64,
}

impl Totals {
    /// Adds to one count.
    pub fn count(&mut self, counter: Counter, more: u64) {
        self.counters[counter as usize] += more;
    }

    /// Adds the points that queried the visibility map, and the unknown ones among them, from the counters that
    /// [`Totals::add`] takes. With an environment, one in `lights` candidates belongs to it; it has no photons, so
    /// these are always unknown.
    pub fn add_mapped(&mut self, counters: &[u32], lights: usize, has_environment: bool) {
        let [dark, lit, shadowed, boundary, unknown] =
            [Counter::Dark, Counter::Lit, Counter::Shadowed, Counter::Boundary, Counter::Unknown]
                .map(|class| u64::from(counters[class as usize]));
        let counted = lit + shadowed + boundary + unknown;
        let of_environment = if has_environment { ((dark + counted) / lights as u64).min(unknown) } else { 0 };
        self.mapped_points += counted - of_environment;
        self.mapped_unknown += unknown - of_environment;
    }

    /// Adds what the kernels counted for a tile of `points` points.
    pub fn add(&mut self, counters: &[u32], points: u64) {
        for (sum, count) in self.counters.iter_mut().zip(counters) {
            *sum += u64::from(*count);
        }
        self.camera_rays += points;
    }

    /// Adds what the kernels counted for gather rays, and for rays that find places of records: they are no samples.
    pub fn add_gathered(&mut self, counters: &[u32]) {
        let samples = self.get(Counter::Overrun);
        self.add(counters, 0);
        self.gather_overruns += self.get(Counter::Overrun) - samples;
        self.counters[Counter::Overrun as usize] = samples;
    }

    /// Invocations of all kernels that exceeded the loop budget.
    pub fn overruns(&self) -> u64 {
        self.get(Counter::Overrun) + self.photon_overruns + self.flux_overruns + self.gather_overruns
    }

    /// These totals, with the time added that a resumed render took to restore them.
    pub fn after(mut self, resumed: &Totals) -> Totals {
        self.time_bvh += resumed.time_bvh;
        self.time_compile += resumed.time_compile;
        self.time_render += resumed.time_render;
        self
    }

    /// The totals of the scene and of the maps that do not depend on the camera, for another view.
    pub fn of_another_view(&self) -> Totals {
        let mut photons = self.photons.clone();
        photons.iter_mut().for_each(|light| light.repaired = 0);
        Totals {
            photons,
            indirect: Indirect { caustics: 0, records: 0, ..self.indirect },
            bvh_depth: self.bvh_depth,
            time_bvh: self.time_bvh,
            scene_bytes: self.scene_bytes,
            photon_bytes: self.photon_bytes,
            ..Totals::default()
        }
    }

    pub fn get(&self, counter: Counter) -> u64 {
        self.counters[counter as usize]
    }

    /// # Errors
    /// [`Error::Computation`] if too many rays exceeded the loop budget, so that the image would be wrong.
    pub fn check(&self) -> Result<()> {
        // The share is of samples, not of rays: a path is lost as a whole, and may have had thousands of rays. So is a
        // photon.
        let shares = [
            (self.get(Counter::Overrun), self.camera_rays, "samples"),
            (self.gather_overruns, self.gather_rays, "gather rays"),
            (self.flux_overruns, self.flux_emitted, "photons of indirect light"),
        ];
        let is_large = |(overruns, all, _): &(u64, u64, &str)| *overruns as f64 > MAX_OVERRUNS * *all as f64;
        let Some((overruns, all, what)) = shares.into_iter().find(is_large) else { return Ok(()) };
        Err(Error::Computation {
            kernel: "bvh".to_owned(),
            problem: format!(
                "{overruns} of {all} {what} met more geometry than the device's loop budget of 65,535 iterations \
                 allows; the image would be wrong. Remove overlapping layers, reduce `indirect.max_bounces`, or \
                 choose another device"
            ),
        })
    }

    pub fn rays(&self) -> Rays {
        Rays {
            camera: self.camera_rays,
            photon: self.photon_rays,
            cell: self.cell_rays,
            shadow: self.get(Counter::ShadowRays),
            audit: self.get(Counter::AuditRays),
            bounce: self.get(Counter::BounceRays),
            gather: self.gather_rays + self.get(Counter::GatherRays),
            ..Rays::default()
        }
        .summed()
    }

    /// Mean number of bounces of a photon of the global map, or of a path where there is no such map.
    pub fn mean_bounces(&self) -> f64 {
        let Indirect { emitted, photons, .. } = self.indirect;
        let (bounces, paths) =
            if emitted > 0 { (photons, emitted) } else { (self.get(Counter::BounceRays), self.camera_rays) };
        bounces as f64 / paths.max(1) as f64
    }

    pub fn points(&self) -> Points {
        let [lit, shadowed, boundary, unknown] =
            [Counter::Lit, Counter::Shadowed, Counter::Boundary, Counter::Unknown].map(|c| self.get(c));
        let total = lit + shadowed + boundary + unknown;
        let share = |part: u64, whole: u64| if whole == 0 { 0.0 } else { part as f64 / whole as f64 };
        Points {
            total,
            dark: self.get(Counter::Dark),
            lit,
            shadowed,
            boundary,
            unknown,
            boundary_share: share(boundary + unknown, total),
            fill_seen: share(self.get(Counter::PenumbraSeen), boundary + unknown),
        }
    }

    pub fn audits(&self) -> Audits {
        let total = self.points().total;
        let stratum = |Decided { points, audited, wrong }: Decided, (of, found): (u64, f64)| Stratum {
            share: if total == 0 { 0.0 } else { points as f64 / total as f64 },
            audited,
            wrong,
            found: if of == 0 { 0.0 } else { found / of as f64 },
        };
        let found = self.decided.into_iter().zip(self.wrong);
        let strata: Vec<Stratum> = self
            .decided_points()
            .strata()
            .into_iter()
            .zip(found)
            .map(|(points, found)| stratum(points, found))
            .collect();
        Audits::new(&strata)
    }

    pub fn decided_points(&self) -> DecidedPoints {
        let counts = |counters: [Counter; 3]| counters.map(|counter| self.get(counter));
        let of = |counters: [Counter; 3]| {
            let [points, audited, wrong] = counts(counters);
            Decided { points, audited, wrong }
        };
        let near = of([Counter::Near, Counter::NearAudited, Counter::AuditsWrongNear]);
        let settled = of([Counter::Settled, Counter::SettledAudited, Counter::AuditsWrongSettled]);
        let [lit, shadowed, audited] = counts([Counter::Lit, Counter::Shadowed, Counter::Audited]);
        let away = Decided {
            points: lit + shadowed - near.points - settled.points,
            audited: audited - near.audited - settled.audited,
            wrong: self.get(Counter::AuditsWrong) - near.wrong - settled.wrong,
        };
        DecidedPoints { near, settled, away }
    }

    /// Audits near boundaries, and away from them. Later audits have more weight: earlier ones are scaled by the share
    /// of decided points that came before the latest batch. This is because each mistake that is found divides its
    /// cell, so that mistakes become rare as samples are added.
    pub fn recent_audits(&self) -> [RecentAudits; 2] {
        self.recent_audits
    }

    /// Adds the audits of a batch; `before` are the decided points before it. Batches have different probabilities of
    /// audits.
    pub fn add_audits(&mut self, before: &DecidedPoints) {
        let all = self.decided_points();
        for (i, (now, before)) in all.strata().iter().zip(before.strata()).enumerate() {
            let (points, audited) = (now.points - before.points, now.audited - before.audited);
            if audited > 0 {
                self.decided[i] += points;
                self.wrong[i] += (now.wrong - before.wrong) as f64 * points as f64 / audited as f64;
            }
        }
        let both = all.near_and_away().into_iter().zip(before.near_and_away());
        for (recent, (now, before)) in self.recent_audits.iter_mut().zip(both) {
            let audited = now.audited - before.audited;
            if audited > 0 {
                let weight = before.points as f64 / now.points as f64;
                recent.audited = weight * recent.audited + audited as f64;
                recent.wrong = weight * recent.wrong + (now.wrong - before.wrong) as f64;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A hundred audits of the first thousand points find two mistakes; a hundred of the next three thousand find none.
    /// The first audits then have a weight of a quarter. A batch without audits changes nothing.
    #[test]
    fn later_audits_weigh_more() {
        let mut totals = Totals::default();
        for [points, audited, wrong] in [[1000, 100, 2], [3000, 100, 0], [500, 0, 0]] {
            let before = totals.decided_points();
            totals.count(Counter::Lit, points);
            totals.count(Counter::Audited, audited);
            totals.count(Counter::AuditsWrong, wrong);
            totals.add_audits(&before);
        }
        let [near, away] = totals.recent_audits();
        assert_eq!([near.audited, near.wrong], [0.0; 2]);
        assert_eq!([away.audited, away.wrong], [125.0, 0.5]);
    }

    /// Settled cells are audited a quarter as often as others near boundaries. Of 1,000 points near boundaries all are
    /// audited, and 10 are wrong; of 4,000 in settled cells one in four is, and 2 of 1,000 are wrong, so 8 of all. That
    /// is 18 of 5,000; all audits taken together would give 12 of 2,000, or 30 of 5,000.
    #[test]
    fn settled_cells_are_a_stratum() {
        let mut totals = Totals::default();
        for (counter, count) in [
            (Counter::Lit, 5000),
            (Counter::Near, 1000),
            (Counter::Settled, 4000),
            (Counter::Audited, 2000),
            (Counter::NearAudited, 1000),
            (Counter::SettledAudited, 1000),
            (Counter::AuditsWrong, 12),
            (Counter::AuditsWrongNear, 10),
            (Counter::AuditsWrongSettled, 2),
        ] {
            totals.count(counter, count);
        }
        totals.add_audits(&DecidedPoints::default());
        let audits = totals.audits();
        assert!((audits.miss_bias - 18.0 / 5000.0).abs() < 1e-12, "{}", audits.miss_bias);
        assert_eq!((audits.audited, audits.wrong), (2000, 12));
        // Both count as near where the probabilities of audits are chosen.
        let [near, away] = totals.recent_audits();
        assert_eq!([near.audited, near.wrong, away.audited], [2000.0, 12.0, 0.0]);
    }

    /// Two batches with different audit probabilities. Of 1,000 points, one in two is audited, and 10 of 500 audits are
    /// wrong. Of 9,000 points, one in nine is audited, and 2 of 1,000 are wrong. So the estimate is 20 + 18 wrong
    /// classes of 10,000, or 0.0038; all audits taken together would give 12 of 1,500, or 0.008.
    #[test]
    fn batches_are_audited_with_different_probabilities() {
        let mut totals = Totals::default();
        for [points, audited, wrong] in [[1000, 500, 10], [9000, 1000, 2], [500, 0, 0]] {
            let before = totals.decided_points();
            totals.count(Counter::Lit, points / 4);
            totals.count(Counter::Shadowed, points - points / 4);
            totals.count(Counter::Audited, audited);
            totals.count(Counter::AuditsWrong, wrong);
            totals.add_audits(&before);
        }
        let audits = totals.audits();
        assert!((audits.miss_bias - 0.0038).abs() < 1e-12, "{}", audits.miss_bias);
        assert_eq!((audits.audited, audits.wrong), (1500, 12));
        let [low, high] = audits.miss_bias_interval;
        // The ends are about half and twice the estimate, as in an interval for 12 of 1,500.
        assert!(
            low > 0.0038 / 2.5 && low < 0.0038 / 1.5 && high > 1.5 * 0.0038 && high < 2.5 * 0.0038,
            "{low}, {high}"
        );
    }
}
