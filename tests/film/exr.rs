//! EXR: written images are read back without loss, and damaged files are refused.

use std::fs;
use std::path::Path;

use glam::{DVec3, Mat4, Vec3};
use penumbra::internal::render::film::{Image, Metadata, View};
use penumbra::internal::scene::{Camera, Normalisation, Projection};

/// An image of 37 x 21 pixels, which is one block of 16 lines and a part, with values that f16 or decimal text cannot
/// represent.
fn sample() -> Image {
    let mut image = Image::new(37, 21);
    let names = ["shadow.lamp.class", "R", "G", "B", "A", "N.X", "Z", "direct.R", "shadow.Größe 灯.ni"];
    for (c, name) in names.into_iter().enumerate() {
        let bits = (0..image.pixels()).map(|i| ((i * 9 + c + 1) as u32).wrapping_mul(2_654_435_761));
        image.add_channel(name, bits.map(f32::from_bits).collect());
    }
    let z = image.channels.iter_mut().find(|channel| channel.name == "Z").unwrap();
    z.samples[..4].copy_from_slice(&[f32::INFINITY, f32::NEG_INFINITY, -0.0, 1e-45]);
    image.metadata = [
        ("penumbra:technique", Metadata::Text("shadow-photons".into())),
        ("penumbra:device", Metadata::Text("Gerät 灯, 37 %".into())),
        ("penumbra:an attribute with a name longer than thirty-one bytes", Metadata::Text(String::new())),
        ("penumbra:seed", Metadata::Int(i32::MIN)),
        ("samplesPerPixel", Metadata::Int(16)),
        ("renderTimeSeconds", Metadata::Float(1.25e-3)),
        ("comments", Metadata::Text("none".into())),
        ("software", Metadata::Text("penumbra".into())),
        ("worldToCamera", Metadata::Matrix(std::array::from_fn(|i| i as f32 + 0.5))),
        ("worldToNDC", Metadata::Matrix(std::array::from_fn(|i| -(i as f32)))),
        ("penumbra:matrix", Metadata::Matrix(std::array::from_fn(|i| 1.0 / (i + 1) as f32))),
    ]
    .map(|(name, value)| (name.to_owned(), value))
    .into();
    image
}

fn bits(samples: &[f32]) -> Vec<u32> {
    samples.iter().map(|x| x.to_bits()).collect()
}

fn written(image: &Image) -> Vec<u8> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.exr");
    image.write_exr(&path).unwrap();
    fs::read(path).unwrap()
}

fn read(bytes: &[u8]) -> Result<Image, String> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.exr");
    fs::write(&path, bytes).unwrap();
    Image::read_exr(&path).map_err(|error| {
        assert_eq!(error.exit_code(), 3, "{error}");
        let text = error.to_string();
        assert_eq!(text.lines().count(), 1, "{text}");
        text.strip_prefix(&format!("{}: ", path.display())).expect("the file is named").to_owned()
    })
}

#[test]
fn images_are_read_back_bit_for_bit() {
    let image = sample();
    let back = read(&written(&image)).unwrap();
    assert_eq!((back.width, back.height), (image.width, image.height));
    assert_eq!(back.metadata, image.metadata);
    assert_eq!(back.channels.len(), image.channels.len());
    for channel in &image.channels {
        assert_eq!(bits(back.channel(&channel.name).unwrap()), bits(&channel.samples), "{}", channel.name);
    }
    assert!(back.channels.is_sorted_by(|a, b| a.name < b.name));
}

/// An image that is read back has the PNG of the image that was written, with or without an alpha channel.
#[test]
fn images_are_as_transparent_as_before() {
    let mut image = Image::new(3, 2);
    for (name, value) in [("R", 0.25), ("G", 0.125), ("B", 0.5), ("A", 0.5)] {
        image.add_channel(name, vec![value; 6]);
    }
    let png = |image: &Image| image.to_png(View::default(), 0.0).unwrap();
    for transparent in [true, false] {
        image.transparent = transparent;
        let back = read(&written(&image)).unwrap();
        assert_eq!(back.transparent, transparent);
        assert_eq!(back.metadata, image.metadata);
        assert_eq!(png(&back), png(&image));
    }
    // Without an alpha channel nothing is transparent, whatever the file says.
    image.transparent = true;
    image.channels.retain(|channel| channel.name != "A");
    assert!(!read(&written(&image)).unwrap().transparent);
}

/// The header matches "OpenEXR File Layout" byte by byte, because other programs rely on it.
#[test]
fn the_header_follows_the_specification() {
    let bytes = written(&sample());
    let attribute = |name: &str, kind: &str| {
        let start = [name.as_bytes(), b"\0", kind.as_bytes(), b"\0"].concat();
        let at = bytes.windows(start.len()).position(|window| window == start).expect(name) + start.len();
        let size = u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap()) as usize;
        &bytes[at + 4..at + 4 + size]
    };
    let floats = |bytes: &[u8]| -> Vec<f32> {
        bytes.chunks(4).map(|four| f32::from_le_bytes(four.try_into().unwrap())).collect()
    };
    // Version 2, one part of scan lines, no tiles, no deep data, names longer than 31 bytes.
    assert_eq!(bytes[..8], [0x76, 0x2f, 0x31, 0x01, 2, 4, 0, 0]);
    // ZIP of 16 lines, with lines from top to bottom.
    assert_eq!(attribute("compression", "compression"), [3]);
    assert_eq!(attribute("lineOrder", "lineOrder"), [0]);
    let rec709 = [0.64, 0.33, 0.30, 0.60, 0.15, 0.06, 0.3127, 0.3290];
    assert_eq!(floats(attribute("chromaticities", "chromaticities")), rec709);
    assert_eq!(floats(attribute("worldToCamera", "m44f"))[..3], [0.5, 1.5, 2.5]);
    assert_eq!(attribute("penumbra:technique", "string"), b"shadow-photons");
    assert_eq!(attribute("samplesPerPixel", "int"), 16i32.to_le_bytes());
    assert_eq!(floats(attribute("renderTimeSeconds", "float")), [1.25e-3]);
}

#[test]
fn cameras_follow_the_conventions_of_pbrt() {
    let normalisation = Normalisation { centre: DVec3::new(10.0, -20.0, 30.0), exponent: -3 };
    // At world (12, -20, 46), looking along -x with +z up.
    let camera = Camera {
        name: "camera".into(),
        position: normalisation.apply(DVec3::new(12.0, -20.0, 46.0)),
        axes: [Vec3::Y, Vec3::Z, Vec3::X],
        projection: Projection::Perspective { yfov: 90f32.to_radians(), aspect: None },
        near: 0.125,
        far: f32::INFINITY,
        lens: None,
    };
    let mut image = Image::new(200, 100);
    image.add_channel("R", vec![0.0; image.pixels()]);
    image.add_camera(&camera, &normalisation);
    let matrix = |name: &str| match image.metadata[name] {
        // The rows of a matrix for row vectors are the columns of the matrix for column vectors.
        Metadata::Matrix(matrix) => Mat4::from_cols_array(&matrix),
        _ => panic!("{name} is a matrix"),
    };
    // The tolerance for f32 matrices at distances of about 50.
    let near = |found: Vec3, expected: Vec3| assert!((found - expected).length() < 1e-4, "{found} for {expected}");

    // 8 in front, 3 to the right, 2 up.
    let point = Vec3::new(12.0 - 8.0, -20.0 + 3.0, 46.0 + 2.0);
    near(matrix("worldToCamera").transform_point3(point), Vec3::new(3.0, 2.0, 8.0));
    // At 90 degrees half the view is 8 high and 16 wide there. The near plane is at 1, so z = 1 - 1/8 on the screen.
    let expected = Vec3::new(0.5 + 0.5 * 3.0 / 16.0, 0.5 - 0.5 * 2.0 / 8.0, 0.5 + 0.5 * (1.0 - 1.0 / 8.0));
    near(matrix("worldToNDC").project_point3(point), expected);
}

/// An attribute of the header: name, type, size, value.
fn attribute(name: &str, kind: &str, value: &[u8]) -> Vec<u8> {
    [name.as_bytes(), b"\0", kind.as_bytes(), b"\0", &(value.len() as u32).to_le_bytes(), value].concat()
}

/// An uncompressed EXR without pixels, with one f32 channel `Y` of that sampling and data window.
fn header(sampling: u32, window: [i32; 4]) -> Vec<u8> {
    let words = |words: &[u32]| words.iter().flat_map(|word| word.to_le_bytes()).collect::<Vec<_>>();
    let window: Vec<u8> = window.iter().flat_map(|word| word.to_le_bytes()).collect();
    let channels = [b"Y\0".as_slice(), &words(&[2, 0, sampling, sampling]), b"\0"].concat();
    [
        vec![0x76, 0x2f, 0x31, 0x01, 2, 0, 0, 0],
        attribute("channels", "chlist", &channels),
        attribute("compression", "compression", &[0]),
        attribute("dataWindow", "box2i", &window),
        attribute("displayWindow", "box2i", &window),
        attribute("lineOrder", "lineOrder", &[0]),
        attribute("pixelAspectRatio", "float", &1f32.to_le_bytes()),
        attribute("screenWindowCenter", "v2f", &[0; 8]),
        attribute("screenWindowWidth", "float", &1f32.to_le_bytes()),
        vec![0],
    ]
    .concat()
}

#[test]
fn a_file_made_by_hand_is_read() {
    // 2 x 2 pixels at (5, 7): a table of two offsets, then y, size and samples of each line.
    let mut bytes = header(1, [5, 7, 6, 8]);
    let start = bytes.len() as u64 + 16;
    bytes.extend([start, start + 16].map(u64::to_le_bytes).concat());
    for (y, line) in [(7i32, [1.5f32, -2.0]), (8, [1e8, 1e-8])] {
        bytes.extend(y.to_le_bytes());
        bytes.extend(8u32.to_le_bytes());
        bytes.extend(line.map(f32::to_le_bytes).concat());
    }
    let image = read(&bytes).unwrap();
    assert_eq!((image.width, image.height), (2, 2));
    assert_eq!(image.channel("Y").unwrap(), [1.5, -2.0, 1e8, 1e-8]);
}

#[test]
fn hostile_headers_are_errors() {
    let part = |flag: u8| {
        let mut bytes = header(1, [0, 0, 1, 1]);
        bytes[5] = flag;
        bytes
    };
    let mut dwa = header(1, [0, 0, 1, 1]);
    let at = dwa.windows(12).position(|window| window == b"compression\0").unwrap();
    dwa[at + 2 * 12 + 4] = 8;
    for (bytes, expected) in [
        (vec![], "the file is empty"),
        (vec![0x76, 0x2f], "this is not an OpenEXR file"),
        (vec![b'x'; 5000], "this is not an OpenEXR file"),
        (header(1, [0, 0, 1, 1])[..60].to_vec(), "the file ends within its header"),
        // 384,000 x 384,000 f32: 590 GB.
        (header(1, [0, 0, 383_999, 383_999]), "dataWindow: claims 589824000000 bytes of pixels in a file of"),
        (header(1, [0, 0, i32::MAX, i32::MAX]), "dataWindow: 2147483648 x 2147483648 pixels"),
        (header(1, [i32::MIN, i32::MIN, i32::MAX, i32::MAX]), "dataWindow: 4294967296 x 4294967296 pixels"),
        (header(1, [i32::MAX - 1, 0, i32::MAX, 1]), "dataWindow: 2 x 2 pixels"),
        (header(1, [0, 0, -1, 5]), "dataWindow: 0 x 6 pixels"),
        (header(2, [0, 0, 1, 1]), "Y: subsampled channel"),
        (header(0, [0, 0, 1, 1]), "Y: subsampled channel"),
        (dwa, "compression: DWAA and DWAB are not supported"),
        (part(0x08), "the file holds deep data"),
        (part(0x10), "the file holds several parts"),
        // Headers without pixels: small, about as large as plausible, and larger than 300 bytes can hold.
        (header(1, [0, 0, 1, 1]), "damaged EXR"),
        (header(1, [0, 0, 499, 499]), "damaged EXR"),
        (header(1, [0, 0, 0, 249_999]), "damaged EXR"),
        (header(1, [0, 0, 999, 999]), "dataWindow: claims 4000000 bytes"),
    ] {
        let error = read(&bytes).unwrap_err();
        assert!(error.starts_with(expected), "{error} for {expected}");
    }
    // Two data windows in either order.
    for windows in [[9999, 1], [1, 9999]] {
        let mut bytes = header(1, [0, 0, windows[0], windows[0]]);
        let second: Vec<u8> = [0, 0, windows[1], windows[1]].into_iter().flat_map(i32::to_le_bytes).collect();
        bytes.splice(8..8, attribute("dataWindow", "box2i", &second));
        assert!(read(&bytes).unwrap_err().starts_with("dataWindow: claims 400000000 bytes"));
    }
    // What follows an attribute without a type is read otherwise by the decoder: here as a window of 85 GB (found by
    // fuzzing).
    let mut bytes = header(1, [0, 0, 1, 1]);
    bytes.splice(8..8, attribute("a", "", &[]));
    assert_eq!(read(&bytes).unwrap_err(), "a: attribute without a type");
    // An attribute that claims a size of 2 GB.
    let mut bytes = header(1, [0, 0, 1, 1]);
    let at = bytes.windows(6).position(|window| window == b"chlist").unwrap() + 7;
    bytes[at..at + 4].copy_from_slice(&i32::MAX.to_le_bytes());
    assert!(read(&bytes).unwrap_err().starts_with("the file ends within its header"));
}

#[test]
fn damage_anywhere_causes_no_panic() {
    let bytes = written(&sample());
    for length in (0..bytes.len()).step_by(bytes.len() / 200) {
        assert!(read(&bytes[..length]).is_err(), "{length} of {} bytes", bytes.len());
    }
    // Every byte of the header is set to extreme values. The pixels may change, or the file may be refused.
    let end = bytes.windows(17).position(|window| window == b"screenWindowWidth").unwrap() + 40;
    for at in 0..end {
        for value in [0, 0x7f, 0xff] {
            let mut damaged = bytes.clone();
            damaged[at] = value;
            if let Ok(image) = read(&damaged) {
                assert!(image.channels.iter().all(|channel| channel.samples.len() == image.pixels()));
            }
        }
    }
}

#[test]
fn images_that_the_format_cannot_represent_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.exr");
    let refused = |change: &dyn Fn(&mut Image), expected: &str| {
        let mut image = sample();
        change(&mut image);
        let error = image.write_exr(&path).unwrap_err().to_string();
        assert!(error.contains(expected), "{error}");
        assert!(!Path::new(&path).exists());
    };
    refused(&|image| image.channels[0].name.clear(), "cannot be called \"\"");
    refused(&|image| image.channels[0].name = "a\0b".into(), "cannot be called");
    refused(&|image| image.channels[0].name = "R".into(), "two channels are called R");
    refused(&|image| image.channels[0].samples.truncate(5), "5 samples for 777 pixels");
    refused(&|image| image.width = 0, "without pixels");
    refused(&|image| image.channels.clear(), "without pixels or channels");
    refused(&|image| drop(image.metadata.insert("dataWindow".into(), Metadata::Int(3))), "dataWindow");
}

#[test]
fn a_view_of_an_exr_that_was_read_can_be_written() {
    let folder = tempfile::tempdir().unwrap();
    let (exr, png) = (folder.path().join("a.exr"), folder.path().join("a.png"));
    sample().write(&exr, View::Neutral, 0.0).unwrap();
    Image::read(&exr).unwrap().write(&png, View::Agx, 0.5).unwrap();
    assert_eq!(image::image_dimensions(&png).unwrap(), (37, 21));
}
