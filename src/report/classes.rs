//! Confusion matrices: the classes that photons or cells give to points, against true visibility.

use std::fs;
use std::path::Path;

use serde::Serialize;

use super::interval::Interval;
use super::run::Subject;
use crate::settings::{Aov, LightSampling, Settings, Technique};
use crate::specialisation::features::Feature;
use crate::statistics::NORMAL_QUANTILE;
use crate::{Error, Image, Result};

/// Points on each light; their shadow rays measure the true visibility of a point.
const LIGHT_POINTS: u32 = 256;

/// Maximum number of pixels times lights: true visibility of more points would take more than 10^9 rays.
const MAX_POINTS: u64 = 1 << 22;

/// True visibility of each light at the centre of each pixel, by shadow rays to all light points.
pub struct Truth(Image);

/// Classes of the points of one technique at the centre of each pixel, against true visibility.
#[derive(Clone, Debug, Serialize)]
pub struct Classes {
    /// The technique.
    pub technique: Technique,
    /// Pairs of a pixel and a light with some of the light in front of the surface.
    pub points: u64,
    /// Points classified lit.
    pub lit: Confusion,
    /// Points classified shadowed.
    pub shadowed: Confusion,
    /// Points classified boundary.
    pub boundary: Confusion,
    /// Points classified unknown.
    pub unknown: Confusion,
    /// Share of penumbra points (0 < V < 1) among the boundary and unknown points.
    pub fill: Interval,
    /// Points classified lit with V below 1 or shadowed with V above 0, over all points.
    pub miss: Interval,
    /// Mean of |V - c| over all points; c is 1 if lit, 0 if shadowed, and V in the other classes.
    pub miss_bias: Interval,
    /// The class of each pixel over all lights, by the codes of [`Aov::Shadow`]. The first that occurs of boundary,
    /// unknown, lit and shadowed wins.
    #[serde(skip)]
    pub map: Vec<u8>,
}

/// Points of one class by their true visibility.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Confusion {
    /// V = 0.
    pub hidden: u64,
    /// 0 < V < 1.
    pub penumbra: u64,
    /// V = 1.
    pub visible: u64,
}

impl Confusion {
    fn total(&self) -> u64 {
        self.hidden + self.penumbra + self.visible
    }
}

impl Truth {
    /// Reads the visibility from `folder`, or traces all shadow rays and saves the result there. `None` if there are
    /// too many points.
    ///
    /// # Errors
    /// As [`Reference::make`](super::reference::Reference::make).
    pub fn make(subject: &Subject<'_>, folder: &Path) -> Result<Option<Truth>> {
        let (width, height) = (subject.settings.image.width, subject.settings.image.height);
        if u64::from(width) * u64::from(height) * subject.scene.lights.len() as u64 > MAX_POINTS {
            return Ok(None);
        }
        let file = folder.join("visibility.exr");
        // A damaged file, or one of another size, is replaced.
        let fits = |image: &Image| (image.width, image.height) == (width, height);
        if let Some(image) = Image::read(&file).ok().filter(fits) {
            return Ok(Some(Truth(image)));
        }
        // If the loop budget of an invocation is too small for all light points, they are split over several renders.
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
    /// Classifies the points of a technique. `None` if it has left out its visibility map.
    ///
    /// # Errors
    /// As [`crate::Renderer::new`].
    pub fn new(subject: &Subject<'_>, technique: Technique, truth: &Truth) -> Result<Option<Classes>> {
        let (image, classified) = render(subject, &one_sample(subject, technique))?;
        if !classified {
            return Ok(None);
        }
        let mut counts = [Confusion::default(); CODES];
        // Sums of |V - c|.
        let (mut sum, mut squares) = (0.0, 0.0);
        let mut map = vec![0; image.pixels()];
        let classes = image.channels.iter().filter_map(|channel| Some((channel, channel.name.strip_suffix(".class")?)));
        // There are no visibility photons for the environment, the last light.
        for (channel, light) in classes.take(subject.scene.placed_lights().len()) {
            let Some(visibility) = truth.0.channel(&format!("{light}.visibility")) else { continue };
            for ((class, visibility), shown) in channel.samples.iter().zip(visibility).zip(&mut map) {
                let (class, visibility) = ((*class as usize).min(CODES - 1), f64::from(*visibility));
                let count = &mut counts[class];
                *match visibility {
                    v if v <= 0.0 => &mut count.hidden,
                    v if v < 1.0 => &mut count.penumbra,
                    _ => &mut count.visible,
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
        let missed = lit.hidden + lit.penumbra + shadowed.penumbra + shadowed.visible;
        let n = points.max(1) as f64;
        let mean = sum / n;
        // The mean over this many points is normally distributed.
        let half = NORMAL_QUANTILE * ((squares / n - mean * mean).max(0.0) / n).sqrt();
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

    /// Boundary and unknown points over all points.
    pub fn boundary_share(&self) -> f64 {
        (self.boundary.total() + self.unknown.total()) as f64 / self.points.max(1) as f64
    }

    /// The pixels that need shadow rays: those classified boundary or unknown.
    pub fn mask(&self) -> Vec<bool> {
        self.map.iter().map(|class| usize::from(*class) > SHADOWED).collect()
    }
}

/// Codes of [`Aov::Shadow`].
const LIT: usize = 1;
const SHADOWED: usize = 2;
const CODES: usize = 5;

/// Precedence of each class in a pixel where lights differ, by code.
const PRECEDENCE: [u8; CODES] = [0, 2, 1, 4, 3];

/// Settings for one sample at the centre of each pixel, direct light only, with the class channels.
fn one_sample(subject: &Subject<'_>, technique: Technique) -> Settings {
    subject.settings.clone().with(|s| {
        s.technique = technique;
        s.image.spp = 1;
        // The class channels are those of all lights.
        s.light_sampling.strategy = Some(LightSampling::All);
        s.indirect.max_bounces = 0;
        s.image.aovs = vec![Aov::Shadow];
    })
}

/// True visibility by the mean of `parts` renders, each with its share of the light points.
fn visibility(subject: &Subject<'_>, parts: u32) -> Result<Image> {
    let part = |index: u32| -> Result<Image> {
        let settings = one_sample(subject, Technique::TWO_PASS);
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
    // `parts` is a power of two: the division is exact, so a visibility of 1 stays 1.
    mean.channels.iter_mut().flat_map(|channel| &mut channel.samples).for_each(|x| *x /= parts as f32);
    Ok(mean)
}

/// Renders one batch. Returns the image, and whether a map, cells or lists classified points.
fn render(subject: &Subject<'_>, settings: &Settings) -> Result<(Image, bool)> {
    let mut renderer = subject.renderer(settings)?;
    renderer.render_batch()?;
    let features = &renderer.specialisation().features;
    let classifying = [Feature::VisibilityMap, Feature::Cells, Feature::LightBuffer];
    Ok((renderer.image()?, classifying.into_iter().any(|feature| features.has(feature))))
}
