//! How well photons, or cells, tell lit, shadowed and boundary points apart: their classes against true visibility.

use std::fs;
use std::path::Path;

use serde::Serialize;

use crate::settings::{Aov, Settings, Technique};
use crate::{Error, Image, Result};

use super::interval::Interval;
use super::run::Subject;

/// Light points that tell what a point's true visibility is, as DESIGN has it.
const LIGHT_POINTS: u32 = 256;

/// Classes are left out where there are more points: the truth about them would take a thousand million rays.
const MOST_POINTS: u64 = 1 << 22;

/// The visibility of each light through the middle of each pixel, from all shadow rays.
pub struct Truth(Image);

/// Classes of the points of one technique, through the middle of each pixel.
#[derive(Clone, Debug, Serialize)]
pub struct Classes {
    /// The technique.
    pub technique: Technique,
    /// Points: with some of the light in front of the surface.
    pub points: u64,
    /// Those classed lit.
    pub lit: Confusion,
    /// Those classed shadowed.
    pub shadowed: Confusion,
    /// Those classed boundary.
    pub boundary: Confusion,
    /// Those classed unknown.
    pub unknown: Confusion,
    /// Penumbra points that are boundary or unknown over all boundary and unknown points.
    pub fill: Interval,
    /// Points classed lit or shadowed whose visibility is not 1 or 0, over all points.
    pub miss: Interval,
    /// The mean over all points of |V - c| where the class decides.
    pub miss_bias: Interval,
    /// The class of each pixel by the codes of [`Aov::Shadow`]: boundary or unknown where that is so for any light,
    /// else lit where it is for any.
    #[serde(skip)]
    pub map: Vec<u8>,
}

/// Points of one class by what is true.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Confusion {
    /// V = 0.
    pub hidden: u64,
    /// 0 < V < 1.
    pub penumbra: u64,
    /// V = 1.
    pub seen: u64,
}

impl Confusion {
    fn total(&self) -> u64 {
        self.hidden + self.penumbra + self.seen
    }
}

impl Truth {
    /// Asks all shadow rays, or reads what `folder` has; none where there are too many points.
    ///
    /// # Errors
    /// As [`Reference::make`](super::reference::Reference::make).
    pub fn make(subject: &Subject<'_>, folder: &Path) -> Result<Option<Truth>> {
        let (width, height) = (subject.settings.image.width, subject.settings.image.height);
        if u64::from(width) * u64::from(height) * subject.scene.lights.len() as u64 > MOST_POINTS {
            return Ok(None);
        }
        let file = folder.join("visibility.exr");
        // One that is damaged, or of another size, is made anew.
        let whole = |image: &Image| (image.width, image.height) == (width, height);
        if let Some(image) = Image::read(&file).ok().filter(whole) {
            return Ok(Some(Truth(image)));
        }
        // As many light points in fewer of an invocation's loops, where these have no room for them all.
        let mut parts = 1;
        let image = loop {
            match visibility(subject, parts) {
                Err(Error::Computation { .. }) if parts < LIGHT_POINTS => parts *= 4,
                made => break made?,
            }
        };
        fs::create_dir_all(folder).map_err(|problem| Error::output(folder, problem))?;
        image.write_exr(&file)?;
        Ok(Some(Truth(image)))
    }
}

impl Classes {
    /// Classes the points of a technique; none where it has left its visibility map out.
    ///
    /// # Errors
    /// As [`crate::Renderer::new`].
    pub fn new(subject: &Subject<'_>, technique: Technique, truth: &Truth) -> Result<Option<Classes>> {
        let (image, classed) = render(subject, &one_sample(subject, technique))?;
        if !classed {
            return Ok(None);
        }
        let mut counts = [Confusion::default(); CODES];
        // Of |V - c| over the decided points.
        let (mut sum, mut squares) = (0.0, 0.0);
        let mut map = vec![0; image.pixels()];
        let classes = image.channels.iter().filter_map(|channel| Some((channel, channel.name.strip_suffix(".class")?)));
        // Photons are not asked about the environment, the last light.
        for (channel, light) in classes.take(subject.scene.placed_lights().len()) {
            let Some(visibility) = truth.0.channel(&format!("{light}.visibility")) else { continue };
            for ((class, visibility), shown) in channel.samples.iter().zip(visibility).zip(&mut map) {
                let (class, visibility) = ((*class as usize).min(CODES - 1), f64::from(*visibility));
                let count = &mut counts[class];
                *match visibility {
                    v if v <= 0.0 => &mut count.hidden,
                    v if v < 1.0 => &mut count.penumbra,
                    _ => &mut count.seen,
                } += 1;
                let wrong = match class {
                    LIT => 1.0 - visibility,
                    SHADOWED => visibility,
                    _ => 0.0,
                };
                sum += wrong;
                squares += wrong * wrong;
                if PRECEDENCE[class] > PRECEDENCE[usize::from(*shown)] {
                    *shown = class as u8;
                }
            }
        }
        let [_, lit, shadowed, boundary, unknown] = counts;
        let points: u64 = counts[LIT..].iter().map(Confusion::total).sum();
        let missed = lit.hidden + lit.penumbra + shadowed.penumbra + shadowed.seen;
        let n = points.max(1) as f64;
        let mean = sum / n;
        // The mean of so many is normally distributed: 97.5 % quantile.
        let half = 1.959_964 * ((squares / n - mean * mean).max(0.0) / n).sqrt();
        Ok(Some(Classes {
            technique,
            points,
            lit,
            shadowed,
            boundary,
            unknown,
            fill: Interval::of_share(boundary.penumbra + unknown.penumbra, boundary.total() + unknown.total()),
            miss: Interval::of_share(missed, points),
            miss_bias: Interval { value: mean, low: (mean - half).max(0.0), high: mean + half },
            map,
        }))
    }

    /// Boundary and unknown points over all.
    pub fn boundary_share(&self) -> f64 {
        (self.boundary.total() + self.unknown.total()) as f64 / self.points.max(1) as f64
    }

    /// Pixels where shadow rays are asked.
    pub fn mask(&self) -> Vec<bool> {
        self.map.iter().map(|class| usize::from(*class) > SHADOWED).collect()
    }
}

/// Codes of [`Aov::Shadow`].
const LIT: usize = 1;
const SHADOWED: usize = 2;
const CODES: usize = 5;

/// Which class shows where lights differ, by code.
const PRECEDENCE: [u8; CODES] = [0, 2, 1, 4, 3];

/// Settings for one sample through the middle of each pixel, direct light alone, with the photons' verdicts.
fn one_sample(subject: &Subject<'_>, technique: Technique) -> Settings {
    subject.settings.clone().with(|s| {
        s.technique = technique;
        s.image.spp = 1;
        s.indirect.max_bounces = 0;
        s.image.aovs = vec![Aov::Shadow];
    })
}

/// Visibility by `parts` renders, each with its share of the light points.
fn visibility(subject: &Subject<'_>, parts: u32) -> Result<Image> {
    let part = |index: u32| {
        let settings = one_sample(subject, Technique::TwoPass);
        let seed = settings.image.seed.wrapping_add(index);
        Ok(render(
            subject,
            &settings.with(|s| {
                s.shadow_rays.samples = LIGHT_POINTS / parts;
                s.image.seed = seed;
            }),
        )?
        .0)
    };
    let mut mean = part(0)?;
    for index in 1..parts {
        for (sum, channel) in mean.channels.iter_mut().zip(&part(index)?.channels) {
            sum.samples.iter_mut().zip(&channel.samples).for_each(|(sum, x)| *sum += x);
        }
    }
    // Halves and quarters are exact in f32, so that a visibility of 1 stays 1.
    mean.channels.iter_mut().flat_map(|channel| &mut channel.samples).for_each(|x| *x /= parts as f32);
    Ok(mean)
}

/// The image, and whether there was something to class points by.
fn render(subject: &Subject<'_>, settings: &Settings) -> Result<(Image, bool)> {
    let mut renderer = subject.renderer(settings)?;
    renderer.render_batch()?;
    let features = &renderer.specialisation().features;
    Ok((renderer.image()?, features.has("visibility_map") || features.has("cells")))
}
