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
    let builder =
        Settings::builder().technique(Technique::TWO_PASS).size(64, 64).spp(80).aovs([Aov::Variance, Aov::Indirect]);
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

/// Sums of the indirect light of all samples, of every pixel and channel.
fn indirect_sums(image: &Image, samples: u32) -> Vec<f64> {
    let channels = ["indirect.R", "indirect.G", "indirect.B"].map(|name| image.channel(name).unwrap());
    channels.iter().flat_map(|channel| channel.iter()).map(|x| f64::from(*x) * f64::from(samples)).collect()
}

/// After sample 25 there are more gather rays, and the samples so far get their light. The following samples are the
/// oracle, because they have the light of more rays from the beginning. The mean of the first 25 differs from theirs
/// only by the positions of samples within pixels, which matters at edges, so the median pixel counts. Without a
/// correction, 24 of 25 samples would keep the difference, more than nine tenths of its square. The variance of the
/// corrected samples equals that of samples which had the light from the beginning.
#[test]
fn earlier_samples_get_the_light_of_later_rays() {
    let of = |rays, samples: [u32; 3]| {
        let mut renderer = renderer(&settings(Some(rays)));
        samples.map(|samples| image_of(&mut renderer, samples))
    };
    let images = of(64, [24, 25, 40]);
    let [few, first, all] = [(0, 24), (1, 25), (2, 40)].map(|(i, samples)| indirect_sums(&images[i], samples));
    let distance = |mean: &dyn Fn(usize) -> f64| {
        let square = |i: usize| (mean(i) - (all[i] - first[i]) / 15.0).powi(2);
        let mut squares: Vec<f64> = (0..all.len()).map(square).collect();
        squares.sort_by(f64::total_cmp);
        squares[squares.len() / 2]
    };
    let before = distance(&|i| few[i] / 24.0);
    let uncorrected = distance(&|i| (few[i] + (all[i] - first[i]) / 15.0) / 25.0);
    let after = distance(&|i| first[i] / 25.0);
    println!("median square of the difference: {before:.3e}, {uncorrected:.3e} uncorrected, {after:.3e} now");
    assert!(after < 0.1 * before && uncorrected > 0.9 * before, "{before:.3e}, {uncorrected:.3e}, {after:.3e}");

    let variance = |image: &Image| {
        let variance = image.channel("variance.G").unwrap();
        variance.iter().map(|x| f64::from(*x)).sum::<f64>() / variance.len() as f64
    };
    // Squares without the changes would be off by some hundredths of the squared light, a multiple of the variance.
    let ratio = variance(&images[1]) / variance(&of(128, [1, 24, 25])[2]);
    assert!((ratio - 1.0).abs() < 0.1, "{ratio}");
}

/// A render may have more samples than were requested, and is continued then too.
#[test]
fn a_render_beyond_its_samples_is_continued() {
    let settings = settings(None).with(|s| s.image.spp = 2);
    let (mut whole, mut resumed) = (renderer(&settings), renderer(&settings));
    image_of(&mut whole, 3);
    resumed.resume_from(&whole.checkpoint().unwrap()).unwrap();
    let [whole, resumed] = [&mut whole, &mut resumed].map(|renderer| image_of(renderer, 4));
    assert_same(&resumed, &whole, "after a checkpoint");
}

/// Estimates decide when gather rays are added. A render that is resumed from a checkpoint makes the same decisions.
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
