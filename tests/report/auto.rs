//! `auto` as an entrant: a choice and a render for each budget, and its error against the best of the others.

use penumbra::internal::report::document::Report;
use penumbra::internal::report::entrant::Entrant;
use penumbra::internal::report::interval::Interval;
use penumbra::internal::report::reference::Reference;
use penumbra::internal::report::run::{Run, Snapshot, Starter, Subject};
use penumbra::internal::statistics::Rays;
use penumbra::settings::Denoise;
use penumbra::{Denoiser, Image, Settings, Technique};

use crate::setup::Box;

const AUTO: Entrant = Entrant { technique: None, denoise: Denoise::None };

const SIDE: u32 = 8;
const GREY: f32 = 0.5;

fn grey(level: f32) -> Image {
    let mut image = Image::new(SIDE, SIDE);
    for name in ["R", "G", "B"] {
        image.add_channel(name, vec![level; (SIDE * SIDE) as usize]);
    }
    image
}

fn settings() -> Settings {
    Settings::default().with(|s| {
        s.image.width = SIDE;
        s.image.height = SIDE;
        s.indirect.max_bounces = 0;
    })
}

/// A technique or `auto`, and its images: budgets and errors.
type Planted<'a> = (Option<Technique>, &'a [(f64, f32)]);

/// A report of three runs of each entrant that end with their set-up, with these images.
fn planted(subject: &Subject<'_>, entrants: &[Planted<'_>]) -> Report {
    let mut runs = Vec::new();
    for seed in 0..3 {
        for (technique, errors) in entrants {
            let starter = Starter::new(*technique, Denoiser::default());
            let mut run = Run::new(subject, &starter, seed, &[], &|| false).unwrap().unwrap();
            let technique = run.settings.technique;
            for &(budget, error) in *errors {
                let (image, rays) = (grey(GREY + error), Rays::default());
                run.snapshots.push(Snapshot {
                    budget,
                    technique,
                    sampled: budget,
                    denoise: 0.0,
                    samples: 4,
                    rays,
                    image,
                    estimate: None,
                });
            }
            runs.push(run);
        }
    }
    let reference = Reference { image: grey(GREY), goal: None };
    Report::new("box.glb", &subject.gpu.info, &reference, &runs, Vec::new()).unwrap()
}

/// Each budget has a render of its own, by the technique for that budget.
#[test]
fn each_budget_has_its_own_choice_and_render() {
    let scene = Box::load();
    let settings = settings();
    let subject = scene.subject(&settings);
    let starter = Starter::new(None, Denoiser::default());
    assert_eq!(starter.entrant(), AUTO);
    let run = |budgets: &[f64]| Run::new(&subject, &starter, 0, budgets, &|| false).unwrap().unwrap();

    let long = run(&[3.0, 4.0]);
    assert_eq!(long.entrant(), AUTO);
    assert!(long.snapshots.iter().all(|snapshot| snapshot.technique == Technique::default()));
    // One render for both would take no longer than its last image.
    let rendered: f64 = long.snapshots.iter().map(|snapshot| snapshot.time()).sum();
    assert!(long.time >= rendered, "{} s for {rendered} s", long.time);

    // Nothing but paths can be there as soon, on a device for which this is known.
    let short = run(&[1e-3]);
    let taken = if subject.gpu.is_software() { Technique::PATH } else { Technique::default() };
    assert_eq!(short.settings.technique, taken);
    assert_eq!(short.entrant(), AUTO);
}

/// Images without an error, as of a black scene, have a ratio of 1, and no entrant is better than another.
#[test]
fn images_without_an_error_have_a_ratio() {
    let scene = Box::load();
    let settings = settings();
    let subject = scene.subject(&settings);
    let report = planted(&subject, &[(None, &[(1.0, 0.0), (2.0, 0.0)]), (Some(Technique::PATH), &[(1.0, 0.0)])]);
    assert!(report.auto.iter().all(|row| row.ratio == Interval { value: 1.0, low: 1.0, high: 1.0 }));
    assert!(!report.csv().contains("NaN"), "{}", report.csv());
    assert!(report.advice.starts_with("No image has an error"), "{}", report.advice);
}

/// The report compares `auto` with the smallest error of the others within the budget, also by an earlier image.
#[test]
fn auto_is_compared_with_the_best_of_the_others() {
    let scene = Box::load();
    let settings = settings();
    let subject = scene.subject(&settings);
    let report = planted(
        &subject,
        &[
            (None, &[(1.0, 0.2), (2.0, 0.2)]),
            (Some(Technique::PATH), &[(1.0, 0.1)]),
            (Some(Technique::TWO_PASS), &[(1.0, 0.3), (2.0, 0.25)]),
        ],
    );
    assert_eq!(report.auto.len(), 2);
    for (row, budget) in report.auto.iter().zip([1.0, 2.0]) {
        assert_eq!((row.entrant, row.budget, row.best), (AUTO, budget, Entrant::raw(Technique::PATH)));
        // Twice the difference is four times the relMSE, up to the rounding of f32 pixels.
        assert!((row.ratio.value - 4.0).abs() < 1e-5, "{:?}", row.ratio);
    }
    let csv = report.csv();
    let best = csv.lines().filter(|line| line.starts_with("auto,")).all(|line| line.rsplit(',').nth(1) == Some("path"));
    assert!(best, "{csv}");
}
