//! The list of decisions, each with its reason and its cost.

use kernel_kit::Feature as _;
use serde::{Serialize, Serializer};

use super::features::{Feature, Features};
use crate::scene::Scene;

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
    #[serde(rename = "name", serialize_with = "by_name")]
    pub feature: Feature,
    /// Why it is kept or left out.
    pub reason: String,
    /// What it costs, or would.
    pub cost: String,
}

impl Specialisation {
    /// Decides on one feature. `kept_for` is the reason where it is on, `left_out_for` where it is off.
    pub(super) fn decide(&mut self, feature: Feature, on: bool, kept_for: String, left_out_for: &str, cost: &str) {
        self.features.set(feature, on);
        let reason = if on { kept_for } else { left_out_for.to_owned() };
        let list = if on { &mut self.kept } else { &mut self.left_out };
        list.push(Item { feature, reason, cost: cost.to_owned() });
    }
}

impl Item {
    /// The feature's name, as kernels know it.
    pub fn name(&self) -> &'static str {
        self.feature.name()
    }
}

fn by_name<S: Serializer>(feature: &Feature, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.serialize_str(feature.name())
}

/// A number and its noun: "1 light", "2 lights".
pub(super) fn count(n: usize, what: &str) -> String {
    format!("{n} {what}{}", if n == 1 { "" } else { "s" })
}

/// Whether there is a surface to be lit, and a light.
pub(super) fn is_lit(scene: &Scene) -> bool {
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
