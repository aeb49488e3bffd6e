//! The cache of references: shared by processes, damaged, or of another form.

use std::fs;
use std::path::Path;
use std::process::Stdio;

use penumbra::report::classes::Truth;
use penumbra::report::reference::Reference;
use penumbra::report::run::Subject;
use penumbra::scene::ImportOptions;
use penumbra::{Image, Scene, Settings};

use crate::common::gpu;
use crate::program::{BOX, device, folder, penumbra};

/// Two reports at once on one folder: both are made, with one reference, of which no file is damaged.
#[test]
fn two_processes_share_a_reference() {
    let folder = folder();
    let folder = folder.path();
    let start = |name: &str| {
        let arguments = "--width 24 --height 16 --techniques path --budgets 1 --repeats 3 --reference-error 0.05";
        let files: [&dyn AsRef<std::ffi::OsStr>; 5] =
            [&BOX, &"--cache", &folder.join("cache"), &"-o", &folder.join(name)];
        let mut command = penumbra(&format!("report --quiet --device {} {arguments}", device()), &files);
        command.stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap()
    };
    for process in ["a", "b"].map(start) {
        let output = process.wait_with_output().unwrap();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    }
    let [a, b] = ["a", "b"].map(|name| Image::read(folder.join(name).join("reference.exr")).unwrap());
    assert_eq!(a.channels, b.channels, "each made a reference of its own");
    let kept = fs::read_dir(folder.join("cache")).unwrap().next().unwrap().unwrap().path();
    let mut names: Vec<_> = fs::read_dir(kept).unwrap().map(|entry| entry.unwrap().file_name()).collect();
    names.sort();
    assert_eq!(names, ["half-0.exr", "half-1.exr"]);
}

/// Files of the cache that are cut off, of another size, without their counts, or none of ours are made anew.
#[test]
fn a_damaged_cache_is_made_anew() {
    let scene = Scene::load(Path::new(BOX), &ImportOptions::default()).unwrap();
    let settings = Settings { width: 16, height: 16, photons: 4096, ..Settings::default() };
    let subject = Subject { gpu: gpu(), scene: &scene, camera: &scene.cameras[0], settings: &settings };
    let folder = folder();
    let folder = folder.path();
    let make = || Reference::make(&subject, folder, 0.2, &|| false, &mut |_| {}).unwrap().unwrap();
    make();
    let [half, other] = ["half-0.exr", "half-1.exr"].map(|name| folder.join(name));
    let whole = fs::read(&half).unwrap();
    let mut small = Image::new(8, 8);
    let mut unsigned = Image::read(&half).unwrap();
    unsigned.metadata.clear();
    for name in ["R", "G", "B"] {
        small.add_channel(name, vec![1.0; 64]);
    }
    let spoils: [&dyn Fn(); 5] = [
        &|| fs::write(&half, &whole[..whole.len() / 2]).unwrap(),
        &|| fs::write(&half, "").unwrap(),
        &|| fs::write(&half, "something else").unwrap(),
        &|| small.write_exr(&half).unwrap(),
        &|| unsigned.write_exr(&half).unwrap(),
    ];
    for spoil in spoils {
        spoil();
        let before = fs::read(&other).unwrap();
        let made = make();
        assert!(made.standard_error().unwrap() <= 0.2);
        assert!(fs::read(&other).unwrap() != before, "the half that was whole stood still");
        assert_eq!(Image::read(&half).unwrap().pixels(), 256);
    }

    let visibility = folder.join("visibility.exr");
    Truth::make(&subject, folder).unwrap().unwrap();
    let first = Image::read(&visibility).unwrap();
    for bytes in [&b""[..], b"something else", &whole[..whole.len() / 2]] {
        fs::write(&visibility, bytes).unwrap();
        Truth::make(&subject, folder).unwrap().unwrap();
        assert_eq!(Image::read(&visibility).unwrap().channels, first.channels);
    }
}
