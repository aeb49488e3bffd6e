//! `penumbra render --samples` and `penumbra merge`.

use std::fs;
use std::path::{Path, PathBuf};

use penumbra::Image;

use crate::program::{Answer, BOX, device, folder, lacks, penumbra, run};

fn render(arguments: &str, output: &Path) -> Answer {
    let common = "--technique path --max-bounces 1 --spp 6 --width 20 --height 12";
    let mut command = penumbra(&format!("render --device {} {common} {arguments}", device()), &[&BOX]);
    Answer::of(command.arg("-o").arg(output))
}

fn merge(arguments: &str, pieces: &[&PathBuf], output: &Path) -> Answer {
    let mut command = penumbra(&format!("merge {arguments}"), &[]);
    Answer::of(command.args(pieces).arg("-o").arg(output))
}

#[test]
fn pieces_are_merged_in_any_order() {
    let folder = folder();
    let file = |name: &str| folder.path().join(name);
    let [one, a, b, c, whole, parts, png] =
        ["one.exr", "a.exr", "b.exr", "c.exr", "whole.exr", "parts.exr", "parts.png"].map(file);
    render("--samples 0..6", &one).assert_done();
    render("--samples 0..3", &a).assert_done();
    render("--samples 3..6 --crop 0,0,7,12", &b).assert_done();
    render("--samples 3..6 --crop 7,0,13,12", &c).assert_done();
    merge("", &[&one], &whole).assert_done();
    merge("", &[&c, &a, &b], &parts).assert_done();
    assert!(fs::read(&whole).unwrap() == fs::read(&parts).unwrap(), "the files differ");
    merge("--view agx", &[&b, &c, &a], &png).assert_done();
    assert_eq!(Image::read(&png).unwrap().width, 20);
    // What is missing.
    let [part, missing] = ["part.exr", "missing.exr"].map(file);
    merge("", &[&b, &a], &missing).assert_refused(3, &["samples 3..6 of the pixels 7,0,13,12", "--partial"]);
    assert!(!missing.exists());
    let answer = merge("--partial", &[&b, &a], &part);
    answer.assert_done();
    assert!(answer.stderr.contains("note: samples 3..6 of the pixels 7,0,13,12 are in no piece"), "{answer:?}");
    let [part, whole] = [part, whole].map(|path| Image::read(path).unwrap());
    let of = |image: &Image, pixel: usize| image.channel("G").unwrap()[pixel].to_bits();
    assert_eq!(of(&part, 6), of(&whole, 6));
    // Files that are no pieces.
    merge("", &[&a, &PathBuf::from(BOX)], &missing).assert_refused(3, &["box.glb"]);
    merge("", &[&a, &file("none.exr")], &missing).assert_refused(3, &["none.exr"]);
    let usual = file("usual.exr");
    render("", &usual).assert_done();
    merge("", &[&a, &usual], &missing).assert_refused(3, &["usual.exr", "is not a piece that --samples makes"]);
}

#[test]
fn merged_pieces_are_denoised() {
    let folder = folder();
    let file = |name: &str| folder.path().join(name);
    let [a, b, plain, exr, png] = ["a.exr", "b.exr", "plain.exr", "whole.exr", "whole.png"].map(file);
    // Which denoiser pieces are for is the same to them.
    render("--samples 0..5 --denoise statistical", &a).assert_done();
    render("--samples 5..6 --denoise auto", &b).assert_done();
    let denoise = format!("--device {} --denoise statistical", device());
    merge(&denoise, &[&a, &b], &exr).assert_done();
    merge(&denoise, &[&b, &a], &png).assert_done();
    let image = Image::read(&exr).unwrap();
    assert!(image.channel("error").is_some());
    let shown = file("shown.png");
    image.denoised().unwrap().write_png(&shown, penumbra::View::Neutral, 0.0).unwrap();
    assert!(fs::read(&shown).unwrap() == fs::read(&png).unwrap(), "the PNG is not the denoised image");
    // By default a .png shows an image without noise, as that of a render, and an .exr has the raw image alone.
    let [by_default, auto] = ["default.png", "auto.png"].map(file);
    let device = format!("--device {}", device());
    merge(&device, &[&a, &b], &by_default).assert_done();
    merge(&format!("{device} --denoise auto"), &[&a, &b], &auto).assert_done();
    assert!(fs::read(&by_default).unwrap() == fs::read(&auto).unwrap());
    merge("", &[&a, &b], &exr).assert_done();
    assert!(Image::read(&exr).unwrap().denoised().is_none());
    merge(&denoise, &[&a], &exr).assert_refused(3, &["samples 5..6", "are in no piece"]);
    render("--samples 0..6", &plain).assert_done();
    merge(&denoise, &[&plain], &exr).assert_refused(3, &["plain.exr", "--denoise was none"]);
    merge(&format!("{denoise} --partial"), &[&a], &exr).assert_refused(2, &["--partial"]);
}

/// Pieces of an image that no memory can hold are refused before anything of its size is made.
#[test]
fn a_merged_image_that_does_not_fit_the_memory() {
    // Of each pixel 24 channels, the number of samples, and four vectors of doubles of which channels are made.
    let needed = 16_384 * 16_384 * (24 * 4 + 4 + 4 * 32);
    if !lacks(needed) {
        return;
    }
    let folder = folder();
    let [piece, output] = ["piece.exr", "whole.exr"].map(|name| folder.path().join(name));
    let aovs = "--aov direct,indirect,albedo,N,P,Z,variance,samples";
    let part = format!("--samples 0..6 --crop 0,0,4,4 --denoise statistical {aovs}");
    let common = "--technique path --max-bounces 1 --spp 6 --width 16384 --height 16384";
    let mut command = penumbra(&format!("render --device {} {common} {part}", device()), &[&BOX]);
    Answer::of(command.arg("-o").arg(&piece)).assert_done();
    let answer = merge("--partial", &[&piece], &output);
    let size = "an image of 16384 x 16384 pixels needs at least ";
    // After the note on what is missing.
    assert_eq!(answer.code, Some(1), "{answer:?}");
    let words = [size, "GB are available", "merge pieces of fewer --aov"];
    assert!(words.iter().all(|word| answer.stderr.contains(word)), "{answer:?}");
    let stated = answer.stderr.split_once(size).and_then(|(_, rest)| rest.split(' ').next()?.parse::<f64>().ok());
    // It is stated to a tenth.
    assert!(stated.is_some_and(|gigabytes| (gigabytes + 0.05) * 1e9 >= needed as f64), "{answer:?}");
    assert!(!output.exists());
}

#[test]
fn what_pieces_cannot_be_is_refused() {
    let folder = folder();
    let output = folder.path().join("a.exr");
    for (arguments, words) in [
        ("--samples 0..7", &["--samples is 0..7", "--spp, 6"][..]),
        ("--samples 3..3", &["--samples is 3..3"]),
        ("--samples 3", &["--samples", "0..16"]),
        ("--samples 0..6 --time 1", &["--time cannot be combined with --samples"]),
        ("--samples 0..6 --noise 1e-3", &["--noise cannot be combined with --samples"]),
        ("--samples 0..6 --sampling adaptive", &["--sampling cannot be combined with --samples"]),
        ("--samples 0..6 --aov shadow", &["--aov cannot be combined with --samples"]),
    ] {
        render(arguments, &output).assert_refused(2, words);
    }
    render("--samples 0..6", &folder.path().join("a.png"))
        .assert_refused(2, &["--samples needs an output that is .exr"]);
    let ward = format!("render --device {} --technique ward-adaptive --samples 0..6 -o {}", device(), output.display());
    run(&ward, &[&BOX]).assert_refused(2, &["--technique cannot be combined with --samples", "learns"]);
    assert!(!output.exists());
}

/// The same command writes the same bytes.
#[test]
fn a_command_writes_the_same_bytes() {
    let folder = folder();
    for arguments in ["--aov all", "--samples 1..4"] {
        let [a, b] = ["a.exr", "b.exr"].map(|name| {
            let file = folder.path().join(name);
            render(arguments, &file).assert_done();
            fs::read(file).unwrap()
        });
        assert!(a == b, "{arguments}: the files differ");
    }
}
