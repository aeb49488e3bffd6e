//! `report.html`: one page with everything in it, for a browser without a network.

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use half::f16;
use serde::Serialize;

use crate::{Error, Image, Result};

use super::document::Report;
use super::plot;
use super::reference::Reference;
use super::run::Run;

/// The page holds the last images, and those before them until they are so many bytes: what a browser still opens at once.
const MOST_BYTES: usize = 48 << 20;

/// Values of an image's pixel take so many bytes: three halves.
const PIXEL_BYTES: usize = 6;

/// What the page's script reads.
#[derive(Serialize)]
struct Data<'a> {
    report: &'a Report,
    width: u32,
    height: u32,
    /// Stored values times this are radiance.
    scale: f32,
    /// The reference, then images of the first runs.
    views: Vec<View>,
    /// The class of each pixel, a byte each, in base64.
    classes: Option<String>,
}

#[derive(Serialize)]
struct View {
    name: String,
    /// Red, then green, then blue: little-endian halves, in base64.
    pixels: String,
}

/// The page.
///
/// # Errors
/// As the functions of [`plot`].
pub fn page(report: &Report, reference: &Reference, runs: &[Run]) -> Result<String> {
    let image = &reference.image;
    // A power of two keeps the digits, and a half ends at 65,504.
    let brightest = image.channels.iter().flat_map(|channel| &channel.samples).fold(1.0f32, |most, x| most.max(*x));
    let scale = (brightest.log2().ceil() - 14.0).max(0.0).exp2();
    let mut views = vec![View { name: "reference".to_owned(), pixels: pixels(image, scale) }];
    for (run, index) in shown(runs, image.pixels()) {
        let snapshot = &run.snapshots[index];
        let name = format!("{}, {} s", run.settings.technique, snapshot.budget);
        views.push(View { name, pixels: pixels(&snapshot.image, scale) });
    }
    let classes = report.classes.first().map(|classes| STANDARD.encode(&classes.map));
    let data = Data { report, width: image.width, height: image.height, scale, views, classes };
    let data = serde_json::to_string(&data).map_err(|problem| Error::output("report.html", problem))?;

    let mut plots = vec![
        ("error", plot::error_over_time(report)?),
        ("rays", plot::error_over_rays(report)?),
        ("passes", plot::time_by_pass(report)?),
    ];
    for sweep in &report.sweeps {
        plots.push((sweep.setting.name(), plot::sweep(sweep)?));
    }
    let figure = |(id, svg): &(&str, String)| format!("<figure id=\"{id}\">{}</figure>\n", themed(svg));
    let plots: String = plots.iter().map(figure).collect();
    Ok(include_str!("page/page.html")
        .replace("{{style}}", include_str!("page/page.css"))
        .replace("{{script}}", include_str!("page/page.js"))
        .replace("{{plots}}", &plots)
        // The one thing that could end the element that holds the data.
        .replace("{{data}}", &data.replace('<', "\\u003c")))
}

/// First runs, and which of their snapshots the page has room for, the last ones first in line.
fn shown(runs: &[Run], pixels: usize) -> Vec<(&Run, usize)> {
    let mut first: Vec<&Run> = Vec::new();
    for run in runs {
        if first.iter().all(|other| other.settings.technique != run.settings.technique) {
            first.push(run);
        }
    }
    // A third is what base64 adds.
    let room = MOST_BYTES / (pixels * PIXEL_BYTES * 4 / 3);
    let each = (room / first.len().max(1)).max(1);
    let all = first.into_iter().flat_map(|run| {
        let count = run.snapshots.len();
        (count.saturating_sub(each)..count).map(move |index| (run, index))
    });
    all.collect()
}

fn pixels(image: &Image, scale: f32) -> String {
    let channels = ["R", "G", "B"].into_iter().filter_map(|name| image.channel(name));
    let bytes: Vec<u8> = channels.flatten().flat_map(|x| f16::from_f32(x / scale).to_le_bytes()).collect();
    STANDARD.encode(bytes)
}

/// A plot that takes the page's colours instead of black on white.
fn themed(svg: &str) -> String {
    svg.replace("\"#000000\"", "\"currentColor\"").replace("\"#FFFFFF\"", "\"var(--back)\"")
}
