//! The list of decisions, each with its reason and its cost.

use kernel_kit::Feature as _;
use serde::{Serialize, Serializer};

use super::features::{Feature, Features};
use crate::scene::Scene;

/// The decisions for a scene and its settings.
#[derive(Clone, Debug, Serialize)]
pub struct Specialisation {
    /// The features with which kernels are composed.
    #[serde(skip)]
    pub features: Features,
    /// Whether pass `path` runs: for all light, for indirect light, or for the light that the shown map lacks.
    #[serde(skip)]
    pub traces_paths: bool,
    /// The items that the render has, and why.
    pub kept: Vec<Item>,
    /// The items that were left out, and why.
    pub left_out: Vec<Item>,
}

/// An optional part of a render.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Item {
    /// Its name.
    #[serde(rename = "name", serialize_with = "by_name")]
    pub feature: Feature,
    /// The reason for keeping it or leaving it out.
    pub reason: String,
    /// Its cost, or what it would cost.
    pub cost: String,
}

impl Specialisation {
    /// Decides on one feature. `kept_for` is the reason if it is on, `left_out_for` if it is off.
    pub(super) fn decide(&mut self, feature: Feature, on: bool, kept_for: String, left_out_for: &str, cost: &str) {
        self.features.set(feature, on);
        let reason = if on { kept_for } else { left_out_for.to_owned() };
        let list = if on { &mut self.kept } else { &mut self.left_out };
        list.push(Item { feature, reason, cost: cost.to_owned() });
    }

    /// Gives another reason for what was decided on a feature.
    pub(crate) fn explain(&mut self, feature: Feature, reason: &str) {
        let items = self.kept.iter_mut().chain(&mut self.left_out);
        items.filter(|item| item.feature == feature).for_each(|item| reason.clone_into(&mut item.reason));
    }

    /// Switches features whatever was decided on them.
    pub(crate) fn force(&mut self, forced: &[(Feature, bool)]) {
        forced.iter().for_each(|(feature, on)| self.features.set(*feature, *on));
    }
}

impl Item {
    /// The feature's name in kernels.
    pub fn name(&self) -> &'static str {
        self.feature.name()
    }
}

/// A feature that a plan cannot decide, because it opens no device and builds no BVH.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Deferred {
    /// Its name.
    #[serde(rename = "name", serialize_with = "by_name")]
    pub feature: Feature,
    /// What decides it when the render starts.
    pub reason: &'static str,
}

impl Deferred {
    /// All of them.
    pub const ALL: &[Deferred] = &[
        Deferred { feature: Feature::TextureLoads, reason: "the device: software devices read textures faster" },
        Deferred { feature: Feature::LayeredTexels, reason: "the device: whether a table fits one texture or buffer" },
        Deferred {
            feature: Feature::Interleave,
            reason: "the device: two threads share a dispatch of a software device",
        },
        Deferred { feature: Feature::Packets, reason: "the device: subgroups of eight lanes trace rays together" },
        Deferred { feature: Feature::ShallowBvh, reason: "the hierarchy: whether a short stack is enough" },
        Deferred { feature: Feature::ClosedForms, reason: "the lights: whether any has a closed form" },
        Deferred { feature: Feature::FarEmitters, reason: "the lights: whether surfaces are far from convex lamps" },
        Deferred { feature: Feature::SampledForms, reason: "the lights: whether any has no closed form" },
    ];
}

fn by_name<S: Serializer>(feature: &Feature, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.serialize_str(feature.name())
}

/// Whether the scene has both a surface and a light.
pub(super) fn is_lit(scene: &Scene) -> bool {
    !scene.lights.is_empty() && !scene.is_empty()
}

/// A number of bytes with a unit, for users.
pub fn bytes_text(bytes: u64) -> String {
    match bytes {
        0..10_000 => format!("{bytes} B"),
        10_000..10_000_000 => format!("{} kB", bytes / 1000),
        _ => format!("{} MB", bytes / 1_000_000),
    }
}
