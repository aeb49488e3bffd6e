//! The same seed, device and binary give the same bytes.

use penumbra::stress::placement::room;
use penumbra::{Aov, Image, Renderer, Settings, Technique};

use crate::setup::{assert_same, gpu, settings};

/// Renders, by way of a checkpoint after that many batches if it is given.
fn render(settings: &Settings, stop: Option<u32>) -> (Image, u64) {
    let (scene, camera) = room().import().unwrap();
    let mut renderer = Renderer::new(gpu(), scene.clone(), &camera, settings).unwrap();
    if let Some(stop) = stop {
        for _ in 0..stop {
            renderer.render_batch().unwrap();
        }
        assert!(renderer.samples() < settings.spp, "nothing is left to be done");
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("state");
        renderer.save_checkpoint(&file).unwrap();
        renderer = Renderer::new(gpu(), scene, &camera, settings).unwrap();
        renderer.resume(&file).unwrap();
    }
    while renderer.samples() < settings.spp {
        renderer.render_batch().unwrap();
    }
    let healed = renderer.statistics().unwrap().photons.iter().map(|light| light.healed).sum();
    let mut image = renderer.image().unwrap();
    image.metadata.clear();
    (image, healed)
}

/// Twenty runs of the default technique, three of each other; every other one stopped on its way and taken up again from a
/// checkpoint. Photons are few and audits many, so that the map is mended in between.
#[test]
fn runs_are_the_same_bytes() {
    for technique in Technique::ALL {
        let runs = if technique == Technique::default() { 20 } else { 3 };
        // No classes among the channels, so that the pilot may leave the map out.
        let settings = Settings {
            photons: 4096,
            nearest: 8,
            audit: 0.25,
            aovs: vec![Aov::Direct, Aov::Variance, Aov::Normal],
            ..settings(technique, 24, 20, 8)
        };
        let (first, healed) = render(&settings, None);
        if technique == Technique::ShadowPhotons {
            assert!(healed > 0, "nothing was mended: the test does not see its order");
        }
        for run in 1..runs {
            let stop = (run % 2 == 1).then_some(1 + run / 2 % 2);
            assert_same(&render(&settings, stop).0, &first, &format!("{technique}, run {run}"));
        }
        let (other, _) = render(&Settings { seed: 1, ..settings }, None);
        assert!(other.channels != first.channels, "{technique}: another seed changes nothing");
    }
}
