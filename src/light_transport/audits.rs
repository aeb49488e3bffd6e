//! Protection against wrong classes: audits of decided points, and wider boundaries.

use crate::passes::classify::AuditProbabilities;
use crate::settings::Settings;
use crate::statistics::totals::Totals;

/// The audit probability over the square root of the share of wrong classes. A wrong class that an audit finds with
/// probability q adds noise of R (1 / q - 1), where R is the mean square of the light that it hides over that of the
/// image. Samples have a noise of V, and processing all decided points costs about as much as auditing all of them. So
/// the error for a given time is smallest at q = sqrt(m R / V), where m is the share of wrong classes. sqrt(R / V) was
/// 16, 27 and 74 in the direct light of `scenes/crowd.glb`, `procedural.glb` and `door.glb`. This value is nearer to
/// the largest, because too many audits cost a few percent of the time, and too few may cost a multiple of it
/// (docs/decisions.md, "Audits follow mistakes").
const AUDIT_SCALE: f64 = 50.0;

/// Audits without a mistake that are assumed before the first one. The probability at the start is then 1 =
/// AUDIT_SCALE sqrt(0.5 / 1250): all of the first points are audited, as most mistakes are in cells that have few
/// photons yet.
const EARLIER_AUDITS: f64 = 1250.0;

/// How the next samples are protected against wrong classes.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Precautions {
    pub audits: AuditProbabilities,
    /// Boundaries are widened by a pixel, unless the settings or the lights decide this.
    pub dilate: bool,
}

impl Precautions {
    /// Derives them from the mistakes that audits have found so far. Probabilities are never below the setting. They
    /// follow from counts, so that a render is reproducible, and from earlier samples only, so that the next ones are
    /// unbiased.
    pub fn after(totals: &Totals, settings: &Settings) -> Precautions {
        let minimum = AuditProbabilities::of(settings.visibility_map.audit);
        // No later sample learns from audits here; in a piece none may, since pieces must not depend on each other.
        if !settings.learns_from_shadow_rays() {
            return Precautions { audits: minimum, dilate: false };
        }
        let [near, away] = totals.recent_audits().map(|recent| audit_probability(recent.audited, recent.wrong));
        let audits = AuditProbabilities { away: minimum.away.max(away), near: minimum.near.max(near) };
        // Where all decided points near boundaries would be audited, boundaries are too narrow. All audits count here:
        // mistakes that a wider boundary prevents are no longer found, so recent audits alone would narrow it again.
        let [near, _] = totals.decided_points().near_and_away();
        let certain = audit_probability(near.audited as f64, near.wrong as f64) >= 1.0;
        Precautions { audits, dilate: near.wrong > 0 && certain }
    }
}

/// The audit probability after `audited` audits, of which `wrong` contradicted the class. Half a mistake is added,
/// because finding no mistake does not prove that there are none.
fn audit_probability(audited: f64, wrong: f64) -> f32 {
    let share = (wrong + 0.5) / (audited + EARLIER_AUDITS);
    (AUDIT_SCALE * share.sqrt()) as f32
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::settings::Technique;
    use crate::statistics::Counter;

    const NONE: Counts = Counts { audited: 0, wrong: 0 };

    #[derive(Clone, Copy)]
    struct Counts {
        audited: u64,
        wrong: u64,
    }

    fn after(near: Counts, away: Counts, settings: &Settings) -> Precautions {
        let mut totals = Totals::default();
        totals.count(Counter::NearAudited, near.audited);
        totals.count(Counter::AuditsWrongNear, near.wrong);
        totals.count(Counter::Audited, near.audited + away.audited);
        totals.count(Counter::AuditsWrong, near.wrong + away.wrong);
        totals.count(Counter::Near, near.audited);
        totals.count(Counter::Lit, near.audited + away.audited);
        totals.add_audits(&Totals::default().decided_points());
        Precautions::after(&totals, settings)
    }

    fn of(near: Counts, away: Counts, settings: &Settings) -> [f32; 2] {
        let AuditProbabilities { away, near } = after(near, away, settings).audits;
        [near, away]
    }

    fn settings() -> Settings {
        Settings::default().with(|s| s.technique = Technique::SHADOW_PHOTONS)
    }

    /// The probability where the root in the rule is round: 1 at first; without mistakes it falls with the square root
    /// of the number of audits, and it grows with the square root of the number of mistakes.
    #[test]
    fn mistakes_raise_the_probability() {
        let settings = settings();
        assert_eq!(of(NONE, NONE, &settings), [1.0; 2]);
        let clean = Counts { audited: 16 * 1250 - 1250, wrong: 0 };
        assert_eq!(of(clean, NONE, &settings), [0.25, 1.0]);
        assert_eq!(of(NONE, clean, &settings), [1.0, 0.25]);
        let wrong = Counts { audited: 16 * 1250 - 1250, wrong: 4 };
        assert_eq!(of(wrong, clean, &settings), [0.75, 0.25]);
        assert_eq!(of(NONE, wrong, &settings), [1.0, 0.75]);
    }

    /// Boundaries are widened if the share of mistakes near boundaries is large enough to make audits there certain:
    /// one in 2,500 or more. They are not widened by mistakes away from boundaries, by a share that no audit has
    /// measured, or without fine cells.
    #[test]
    fn frequent_mistakes_widen_boundaries() {
        let widened = |near, away| after(near, away, &settings()).dilate;
        let of = |audited, wrong| Counts { audited, wrong };
        assert!(widened(of(48_750, 20), NONE));
        assert!(!widened(of(50_100, 20), NONE));
        assert!(!widened(NONE, of(48_750, 20)));
        assert!(!widened(NONE, NONE));
        let alone = settings().with(|s| s.visibility_map.fine_cells = false);
        assert!(!after(of(48_750, 20), NONE, &alone).dilate);
    }

    /// The setting is the minimum, and the only probability where samples do not learn.
    #[test]
    fn the_setting_is_the_minimum() {
        let many = Counts { audited: 1 << 40, wrong: 0 };
        assert_eq!(of(many, many, &settings()), [0.25, 1.0 / 64.0]);
        let wrong = Counts { audited: 1000, wrong: 1000 };
        let alone = settings().with(|s| s.visibility_map.fine_cells = false);
        assert_eq!(of(wrong, wrong, &alone), [0.25, 1.0 / 64.0]);
    }
}
