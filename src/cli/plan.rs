//! `penumbra plan`.

use std::fmt::Write;

use kernel_kit::Feature as _;
use penumbra::internal::specialisation::{Deferred, Item, Specialisation};
use penumbra::{Result, Scene, Settings};
use serde::Serialize;

use super::options::{PartOptions, RenderOptions, SceneOptions};
use super::{Ending, print, print_json};

#[derive(clap::Args)]
#[command(allow_negative_numbers = true)]
pub struct Arguments {
    #[command(flatten)]
    scene: SceneOptions,

    #[command(flatten)]
    settings: RenderOptions,

    #[command(flatten)]
    part: PartOptions,

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
    arguments.settings.check(&arguments.part)?;
    let (scene, camera) = arguments.scene.load(arguments.settings.aspect())?;
    let settings = arguments.settings.settings(&camera, &arguments.part)?;
    let Specialisation { kept, left_out, .. } = Specialisation::new(&scene, Some(&camera), &settings);
    let plan =
        Plan { scene: Counts::new(&scene), settings, kept, left_out, deferred: Deferred::ALL, notes: scene.notes };
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
        text
    }
}
