//! Entrants with a denoiser: their time, their bias and variance, and the error that they expect of themselves.

use penumbra::internal::report::document::{EntrantReport, Report};
use penumbra::internal::report::entrant::Entrant;
use penumbra::internal::report::estimate;
use penumbra::internal::report::finding::FindingKind;
use penumbra::internal::report::reference::Reference;
use penumbra::internal::report::run::{Run, Snapshot, Starter, Subject};
use penumbra::internal::statistics::Rays;
use penumbra::settings::Denoise;
use penumbra::{Denoiser, Image, Renderer, Settings, Technique};

use crate::setup::{Box, folder, goal};

const RUNS: u32 = 3;

/// Width and height of images that are made here.
const SIDE: u32 = 8;
const GREY: f32 = 0.5;

/// Seconds of the set-up and of the denoiser of runs that are made here.
const SETUP: f64 = 0.5;
const FILTER: f64 = 0.25;

/// An image of given values.
fn image(value: impl Fn(u32, u32) -> f32) -> Image {
    let mut image = Image::new(SIDE, SIDE);
    let samples: Vec<f32> = (0..SIDE * SIDE).map(|i| value(i % SIDE, i / SIDE)).collect();
    for name in ["R", "G", "B"] {
        image.add_channel(name, samples.clone());
    }
    image
}

/// A reference of a variance.
fn reference(variance: f32) -> Reference {
    let mut image = image(|_, _| GREY);
    for name in ["variance.R", "variance.G", "variance.B"] {
        image.add_channel(name, vec![variance; (SIDE * SIDE) as usize]);
    }
    Reference { image, goal: None }
}

/// Errors planted in an image: the part that is the same in all runs, and the part of each run.
#[derive(Clone, Copy)]
struct Wrong {
    common: f32,
    own: f32,
}

/// The relMSE of a difference from the reference.
fn relmse(difference: f32) -> f64 {
    let [difference, grey] = [difference, GREY].map(f64::from);
    difference * difference / (grey * grey + 0.01)
}

fn sign(bit: u32) -> f32 {
    if bit & 1 == 0 { 1.0 } else { -1.0 }
}

/// Runs with an image at 1 s, one at 4 s, and so on, which are wrong in these ways. Their patterns are orthogonal.
fn runs(subject: &Subject<'_>, denoise: Denoise, wrong: &[Wrong]) -> Vec<Run> {
    let run = |seed: u32| {
        let starter = Starter::new(Technique::PATH, Denoiser::default());
        let mut run = Run::new(subject, &starter, seed, &[1e-9], &|| false).unwrap().unwrap();
        run.settings.image.denoise = denoise;
        run.setup = SETUP;
        for (index, Wrong { common, own }) in wrong.iter().enumerate() {
            let budget = 4f64.powi(index as i32);
            run.snapshots.push(Snapshot {
                budget,
                technique: Technique::PATH,
                sampled: budget,
                denoise: if denoise == Denoise::None { 0.0 } else { FILTER },
                samples: 4,
                rays: Rays::default(),
                image: image(|x, y| GREY + common * sign(y) + own * sign(x >> seed)),
                estimate: (denoise != Denoise::None).then(|| 0.5 * relmse(common.hypot(*own))),
            });
        }
        run
    };
    (0..RUNS).map(run).collect()
}

fn settings(side: u32) -> Settings {
    Settings::builder().size(side, side).photons_per_light(4096).indirect_photons(4096).build().unwrap()
}

fn of(report: &Report, entrant: Entrant) -> &EntrantReport {
    report.entrants.iter().find(|report| report.entrant == entrant).unwrap()
}

const DENOISED: Entrant = Entrant { technique: Some(Technique::PATH), denoise: Denoise::Statistical };

/// A denoiser's bias is distinguished from its variance, and a bias that falls with the samples from one that stays.
/// The planted values are found, up to the rounding of f32.
#[test]
fn a_bias_that_falls_is_told_from_one_that_stays() {
    let scene = Box::load();
    let settings = settings(SIDE);
    let subject = scene.subject(&settings);
    let report = |denoise: Denoise, wrong: &[Wrong]| {
        let runs = runs(&subject, denoise, wrong);
        let report = Report::new("box.glb", &subject.gpu.info, &reference(1e-9), &runs, Vec::new()).unwrap();
        let entrant = report.entrants[0].clone();
        assert_eq!(entrant.entrant, Entrant { technique: Some(Technique::PATH), denoise });
        for (snapshot, Wrong { common, own }) in entrant.snapshots.iter().zip(wrong) {
            for (found, planted) in [(snapshot.bias, *common), (snapshot.variance, *own)] {
                assert!((found.value - relmse(planted)).abs() < 1e-6, "{found:?}, not {}", relmse(planted));
            }
        }
        entrant.finding
    };
    let wrong = |common: f32| Wrong { common, own: 0.02 };
    let falling = [wrong(0.05), wrong(0.02)];
    // 0.81 of the bias is left: a fall that may be about to stop.
    let staying = [wrong(0.05), wrong(0.045)];
    let cases = [
        (Denoise::Statistical, &falling[..], FindingKind::FallingBias, "the same in every run; the bias falls"),
        (Denoise::Statistical, &staying, FindingKind::Bias, "the same in every run; the bias does not clearly fall"),
        (
            Denoise::Statistical,
            &falling[..1],
            FindingKind::Bias,
            "a single budget does not show whether the bias falls",
        ),
        (Denoise::None, &staying, FindingKind::Bias, "of the error stays however long the render takes"),
        (Denoise::Statistical, &[wrong(0.0), wrong(0.0)], FindingKind::Noise, "differs from run to run"),
    ];
    for (denoise, wrong, kind, words) in cases {
        let finding = report(denoise, wrong);
        assert_eq!(finding.kind, kind, "{}", finding.text);
        assert!(finding.text.contains(words), "{words:?} in {}", finding.text);
    }
}

/// The time of an image includes the denoiser's; the slope includes sampling only. The estimate is compared with the
/// error without the reference's.
#[test]
fn time_and_estimate_are_those_of_the_denoised_image() {
    let scene = Box::load();
    let settings = settings(SIDE);
    let subject = scene.subject(&settings);
    let wrong = [Wrong { common: 0.05, own: 0.035 }, Wrong { common: 0.02, own: 0.01 }];
    let mut both = runs(&subject, Denoise::None, &wrong);
    both.extend(runs(&subject, Denoise::Statistical, &wrong));
    let report =
        |variance: f32| Report::new("box.glb", &subject.gpu.info, &reference(variance), &both, Vec::new()).unwrap();
    let found = report(1e-9);
    let names: Vec<String> = found.entrants.iter().map(|entrant| entrant.entrant.to_string()).collect();
    assert_eq!(names, ["path", "path+statistical"]);
    assert!(found.csv().contains("\npath+statistical,0,1,1.25,0.25,4,"), "{}", found.csv());

    let [raw, denoised] = [Entrant::raw(Technique::PATH), DENOISED].map(|entrant| of(&found, entrant));
    for (entrant, filter) in [(raw, 0.0), (denoised, FILTER)] {
        assert_eq!(entrant.time.denoise, filter);
        let times: Vec<f64> = entrant.snapshots.iter().map(|snapshot| snapshot.time.value).collect();
        assert_eq!(times, [1.0 + filter, 4.0 + filter]);
        let [first, last] = wrong.map(|wrong| relmse(wrong.common.hypot(wrong.own)));
        let slope = (last / first).ln() / ((4.0 - SETUP) / (1.0 - SETUP)).ln();
        // The reference is wrong by a hundred-thousandth of the smaller error.
        assert!((entrant.slope.unwrap().value - slope).abs() < 1e-4, "{:?}, not {slope}", entrant.slope);
    }
    let last = |report: &Report, entrant: Entrant| of(report, entrant).snapshots.last().unwrap().clone();
    assert!(last(&found, Entrant::raw(Technique::PATH)).estimate.is_none());
    let ratio = |variance: f32| last(&report(variance), DENOISED).estimate_ratio;
    // The planted estimate is half of the error, of which a fifth is now put down to the reference; if that is more
    // than half, nothing is said.
    let error = wrong[1].common.hypot(wrong[1].own).powi(2);
    assert!((ratio(1e-9).unwrap().value - 0.5).abs() < 1e-4);
    assert!((ratio(0.2 * error).unwrap().value - 0.625).abs() < 1e-4);
    assert!(ratio(0.6 * error).is_none());
}

/// Renders of four samples: fewer leave the bias in doubt.
const RENDERS: u32 = 12;

/// Denoising four samples of the box gives less error than the samples have, and about as much as the denoiser
/// estimates.
#[test]
fn a_denoised_image_has_the_error_that_it_expects() {
    let scene = Box::load();
    let settings = settings(48);
    let subject = scene.subject(&settings);
    let folder = folder();
    // A standard error of 2 % is a hundredth of the squared error of four samples.
    let reference = Reference::make(&subject, folder.path(), goal(0.02), &|| false, &mut |_| {}).unwrap().unwrap();
    let denoiser = Denoiser::new(Denoise::Statistical, None).unwrap();
    let mut runs = Vec::new();
    for seed in 0..RENDERS {
        let settings = settings.clone().with(|s| {
            s.technique = Technique::PATH;
            s.image.denoise = Denoise::Statistical;
            s.image.seed = seed;
            s.image.spp = 4;
        });
        let mut renderer = Renderer::new(subject.gpu, subject.scene.clone(), subject.camera, &settings).unwrap();
        while renderer.samples() < 4 {
            renderer.render_batch().unwrap();
        }
        let image = renderer.denoised_image(&denoiser).unwrap();
        for (denoise, shown, estimate) in [
            (Denoise::None, image.clone(), None),
            (Denoise::Statistical, image.denoised().unwrap(), estimate::denoised_relmse(&image)),
        ] {
            let (sampled, rays) = (1.0, renderer.statistics().unwrap().rays);
            let snapshot = Snapshot {
                budget: 1.0,
                technique: Technique::PATH,
                sampled,
                denoise: 0.0,
                samples: 4,
                rays,
                image: shown,
                estimate,
            };
            runs.push(Run {
                is_automatic: false,
                settings: settings.clone().with(|s| s.image.denoise = denoise),
                setup: SETUP,
                first: Some(1.0),
                snapshots: vec![snapshot],
                noisy: None,
                denoisers: Vec::new(),
                denoise: 0.0,
                statistics: renderer.statistics().unwrap(),
                map_left_out: None,
                time: 1.0,
            });
        }
    }
    let report = Report::new("box.glb", &subject.gpu.info, &reference, &runs, Vec::new()).unwrap();
    let last = |entrant: Entrant| of(&report, entrant).snapshots.last().unwrap().clone();
    let (raw, denoised) = (last(Entrant::raw(Technique::PATH)), last(DENOISED));
    for entrant in &report.entrants {
        let shown = entrant.snapshots.last().unwrap();
        println!("{}: {}; {:?} {:?}", entrant.entrant, entrant.finding.text, shown.bias, shown.variance);
    }
    println!("{:?} of {:?}, expected {:?}", denoised.relmse, raw.relmse, denoised.estimate);
    // A fifth was measured. In one run of twelve a firefly adds as much to both errors.
    assert!(denoised.relmse.high < 0.5 * raw.relmse.low);
    // What is gained is variance, at the cost of some bias.
    assert!(denoised.variance.value < 0.5 * raw.variance.value);
    assert!(raw.bias.holds(0.0) && denoised.bias.low > 0.0);
    assert_eq!(of(&report, Entrant::raw(Technique::PATH)).finding.kind, FindingKind::Noise);
    // So small an image is about one region, and few regions give an estimate within a factor of three.
    let ratio = denoised.estimate_ratio.unwrap().value;
    assert!((1.0 / 3.0..3.0).contains(&ratio), "{ratio}");
    // The estimate distinguishes the denoised image from the raw one.
    assert!(denoised.estimate.unwrap().value * 3.0 < raw.relmse.value);
}

/// A run shows the denoised image of its samples and keeps the raw image: both have the bits of a render with that many
/// samples.
#[test]
fn a_run_shows_the_denoised_image_and_keeps_the_raw_one() {
    let scene = Box::load();
    let settings = settings(16);
    let subject = scene.subject(&settings);
    let denoiser = || Denoiser::new(Denoise::Statistical, None).unwrap();
    let mut starter = Starter::new(Technique::PATH, denoiser());
    assert_eq!(starter.entrant(), DENOISED);
    starter.warm_up(&subject, &[60.0]).unwrap();
    // A busy machine may need longer.
    let run = |budget: f64| Run::new(&subject, &starter, 3, &[budget], &|| false).unwrap().unwrap();
    let run = [1.0, 4.0, 16.0].into_iter().map(run).find(|run| !run.snapshots.is_empty()).unwrap();
    assert_eq!((run.entrant(), run.denoisers.as_slice()), (DENOISED, &["statistical"][..]));
    let shown = &run.snapshots[0];
    assert!(shown.denoise > 0.0 && shown.time() <= 1.1 * shown.budget);

    let mut renderer = Renderer::new(subject.gpu, subject.scene.clone(), subject.camera, &run.settings).unwrap();
    while renderer.samples() < shown.samples {
        renderer.render_up_to(shown.samples - renderer.samples()).unwrap();
    }
    let image = renderer.denoised_image(&denoiser()).unwrap();
    assert_eq!(shown.estimate, estimate::denoised_relmse(&image));
    let kept = run.noisy.as_ref().unwrap();
    let channels = ["R", "G", "B", "error"];
    assert!(channels.iter().all(|name| kept.channel(name) == image.channel(name)), "{} samples", shown.samples);
    assert_eq!(kept.channels.len(), channels.len());
    let denoised = image.denoised().unwrap();
    assert!(["R", "G", "B"].iter().all(|name| shown.image.channel(name) == denoised.channel(name)));
    assert!(shown.image.channel("R") != kept.channel("R"));
}
