//! Triangles without area, twins, closed and thin walls, cameras in odd places, scenes of next to nothing.

use glam::{DAffine3, DQuat, DVec3, EulerRot};
use penumbra::Technique;
use penumbra::internal::stress::oracle::{difference, green, mean, reflected, relative};
use penumbra::internal::stress::placement::room;
use penumbra::internal::stress::stage::{Corners, Eye, Paint, PointLight, Stage, View, cube, inside_out, square};

use crate::setup::{assert_finite, assert_same, brightest, mean_and_error, render, settings, with_variance};

/// Triangles whose corners coincide or lie on a line, emissive ones too, change no bit of the image.
#[test]
fn triangles_without_area_are_none() {
    let settings = settings(Technique::ShadowPhotons, 24, 2, 4);
    let (reference, _) = render(&room(), &settings);
    // What f32 holds, and so does it the middle.
    let (a, b) = (DVec3::new(0.125, 0.25, 0.25), DVec3::new(-0.25, 0.125, 0.0));
    let degenerate: Vec<Corners> = vec![[a, a, a], [a, b, a], [a, b, 0.5 * (a + b)]];
    let mut with = room();
    for part in &mut with.parts {
        part.triangles.extend(degenerate.clone());
    }
    let (scene, _) = with.import().unwrap();
    assert!(scene.notes.iter().any(|note| note.starts_with("9 triangles have no area")), "{:?}", scene.notes);
    assert_same(&render(&with, &settings).0, &reference, "with degenerate triangles");
    // A lamp of nothing else is no light.
    let (scene, _) = room().with(degenerate, Paint::lamp(1e6)).import().unwrap();
    assert_eq!(scene.lights.len(), 2);
}

/// A surface that is there twice is one surface: no photon falls from one to the other, and rays take one of them.
#[test]
fn twins_are_one_surface() {
    let twin = |twice: bool| {
        let mut stage = room();
        if twice {
            let all = stage.parts[1].triangles.clone();
            stage.parts[1].triangles.extend(all);
        }
        stage
    };
    for technique in [Technique::Path, Technique::TwoPass] {
        let settings = settings(technique, 24, 2, 0);
        assert_same(&render(&twin(true), &settings).0, &render(&twin(false), &settings).0, technique.name());
    }
    let settings = settings(Technique::ShadowPhotons, 24, 2, 0);
    let ((one, single), (two, double)) = (render(&twin(false), &settings), render(&twin(true), &settings));
    for (a, b) in single.photons.iter().zip(&double.photons) {
        assert_eq!((a.illumination, a.shadow), (b.illumination, b.shadow), "{}", a.light);
    }
    // The map's cells are others, as the area is.
    let off = relative(mean(&two), mean(&one));
    assert!(off < 2e-2, "{off}");
}

/// A closed box of double-sided walls without thickness, turned so that no edge lies along an axis, with a lamp in it, in a
/// room without a light: nothing comes through its walls, edges and corners, by any technique but that of negative photons,
/// whose darkness is a difference of two estimates.
#[test]
fn nothing_leaves_a_closed_box() {
    let turn = DAffine3::from_quat(DQuat::from_euler(EulerRot::XYZ, 0.4, 0.7, 0.2));
    let eye = Eye {
        position: DVec3::new(0.35, 0.3, 0.45),
        towards: DVec3::new(-0.4, -0.35, -0.5),
        view: View::Perspective(0.9),
    };
    for technique in Technique::ALL.into_iter().filter(|technique| *technique != Technique::NegativePhotons) {
        let stage = |open: bool| {
            let mut walls = cube(DVec3::ZERO, 0.2);
            if open {
                walls.truncate(10);
            }
            Stage::new(eye)
                .with(inside_out(cube(DVec3::ZERO, 0.5)), Paint::matte(0.8))
                .with(walls, Paint { double_sided: true, ..Paint::matte(0.8) })
                .with(cube(DVec3::new(0.05, 0.02, 0.0), 0.05), Paint::lamp(10.0))
                .placed(turn)
        };
        let settings = settings(technique, 24, 4, 8);
        let (image, statistics) = render(&stage(false), &settings);
        assert_eq!((brightest(&image), statistics.not_finite), (0.0, 0), "{technique}: light outside of the box");
        assert!(brightest(&render(&stage(true), &settings).0) > 0.0, "{technique}: the test sees nothing");
    }
}

/// A room is divided by a wall 1e-5 thick; the light is on the other side. There is none on this side: exactly none where
/// every point asks for itself, and none but noise that is 0 on average where photons beyond the wall are among a point's
/// nearest. (Those are what `visibility-estimate` and the techniques that show the map show.)
#[test]
fn nothing_passes_a_thin_wall() {
    let eye = Eye {
        position: DVec3::new(0.45, 0.1, 0.4),
        towards: DVec3::new(-1.0, -0.4, -0.9),
        view: View::Perspective(1.3),
    };
    let side = |x: f64, facing: f64| square(DVec3::X * x, DVec3::Y * 0.5 * facing, DVec3::Z * 0.5);
    for technique in [Technique::Path, Technique::TwoPass, Technique::ShadowPhotons] {
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
        assert!(mean(&open) > 0.01, "{technique}: the test sees nothing");
        if technique == Technique::ShadowPhotons {
            let (mean_behind, error) = mean_and_error(&behind);
            println!("{mean_behind} +- {error} behind the wall, {} without it", mean(&open));
            assert!(mean_behind.abs() <= 4.0 * error && error < 1e-3 * mean(&open), "{mean_behind} +- {error}");
        } else {
            assert_eq!(brightest(&behind), 0.0, "{technique}: light behind the wall");
        }
    }
}

/// From inside a solid there is its inside, which is dark where the light is outside (but for noise that is 0 on average,
/// where photons on the outside of the far wall are a point's nearest), and no ray leaves it.
#[test]
fn a_camera_may_be_inside_a_solid() {
    let inside =
        Eye { position: DVec3::new(0.05, 0.0, 0.1), towards: DVec3::new(1.0, 0.3, -0.4), view: View::Perspective(2.0) };
    for technique in [Technique::Path, Technique::TwoPass, Technique::ShadowPhotons] {
        let stage = Stage::new(inside)
            .with(cube(DVec3::ZERO, 0.2), Paint::matte(0.8))
            .with(inside_out(cube(DVec3::ZERO, 0.6)), Paint { radiance: 1.0, ..Paint::matte(0.5) });
        let (image, _) = render(&stage, &with_variance(settings(technique, 24, 16, 4)));
        if technique == Technique::ShadowPhotons {
            let (mean, error) = mean_and_error(&image);
            println!("{mean} +- {error} in the cube");
            assert!(mean.abs() <= 4.0 * error && error < 0.01, "{mean} +- {error} in the cube");
        } else {
            assert_eq!(brightest(&image), 0.0, "{technique}: light in the cube");
        }
        assert!(image.channel("A").unwrap().iter().all(|a| *a == 1.0), "{technique}: rays leave the cube");
    }
}

/// One triangle under a point light: every point has the light's closed form, and there is nothing to cast a shadow.
#[test]
fn one_triangle_is_a_scene() {
    let eye = Eye { position: DVec3::Y, towards: -DVec3::Y, view: View::Orthographic(0.3) };
    let mut stage = Stage::new(eye).with(
        vec![[DVec3::new(-2.0, 0.0, -1.0), DVec3::new(0.0, 0.0, 3.0), DVec3::new(2.0, 0.0, -1.0)]],
        Paint::matte(0.5),
    );
    stage.lights.push(PointLight { position: DVec3::new(0.1, 0.7, -0.2), intensity: 2.0 });
    for technique in [Technique::Path, Technique::TwoPass, Technique::ShadowPhotons] {
        let settings = settings(technique, 16, 1, 4);
        let (image, statistics) = render(&stage, &settings);
        for (pixel, radiance) in (0..).zip(green(&image)) {
            let (origin, _) = eye.ray([pixel % 16, pixel / 16], 16);
            let way = stage.lights[0].position - DVec3::new(origin.x, 0.0, origin.z);
            let expected = reflected(0.5, 2.0 * way.normalize().y / way.length_squared());
            assert!(relative(radiance, expected) < 1e-5, "{technique}: {radiance} for {expected}");
        }
        if technique == Technique::ShadowPhotons {
            assert_eq!((statistics.photons[0].shadow, statistics.rays.shadow), (0, 0), "what is there to ask?");
        }
    }
}

/// Without a light all is black, and without anything there is not even a surface, by any technique.
#[test]
fn nothing_may_be_lit_and_nothing_may_be_there() {
    for technique in Technique::ALL {
        let settings = settings(technique, 8, 2, 4);
        let dark = Stage { lights: Vec::new(), parts: room().parts[..2].to_vec(), ..room() };
        let (image, _) = render(&dark, &settings);
        assert_eq!(brightest(&image), 0.0, "{technique}");
        assert!(image.channel("A").unwrap().iter().all(|a| *a == 1.0), "{technique}");
        let (image, _) = render(&Stage::new(room().eye), &settings);
        assert!(image.channels.iter().all(|channel| channel.samples.iter().all(|x| *x == 0.0)), "{technique}");
    }
}

/// An occluder casts its shadow whichever way each of its triangles is wound, and open as it may be.
#[test]
fn winding_does_not_matter_to_shadows() {
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
        // Corners in another order round otherwise, at the shadow's edges.
        (Technique::Path, 1e-3),
        (Technique::TwoPass, 1e-3),
        // The photons on the occluder's own back are missing, so points near it are decided otherwise.
        (Technique::ShadowPhotons, 2e-2),
    ] {
        let settings = settings(technique, 32, 4, 0).with(|s| s.shadow_rays.samples = 16);
        let ((mixed, _), (same, _)) = (render(&stage(true), &settings), render(&stage(false), &settings));
        assert_finite(&mixed);
        let off = difference(&mixed, &same);
        assert!(off < tolerance, "{technique}: {off}");
    }
}
