//! Budgets that are too short for an image: the error and the advice name the technique, its time and a sufficient
//! budget.

use penumbra::internal::report::document::{MIN_REPEATS, Report};
use penumbra::internal::report::reference::Reference;
use penumbra::internal::report::run::{Run, Snapshot, Starter, Subject};
use penumbra::internal::statistics::Rays;
use penumbra::settings::Denoise;
use penumbra::{Denoiser, Image, Result, Settings, Technique};

use crate::setup::Box;

/// A run without an image: its only budget is a nanosecond.
fn late(subject: &Subject<'_>, technique: Technique, seed: u32) -> Run {
    let starter = Starter::new(technique, Denoiser::default());
    Run::new(subject, &starter, seed, &[1e-9], &|| false).unwrap().unwrap()
}

fn grey(level: f32) -> Image {
    let mut image = Image::new(8, 8);
    for name in ["R", "G", "B"] {
        image.add_channel(name, vec![level; 64]);
    }
    image
}

fn report(subject: &Subject<'_>, runs: &[Run]) -> Result<Report> {
    let reference = Reference { image: grey(0.5), goal: None };
    Report::new("box.glb", &subject.gpu.info, &reference, runs, Vec::new())
}

/// A technique without an image in time is named, with the budget that would be enough.
#[test]
fn late_techniques_are_named_with_a_sufficient_budget() {
    let scene = Box::load();
    let settings = Settings::default().with(|s| {
        s.image.width = 8;
        s.image.height = 8;
        s.visibility_map.photons_per_light = Some(4096);
        s.indirect.photons = Some(4096);
    });
    let subject = scene.subject(&settings);
    let seeds = 0..MIN_REPEATS as u32;
    let techniques = [Technique::PATH, Technique::PHOTON_MAP];
    let mut runs: Vec<Run> =
        seeds.flat_map(|seed| techniques.map(|technique| late(&subject, technique, seed))).collect();
    assert!(runs.iter().all(|run| run.snapshots.is_empty() && run.first.is_none() && run.setup > 1e-9));
    let refused = |runs: &[Run], words: &[&str]| {
        let error = report(&subject, runs).err().unwrap();
        let (code, text) = (error.exit_code(), error.to_string());
        assert!(code == 2 && words.iter().all(|word| text.contains(word)), "{words:?} in {text}");
    };

    // No run has an image: the slowest set-up counts.
    for (index, run) in runs.iter_mut().enumerate() {
        run.setup = 1.0 + index as f64;
    }
    refused(&runs, &["`budgets`", "path", "set-up alone takes up to 5.00 s", "more than 5.00 s"]);

    // All runs of one technique have an image, but too late.
    for (index, run) in runs.iter_mut().enumerate().filter(|(index, _)| index % 2 == 1) {
        run.first = Some(7.0 + 0.1234 * index as f64);
    }
    refused(&runs, &["photon-map", "first image takes up to 7.62 s", "at least 7.62 s"]);

    // The other technique is in time: the late one is left out, and the advice gives the reason.
    for (index, run) in runs.iter_mut().enumerate().filter(|(index, _)| index % 2 == 0) {
        let (samples, rays, image) = (4, Rays::default(), grey(0.5 + 0.01 * (1 + index) as f32));
        run.first = Some(1.0);
        let [budget, sampled] = [2.0; 2];
        run.snapshots.push(Snapshot {
            budget,
            technique: Technique::PATH,
            sampled,
            denoise: 0.0,
            samples,
            rays,
            image,
            estimate: None,
        });
    }
    let advice = report(&subject, &runs).unwrap().advice;
    assert!(
        advice.contains(
            "Left out, because no budget has an image of every run: photon-map (its first image takes up to 7.62 s)."
        ),
        "{advice}"
    );
}

/// An entrant's denoiser takes a part of the budget, as its set-up does.
#[test]
fn a_late_entrant_is_named_with_its_denoiser() {
    let scene = Box::load();
    let settings = Settings::builder().size(8, 8).build().unwrap();
    let subject = scene.subject(&settings);
    let runs: Vec<Run> = (0..MIN_REPEATS as u32)
        .map(|seed| {
            let mut run = late(&subject, Technique::PATH, seed);
            run.settings.image.denoise = Denoise::Oidn;
            (run.setup, run.denoise) = (1.0, 0.5);
            run
        })
        .collect();
    let text = report(&subject, &runs).err().unwrap().to_string();
    for words in ["the soonest is path+oidn", "its set-up and denoiser take up to 1.50 s", "more than 1.50 s"] {
        assert!(text.contains(words), "{words:?} in {text}");
    }
}
