//! Each count of `conditioning` is positive for a scene that provokes it, and zero for an ordinary one.

use std::sync::Arc;

use glam::{DAffine3, DVec3};
use penumbra::internal::procedural::Role;
use penumbra::internal::render::film::Metadata;
use penumbra::internal::scene::{Material, Panorama};
use penumbra::internal::statistics::{Conditioning, NotFinite};
use penumbra::{Aov, Camera, Image, Renderer, Result, Scene, Settings, Statistics, Technique};

use crate::common::gpu;
use crate::meshes::{Corners, camera, cube, inside_out, scene, square, surface};
use crate::procedurals::{self, Object};

/// A closed room of the given albedo with a square lamp below its ceiling, and more meshes.
fn room(albedo: f32, radiance: f32, more: &[(Vec<Corners>, Material)]) -> Scene {
    let lamp = square(DVec3::new(0.0, 0.45, 0.0), DVec3::X * 0.15, DVec3::Z * 0.15);
    let walls = (inside_out(cube(DVec3::ZERO, 0.5)), surface(albedo, 0.0));
    scene(&[&[walls, (lamp, surface(0.0, radiance))], more].concat(), Vec::new())
}

fn view() -> Camera {
    // Wide enough to see the lamp.
    camera(DVec3::new(0.0, 0.0, 0.45), DVec3::NEG_Z, 1.7)
}

/// Fast settings: few photons, a small image.
fn settings(technique: Technique) -> Settings {
    let (photons, flux_photons) = (4096, 4096);
    Settings::default().with(|s| {
        s.technique = technique;
        s.visibility_map.photons_per_light = Some(photons);
        s.indirect.photons = Some(flux_photons);
        s.image.width = 24;
        s.image.height = 24;
        s.image.spp = 4;
    })
}

fn try_render(scene: Scene, settings: &Settings) -> Result<(Image, Statistics)> {
    let mut renderer = Renderer::new(gpu(), scene, &view(), settings)?;
    while renderer.samples() < settings.image.spp {
        renderer.render_batch()?;
    }
    Ok((renderer.image()?, renderer.statistics()?))
}

/// Renders and asserts that the image is finite. Returns the counts, the statistics, and the image's conditioning
/// metadata.
fn render(scene: Scene, settings: &Settings) -> (Conditioning, Statistics, Option<String>) {
    let (image, statistics) = try_render(scene, settings).unwrap();
    let finite = image.channels.iter().all(|channel| channel.samples.iter().all(|x| x.is_finite()));
    assert!(finite, "{settings:?}: the image has samples that are not finite");
    let said = image.metadata.get("penumbra:conditioning").map(|value| match value {
        Metadata::Text(text) => text.clone(),
        other => panic!("{other:?}"),
    });
    (statistics.conditioning, statistics, said)
}

/// Asserts that exactly one note contains `word`, and that the metadata state the count.
#[track_caller]
fn assert_reported(statistics: &Statistics, said: &Option<String>, name: &str, count: u64, word: &str) {
    let notes: Vec<_> = statistics.notes.iter().filter(|note| note.contains(word)).collect();
    assert_eq!(notes.len(), 1, "{word}: {:?}", statistics.notes);
    assert!(!notes[0].contains('\n'), "{notes:?}");
    let expected = format!("{name}={count}");
    let said = said.as_deref().unwrap_or("");
    assert!(said.split(' ').any(|word| word == expected), "{expected} is not in '{said}'");
}

/// An ordinary scene has no fault counts, no notes about them, and no such metadata, by any technique.
#[test]
fn an_ordinary_scene_has_no_faults() {
    for technique in Technique::all() {
        let settings = settings(technique).with(|s| s.image.aovs = Aov::ALL.to_vec());
        let (found, statistics, said) = render(room(0.7, 5.0, &[]), &settings);
        let Conditioning { unknown, min_radius_records, mean_bounces, .. } = found;
        let figures = Conditioning { unknown, min_radius_records, mean_bounces, ..Default::default() };
        assert_eq!(found, figures, "{technique}");
        assert_eq!((statistics.not_finite, said), (0, None), "{technique}");
        // Up to this share there is no note.
        assert!(found.unknown as f64 <= 0.1 * statistics.points.total as f64, "{technique}: {found:?}");
        assert!(found.min_radius_records <= statistics.indirect.records, "{technique}: {found:?}");
        let words = ["finite", "largest number", "too few photons", "weight", "loop budget", "lost"];
        let note = statistics.notes.iter().find(|note| words.iter().any(|word| note.contains(word)));
        assert_eq!(note, None, "{technique}");
    }
}

/// Invalid samples are dropped and counted by pass, and the rest of the image stays valid. The cube has an infinite
/// colour, the result of an overflow in f32.
#[test]
fn invalid_samples_are_dropped_and_counted_by_pass() {
    let cube = || cube(DVec3::new(0.0, -0.3, -0.1), 0.12);
    let infinite = || room(0.7, 5.0, &[(cube(), surface(f32::INFINITY, 0.0))]);
    let pass = |technique, max_bounces| {
        let (found, statistics, said) =
            render(infinite(), &settings(technique).with(|s| s.indirect.max_bounces = max_bounces));
        assert!(statistics.not_finite > 0, "{technique}: no sample was dropped");
        let all = u64::from(statistics.samples) * 24 * 24;
        assert!(statistics.not_finite < all, "{technique}: {} of {all} were dropped", statistics.not_finite);
        let count = statistics.not_finite.max(found.not_finite.total());
        assert_reported(&statistics, &said, "not_finite", count, "infinite or not a number");
        found.not_finite
    };
    let path = pass(Technique::PATH, 4);
    assert_eq!(path, NotFinite { path: path.path, ..NotFinite::default() });
    assert!(path.path > 0);
    let shade = pass(Technique::TWO_PASS, 0);
    assert_eq!(shade, NotFinite { shade: shade.shade, ..NotFinite::default() });
    assert!(shade.shade > 0);
    let all = pass(Technique::SHADOW_PHOTONS, 4);
    assert!(all.flux > 0 && all.gather > 0 && all.shade > 0 && all.primary == 0, "{all:?}");
    let shown = pass(Technique::PHOTON_MAP, 4);
    assert!(shown.irradiance > 0 && shown.flux > 0, "{shown:?}");

    let unlit = Material { unlit: true, ..surface(f32::INFINITY, 0.0) };
    let (found, ..) = render(room(0.7, 5.0, &[(cube(), unlit)]), &settings(Technique::PATH));
    let primary = found.not_finite;
    assert_eq!(primary, NotFinite { primary: primary.primary, ..NotFinite::default() });
    assert!(primary.primary > 0);
}

/// Sums beyond 2^104 = 2.03e31 are counted as near overflow. Pixels of a lamp of 1e31 reach that sum at the third
/// sample; those of a lamp of 1e30 do not in four samples.
#[test]
fn sums_near_overflow_are_counted() {
    let direct = settings(Technique::TWO_PASS).with(|s| s.indirect.max_bounces = 0);
    let (found, statistics, said) = render(room(0.0, 1e31, &[]), &direct);
    assert!(found.near_overflow > 0 && statistics.not_finite == 0, "{found:?}");
    assert_reported(&statistics, &said, "near_overflow", found.near_overflow, "`light_scale`");
    assert_eq!(render(room(0.0, 1e30, &[]), &direct).0, Conditioning::default());
    // The square of 1e30 overflows f32, so the variance would silently lack it.
    let variance = direct.with(|s| s.image.aovs = vec![Aov::Variance]);
    assert!(render(room(0.0, 1e30, &[]), &variance).0.near_overflow > 0);
}

/// A note reports missing photons if more than a tenth of the points are unknown.
#[test]
fn missing_photons_are_reported_above_a_tenth_of_the_points() {
    // The class channels keep the map whatever the pilot finds.
    let sparse = settings(Technique::SHADOW_PHOTONS).with(|s| {
        s.visibility_map.photons_per_light = Some(64);
        s.indirect.max_bounces = 0;
        s.image.aovs = vec![Aov::Shadow];
    });
    let (found, statistics, said) = render(room(0.7, 5.0, &[]), &sparse);
    assert_eq!(found.unknown, statistics.points.unknown);
    assert!(found.unknown as f64 > 0.1 * statistics.points.total as f64, "{found:?}");
    assert_reported(&statistics, &said, "unknown", found.unknown, "`visibility_map.photons_per_light`");
    // Without a map there are no classes.
    let (found, ..) = render(room(0.7, 5.0, &[]), &sparse.clone().with(|s| s.technique = Technique::TWO_PASS));
    assert_eq!(found.unknown, 0);
    // The environment's points have no photons, however many there are.
    let mut lit = room(0.7, 5.0, &[]);
    let panorama = Panorama { width: 1, height: 1, texels: vec![[1.0; 3]] };
    lit.set_environment(Arc::new(panorama), 0.0, 1.0).unwrap();
    let dense = sparse.clone().with(|s| s.visibility_map.photons_per_light = Some(100_000));
    let (found, statistics, _) = render(lit, &dense);
    let total = statistics.points.total as f64;
    // Each hit has a point for the environment, and one for the lamp unless it is dark: half of all or more.
    assert!(statistics.points.unknown as f64 > 0.4 * total, "the environment is not counted: {:?}", statistics.points);
    assert!((found.unknown as f64) < 0.01 * total, "{found:?}");
    // A map that is full needs no advice on more of them.
    let full = sparse.with(|s| s.visibility_map.photons_per_light = Some(1 << 23));
    let notes = render(room(0.7, 5.0, &[]), &full).1.notes;
    assert!(notes.iter().any(|note| note.contains("4194304 visibility photons, not 8388608")), "{notes:?}");
}

/// Records of the minimum radius are counted, but not reported as a fault.
#[test]
fn records_of_the_minimum_radius_are_counted() {
    let (found, statistics, said) = render(room(0.7, 5.0, &[]), &settings(Technique::TWO_PASS));
    assert!(found.min_radius_records > 0 && found.min_radius_records < statistics.indirect.records, "{found:?}");
    assert_eq!(said, None);
}

/// Paths whose weight exceeds 8 are counted as heavy. At an albedo of 1.5 the weight is above 8 after six bounces, so
/// all paths of eight bounces are heavy, except for those that hit the lamp. At an albedo of 1 none is.
#[test]
fn heavy_paths_are_counted() {
    let settings = settings(Technique::PATH).with(|s| s.indirect.max_bounces = 8);
    let (found, statistics, said) = render(room(1.5, 5.0, &[]), &settings);
    let paths = u64::from(statistics.samples) * 24 * 24;
    assert!((paths / 2..=paths).contains(&found.heavy_paths), "{found:?}");
    assert_reported(&statistics, &said, "heavy_paths", found.heavy_paths, "weight");
    let all = settings.with(|s| s.indirect.max_bounces = 64);
    assert_eq!(render(room(1.0, 5.0, &[]), &all).0.heavy_paths, 0);
}

/// A note reports light that is lost to the limit on bounces. In a closed room light bounces 1 / (1 - albedo) times.
/// After 64 bounces 14 % of it remain at an albedo of 0.97, and a thousandth at 0.9.
#[test]
fn light_lost_to_the_bounce_limit_is_reported() {
    for technique in [Technique::PATH, Technique::SHADOW_PHOTONS] {
        let (found, statistics, said) = render(room(0.97, 5.0, &[]), &settings(technique));
        // The lamp reflects nothing and is a twentieth of the surfaces that light hits: an effective albedo of 0.97 x
        // 0.95.
        assert!((10..=33).contains(&found.mean_bounces), "{technique}: {found:?}");
        assert_reported(&statistics, &said, "mean_bounces", found.mean_bounces, "`indirect.max_bounces` 64");
        // No note if the limit is high enough, or was set low on purpose.
        for max_bounces in [512, 8] {
            let (_, _, said) =
                render(room(0.97, 5.0, &[]), &settings(technique).with(|s| s.indirect.max_bounces = max_bounces));
            assert_eq!(said, None, "{technique}: {max_bounces}");
        }
    }
}

/// Rays that exceed the loop budget of traversal are dropped and reported, or end the render if they are many. 70,000
/// coincident triangles exceed the budget. As a small spot they cost some samples; as a large one they prevent an
/// image.
#[test]
fn rays_beyond_the_loop_budget_are_dropped_or_end_the_render() {
    let stack = |half: f64| {
        let layer = square(DVec3::new(0.0, 0.0, -0.2), DVec3::X * half, DVec3::Y * half);
        room(0.7, 5.0, &[(layer.iter().copied().cycle().take(70_000).collect(), surface(0.5, 0.0))])
    };
    // A pixel covers 0.023 at that distance. The spot is smaller than one of the 64 x 64 pixels, and few other rays hit
    // it; with such a ray the other seven of its packet are dropped.
    let spot = settings(Technique::PATH).with(|s| {
        s.image.width = 64;
        s.image.height = 64;
        s.image.spp = 8;
        s.indirect.max_bounces = 1;
    });
    let (found, statistics, said) = render(stack(0.006), &spot);
    assert!(found.overruns > 0 && statistics.not_finite >= found.overruns, "{found:?}");
    assert_eq!(found.not_finite.total(), 0, "{found:?}");
    assert_reported(&statistics, &said, "overruns", found.overruns, "loop budget");
    let error = try_render(stack(0.2), &spot).unwrap_err();
    assert_eq!(error.exit_code(), 1, "{error}");
    assert!(error.to_string().contains("loop budget"), "{error}");
}

/// Photon rays continue through all surfaces, so a pile of 35,000 sheets exceeds their loop budget, but not that of
/// other rays. Where no photons are stored, points trace shadow rays: the image is right, and the render continues.
#[test]
fn photons_beyond_the_loop_budget_end_no_render() {
    let sheet = |i: u32| square(DVec3::Y * (1e-6 * f64::from(i) - 0.2), DVec3::Z * 0.2, DVec3::X * 0.2);
    let pile: Vec<_> = (0..35_000).flat_map(sheet).collect();
    let mean = |technique| {
        let settings = settings(technique).with(|s| {
            s.visibility_map.photons_per_light = Some(8192);
            s.indirect.max_bounces = 0;
            s.image.spp = 32;
        });
        let scene = room(0.7, 5.0, &[(pile.clone(), surface(0.5, 0.0))]);
        let (image, statistics) = try_render(scene, &settings).unwrap();
        let samples = image.channel("G").unwrap();
        let mean = samples.iter().map(|x| f64::from(*x)).sum::<f64>() / samples.len() as f64;
        (mean, statistics.conditioning.overruns)
    };
    let ((all, none), (some, overruns)) = (mean(Technique::TWO_PASS), mean(Technique::SHADOW_PHOTONS));
    assert_eq!(none, 0);
    assert!(overruns > 100, "{overruns} rays are no test");
    assert!((some - all).abs() < 0.02 * all, "{some} with photons, {all} with all shadow rays");
}

/// Failures of procedural functions are counted and reported: functions that never return, and functions that return
/// NaN. Rays pass through such objects and the image stays valid. A correct function has no failures.
#[test]
fn failing_procedural_objects_are_counted() {
    let with = |body: &str| {
        let mut scene = room(0.7, 5.0, &[]);
        let source = format!("fn f(position: vec3f, parameters: vec4f) -> f32 {{ {body} }}");
        let world = DAffine3::from_scale(DVec3::splat(0.1));
        let (role, material) = (Role::Distance, surface(0.5, 0.0));
        let object = Object { source: &source, function: "f", role, parameter: 1.0, world, material };
        procedurals::place(&mut scene, &[object]);
        scene
    };
    for technique in [Technique::PATH, Technique::SHADOW_PHOTONS, Technique::PHOTON_MAP] {
        // Each ray takes 4096 iterations. With many rays or bounces they would exceed the budget of a path.
        let (photons, flux_photons, gather_rays) = (64, 64, 16);
        let settings = settings(technique).with(|s| {
            s.indirect.max_bounces = 1;
            s.visibility_map.photons_per_light = Some(photons);
            s.indirect.photons = Some(flux_photons);
            s.indirect.irradiance_cache.gather_rays = Some(gather_rays);
            s.image.spp = 1;
        });
        let (found, statistics, said) = render(with("loop {} return 1.0;"), &settings);
        let count = found.procedural_overruns;
        assert!(count > 0 && found.procedural_invalid == 0 && statistics.not_finite == 0, "{technique}: {found:?}");
        assert_reported(&statistics, &said, "procedural_overruns", count, "iterations in a procedural object");
    }
    let (found, statistics, said) =
        render(with("return sqrt(-1.0 - parameters.x);"), &settings(Technique::SHADOW_PHOTONS));
    assert!(found.procedural_invalid > 0 && found.procedural_overruns == 0, "{found:?}");
    assert_reported(
        &statistics,
        &said,
        "procedural_invalid",
        found.procedural_invalid,
        "results of procedural objects",
    );
    let (found, ..) = render(with("return length(position) - parameters.x;"), &settings(Technique::SHADOW_PHOTONS));
    assert_eq!((found.procedural_overruns, found.procedural_invalid), (0, 0));
}
