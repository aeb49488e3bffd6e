//! What a setting of the visibility map does to error, rays and classes.

use std::str::FromStr;

use serde::Serialize;

use crate::settings::{Settings, Technique};
use crate::{Error, Result};

use super::classes::{Classes, Truth};
use super::interval::Interval;
use super::metrics;
use super::reference::Reference;
use super::run::{Subject, colour};

/// Values of a sweep, at equal ratios: two or more to each factor of ten of a sweep over a thousandfold.
const VALUES: u32 = 7;

/// Samples a pixel of the renders whose error and rays are told: enough that the map is mended several times.
const SAMPLES: u32 = 16;

/// A setting that can be swept.
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

    /// The power of the setting with which the boundary share goes at hard edges: boundaries are as wide as the radius of
    /// the nearest photons, the root of their number over their density.
    pub fn law(self) -> f64 {
        match self {
            Swept::Photons => -0.5,
            Swept::Nearest => 0.5,
        }
    }

    fn set(self, settings: &mut Settings, value: u32) {
        match self {
            Swept::Photons => settings.visibility_map.photons_per_light = value,
            Swept::Nearest => settings.visibility_map.nearest = value,
        }
    }
}

/// A setting and its first and last value.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Range {
    swept: Swept,
    from: u32,
    to: u32,
}

impl FromStr for Range {
    type Err = String;

    /// From `photons=1e3..1e6`.
    fn from_str(text: &str) -> std::result::Result<Self, String> {
        let form = || {
            let names = Swept::ALL.map(Swept::name).join(" or ");
            format!("it must be like photons=1e3..1e6, of {names}")
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
    /// From the first to the last, in order.
    fn values(&self) -> Vec<u32> {
        let [from, to] = [self.from, self.to].map(f64::from);
        let value = |i: u32| (from * (to / from).powf(f64::from(i) / f64::from(VALUES - 1))).round() as u32;
        let mut values: Vec<u32> = (0..VALUES).map(value).collect();
        values.dedup();
        values
    }

    /// Says whether the settings hold for every value.
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

/// What a setting does.
#[derive(Clone, Debug, Serialize)]
pub struct Sweep {
    /// The setting.
    pub setting: Swept,
    /// A value each.
    pub points: Vec<SweepPoint>,
}

/// What a value of a setting does.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct SweepPoint {
    /// The value.
    pub value: u32,
    /// relMSE after 16 samples a pixel.
    pub relmse: f64,
    /// Shadow rays until then.
    pub shadow_rays: u64,
    /// Boundary and unknown points over all, of one sample through the middle of each pixel.
    pub boundary_share: f64,
    /// See [`Classes`].
    pub fill: Interval,
    /// See [`Classes`].
    pub miss: Interval,
}

impl Sweep {
    /// Renders with every value of the range by shadow photons. Nothing where `stop` says so.
    ///
    /// # Errors
    /// As [`crate::Renderer::new`]; [`Error::Usage`] where the scene needs no visibility map.
    pub fn new(
        subject: &Subject<'_>,
        range: &Range,
        reference: &Reference,
        truth: &Truth,
        stop: &dyn Fn() -> bool,
    ) -> Result<Option<Sweep>> {
        let technique = Technique::ShadowPhotons;
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
