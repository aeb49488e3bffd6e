//! Adaptive sampling: samples have the bits of those in other renders, go where noise is, and are distributed without
//! bias.

use std::collections::BTreeSet;

use penumbra::internal::scene::ImportOptions;
use penumbra::settings::{Background, Crop, Denoise, Sampling};
use penumbra::{Aov, Denoiser, Image, Renderer, Scene, Settings, Technique};

use crate::setup::{gpu, render, scene_file};

fn settings(technique: Technique, [width, height]: [u32; 2], max_bounces: u32) -> Settings {
    let builder = Settings::builder().technique(technique).size(width, height).max_bounces(max_bounces);
    builder.spp(4096).aovs([Aov::Samples, Aov::Direct, Aov::Normal]).build().unwrap()
}

/// Renders until all blocks have an estimated relMSE of `noise`.
fn adaptive(scene: &str, settings: &Settings, noise: f64, denoiser: &Denoiser) -> Image {
    complete(scene, &settings.clone().with(|s| s.image.noise = Some(noise)), denoiser)
}

/// Renders with `spp` samples per pixel on average, in adaptive sampling with a fixed budget.
fn shared_out(scene: &str, settings: &Settings, spp: u32) -> Image {
    let settings = settings.clone().with(|s| (s.image.spp, s.image.sampling) = (spp, Sampling::Adaptive));
    complete(scene, &settings, &Denoiser::default())
}

/// Renders all samples that the settings request.
fn complete(scene: &str, settings: &Settings, denoiser: &Denoiser) -> Image {
    completed(scene, settings, denoiser).denoised_image(denoiser).unwrap()
}

/// A renderer with all samples that the settings request.
fn completed(scene: &str, settings: &Settings, denoiser: &Denoiser) -> Renderer<'static> {
    let settings = settings.clone().with(|s| s.image.denoise = denoiser.choice());
    let scene = Scene::load(scene_file(scene), &ImportOptions::default()).unwrap();
    let camera = scene.cameras[0].clone();
    let mut renderer = Renderer::new(gpu(), scene, &camera, &settings).unwrap();
    while renderer.wants_samples(denoiser).unwrap() {
        renderer.render_batch().unwrap();
    }
    renderer
}

/// Techniques that decide points and never audit them state the error of their samples, which is that of `two-pass` or
/// less: no audit bounds the errors of their classes. A missing bound counted as the largest, 64 over the samples.
#[test]
fn techniques_without_audits_state_the_error_of_their_samples() {
    let estimate = |settings: &Settings| {
        // With a denoiser the film keeps the sums that the estimate needs.
        let denoiser = Denoiser::new(Denoise::Statistical, None).unwrap();
        let renderer = completed("box.glb", &settings.clone().with(|s| s.image.spp = 16), &denoiser);
        let points = renderer.statistics().unwrap().points;
        (renderer.estimated_relmse().unwrap().unwrap(), points.lit + points.shadowed)
    };
    let of = |technique| settings(technique, [24, 24], 0);
    let (of_all, _) = estimate(&of(Technique::TWO_PASS));
    let unaudited = of(Technique::SHADOW_PHOTONS).with(|s| {
        s.visibility_map.audit = 0.0;
        s.visibility_map.photons_per_light = Some(1 << 14);
    });
    for settings in [of(Technique::LIGHT_BUFFER), of(Technique::VOXEL_TAGS), unaudited] {
        let (estimate, decided) = estimate(&settings);
        println!("{}: {estimate}, two-pass {of_all}", settings.technique);
        assert!(decided > 1000, "{}: {decided} decided points", settings.technique);
        // Two estimates of one error by one difference of halves each.
        assert!(estimate > 0.5 * of_all && estimate < 2.0 * of_all, "{}: {estimate}, {of_all}", settings.technique);
    }
}

/// The samples of a pixel are the same whatever the others get: pixels of n samples have the bits of a render of n.
#[test]
fn pixels_have_the_bits_of_uniform_renders() {
    for technique in [Technique::PATH, Technique::TWO_PASS] {
        // Blocks at the edges are not whole.
        let settings = settings(technique, [60, 45], 1).with(|s| {
            // From 24 samples on there are more gather rays, which change the samples before.
            s.image.spp = 23;
            s.indirect.irradiance_cache.gather_rays = Some(64);
        });
        assert_bits(&adaptive("sphere.glb", &settings, 2e-3, &Denoiser::default()), &settings);
        // A part of an image has blocks of its own.
        let part = settings.clone().with(|s| s.image.crop = Some(Crop { x: 13, y: 6, width: 31, height: 39 }));
        assert_bits(&adaptive("sphere.glb", &part, 2e-3, &Denoiser::default()), &part);
        // Pixels get up to 80 samples, and gather rays grow with the mean.
        let direct = settings.with(|s| s.indirect.max_bounces = 0);
        assert_bits(&shared_out("sphere.glb", &direct, 10), &direct);
    }
}

/// Checks that the pixels of an image of the sphere have the bits of images with their numbers of samples.
fn assert_bits(image: &Image, settings: &Settings) {
    let technique = settings.technique;
    let samples = image.channel("samples").unwrap();
    let numbers: BTreeSet<u32> = samples.iter().map(|n| *n as u32).collect();
    assert!(numbers.len() >= 3, "{technique}: {numbers:?}");
    let mut differing = 0;
    for number in numbers {
        let uniform = settings.clone().with(|s| s.image.spp = number);
        let (whole, statistics) = render(&scene_file("sphere.glb"), &uniform);
        assert_eq!(statistics.mean_samples, f64::from(number));
        for channel in &image.channels {
            let expected = whole.channel(&channel.name).unwrap();
            for (pixel, (got, expected)) in channel.samples.iter().zip(expected).enumerate() {
                let same = got.to_bits() == expected.to_bits();
                let counted = samples[pixel] as u32 == number;
                assert!(same || !counted, "{technique}, {number} samples: {} of pixel {pixel}", channel.name);
                differing += usize::from(!same);
            }
        }
    }
    assert!(differing > 100, "{technique}: images of other numbers of samples are the same");
}

/// The noise is reached with fewer samples than uniform ones would take, and pixels without light get few.
#[test]
fn samples_go_where_the_noise_is() {
    let statistical = Denoiser::new(Denoise::Statistical, None).unwrap();
    // The filter takes most of the noise away: its image needs a smaller bound to take as many samples.
    for (denoiser, noise) in [(Denoiser::default(), 2e-3), (statistical, 4e-4)] {
        let settings = settings(Technique::PATH, [64, 64], 0);
        let image = adaptive("box.glb", &settings, noise, &denoiser);
        let samples = image.channel("samples").unwrap();
        let mean = samples.iter().sum::<f32>() / samples.len() as f32;
        let (least, most) = samples.iter().fold((f32::MAX, 0f32), |(a, b), n| (a.min(*n), b.max(*n)));
        // Each pixel has 8 samples before the first estimate; those without light get no more.
        assert!(least == 8.0 && most >= 64.0 && mean < most / 2.0, "{least} to {most}, mean {mean}");
        let reference = settings.clone().with(|s| (s.image.spp, s.image.seed) = (1024, 1));
        let (reference, _) = render(&scene_file("box.glb"), &reference);
        let error = relmse(&image.denoised().unwrap_or_else(|| image.clone()), &reference);
        // Many blocks have far less; estimates from halves are too large for stratified samples, by up to 4.
        assert!(error < noise && error > noise / 40.0, "{:?}: {error}", denoiser.choice());
    }
}

/// The noise of edges before a colour counts, though they have no light of their own: the image has the error that was
/// requested, without and with a denoiser.
#[test]
fn edges_before_a_background_get_samples() {
    let statistical = Denoiser::new(Denoise::Statistical, None).unwrap();
    let noise = 2e-4;
    for denoiser in [Denoiser::default(), statistical] {
        let settings = settings(Technique::PATH, [64, 64], 0)
            .with(|s| (s.light_scale, s.image.background) = (0.0, Background::Colour([1.0; 3])));
        let image = adaptive("sphere.glb", &settings, noise, &denoiser);
        let most = image.channel("samples").unwrap().iter().fold(0f32, |most, n| most.max(*n));
        assert!(most >= 64.0, "{:?}: {most}", denoiser.choice());
        // What is seen is the colour alone, as far as no surface covers it.
        let reference = settings.with(|s| (s.image.spp, s.image.seed) = (1024, 1));
        let (reference, _) = render(&scene_file("sphere.glb"), &reference);
        let error = relmse(&image.denoised().unwrap_or(image), &reference);
        assert!(error < noise, "{:?}: {error}", denoiser.choice());
    }
}

fn relmse(image: &Image, reference: &Image) -> f64 {
    let relative = |name: &str| {
        let (x, r) = (image.channel(name).unwrap(), reference.channel(name).unwrap());
        let error = |(x, r): (&f32, &f32)| f64::from(x - r).powi(2) / (f64::from(*r).powi(2) + 0.01);
        x.iter().zip(r).map(error).sum::<f64>() / x.len() as f64
    };
    ["R", "G", "B"].map(relative).iter().sum::<f64>() / 3.0
}

/// Samples that are shared out by the noise make less error than equal numbers of as many: where most of the noise is
/// at edges and in penumbrae, at most 0.6 of it. Their mean is what was requested, but for less than one in a hundred
/// that no pixel may have.
#[test]
fn shared_out_samples_make_less_error() {
    for technique in [Technique::PATH, Technique::SHADOW_PHOTONS] {
        let settings = settings(technique, [96, 96], 0);
        let reference = settings.clone().with(|s| (s.image.spp, s.image.seed) = (1024, 1));
        let (reference, _) = render(&scene_file("box.glb"), &reference);
        let image = shared_out("box.glb", &settings, 20);
        let samples = image.channel("samples").unwrap();
        let mean = samples.iter().sum::<f32>() / samples.len() as f32;
        assert!(mean > 19.8 && mean <= 20.0, "{technique}: {mean}");
        let (least, most) = samples.iter().fold((f32::MAX, 0f32), |(a, b), n| (a.min(*n), b.max(*n)));
        // Half of 16, the last mean at which samples are allocated, and eight times the mean of 20 at the end.
        assert!(least >= 8.0 && most > 60.0 && most <= 160.0, "{technique}: {least} to {most}");
        let uniform = render(&scene_file("box.glb"), &settings.clone().with(|s| s.image.spp = 20)).0;
        let [error, of_uniform] = [&image, &uniform].map(|image| relmse(image, &reference));
        assert!(error < 0.6 * of_uniform, "{technique}: {error}, with equal numbers {of_uniform}");
    }
}

/// Samples end where few of them happen to agree, but blocks are large enough that no bias can be measured: over 16
/// seeds, the mean of the image is within 4 standard errors of that of many samples (Student's t with 15 degrees of
/// freedom: p = 0.001), and these are less than a thousandth. The same images 0.5 % darker do not pass.
#[test]
fn no_bias_can_be_measured() {
    const SEEDS: u32 = 16;
    let settings = settings(Technique::PATH, [96, 96], 2);
    let mean = |image: &Image| {
        let sum = |name: &str| image.channel(name).unwrap().iter().map(|x| f64::from(*x)).sum::<f64>();
        ["R", "G", "B"].map(sum).iter().sum::<f64>()
    };
    let truth = settings.clone().with(|s| (s.image.spp, s.image.seed) = (1024, 1000));
    let truth = mean(&render(&scene_file("box.glb"), &truth).0);
    // Until all have little noise, and by decisions after two and after four samples.
    let of_noise = |settings: &Settings| adaptive("box.glb", settings, 0.1, &Denoiser::default());
    let of_shares = |settings: &Settings| shared_out("box.glb", settings, 8);
    for image in [&of_noise as &dyn Fn(&Settings) -> Image, &of_shares] {
        let of_seed = |seed: u32| mean(&image(&settings.clone().with(|s| s.image.seed = seed))) / truth;
        let means: Vec<f64> = (0..SEEDS).map(of_seed).collect();
        let average = means.iter().sum::<f64>() / f64::from(SEEDS);
        let variance = means.iter().map(|x| (x - average).powi(2)).sum::<f64>() / f64::from(SEEDS - 1);
        let error = (variance / f64::from(SEEDS)).sqrt();
        let is_unbiased = |average: f64| (average - 1.0).abs() < 4.0 * error;
        assert!(error < 1e-3, "{error}");
        assert!(is_unbiased(average), "{average} +- {error}");
        assert!(!is_unbiased(0.995 * average), "a bias of 0.5 % is not noticed");
    }
}
