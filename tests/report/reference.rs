//! The reference that a report makes, caches and continues.

use std::fs;
use std::sync::Arc;

use penumbra::internal::render::film::Metadata;
use penumbra::internal::report::classes::{Classes, Truth};
use penumbra::internal::report::metrics;
use penumbra::internal::report::reference::{Goal, Reference, cache_folder};
use penumbra::settings::LightSampling;
use penumbra::{Image, Settings, Technique};

use crate::setup::{Box, folder, goal};

/// A cached reference is reused or continued, and its stated error is correct.
#[test]
fn a_reference_is_continued_and_states_its_error() {
    let scene = Box::load();
    let settings = Settings::default().with(|s| {
        s.image.width = 24;
        s.image.height = 24;
    });
    let subject = scene.subject(&settings);
    let folder = folder();
    let make = |target: f64| {
        let mut saves = 0;
        let made = Reference::make(&subject, folder.path(), goal(target), &|| false, &mut |_| saves += 1);
        (made.unwrap().unwrap(), saves)
    };
    let (early, saves) = make(0.2);
    assert!(saves > 0 && early.standard_error().unwrap() <= 0.2);
    let (again, saves) = make(0.2);
    assert!(saves == 0 && again.image.channels == early.image.channels, "a sufficient reference was rendered again");
    // The error of the early reference depends on the machine's speed, because the goal is checked at intervals.
    let target = 0.3 * early.standard_error().unwrap();
    let (late, _) = make(target);
    assert!(late.samples() > early.samples() && late.standard_error().unwrap() <= target);

    // The distance of the early reference from a three times better one, which contains it, matches its stated error. A
    // mistake in the halves would make it half or twice as large. A few dozen fireflies among the 1728 values dominate
    // the estimate, so its standard error is a fifth.
    let distance = metrics::relmse(&early.image, &late.image).unwrap();
    let stated = early.floor().unwrap() - late.floor().unwrap();
    assert!((0.6..1.6).contains(&(distance / stated)), "{distance} for {stated}");
}

/// A reference that runs out of time is used as it is and reports that it is short of its goal. The time limit covers
/// all sessions.
#[test]
fn a_reference_that_runs_out_of_time_is_short() {
    let scene = Box::load();
    let settings = Settings::default().with(|s| {
        s.image.width = 8;
        s.image.height = 8;
    });
    let subject = scene.subject(&settings);
    let folder = folder();
    let make = |standard_error: f64, seconds: f64| {
        let goal = Goal { standard_error, seconds };
        Reference::make(&subject, folder.path(), goal, &|| false, &mut |_| {}).unwrap().unwrap()
    };
    // One sample is taken, however short the time.
    let first = make(1e-9, 1e-9);
    assert!(first.is_short() && first.samples() >= Some(2) && first.standard_error() > Some(1e-9));
    let kept = make(1e-9, 1e-9);
    assert!(kept.is_short() && kept.image == first.image, "its time had run out before");
    let longer = make(1e-9, 0.5);
    assert!(longer.is_short() && longer.samples() > first.samples());
    let found = longer.standard_error().unwrap();
    let enough = make(1.1 * found, 1e-9);
    assert!(!enough.is_short() && enough.image == longer.image);
}

/// Any strategy for many lights can be measured: paths refuse some, and class channels those that sample lights, so
/// the reference has none, and true visibility and classes have all lights.
#[test]
fn every_light_sampling_can_be_measured() {
    let scene = Box::load();
    let folder = folder();
    let measured = |strategy: Option<LightSampling>| {
        let settings = Settings::default().with(|s| {
            (s.image.width, s.image.height) = (8, 8);
            (s.light_sampling.strategy, s.light_sampling.sampled_lights) = (strategy, 1);
        });
        let subject = scene.subject(&settings);
        let name = strategy.map_or("none", LightSampling::name);
        let (references, truths) = (folder.path().join(name), folder.path().join(name.to_owned() + " truth"));
        let goal = Goal { standard_error: 1e-9, seconds: 1e-9 };
        let made = Reference::make(&subject, &references, goal, &|| false, &mut |_| {}).unwrap().unwrap();
        let truth = Truth::make(&subject, &truths).unwrap().unwrap();
        let classes = Classes::new(&subject, Technique::SHADOW_PHOTONS, &truth).unwrap().unwrap();
        (made.image.channels, classes.map)
    };
    let usual = measured(None);
    for strategy in LightSampling::ALL {
        assert_eq!(measured(Some(strategy)), usual, "{strategy}");
    }
}

/// A clamp is no part of the reference: it is biased, and reports without it find the same folder.
#[test]
fn a_reference_has_no_clamp() {
    let scene = Box::load();
    let settings = Settings::default().with(|s| (s.image.width, s.image.height) = (8, 8));
    let clamped = settings.clone().with(|s| s.indirect.clamp = Some(1e-4));
    let make = |settings: &Settings| {
        let folder = folder();
        let goal = Goal { standard_error: 1e-9, seconds: 1e-9 };
        let made = Reference::make(&scene.subject(settings), folder.path(), goal, &|| false, &mut |_| {});
        made.unwrap().unwrap().image.channels
    };
    assert_eq!(make(&settings), make(&clamped));
}

/// A stopped session returns nothing and keeps the halves on disk.
#[test]
fn a_stopped_session_keeps_the_saved_halves() {
    let scene = Box::load();
    let settings = Settings::default().with(|s| {
        s.image.width = 8;
        s.image.height = 8;
    });
    let folder = folder();
    let make = |stop: bool| {
        Reference::make(&scene.subject(&settings), folder.path(), goal(1e-9), &|| stop, &mut |_| {}).unwrap().is_some()
    };
    assert!(!make(true));
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0);
    // The halves have independent samples, as their difference is the error estimate.
    Reference::make(&scene.subject(&settings), folder.path(), goal(0.5), &|| false, &mut |_| {}).unwrap();
    let [a, b] = ["half-0.exr", "half-1.exr"].map(|name| Image::read(folder.path().join(name)).unwrap());
    assert_ne!(a.channels, b.channels);
    assert!(!make(true));
    assert_eq!(Image::read(folder.path().join("half-0.exr")).unwrap(), a);
}

/// A file in the cache that is not a half of this reference is refused with an error, never merged.
#[test]
fn foreign_or_damaged_halves_are_refused() {
    let scene = Box::load();
    let settings = Settings::default().with(|s| {
        s.image.width = 8;
        s.image.height = 8;
    });
    let folder = folder();
    let path = folder.path().join("half-1.exr");
    let make =
        || Reference::make(&scene.subject(&settings), folder.path(), goal(0.5), &|| false, &mut |_| {}).map(|_| ());
    make().unwrap();
    let good = Image::read(&path).unwrap();
    let set = |name: &str, value: i32| {
        let mut image = good.clone();
        image.metadata.insert(name.into(), Metadata::Int(value));
        image
    };
    let mut wide = Image::new(9, 8);
    let mut grey = Image::new(8, 8);
    for channel in &good.channels {
        wide.add_channel(&channel.name, vec![0.5; 72]);
    }
    wide.metadata = good.metadata.clone();
    grey.metadata = good.metadata.clone();
    grey.add_channel("R", vec![0.5; 64]);
    let mut not_finite = good.clone();
    not_finite.channels[1].samples[5] = f32::NAN;
    let counts = [("samplesPerPixel", 0), ("samplesPerPixel", i32::MAX), ("penumbra:sessions", -1)];
    for bad in counts.map(|(name, value)| set(name, value)).into_iter().chain([wide.clone(), grey, not_finite]) {
        bad.write_exr(&path).unwrap();
        let error = make().unwrap_err().to_string();
        assert!(error.contains("half-1.exr") && error.contains("delete"), "{error}");
    }
    // Halves of different sizes are refused, too.
    assert!(Reference::of_halves(&good, &wide).is_err());
    // Negative halves still have a positive error.
    let mut negative = good.clone();
    negative.channels.iter_mut().flat_map(|channel| &mut channel.samples).for_each(|x| *x = -1.0 - x.abs());
    let mut other = negative.clone();
    other.channels[0].samples[5] -= 1.0;
    assert!(Reference::of_halves(&negative, &other).unwrap().standard_error() > Some(0.0));
    good.write_exr(&path).unwrap();
    make().unwrap();
}

/// The cache folder depends on everything that changes the reference, and on nothing else.
#[test]
fn another_scene_or_view_has_its_own_folder() {
    let scene = Box::load();
    let mut other = Box::load();
    Arc::make_mut(&mut other.scene.vertices)[0].position.x += 1e-6;
    let mut turned = Box::load();
    turned.camera.position.y += 1e-6;
    let settings = Settings::default();
    let folders = [
        cache_folder("".as_ref(), &scene.subject(&settings)),
        cache_folder("".as_ref(), &other.subject(&settings)),
        cache_folder("".as_ref(), &turned.subject(&settings)),
        cache_folder("".as_ref(), &scene.subject(&settings.clone().with(|s| s.image.width = 511))),
        cache_folder("".as_ref(), &scene.subject(&settings.clone().with(|s| s.indirect.max_bounces = 1))),
        cache_folder("".as_ref(), &scene.subject(&settings.clone().with(|s| s.light_scale = 2.0))),
    ];
    let different: std::collections::BTreeSet<_> = folders.iter().collect();
    assert_eq!(different.len(), folders.len());
    // Settings that `path` does not use.
    let same = settings.clone().with(|s| {
        s.visibility_map.photons_per_light = Some(7);
        s.visibility_map.nearest = 8;
        s.visibility_map.audit = 0.0;
        s.image.seed = 9;
    });
    assert_eq!(cache_folder("".as_ref(), &scene.subject(&same)), folders[0]);
}
