//! Indirect light that grows with the samples.

use penumbra::internal::scene::ImportOptions;
use penumbra::{Aov, Image, Renderer, Scene, Settings, Technique};

use crate::setup::{assert_same, gpu, scene_file};

fn renderer(settings: &Settings) -> Renderer<'static> {
    let scene = Scene::load(scene_file("box.glb"), &ImportOptions::default()).unwrap();
    let camera = scene.cameras[0].clone();
    Renderer::new(gpu(), scene, &camera, settings).unwrap()
}

fn settings(gather_rays: Option<u32>) -> Settings {
    let builder = Settings::builder().technique(Technique::TWO_PASS).size(64, 64).spp(80).aovs([Aov::Variance]);
    builder.build().unwrap().with(|s| s.indirect.irradiance_cache.gather_rays = gather_rays)
}

/// The image of `samples` samples.
fn image_of(renderer: &mut Renderer<'_>, samples: u32) -> Image {
    while renderer.samples() < samples {
        renderer.render_up_to(samples - renderer.samples()).unwrap();
    }
    assert_eq!(renderer.samples(), samples);
    renderer.image().unwrap()
}

fn mean_square(a: &Image, b: &Image) -> f64 {
    let [a, b] = [a, b].map(|image| image.rgb().unwrap().concat());
    a.iter().zip(&b).map(|(a, b)| f64::from(a - b).powi(2)).sum::<f64>() / a.len() as f64
}

/// Samples with the light of few gather rays get that of more once there are more. Direct light is the same in both
/// images, so they differ by indirect light alone: with 24 samples by that of 64 and of 128 rays, with 25 by that of
/// 128 and of 256 rays, whose squares are two fifths of it (`src/render/growth.rs`). Without a correction 24 of 25
/// samples would keep the difference, more than nine tenths of its square. Their variance is that of samples which had
/// the light from the beginning.
#[test]
fn earlier_samples_get_the_light_of_later_rays() {
    let mut few = renderer(&settings(Some(64)));
    let mut many = renderer(&settings(Some(128)));
    let before = mean_square(&image_of(&mut few, 24), &image_of(&mut many, 24));
    let (few, many) = (image_of(&mut few, 25), image_of(&mut many, 25));
    let after = mean_square(&few, &many);
    println!("mean square of the difference: {before:.3e}, and {after:.3e} with the light of later rays");
    assert!(before > 0.0 && after < 0.65 * before, "{before:.3e}, {after:.3e}");

    let variance = |image: &Image| {
        let variance = image.channel("variance.G").unwrap();
        variance.iter().map(|x| f64::from(*x)).sum::<f64>() / variance.len() as f64
    };
    // Squares without the changes would be off by some hundredths of the squared light, a multiple of the variance.
    let ratio = variance(&few) / variance(&many);
    assert!((ratio - 1.0).abs() < 0.1, "{ratio}");
}

/// Estimates decide when there are more rays. A render that goes on from a checkpoint makes the same decisions.
#[test]
fn rays_grow_by_estimates_that_checkpoints_keep() {
    let settings = settings(None);
    let (mut whole, mut first) = (renderer(&settings), renderer(&settings));
    let rays = |renderer: &Renderer<'_>| renderer.statistics().unwrap().rays.gather;
    image_of(&mut whole, 1);
    let few = rays(&whole);
    let image = image_of(&mut whole, 80);
    assert!(rays(&whole) > 10 * few, "{few} gather rays for one sample, {} for 80", rays(&whole));
    // By the same batches, which are up to the estimates.
    while first.samples() < 20 {
        first.render_batch().unwrap();
    }
    let mut resumed = renderer(&settings);
    resumed.resume_from(&first.checkpoint().unwrap()).unwrap();
    let (mut free, mut batches) = (renderer(&settings), 0);
    while free.samples() < 80 {
        free.render_batch().unwrap();
        batches += 1;
    }
    while resumed.samples() < 80 {
        resumed.render_batch().unwrap();
    }
    assert!(batches > 5);
    assert_same(&resumed.image().unwrap(), &free.image().unwrap(), "after a checkpoint");
    assert_eq!(rays(&resumed), rays(&free));
    // Samples that come in other batches meet the estimates at other numbers.
    assert!(mean_square(&image, &free.image().unwrap()) < 1e-2, "batches change the image by more than noise");
}
