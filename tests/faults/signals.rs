//! Signals at any time.

use std::io::{BufRead, BufReader, Read};
use std::path::{Path, PathBuf};
use std::process::Stdio;
use std::time::Duration;
use std::{fs, thread};

use penumbra::Image;

use crate::disk::{SMALL, begin, names};
use crate::program::{BOX, device, folder, penumbra, signal};

/// Asserts that every file in the folder is complete and one of the requested outputs.
fn assert_whole(folder: &Path, requested: &[String]) {
    for name in names(folder) {
        assert!(requested.contains(&name), "{name} is left");
        let path = folder.join(&name);
        match path.extension().unwrap().to_str().unwrap() {
            "exr" | "png" => drop(Image::read(&path).unwrap_or_else(|error| panic!("a partial file is left: {error}"))),
            _ => drop(serde_json::from_slice::<serde_json::Value>(&fs::read(&path).unwrap()).unwrap()),
        }
    }
}

/// A signal ends the process at any time and never leaves a partial file: while the scene is read, kernels compile,
/// photons are traced, samples are taken, or files are written. The exit code is that of the signal, or of a complete
/// render.
#[test]
fn a_signal_may_come_at_any_time() {
    let requested = ["a.exr", "a.png", "a.json"].map(str::to_owned);
    let mut written = [false; 2];
    for (moment, name) in
        [0u64, 10, 30, 80, 150, 300, 500, 800, 1200, 2000].into_iter().zip(["-INT", "-TERM"].into_iter().cycle())
    {
        let folder = folder();
        let [exr, png, json] = ["a.exr", "a.png", "a.json"].map(|name| folder.path().join(name));
        let arguments = format!("render --quiet --spp 64 --aov all --device {} {SMALL}", device());
        let files: [&dyn AsRef<std::ffi::OsStr>; 7] = [&BOX, &"-o", &exr, &"-o", &png, &"--stats", &json];
        let mut child = penumbra(&arguments, &files).stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
        thread::sleep(Duration::from_millis(moment));
        signal(&child, name);
        // There is no exit code if the signal came before the program handled it.
        let code = child.wait().unwrap().code();
        let expected = [None, Some(0), Some(130), Some(if name == "-INT" { 130 } else { 143 })];
        assert!(expected.contains(&code), "{moment} ms, {name}: {code:?}");
        assert_whole(folder.path(), &requested);
        written[usize::from(names(folder.path()).is_empty())] = true;
    }
    assert!(written[1], "no signal came before there was something to write");
}

/// That many images in a folder: their names and their paths.
fn outputs(folder: &Path, count: usize) -> (Vec<String>, Vec<PathBuf>) {
    let names: Vec<String> = (0..count).map(|i| format!("{i}.exr")).collect();
    let paths = names.iter().map(|name| folder.join(name)).collect();
    (names, paths)
}

fn paths(outputs: &[PathBuf]) -> Vec<&Path> {
    outputs.iter().map(PathBuf::as_path).collect()
}

/// A SIGTERM that is sent to all processes and passed on by a script counts once: the image is written.
#[test]
fn a_signal_that_is_passed_on_counts_once() {
    let folder = folder();
    let (requested, outputs) = outputs(folder.path(), 20);
    let (mut child, mut said, mut stderr) = begin(SMALL, &paths(&outputs));
    signal(&child, "-TERM");
    signal(&child, "-TERM");
    stderr.read_to_string(&mut said).unwrap();
    assert_eq!(child.wait().unwrap().code(), Some(130), "{said}");
    assert_eq!(names(folder.path()).len(), requested.len(), "{said}");
    assert_whole(folder.path(), &requested);
}

/// Commands that have no image to save end at once, too, after their temporary files are removed: so a signal is no
/// default action, but has an exit code.
#[test]
fn a_signal_ends_every_command_with_its_code() {
    for (name, code) in [("-INT", 130), ("-TERM", 143)] {
        let mut command = penumbra(&format!("stress scale --device {}", device()), &[]);
        let mut child = command.stdout(Stdio::piped()).stderr(Stdio::null()).spawn().unwrap();
        let mut first = String::new();
        BufReader::new(child.stdout.as_mut().unwrap()).read_line(&mut first).unwrap();
        signal(&child, name);
        assert_eq!(child.wait().unwrap().code(), Some(code), "{first}");
    }
}

/// The first Ctrl-C ends sampling, and a second one ends writing at once, without leaving a partial file.
#[test]
fn a_second_signal_ends_the_process_at_once() {
    let folder = folder();
    let (requested, outputs) = outputs(folder.path(), 40);
    let large = "--width 256 --height 256 --photons 4096 --max-bounces 0 --aov all";
    let (mut child, mut said, mut stderr) = begin(large, &paths(&outputs));
    signal(&child, "-INT");
    while !said.contains("wrote") {
        assert!(stderr.read_line(&mut said).unwrap() > 0, "it ended before it wrote: {said}");
    }
    signal(&child, "-INT");
    stderr.read_to_string(&mut said).unwrap();
    assert_eq!(child.wait().unwrap().code(), Some(130), "{said}");
    let files = names(folder.path()).len();
    assert!((1..40).contains(&files), "{files} of 40 files are there: {said}");
    assert_whole(folder.path(), &requested);
}
