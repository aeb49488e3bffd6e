//! `penumbra table1`.

use std::path::PathBuf;

use kernel_kit::{DeviceChoice, Gpu};
use penumbra::internal::render::film;
use penumbra::internal::report::table1::{Comparison, Options, SCENES, TECHNIQUES, notes, page};
use penumbra::{Result, Technique};

use super::progress::{Display, Goal};
use super::{Ending, cache, print, say, write_text};

#[derive(clap::Args)]
#[command(allow_negative_numbers = true)]
pub struct Arguments {
    /// Write a self-contained HTML page with the images side by side
    #[arg(long, value_name = "FILE", help_heading = "Output")]
    html: Option<PathBuf>,

    /// Print only the table and errors
    #[arg(long, help_heading = "Output")]
    quiet: bool,

    /// Width and height in pixels [default: about those of the paper]
    #[arg(long, value_name = "PIXELS", help_heading = "Image")]
    width: Option<u32>,

    /// Samples per pixel of every technique [default: about those of the paper]
    #[arg(long, value_name = "SAMPLES", help_heading = "Image")]
    spp: Option<u32>,

    /// Count photons regardless of their normals, as the paper does
    #[arg(long, help_heading = "Visibility map")]
    paper_counting: bool,

    /// Device: best, software, or the index or a part of the name that `penumbra devices` prints
    #[arg(long, value_name = "D", default_value = "best", help_heading = "Device")]
    device: DeviceChoice,
}

pub fn run(arguments: &Arguments) -> Result<Ending> {
    let Arguments { width, spp, paper_counting, .. } = *arguments;
    let options = Options { width, spp, paper_counting };
    SCENES[0].settings(Technique::PATH, &options).check()?;
    arguments.html.iter().try_for_each(film::check_target)?;
    let gpu = cache::with_kernels(Gpu::open(&arguments.device)?);
    let mut comparisons = Vec::new();
    for scene in &SCENES {
        let render = |technique| {
            let settings = scene.settings(technique, &options);
            if !arguments.quiet {
                say(format_args!("{}: {technique}, {} spp, on {}", scene.title, settings.image.spp, gpu.info.name));
            }
            let mut display = None;
            scene.render(&gpu, &settings, |progress| {
                // Created by the first batch, so that its clock does not count compile time.
                let goal = Goal { spp: settings.image.spp, deadline: None };
                display.get_or_insert_with(|| Display::new(goal, progress, arguments.quiet)).update(progress);
            })
        };
        let [path, all, some, none] = TECHNIQUES;
        let comparison = Comparison::new(scene, [render(path)?, render(all)?, render(some)?, render(none)?])?;
        print(&(comparison.text() + "\n"))?;
        comparisons.push(comparison);
    }
    print(&(notes(&options).join("\n") + "\n"))?;
    if let Some(path) = &arguments.html {
        let page = page(&comparisons, &options)?;
        write_text(path, &page)?;
        if !arguments.quiet {
            say(format_args!("wrote {}", path.display()));
        }
    }
    Ok(Ending::Done)
}
