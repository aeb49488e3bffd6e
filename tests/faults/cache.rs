//! The cache of references: shared by processes, damaged, or of another form.

use std::fs;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::thread;

use penumbra::internal::gpu::Gpu;
use penumbra::internal::report::classes::Truth;
use penumbra::internal::report::reference::{Goal, Making, Reference};
use penumbra::internal::report::run::Subject;
use penumbra::internal::scene::ImportOptions;
use penumbra::{Image, Scene, Settings};

use crate::common::gpu;
use crate::program::{BOX, device, folder};

fn goal(standard_error: f64) -> Goal {
    Goal { standard_error, seconds: f64::INFINITY }
}

/// Two at once on one folder, each on a device and with files of its own, as two processes are: one makes the reference, the other
/// waits and has the same, and no file is damaged or left behind. One that is told to stop waits no more.
#[test]
fn one_makes_the_reference_that_two_ask_for() {
    let scene = Scene::load(Path::new(BOX), &ImportOptions::default()).unwrap();
    let settings = Settings::default().with(|s| {
        s.image.width = 24;
        s.image.height = 16;
    });
    let folder = folder();
    let choice = device().parse().unwrap();
    let make = |target: f64, stop: &dyn Fn() -> bool, tell: &mut dyn FnMut(Making)| {
        let gpu = Gpu::open(&choice).unwrap();
        let subject = Subject { gpu: &gpu, scene: &scene, camera: &scene.cameras[0], settings: &settings };
        Reference::make(&subject, folder.path(), goal(target), stop, tell).unwrap()
    };
    let ask = || {
        let mut saves = 0;
        let reference = make(0.05, &|| false, &mut |_| saves += 1);
        (reference.unwrap(), saves)
    };
    let [(a, saves_of_a), (b, saves_of_b)] = thread::scope(|scope| {
        let both = [scope.spawn(ask), scope.spawn(ask)];
        both.map(|one| one.join().unwrap())
    });
    assert_eq!(a.image.channels, b.image.channels, "each made a reference of its own");
    assert!((saves_of_a == 0) != (saves_of_b == 0), "{saves_of_a} and {saves_of_b} saves");
    let mut names: Vec<_> = fs::read_dir(folder.path()).unwrap().map(|entry| entry.unwrap().file_name()).collect();
    names.sort();
    assert_eq!(names, ["half-0.exr", "half-1.exr"]);

    // One goes on for better than it will ever have; the other is stopped while it waits, and tells the first.
    let (begun, stopped) = (AtomicBool::new(false), AtomicBool::new(false));
    thread::scope(|scope| {
        scope.spawn(|| {
            let first = make(1e-9, &|| stopped.load(Relaxed), &mut |_| begun.store(true, Relaxed));
            assert!(first.is_none());
        });
        while !begun.load(Relaxed) {
            thread::yield_now();
        }
        assert!(make(1e-9, &|| true, &mut |_| panic!("it did not wait")).is_none());
        stopped.store(true, Relaxed);
    });
}

/// A half that is cut off, or none of ours, is refused by name, as it may be worth hours to its owner; visibility, which is made
/// in a moment, is made anew.
#[test]
fn a_damaged_cache_is_told_or_made_anew() {
    let scene = Scene::load(Path::new(BOX), &ImportOptions::default()).unwrap();
    let settings = Settings::default().with(|s| {
        s.image.width = 16;
        s.image.height = 16;
        s.visibility_map.photons_per_light = 4096;
    });
    let subject = Subject { gpu: gpu(), scene: &scene, camera: &scene.cameras[0], settings: &settings };
    let folder = folder();
    let folder = folder.path();
    let make = || Reference::make(&subject, folder, goal(0.2), &|| false, &mut |_| {}).map(drop);
    make().unwrap();
    let half = folder.join("half-0.exr");
    let whole = fs::read(&half).unwrap();
    for bytes in [&b""[..], b"something else", &whole[..whole.len() / 2]] {
        fs::write(&half, bytes).unwrap();
        let error = make().unwrap_err();
        assert!(error.exit_code() == 3 && error.to_string().contains("half-0.exr"), "{error}");
    }
    fs::remove_file(&half).unwrap();
    make().unwrap();

    let visibility = folder.join("visibility.exr");
    Truth::make(&subject, folder).unwrap().unwrap();
    let first = Image::read(&visibility).unwrap();
    for bytes in [&b""[..], b"something else", &whole[..whole.len() / 2]] {
        fs::write(&visibility, bytes).unwrap();
        Truth::make(&subject, folder).unwrap().unwrap();
        assert_eq!(Image::read(&visibility).unwrap().channels, first.channels);
    }
}
