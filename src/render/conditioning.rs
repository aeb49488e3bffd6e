//! Problems of arithmetic and limits that a render detects, and warnings about them.

use crate::count::count;
use crate::procedural::ITERATIONS;
use crate::settings::Settings;
use crate::statistics::totals::Totals;
use crate::statistics::{Conditioning, Counter, NotFinite};

/// Share of unknown points above which there is a warning. Below it, more photons could save at most a tenth of the
/// shadow rays of `two-pass`. The image is right in both cases.
const MANY_UNKNOWN: f64 = 0.1;

/// Share of rays that may be cut short in procedural objects without a warning. Rays that graze a flat face of a
/// distance function take thousands of steps: 2e-5 of those of `scenes/procedural.glb` do.
const FEW_OVERRUNS: f64 = 1e-4;

/// Mean number of bounces over the maximum, above which there is a warning: the maximum then cuts more than a fiftieth
/// of the paths, because in a closed room numbers of bounces fall off as exp(-n / mean).
const LONG_SHARE: f64 = 0.25;

/// There is no warning if the maximum number of bounces is below this, which is a deliberate choice.
const MANY_BOUNCES: u32 = 16;

/// A possible problem, and its remedy.
pub(super) struct Warning {
    /// Key of the count in [`Conditioning`].
    pub name: &'static str,
    pub count: u64,
    pub text: String,
}

/// The counts of [`Conditioning`].
pub(super) fn conditioning(totals: &Totals) -> Conditioning {
    let number = |counter| totals.get(counter);
    Conditioning {
        not_finite: NotFinite {
            flux: number(Counter::NotFiniteFlux),
            irradiance: number(Counter::NotFiniteIrradiance),
            gather: number(Counter::NotFiniteGather),
            primary: number(Counter::NotFinitePrimary),
            shade: number(Counter::NotFiniteShade),
            path: number(Counter::NotFinitePath),
        },
        near_overflow: number(Counter::NearOverflow),
        unknown: totals.mapped_unknown,
        min_radius_records: totals.min_radius_records,
        heavy_paths: number(Counter::HeavyPaths),
        overruns: totals.overruns(),
        procedural_overruns: number(Counter::ProceduralOverruns),
        procedural_invalid: number(Counter::ProceduralInvalid),
        mean_bounces: totals.mean_bounces().round() as u64,
        devices_lost: totals.devices_lost,
    }
}

/// The warnings, one for each count that indicates a problem.
pub(super) fn warnings(totals: &Totals, settings: &Settings) -> Vec<Warning> {
    // There is no warning about records of minimum radius: their blur is three pixels wide at most, and corners
    // need them in any scene.
    let mut warnings = number_warnings(totals);
    warnings.extend(unknown_warning(totals, settings));
    warnings.extend(path_warnings(totals, settings));
    warnings.extend(procedural_warnings(totals));
    let lost = totals.devices_lost;
    warnings.push(Warning {
        name: "devices_lost",
        count: lost,
        text: format!(
            "the device was lost (times: {lost}), and the render resumed from the state in memory: if it happens \
             again, look for a driver that resets or is short of memory"
        ),
    });
    warnings.retain(|warning| warning.count > 0);
    warnings
}

/// Values that are not finite or near overflow.
fn number_warnings(totals: &Totals) -> Vec<Warning> {
    let Conditioning { not_finite, near_overflow, overruns, .. } = conditioning(totals);
    let left_out = totals.get(Counter::NotFinite);
    // The samples of rays that exceeded the loop budget are invalid, and count as not finite.
    let advice = match overruns {
        0 => "dim the lights with `light_scale`, or look for extreme lights, colours or sizes in the scene",
        _ => "they include those of rays whose traversal was cut short",
    };
    vec![
        Warning {
            name: "not_finite",
            count: left_out.max(not_finite.total()),
            text: format!(
                "the light of {} is infinite or not a number, and is missing from the image: {advice}",
                without_light(left_out, &not_finite)
            ),
        },
        Warning {
            name: "near_overflow",
            count: near_overflow,
            text: format!(
                "sums of pixels or of their squares came close to the largest number that they can hold, \
                 {near_overflow} times: the channel variance and estimated errors may be too small; dim the lights \
                 with `light_scale`"
            ),
        },
    ]
}

/// A visibility map that leaves many points unknown.
fn unknown_warning(totals: &Totals, settings: &Settings) -> Option<Warning> {
    let unknown = totals.mapped_unknown;
    let many = unknown as f64 > MANY_UNKNOWN * totals.mapped_points as f64;
    many.then(|| {
        let percent = 100.0 * unknown as f64 / totals.mapped_points as f64;
        let has_room = settings.photons_of_light(totals.photons.len()) == settings.photons_per_light();
        let advice = match has_room {
            true => "more `visibility_map.photons_per_light` would save shadow rays",
            false => "the map has no room for more",
        };
        let text =
            format!("{percent:.0} % of the points have too few photons nearby to tell light from shadow: {advice}");
        Warning { name: "unknown", count: unknown, text }
    })
}

/// Paths that are too heavy, too deep in geometry, or too short.
fn path_warnings(totals: &Totals, settings: &Settings) -> Vec<Warning> {
    let Conditioning { heavy_paths, overruns, mean_bounces, .. } = conditioning(totals);
    let mut warnings = vec![
        Warning {
            name: "heavy_paths",
            count: heavy_paths,
            text: format!(
                "{} more than eight times the usual weight, which shows as bright specks that fade slowly: take more \
                 samples, or look for materials that reflect more light than they receive",
                count(heavy_paths, "path has", "paths have")
            ),
        },
        Warning {
            name: "overruns",
            count: overruns,
            text: format!(
                "{} met more geometry than the device's loop budget of 65,535 iterations allows, and all samples and \
                 photons of such rays are left out: remove overlapping layers, or choose another device",
                count(overruns, "ray", "rays")
            ),
        },
    ];
    let max_bounces = settings.indirect.max_bounces;
    if max_bounces >= MANY_BOUNCES && totals.mean_bounces() > LONG_SHARE * f64::from(max_bounces) {
        let text = format!(
            "light bounces {mean_bounces} times on average, and `indirect.max_bounces` {max_bounces} leaves out longer \
             paths: the image is too dark unless the maximum is raised"
        );
        warnings.push(Warning { name: "mean_bounces", count: mean_bounces, text });
    }
    warnings
}

/// Functions of procedural objects that do not end, or return invalid results.
fn procedural_warnings(totals: &Totals) -> Vec<Warning> {
    let Conditioning { procedural_overruns: overruns, procedural_invalid: invalid, .. } = conditioning(totals);
    let are_many = overruns as f64 > FEW_OVERRUNS * totals.rays().total as f64;
    vec![
        Warning {
            name: "procedural_overruns",
            count: if are_many { overruns } else { 0 },
            text: format!(
                "{} took more than {ITERATIONS} iterations in a procedural object and passed through it: look for \
                 loops that do not end, or distance functions that return far less than the distance",
                count(overruns, "ray", "rays")
            ),
        },
        Warning {
            name: "procedural_invalid",
            count: invalid,
            text: format!(
                "{} not finite or without a normal, so that rays passed through: look for divisions by zero and roots \
                 of negative numbers in the functions",
                count(invalid, "result of a procedural object is", "results of procedural objects are")
            ),
        },
    ]
}

/// What has no light because that is not finite. `samples` of pixels are left out, whichever pass made them so.
fn without_light(samples: u64, not_finite: &NotFinite) -> String {
    let NotFinite { flux, irradiance, gather, .. } = *not_finite;
    let counts = [
        (samples, "sample", "samples"),
        (flux, "photon", "photons"),
        (irradiance, "estimate from the photon map", "estimates from the photon map"),
        (gather, "gather ray", "gather rays"),
    ];
    let named = counts.into_iter().filter(|(n, ..)| *n > 0).map(|(n, one, many)| count(n, one, many));
    let named: Vec<String> = named.collect();
    match named.as_slice() {
        [first @ .., last] if !first.is_empty() => format!("{} and {last}", first.join(", ")),
        all => all.concat(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A note says what lacks light in words, also where every sample is finite and only photons are not.
    #[test]
    fn what_lacks_light_is_named() {
        let none = NotFinite::default();
        assert_eq!(without_light(1, &NotFinite { shade: 9, ..none }), "1 sample");
        assert_eq!(without_light(0, &NotFinite { flux: 2, ..none }), "2 photons");
        let all = NotFinite { flux: 2, irradiance: 3, gather: 1, ..none };
        assert_eq!(without_light(7, &all), "7 samples, 2 photons, 3 estimates from the photon map and 1 gather ray");
    }
}
