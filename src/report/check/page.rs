//! `check.html`: one self-contained page with baseline, new image and difference of each case.

use std::fmt::Write;
use std::path::Path;

use base64::Engine;
use base64::engine::general_purpose::STANDARD;

use super::comparison::Comparison;
use super::outcome::{Finding, Outcome};
use crate::render::film::{Image, encode_colours};
use crate::report::format::escaped;
use crate::report::metrics::display;
use crate::{Error, Result};

/// Renders the page of the cases of `file`. `device` is the one that they ran on, and `unused` are the baselines that
/// no case uses. Cases that need attention come first.
///
/// # Errors
/// [`Error::Output`] if an image cannot be encoded.
pub fn page(file: &Path, device: Option<&str>, outcomes: &[Outcome], unused: &[String]) -> Result<String> {
    let count = |is: &dyn Fn(&Finding) -> bool| outcomes.iter().filter(|outcome| is(&outcome.finding)).count();
    let failed = count(&|finding| matches!(finding, Finding::Failed(_)));
    let broken = count(&|finding| matches!(finding, Finding::Broken(_)));
    let good = outcomes.len() - failed - broken;
    let mut body = String::new();
    let mut put = |text: &str| body.push_str(text);
    put(&format!("<h1>{}</h1>\n", escaped(&file.display().to_string())));
    let all_good = if failed + broken == 0 { "good" } else { "bad" };
    let on = device.map_or("images of another renderer".to_owned(), |name| format!("on {}", escaped(name)));
    put(&format!(
        "<p class=\"summary {all_good}\">{good} of {} cases passed, {failed} failed, {broken} broken, {on}</p>\n",
        outcomes.len()
    ));
    if !unused.is_empty() {
        put(&format!("<p class=\"note\">No case uses these baselines: {}</p>\n", escaped(&unused.join(", "))));
    }
    let mut sorted: Vec<&Outcome> = outcomes.iter().collect();
    sorted.sort_by_key(|outcome| outcome.is_good());
    for outcome in sorted {
        put(&section(outcome)?);
    }
    Ok(format!(
        "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n\
         <title>{good} of {} passed: penumbra check</title>\n<style>\n{}</style>\n</head>\n<body>\n{body}</body>\n\
         </html>\n",
        outcomes.len(),
        include_str!("page.css")
    ))
}

/// A case.
fn section(outcome: &Outcome) -> Result<String> {
    let Outcome { case, command, seconds, image, baseline, comparison, .. } = outcome;
    let word = outcome.word();
    let name = escaped(&case.name);
    let mut text = format!("<section class=\"{word}\" id=\"{name}\">\n<h2>{name} <span>{word}</span></h2>\n");
    if !outcome.is_good() {
        text += &format!("<p class=\"reasons\">{}</p>\n", escaped(&outcome.reasons()));
    }
    text += "<div class=\"images\">\n";
    text += &figure("baseline", baseline.as_ref().map(png_of).transpose()?.as_deref());
    text += &figure("new", image.as_ref().map(png_of).transpose()?.as_deref());
    let difference = image.as_ref().zip(comparison.as_ref());
    let difference = difference.map(|(image, Comparison { map, .. })| png([image.width, image.height], map));
    text += &figure("difference (FLIP)", difference.transpose()?.as_deref());
    if let (Some(image), Some(baseline)) = (image, baseline) {
        let both = [png_of(baseline)?, png_of(image)?];
        text += &format!(
            "<figure class=\"both\"><div><img alt=\"new image of {name}\" src=\"{}\"><img alt=\"baseline of {name}\" \
             src=\"{}\"></div><figcaption>new; baseline while the pointer is on it</figcaption></figure>\n",
            both[1], both[0]
        );
    }
    text += "</div>\n";
    if let Some(comparison) = comparison {
        text += &measures(outcome, comparison);
    }
    if !command.is_empty() {
        text += &format!("<p class=\"command\"><code>{}</code> in {seconds:.1} s</p>\n", escaped(command));
    }
    Ok(text + "</section>\n")
}

/// The table of measures and limits.
fn measures(outcome: &Outcome, comparison: &Comparison) -> String {
    let limits = &outcome.case.limits;
    let mut rows = String::new();
    let mut row = |name: &str, value: String, limit: String, exceeds: bool| {
        let class = if exceeds { " class=\"exceeded\"" } else { "" };
        // Writing to a string never fails.
        let _ = writeln!(rows, "<tr{class}><th>{name}</th><td>{value}</td><td>{limit}</td></tr>");
    };
    let Comparison { relmse, flip, changed, different, .. } = *comparison;
    row("relMSE", format!("{relmse:.3e}"), format!("{:e}", limits.relmse), relmse > limits.relmse);
    row("FLIP", format!("{flip:.4}"), limits.flip.to_string(), flip > limits.flip);
    row(
        &format!("pixels changed by more than {} of 255", limits.step),
        format!("{:.2} %", 100.0 * changed),
        format!("{} %", 100.0 * limits.changed),
        changed > limits.changed,
    );
    row("pixels that differ in any bit", different.to_string(), String::new(), false);
    match outcome.unlike {
        Some(pixels) => row("pixels that differ between two runs", pixels.to_string(), "0".into(), pixels > 0),
        None => row("pixels that differ between two runs", "one run".into(), "0".into(), false),
    }
    format!("<table><thead><tr><th></th><th>measured</th><th>limit</th></tr></thead><tbody>\n{rows}</tbody></table>\n")
}

fn figure(caption: &str, source: Option<&str>) -> String {
    let shown = match source {
        Some(source) => format!("<img alt=\"{caption}\" src=\"{source}\">"),
        None => "<div class=\"none\">none</div>".to_owned(),
    };
    format!("<figure>{shown}<figcaption>{caption}</figcaption></figure>\n")
}

/// The colours of an image, as a data URI.
fn png_of(image: &Image) -> Result<String> {
    png([image.width, image.height], &display("image", image)?)
}

/// 8-bit colours, as the data URI of a PNG.
fn png(size: [u32; 2], colours: &[u8]) -> Result<String> {
    let mut bytes = Vec::new();
    encode_colours(&mut bytes, size, colours).map_err(|problem| Error::output("check.html", problem))?;
    Ok(format!("data:image/png;base64,{}", STANDARD.encode(bytes)))
}
