//! The same seed, device and binary give the same bits.

use std::sync::Arc;

use glam::{DAffine3, DVec3, Vec3};
use penumbra::internal::procedural::Role;
use penumbra::internal::scene::{Panorama, Volume};
use penumbra::internal::specialisation::Specialisation;
use penumbra::internal::specialisation::features::Feature;
use penumbra::internal::stress::placement::room;
use penumbra::internal::stress::stage::{Paint, Part, square};
use penumbra::{Aov, Camera, Image, Renderer, Scene, Settings, Technique};

use crate::procedurals;
use crate::setup::{assert_same, gpu, settings};

/// A room with every feature: many lights, glass with caustics, a sky, and a procedural object.
fn everything() -> (Scene, Camera) {
    let mut stage = room();
    // Without the last two triangles the room is open behind the camera.
    stage.parts[0].triangles.truncate(10);
    let instances = (0..20).map(|i| DAffine3::from_translation(DVec3::new(0.04 * f64::from(i) - 0.4, 0.4, 0.2)));
    let bulb = square(DVec3::ZERO, DVec3::X * 0.01, DVec3::Z * 0.01);
    stage.parts.push(Part { triangles: bulb, paint: Paint::lamp(50.0), instances: instances.collect() });
    let (mut scene, camera) = stage.import().unwrap();
    let glass = &mut scene.materials[1];
    glass.roughness = 0.0;
    (glass.transmission.factor, glass.specular.factor) = (1.0, 1.0);
    glass.volume = Some(Volume { attenuation_distance: f32::INFINITY, attenuation_colour: Vec3::ONE });
    let wall = scene.materials[0].clone();
    let world = DAffine3::from_scale_rotation_translation(DVec3::splat(0.1), Default::default(), DVec3::X * 0.25);
    procedurals::place(&mut scene, &[procedurals::sphere(Role::Distance, world, wall)]);
    let sky = Panorama { width: 2, height: 1, texels: vec![[0.5; 3], [1.0; 3]] };
    scene.set_environment(Arc::new(sky), 0.0, 1.0).unwrap();
    (scene, camera)
}

/// Renders an image and returns it with the number of repairs of the map. If it `is_stopped`, each batch but the first
/// is rendered by another renderer, which resumes from a checkpoint.
fn render((scene, camera): &(Scene, Camera), settings: &Settings, is_stopped: bool) -> (Image, u64) {
    let new = || Renderer::new(gpu(), scene.clone(), camera, settings).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("state");
    let mut renderer = new();
    renderer.render_batch().unwrap();
    assert!(renderer.samples() < settings.image.spp, "one batch has all samples");
    while renderer.samples() < settings.image.spp {
        if is_stopped {
            renderer.save_checkpoint(&file).unwrap();
            renderer = new();
            renderer.resume(&file).unwrap();
        }
        renderer.render_batch().unwrap();
    }
    let statistics = renderer.statistics().unwrap();
    let repaired = statistics.photons.iter().map(|light| light.repaired).sum();
    let mut image = renderer.image().unwrap();
    image.metadata.clear();
    (image, repaired)
}

/// Repeated runs give the same bits: seven of the default technique, seven with photons alone, and three of each other
/// technique. Every other run is stopped after each batch and resumed from a checkpoint. Few photons and many audits
/// cause repairs of the map in between; with fine cells these take what audits find.
#[test]
fn runs_give_the_same_bits() {
    let scene = room().import().unwrap();
    let by_photons_alone = std::iter::once((Technique::SHADOW_PHOTONS, false));
    for (technique, fine_cells) in Technique::all().map(|technique| (technique, true)).chain(by_photons_alone) {
        let is_default = technique == Technique::default();
        let (runs, side) = if is_default { (7, 48) } else { (3, 24) };
        // Classes by a single photon are sometimes wrong.
        let settings = settings(technique, side, side, 8).with(|s| {
            s.visibility_map.photons_per_light = Some(8192);
            s.visibility_map.nearest = 1;
            s.visibility_map.fine_cells = fine_cells;
            s.visibility_map.audit = 1.0;
            s.visibility_map.dilate = Some(0);
            // The AOV of classes would leave the default technique without cells.
            s.image.aovs = if is_default { vec![Aov::Direct, Aov::Variance, Aov::Normal] } else { Aov::ALL.into() };
        });
        let (first, repaired) = render(&scene, &settings, false);
        if !fine_cells {
            assert!(repaired > 0, "the map was not repaired: the test does not cover the order of repairs");
        }
        for run in 1..runs {
            let (image, _) = render(&scene, &settings, run % 2 == 1);
            assert_same(&image, &first, &format!("{technique}, run {run}"));
        }
        let (other, _) = render(&scene, &settings.with(|s| s.image.seed = 1), false);
        assert!(other.channels != first.channels, "{technique}: another seed changes nothing");
    }
}

/// Repeated and resumed runs give the same bits for a scene with every feature, by the technique that uses them all.
#[test]
fn runs_with_every_feature_give_the_same_bits() {
    let scene = everything();
    let settings = settings(Technique::SHADOW_PHOTONS, 16, 20, 4).with(|s| s.indirect.photons = Some(1 << 12));
    let specialisation = Specialisation::new(&scene.0, None, &settings);
    let all = [
        Feature::Environment,
        Feature::Procedurals,
        Feature::Transmission,
        Feature::Zones,
        Feature::LightSampling,
        Feature::Caustics,
        Feature::CausticIrradiance,
        Feature::SpecularChains,
    ];
    assert!(all.iter().all(|feature| specialisation.features.has(*feature)), "something is missing");
    let (first, _) = render(&scene, &settings, false);
    assert!(first.channel("G").unwrap().iter().any(|x| *x > 0.0), "the image is black");
    assert_same(&render(&scene, &settings, false).0, &first, "run again");
    assert_same(&render(&scene, &settings, true).0, &first, "resumed");
}
