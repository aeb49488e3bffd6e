//! PNG files, read back with a different crate.

use std::fs;

use penumbra::internal::render::film::{Image, View, fingerprint};

fn image(channels: &[(&str, &[f32])]) -> Image {
    let mut image = Image::new(2, 2);
    for (name, samples) in channels {
        image.add_channel(*name, samples.to_vec());
    }
    image
}

#[test]
fn pixels_are_coded_in_srgb_after_exposure() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.png");
    let image = image(&[
        ("R", &[0.0, 0.25, 0.1, 5.0]),
        ("G", &[0.0, 0.5, 0.1, 0.0]),
        ("B", &[0.5, 0.0, 0.1, f32::NAN]),
        ("Z", &[9.0; 4]),
    ]);
    image.write_png(&path, View::Standard, 1.0).unwrap();
    let png = image::open(&path).unwrap();
    assert_eq!(png.color(), image::ColorType::Rgb8);
    // In IEC 61966-2-1, linear 1/2 has the code 187.52, and 1/5 has 123.54.
    assert_eq!(png.to_rgb8().into_raw(), [0, 0, 255, 188, 255, 0, 124, 124, 124, 255, 0, 0]);

    image.write_png(&path, View::Raw, 0.0).unwrap();
    assert_eq!(image::open(&path).unwrap().to_rgb8().into_raw(), [0, 0, 128, 64, 128, 0, 26, 26, 26, 255, 0, 0]);
}

/// The exposure that suits the image is 0, not -0.
#[test]
fn no_exposure_is_suggested_as_zero() {
    let grey: &[f32] = &[0.18; 4];
    let suggested = image(&[("R", grey), ("G", grey), ("B", grey)]).suggested_exposure(10.0).unwrap();
    assert_eq!(suggested.to_string(), "0");
}

/// A PNG has premultiplied colour over black, without alpha.
#[test]
fn transparency_is_over_black() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("alpha.png");
    let mut image = Image::new(2, 1);
    for name in ["R", "G", "B"] {
        image.add_channel(name, vec![0.25, 0.0]);
    }
    image.add_channel("A", vec![0.5, 0.0]);
    image.write_png(&path, View::Raw, 0.0).unwrap();
    let png = image::open(&path).unwrap();
    assert!(!png.color().has_alpha());
    // 0.25 * 255 = 63.75.
    assert_eq!(png.to_rgb8().into_raw(), [64, 64, 64, 0, 0, 0]);
}

#[test]
fn srgb_codes_are_preserved() {
    let folder = tempfile::tempdir().unwrap();
    let (first, second) = (folder.path().join("a.png"), folder.path().join("b.png"));
    let codes: Vec<u8> = (0..=255).flat_map(|i: u8| [i, 255 - i, i / 2]).collect();
    image::save_buffer(&first, &codes, 16, 16, image::ColorType::Rgb8).unwrap();
    Image::read(&first).unwrap().write(&second, View::Standard, 0.0).unwrap();
    assert_eq!(image::open(&second).unwrap().to_rgb8().into_raw(), codes);
}

#[test]
fn radiance_hdr_is_read_without_change() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.hdr");
    // Flat RGBE: mantissa / 256 * 2^(exponent - 128).
    let header = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 1 +X 2\n";
    std::fs::write(&path, [header.as_slice(), &[128, 64, 0, 129, 128, 128, 128, 138]].concat()).unwrap();
    let image = Image::read(&path).unwrap();
    assert_eq!(image.rgb().unwrap(), [&[1.0, 512.0], &[0.5, 512.0], &[0.0, 512.0]]);
}

#[test]
fn files_that_are_not_images_are_errors() {
    let folder = tempfile::tempdir().unwrap();
    // A PNG header with a valid checksum for 400,000 x 400,000 pixels, 590 GB as RGBA, without data.
    let mut huge = Vec::new();
    png::Encoder::new(&mut huge, 400_000, 400_000).write_header().unwrap();
    // 14 MB of pixels with 64 bits each in 302 bytes. The limit must use these 64 bits, not one (found by fuzzing).
    let mut wide = Vec::new();
    let mut encoder = png::Encoder::new(&mut wide, 9, 200_000);
    encoder.set_color(png::ColorType::Rgba);
    encoder.set_depth(png::BitDepth::Sixteen);
    encoder.write_header().unwrap().write_chunk(png::chunk::IDAT, &[0; 245]).unwrap();
    // Radiance files whose size is zero, or too large for so few bytes.
    let radiance = |size: &str| format!("#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n{size}\n").into_bytes();
    for (name, bytes) in [
        ("nothing.hdr", radiance("-Y 0 +X 7")),
        ("claims.hdr", radiance("-Y 4000 +X 4000")),
        ("empty.png", Vec::new()),
        ("garbage.png", vec![7; 999]),
        ("garbage.hdr", vec![7; 999]),
        ("text.txt", vec![7; 9]),
        ("huge.png", huge),
        ("wide.png", wide),
    ] {
        let path = folder.path().join(name);
        std::fs::write(&path, bytes).unwrap();
        let error = Image::read(&path).unwrap_err();
        assert_eq!(error.exit_code(), 3);
        assert!(error.to_string().contains(name), "{error}");
        assert!(name != "wide.png" || error.to_string().contains("claims 9 x 200000"), "{error}");
        assert_eq!(error.to_string().lines().count(), 1, "{error}");
    }
    for name in ["missing.png", "."] {
        assert_eq!(Image::read(folder.path().join(name)).unwrap_err().exit_code(), 3);
    }
}

/// A sequence recognises its own frames of any size by their fingerprint, and only complete ones.
#[test]
fn large_frames_are_recognised() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("frame.png");
    let [width, height] = [8192, 4320];
    let mut encoder = png::Encoder::new(fs::File::create(&path).unwrap(), width, height);
    encoder.set_depth(png::BitDepth::One);
    encoder.add_text_chunk("penumbra:fingerprint".into(), "f00".into()).unwrap();
    let mut writer = encoder.write_header().unwrap();
    writer.write_image_data(&vec![0x5a; (width / 8 * height) as usize]).unwrap();
    writer.finish().unwrap();
    assert_eq!(fingerprint(&path).as_deref(), Some("f00"));
    let mut bytes = fs::read(&path).unwrap();
    bytes.truncate(bytes.len() - 20);
    fs::write(&path, bytes).unwrap();
    assert_eq!(fingerprint(&path), None);
}
