//! Pieces: whatever the cut, the whole has the same bits.

use std::path::{Path, PathBuf};

use penumbra::internal::render::pieces::Pieces;
use penumbra::internal::scene::ImportOptions;
use penumbra::settings::{Background, Crop, Denoise, SampleRange};
use penumbra::{Aov, Denoiser, Image, Metadata, Renderer, Scene, Settings, Technique};

use crate::random::{Random, RandomInput as _};
use crate::setup::{assert_same, gpu, scene_file};

fn renderer(scene: &str, settings: &Settings) -> Renderer<'static> {
    let scene = Scene::load(scene_file(scene), &ImportOptions::default()).unwrap();
    let camera = scene.cameras[0].clone();
    Renderer::new(gpu(), scene, &camera, settings).unwrap()
}

/// Renders a piece to a file.
fn render(scene: &str, settings: &Settings, file: PathBuf) -> PathBuf {
    let mut renderer = renderer(scene, settings);
    while renderer.samples() < settings.image.range().count() {
        renderer.render_batch().unwrap();
    }
    renderer.image().unwrap().write_exr(&file).unwrap();
    file
}

fn merge(files: &[PathBuf]) -> Image {
    let pieces = Pieces::open(files).unwrap();
    assert_eq!(pieces.missing(), []);
    pieces.merge().unwrap()
}

/// Cuts a part of the image and of the samples in two, `times` times.
fn cut(random: &mut Random, part: (SampleRange, Crop), times: u32) -> Vec<(SampleRange, Crop)> {
    let mut parts = vec![part];
    for _ in 0..times {
        let index = random.below(parts.len() as u32) as usize;
        let (range, crop) = parts[index];
        let (mut first, mut second) = ((range, crop), (range, crop));
        let lengths = [range.count(), crop.width, crop.height];
        // Samples as often as pixels.
        let axis = [0, 0, 1, 2][random.below(4) as usize];
        if lengths[axis] < 2 {
            continue;
        }
        let at = 1 + random.below(lengths[axis] - 1);
        match axis {
            0 => (first.0.end, second.0.first) = (range.first + at, range.first + at),
            1 => (first.1.width, second.1.x, second.1.width) = (at, crop.x + at, crop.width - at),
            _ => (first.1.height, second.1.y, second.1.height) = (at, crop.y + at, crop.height - at),
        }
        parts[index] = first;
        parts.push(second);
    }
    // In any order.
    for i in (1..parts.len()).rev() {
        parts.swap(i, random.below(i as u32 + 1) as usize);
    }
    parts
}

fn settings(technique: Technique, spp: u32) -> Settings {
    Settings::default().with(|s| {
        s.technique = technique;
        (s.image.width, s.image.height, s.image.spp) = (24, 18, spp);
        s.image.aovs = vec![Aov::Direct, Aov::Indirect, Aov::Albedo, Aov::Normal, Aov::Position, Aov::Depth];
        s.image.aovs.extend([Aov::Variance, Aov::Samples]);
        s.visibility_map.photons_per_light = Some(4096);
        // Many audits contradict the map: if they repaired it, pieces would differ.
        s.visibility_map.audit = 0.25;
        s.indirect.photons = Some(4096);
        s.indirect.irradiance_cache.gather_rays = Some(16);
    })
}

/// Random cuts by samples and by pixels, over the samples at which photons, records and caustics are made again.
#[test]
fn any_cut_has_the_bits_of_one_process() {
    let folder = tempfile::tempdir_in(env!("CARGO_TARGET_TMPDIR")).unwrap();
    let mut random = Random(23);
    for (scene, technique, spp, times) in [
        ("box.glb", Technique::PATH, 21, 4),
        ("sphere.glb", Technique::TWO_PASS, 36, 3),
        ("sphere.glb", Technique::SHADOW_PHOTONS, 36, 4),
        // Glossy surfaces, caustics.
        ("still_life.glb", Technique::SHADOW_PHOTONS, 21, 3),
        // More lights than a chunk has, sampled by zones.
        ("lamps.glb", Technique::SHADOW_PHOTONS, 12, 2),
        ("box.glb", Technique::VISIBILITY_ESTIMATE, 9, 3),
    ] {
        let what = format!("{scene}, {technique}");
        let settings = settings(technique, spp);
        let all = (SampleRange { first: 0, end: spp }, Crop { x: 0, y: 0, width: 24, height: 18 });
        let piece = |(range, crop): (SampleRange, Crop), name: &str| {
            let settings = settings.clone().with(|s| (s.image.piece, s.image.crop) = (Some(range), Some(crop)));
            render(scene, &settings, folder.path().join(name))
        };
        let uncut = settings.clone().with(|s| s.image.piece = Some(all.0));
        let one = render(scene, &uncut, folder.path().join("one.exr"));
        let whole = merge(std::slice::from_ref(&one));
        // The one process shows the same picture itself.
        let shown = Image::read_exr(&one).unwrap();
        for channel in &whole.channels {
            assert_eq!(shown.channel(&channel.name).unwrap(), channel.samples, "{what}: {}", channel.name);
        }
        let parts = cut(&mut random, all, times);
        let files: Vec<_> = parts.iter().zip(0..).map(|(part, i)| piece(*part, &format!("{i}.exr"))).collect();
        let merged = merge(&files);
        assert_same(&merged, &whole, &what);
        let [a, b] = [("a.exr", &merged), ("b.exr", &whole)].map(|(name, image)| {
            let file = folder.path().join(name);
            image.write_exr(&file).unwrap();
            std::fs::read(file).unwrap()
        });
        assert!(a == b, "{what}: the files differ");
    }
}

/// Merged pieces are denoised: with the same bits whatever the cut, and as an ordinary render of the same samples.
#[test]
fn merged_pieces_are_denoised() {
    let folder = tempfile::tempdir_in(env!("CARGO_TARGET_TMPDIR")).unwrap();
    let mut random = Random(7);
    let denoiser = Denoiser::new(Denoise::Statistical, None).unwrap();
    // Samples are 0 to 7 and 8 to 20 for denoisers; the largest node of the tree is 0 to 15.
    let settings = settings(Technique::PATH, 21).with(|s| {
        s.image.denoise = Denoise::Statistical;
        s.image.background = Background::Colour([0.25, 0.5, 1.0]);
        s.image.aovs = vec![Aov::Variance];
    });
    let mut usual = renderer("still_life.glb", &settings);
    while usual.samples() < 21 {
        usual.render_batch().unwrap();
    }
    let usual = usual.denoised_image(&denoiser).unwrap();
    let all = (SampleRange { first: 0, end: 21 }, Crop { x: 0, y: 0, width: 24, height: 18 });
    let piece = |(range, crop): (SampleRange, Crop), name: &str| {
        let settings = settings.clone().with(|s| (s.image.piece, s.image.crop) = (Some(range), Some(crop)));
        render("still_life.glb", &settings, folder.path().join(name))
    };
    let denoised = |files: &[PathBuf]| Pieces::open(files).unwrap().merge_denoised(gpu(), &denoiser);
    let one = denoised(&[piece(all, "one.exr")]).unwrap();
    let files: Vec<_> =
        cut(&mut random, all, 3).iter().zip(0..).map(|(part, i)| piece(*part, &format!("{i}.exr"))).collect();
    assert_same(&denoised(&files).unwrap(), &one, "denoised");
    // Denoised or not, the raw image is the same.
    let raw = merge(&files);
    assert_eq!(raw.channel("G").unwrap(), one.channel("G").unwrap());
    for name in ["denoised.R", "denoised.G", "denoised.B", "error", "relative_error"] {
        let (got, expected) = (one.channel(name).unwrap(), usual.channel(name).unwrap());
        let size = expected.iter().map(|x| x.abs()).sum::<f32>() / expected.len() as f32;
        let difference = got.iter().zip(expected).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        // The means differ in their last bits, which the filter may double a few times.
        assert!(difference < 1e-4 * size, "{name}: {difference} of {size}");
    }
    // Pieces that cannot be denoised.
    let error = denoised(&files[1..]).unwrap_err().to_string();
    assert!(error.contains("lack samples"), "{error}");
    let plain = settings.clone().with(|s| (s.image.denoise, s.image.piece) = (Denoise::None, Some(all.0)));
    let error = denoised(&[render("still_life.glb", &plain, folder.path().join("plain.exr"))]).unwrap_err().to_string();
    assert!(error.contains("plain.exr: the pieces keep nothing for denoisers"), "{error}");
    let single = settings.with(|s| s.image.piece = Some(all.0));
    let error = renderer("still_life.glb", &single).denoised_image(&denoiser).unwrap_err().to_string();
    assert!(error.contains("`image.denoise` is for merged pieces"), "{error}");
}

/// A piece that is interrupted and resumed has the same bits.
#[test]
fn a_resumed_piece_has_the_same_bits() {
    let folder = tempfile::tempdir_in(env!("CARGO_TARGET_TMPDIR")).unwrap();
    let settings = settings(Technique::SHADOW_PHOTONS, 48).with(|s| {
        s.image.piece = Some(SampleRange { first: 29, end: 45 });
    });
    let whole = Image::read_exr(render("sphere.glb", &settings, folder.path().join("whole.exr"))).unwrap();
    let mut first = renderer("sphere.glb", &settings);
    while first.samples() < 5 {
        first.render_batch().unwrap();
    }
    let checkpoint = folder.path().join("checkpoint");
    first.save_checkpoint(&checkpoint).unwrap();
    drop(first);
    let mut second = renderer("sphere.glb", &settings);
    second.resume(&checkpoint).unwrap();
    while second.samples() < 16 {
        second.render_batch().unwrap();
    }
    // It has all its samples, so there are no others.
    assert_eq!(second.render_batch().unwrap().samples, 16);
    let resumed = folder.path().join("resumed.exr");
    second.image().unwrap().write_exr(&resumed).unwrap();
    assert_same(&Image::read_exr(resumed).unwrap(), &whole, "resumed");
}

/// The samples of a piece equal those of the render, except for what classes and photons learn, which changes noise
/// only.
#[test]
fn pieces_show_what_a_render_shows() {
    let folder = tempfile::tempdir_in(env!("CARGO_TARGET_TMPDIR")).unwrap();
    let settings = settings(Technique::PATH, 16);
    let mut renderer = renderer("box.glb", &settings);
    while renderer.samples() < 16 {
        renderer.render_batch().unwrap();
    }
    let usual = renderer.image().unwrap();
    let piece = settings.with(|s| s.image.piece = Some(SampleRange { first: 0, end: 16 }));
    let merged = merge(&[render("box.glb", &piece, folder.path().join("piece.exr"))]);
    for channel in &usual.channels {
        let got = merged.channel(&channel.name).unwrap();
        for (a, b) in got.iter().zip(&channel.samples) {
            // Sums of 16 numbers in f32 with compensation, and in a tree: the last bit of the mean. Variances are small
            // differences of large squares.
            let tolerance = if channel.name.starts_with("variance") { 1e-4 } else { 1e-6 };
            assert!((a - b).abs() <= tolerance * b.abs().max(1e-3), "{}: {a}, not {b}", channel.name);
        }
    }
}

fn error(files: &[&Path]) -> String {
    Pieces::open(files).unwrap_err().to_string()
}

/// Pieces that do not fit are named, with what is wrong.
#[test]
fn pieces_that_do_not_fit_are_named() {
    let folder = tempfile::tempdir_in(env!("CARGO_TARGET_TMPDIR")).unwrap();
    let file = |name: &str| folder.path().join(name);
    let piece = |scene: &str, first: u32, end: u32, name: &str, change: &dyn Fn(&mut Settings)| {
        let settings = settings(Technique::PATH, 8).with(|s| {
            s.image.piece = Some(SampleRange { first, end });
            s.image.crop = Some(Crop { x: 0, y: 0, width: 24, height: 12 });
            s.image.background = Background::Colour([1.0, 0.5, 0.25]);
            change(s);
        });
        render(scene, &settings, file(name))
    };
    let first = piece("box.glb", 0, 3, "first.exr", &|_| {});
    let last = piece("box.glb", 3, 8, "last.exr", &|_| {});
    let doubled = piece("box.glb", 2, 4, "doubled.exr", &|_| {});
    let scene = piece("sphere.glb", 3, 8, "scene.exr", &|_| {});
    let seed = piece("box.glb", 3, 8, "seed.exr", &|s| s.image.seed = 1);
    for (other, expected) in [
        (&scene, "scene.exr: the piece is of another scene or camera than"),
        (&seed, "seed.exr: the piece is of other settings (seed is 1, not 0) than"),
        (&doubled, "doubled.exr: the piece has samples 2..4 of the pixels 0,0,24,12, some of which"),
        (&first, "first.exr: the piece has samples 0..3 of the pixels 0,0,24,12, some of which"),
    ] {
        let error = error(&[&first, other]);
        assert!(error.contains(expected), "{error}");
    }
    // What is missing: samples, and pixels of the others.
    let pieces = Pieces::open(&[&last]).unwrap();
    let missing: Vec<String> = pieces.missing().iter().map(ToString::to_string).collect();
    assert_eq!(missing, ["samples 0..3 of the pixels 0,0,24,12", "samples 0..8 of the pixels 0,12,24,6"]);
    let partial = pieces.merge().unwrap();
    let shown = Image::read_exr(&last).unwrap();
    let channel = |image: &Image| image.channel("G").unwrap()[..24 * 12].to_vec();
    assert_eq!(channel(&partial), channel(&shown));
    // Pixels without samples show nothing, not even the background.
    for name in ["R", "A"] {
        assert_eq!(partial.channel(name).unwrap()[24 * 12..], [0.0; 24 * 6], "{name}");
    }
    assert!(Pieces::open(&[&first, &last]).unwrap().missing().len() == 1);
    // Another device, and another version.
    let elsewhere = file("elsewhere.exr");
    for (name, value, expected) in [
        ("device", "Other GPU (1.2)", "elsewhere.exr: the piece is of another device, Other GPU (1.2), than"),
        ("version", "9.9.9", "elsewhere.exr: the file was written by version 9.9.9"),
    ] {
        let mut image = Image::read_exr(&last).unwrap();
        let Some(Metadata::Text(text)) = image.metadata.get_mut("penumbra:piece") else { panic!("no description") };
        let mut description: serde_json::Value = serde_json::from_str(text).unwrap();
        description["whole"][name] = value.into();
        *text = description.to_string();
        image.write_exr(&elsewhere).unwrap();
        let error = error(&[&first, &elsewhere]);
        assert!(error.contains(expected), "{error}");
    }
    // Damage anywhere.
    let bytes = std::fs::read(&first).unwrap();
    let damaged = file("damaged.exr");
    for cut in [0, 100, bytes.len() / 2, bytes.len() - 1] {
        std::fs::write(&damaged, &bytes[..cut]).unwrap();
        let error = Pieces::open(&[&damaged]).and_then(|pieces| pieces.merge()).unwrap_err().to_string();
        assert!(error.contains("damaged.exr"), "{cut} bytes: {error}");
    }
    let mut image = Image::read_exr(&first).unwrap();
    image.channels.iter_mut().find(|c| c.name == "piece.0-2.direct.G").unwrap().samples[7] += 1e-3;
    image.write_exr(&damaged).unwrap();
    let error = Pieces::open(&[&damaged]).and_then(|pieces| pieces.merge()).unwrap_err().to_string();
    assert!(error.contains("damaged.exr: the file is damaged"), "{error}");
    image.metadata.remove("penumbra:piece");
    image.write_exr(&damaged).unwrap();
    let error = Pieces::open(&[&damaged]).unwrap_err().to_string();
    assert!(error.contains("damaged.exr: the file is not a piece"), "{error}");
}
