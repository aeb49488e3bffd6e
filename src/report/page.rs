//! `report.html`: one self-contained page that needs no network.

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use half::f16;
use serde::Serialize;

use super::document::Report;
use super::plot;
use super::reference::Reference;
use super::run::Run;
use crate::{Error, Image, Result};

/// Maximum bytes of the images in the page, which a browser still opens at once. If there are more, the first images of
/// each entrant are left out.
const MAX_BYTES: usize = 48 << 20;

/// Bytes of a pixel: three half-precision floats.
const PIXEL_BYTES: usize = 6;

/// The data that the page's script reads.
#[derive(Serialize)]
struct Data<'a> {
    report: &'a Report,
    width: u32,
    height: u32,
    /// Factor from stored values to radiance.
    scale: f32,
    /// The reference, then images of the first run of each entrant.
    views: Vec<View>,
    /// The last image of the first run of each entrant with a denoiser.
    denoised: Vec<Denoised>,
    /// The class of each pixel, one byte each, in base64.
    classes: Option<String>,
}

#[derive(Serialize)]
struct View {
    name: String,
    /// All red, then all green, then all blue values: little-endian half-precision floats, in base64.
    pixels: String,
}

/// An image without noise, and what it was made of.
#[derive(Serialize)]
struct Denoised {
    /// Indices of views.
    denoised: usize,
    raw: usize,
    /// The estimated standard error of each pixel, encoded as the values of the views; `None` if it is not known.
    error: Option<String>,
}

/// Renders the page.
///
/// # Errors
/// As the functions of [`plot`].
pub fn page(report: &Report, reference: &Reference, runs: &[Run]) -> Result<String> {
    let image = &reference.image;
    // A half-precision float ends at 65,504. Scaling by a power of two is exact.
    let brightest = image.channels.iter().flat_map(|channel| &channel.samples).fold(1.0f32, |max, x| max.max(*x));
    let scale = (brightest.log2().ceil() - 14.0).max(0.0).exp2();
    let mut views = vec![View { name: "reference".to_owned(), pixels: colours(image, scale) }];
    let mut denoised = Vec::new();
    for (run, index) in snapshots_shown(runs, image.pixels()) {
        let snapshot = &run.snapshots[index];
        let name = format!("{}, {} s", run.entrant(), snapshot.budget);
        let is_last = index + 1 == run.snapshots.len();
        if let Some(noisy) = run.noisy.as_ref().filter(|_| is_last) {
            let error = noisy.channel("error").map(|error| pixels([error], scale));
            denoised.push(Denoised { raw: views.len(), denoised: views.len() + 1, error });
            views.push(View { name: format!("{name}, raw"), pixels: colours(noisy, scale) });
        }
        views.push(View { name, pixels: colours(&snapshot.image, scale) });
    }
    let classes = report.classes.first().map(|classes| STANDARD.encode(&classes.map));
    let data = Data { report, width: image.width, height: image.height, scale, views, denoised, classes };
    let data = serde_json::to_string(&data).map_err(|problem| Error::output("report.html", problem))?;

    let mut plots = vec![
        ("error", plot::error_over_time(report)?),
        ("rays", plot::error_over_rays(report)?),
        ("passes", plot::time_by_pass(report)?),
    ];
    for sweep in &report.sweeps {
        plots.push((sweep.setting.name(), plot::sweep(sweep)?));
        plots.push(("savings", plot::savings(sweep)?));
    }
    let figure = |(id, svg): &(&str, String)| format!("<figure id=\"{id}\">{}</figure>\n", themed(svg));
    let plots: String = plots.iter().map(figure).collect();
    Ok(include_str!("page/page.html")
        .replace("{{style}}", include_str!("page/page.css"))
        .replace("{{script}}", include_str!("page/page.js"))
        .replace("{{plots}}", &plots)
        // Without `<`, no text in the data can end its script element.
        .replace("{{data}}", &data.replace('<', "\\u003c")))
}

/// The first run of each entrant, with the indices of the snapshots that fit into the page: the last ones.
fn snapshots_shown(runs: &[Run], pixels: usize) -> Vec<(&Run, usize)> {
    let mut first: Vec<&Run> = Vec::new();
    for run in runs {
        if first.iter().all(|other| other.entrant() != run.entrant()) {
            first.push(run);
        }
    }
    // Base64 adds a third.
    let room = MAX_BYTES / (pixels * PIXEL_BYTES * 4 / 3);
    // The raw image and the error of a denoised one take no more than two images.
    let beside = 2 * first.iter().filter(|run| run.noisy.is_some()).count();
    let each = (room.saturating_sub(beside) / first.len().max(1)).max(1);
    let all = first.into_iter().flat_map(|run| {
        let count = run.snapshots.len();
        (count.saturating_sub(each)..count).map(move |index| (run, index))
    });
    all.collect()
}

fn colours(image: &Image, scale: f32) -> String {
    pixels(["R", "G", "B"].into_iter().filter_map(|name| image.channel(name)), scale)
}

fn pixels<'a>(channels: impl IntoIterator<Item = &'a [f32]>, scale: f32) -> String {
    let bytes: Vec<u8> = channels.into_iter().flatten().flat_map(|x| f16::from_f32(x / scale).to_le_bytes()).collect();
    STANDARD.encode(bytes)
}

/// Replaces black and white in a plot by the page's colours.
fn themed(svg: &str) -> String {
    svg.replace("\"#000000\"", "\"currentColor\"").replace("\"#FFFFFF\"", "\"var(--back)\"")
}
