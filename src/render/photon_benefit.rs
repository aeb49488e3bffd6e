//! Whether visibility photons pay off: predicted from the first sample, and checked by the share of points that they
//! decide.

use crate::scene::{Camera, Scene};
use crate::settings::{Settings, Technique};
use crate::specialisation::Specialisation;
use crate::specialisation::features::Feature;
use crate::specialisation::visibility::{SAMPLES_OF_MAP, SHADOW_RAYS_OF_MAP};
use crate::statistics::totals::Totals;
use crate::statistics::{Counter, Points};

/// Maximum share of shadow rays that start at penumbra points: above it, no photons are emitted. Such points, and the
/// points around them, trace shadow rays in any case. The share was 0.13 to 0.39 in one scene and five models where 64
/// samples with photons took 0.97 to 1.4 times as long as with `two-pass`, and 0 to 0.09 in all others that were
/// measured (docs/decisions.md, "The first sample shows whether photons pay off").
const MAX_PENUMBRAE: f64 = 0.11;

/// Samples per pixel after which photons must be expected to decide [`MIN_DECIDED`] of the points, if they are emitted
/// after the first sample. The shadow rays of three samples have classified the fine cells by then.
pub(super) const TRIAL_SAMPLES: u32 = 8;

/// Share of points that photons must be expected to decide; below it, all shadow rays are traced from then on. Scenes
/// with few penumbrae may still have boundaries everywhere. 64 samples took 0.4 to 1.1 times as long as with `two-pass`
/// if the share was larger, and 0.97 to 1.4 times if it was smaller (docs/decisions.md, "The first sample shows whether
/// photons pay off").
const MIN_DECIDED: f64 = 0.6;

/// Like [`MIN_DECIDED`], for adaptive sampling with a fixed budget: pixels in penumbrae get most of the samples,
/// whatever photons decide elsewhere. 64 samples took 0.65 to 1.02 times as long with photons as without if the share
/// was 0.46 or more, and 1.05 times if it was 0.21 (docs/decisions.md, "Adaptive sampling with a fixed budget").
const MIN_DECIDED_OF_ALLOCATED: f64 = 0.4;

/// Part of the latest growth of the share by which it will grow further, as fine cells are divided. In 16 scenes and
/// models, the share of the last samples of the trial plus this part of its growth since the samples before was close
/// to the share of 64 samples (docs/decisions.md, "The first sample shows whether photons pay off").
const FURTHER_GROWTH: f64 = 0.5;

/// Why photons would cost more than the shadow rays that they save; `None` if they are worth a trial. `totals` are the
/// totals of the first `samples` samples, at least one, each of which traced all shadow rays. The render will have
/// `spp` samples.
pub(super) fn problem_of_photons(totals: &Totals, samples: u32, spp: u32) -> Option<&'static str> {
    // The render that remains, counted from the last of these samples.
    let spp = spp.saturating_sub(samples - 1);
    let traced = totals.get(Counter::ShadowRays) as f64;
    if traced / f64::from(samples) * f64::from(spp) < SHADOW_RAYS_OF_MAP || spp < SAMPLES_OF_MAP {
        return Some("few shadow rays remain to be traced");
    }
    let of_penumbrae = totals.get(Counter::PenumbraRays) as f64;
    (of_penumbrae >= MAX_PENUMBRAE * traced).then_some("many points are in penumbrae")
}

/// Whether photons will decide enough points. `counted` has the points of the first `samples` samples, of which the
/// first `without` had no photons; `points` has those of all samples so far. `is_allocated`: adaptive sampling with a
/// fixed budget.
pub(super) fn decide_enough(
    counted: &Points,
    [without, samples]: [u32; 2],
    points: &Points,
    is_allocated: bool,
) -> bool {
    let share = |decided: u64, total: f64| decided as f64 / total.max(1.0);
    let tried = f64::from(samples - without) / f64::from(samples);
    let decided = points.lit + points.shadowed - counted.lit - counted.shadowed;
    let last = share(decided, (points.total - counted.total) as f64);
    // A trial of a single batch shows no growth.
    let first =
        if samples > without { share(counted.lit + counted.shadowed, counted.total as f64 * tried) } else { last };
    last + FURTHER_GROWTH * (last - first) >= if is_allocated { MIN_DECIDED_OF_ALLOCATED } else { MIN_DECIDED }
}

/// Whether visibility photons are on trial in such a render.
pub(super) fn is_on_trial(specialisation: &Specialisation, settings: &Settings) -> bool {
    specialisation.features.has(Feature::FineCells) && settings.tries_photons()
}

/// If photons are on trial, leaves them out of the first sample. Returns the specialisation of that sample, and the one
/// with photons, which later samples have if photons pay off: `None` if photons are emitted in any case or never.
/// `settings` are those of the specialisation.
pub(super) fn postpone_photons(
    specialisation: Specialisation,
    scene: &Scene,
    camera: &Camera,
    settings: &Settings,
) -> (Specialisation, Option<Specialisation>) {
    if !is_on_trial(&specialisation, settings) {
        return (specialisation, None);
    }
    let reason = "the first sample will show how many points are in penumbrae";
    (without_photons(&specialisation, scene, camera, settings, reason), Some(specialisation))
}

/// The same render without visibility photons: direct light by the kernels of `two-pass`. `reason` is that in the list
/// of what was left out.
pub(super) fn without_photons(
    specialisation: &Specialisation,
    scene: &Scene,
    camera: &Camera,
    settings: &Settings,
    reason: &str,
) -> Specialisation {
    let settings = settings.clone().with(|s| s.technique = Technique::TWO_PASS);
    let mut without = Specialisation::new(scene, Some(camera), &settings).with_deferred_of(specialisation);
    without.explain(Feature::VisibilityMap, reason);
    without
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The growth of the share of decided points is that of the samples with photons, however many came before: a
    /// share of 0.55 that has grown by 0.11 is enough, and one that has not grown is not.
    #[test]
    fn samples_without_photons_show_no_growth() {
        let points = |total: u64, lit: u64| Points { total, lit, ..Points::default() };
        for without in [1, 12] {
            let samples = without + 3;
            let before = u64::from(without) * 100;
            let enough = |first: u64, last: u64| {
                let (counted, all) = (points(before + 300, 3 * first), points(before + 700, 3 * first + 4 * last));
                decide_enough(&counted, [without, samples], &all, false)
            };
            assert!(enough(44, 55) && !enough(55, 55), "after {without} samples without photons");
            // A trial of one batch.
            let (counted, all) = (points(before, 0), points(before + 700, 7 * 55));
            assert!(!decide_enough(&counted, [without, without], &all, false));
        }
    }
}
