//! Features: every set that scenes require composes, and unneeded features change no image.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use glam::{DAffine3, DVec3, Mat2, Vec2, Vec3, Vec4};
use kernel_kit::{Composed, DeviceLimits, Feature as _, Gpu, Taken, kernel_test};
use penumbra::internal::kernels::{compose, compose_source, features_of, kernel_stems};
use penumbra::internal::procedural::Role;
use penumbra::internal::scene::{
    AlphaMode, Anisotropy, Clearcoat, ColourSpace, DiffuseTransmission, Dispersion, Filter, Iridescence, LightKind,
    Material, Medium, Panorama, Scene, Sheen, Specular, Texture, TextureImage, TextureInfo, Transmission, Volume, Wrap,
};
use penumbra::internal::specialisation::Specialisation;
use penumbra::internal::specialisation::features::{Feature, Features};
use penumbra::settings::{Background, Denoise, LightSampling};
use penumbra::{Aov, Result, Settings, Technique};
use rayon::prelude::*;

use crate::light::{Corners, cube, sphere, square};
use crate::path::{camera, render_with, scene, surface};
use crate::procedurals::{self, Object};
use crate::stage::hash1;

/// A random selection of some forty properties of a scene, its settings and the device.
#[derive(Clone, Copy)]
struct Selection(u64);

/// Random selections. A combination of two properties occurs in one of four selections, or of eight for lobes of
/// materials: 192 selections miss one of the combinations with a probability of 1e-9.
fn selections() -> impl ParallelIterator<Item = Selection> {
    (0..192u32).into_par_iter().map(|i| Selection(u64::from(hash1(i)) | u64::from(hash1(!i)) << 32))
}

impl Selection {
    fn has(self, property: u64) -> bool {
        self.0 >> property & 1 != 0
    }

    fn scene(self) -> Scene {
        let texture = |uv_set| Some(TextureInfo { texture: 0, uv_set, matrix: Mat2::IDENTITY, offset: Vec2::ZERO });
        // Lambertian, whatever its roughness and its index of refraction.
        let roughness = if self.has(32) { 0.03 } else { 1.0 };
        let plain = Material { roughness, ior: if self.has(61) { 3.0 } else { 1.5 }, ..surface(0.5, 0.0) };
        // One in four has no light at all.
        let dark = self.has(29) && self.has(30);
        let lamp = surface(0.0, if dark { 0.0 } else { 1.0 });
        let panel = |i: f64| square(DVec3::new(0.1 * i, 0.0, 0.0), 0.04 * DVec3::X, 0.04 * DVec3::Y);
        let mut meshes: Vec<(Vec<Corners>, Material)> = vec![(panel(-5.0), plain.clone())];
        let materials = [
            Material { metallic: 1.0, ..plain.clone() },
            Material { alpha: AlphaMode::Mask { cutoff: 0.5 }, ..plain.clone() },
            Material { unlit: true, ..plain.clone() },
            Material { base_colour_texture: texture(0), ..plain.clone() },
            Material { base_colour_texture: texture(1), ..plain.clone() },
            Material { normal_texture: texture(0), ..plain.clone() },
            lamp.clone(),
            Material { emissive_texture: texture(0), ..lamp.clone() },
            Material { alpha: AlphaMode::Mask { cutoff: 0.5 }, ..lamp.clone() },
        ];
        // Half of the scenes are without lobes.
        let has_lobe = |property: u64| self.has(55) && self.has(property);
        for (i, material) in (0..).zip(materials).filter(|(i, _)| match i {
            0 => has_lobe(0),
            8 => self.has(59),
            _ => self.has(*i),
        }) {
            meshes.push((panel(i as f64 - 4.0), material));
        }
        let normal_texture = texture(0).filter(|_| self.has(48));
        let clearcoat = Clearcoat { normal_texture, ..Clearcoat::with_factor(1.0) };
        let lobed = [
            Material { transmission: Transmission::with_factor(1.0), ..plain.clone() },
            Material { clearcoat, ..plain.clone() },
            Material {
                specular: Specular::with_factor(1.0),
                anisotropy: Anisotropy::with_strength(0.5),
                ..plain.clone()
            },
            Material { sheen: Sheen::new(Vec3::ONE, 0.0), ..plain.clone() },
        ];
        for (i, material) in (33..).zip(lobed).filter(|(i, _)| has_lobe(*i)) {
            meshes.push((panel(i as f64 - 29.0), material));
        }
        if has_lobe(50) {
            meshes.push((panel(8.0), Material { iridescence: Iridescence::new(1.0, 1.3, 400.0), ..plain.clone() }));
        }
        if has_lobe(38) {
            let diffuse_transmission = DiffuseTransmission::new(0.5, Vec3::ONE);
            meshes.push((panel(9.0), Material { diffuse_transmission, ..plain.clone() }));
        }
        let volume = Volume { attenuation_distance: 1.0, attenuation_colour: Vec3::splat(0.5) };
        if has_lobe(39) {
            let (transmission, dispersion) = (Transmission::with_factor(1.0), Dispersion::new(1.0));
            let shining = if self.has(8) { lamp.clone() } else { plain.clone() };
            let glass = Material { transmission, dispersion, volume: Some(volume), double_sided: true, ..shining };
            meshes.push((panel(10.0), glass));
        }
        if has_lobe(40) {
            meshes.push((panel(11.0), Material { medium: Some(Medium { ior: 1.33, volume }), ..plain }));
        }
        if self.has(8) {
            meshes.push((cube(DVec3::Y, 0.1), lamp));
        }
        if self.has(49) {
            meshes.push((square(DVec3::NEG_Y, 0.5 * DVec3::X, 1e-4 * DVec3::Z), surface(0.5, 0.0)));
        }
        let (position, direction, intensity) = (Vec3::Z, Vec3::NEG_Z, Vec3::ONE);
        let range = f32::INFINITY;
        let punctual = [
            LightKind::Point { position, intensity, range },
            LightKind::Spot { position, direction, intensity, cos_inner: 0.9, cos_outer: 0.8, range },
            LightKind::Directional { direction, irradiance: Vec3::ONE },
        ];
        let punctual = (9..).zip(punctual).filter(|(i, _)| self.has(*i) && !dark).map(|(_, light)| light).collect();
        let mut scene = scene(&meshes, punctual);
        if self.has(31) {
            let panorama = Panorama { width: 1, height: 1, texels: vec![[1.0; 3]] };
            scene.set_environment(Arc::new(panorama), 0.0, 1.0).unwrap();
        }
        scene.images = vec![TextureImage { name: String::new(), width: 1, height: 1, texels: vec![[255; 4]] }].into();
        let wrap = [Wrap::Repeat; 2];
        scene.textures = vec![Texture { image: 0, wrap, filter: Filter::Linear, space: ColourSpace::Srgb }];
        if self.has(12) {
            Arc::make_mut(&mut scene.vertices)[0].colour = Vec4::splat(0.5);
        }
        if self.has(13) {
            Arc::make_mut(&mut scene.vertices)[..3]
                .iter_mut()
                .for_each(|vertex| vertex.normal = Vec3::new(0.6, 0.0, 0.8));
        }
        if self.has(37) {
            let sponge = include_str!("../../scenes/procedural/menger.wgsl");
            let (role, function) = (Role::Distance, "menger");
            let material = surface(0.5, 0.0);
            let sponge = Object { source: sponge, function, role, parameter: 2.0, world: DAffine3::IDENTITY, material };
            let ball = procedurals::sphere(Role::Intersection, DAffine3::IDENTITY, surface(0.5, 0.0));
            procedurals::place(&mut scene, &[sponge, ball]);
        }
        scene
    }

    fn features(self) -> Features {
        let techniques: Vec<Technique> = Technique::all().collect();
        let aovs = (23..).zip([Aov::Albedo, Aov::Normal, Aov::Position, Aov::Shadow]);
        // One in four is of the technique that has zones.
        let technique = match self.has(46) && self.has(47) {
            true => Technique::SHADOW_PHOTONS,
            false => techniques[hash1(self.0 as u32) as usize % techniques.len()],
        };
        let light_sampling = match technique.uses_zones() {
            true if !self.has(41) || self.has(42) => LightSampling::Zones,
            _ if technique.samples_lights() && self.has(51) => LightSampling::Contribution,
            _ if self.has(41) => LightSampling::Uniform,
            _ => LightSampling::Power,
        };
        let settings = Settings::default().with(|s| {
            s.technique = technique;
            s.light_sampling.strategy = (self.has(43) || self.has(44)).then_some(light_sampling);
            s.light_sampling.sampled_lights = 2;
            s.visibility_map.audit = if self.has(18) { 1.0 } else { 0.0 };
            s.visibility_map.paper_counting = self.has(19);
            s.indirect.max_bounces = if self.has(20) { 64 } else { 0 };
            s.indirect.irradiance_cache.enabled = self.has(21);
            if self.has(16) {
                s.image.background = Background::Transparent;
            }
            s.image.noise = self.has(14).then_some(0.01);
            s.image.denoise = if self.has(63) { Denoise::Auto } else { Denoise::None };
            // The last one, the AOV of classes, excludes light sampling.
            s.image.aovs =
                aovs.filter(|(i, _)| self.has(*i) && (*i < 26 || self.has(45))).map(|(_, aov)| aov).collect();
        });
        let specialisation = Specialisation::new(&self.scene(), None, &settings);
        let features =
            specialisation.features.with(Feature::TextureLoads, self.has(27)).with(Feature::Interleave, self.has(28));
        // Packets read textures.
        let instances = self.has(17) && self.has(22);
        let features = features.with(Feature::Instances, instances);
        let features = features.with(Feature::Packets, self.has(27) && self.has(62) && !instances);
        let far = self.has(54) && features.has(Feature::EmitterPairs);
        features
            .with(Feature::LayeredTexels, self.has(57) && self.has(58))
            .with(Feature::ThinLens, self.has(15))
            .with(Feature::ShallowBvh, self.has(60) && !instances)
            .with(Feature::ClosedForms, self.has(52))
            .with(Feature::SampledForms, self.has(53))
            .with(Feature::FarEmitters, far)
            .with(Feature::ShownCells, self.has(56))
    }
}

/// Whether a render of those features runs the kernel.
fn runs(kernel: &str, features: &Features) -> bool {
    match kernel {
        "photons" | "grid" => features.has(Feature::VisibilityMap) || features.has(Feature::Zones),
        "sample_lights" => features.has(Feature::LightSampling),
        "zones" => features.has(Feature::Zones),
        "flux" | "irradiance" => features.has(Feature::GlobalMap),
        "cells" => features.has(Feature::Cells),
        "light_buffer" => features.has(Feature::LightBuffer),
        "ward" => features.has(Feature::Ward),
        "gather" | "cache" => features.has(Feature::IrradianceCache),
        _ => true,
    }
}

/// What an entry point takes beyond the least limits of devices, if any does.
fn beyond_limits(composed: &Composed) -> Option<String> {
    let least = DeviceLimits::least();
    let beyond = |taken: &Taken| {
        taken.storage_buffers > least.max_storage_buffers_per_shader_stage
            // The first four storage textures stay; `bvh_nodes` is one of them, which all with as many textures read.
            || taken.storage_textures + taken.sampled_textures > least.max_sampled_textures_per_shader_stage + 1
            // And two of the kit's.
            || taken.uniform_buffers + 2 > least.max_uniform_buffers_per_shader_stage
    };
    composed.taken().into_iter().find(beyond).map(|taken| format!("takes too much: {taken:?}"))
}

/// Every kernel composes to valid WGSL (by naga, without a device) for random sets of features that scenes and settings
/// require, and takes no more than devices have. Each feature is on in some sets and off in others, so errors of any
/// two features together are found.
#[test]
fn reachable_features_compose() {
    let sets: BTreeSet<Features> = selections().map(Selection::features).collect();
    for feature in Feature::ALL {
        let (with, without): (Vec<_>, Vec<_>) = sets.iter().partition(|set| set.has(*feature));
        assert!(!with.is_empty() && !without.is_empty(), "{feature:?}: in {} sets of {}", with.len(), sets.len());
    }
    let wrong = |kernel: &str, composed: &(dyn Fn(&Features) -> Result<Composed> + Sync)| -> Vec<String> {
        // A kernel is composed once for all sets in which it is the same.
        let mut is_limited = BTreeMap::new();
        for set in sets.iter().filter(|set| runs(kernel, set)) {
            // Where tables are buffers, devices allow many; those that trace packets have more than the least.
            *is_limited.entry(features_of(kernel, set)).or_insert(false) |=
                set.has(Feature::TextureLoads) && !set.has(Feature::Packets);
        }
        let errors = is_limited.par_iter().filter_map(|(set, is_limited)| {
            let names: Vec<_> = set.iter().map(Feature::name).collect();
            let error = match composed(set) {
                Err(error) => error.to_string(),
                Ok(composed) if *is_limited => beyond_limits(&composed)?,
                Ok(_) => return None,
            };
            Some(format!("{}: {error}", names.join(" ")))
        });
        errors.collect()
    };
    for kernel in kernel_stems() {
        let running = sets.iter().filter(|set| runs(kernel, set)).count();
        assert!(running >= 8, "{kernel} runs with {running} of {} sets", sets.len());
        let wrong = wrong(kernel, &|set| compose(kernel, set));
        assert!(wrong.is_empty(), "{kernel}: {} of {} sets, {}", wrong.len(), sets.len(), wrong[0]);
    }
    let fault = "@compute @workgroup_size(1) fn nothing() { @if(uv1 && !glossy) { let x: u32 = 1.0; } }";
    let found = wrong("fault", &|set| compose_source("fault", fault, set)).len();
    assert!(found > 0 && found < sets.len(), "a fault where two features meet is in {found} of {} sets", sets.len());
}

/// The parameters of every kernel are valid in a uniform buffer, from which devices without immediates take them.
#[test]
fn parameters_fit_a_uniform_buffer() {
    let sets: BTreeSet<Features> = selections().map(Selection::features).collect();
    for kernel in kernel_stems() {
        for set in sets.iter().filter(|set| runs(kernel, set)).take(4) {
            compose(kernel, set).unwrap().without_immediates().unwrap();
        }
    }
    let misaligned =
        "struct Two { x: u32, y: u32 } struct Parameters { two: Two, z: u32 } var<immediate> all: Parameters;
        @compute @workgroup_size(1) fn nothing() { let z = all.z; }";
    let misaligned = compose_source("misaligned", misaligned, sets.first().unwrap()).unwrap();
    let error = misaligned.without_immediates().unwrap_err().to_string();
    assert!(error.contains("misaligned") && error.contains("Alignment"), "{error}");
}

/// A simple scene rendered with the code of all features gives the same image, except for roundings of the longer sums
/// with unused terms, and for the few paths that take another way because of them.
#[kernel_test("PENUMBRA_DEVICE")]
fn features_that_are_not_needed_change_nothing(gpu: &Gpu) {
    const FORCED: [Feature; 27] = [
        Feature::Needles,
        Feature::Textures,
        Feature::Uv1,
        Feature::VertexColours,
        Feature::NormalMaps,
        Feature::SmoothNormals,
        Feature::Glossy,
        Feature::Transmission,
        Feature::DiffuseTransmission,
        Feature::Dispersion,
        Feature::Immersed,
        Feature::Clearcoat,
        Feature::CoatNormals,
        Feature::Anisotropy,
        Feature::Sheen,
        Feature::Iridescence,
        Feature::AlphaTest,
        Feature::Unlit,
        Feature::Procedurals,
        Feature::PointLights,
        Feature::SpotLights,
        Feature::DirectionalLights,
        Feature::ManyEmitters,
        Feature::EmitterPairs,
        Feature::EmissiveTextures,
        Feature::EmissiveAlpha,
        Feature::EmissiveVolumes,
    ];
    let room = || {
        let lamp = square(DVec3::new(0.0, 0.45, 0.0), 0.2 * DVec3::X, 0.2 * DVec3::Z);
        let walls = crate::path::inside_out(cube(DVec3::ZERO, 0.5));
        let ball = sphere(DVec3::new(0.1, -0.3, 0.0), 0.15, 6);
        scene(&[(walls, surface(0.6, 0.0)), (ball, surface(0.8, 0.0)), (lamp, surface(0.0, 5.0))], Vec::new())
    };
    let view = camera(DVec3::new(0.0, 0.1, 0.45), DVec3::new(0.0, -0.3, -1.0), 1.2);
    let image = |forced: &[Feature]| {
        let rendered = render_with(gpu, room(), &view, 24, 16, 4, |features| {
            forced.iter().fold(features, |features, feature| {
                assert!(!features.has(*feature), "{feature:?} is needed: nothing is forced");
                features.with(*feature, true)
            })
        });
        rendered.all().collect::<Vec<f64>>()
    };
    let trimmed = image(&[]);
    let differing = |other: &[f64]| {
        // Between a dozen roundings of f32, below 1e-6, and the thousandth that the test must see.
        let differs = |(a, b): &(&f64, &f64)| (*a - *b).abs() > 1e-4 * a.abs().max(0.1);
        trimmed.iter().zip(other).filter(differs).count()
    };
    let forced = differing(&image(&FORCED));
    println!("{forced} of {} samples differ", trimmed.len());
    assert!(trimmed.len() == 24 * 24 * 16 && trimmed.iter().any(|sample| *sample > 0.1));
    // Roundings change some paths in a hundred thousand; another sequence of random numbers would change nearly all.
    assert!(forced * 1000 < trimmed.len(), "{forced} of {} samples differ", trimmed.len());
    let shifted: Vec<f64> = trimmed.iter().map(|sample| sample * 1.001).collect();
    assert!(differing(&shifted) * 2 > trimmed.len(), "a tenth of a percent is not seen");
}
