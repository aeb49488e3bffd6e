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

/// A half that is cut off, or none of ours, is refused by name, as it may be worth hours to its owner; visibility, which is made
/// in a moment, is made anew.
#[test]
fn a_damaged_cache_is_told_or_made_anew() {
    let scene = Scene::load(Path::new(BOX), &ImportOptions::default()).unwrap();
    let settings = Settings { width: 16, height: 16, photons: 4096, ..Settings::default() };
    let subject = Subject { gpu: gpu(), scene: &scene, camera: &scene.cameras[0], settings: &settings };
    let folder = folder();
    let folder = folder.path();
    let make = || Reference::make(&subject, folder, 0.2, &|| false, &mut |_| {}).map(drop);
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
