//! Faults planted in renders of the box: the report must identify them as bias or noise.

use penumbra::internal::report::document::{EntrantReport, Report};
use penumbra::internal::report::finding::FindingKind;
use penumbra::internal::report::reference::Reference;
use penumbra::internal::report::run::{Run, Snapshot, Starter, Subject};
use penumbra::{Denoiser, Image, Renderer, Settings, Technique};

use crate::setup::{Box, folder, goal};

const REPEATS: u32 = 5;

/// A run with a fixed number of samples and nominal times. `plant` modifies its images.
fn run(subject: &Subject<'_>, settings: Settings, plant: impl Fn(u32, &mut Image)) -> Run {
    let mut renderer = Renderer::new(subject.gpu, subject.scene.clone(), subject.camera, &settings).unwrap();
    let snapshots = [(1.0, 16), (4.0, 64)].map(|(budget, samples)| {
        while renderer.samples() < samples {
            renderer.render_up_to(samples - renderer.samples()).unwrap();
        }
        let mut image = renderer.image().unwrap();
        plant(settings.image.seed, &mut image);
        let rays = renderer.statistics().unwrap().rays;
        Snapshot {
            budget,
            technique: Technique::PATH,
            sampled: budget,
            denoise: 0.0,
            samples,
            rays,
            image,
            estimate: None,
        }
    });
    let statistics = renderer.statistics().unwrap();
    Run {
        is_automatic: false,
        settings,
        setup: 0.5,
        first: Some(0.6),
        snapshots: snapshots.into(),
        noisy: None,
        denoisers: Vec::new(),
        denoise: 0.0,
        statistics,
        map_left_out: None,
        time: 4.0,
    }
}

/// Multiplies the colour of each pixel by a factor.
fn scale(image: &mut Image, factor: impl Fn(u32, u32) -> f32) {
    let width = image.width;
    for channel in image.channels.iter_mut().filter(|channel| ["R", "G", "B"].contains(&channel.name.as_str())) {
        for (i, x) in channel.samples.iter_mut().enumerate() {
            *x *= factor(i as u32 % width, i as u32 / width);
        }
    }
}

/// A pseudo-random sign, -1 or 1.
fn sign(seed: u32, x: u32, y: u32) -> f32 {
    // The finaliser of MurmurHash3 mixes all bits.
    let mut h = (seed * 65_536 + y * 256 + x).wrapping_mul(0x9e37_79b9);
    h = (h ^ (h >> 16)).wrapping_mul(0x85eb_ca6b);
    h = (h ^ (h >> 13)).wrapping_mul(0xc2b2_ae35);
    if (h ^ (h >> 16)) & 1 == 0 { 1.0 } else { -1.0 }
}

/// The report names planted bias and planted noise, and recommends the technique without a fault.
#[test]
fn planted_bias_and_noise_are_named() {
    let scene = Box::load();
    let settings = Settings::default().with(|s| {
        s.image.width = 32;
        s.image.height = 32;
    });
    let subject = scene.subject(&settings);
    let folder = folder();
    // The reference's error is a sixth of that of 64 samples.
    let reference = Reference::make(&subject, folder.path(), goal(0.01), &|| false, &mut |_| {}).unwrap().unwrap();
    assert!(reference.standard_error().unwrap() <= 0.01);

    let mut runs = Vec::new();
    for seed in 0..REPEATS {
        // All runs render by path tracing. The techniques are just names, which differ by what is planted.
        let rendered = |technique: Technique, light_scale: f32, plant: &dyn Fn(u32, &mut Image)| {
            let path = settings.clone().with(|s| {
                s.technique = Technique::PATH;
                s.image.seed = seed;
                s.image.spp = 64;
                s.light_scale = light_scale;
            });
            let mut run = run(&subject, path, plant);
            run.settings.technique = technique;
            run
        };
        runs.push(rendered(Technique::PATH, 1.0, &|_, _| {}));
        runs.push(rendered(Technique::TWO_PASS, 1.02, &|_, _| {}));
        let noise = |seed: u32, image: &mut Image| scale(image, |x, y| 1.0 + 0.3 * sign(seed, x, y));
        runs.push(rendered(Technique::SHADOW_PHOTONS, 1.0, &noise));
        // A pattern that is the same in every run and keeps the mean.
        let pattern = |_: u32, image: &mut Image| scale(image, |x, y| 1.0 + 0.1 * sign(12, x, y));
        runs.push(rendered(Technique::VISIBILITY_ESTIMATE, 1.0, &pattern));
    }
    let report = Report::new("box.glb", &subject.gpu.info, &reference, &runs, Vec::new()).unwrap();
    let of = |technique: Technique| -> &EntrantReport {
        report.entrants.iter().find(|report| report.settings.technique == technique).unwrap()
    };
    for entrant in &report.entrants {
        println!("{}: {}", entrant.entrant, entrant.finding.text);
    }
    println!("{}", report.advice);

    let plain = of(Technique::PATH);
    assert_eq!(plain.finding.kind, FindingKind::Noise, "{}", plain.finding.text);
    let strong = of(Technique::TWO_PASS);
    assert_eq!(strong.finding.kind, FindingKind::Bias);
    assert!(strong.finding.text.contains("the image is too bright by "), "{}", strong.finding.text);
    // The tolerance is twice the half width of the interval at this number of samples.
    assert!((strong.brightness.value - 0.02).abs() < 0.002, "{:?}", strong.brightness);
    let noisy = of(Technique::SHADOW_PHOTONS);
    assert_eq!(noisy.finding.kind, FindingKind::Noise, "{}", noisy.finding.text);
    let last = |entrant: &EntrantReport| entrant.snapshots.last().unwrap().clone();
    // Noise of 0.3 r adds 0.09 r^2 / (r^2 + 0.01) to the variance, of which more than 0.03 must show.
    assert!(last(noisy).variance.low > last(plain).variance.high + 0.03);
    let wrong = of(Technique::VISIBILITY_ESTIMATE);
    assert_eq!(wrong.finding.kind, FindingKind::Bias);
    assert!(wrong.finding.text.contains("however long"), "{}", wrong.finding.text);
    // The pattern of 0.1 r adds 0.01 r^2 / (r^2 + 0.01) to the bias.
    assert!(last(wrong).bias.low > 0.003 && last(wrong).bias.high < 0.01, "{:?}", last(wrong).bias);
    assert!(report.advice.starts_with("Use path"), "{}", report.advice);
}

/// The error that all runs share counts as bias only from twice the reference's own error on, because the halves can
/// underestimate that error by half if a few bright pixels dominate it.
#[test]
fn the_references_own_error_is_not_called_bias() {
    let scene = Box::load();
    let settings = Settings::default().with(|s| {
        s.image.width = 8;
        s.image.height = 8;
    });
    let subject = scene.subject(&settings);
    const GREY: f32 = 0.5;
    let image = |value: &dyn Fn(u32, u32) -> f32| {
        let mut image = Image::new(8, 8);
        let samples: Vec<f32> = (0..64).map(|i| value(i % 8, i / 8)).collect();
        for name in ["R", "G", "B"] {
            image.add_channel(name, samples.clone());
        }
        image
    };
    let sign = |bit: u32| if bit & 1 == 0 { 1.0 } else { -1.0 };
    // A pattern that all runs share, and one of each run that is orthogonal to all others.
    let (common, own) = (0.05f32, 0.035);
    let runs: Vec<Run> = (0..3)
        .map(|seed| {
            let starter = Starter::new(Technique::PATH, Denoiser::default());
            let mut run = Run::new(&subject, &starter, seed, &[1e-9], &|| false).unwrap().unwrap();
            let image = image(&|x, y| GREY + common * sign(y) + own * sign(x >> seed));
            let rays = run.statistics.rays;
            let [budget, sampled] = [1.0; 2];
            run.snapshots.push(Snapshot {
                budget,
                technique: Technique::PATH,
                sampled,
                denoise: 0.0,
                samples: 4,
                rays,
                image,
                estimate: None,
            });
            run
        })
        .collect();
    let kind = |common_over_floor: f32| {
        let mut reference = Reference { image: image(&|_, _| GREY), goal: None };
        for name in ["variance.R", "variance.G", "variance.B"] {
            reference.image.add_channel(name, vec![common * common / common_over_floor; 64]);
        }
        let report = Report::new("box.glb", &subject.gpu.info, &reference, &runs, Vec::new()).unwrap();
        report.entrants[0].finding.kind
    };
    assert_eq!(kind(1.5), FindingKind::Reference);
    assert_eq!(kind(3.0), FindingKind::Bias);
}
