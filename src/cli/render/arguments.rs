//! The arguments of `penumbra render`, and the checks that need neither scene nor device.

use std::path::PathBuf;
use std::time::Duration;

use penumbra::internal::render::Checkpoint;
use penumbra::internal::render::film::{self, View, is_exr};
use penumbra::settings::Denoise;
use penumbra::{Denoiser, Error, Image, Result};

use super::files::Files;
use crate::cli::options::{
    DeviceOptions, ExtentOptions, OidnOptions, RenderOptions, SceneOptions, denoisers, finite, positive,
};
use crate::cli::sequence::{Frame, SequenceOptions};

#[derive(clap::Args)]
#[command(allow_negative_numbers = true)]
pub struct Arguments {
    #[command(flatten)]
    pub scene: SceneOptions,

    /// Output image: .exr (scene-linear, all channels) or .png (tone-mapped); may be given several times
    #[arg(short, long, value_name = "FILE", required = true, help_heading = "Output")]
    pub output: Vec<PathBuf>,

    /// Tone mapping of .png: neutral (Khronos PBR Neutral), agx, standard (sRGB, clipped) or raw (linear values)
    #[arg(long, value_name = "VIEW", default_value_t = View::default(), help_heading = "Output")]
    pub view: View,

    /// Exposure of .png, in stops
    #[arg(long, value_name = "EV", default_value_t = 0.0, value_parser = finite::<f32>, help_heading = "Output")]
    pub exposure: f32,

    /// Remove noise. A .png shows the denoised image. An .exr keeps the raw image in R, G and B, and has the denoised
    /// one in denoised.R, denoised.G and denoised.B and its estimated standard error in error [default: auto if an
    /// output is .png, else none]. With --samples, the .exr instead keeps what `penumbra merge --denoise` needs
    #[arg(long, value_name = "DENOISER", value_parser = denoisers(), help_heading = "Output")]
    pub denoise: Option<Denoise>,

    #[command(flatten)]
    pub oidn: OidnOptions,

    /// Write statistics as JSON
    #[arg(long, value_name = "FILE.json", help_heading = "Output")]
    pub stats: Option<PathBuf>,

    /// Reference image: the error against it is printed, as by `penumbra compare`
    #[arg(long, value_name = "FILE", help_heading = "Output")]
    pub reference: Option<PathBuf>,

    /// Write a checkpoint for --resume, every minute and at the end. Without --resume the file must not exist yet
    #[arg(long, value_name = "FILE", help_heading = "Output")]
    pub checkpoint: Option<PathBuf>,

    /// Continue the render that wrote the --checkpoint file, or begin it if there is no such file. --spp and all else
    /// that the samples depend on must be unchanged; the image then has the same bits as without the interruption
    #[arg(long, requires = "checkpoint", help_heading = "Output")]
    pub resume: bool,

    /// Print only errors
    #[arg(long, help_heading = "Output")]
    pub quiet: bool,

    #[command(flatten)]
    pub sequence: SequenceOptions,

    #[command(flatten)]
    pub settings: RenderOptions,

    #[command(flatten)]
    pub extent: ExtentOptions,

    /// Finish within this time, including reading, denoising and writing, unless it is too short for one sample. --spp
    /// is then only an upper limit; by default the number of samples is not limited
    #[arg(long, value_name = "SECONDS", value_parser = time_budget, help_heading = "Image")]
    pub time: Option<Duration>,

    #[command(flatten)]
    pub device: DeviceOptions,
}

fn time_budget(text: &str) -> std::result::Result<Duration, String> {
    Duration::try_from_secs_f64(positive(text)?).map_err(|_| "it must be less than 1.8e19".into())
}

impl Arguments {
    /// Checks everything that can be checked before the scene is read.
    pub fn check(&self) -> Result<()> {
        self.settings.check(&self.extent)?;
        self.sequence.check_names(self.output.iter().chain(&self.stats))?;
        let files = self.files(self.sequence.first());
        for path in &files.outputs {
            film::check_writable(path)?;
        }
        if self.settings.has_aovs() && !self.output.iter().any(|path| is_exr(path)) {
            return Err(Error::Usage("--aov needs an output that is .exr: a .png holds only the picture".into()));
        }
        self.oidn.check(self.requested_denoiser())?;
        self.check_piece()?;
        files.stats.iter().chain(&self.checkpoint).try_for_each(film::check_target)?;
        if let Some(path) = self.checkpoint.as_ref().filter(|path| path.exists() && !self.resume) {
            let problem = "exists already: add --resume to continue its render, or remove it to begin another";
            return Err(Error::Usage(format!("--checkpoint {} {problem}", path.display())));
        }
        self.check_names(&[])
    }

    /// Checks that the piece is written as sums that can be merged, and that time does not decide on its samples.
    fn check_piece(&self) -> Result<()> {
        if !self.extent.is_piece() {
            return Ok(());
        }
        if self.time.is_some() {
            let problem = "--time cannot be combined with --samples: how many samples a pixel gets would depend \
                 on chance";
            return Err(Error::Usage(problem.into()));
        }
        if !self.output.iter().any(|path| is_exr(path)) {
            let problem = "--samples needs an output that is .exr: a .png has no sums that could be merged";
            return Err(Error::Usage(problem.into()));
        }
        Ok(())
    }

    /// Checks that no output overwrites another output or an input. `referred` are the files that the scene's file
    /// refers to.
    pub fn check_names(&self, referred: &[PathBuf]) -> Result<()> {
        let others = self.scene.other_files();
        let inputs = [&self.scene.scene].into_iter().chain(&others).chain(&self.reference).chain(referred);
        let inputs: Vec<&PathBuf> = inputs.collect();
        let frames = self.sequence.first_and_named(&inputs);
        let files: Vec<Files> = match frames.is_empty() {
            true => vec![self.files(None)],
            false => frames.into_iter().map(|frame| self.files(Some(frame))).collect(),
        };
        let outputs = files.iter().flat_map(|files| files.outputs.iter().chain(&files.stats));
        film::check_names(inputs, outputs.chain(&self.checkpoint))
    }

    /// The checkpoint that the render continues from, if there is one.
    pub fn read_checkpoint(&self) -> Result<Option<Checkpoint>> {
        self.checkpoint.as_ref().filter(|path| path.exists()).map(Checkpoint::read).transpose()
    }

    /// A note if there is no checkpoint to resume from.
    pub fn note_on_checkpoint(&self, from: Option<&Checkpoint>) -> Option<String> {
        let path = self.checkpoint.as_ref().filter(|_| self.resume && from.is_none())?;
        Some(format!("there is no checkpoint {} yet: a new render begins", path.display()))
    }

    /// The denoiser. If it cannot be used, an empty denoiser and the error.
    pub fn denoiser(&self) -> (Denoiser, Option<Error>) {
        if self.extent.is_piece() {
            return (Denoiser::default(), None);
        }
        match self.oidn.denoiser(self.requested_denoiser()) {
            Ok(denoiser) => (denoiser, None),
            Err(problem) => (Denoiser::default(), Some(problem)),
        }
    }

    /// The denoiser that the user requests, or the default one.
    fn requested_denoiser(&self) -> Denoise {
        let shows = self.output.iter().any(|path| !is_exr(path));
        self.denoise.unwrap_or(if shows { Denoise::Auto } else { Denoise::None })
    }

    /// A note if most of a .png is white or black.
    pub fn note_on_exposure(&self, image: &Image) -> Option<String> {
        let png = self.output.iter().find(|path| !is_exr(path))?;
        let suggested = image.suggested_exposure(self.exposure)?;
        let seen = if suggested < self.exposure { "white" } else { "black" };
        Some(format!("{} is mostly {seen}: try --exposure {suggested}", png.display()))
    }

    /// The files of an image, or of a frame of a sequence.
    pub fn files(&self, frame: Option<Frame>) -> Files {
        let name = |path: &PathBuf| frame.map_or_else(|| path.clone(), |frame| frame.file(path));
        Files { outputs: self.output.iter().map(name).collect(), stats: self.stats.as_ref().map(name) }
    }
}
