//! `penumbra compare`: measures against arithmetic, exit codes against the limit.

use std::path::{Path, PathBuf};

use penumbra::Image;
use penumbra::internal::render::film::{View, Window};

use crate::program::{Answer, folder, run};
use crate::schema;

/// An EXR of one grey.
fn grey(folder: &Path, name: &str, [width, height]: [u32; 2], value: f32) -> PathBuf {
    let mut image = Image::new(width, height);
    for channel in ["R", "G", "B"] {
        image.add_channel(channel, vec![value; image.pixels()]);
    }
    let path = folder.join(name);
    image.write_exr(&path).unwrap();
    path
}

fn compare(arguments: &str, [image, reference]: [&PathBuf; 2]) -> Answer {
    run(&format!("compare {arguments}"), &[image, reference])
}

#[test]
fn measures_are_those_of_arithmetic() {
    let folder = folder();
    let image = grey(folder.path(), "image.exr", [16, 8], 0.75);
    let reference = grey(folder.path(), "reference.exr", [16, 8], 0.5);
    let answer = compare("--json", [&image, &reference]);
    let measures = answer.assert_done().json();
    schema::assert_documented("Comparison", &measures);
    // All values are exact in f32, so only the rounding of f64 is left.
    let assert_near = |key: &str, expected: f64| {
        let value = measures[key].as_f64().unwrap();
        assert!((value - expected).abs() < 1e-12, "{key} {value}, not {expected}");
    };
    assert_near("rmse", 0.25);
    assert_near("mae", 0.25);
    assert_near("p99", 0.25);
    assert_near("relmse", 0.0625 / 0.26);
    let flip = measures["flip"].as_f64().unwrap();
    assert!(flip > 0.0 && flip < 1.0, "{flip}");

    let text = compare("", [&image, &reference]);
    let text = &text.assert_done().stdout;
    for line in ["RMSE    2.5000e-1", "relMSE  2.4038e-1", "MAE     2.5000e-1", "p99     2.5000e-1", "FLIP    "] {
        assert!(text.contains(line), "{text}");
    }
}

#[test]
fn the_limit_decides_the_exit_code() {
    let folder = folder();
    let image = grey(folder.path(), "image.exr", [16, 8], 0.75);
    let reference = grey(folder.path(), "reference.exr", [16, 8], 0.5);
    // relMSE is 0.0625 / 0.26 = 0.2404.
    compare("--max-relmse 0.241", [&image, &reference]).assert_done();
    let above = compare("--max-relmse 0.240", [&image, &reference]);
    assert_eq!(above.code, Some(5));
    assert!(above.stdout.contains("relMSE") && above.stderr.contains("image.exr"), "{above:?}");
    compare("--max-relmse 0", [&image, &image]).assert_done();
}

/// What a screen shows is no radiance.
#[test]
fn formats_of_two_kinds_are_noted() {
    let folder = folder();
    let image = grey(folder.path(), "image.exr", [16, 8], 0.75);
    let shown = folder.path().join("image.png");
    Image::read(&image).unwrap().write_png(&shown, View::default(), 0.0).unwrap();
    for (pair, noted) in [([&image, &shown], true), ([&shown, &image], true), ([&shown, &shown], false)] {
        let answer = compare("", pair);
        assert_eq!(answer.assert_done().stderr.contains("one image is .png"), noted, "{answer:?}");
    }
}

#[test]
fn images_that_cannot_be_compared() {
    let folder = folder();
    let image = grey(folder.path(), "image.exr", [16, 8], 0.75);
    let other = grey(folder.path(), "other.exr", [8, 8], 0.5);
    let nan = grey(folder.path(), "nan.exr", [16, 8], f32::NAN);
    let missing = folder.path().join("missing.exr");
    let broken = folder.path().join("broken.exr");
    std::fs::write(&broken, "not an image").unwrap();
    let [part, other_part] = [0, 4].map(|x| {
        let mut part = Image::read(&other).unwrap();
        part.crop = Some(Window { at: [x, 0], of: [16, 8] });
        let path = folder.path().join(format!("part{x}.exr"));
        part.write_exr(&path).unwrap();
        path
    });
    compare("", [&part, &part]).assert_done();
    compare("", [&part, &other_part]).assert_refused(3, &["part0.exr", "another part"]);
    compare("", [&image, &missing]).assert_refused(3, &["missing.exr"]);
    compare("", [&broken, &image]).assert_refused(3, &["broken.exr"]);
    compare("", [&other, &image]).assert_refused(3, &["other.exr", "8 x 8", "16 x 8"]);
    compare("", [&image, &nan]).assert_refused(3, &["nan.exr", "R", "NaN"]);
    compare("", [&nan, &image]).assert_refused(3, &["nan.exr", "R", "NaN"]);
}
