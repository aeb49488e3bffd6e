//! `penumbra render --denoise`: with Open Image Denoise, without it, and with libraries that are something else.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use penumbra::Image;
use penumbra::internal::render::film::View;
use penumbra::internal::report::estimate::denoised_relmse;
use penumbra::internal::report::metrics::relmse;
use serde_json::Value;

use crate::program::{Answer, BOX, device, folder, oidn_library as library, penumbra};
use crate::schema;

/// Quick settings: few photons, a small image.
const SMALL: &str = "--width 48 --height 32 --photons 4096 --max-bounces 1";

/// Renders the box to `outputs` with `arguments`, and with `library` in the environment.
fn render(arguments: &str, library: Option<&Path>, outputs: &[&Path]) -> Answer {
    let mut command = penumbra(&format!("render --device {} {SMALL} {arguments}", device()), &[&BOX]);
    for output in outputs {
        command.arg("-o").arg(output);
    }
    if let Some(library) = library {
        command.env("OIDN_LIBRARY", library);
    }
    Answer::of(&mut command)
}

fn bits(image: &Image, channel: &str) -> Vec<u32> {
    image.channel(channel).unwrap_or_else(|| panic!("no channel {channel}")).iter().map(|x| x.to_bits()).collect()
}

#[test]
fn a_png_shows_the_denoised_image_and_an_exr_has_both() {
    let folder = folder();
    let [exr, png, json, shown] = ["a.exr", "a.png", "a.json", "b.png"].map(|name| folder.path().join(name));
    let reference = folder.path().join("reference.exr");
    render("--technique path --spp 2048 --seed 9", None, &[&reference]).assert_done();
    let reference = Image::read(&reference).unwrap();
    let arguments = format!("--technique path --spp 8 --stats {}", json.display());
    let answer = render(&arguments, Some(&library()), &[&exr, &png]);
    answer.assert_done();
    assert!(answer.stderr.contains("denoised by auto (oidn, statistical)"), "{answer:?}");
    let image = Image::read(&exr).unwrap();
    assert!(image.channels.iter().all(|channel| channel.samples.iter().all(|x| x.is_finite())));
    image.denoised().unwrap().write_png(&shown, View::Neutral, 0.0).unwrap();
    assert!(fs::read(&shown).unwrap() == fs::read(&png).unwrap(), "the PNG is not the denoised image");

    let [raw, denoised] = [&image, &image.denoised().unwrap()].map(|image| relmse(image, &reference).unwrap());
    assert!(denoised < 0.6 * raw, "{denoised} of {raw}");
    // So small an image is about one region, and the reference adds its own error, a two-hundredth of the raw image's.
    let estimate = denoised_relmse(&image).unwrap();
    assert!(estimate < 3.0 * denoised && estimate > denoised / 3.0, "{estimate} for {denoised}");

    let statistics: Value = serde_json::from_slice(&fs::read(&json).unwrap()).unwrap();
    schema::assert_documented("Statistics", &statistics);
    assert!(statistics["time"]["denoise"].as_f64().unwrap() > 0.0);
    assert_eq!(statistics["settings"]["denoise"], "auto");
}

#[test]
fn an_exr_alone_is_raw_unless_a_denoiser_is_named() {
    let folder = folder();
    let [raw, denoised] = ["a.exr", "b.exr"].map(|name| folder.path().join(name));
    render("--spp 4", Some(&library()), &[&raw]).assert_done();
    let image = Image::read(&raw).unwrap();
    assert!(image.channel("denoised.R").is_none() && image.channel("error").is_none());
    for spp in [1, 2, 3] {
        let arguments = format!("--spp {spp} --denoise oidn --oidn {}", library().display());
        render(&arguments, None, &[&denoised]).assert_done();
        let image = Image::read(&denoised).unwrap();
        assert_eq!(image.channel("error").is_some(), spp > 1, "{spp} samples");
        assert!(bits(&image, "denoised.R") != bits(&image, "R"));
        // The raw image has the bits of a render without a denoiser.
        render(&format!("--spp {spp}"), None, &[&raw]).assert_done();
        assert_eq!(bits(&image, "R"), bits(&Image::read(&raw).unwrap(), "R"), "{spp} samples");
    }
}

/// The raw image is written, and the error names the library and says what to do.
#[test]
fn a_library_that_cannot_be_used_is_an_error_and_the_raw_image_is_safe() {
    let folder = folder();
    let [raw, exr, broken, missing] =
        ["raw.exr", "a.exr", "broken.so", "missing.so"].map(|name| folder.path().join(name));
    fs::write(&broken, "no library").unwrap();
    render("--spp 2", None, &[&raw]).assert_done();
    let raw = Image::read(&raw).unwrap();
    let mut cases = vec![(&broken, "broken.so"), (&missing, "there is no such file")];
    // A library of other functions.
    let other = PathBuf::from("libc.so.6");
    if cfg!(target_os = "linux") {
        cases.push((&other, "no function oidnNewDevice"));
    }
    for (library, words) in cases {
        for denoise in ["auto", "oidn"] {
            for by_flag in [true, false] {
                let flag = if by_flag { format!("--oidn {}", library.display()) } else { String::new() };
                let variable = Some(library.as_path()).filter(|_| !by_flag);
                let answer = render(&format!("--spp 2 --denoise {denoise} {flag}"), variable, &[&exr]);
                assert_eq!(answer.code, Some(3), "{answer:?}");
                let last = answer.stderr.lines().last().unwrap();
                let name = library.file_name().unwrap().to_str().unwrap();
                let all = ["penumbra: error: ", name, words, "install version 2", "--oidn or OIDN_LIBRARY"];
                assert!(all.iter().all(|word| last.contains(word)), "{answer:?}");
                let image = Image::read(&exr).unwrap();
                assert_eq!(bits(&image, "G"), bits(&raw, "G"));
                assert!(image.channel("denoised.G").is_none());
                fs::remove_file(&exr).unwrap();
            }
        }
    }
}

/// A library of Open Image Denoise whose filter fails or, with `no_filter`, one that returns no filter and no reason.
const FAILING_LIBRARY: &str = r#"
#![allow(non_snake_case)]
use std::os::raw::{c_char, c_int};
use std::sync::atomic::{AtomicBool, Ordering};
static FAILED: AtomicBool = AtomicBool::new(false);
#[no_mangle] pub extern "C" fn oidnNewDevice(_: c_int) -> usize { 1 }
#[no_mangle] pub extern "C" fn oidnSetDeviceBool(_: usize, _: *const c_char, _: bool) {}
#[no_mangle] pub extern "C" fn oidnCommitDevice(_: usize) {}
#[no_mangle] pub extern "C" fn oidnReleaseDevice(_: usize) {}
#[no_mangle] pub extern "C" fn oidnGetDeviceInt(_: usize, _: *const c_char) -> c_int { 20501 }
#[no_mangle] pub unsafe extern "C" fn oidnGetDeviceError(_: usize, message: *mut *const c_char) -> c_int {
    *message = b"out of patience\0".as_ptr() as *const c_char;
    if FAILED.swap(false, Ordering::SeqCst) { 1 } else { 0 }
}
#[no_mangle] pub extern "C" fn oidnNewFilter(_: usize, _: *const c_char) -> usize { !cfg!(no_filter) as usize }
#[no_mangle] pub extern "C" fn oidnSetSharedFilterImage(
    _: usize, _: *const c_char, _: usize, _: c_int, _: usize, _: usize, _: usize, _: usize, _: usize) {}
#[no_mangle] pub extern "C" fn oidnSetFilterBool(_: usize, _: *const c_char, _: bool) {}
#[no_mangle] pub extern "C" fn oidnSetFilterInt(_: usize, _: *const c_char, _: c_int) {}
#[no_mangle] pub extern "C" fn oidnCommitFilter(_: usize) {}
#[no_mangle] pub extern "C" fn oidnExecuteFilter(_: usize) { FAILED.store(true, Ordering::SeqCst) }
#[no_mangle] pub extern "C" fn oidnReleaseFilter(_: usize) {}
"#;

/// [`FAILING_LIBRARY`], compiled with this `cfg`.
fn failing_library(folder: &Path, cfg: &str) -> PathBuf {
    let [source, library] = [format!("{cfg}.rs"), format!("{cfg}.so")].map(|name| folder.join(name));
    fs::write(&source, FAILING_LIBRARY).unwrap();
    let mut compiler = Command::new("rustc");
    compiler.args(["--crate-type", "cdylib", "--cfg", cfg, "-o"]).arg(&library).arg(&source);
    assert!(compiler.status().unwrap().success());
    library
}

/// Where the denoised image's error decides on samples, a library that fails ends the render. The samples so far are
/// written, and a checkpoint of them.
#[test]
fn a_library_that_fails_between_samples_loses_none() {
    let folder = folder();
    let [raw, exr, state] = ["raw.exr", "a.exr", "state"].map(|name| folder.path().join(name));
    // Without an estimate all pixels get 8 samples.
    render("--spp 8 --technique path", None, &[&raw]).assert_done();
    let raw = Image::read(&raw).unwrap();
    for (cfg, words) in [("filter", "out of patience"), ("no_filter", "it made no filter, and gave no reason")] {
        let library = failing_library(folder.path(), cfg);
        let arguments = format!(
            "--spp 999 --technique path --noise 1e-9 --denoise oidn --oidn {} --checkpoint {}",
            library.display(),
            state.display()
        );
        let answer = render(&arguments, None, &[&exr]);
        let last = answer.stderr.lines().last().unwrap();
        let all = ["penumbra: error: ", &format!("{cfg}.so"), "Open Image Denoise failed", words];
        assert!(answer.code == Some(3) && all.iter().all(|words| last.contains(words)), "{answer:?}");
        assert!(answer.stderr.contains("stopped after 8.0"), "{answer:?}");
        assert_eq!(bits(&Image::read(&exr).unwrap(), "G"), bits(&raw, "G"));
        for file in [&exr, &state] {
            fs::remove_file(file).unwrap();
        }
    }
}

/// A frame that could not be denoised is not complete: the same command renders it again.
#[test]
fn a_frame_that_is_not_denoised_is_rendered_again() {
    let folder = folder();
    let [name, frame] = ["{frame}.exr", "0000.exr"].map(|name| folder.path().join(name));
    let sequence = |library: &Path| {
        let arguments = format!("--spp 2 --turntable 1 --denoise oidn --oidn {}", library.display());
        render(&arguments, None, &[&name])
    };
    let answer = sequence(&failing_library(folder.path(), "filter"));
    assert!(answer.code == Some(3) && answer.stderr.contains("an incomplete frame is not written"), "{answer:?}");
    assert!(!frame.exists());
    sequence(&library()).assert_done();
    assert!(Image::read(&frame).unwrap().channel("denoised.R").is_some());
}

/// Where the loader finds no library, a PNG shows what the statistical denoiser gives.
#[test]
fn without_a_library_a_png_is_denoised_all_the_same() {
    let folder = folder();
    let [exr, png, shown] = ["a.exr", "a.png", "b.png"].map(|name| folder.path().join(name));
    let answer = render("--spp 2", None, &[&png, &exr]);
    assert!(answer.assert_done().stderr.contains("denoised by auto ("), "{answer:?}");
    let image = Image::read(&exr).unwrap();
    image.denoised().unwrap().write_png(&shown, View::Neutral, 0.0).unwrap();
    assert!(fs::read(&shown).unwrap() == fs::read(&png).unwrap());
    image.write_png(&shown, View::Neutral, 0.0).unwrap();
    assert!(fs::read(&shown).unwrap() != fs::read(&png).unwrap(), "the raw image is shown");
    let answer = render("--spp 2 --denoise statistical", None, &[&exr]);
    assert!(answer.assert_done().stderr.contains("denoised by statistical (statistical)"), "{answer:?}");
    let answer = render("--spp 2 --denoise oidn", None, &[&exr]);
    if answer.code == Some(0) {
        // This machine has the library where the loader looks.
        return;
    }
    assert_eq!(answer.code, Some(3), "{answer:?}");
    assert!(answer.stderr.lines().last().unwrap().contains("libOpenImageDenoise.so.2"), "{answer:?}");
}

/// A checkpoint holds the sums that denoisers need: a resumed render is denoised to the same bits.
#[test]
fn a_resumed_render_is_denoised_to_the_same_bits() {
    let folder = folder();
    let [whole, parts, state, json] = ["a.exr", "b.exr", "state", "a.json"].map(|name| folder.path().join(name));
    let arguments = "--spp 9 --seed 3 --denoise auto";
    render(arguments, Some(&library()), &[&whole]).assert_done();
    let stopped = format!("{arguments} --time 0.001 --checkpoint {} --stats {}", state.display(), json.display());
    render(&stopped, Some(&library()), &[&parts]).assert_done();
    let samples = || serde_json::from_slice::<Value>(&fs::read(&json).unwrap()).unwrap()["samples"].clone();
    let mut stops = 0;
    while samples() != 9 {
        stops += 1;
        render(&format!("{stopped} --resume"), Some(&library()), &[&parts]).assert_done();
    }
    assert!(stops >= 2, "never stopped");
    let [whole, parts] = [&whole, &parts].map(|path| Image::read(path).unwrap());
    for channel in &whole.channels {
        assert!(bits(&whole, &channel.name) == bits(&parts, &channel.name), "{} differs", channel.name);
    }
    // Without what a denoiser needs the checkpoint is of other settings.
    let answer = render(
        &format!("--spp 9 --seed 3 --checkpoint {} --resume", state.display()),
        None,
        &[&state.with_extension("exr")],
    );
    answer.assert_refused(3, &["state", "other settings: denoise is auto, not none"]);
}
