//! What a render notices of its own arithmetic and limits, and what it says about it.

use crate::procedural::TURNS;
use crate::settings::Settings;
use crate::statistics::{Conditioning, Counter, NotFinite};

use crate::statistics::totals::Totals;

/// Unknown points are of note above this share of all: below it more photons could save no more than a tenth of the shadow
/// rays of `two-pass`. The image is the same with either.
const MANY_UNKNOWN: f64 = 0.1;

/// Where light bounces more often on average than this share of the bounces that are asked for, more than a fiftieth of the
/// paths are not at their end there: numbers of bounces fall off as exp(-n / mean) in a closed room.
const LONG_SHARE: f64 = 0.25;

/// Fewer bounces than these are asked for by someone who knows that they are few.
const MANY_BOUNCES: u32 = 16;

/// Something that the user should know, and what to do about it.
pub(super) struct Warning {
    /// Key of the count in [`Conditioning`].
    pub name: &'static str,
    pub count: u64,
    pub text: String,
}

/// The counts that [`Conditioning`] is made of.
pub(super) fn conditioning(totals: &Totals) -> Conditioning {
    let count = |counter| totals.get(counter);
    Conditioning {
        not_finite: NotFinite {
            flux: count(Counter::NotFiniteFlux),
            irradiance: count(Counter::NotFiniteIrradiance),
            gather: count(Counter::NotFiniteGather),
            primary: count(Counter::NotFinitePrimary),
            shade: count(Counter::NotFiniteShade),
            path: count(Counter::NotFinitePath),
        },
        near_overflow: count(Counter::NearOverflow),
        unknown: totals.mapped_unknown,
        least_records: totals.least_records,
        heavy_paths: count(Counter::HeavyPaths),
        overruns: count(Counter::Overrun),
        procedural_overruns: count(Counter::ProceduralOverruns),
        procedural_nonsense: count(Counter::ProceduralNonsense),
        mean_bounces: totals.mean_bounces().round() as u64,
        devices_lost: totals.devices_lost,
    }
}

/// A warning for each count that is not as it should be.
pub(super) fn warnings(totals: &Totals, settings: &Settings) -> Vec<Warning> {
    // Records of the least radius are a figure alone: what they blur is three pixels wide, and corners ask for them in any scene.
    let Conditioning { not_finite, near_overflow, unknown, heavy_paths, overruns, mean_bounces, devices_lost, .. } =
        conditioning(totals);
    let Conditioning { procedural_overruns, procedural_nonsense, .. } = conditioning(totals);
    let mut warnings = Vec::new();
    let mut warn = |name, count: u64, text: String| {
        if count > 0 {
            warnings.push(Warning { name, count, text });
        }
    };
    let by_pass = by_pass(&not_finite);
    let left_out = totals.get(Counter::NotFinite);
    // What a ray would bring that took too many turns is not known, and left out as what is not finite.
    let advice = match overruns {
        0 => "look for lights, colours or sizes in the scene that are beyond all measure",
        _ => "those of rays that took too many turns are among them",
    };
    warn(
        "not_finite",
        left_out.max(not_finite.total()),
        format!("{left_out} samples are not finite and left out of the image{by_pass}: {advice}"),
    );
    warn(
        "near_overflow",
        near_overflow,
        format!(
            "sums of pixels came near the largest number there is, {near_overflow} times: dim the lights with `light_scale`"
        ),
    );
    // Where the map was left out after all, that is what the notes say.
    let mapped = totals.mapped_points == totals.points().total;
    if mapped && unknown as f64 > MANY_UNKNOWN * totals.mapped_points as f64 {
        let percent = 100.0 * unknown as f64 / totals.mapped_points as f64;
        let text = format!(
            "{percent:.0} % of the points have too few photons near to tell light from shadow: more \
             `visibility_map.photons_per_light` would save shadow rays"
        );
        warn("unknown", unknown, text);
    }
    warn(
        "heavy_paths",
        heavy_paths,
        format!(
            "{heavy_paths} paths carry more than eight times their weight, and show as bright specks that fade slowly: take \
             more samples, or look for materials that reflect more than they get"
        ),
    );
    warn(
        "overruns",
        overruns,
        format!(
            "{overruns} rays met more geometry than the device's loop budget of 65,535 turns allows, and their samples are \
             left out of the image: remove overlapping layers, or choose another device"
        ),
    );
    let most = settings.indirect.max_bounces;
    if most >= MANY_BOUNCES && totals.mean_bounces() > LONG_SHARE * f64::from(most) {
        let text = format!(
            "light bounces {mean_bounces} times here on average, and `indirect.max_bounces` {most} leaves out what bounces more often: \
             the image is too dark unless more are asked for"
        );
        warn("mean_bounces", mean_bounces, text);
    }
    warn(
        "procedural_overruns",
        procedural_overruns,
        format!(
            "{procedural_overruns} rays took more than {TURNS} turns in a procedural object and passed through it: look for \
             loops that do not end, or distances far smaller than the surface is away"
        ),
    );
    warn(
        "procedural_nonsense",
        procedural_nonsense,
        format!(
            "{procedural_nonsense} answers of procedural objects are not finite or have no normal, and their rays passed \
             through: look for divisions by zero and roots of negative numbers in their functions"
        ),
    );
    warn(
        "devices_lost",
        devices_lost,
        format!(
            "the device was lost {devices_lost} times, and the render went on with what was kept, as if it had not stopped: \
             look for a driver that is short of memory or resets, should it happen again"
        ),
    );
    warnings
}

/// The counts that are not zero, with the names of their passes.
fn by_pass(counts: &NotFinite) -> String {
    let named = counts.named().into_iter().filter(|(_, count)| *count > 0);
    let named: Vec<String> = named.map(|(pass, count)| format!("{pass} {count}")).collect();
    if named.is_empty() { String::new() } else { format!(" (by pass: {})", named.join(", ")) }
}
