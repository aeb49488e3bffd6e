//! Each count of `conditioning` is made by a scene that asks for it, and is zero in a scene that does not.

use glam::{DAffine3, DVec3};
use penumbra::internal::procedural::Role;
use penumbra::internal::render::film::Metadata;
use penumbra::internal::scene::Material;
use penumbra::internal::statistics::{Conditioning, NotFinite};
use penumbra::{Aov, Camera, Image, Renderer, Result, Scene, Settings, Statistics, Technique};

use crate::common::gpu;
use crate::meshes::{Corners, camera, cube, inside_out, scene, square, surface};
use crate::procedurals::{self, Object};

/// A closed room of that albedo, a square lamp under its ceiling, and whatever else.
fn room(albedo: f32, radiance: f32, more: &[(Vec<Corners>, Material)]) -> Scene {
    let lamp = square(DVec3::new(0.0, 0.45, 0.0), DVec3::X * 0.15, DVec3::Z * 0.15);
    let walls = (inside_out(cube(DVec3::ZERO, 0.5)), surface(albedo, 0.0));
    scene(&[&[walls, (lamp, surface(0.0, radiance))], more].concat(), Vec::new())
}

fn view() -> Camera {
    // Wide enough for the lamp.
    camera(DVec3::new(0.0, 0.0, 0.45), DVec3::NEG_Z, 1.7)
}

/// Settings that are quick: few photons, a small image.
fn settings(technique: Technique) -> Settings {
    let (photons, flux_photons) = (4096, 4096);
    Settings::default().with(|s| {
        s.technique = technique;
        s.visibility_map.photons_per_light = photons;
        s.indirect.photons = flux_photons;
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

/// Renders, and checks what holds of every image.
fn render(scene: Scene, settings: &Settings) -> (Conditioning, Statistics, Option<String>) {
    let (image, statistics) = try_render(scene, settings).unwrap();
    let finite = image.channels.iter().all(|channel| channel.samples.iter().all(|x| x.is_finite()));
    assert!(finite, "{settings:?}: the image has numbers that are none");
    let said = image.metadata.get("penumbra:conditioning").map(|value| match value {
        Metadata::Text(text) => text.clone(),
        other => panic!("{other:?}"),
    });
    (statistics.conditioning, statistics, said)
}

/// One note that says `word`, and the metadata's name and number.
#[track_caller]
fn assert_told(statistics: &Statistics, said: &Option<String>, name: &str, count: u64, word: &str) {
    let told: Vec<_> = statistics.notes.iter().filter(|note| note.contains(word)).collect();
    assert_eq!(told.len(), 1, "{word}: {:?}", statistics.notes);
    assert!(!told[0].contains('\n'), "{told:?}");
    let expected = format!("{name}={count}");
    let said = said.as_deref().unwrap_or("");
    assert!(said.split(' ').any(|word| word == expected), "{expected} is not in '{said}'");
}

#[test]
fn an_ordinary_scene_says_nothing() {
    for technique in Technique::ALL {
        let settings = settings(technique).with(|s| s.image.aovs = Aov::ALL.to_vec());
        let (found, statistics, said) = render(room(0.7, 5.0, &[]), &settings);
        let Conditioning { unknown, least_records, mean_bounces, .. } = found;
        let figures = Conditioning { unknown, least_records, mean_bounces, ..Default::default() };
        assert_eq!(found, figures, "{technique}");
        assert_eq!((statistics.not_finite, said), (0, None), "{technique}");
        assert!(found.unknown as f64 <= 0.1 * statistics.points.total as f64, "{technique}: {found:?}");
        assert!(found.least_records <= statistics.indirect.records, "{technique}: {found:?}");
        let told = ["finite", "largest number", "too few photons", "weight", "loop budget", "lost"];
        let note = statistics.notes.iter().find(|note| told.iter().any(|word| note.contains(word)));
        assert_eq!(note, None, "{technique}");
    }
}

/// A cube whose colour is infinite, as arithmetic beyond f32 leaves it: each pass counts what it makes of it, the
/// samples that see it are left out, and the rest of the image stands.
#[test]
fn numbers_that_are_none_are_left_out_and_counted_by_pass() {
    let cube = || cube(DVec3::new(0.0, -0.3, -0.1), 0.12);
    let endless = || room(0.7, 5.0, &[(cube(), surface(f32::INFINITY, 0.0))]);
    let pass = |technique, max_bounces| {
        let (found, statistics, said) =
            render(endless(), &settings(technique).with(|s| s.indirect.max_bounces = max_bounces));
        assert!(statistics.not_finite > 0, "{technique}: nothing was left out");
        let all = u64::from(statistics.samples) * 24 * 24;
        assert!(statistics.not_finite < all, "{technique}: {} of {all} were left out", statistics.not_finite);
        let count = statistics.not_finite.max(found.not_finite.total());
        assert_told(&statistics, &said, "not_finite", count, "not finite");
        found.not_finite
    };
    let path = pass(Technique::Path, 4);
    assert_eq!(path, NotFinite { path: path.path, ..NotFinite::default() });
    assert!(path.path > 0);
    let shade = pass(Technique::TwoPass, 0);
    assert_eq!(shade, NotFinite { shade: shade.shade, ..NotFinite::default() });
    assert!(shade.shade > 0);
    let all = pass(Technique::ShadowPhotons, 4);
    assert!(all.flux > 0 && all.gather > 0 && all.shade > 0 && all.primary == 0, "{all:?}");
    let shown = pass(Technique::PhotonMap, 4);
    assert!(shown.irradiance > 0 && shown.flux > 0, "{shown:?}");

    let unlit = Material { unlit: true, ..surface(f32::INFINITY, 0.0) };
    let (found, ..) = render(room(0.7, 5.0, &[(cube(), unlit)]), &settings(Technique::Path));
    let primary = found.not_finite;
    assert_eq!(primary, NotFinite { primary: primary.primary, ..NotFinite::default() });
    assert!(primary.primary > 0);
}

/// 2^104 is 2.03e31: a lamp of 1e31 that is seen comes to it at the third sample, one of 1e30 does not in four.
#[test]
fn sums_near_overflow_are_counted() {
    let direct = settings(Technique::TwoPass).with(|s| s.indirect.max_bounces = 0);
    let (found, statistics, said) = render(room(0.0, 1e31, &[]), &direct);
    assert!(found.near_overflow > 0 && statistics.not_finite == 0, "{found:?}");
    assert_told(&statistics, &said, "near_overflow", found.near_overflow, "`light_scale`");
    assert_eq!(render(room(0.0, 1e30, &[]), &direct).0, Conditioning::default());
    // Its square is beyond f32, and the variance would lack it in silence.
    let variance = direct.with(|s| s.image.aovs = vec![Aov::Variance]);
    assert!(render(room(0.0, 1e30, &[]), &variance).0.near_overflow > 0);
}

#[test]
fn want_of_photons_is_told_above_a_tenth_of_the_points() {
    // The map is kept whatever the pilot says where its classes are asked for.
    let asked = settings(Technique::ShadowPhotons).with(|s| {
        s.visibility_map.photons_per_light = 64;
        s.indirect.max_bounces = 0;
        s.image.aovs = vec![Aov::Shadow];
    });
    let (found, statistics, said) = render(room(0.7, 5.0, &[]), &asked);
    assert_eq!(found.unknown, statistics.points.unknown);
    assert!(found.unknown as f64 > 0.1 * statistics.points.total as f64, "{found:?}");
    assert_told(&statistics, &said, "unknown", found.unknown, "`visibility_map.photons_per_light`");
    // Without a map nothing is asked of photons.
    let (found, ..) = render(room(0.7, 5.0, &[]), &asked.with(|s| s.technique = Technique::TwoPass));
    assert_eq!(found.unknown, 0);
}

#[test]
fn records_of_the_least_radius_are_a_figure() {
    let (found, statistics, said) = render(room(0.7, 5.0, &[]), &settings(Technique::TwoPass));
    assert!(found.least_records > 0 && found.least_records < statistics.indirect.records, "{found:?}");
    assert_eq!(said, None);
}

/// Walls that reflect half as much again as they get: 1.5^6 is more than 8, so that all paths of eight bounces are heavy but those
/// that meet the lamp. Where surfaces reflect all that they get, none is.
#[test]
fn heavy_paths_are_counted() {
    let settings = settings(Technique::Path).with(|s| s.indirect.max_bounces = 8);
    let (found, statistics, said) = render(room(1.5, 5.0, &[]), &settings);
    let paths = u64::from(statistics.samples) * 24 * 24;
    assert!((paths / 2..=paths).contains(&found.heavy_paths), "{found:?}");
    assert_told(&statistics, &said, "heavy_paths", found.heavy_paths, "weight");
    let all = settings.with(|s| s.indirect.max_bounces = 64);
    assert_eq!(render(room(1.0, 5.0, &[]), &all).0.heavy_paths, 0);
}

/// A closed room in which light bounces 1 / (1 - albedo) times: at 0.97 of it 14 % is left after 64 bounces, at 0.9 a thousandth.
#[test]
fn light_that_bounces_on_is_told() {
    for technique in [Technique::Path, Technique::ShadowPhotons] {
        let (found, statistics, said) = render(room(0.97, 5.0, &[]), &settings(technique));
        // The lamp, which reflects nothing, is a twentieth of what light meets: 0.97 of 0.95.
        assert!((10..=33).contains(&found.mean_bounces), "{technique}: {found:?}");
        assert_told(&statistics, &said, "mean_bounces", found.mean_bounces, "`indirect.max_bounces` 64");
        // Enough of them, or knowingly few.
        for max_bounces in [512, 8] {
            let (_, _, said) =
                render(room(0.97, 5.0, &[]), &settings(technique).with(|s| s.indirect.max_bounces = max_bounces));
            assert_eq!(said, None, "{technique}: {max_bounces}");
        }
    }
}

/// 70,000 triangles in one place take more turns than a device may have. A spot of them costs some samples and a note; where
/// they are in everyone's way, there is no image.
#[test]
fn rays_that_meet_the_loop_budget_are_left_out_or_end_the_render() {
    let stack = |half: f64| {
        let layer = square(DVec3::new(0.0, 0.0, -0.2), DVec3::X * half, DVec3::Y * half);
        room(0.7, 5.0, &[(layer.iter().copied().cycle().take(70_000).collect(), surface(0.5, 0.0))])
    };
    // The size of a pixel at that distance is 0.03: a spot that is less than one in 48 x 48, and that few other rays meet.
    let spot = settings(Technique::Path).with(|s| {
        s.image.width = 48;
        s.image.height = 48;
        s.image.spp = 8;
        s.indirect.max_bounces = 1;
    });
    let (found, statistics, said) = render(stack(0.006), &spot);
    assert!(found.overruns > 0 && statistics.not_finite >= found.overruns, "{found:?}");
    assert_eq!(found.not_finite.total(), 0, "{found:?}");
    assert_told(&statistics, &said, "overruns", found.overruns, "loop budget");
    let error = try_render(stack(0.2), &spot).unwrap_err();
    assert_eq!(error.exit_code(), 1, "{error}");
    assert!(error.to_string().contains("loop budget"), "{error}");
}

/// A function that never ends, and one that has no answer: rays pass through, the image stands, and it is said how
/// often. One that is as it should be says nothing.
#[test]
fn procedural_objects_that_fail_are_counted() {
    let with = |body: &str| {
        let mut scene = room(0.7, 5.0, &[]);
        let source = format!("fn f(position: vec3f, parameters: vec4f) -> f32 {{ {body} }}");
        let world = DAffine3::from_scale(DVec3::splat(0.1));
        let (role, material) = (Role::Distance, surface(0.5, 0.0));
        let object = Object { source: &source, function: "f", role, parameter: 1.0, world, material };
        procedurals::place(&mut scene, &[object]);
        scene
    };
    for technique in [Technique::Path, Technique::ShadowPhotons, Technique::PhotonMap] {
        // Each ray takes 4096 turns: few rays, and few bounces, as the turns of a path would be too many.
        let (photons, flux_photons, gather_rays) = (64, 64, 16);
        let settings = settings(technique).with(|s| {
            s.indirect.max_bounces = 1;
            s.visibility_map.photons_per_light = photons;
            s.indirect.photons = flux_photons;
            s.indirect.irradiance_cache.gather_rays = gather_rays;
            s.image.spp = 1;
        });
        let (found, statistics, said) = render(with("loop {} return 1.0;"), &settings);
        let count = found.procedural_overruns;
        assert!(count > 0 && found.procedural_nonsense == 0 && statistics.not_finite == 0, "{technique}: {found:?}");
        assert_told(&statistics, &said, "procedural_overruns", count, "turns in a procedural object");
    }
    let (found, statistics, said) =
        render(with("return sqrt(-1.0 - parameters.x);"), &settings(Technique::ShadowPhotons));
    assert!(found.procedural_nonsense > 0 && found.procedural_overruns == 0, "{found:?}");
    assert_told(&statistics, &said, "procedural_nonsense", found.procedural_nonsense, "answers of procedural objects");
    let (found, ..) = render(with("return length(position) - parameters.x;"), &settings(Technique::ShadowPhotons));
    assert_eq!((found.procedural_overruns, found.procedural_nonsense), (0, 0));
}
