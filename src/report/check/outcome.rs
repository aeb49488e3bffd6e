//! The outcome of a case.

use std::borrow::Cow;

use super::cases::Case;
use super::comparison::{Comparison, device_kind, different_pixels, kind_of};
use crate::count::count;
use crate::render::film::{Image, View};

/// The finding of a case.
#[derive(Clone, Debug, PartialEq)]
pub enum Finding {
    /// The image is within its limits.
    Passed,
    /// The image is the new baseline.
    Blessed,
    /// Limits are exceeded, or two runs differ: reasons.
    Failed(Vec<String>),
    /// There is nothing to compare: the reason.
    Broken(String),
}

/// The outcome of a case.
#[derive(Clone, Debug)]
pub struct Outcome {
    /// The case.
    pub case: Case,
    /// The finding.
    pub finding: Finding,
    /// The command that makes the image; empty for images of other renderers.
    pub command: String,
    /// Seconds that it took.
    pub seconds: f64,
    /// The new image.
    pub image: Option<Image>,
    /// The image that it should be.
    pub baseline: Option<Image>,
    /// How far both are from each other.
    pub comparison: Option<Comparison>,
    /// Number of pixels in which two runs differ in a bit; `None` if there was one run.
    pub unlike: Option<usize>,
}

impl Outcome {
    /// The outcome of a case without an image.
    pub fn broken(case: &Case, command: String, seconds: f64, problem: String) -> Outcome {
        Outcome {
            case: case.clone(),
            finding: Finding::Broken(problem),
            command,
            seconds,
            image: None,
            baseline: None,
            comparison: None,
            unlike: None,
        }
    }

    /// Compares the images of one or two runs with the baseline, or the reason why there is none.
    pub fn of(
        case: &Case,
        command: String,
        seconds: f64,
        image: Image,
        again: Option<&Image>,
        baseline: Result<Image, String>,
    ) -> Outcome {
        let unlike = again.map(|again| different_pixels(&image, again).unwrap_or(image.pixels()));
        let mut outcome = Outcome::broken(case, command, seconds, String::new());
        outcome.unlike = unlike;
        let compared = baseline.and_then(|baseline| {
            let kinds = [device_kind(&image), device_kind(&baseline)];
            let comparison = match kinds {
                [Some(own), Some(other)] if own != other => {
                    Err(format!("the baseline is of the device {other}, but the image is of {own}"))
                }
                _ => in_format_of(case, &image)
                    .and_then(|image| Comparison::new(&image, &baseline, &case.limits))
                    .map_err(|problem| problem.to_string()),
            };
            outcome.baseline = Some(baseline);
            comparison
        });
        outcome.finding = match &compared {
            Err(problem) => Finding::Broken(problem.clone()),
            Ok(comparison) => {
                let mut reasons = comparison.exceeded(&case.limits);
                if let Some(pixels) = unlike.filter(|pixels| *pixels > 0) {
                    reasons.push(format!("two runs differ in {}", count(pixels, "pixel", "pixels")));
                }
                if reasons.is_empty() { Finding::Passed } else { Finding::Failed(reasons) }
            }
        };
        outcome.comparison = compared.ok();
        outcome.image = Some(image);
        outcome
    }

    /// Whether the case passed, or has a new baseline.
    pub fn is_good(&self) -> bool {
        matches!(self.finding, Finding::Passed | Finding::Blessed)
    }

    /// Why the image cannot become the new baseline; `None` if it can. `device` is the kind that the file of cases
    /// names.
    pub fn cannot_be_blessed(&self, device: Option<&str>) -> Option<String> {
        let Some(image) = &self.image else {
            let Finding::Broken(problem) = &self.finding else { return None };
            return Some(problem.clone());
        };
        if let Some(pixels) = self.unlike.filter(|pixels| *pixels > 0) {
            return Some(format!("two runs differ in {}", count(pixels, "pixel", "pixels")));
        }
        let own = device_kind(image)?;
        let of_baseline = self.baseline.as_ref().and_then(device_kind);
        let other = device.map(kind_of).or(of_baseline).filter(|other| *other != own)?;
        Some(format!("the baselines are of the device {other}, but the image is of {own}"))
    }

    /// The image as a baseline: colours, and the device.
    pub fn new_baseline(&self) -> Option<Image> {
        self.image.as_ref().map(as_baseline)
    }

    /// The finding in a word.
    pub fn word(&self) -> &'static str {
        match self.finding {
            Finding::Passed => "passed",
            Finding::Blessed => "blessed",
            Finding::Failed(_) => "failed",
            Finding::Broken(_) => "broken",
        }
    }

    /// Why the case is not good; empty if it is.
    pub fn reasons(&self) -> String {
        match &self.finding {
            Finding::Passed | Finding::Blessed => String::new(),
            Finding::Failed(reasons) => reasons.join("; "),
            Finding::Broken(problem) => problem.clone(),
        }
    }
}

/// The colours of an image, and the device.
fn as_baseline(image: &Image) -> Image {
    let mut image = image.colour();
    image.metadata.retain(|name, _| name.starts_with("penumbra:device") || name == "penumbra:driver");
    (image.crop, image.transparent) = (None, false);
    image
}

/// The image in the precision of its baseline: a PNG has eight bits per channel, and nothing brighter than white.
fn in_format_of<'a>(case: &Case, image: &'a Image) -> crate::Result<Cow<'a, Image>> {
    match case.baseline.extension() {
        Some(extension) if extension.eq_ignore_ascii_case("png") => {
            let png = as_baseline(image).to_png(View::Standard, 0.0)?;
            Image::from_bytes(&png, &case.baseline).map(Cow::Owned)
        }
        _ => Ok(Cow::Borrowed(image)),
    }
}
