//! `penumbra merge`.

use std::path::PathBuf;

use penumbra::internal::render::film::{self, View, is_exr};
use penumbra::internal::render::pieces::{MissingSamples, Pieces};
use penumbra::settings::Denoise;
use penumbra::{Error, Result};

use super::options::{DeviceOptions, OidnOptions, denoisers, finite};
use super::render::both;
use super::{Ending, say};

/// Parts that a message names; the others are counted, because a sequence may lack hundreds.
const NAMED: usize = 8;

#[derive(clap::Args)]
#[command(allow_negative_numbers = true)]
pub struct Arguments {
    /// Pieces: the .exr files of `penumbra render --samples`, in any order
    #[arg(required = true, value_name = "PIECE")]
    pieces: Vec<PathBuf>,

    /// Output image: .exr (scene-linear, all channels) or .png (tone-mapped); may be given several times
    #[arg(short, long, value_name = "FILE", required = true)]
    output: Vec<PathBuf>,

    /// Write the image even if pieces are missing, and say which: each pixel is then the mean of the samples it has
    #[arg(long)]
    partial: bool,

    /// Remove noise, as `penumbra render --denoise` does, from pieces that were rendered with --denoise: a .png shows
    /// the denoised image, an .exr has it beside the raw one [default: auto if an output is .png and the pieces were
    /// rendered with --denoise, else none]
    #[arg(long, value_name = "DENOISER", value_parser = denoisers(), conflicts_with = "partial")]
    denoise: Option<Denoise>,

    #[command(flatten)]
    oidn: OidnOptions,

    #[command(flatten)]
    device: DeviceOptions,

    /// Tone mapping of .png: neutral (Khronos PBR Neutral), agx, standard (sRGB, clipped) or raw (linear values)
    #[arg(long, value_name = "VIEW", default_value_t = View::default())]
    view: View,

    /// Exposure of .png, in stops
    #[arg(long, value_name = "EV", default_value_t = 0.0, value_parser = finite::<f32>)]
    exposure: f32,

    /// Print only errors
    #[arg(long)]
    quiet: bool,
}

pub fn run(arguments: &Arguments) -> Result<Ending> {
    arguments.output.iter().try_for_each(film::check_writable)?;
    film::check_names(&arguments.pieces, &arguments.output)?;
    let pieces = Pieces::open(&arguments.pieces)?;
    let missing = pieces.missing();
    if !missing.is_empty() {
        let parts = listed(&missing);
        if !arguments.partial {
            let problem =
                format!("the image of this piece is incomplete: {parts} are in no piece; --partial writes it as it is");
            return Err(Error::input(&arguments.pieces[0], "file", problem));
        }
        if !arguments.quiet {
            say(format_args!("note: {parts} are in no piece"));
        }
    }
    let shows = arguments.output.iter().any(|path| !is_exr(path));
    let default = if shows && missing.is_empty() && pieces.have_guides() { Denoise::Auto } else { Denoise::None };
    let denoise = arguments.denoise.unwrap_or(default);
    arguments.oidn.check(denoise)?;
    let image = match denoise {
        Denoise::None => pieces.merge()?,
        denoise => {
            let denoiser = arguments.oidn.denoiser(denoise)?;
            pieces.merge_denoised(&arguments.device.open()?, &denoiser)?
        }
    };
    let mut result = Ok(());
    for path in &arguments.output {
        let outcome = image.write_shown(path, arguments.view, arguments.exposure);
        if outcome.is_ok() && !arguments.quiet {
            say(format_args!("wrote {}", path.display()));
        }
        result = both(result, outcome);
    }
    result.map(|()| Ending::Done)
}

/// The parts that are missing.
fn listed(missing: &[MissingSamples]) -> String {
    let mut parts: Vec<String> = missing.iter().take(NAMED).map(MissingSamples::to_string).collect();
    if missing.len() > NAMED {
        parts.push(format!("{} more parts", missing.len() - NAMED));
    }
    parts.join("; ")
}
