//! Sweeps: the effect of a setting of the visibility map on classes, error, rays and time, for photons alone and with
//! fine cells.

use std::str::FromStr;

use serde::Serialize;

use super::classes::{Classes, Truth};
use super::interval::Interval;
use super::metrics;
use super::reference::Reference;
use super::run::Subject;
use crate::settings::{Settings, Technique};
use crate::statistics::Statistics;
use crate::{Error, Image, Result};

/// Number of values of a sweep, at equal ratios: at least two per decade in a sweep over three decades.
const VALUES: u32 = 7;

/// Samples per pixel of the renders whose error, rays and time are measured: as many as in the tables of
/// `docs/decisions.md`.
const SAMPLES: u32 = 64;

/// Renders for each time. The median of three leaves out one during which the machine did other work.
const ROUNDS: usize = 3;

/// The settings that can be swept.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Swept {
    /// [`crate::settings::VisibilityMapSettings::photons_per_light`].
    Photons,
    /// [`crate::settings::VisibilityMapSettings::nearest`].
    Nearest,
}

impl Swept {
    const ALL: [Swept; 2] = [Swept::Photons, Swept::Nearest];

    /// The name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Swept::Photons => "photons",
            Swept::Nearest => "nearest",
        }
    }

    /// The exponent of the boundary share as a power of the setting, at hard edges. Boundaries are as wide as the
    /// radius of the nearest photons, which is the square root of their number over their density.
    pub fn law(self) -> f64 {
        match self {
            Swept::Photons => -0.5,
            Swept::Nearest => 0.5,
        }
    }

    fn set(self, settings: &mut Settings, value: u32) {
        match self {
            Swept::Photons => settings.visibility_map.photons_per_light = Some(value),
            Swept::Nearest => settings.visibility_map.nearest = value,
        }
    }
}

/// A setting with its first and last value.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Range {
    swept: Swept,
    from: u32,
    to: u32,
}

impl FromStr for Range {
    type Err = String;

    /// Parses a range like `photons=1e3..1e6`.
    fn from_str(text: &str) -> std::result::Result<Self, String> {
        let form = || {
            let names = Swept::ALL.map(Swept::name).join(" or ");
            format!("it must be a range of {names}, as in photons=1e3..1e6")
        };
        let (name, values) = text.split_once('=').ok_or_else(form)?;
        let (from, to) = values.split_once("..").ok_or_else(form)?;
        let swept = Swept::ALL.into_iter().find(|swept| swept.name() == name).ok_or_else(form)?;
        let number = |text: &str| text.parse::<f64>().ok().filter(|x| (1.0..=f64::from(u32::MAX)).contains(x));
        let [from, to] = [number(from), number(to)].map(|x| x.map(|x| x.round() as u32));
        match (from, to) {
            (Some(from), Some(to)) if from < to => Ok(Range { swept, from, to }),
            _ => Err(form()),
        }
    }
}

impl Range {
    /// The name of the setting.
    pub fn setting(&self) -> &'static str {
        self.swept.name()
    }

    /// The values, ascending.
    fn values(&self) -> Vec<u32> {
        let [from, to] = [self.from, self.to].map(f64::from);
        let value = |i: u32| (from * (to / from).powf(f64::from(i) / f64::from(VALUES - 1))).round() as u32;
        let mut values: Vec<u32> = (0..VALUES).map(value).collect();
        values.dedup();
        values
    }

    /// Checks the settings with every value of the range, for the techniques of a [`Sweep`].
    ///
    /// # Errors
    /// As [`Settings::check`].
    pub fn check(&self, settings: &Settings) -> Result<()> {
        self.values().into_iter().try_for_each(|value| {
            [Technique::SHADOW_PHOTONS, Technique::TWO_PASS].into_iter().try_for_each(|technique| {
                let mut settings = settings.clone().with(|s| s.technique = technique);
                self.swept.set(&mut settings, value);
                settings.check()
            })
        })
    }
}

/// The effect of a setting.
#[derive(Clone, Debug, Serialize)]
pub struct Sweep {
    /// The setting.
    pub setting: Swept,
    /// One entry per value, ascending.
    pub points: Vec<SweepPoint>,
}

/// The effect of one value of a setting.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct SweepPoint {
    /// The value.
    pub value: u32,
    /// Boundary and unknown points over all points, with one sample at the centre of each pixel.
    pub boundary_share: f64,
    /// See [`Classes`].
    pub fill: Interval,
    /// See [`Classes`].
    pub miss: Interval,
    /// `shadow-photons` without fine cells, so that photons alone decide.
    pub photons_alone: Savings,
    /// `shadow-photons` with fine cells.
    pub fine_cells: Savings,
}

/// A render of `shadow-photons` with 64 samples per pixel, compared with one of `two-pass`.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Savings {
    /// relMSE.
    pub relmse: f64,
    /// Shadow rays.
    pub shadow_rays: u64,
    /// 1 - shadow rays over those of `two-pass`.
    pub reduction: f64,
    /// Photon rays, shadow rays and audits over the shadow rays of `two-pass`.
    pub rays: f64,
    /// See [`Points::fill_seen`](crate::statistics::Points::fill_seen).
    pub fill_seen: f64,
    /// See [`Audits::miss_bias`](crate::statistics::Audits::miss_bias).
    pub miss_bias: Interval,
    /// Render time over the render time of `two-pass`; both are medians of renders in turn.
    pub time: f64,
}

impl Sweep {
    /// Renders `shadow-photons` and `two-pass` with every value of the range. `None` once `stop` returns true.
    ///
    /// # Errors
    /// As [`crate::Renderer::new`]; [`Error::Usage`] if the scene needs no visibility map.
    pub fn new(
        subject: &Subject<'_>,
        range: &Range,
        reference: &Reference,
        truth: &Truth,
        stop: &dyn Fn() -> bool,
    ) -> Result<Option<Sweep>> {
        let technique = Technique::SHADOW_PHOTONS;
        let mut points = Vec::new();
        for value in range.values() {
            let mut settings = subject.settings.clone().with(|s| {
                s.technique = technique;
                s.image.spp = SAMPLES;
                s.image.aovs = Vec::new();
            });
            range.swept.set(&mut settings, value);
            let subject = Subject { settings: &settings, ..*subject };
            let Some(classes) = Classes::new(&subject, technique, truth)? else {
                return Err(Error::Usage("`sweep`: the scene needs no visibility map".to_owned()));
            };
            let Some([photons_alone, fine_cells]) = savings(&subject, reference, stop)? else { return Ok(None) };
            points.push(SweepPoint {
                value,
                boundary_share: classes.boundary_share(),
                fill: classes.fill,
                miss: classes.miss,
                photons_alone,
                fine_cells,
            });
        }
        Ok(Some(Sweep { setting: range.swept, points }))
    }
}

/// Renders `shadow-photons` with photons alone and with fine cells, in turn with `two-pass`. `None` once `stop` returns
/// true.
fn savings(subject: &Subject<'_>, reference: &Reference, stop: &dyn Fn() -> bool) -> Result<Option<[Savings; 2]>> {
    let photons_alone = subject.settings.clone().with(|s| s.visibility_map.fine_cells = false);
    let two_pass = subject.settings.clone().with(|s| s.technique = Technique::TWO_PASS);
    let compared = [&two_pass, &photons_alone, subject.settings];
    let mut renders: [Vec<(Image, Statistics)>; 3] = Default::default();
    for _ in 0..ROUNDS {
        for (settings, renders) in compared.into_iter().zip(&mut renders) {
            if stop() {
                return Ok(None);
            }
            renders.push(render(subject, settings)?);
        }
    }
    let [baseline, others @ ..] = &renders;
    let all = baseline[0].1.rays.shadow.max(1) as f64;
    let savings = |renders: &[(Image, Statistics)]| -> Result<Savings> {
        // Rounds differ in time alone.
        let (image, Statistics { rays, points, audits, .. }) = &renders[0];
        let [low, high] = audits.miss_bias_interval;
        Ok(Savings {
            relmse: metrics::relmse(image, &reference.image)?,
            shadow_rays: rays.shadow,
            reduction: 1.0 - rays.shadow as f64 / all,
            rays: (rays.photon + rays.shadow + rays.audit) as f64 / all,
            fill_seen: points.fill_seen,
            miss_bias: Interval { value: audits.miss_bias, low, high },
            time: median_time(renders) / median_time(baseline),
        })
    };
    let [photons_alone, fine_cells] = others;
    Ok(Some([savings(photons_alone)?, savings(fine_cells)?]))
}

fn render(subject: &Subject<'_>, settings: &Settings) -> Result<(Image, Statistics)> {
    let mut renderer = subject.renderer(settings)?;
    while renderer.samples() < SAMPLES {
        renderer.render_batch()?;
    }
    Ok((renderer.image()?.colour(), renderer.statistics()?))
}

fn median_time(renders: &[(Image, Statistics)]) -> f64 {
    let mut times: Vec<f64> = renders.iter().map(|(_, statistics)| statistics.time.render).collect();
    times.sort_by(f64::total_cmp);
    times[times.len() / 2]
}
