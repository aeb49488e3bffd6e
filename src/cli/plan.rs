//! `penumbra plan`.

use std::fmt::Write;

use kernel_kit::Feature as _;
use penumbra::internal::render::host_memory::ImageMemory;
use penumbra::internal::report::prediction::{self, Prediction};
use penumbra::internal::report::run::Subject;
use penumbra::internal::specialisation::{Deferred, Item, Specialisation, bytes_text};
use penumbra::settings::Denoise;
use penumbra::{Error, Result, Scene, Settings};
use serde::Serialize;

use super::options::{DeviceOptions, ExtentOptions, RenderOptions, SceneOptions};
use super::{Ending, print, print_json};

#[derive(clap::Args)]
#[command(allow_negative_numbers = true)]
pub struct Arguments {
    #[command(flatten)]
    scene: SceneOptions,

    #[command(flatten)]
    settings: RenderOptions,

    #[command(flatten)]
    extent: ExtentOptions,

    /// Predict the time and the noise of the image by `path`, `two-pass` and `shadow-photons`, with --spp samples in
    /// every pixel, from renders of small images, which take some seconds
    #[arg(long, help_heading = "Output")]
    predict: bool,

    #[command(flatten)]
    device: DeviceOptions,

    /// Print JSON, with the lists kept and left_out, whose items have a name, a reason and a cost
    #[arg(long, help_heading = "Output")]
    json: bool,
}

/// The output; `docs/statistics.md` describes the JSON form.
#[derive(Serialize)]
struct Plan {
    scene: Counts,
    settings: Settings,
    kept: Vec<Item>,
    left_out: Vec<Item>,
    deferred: &'static [Deferred],
    notes: Vec<String>,
    memory: Memories,
    /// Empty without --predict.
    predictions: Vec<Prediction>,
}

#[derive(Serialize)]
struct Counts {
    triangles: usize,
    instances: usize,
    vertices: usize,
    materials: usize,
    images: usize,
    lights: usize,
    cameras: usize,
}

/// The memory of the image alone, without and with a denoiser: whether `render` denoises depends on its outputs, which
/// `plan` does not have.
#[derive(Serialize)]
struct Memories {
    raw: ImageMemory,
    denoised: ImageMemory,
}

impl Counts {
    fn new(scene: &Scene) -> Self {
        Counts {
            triangles: scene.triangles.len(),
            instances: scene.instances.len(),
            vertices: scene.vertices.len(),
            materials: scene.materials.len(),
            images: scene.images.len(),
            lights: scene.lights.len(),
            cameras: scene.cameras.len(),
        }
    }
}

pub fn run(arguments: &Arguments) -> Result<Ending> {
    arguments.settings.check(&arguments.extent)?;
    if arguments.predict && arguments.settings.noise.is_some() {
        let problem = "--predict cannot be combined with --noise: it predicts what the samples of --spp cost";
        return Err(Error::Usage(problem.into()));
    }
    let (scene, camera) = arguments.scene.load(arguments.settings.aspect())?;
    let settings = arguments.settings.settings_to_end(&camera, &arguments.extent, false)?;
    let specialisation = Specialisation::new(&scene, Some(&camera), &settings);
    let denoised = settings.clone().with(|s| s.image.denoise = Denoise::Auto);
    let memory = Memories {
        raw: ImageMemory::new(&specialisation, &settings),
        denoised: ImageMemory::new(&Specialisation::new(&scene, Some(&camera), &denoised), &denoised),
    };
    let Specialisation { kept, left_out, .. } = specialisation;
    let mut predictions = Vec::new();
    if arguments.predict {
        let gpu = arguments.device.open()?;
        // Both sizes of a technique's small images have the same kernels.
        gpu.keep_kernels();
        let subject = Subject { gpu: &gpu, scene: &scene, camera: &camera, settings: &settings, slowness: 1.0 };
        for technique in prediction::TECHNIQUES {
            predictions.extend(prediction::predict(&subject, technique)?);
        }
    }
    let plan = Plan {
        scene: Counts::new(&scene),
        settings,
        kept,
        left_out,
        deferred: Deferred::ALL,
        notes: scene.notes,
        memory,
        predictions,
    };
    if arguments.json {
        print_json(&plan)?
    } else {
        print(&plan.text())?
    }
    Ok(Ending::Done)
}

impl Plan {
    fn text(&self) -> String {
        let Counts { triangles, instances, vertices, materials, images, lights, cameras } = self.scene;
        let Settings { technique, ref image, .. } = self.settings;
        let mut text = format!(
            "{} x {} pixels, technique {technique}\n\
             triangles {triangles}, instances {instances}, vertices {vertices}, materials {materials}, \
             images {images}, lights {lights}, cameras {cameras}\n",
            image.width, image.height
        );
        for note in &self.notes {
            let _ = writeln!(text, "note: {note}");
        }
        let items = || self.kept.iter().chain(&self.left_out);
        let name_width = items().map(|item| item.name().len()).max().unwrap_or(0);
        let reason_width = items().map(|item| item.reason.chars().count()).max().unwrap_or(0);
        for (title, items) in [("kept", &self.kept), ("left out", &self.left_out)] {
            let _ = writeln!(text, "\n{title}");
            for item in items {
                let Item { reason, cost, .. } = item;
                let name = item.name();
                let _ = writeln!(text, "  {name:name_width$}  {reason:reason_width$}  {cost}");
            }
        }
        let _ = writeln!(text, "\ndecided when the render starts");
        for Deferred { feature, reason } in self.deferred {
            let _ = writeln!(text, "  {:name_width$}  {reason}", feature.name());
        }
        self.add_memory(&mut text);
        self.add_predictions(&mut text);
        text
    }

    fn add_memory(&self, text: &mut String) {
        let Memories { raw, denoised } = &self.memory;
        let _ = writeln!(text, "\nmemory of the image, at least");
        for (name, ImageMemory { host, film }) in [("raw", raw), ("denoised", denoised)] {
            let (host, film) = (bytes_text(*host), bytes_text(*film));
            let _ = writeln!(text, "  {name:8}  {host:>10} of the machine  {film:>10} of the device");
        }
    }

    fn add_predictions(&self, text: &mut String) {
        if self.predictions.is_empty() {
            return;
        }
        let width = self.predictions.iter().map(|p| p.technique.name().len()).max().unwrap_or(0);
        let spp = self.settings.image.range().count();
        let all = format!("{spp} spp");
        let _ = writeln!(
            text,
            "\npredicted\n  {:width$}  first sample  each after 8  {all:>12}  relMSE of their noise",
            "technique"
        );
        for Prediction { technique, first_sample, sample, all, noise } in &self.predictions {
            let name = technique.name();
            let noise = noise.map_or("unknown".to_owned(), |noise| format!("{noise:.1e}"));
            let _ = writeln!(text, "  {name:width$}  {first_sample:>10.2} s  {sample:>10.3} s  {all:>10.1} s  {noise}");
        }
    }
}
