//! Denoised images of whole renders, and the error that they state.

use std::sync::Arc;

use glam::{DVec3, Vec4};
use penumbra::internal::render::pieces::Pieces;
use penumbra::internal::scene::{ImportOptions, Material, Panorama};
use penumbra::settings::{Background, Denoise, SampleRange};
use penumbra::{Aov, Denoiser, Image, Renderer, Scene, Settings, Technique};

use crate::meshes::{camera, panorama, scene, sphere, square, surface};
use crate::setup::{gpu, scene_file};

const SIDE: u32 = 48;

fn settings(spp: u32, seed: u32) -> Settings {
    Settings::default().with(|s| {
        s.technique = Technique::PATH;
        (s.image.width, s.image.height) = (SIDE, SIDE);
        (s.image.spp, s.image.seed) = (spp, seed);
        s.image.aovs = vec![Aov::Depth];
        s.image.denoise = Denoise::Statistical;
    })
}

/// A ball in front of a panorama.
fn ball(base_colour: Vec4, sky: &Panorama) -> Scene {
    let material = Material { base_colour, ..surface(0.5, 0.0) };
    let floor = square(DVec3::Y * -0.3, DVec3::Z * 0.3, DVec3::X * 0.3);
    let mut scene = scene(&[(sphere(DVec3::ZERO, 0.3, 24), material.clone()), (floor, material)], Vec::new());
    scene.set_environment(Arc::new(sky.clone()), 0.0, 1.0).unwrap();
    scene
}

fn renderer(scene: Scene, settings: &Settings) -> Renderer<'static> {
    let view = camera(DVec3::new(0.0, 0.2, 1.2), DVec3::new(0.0, -0.2, -1.2), 0.8);
    Renderer::new(gpu(), scene, &view, settings).unwrap()
}

fn filter() -> Denoiser {
    Denoiser::new(Denoise::Statistical, None).unwrap()
}

fn denoised(scene: Scene, settings: &Settings) -> Image {
    let mut renderer = renderer(scene, settings);
    while renderer.samples() < settings.image.spp {
        renderer.render_batch().unwrap();
    }
    renderer.denoised_image(&filter()).unwrap()
}

/// Stars are no fireflies: a single sample of the sky has no noise, so the filter leaves it as it is. It also leaves
/// the sky of merged pieces, which has several samples.
#[test]
fn the_sky_is_not_filtered() {
    let stars = panorama(256, 128, |d| {
        let bits = (d * 1e4).abs().element_sum() as u32;
        DVec3::splat(if bits.is_multiple_of(31) { 3.0 } else { 0.02 })
    });
    let scene = || ball(Vec4::splat(0.5).with_w(1.0), &stars);
    let folder = tempfile::tempdir_in(env!("CARGO_TARGET_TMPDIR")).unwrap();
    let pieces = [0, 4].map(|first| {
        let settings = settings(8, 0).with(|s| s.image.piece = Some(SampleRange { first, end: first + 4 }));
        let mut renderer = renderer(scene(), &settings);
        while renderer.samples() < 4 {
            renderer.render_batch().unwrap();
        }
        let file = folder.path().join(format!("{first}.exr"));
        renderer.image().unwrap().write_exr(&file).unwrap();
        file
    });
    let merged = Pieces::open(&pieces).unwrap().merge_denoised(gpu(), &filter()).unwrap();
    for (what, image) in [("of a render", denoised(scene(), &settings(1, 0))), ("of pieces", merged)] {
        let channel = |name: &str| image.channel(name).unwrap();
        let is_sky: Vec<bool> = channel("Z").iter().map(|z| *z >= 1e10).collect();
        let of = |name: &str, of_sky: bool| -> Vec<f32> {
            channel(name).iter().zip(&is_sky).filter(|(_, is_sky)| **is_sky == of_sky).map(|(x, _)| *x).collect()
        };
        assert!(of("G", true).iter().filter(|x| **x > 1.0).count() > 10, "there are no stars in the view {what}");
        assert_eq!(of("denoised.G", true), of("G", true), "{what}");
        assert_ne!(of("denoised.G", false), of("G", false), "the ball {what} is not filtered");
    }
}

/// Root mean squares of the stated and of the true error before `background`, over the pixels that `is_counted` picks
/// by the share of their rays that meet the scene.
fn errors(scene: impl Fn() -> Scene, background: Background, is_counted: fn(f32) -> bool) -> [f64; 2] {
    let before = |background, spp, seed| settings(spp, seed).with(|s| s.image.background = background);
    let coverage = denoised(scene(), &before(Background::Transparent, 256, 101));
    let coverage = coverage.channel("A").unwrap();
    let reference = denoised(scene(), &before(background, 512, 100));
    let mut squares = [0.0; 2];
    let mut count = 0;
    for seed in 0..4 {
        let image = denoised(scene(), &before(background, 8, seed));
        for i in (0..image.pixels()).filter(|i| is_counted(coverage[*i])) {
            let off = ["R", "G", "B"].map(|name| {
                let found = image.channel(&format!("denoised.{name}")).unwrap()[i];
                f64::from(found - reference.channel(name).unwrap()[i]).powi(2)
            });
            squares[0] += f64::from(image.channel("error").unwrap()[i]).powi(2);
            squares[1] += off.iter().sum::<f64>() / 3.0;
            count += 1;
        }
    }
    assert!(count > 100, "{count} pixels");
    squares.map(|sum| (sum / f64::from(count)).sqrt())
}

/// At a silhouette before a bright background, chance decides how much of it a pixel shows.
#[test]
fn the_error_of_a_silhouette_includes_the_background() {
    let sky = panorama(8, 4, |_| DVec3::ONE);
    let grey = || ball(Vec4::new(0.1, 0.1, 0.1, 1.0), &sky);
    let [stated, found] = errors(grey, Background::Colour([3.0; 3]), |coverage| coverage > 0.02 && coverage < 0.98);
    println!("stated {stated}, found {found}");
    assert!((0.65..1.6).contains(&(stated / found)), "{stated} for {found}");
}

/// Samples share irradiance records, so their halves do not show the records' error: on the walls of the box, far from
/// its lamp, there is hardly any other.
#[test]
fn the_error_of_irradiance_records_is_stated() {
    let of = |spp, seed| {
        settings(spp, seed).with(|s| {
            s.technique = Technique::TWO_PASS;
            (s.image.width, s.image.height) = (64, 64);
        })
    };
    let render = |settings: &Settings| {
        let scene = Scene::load(scene_file("box.glb"), &ImportOptions::default()).unwrap();
        let camera = scene.cameras[0].clone();
        let mut renderer = Renderer::new(gpu(), scene, &camera, settings).unwrap();
        while renderer.samples() < settings.image.spp {
            renderer.render_batch().unwrap();
        }
        renderer.denoised_image(&filter()).unwrap()
    };
    let reference = render(&of(512, 100));
    let wall = || (20..40).flat_map(|y| (4..14).map(move |x| y * 64 + x));
    let (mut stated, mut found) = (0.0, 0.0);
    for seed in 0..4 {
        let image = render(&of(16, seed));
        for i in wall() {
            stated += f64::from(image.channel("relative_error").unwrap()[i]).powi(2);
            found += ["R", "G", "B"]
                .map(|name| {
                    let (x, r) =
                        (image.channel(&format!("denoised.{name}")).unwrap()[i], reference.channel(name).unwrap()[i]);
                    f64::from(x - r).powi(2) / (f64::from(r).powi(2) + 0.01)
                })
                .iter()
                .sum::<f64>()
                / 3.0;
        }
    }
    let ratio = (stated / found).sqrt();
    println!("{ratio} of {}", (found / 800.0).sqrt());
    assert!((0.6..1.7).contains(&ratio), "{ratio}");
}
