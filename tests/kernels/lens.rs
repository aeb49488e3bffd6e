//! The lens: where its rays begin, and that all rays of a pixel meet where it is in focus.

use glam::{DVec2, DVec3, Vec4};
use kernel_kit::{Gpu, kernel_test};
use penumbra::Technique;
use penumbra::internal::kernels::INVALID_POINT;
use penumbra::internal::passes::primary::Primary;
use penumbra::internal::passes::{Tile, TileBuffers};
use penumbra::internal::scene::{Camera, Lens, Projection};
use penumbra::internal::specialisation::features::Feature;

use crate::light::square;
use crate::path::{camera, scene, surface};
use crate::stage::{Stage, whole};

const SIZE: [u32; 2] = [8, 6];

/// A camera's rays as the pass made them: the pixel, the point of the lens in radii of it, and the hit.
struct Seen {
    pixel: usize,
    iris: DVec2,
    /// Distance of that point from the plane of the lens.
    off: f64,
    eye: DVec3,
    hit: DVec3,
}

fn see(gpu: &Gpu, camera: &Camera, samples_per_pixel: u32) -> Vec<Seen> {
    let wall = square(DVec3::new(0.0, 0.0, -0.5), DVec3::new(0.8, 0.0, 0.3), DVec3::Y * 0.8);
    let scene = scene(&[(wall, surface(0.5, 1.0))], Vec::new());
    let stage =
        Stage::new(gpu, scene, camera, SIZE, Technique::TWO_PASS, |features| features.with(Feature::ThinLens, true));
    let tile = Tile { centred: 1.0, ..whole(SIZE, samples_per_pixel) };
    let pass = Primary::new(gpu, &stage.features, &stage.gpu_scene.constants()).unwrap();
    let buffers = TileBuffers::new(gpu, &stage.features, tile.point_count, false).unwrap();
    let mut frame = gpu.frame("test");
    pass.bind(gpu, &buffers, &stage.gpu_scene).unwrap().record(&mut frame, &tile);
    frame.submit().unwrap();
    let count = tile.point_count as usize;
    let vectors = |words: Vec<[u32; 4]>| words.into_iter().map(|w| Vec4::from_array(w.map(f32::from_bits)));
    let points: Vec<[u32; 4]> = gpu.read(&buffers.points.buffer, count).unwrap();
    assert!(points.iter().all(|point| point[3] != INVALID_POINT), "the wall fills the view");
    // A Lambertian surface is one vector; the eye follows.
    let surfaces: Vec<Vec4> = vectors(gpu.read(&buffers.surfaces.buffer, 2 * count).unwrap()).collect();
    let [right, up, backward] = camera.axes.map(|axis| axis.as_dvec3());
    let seen = |(i, point): (usize, Vec4)| {
        let eye = surfaces[2 * i + 1].truncate().as_dvec3();
        let offset = eye - camera.position.as_dvec3();
        let radius = f64::from(camera.lens.unwrap().radius);
        Seen {
            pixel: i / samples_per_pixel as usize,
            iris: DVec2::new(offset.dot(right), offset.dot(up)) / radius,
            off: offset.dot(backward).abs(),
            eye,
            hit: point.truncate().as_dvec3(),
        }
    };
    vectors(points).enumerate().map(seen).collect()
}

/// Rays whose line passes by the point where the ray through the lens's centre is in focus.
fn unfocused(seen: &[Seen], camera: &Camera, distance: f64) -> usize {
    let [right, up, backward] = camera.axes.map(|axis| axis.as_dvec3());
    let Projection::Perspective { yfov, .. } = camera.projection else { unreachable!("a lens needs perspective") };
    let half = (f64::from(yfov) / 2.0).tan();
    let [width, height] = SIZE.map(f64::from);
    let passes_by = |seen: &&Seen| {
        let [x, y] = [seen.pixel % SIZE[0] as usize, seen.pixel / SIZE[0] as usize].map(|at| at as f64 + 0.5);
        let across = half * width / height * (2.0 * x / width - 1.0) * right + half * (1.0 - 2.0 * y / height) * up;
        let in_focus = camera.position.as_dvec3() + (across - backward) * distance;
        let along = (seen.hit - seen.eye).normalize();
        // Roundings of positions and directions of unit size.
        (in_focus - seen.eye).cross(along).length() > 2e-6
    };
    seen.iter().filter(passes_by).count()
}

/// Points beyond the sides of a regular polygon with a corner to the right.
fn outside(seen: &[Seen], blades: u32) -> usize {
    let corner = |i: u32| DVec2::from_angle(std::f64::consts::TAU * f64::from(i) / f64::from(blades));
    // A coordinate of unit size is rounded by 6e-8, which is 1e-6 of a radius of 0.08.
    let beyond = |p: DVec2| (0..blades).any(|i| (corner(i + 1) - corner(i)).perp_dot(p - corner(i)) < -1e-5);
    seen.iter().filter(|seen| beyond(seen.iris)).count()
}

/// The mean of the points' squared distances from the centre.
fn mean_square(seen: &[Seen]) -> f64 {
    seen.iter().map(|seen| seen.iris.length_squared()).sum::<f64>() / seen.len() as f64
}

#[kernel_test("PENUMBRA_DEVICE")]
fn rays_leave_the_whole_iris_and_meet_in_focus(gpu: &Gpu) {
    for blades in [0, 3, 5, 6] {
        let lens = Lens { radius: 0.08, distance: 0.9, blades };
        let view = camera(DVec3::new(0.02, 0.05, 0.9), DVec3::new(-0.02, -0.05, -1.0), 0.6);
        let view = Camera { lens: Some(lens), ..view };
        let seen = see(gpu, &view, 64);
        // A few roundings of f32 positions of unit size.
        assert!(seen.iter().all(|seen| seen.off < 1e-6), "{blades} blades: rays do not leave the lens");
        assert_eq!(unfocused(&seen, &view, 0.9), 0, "{blades} blades");
        assert!(unfocused(&seen, &view, 1.0) > seen.len() / 2, "another distance is not noticed");
        let mean = seen.iter().map(|seen| seen.iris).sum::<DVec2>() / seen.len() as f64;
        // A coordinate's variance is at most 1/4: 4 standard errors of the mean of 3072 independent points.
        assert!(mean.abs().max_element() < 0.036, "{blades} blades: {mean}");
        let is_round = blades == 0;
        if is_round {
            // Roundings of 1e-6 of the radius, as in `outside`.
            assert!(seen.iter().all(|seen| seen.iris.length() < 1.0 + 1e-5), "points beyond the rim");
            assert!(outside(&seen, 5) > seen.len() / 10, "a round iris is not noticed");
        } else {
            assert_eq!(outside(&seen, blades), 0, "{blades} blades");
            assert!(outside(&seen, blades + 1) > 0, "another number of blades is not noticed");
        }
        // The polar moment of a regular polygon over its area, with corners at distance 1; 1/2 of a disc.
        let expected = if is_round { 0.5 } else { (2.0 + (std::f64::consts::TAU / f64::from(blades)).cos()) / 6.0 };
        // The variance of a squared distance is at most 1/12: 4 standard errors.
        let is_expected = |expected: f64| (mean_square(&seen) - expected).abs() < 0.021;
        assert!(is_expected(expected), "{blades} blades: {} for {expected}", mean_square(&seen));
        assert!(!is_expected(1.1 * expected), "{blades} blades: a larger iris is not noticed");
    }
}
