//! Degenerate, duplicate and thin geometry, cameras inside solids, and nearly empty scenes.

use glam::{DAffine3, DQuat, DVec3, EulerRot};
use penumbra::Technique;
use penumbra::internal::stress::oracle::{difference, green, mean, reflected, relative};
use penumbra::internal::stress::placement::room;
use penumbra::internal::stress::stage::{Corners, Eye, Paint, PointLight, Stage, View, cube, inside_out, square};

use crate::setup::{assert_finite, assert_same, brightest, mean_and_error, render, settings, with_variance};

/// Triangles without area, even emissive ones, change no bit of the image.
#[test]
fn triangles_without_area_change_nothing() {
    let settings = settings(Technique::SHADOW_PHOTONS, 24, 2, 4);
    let (reference, _) = render(&room(), &settings);
    // Exact in f32, and so is their midpoint.
    let (a, b) = (DVec3::new(0.125, 0.25, 0.25), DVec3::new(-0.25, 0.125, 0.0));
    let degenerate: Vec<Corners> = vec![[a, a, a], [a, b, a], [a, b, 0.5 * (a + b)]];
    let mut with = room();
    for part in &mut with.parts {
        part.triangles.extend(degenerate.clone());
    }
    let (scene, _) = with.import().unwrap();
    assert!(scene.notes.iter().any(|note| note.starts_with("9 triangles have no area")), "{:?}", scene.notes);
    assert_same(&render(&with, &settings).0, &reference, "with degenerate triangles");
    // A lamp of degenerate triangles only is not a light.
    let (scene, _) = room().with(degenerate, Paint::lamp(1e6)).import().unwrap();
    assert_eq!(scene.lights.len(), 2);
}

/// Coincident copies of a surface act as one: rays hit one of them, and photons do not pass from one to the other.
#[test]
fn coincident_surfaces_act_as_one() {
    let stage = |twice: bool| {
        let mut stage = room();
        if twice {
            let all = stage.parts[1].triangles.clone();
            stage.parts[1].triangles.extend(all);
        }
        stage
    };
    for technique in [Technique::PATH, Technique::TWO_PASS] {
        let settings = settings(technique, 24, 2, 0);
        assert_same(&render(&stage(true), &settings).0, &render(&stage(false), &settings).0, technique.name());
    }
    let settings = settings(Technique::SHADOW_PHOTONS, 24, 2, 0);
    let ((one, single), (two, double)) = (render(&stage(false), &settings), render(&stage(true), &settings));
    for (a, b) in single.photons.iter().zip(&double.photons) {
        assert_eq!((a.illumination, a.shadow), (b.illumination, b.shadow), "{}", a.light);
    }
    // The total area is larger, which changes the map's cells.
    let off = relative(mean(&two), mean(&one));
    assert!(off < 2e-2, "{off}");
}

/// No light leaves a closed box through its walls, edges or corners. The box has double-sided walls without thickness,
/// no edge along an axis, and a lamp inside; the room around it has no light. `negative-photons` is left out, because
/// its darkness is a difference of two estimates.
#[test]
fn no_light_leaves_a_closed_box() {
    let rotation = DAffine3::from_quat(DQuat::from_euler(EulerRot::XYZ, 0.4, 0.7, 0.2));
    let eye = Eye {
        position: DVec3::new(0.35, 0.3, 0.45),
        towards: DVec3::new(-0.4, -0.35, -0.5),
        view: View::Perspective(0.9),
    };
    for technique in Technique::all().filter(|technique| *technique != Technique::NEGATIVE_PHOTONS) {
        let stage = |open: bool| {
            let mut walls = cube(DVec3::ZERO, 0.2);
            if open {
                walls.truncate(10);
            }
            Stage::new(eye)
                .with(inside_out(cube(DVec3::ZERO, 0.5)), Paint::matte(0.8))
                .with(walls, Paint { double_sided: true, ..Paint::matte(0.8) })
                .with(cube(DVec3::new(0.05, 0.02, 0.0), 0.05), Paint::lamp(10.0))
                .transformed(rotation)
        };
        let settings = settings(technique, 24, 4, 8);
        let (image, statistics) = render(&stage(false), &settings);
        assert_eq!((brightest(&image), statistics.not_finite), (0.0, 0), "{technique}: light outside the box");
        assert!(brightest(&render(&stage(true), &settings).0) > 0.0, "{technique}: no light from the open box");
    }
}

/// No light passes a wall that is 1e-5 thick. Techniques that trace every shadow ray give exactly 0 behind it. With
/// `shadow-photons`, photons beyond the wall can be among a point's nearest, which adds noise with a mean of 0.
/// (`visibility-estimate` and the techniques that show the map display those photons, so they are left out.)
#[test]
fn no_light_passes_a_thin_wall() {
    let eye = Eye {
        position: DVec3::new(0.45, 0.1, 0.4),
        towards: DVec3::new(-1.0, -0.4, -0.9),
        view: View::Perspective(1.3),
    };
    let side = |x: f64, facing: f64| square(DVec3::X * x, DVec3::Y * 0.5 * facing, DVec3::Z * 0.5);
    for technique in [Technique::PATH, Technique::TWO_PASS, Technique::SHADOW_PHOTONS] {
        let stage = |walled: bool| {
            let mut stage = Stage::new(eye)
                .with(inside_out(cube(DVec3::ZERO, 0.5)), Paint::matte(0.7))
                .with(square(DVec3::new(-0.25, 0.45, 0.0), DVec3::X * 0.1, DVec3::Z * 0.1), Paint::lamp(5.0));
            if walled {
                stage = stage.with([side(-0.5e-5, -1.0), side(0.5e-5, 1.0)].concat(), Paint::matte(0.7));
            }
            stage
        };
        let settings = with_variance(settings(technique, 24, 4, 8));
        let ((behind, _), (open, _)) = (render(&stage(true), &settings), render(&stage(false), &settings));
        assert!(mean(&open) > 0.01, "{technique}: no light without the wall");
        if technique == Technique::SHADOW_PHOTONS {
            let (mean_behind, error) = mean_and_error(&behind);
            println!("{mean_behind} +- {error} behind the wall, {} without it", mean(&open));
            assert!(mean_behind.abs() <= 4.0 * error && error < 1e-3 * mean(&open), "{mean_behind} +- {error}");
        } else {
            assert_eq!(brightest(&behind), 0.0, "{technique}: light behind the wall");
        }
    }
}

/// A camera inside a solid sees its dark inside, and no ray leaves the solid. The light is outside. With
/// `shadow-photons`, photons on the outside of a wall can be among a point's nearest, which adds noise with a mean of
/// 0.
#[test]
fn a_camera_may_be_inside_a_solid() {
    let inside =
        Eye { position: DVec3::new(0.05, 0.0, 0.1), towards: DVec3::new(1.0, 0.3, -0.4), view: View::Perspective(2.0) };
    for technique in [Technique::PATH, Technique::TWO_PASS, Technique::SHADOW_PHOTONS] {
        let stage = Stage::new(inside)
            .with(cube(DVec3::ZERO, 0.2), Paint::matte(0.8))
            .with(inside_out(cube(DVec3::ZERO, 0.6)), Paint { radiance: 1.0, ..Paint::matte(0.5) });
        let (image, _) = render(&stage, &with_variance(settings(technique, 24, 16, 4)));
        if technique == Technique::SHADOW_PHOTONS {
            let (mean, error) = mean_and_error(&image);
            println!("{mean} +- {error} in the cube");
            assert!(mean.abs() <= 4.0 * error && error < 0.01, "{mean} +- {error} in the cube");
        } else {
            assert_eq!(brightest(&image), 0.0, "{technique}: light in the cube");
        }
        assert!(image.channel("A").unwrap().iter().all(|a| *a == 1.0), "{technique}: rays leave the cube");
    }
}

/// A single triangle under a point light has the light's closed form at every point, without shadow rays.
#[test]
fn one_triangle_is_a_scene() {
    let eye = Eye { position: DVec3::Y, towards: -DVec3::Y, view: View::Orthographic(0.3) };
    let mut stage = Stage::new(eye).with(
        vec![[DVec3::new(-2.0, 0.0, -1.0), DVec3::new(0.0, 0.0, 3.0), DVec3::new(2.0, 0.0, -1.0)]],
        Paint::matte(0.5),
    );
    stage.lights.push(PointLight { position: DVec3::new(0.1, 0.7, -0.2), intensity: 2.0 });
    for technique in [Technique::PATH, Technique::TWO_PASS, Technique::SHADOW_PHOTONS] {
        let settings = settings(technique, 16, 1, 4);
        let (image, statistics) = render(&stage, &settings);
        for (pixel, radiance) in (0..).zip(green(&image)) {
            let (origin, _) = eye.ray([pixel % 16, pixel / 16], 16);
            let way = stage.lights[0].position - DVec3::new(origin.x, 0.0, origin.z);
            let expected = reflected(0.5, 2.0 * way.normalize().y / way.length_squared());
            // Positions, distances and cosines are f32, each with a relative rounding of 6e-8.
            assert!(relative(radiance, expected) < 1e-5, "{technique}: {radiance} for {expected}");
        }
        if technique == Technique::SHADOW_PHOTONS {
            assert_eq!((statistics.photons[0].shadow, statistics.rays.shadow), (0, 0), "nothing can cast a shadow");
        }
    }
}

/// Scenes without lights are black, and empty scenes are transparent too, by every technique.
#[test]
fn scenes_may_be_dark_or_empty() {
    for technique in Technique::all() {
        let settings = settings(technique, 8, 2, 4);
        let dark = Stage { lights: Vec::new(), parts: room().parts[..2].to_vec(), ..room() };
        let (image, _) = render(&dark, &settings);
        assert_eq!(brightest(&image), 0.0, "{technique}");
        assert!(image.channel("A").unwrap().iter().all(|a| *a == 1.0), "{technique}");
        let (image, _) = render(&Stage::new(room().eye), &settings);
        assert!(image.channels.iter().all(|channel| channel.samples.iter().all(|x| *x == 0.0)), "{technique}");
    }
}

/// The shadow of an open occluder does not depend on the winding of its triangles.
#[test]
fn shadows_do_not_depend_on_winding() {
    let eye = Eye { position: DVec3::Y * 0.2, towards: -DVec3::Y, view: View::Orthographic(0.4) };
    let stage = |mixed: bool| {
        let mut shade = square(DVec3::Y * 0.3, DVec3::Z * 0.1, DVec3::X * 0.1);
        if mixed {
            shade[1].swap(1, 2);
        }
        Stage::new(eye)
            .with(square(DVec3::ZERO, DVec3::Z, DVec3::X), Paint::matte(0.5))
            .with(shade, Paint::matte(0.5))
            .with(square(DVec3::Y, DVec3::X * 0.1, DVec3::Z * 0.1), Paint::lamp(1.0))
    };
    for (technique, tolerance) in [
        // Another order of corners rounds differently, which shows at the shadow's edges.
        (Technique::PATH, 1e-3),
        (Technique::TWO_PASS, 1e-3),
        // The occluder's back has no photons, so points near it are classified differently.
        (Technique::SHADOW_PHOTONS, 2e-2),
    ] {
        let settings = settings(technique, 32, 4, 0).with(|s| s.shadow_rays.samples = 16);
        let ((mixed, _), (same, _)) = (render(&stage(true), &settings), render(&stage(false), &settings));
        assert_finite(&mixed);
        let off = difference(&mixed, &same);
        assert!(off < tolerance, "{technique}: {off}");
    }
}
