//! `penumbra render`: what of the scene an image shows.

use std::path::Path;

use penumbra::Image;

use crate::program::{Answer, BOX, device, folder, penumbra};

const SPHERE: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/scenes/sphere.glb");
const SKY: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/scenes/sky.exr");

/// Renders direct light by path tracing, whose pixels do not depend on each other.
fn render(scene: &str, arguments: &str, outputs: &[&Path]) -> Answer {
    let spp = if arguments.contains("--spp") { "" } else { "--spp 4" };
    let common = format!("--technique path --max-bounces 0 {spp} --denoise none --width 24 --height 16");
    let mut command = penumbra(&format!("render --device {} {common} {arguments}", device()), &[&scene]);
    for output in outputs {
        command.arg("-o").arg(output);
    }
    Answer::of(&mut command)
}

fn pixel(image: &Image, i: usize) -> [f32; 4] {
    ["R", "G", "B", "A"].map(|name| image.channel(name).unwrap()[i])
}

#[test]
fn a_crop_has_the_bits_of_the_whole_image() {
    let folder = folder();
    let [whole, part, png] = ["whole.exr", "part.exr", "part.png"].map(|name| folder.path().join(name));
    render(BOX, "--aov all", &[&whole]).assert_done();
    render(BOX, "--aov all --crop 7,5,11,8", &[&part, &png]).assert_done();
    let [whole, part] = [whole, part].map(|path| Image::read(path).unwrap());
    let window = part.crop.unwrap();
    assert_eq!((part.width, part.height, window.at, window.of), (11, 8, [7, 5], [24, 16]));
    assert_eq!(part.metadata["worldToNDC"], whole.metadata["worldToNDC"]);
    assert_eq!(whole.crop, None);
    assert!(part.channels.len() > 10);
    for channel in &part.channels {
        let of_whole = whole.channel(&channel.name).unwrap();
        for (i, got) in channel.samples.iter().enumerate() {
            let expected = of_whole[(5 + i / 11) * 24 + 7 + i % 11];
            assert_eq!(got.to_bits(), expected.to_bits(), "{} of pixel {i}", channel.name);
        }
    }
    let png = Image::read(png).unwrap();
    assert_eq!((png.width, png.height), (11, 8));
    for crop in ["0,0,25,16", "0,9,24,8", "3,3,0,1", "4294967295,0,2,1"] {
        render(BOX, &format!("--crop {crop}"), &[&folder.path().join("a.exr")]).assert_refused(2, &["--crop"]);
    }
    render(BOX, "--crop 1,2,3", &[&folder.path().join("a.exr")]).assert_refused(2, &["four whole numbers"]);
}

#[test]
fn backgrounds_replace_what_is_behind_the_scene() {
    let folder = folder();
    let render = |name: &str, arguments: &str| {
        let [exr, png] = ["exr", "png"].map(|extension| folder.path().join(format!("{name}.{extension}")));
        let sky = format!("--environment {SKY} --aov P,Z {arguments}");
        render(SPHERE, &sky, &[&exr, &png]).assert_done();
        (Image::read(exr).unwrap(), image::open(png).unwrap())
    };
    let (shown, png) = render("shown", "");
    assert!(shown.channel("A").unwrap().iter().all(|alpha| *alpha == 1.0));
    assert_eq!(png.color(), image::ColorType::Rgb8);
    let (clear, png) = render("clear", "--background transparent");
    assert_eq!(png.color(), image::ColorType::Rgba8);
    let (red, _) = render("red", "--background 2,0.5,0");
    let (coded, _) = render("coded", "--background #ff8000");
    let (mut covered, mut open) = (0, 0);
    for i in 0..shown.pixels() {
        let [r, g, b, alpha] = pixel(&clear, i);
        let code = f32::from(png.to_rgba8().get_pixel(i as u32 % 24, i as u32 / 24)[3]);
        // Codes are rounded to the nearest whole number.
        assert!((code - 255.0 * alpha).abs() <= 0.5, "alpha {alpha} has the code {code}");
        if alpha == 1.0 {
            // The environment lights the scene all the same.
            assert_eq!(pixel(&shown, i), [r, g, b, 1.0]);
            covered += 1;
        }
        for name in ["P.X", "P.Y", "P.Z", "Z"] {
            assert_eq!(shown.channel(name).unwrap()[i].to_bits(), clear.channel(name).unwrap()[i].to_bits(), "{name}");
        }
        if alpha == 0.0 {
            // The value that Blender writes for no surface.
            assert_eq!(shown.channel("Z").unwrap()[i], 1e10);
            assert_eq!([r, g, b], [0.0; 3]);
            assert_eq!(pixel(&red, i), [2.0, 0.5, 0.0, 1.0]);
            // IEC 61966-2-1: the code 0x80 is 0.21586.
            let [r, g, b, alpha] = pixel(&coded, i);
            assert!((g - 0.215_86).abs() < 1e-5 && [r, b, alpha] == [1.0, 0.0, 1.0], "{g}");
            open += 1;
        } else {
            let behind = 1.0 - alpha;
            let expected = [r + behind * 2.0, g + behind * 0.5, b, 1.0];
            for (got, expected) in pixel(&red, i).into_iter().zip(expected) {
                // Sums in f64, rounded once.
                assert!((got - expected).abs() <= 1e-6 * expected.max(1.0), "{got} for {expected}");
            }
        }
    }
    assert!(covered > 50 && open > 50, "{covered} pixels are covered, {open} open");
}

/// Views of one sphere on a plane: the image from above shows no background, the image from the front does.
#[test]
fn views_have_a_direction() {
    let folder = folder();
    let [above, front] = ["above.exr", "front.exr"].map(|name| folder.path().join(name));
    render(SPHERE, "--from 0,90 --aov Z", &[&above]).assert_done();
    render(SPHERE, "--from=-20,5 --aov Z", &[&front]).assert_done();
    let open = |path: &Path| {
        let image = Image::read(path).unwrap();
        image.channel("A").unwrap().iter().filter(|alpha| **alpha == 0.0).count()
    };
    assert!(open(&above) < open(&front), "{} and {} open pixels", open(&above), open(&front));
    let path = folder.path().join("a.exr");
    render(SPHERE, "--from 0,91", &[&path]).assert_refused(2, &["from -90 to 90"]);
    render(SPHERE, "--from 0,9 --camera 0", &[&path]).assert_refused(2, &["--camera"]);
    render(SPHERE, "--iris-blades 5", &[&path]).assert_refused(2, &["--aperture"]);
    render(SPHERE, "--aperture 2 --iris-blades 2", &[&path]).assert_refused(2, &["from 3"]);
    render(SPHERE, "--aperture 2 --focus behind", &[&path]).assert_refused(2, &["or auto"]);
}

/// A wide iris blurs what is not in focus: edges between colours become smoother.
#[test]
fn irises_blur_what_is_out_of_focus() {
    let folder = folder();
    let edges = |name: &str, arguments: &str| {
        let path = folder.path().join(name);
        render(SPHERE, &format!("--spp 64 --aov albedo {arguments}"), &[&path]).assert_done();
        let image = Image::read(path).unwrap();
        let colour = image.channel("albedo.R").unwrap();
        let difference = |i: usize| if i % 24 == 23 { 0.0 } else { (colour[i] - colour[i + 1]).powi(2) };
        (0..image.pixels()).map(difference).sum::<f32>()
    };
    let sharp = edges("sharp.exr", "");
    let focused = edges("focused.exr", "--aperture 0.02");
    let blurred = edges("blurred.exr", "--aperture 0.02 --focus 0.5 --iris-blades 6");
    assert!(blurred < 0.7 * focused && blurred < 0.7 * sharp, "{sharp}, {focused}, {blurred}");
}
