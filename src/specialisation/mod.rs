//! The specialisation of a render: the only place that decides which modules and branches the kernels contain, which
//! buffers exist and which passes run. It decides in steps: first by scene, settings and camera
//! ([`Specialisation::new`]), which is all that a plan uses; then by BVH and device, by the light tables, and by the
//! first samples.

mod bsdf_rays;
mod decisions;
pub mod features;
mod indirect;
pub mod kernels;
pub mod lights;
pub(crate) mod lobes;
mod surfaces;
pub(crate) mod visibility;

use kernel_kit::Gpu;

use crate::bvh::{Bvh, PACKET_LANES};
use crate::scene::{AlphaMode, Camera, Scene, Triangle};
use crate::settings::{Aov, Background, Denoise, Settings};
use crate::specialisation::features::{Feature, Features};

pub(crate) use bsdf_rays::{MIN_HIT_PROBABILITY, Sphere};
pub use decisions::{Deferred, Item, Specialisation, bytes_text};
pub(crate) use lights::LightFacts;
pub(crate) use lobes::surface_vectors;
pub(crate) use surfaces::FOCUSING_ALPHA;
use surfaces::Facts;

/// Maximum number of triangles with alpha tests for packets. A packet takes more iterations at each than a single ray:
/// 10,000 panes of two triangles, one behind the other, exceed the loop budget of packets, but not that of single rays.
const MAX_PACKET_ALPHA_TESTS: usize = 4096;

impl Specialisation {
    /// Decides what `scene` seen by `camera` and rendered with `settings` needs; without a camera as if surfaces filled
    /// the image of a pinhole.
    pub fn new(scene: &Scene, camera: Option<&Camera>, settings: &Settings) -> Specialisation {
        let mut specialisation = Specialisation {
            features: Features::default(),
            traces_paths: false,
            kept: Vec::new(),
            left_out: Vec::new(),
        };
        let facts = Facts::new(scene);
        specialisation.decide_on_surfaces(scene, &facts);
        specialisation.decide_on_instances(scene, settings);
        specialisation.decide_on_lights(scene, &facts);
        specialisation.decide_on_light_sampling(scene, settings);
        specialisation.decide_on_visibility(scene, camera, settings);
        specialisation.decide_on_indirect_light(scene, settings, &facts);
        specialisation.decide_on_channels(scene, settings);
        specialisation.decide_on_lens(camera);
        specialisation
    }

    fn decide_on_channels(&mut self, scene: &Scene, settings: &Settings) {
        let pixels = settings.image.crop_window().pixels();
        let aov = |aov: Aov| settings.image.aovs.contains(&aov);
        let shown = settings.image.background == Background::Environment;
        let position = aov(Aov::Position) || aov(Aov::Depth);
        // Where the camera sees the environment, only the albedo tells which rays hit a surface.
        let albedo = aov(Aov::Albedo) || (position && shown && scene.environment().is_some());
        for (feature, on) in [
            (Feature::AovAlbedo, albedo),
            (Feature::AovNormal, aov(Aov::Normal)),
            (Feature::AovPosition, position),
            (Feature::AovShadow, aov(Aov::Shadow)),
        ] {
            let cost = format!("{} of film", bytes_text(pixels * 32));
            self.decide(feature, on, "requested".into(), "not requested", &cost);
        }
        let cost = format!("{} of lists, and up to {} of film", bytes_text(pixels * 8), bytes_text(pixels * 4 * 32));
        let noise = settings.image.noise;
        let adaptive = noise.is_some() || settings.image.allocates_samples();
        let reason = noise.map_or_else(
            || "pixels with noise around them get more samples".to_owned(),
            |noise| format!("pixels get samples until their relMSE is {noise}"),
        );
        self.decide(Feature::AdaptiveSampling, adaptive, reason, "all pixels get the same samples", &cost);
        let cost = "a read of the fine cells at every point";
        self.decide(Feature::ShownCells, false, String::new(), "no window shows them", cost);
        let hides = scene.environment().is_some() && !shown;
        let unneeded = if shown { "what is behind the scene is shown" } else { "the scene has no environment" };
        self.decide(Feature::HiddenEnvironment, hides, "another background is shown".into(), unneeded, "nothing");
        let denoise = settings.image.denoise;
        // The guides; of direct and of indirect light the squares and two snapshots.
        let cost = format!("up to {} of film", bytes_text(pixels * (3 + 2 * 3) * 32));
        let reason = format!("the image is denoised: {denoise}");
        self.decide(Feature::Guides, denoise != Denoise::None, reason, "the image is not denoised", &cost);
    }

    /// Whether the technique's kernels trace instances. Cells and light buffers have lists of triangles in the scene.
    pub(crate) fn traces_instances(settings: &Settings) -> bool {
        !settings.technique.uses_cells() && !settings.technique.uses_light_buffers()
    }

    /// Whether there is light besides separate direct light.
    pub(crate) fn has_indirect_light(&self) -> bool {
        self.traces_paths || self.features.has(Feature::GlobalMap)
    }

    fn decide_on_lens(&mut self, camera: Option<&Camera>) {
        let why = "the camera has an iris".to_owned();
        let cost = "a point of the iris for every camera ray; 16 B per point";
        self.decide(
            Feature::ThinLens,
            camera.is_some_and(|camera| camera.lens.is_some()),
            why,
            "the camera is a pinhole",
            cost,
        );
    }

    /// These decisions, with those on [`Deferred`] features that another specialisation of the same scene on the same
    /// device made.
    pub(crate) fn with_deferred_of(mut self, other: &Specialisation) -> Specialisation {
        for Deferred { feature, .. } in Deferred::ALL {
            self.features.set(*feature, other.features.has(*feature));
        }
        self
    }

    /// Decides what depends on the device and the BVH. A plan opens no device and builds no BVH.
    pub(crate) fn decide_by_device(&mut self, gpu: &Gpu, scene: &Scene, bvh: &Bvh) {
        self.features = device_features(gpu, std::mem::take(&mut self.features));
        self.features.set(Feature::ShallowBvh, bvh.is_shallow());
        // Nodes for packets take more than twice as many texels: those of the largest BVHs do not fit a texture.
        let packets = self.features.has(Feature::Packets)
            && !self.features.has(Feature::Instances)
            && bvh.packet_texels() <= gpu.max_table_records()
            && alpha_tests(scene) <= MAX_PACKET_ALPHA_TESTS;
        self.features.set(Feature::Packets, packets);
    }

    /// Decides on tables in layers, by the records of the largest table that grows with the triangles.
    pub(crate) fn decide_on_layers(&mut self, gpu: &Gpu, records: usize) {
        self.features.set(Feature::LayeredTexels, records as u64 > gpu.max_table_records());
    }
}

/// Number of triangles with alpha tests.
fn alpha_tests(scene: &Scene) -> usize {
    let is_tested = |triangle: &&Triangle| scene.materials[triangle.material as usize].alpha != AlphaMode::Opaque;
    scene.triangles.iter().filter(is_tested).count()
}

/// `features` with those of the device: software devices read tables through textures, interleave workgroups between
/// threads, and trace rays in packets.
pub fn device_features(gpu: &Gpu, features: Features) -> Features {
    let software = gpu.is_software();
    features
        .with(Feature::TextureLoads, gpu.texture_loads)
        .with(Feature::Interleave, software)
        .with(Feature::Packets, software && gpu.subgroup_size == Some(PACKET_LANES))
}
