//! Light sampling: a few of many lights at each point give the same image from a fraction of the rays.

use glam::{DVec3, Vec3};
use penumbra::internal::scene::{LightKind, Scene};
use penumbra::settings::LightSampling;
use penumbra::{Aov, Camera, Image, Settings, Statistics, Technique};

use crate::meshes::{camera, cube, inside_out, scene, square, surface};
use crate::setup::{deviation, mean_and_error, render_scene};

/// Four rooms under `lights` point lights and a square one, the strongest a hundred times the weakest.
fn rooms(lights: u32) -> (Scene, Camera) {
    let wall = |across: DVec3| {
        let slab = cube(DVec3::ZERO, 0.5);
        let shape = DVec3::new(0.02, 0.8, 0.9) * across.x + DVec3::new(0.9, 0.8, 0.02) * across.z;
        slab.iter().map(|corners| corners.map(|p| p * shape + DVec3::new(0.0, -0.1, -0.05))).collect::<Vec<_>>()
    };
    let lamp = |i: u32| {
        let at = |step: f64| (f64::from(i) * step).fract() * 0.94 - 0.47;
        // Irrational steps avoid rows of lights.
        let position =
            DVec3::new(at(0.754_877_666), -0.2 + 0.3 * (at(0.381_966_011) + 0.5), at(0.569_840_291)).as_vec3();
        let intensity = Vec3::splat(2.0 / lights as f32 * 0.01f32.powf((i * 29 % lights) as f32 / lights as f32));
        LightKind::Point { position, intensity, range: f32::INFINITY }
    };
    let meshes = [
        (inside_out(cube(DVec3::ZERO, 0.5)), surface(0.7, 0.0)),
        ([wall(DVec3::X), wall(DVec3::Z)].concat(), surface(0.5, 0.0)),
        (square(DVec3::new(0.2, 0.0, 0.2), DVec3::X * 0.05, DVec3::Z * 0.05), surface(0.0, 1.0)),
    ];
    let view = camera(DVec3::new(0.1, 0.45, 0.4), DVec3::new(-0.15, -0.9, -0.6), 1.6);
    (scene(&meshes, (0..lights).map(lamp).collect()), view)
}

fn render(lights: u32, changed: impl Fn(Settings) -> Settings) -> (Image, Statistics) {
    let (scene, view) = rooms(lights);
    let settings = Settings::default().with(|s| {
        s.image.width = 32;
        s.image.height = 32;
        s.indirect.max_bounces = 0;
        s.visibility_map.photons_per_light = Some(2000);
        s.image.aovs = vec![Aov::Variance];
    });
    render_scene(scene, &view, &changed(settings))
}

fn has(statistics: &Statistics, part: &str) -> bool {
    statistics.kept.iter().any(|kept| kept == part)
}

/// Light sampling is unbiased: by zones, by power and uniformly it gives the image of all lights. Zones are unbiased
/// even if most lights have no photon, as long as they are audited. Without audits the light of those lights is
/// missing, which is detected.
#[test]
fn sampled_lights_give_all_light() {
    let settings = |spp, seed| {
        move |settings: Settings| {
            settings.with(|s| {
                s.image.spp = spp;
                s.image.seed = seed;
            })
        }
    };
    let all = render(200, |s| settings(8, 1)(s).with(|s| s.technique = Technique::TWO_PASS));
    assert!(!has(&all.1, "light_sampling"));
    let truth = mean_and_error(&all.0, "G");
    println!("all lights: {truth:?}, {} rays", all.1.rays.shadow);
    let of = |what: &str, image: &(Image, Statistics)| {
        let found = mean_and_error(&image.0, "G");
        let off = deviation(found, truth);
        println!(
            "{what}: {found:?}, {off} standard errors off, {} rays, kept {}",
            image.1.rays.shadow,
            image.1.kept.join(" ")
        );
        (found, off)
    };

    let zones = render(200, settings(32, 2));
    assert!(has(&zones.1, "zones") && has(&zones.1, "light_sampling"));
    let (found, off) = of("zones", &zones);
    // By chance, 3.5 standard errors are exceeded once in 2,000 times. With errors of at most 2 %, a tenth of the light
    // could not be missing.
    assert!(off < 3.5 && found.1 < 0.02 * found.0, "zones: {off}");
    // Per sample: eight of 201 lights.
    assert!(zones.1.rays.shadow / 32 < all.1.rays.shadow / 8 / 10, "{} rays", zones.1.rays.shadow);

    for sampling in [LightSampling::Power, LightSampling::Uniform] {
        let some = render(200, |s| settings(32, 3)(s).with(|s| s.light_sampling.strategy = Some(sampling)));
        let ((_, error), off) = of(sampling.name(), &some);
        assert!(off < 3.5, "{sampling}: {off}");
        assert!(error > 2.0 * found.1, "{sampling} is no noisier than zones: {error}");
        let paths = render(200, |s| {
            settings(64, 3)(s).with(|s| {
                s.technique = Technique::PATH;
                s.light_sampling.strategy = Some(sampling);
            })
        });
        let (_, off) = of("path", &paths);
        assert!(off < 3.5, "path, {sampling}: {off}");
    }

    // The sampling of Shirley, Wang and Zimmerman: one light by its contribution, one point of it, one ray.
    for (lights, samples) in [(8, 4), (1, 1)] {
        let some = render(200, |s| {
            settings(64, 5)(s).with(|s| {
                s.technique = Technique::TWO_PASS;
                s.light_sampling.strategy = Some(LightSampling::Contribution);
                s.light_sampling.sampled_lights = lights;
                s.shadow_rays.samples = samples;
            })
        });
        assert!(has(&some.1, "contribution_sampling"));
        let what = format!("{lights} by contribution");
        // A two-sided z-test of the means. An error of a fifth would be detected.
        let ((mean, error), off) = of(&what, &some);
        assert!(off < 3.5 && error < 0.05 * mean, "{what}: {off}");
        assert!(some.1.rays.shadow <= u64::from(lights * samples) * some.1.rays.camera, "{}", some.1.rays.shadow);
    }

    // One photon ray from each light; zones list 64 lights.
    let one_photon = |audit| {
        render(200, |s| {
            settings(32, 4)(s).with(|s| {
                s.visibility_map.photons_per_light = Some(1);
                s.visibility_map.audit = audit;
            })
        })
    };
    let (_, off) = of("one photon, audited", &one_photon(Settings::default().visibility_map.audit));
    assert!(off < 3.5, "one photon, audited: {off}");
    let ((mean, _), off) = of("one photon, not audited", &one_photon(0.0));
    assert!(off > 10.0 && mean < truth.0, "the light of lights outside the zones is not missing: {off}");
}

/// If there are more lights than a photon's light index can hold, lights are sampled by power, without bias.
#[test]
fn more_lights_than_photons_can_index_are_sampled_by_power() {
    let small = |settings: Settings| {
        settings.with(|s| {
            s.image.width = 12;
            s.image.height = 12;
        })
    };
    let all = render(2100, |s| {
        small(s).with(|s| {
            s.technique = Technique::TWO_PASS;
            s.image.spp = 4;
        })
    });
    let some = render(2100, |s| {
        small(s).with(|s| {
            s.image.spp = 256;
            s.image.seed = 1;
        })
    });
    assert!(has(&some.1, "light_sampling") && !has(&some.1, "zones") && !has(&some.1, "visibility_map"));
    let [all, some] = [&all, &some].map(|(image, _)| mean_and_error(image, "G"));
    println!("{all:?}, {some:?}");
    // As in the test of zones, but with more noise: lights are sampled by power alone.
    assert!(deviation(all, some) < 3.5 && some.1 < 0.05 * some.0, "{all:?}, {some:?}");
}
