//! Sweeps: the effect of a setting of the visibility map on error, rays and classes.

use std::str::FromStr;

use serde::Serialize;

use super::classes::{Classes, Truth};
use super::interval::Interval;
use super::metrics;
use super::reference::Reference;
use super::run::{Subject, colour};
use crate::settings::{Settings, Technique};
use crate::{Error, Result};

/// Number of values of a sweep, at equal ratios: at least two per decade in a sweep over three decades.
const VALUES: u32 = 7;

/// Samples per pixel of the renders whose error and rays are measured: enough for several repairs of the map.
const SAMPLES: u32 = 16;

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
            format!("a range of {names} is expected, like photons=1e3..1e6")
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
    /// The values, ascending.
    fn values(&self) -> Vec<u32> {
        let [from, to] = [self.from, self.to].map(f64::from);
        let value = |i: u32| (from * (to / from).powf(f64::from(i) / f64::from(VALUES - 1))).round() as u32;
        let mut values: Vec<u32> = (0..VALUES).map(value).collect();
        values.dedup();
        values
    }

    /// Checks the settings with every value of the range.
    ///
    /// # Errors
    /// As [`Settings::check`].
    pub fn check(&self, settings: &Settings) -> Result<()> {
        self.values().into_iter().try_for_each(|value| {
            let mut settings = settings.clone();
            self.swept.set(&mut settings, value);
            settings.check()
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
    /// relMSE after 16 samples per pixel.
    pub relmse: f64,
    /// Shadow rays of those samples.
    pub shadow_rays: u64,
    /// Boundary and unknown points over all points, with one sample at the centre of each pixel.
    pub boundary_share: f64,
    /// See [`Classes`].
    pub fill: Interval,
    /// See [`Classes`].
    pub miss: Interval,
}

impl Sweep {
    /// Renders `shadow-photons` with every value of the range. `None` once `stop` returns true.
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
            if stop() {
                return Ok(None);
            }
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
            let mut renderer = subject.renderer(&settings)?;
            while renderer.samples() < SAMPLES {
                renderer.render_batch()?;
            }
            points.push(SweepPoint {
                value,
                relmse: metrics::relmse(&colour(renderer.image()?), &reference.image)?,
                shadow_rays: renderer.statistics()?.rays.shadow,
                boundary_share: classes.boundary_share(),
                fill: classes.fill,
                miss: classes.miss,
            });
        }
        Ok(Some(Sweep { setting: range.swept, points }))
    }
}
