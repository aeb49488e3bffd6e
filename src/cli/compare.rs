//! `penumbra compare`.

use std::path::{Path, PathBuf};

use penumbra::internal::report::metrics::Measures;
use penumbra::{Error, Image, Result};

use super::options::finite;
use super::{Ending, print, print_json, say};

#[derive(clap::Args)]
#[command(allow_negative_numbers = true)]
pub struct Arguments {
    /// Image: .exr, .png or .hdr
    image: PathBuf,

    /// Reference, of the same size
    reference: PathBuf,

    /// Exit with code 5 if relMSE is above X
    #[arg(long, value_name = "X", value_parser = limit)]
    max_relmse: Option<f64>,

    /// Print JSON
    #[arg(long)]
    json: bool,
}

fn limit(text: &str) -> std::result::Result<f64, String> {
    finite(text).and_then(|x| if x >= 0.0 { Ok(x) } else { Err("it must be 0 or more".into()) })
}

pub fn run(arguments: &Arguments) -> Result<Ending> {
    let Arguments { image, reference, .. } = arguments;
    if is_tone_mapped(image) != is_tone_mapped(reference) {
        say(format_args!("note: one image is .png: its 8 bits and its tone mapping count as errors"));
    }
    let image = Image::read(&arguments.image)?;
    let reference = Image::read(&arguments.reference)?;
    let measures = measures((&image, &arguments.image), (&reference, &arguments.reference))?;
    if arguments.json {
        print_json(&measures)?;
    } else {
        print(&text(&measures))?;
    }
    match arguments.max_relmse {
        Some(limit) if measures.relmse > limit => {
            let image = arguments.image.display();
            say(format_args!("{image}: relMSE {:.4e} is above the limit of {limit:e}", measures.relmse));
            Ok(Ending::AboveLimit)
        }
        _ => Ok(Ending::Done),
    }
}

/// Whether the file is a .png, which holds tone-mapped values of 8 bits.
fn is_tone_mapped(path: &Path) -> bool {
    path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("png"))
}

/// A line for each measure.
pub fn text(measures: &Measures) -> String {
    let Measures { rmse, relmse, mae, p99, flip } = measures;
    let lines = [("RMSE", rmse), ("relMSE", relmse), ("MAE", mae), ("p99", p99), ("FLIP", flip)];
    lines.map(|(name, value)| format!("{name:<8}{value:.4e}\n")).concat()
}

/// The measures of an image against a reference, each with its path. Errors of the metrics have no paths: they get
/// these.
pub fn measures((image, path): (&Image, &Path), (reference, of_reference): (&Image, &Path)) -> Result<Measures> {
    Measures::new(image, reference).map_err(|error| match error {
        Error::Input { file, location, problem } => {
            let path = if file.as_os_str() == "reference" { of_reference } else { path };
            Error::Input { file: path.to_owned(), location, problem }
        }
        other => other,
    })
}
