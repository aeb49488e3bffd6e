//! The cache of references: shared by processes, or damaged.

use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::{fs, thread};

use kernel_kit::Gpu;
use penumbra::internal::report::classes::Truth;
use penumbra::internal::report::reference::{Goal, Reference, ReferenceProgress};
use penumbra::internal::report::run::Subject;
use penumbra::internal::scene::ImportOptions;
use penumbra::{Image, Scene, Settings};

use crate::common::gpu;
use crate::program::{BOX, device, folder};

fn goal(standard_error: f64) -> Goal {
    Goal { standard_error, seconds: f64::INFINITY }
}

/// If two processes need the same reference, one renders it and the other waits for it. No file is damaged or left
/// behind. A waiting process that is told to stop does so. Two threads with a device and files of their own stand for
/// the processes.
#[test]
fn one_of_two_processes_makes_the_reference() {
    let scene = Scene::load(Path::new(BOX), &ImportOptions::default()).unwrap();
    let settings = Settings::default().with(|s| {
        s.image.width = 24;
        s.image.height = 16;
    });
    let folder = folder();
    let choice = device().parse().unwrap();
    let make = |target: f64, stop: &dyn Fn() -> bool, on_save: &mut dyn FnMut(ReferenceProgress)| {
        let gpu = Gpu::open(&choice).unwrap();
        let subject =
            Subject { gpu: &gpu, scene: &scene, camera: &scene.cameras[0], settings: &settings, slowness: 1.0 };
        Reference::make(&subject, folder.path(), goal(target), stop, on_save).unwrap()
    };
    let make_counted = || {
        let mut saves = 0;
        let reference = make(0.05, &|| false, &mut |_| saves += 1);
        (reference.unwrap(), saves)
    };
    let [(a, saves_of_a), (b, saves_of_b)] = thread::scope(|scope| {
        let both = [scope.spawn(make_counted), scope.spawn(make_counted)];
        both.map(|one| one.join().unwrap())
    });
    assert_eq!(a.image.channels, b.image.channels, "each made a reference of its own");
    assert!((saves_of_a == 0) != (saves_of_b == 0), "{saves_of_a} and {saves_of_b} saves");
    let mut names: Vec<_> = fs::read_dir(folder.path()).unwrap().map(|entry| entry.unwrap().file_name()).collect();
    names.sort();
    assert_eq!(names, ["half-0.exr", "half-1.exr"]);

    // The first one renders towards an error that it cannot reach. The second one is stopped while it waits, and then
    // stops the first.
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

/// A truncated or foreign half is refused by name, because it may be worth hours of rendering. Damaged visibility is
/// quick to make and is replaced.
#[test]
fn a_damaged_cache_is_refused_or_replaced() {
    let scene = Scene::load(Path::new(BOX), &ImportOptions::default()).unwrap();
    let settings = Settings::default().with(|s| {
        s.image.width = 16;
        s.image.height = 16;
        s.visibility_map.photons_per_light = Some(4096);
    });
    let subject = Subject { gpu: gpu(), scene: &scene, camera: &scene.cameras[0], settings: &settings, slowness: 1.0 };
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
