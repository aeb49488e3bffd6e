//! What a render needs: the one place that decides which modules and branches the kernels are composed of, which buffers
//! exist and which passes run. It decides in steps: by scene and settings ([`Specialisation::new`], which is all that a plan
//! knows), by hierarchy and device, by the light tables, and by the pilot samples.

mod indirect;
pub(crate) mod kernels;
pub(crate) mod lights;
mod surfaces;
pub(crate) mod visibility;

use serde::Serialize;

use crate::bvh::Bvh;
use crate::gpu::{Features, Gpu};
use crate::scene::Scene;
use crate::settings::{Aov, Settings};

pub(crate) use surfaces::FOCUSING_ALPHA;
use surfaces::Facts;

/// What was decided for a scene and its settings.
#[derive(Clone, Debug, Serialize)]
pub struct Specialisation {
    /// What the kernels are composed with.
    #[serde(skip)]
    pub features: Features,
    /// Pass `path` runs: for all light, for indirect light, or for what the shown map leaves.
    #[serde(skip)]
    pub traces_paths: bool,
    /// What is there, and why.
    pub kept: Vec<Item>,
    /// What was left out, and why.
    pub left_out: Vec<Item>,
}

/// Something that a render can have or do without.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Item {
    /// What it is.
    pub name: &'static str,
    /// Why it is kept or left out.
    pub reason: String,
    /// What it costs, or would.
    pub cost: String,
}

impl Specialisation {
    /// Decides what `scene` rendered with `settings` needs.
    pub fn new(scene: &Scene, settings: &Settings) -> Specialisation {
        let mut specialisation = Specialisation {
            features: Features::default(),
            traces_paths: false,
            kept: Vec::new(),
            left_out: Vec::new(),
        };
        let facts = Facts::new(scene);
        specialisation.of_surfaces(scene, &facts);
        specialisation.of_lights(scene, &facts);
        specialisation.of_light_sampling(scene, settings);
        specialisation.of_visibility(scene, settings);
        specialisation.of_indirect_light(scene, settings, &facts);
        specialisation.of_channels(settings);
        specialisation
    }

    fn of_channels(&mut self, settings: &Settings) {
        let pixels = u64::from(settings.width) * u64::from(settings.height);
        let aov = |aov: Aov| settings.aovs.contains(&aov);
        for (feature, on) in [
            ("aov_albedo", aov(Aov::Albedo)),
            ("aov_normal", aov(Aov::Normal)),
            ("aov_position", aov(Aov::Position) || aov(Aov::Depth)),
            ("aov_shadow", aov(Aov::Shadow)),
        ] {
            let cost = format!("{} of film", bytes_text(pixels * 32));
            self.decide(feature, on, "asked for".into(), "not asked for", &cost);
        }
    }

    /// Decides what depends on the hierarchy, which a plan does not build.
    pub(crate) fn of_hierarchy(&mut self, bvh: &Bvh) {
        self.set("shallow_bvh", bvh.is_shallow());
    }

    /// Decides what depends on the device, which a plan does not open.
    pub(crate) fn of_device(&mut self, gpu: &Gpu) {
        self.features = device_features(gpu, std::mem::take(&mut self.features));
    }

    fn decide(&mut self, name: &'static str, on: bool, kept_for: String, left_out_for: &str, cost: &str) {
        self.set(name, on);
        let reason = if on { kept_for } else { left_out_for.to_owned() };
        let list = if on { &mut self.kept } else { &mut self.left_out };
        list.push(Item { name, reason, cost: cost.to_owned() });
    }

    fn set(&mut self, name: &'static str, on: bool) {
        self.features = std::mem::take(&mut self.features).with(name, on);
    }
}

/// `features` with those of the device: software devices read tables through textures, and interleave workgroups between
/// threads.
pub fn device_features(gpu: &Gpu, features: Features) -> Features {
    features.with("texture_loads", gpu.texture_loads).with("interleave", gpu.info.is_software())
}

/// A number and its noun: "1 light", "2 lights".
fn count(n: usize, what: &str) -> String {
    format!("{n} {what}{}", if n == 1 { "" } else { "s" })
}

/// Whether there is a surface to be lit, and a light.
fn is_lit(scene: &Scene) -> bool {
    !scene.lights.is_empty() && !scene.is_empty()
}

/// A number of bytes as people read it.
pub fn bytes_text(bytes: u64) -> String {
    match bytes {
        0..10_000 => format!("{bytes} B"),
        10_000..10_000_000 => format!("{} kB", bytes / 1000),
        _ => format!("{} MB", bytes / 1_000_000),
    }
}
