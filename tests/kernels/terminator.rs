//! The shadow terminator: a coarse sphere with smooth normals is shaded like the sphere that it approximates, without
//! black triangles or shadows of its edges (Hanika 2021).

use std::f64::consts::PI;
use std::sync::Arc;

use glam::{DVec3, Vec3};
use kernel_kit::{Gpu, kernel_test};
use penumbra::internal::scene::{LightKind, Scene};
use penumbra::{Aov, Image, Renderer, Settings, Technique};

use crate::light::{sphere, square};
use crate::path::{camera, scene, surface};
use crate::stage::crossings;

const RADIUS: f64 = 0.5;
const ALBEDO: f32 = 0.5;
const EYE: DVec3 = DVec3::new(0.0, 0.0, 2.0);
/// Direction of the light: beside the view, so that the terminator crosses the middle of the image, and oblique to the
/// sphere's edges.
const LIGHT: DVec3 = DVec3::new(1.9, 1.1, 0.2);

/// The sphere, of triangles that are 22 degrees wide, under either light.
fn ball(area_light: bool) -> Scene {
    let ball = (sphere(DVec3::ZERO, RADIUS, 8), surface(ALBEDO, 0.0));
    let towards = -LIGHT.normalize();
    let side = towards.cross(DVec3::Y).normalize() * 0.3;
    let lamp = (square(LIGHT, side, towards.cross(side)), surface(0.0, 10.0));
    let point = LightKind::Point { position: LIGHT.as_vec3(), intensity: Vec3::splat(3.0), range: f32::INFINITY };
    let mut scene = if area_light { scene(&[ball, lamp], Vec::new()) } else { scene(&[ball], vec![point]) };
    for triangle in scene.triangles.iter().filter(|triangle| triangle.material == 0) {
        for vertex in triangle.vertices {
            let vertex = &mut Arc::make_mut(&mut scene.vertices)[vertex as usize];
            vertex.normal = vertex.position.normalize();
        }
    }
    scene
}

fn render(gpu: &Gpu, area_light: bool, technique: Technique, spp: u32) -> Image {
    let settings = Settings::default().with(|s| {
        s.technique = technique;
        s.image.width = 160;
        s.image.height = 160;
        s.image.spp = spp;
        s.shadow_rays.samples = 256;
        s.indirect.max_bounces = 0;
        s.image.aovs = vec![Aov::Normal, Aov::Position];
    });
    let view = camera(EYE, DVec3::NEG_Z, 0.55);
    let mut renderer = Renderer::new(gpu, ball(area_light), &view, &settings).unwrap();
    while renderer.samples() < spp {
        renderer.render_batch().unwrap();
    }
    renderer.image().unwrap()
}

/// The light that a point of the sphere reflects, from the point light or from 24 x 24 pieces of the square. `visible`
/// tells whether light arrives from a direction.
fn reflected(area_light: bool, position: DVec3, normal: DVec3, visible: impl Fn(DVec3) -> bool) -> f64 {
    let from = |light: DVec3, intensity: f64| {
        let offset = light - position;
        let direction = offset.normalize();
        let cosine = if visible(direction) { direction.dot(normal).max(0.0) } else { 0.0 };
        f64::from(ALBEDO) / PI * intensity * cosine / offset.length_squared()
    };
    if !area_light {
        return from(LIGHT, 3.0);
    }
    const N: usize = 24;
    let towards = -LIGHT.normalize();
    let side = towards.cross(DVec3::Y).normalize() * 0.3;
    let other = towards.cross(side);
    let piece = |k: usize| {
        let at = |i: usize| 2.0 * (i as f64 + 0.5) / N as f64 - 1.0;
        let light = LIGHT + side * at(k % N) + other * at(k / N);
        let area = (0.6 / N as f64).powi(2);
        from(light, 10.0 * area * towards.dot((position - light).normalize()).max(0.0))
    };
    (0..N * N).map(piece).sum()
}

/// Numbers of pixels that show the sphere, without its rim, where normals are bent: those that differ from the smooth
/// sphere; those that differ from triangles that are black below their own horizons; and all of them.
fn differences(image: &Image, area_light: bool) -> [usize; 3] {
    let channel = |name: &str| image.channel(name).unwrap();
    let vector = |names: [&str; 3], i: usize| DVec3::from(names.map(|name| f64::from(channel(name)[i])));
    let triangles = ball(false);
    // At the sphere's brightest point.
    let brightest = reflected(area_light, LIGHT.normalize() * RADIUS, LIGHT.normalize(), |_| true);
    // Rays start up to 0.02 above the triangles, a hundredth of the distance to the light. The errors by the square's
    // noise and by its pieces are smaller.
    let differs = |got: f64, expected: f64| (got - expected).abs() > 0.02 * brightest;
    let mut found = [0; 3];
    for i in 0..image.pixels() {
        let (position, normal) = (vector(["P.X", "P.Y", "P.Z"], i), vector(["N.X", "N.Y", "N.Z"], i));
        if channel("A")[i] < 1.0 || position.length() > 1.1 * RADIUS || normal.dot((EYE - position).normalize()) < 0.1 {
            continue;
        }
        let got = f64::from(channel("G")[i]);
        let outwards = crossings(&triangles, DVec3::ZERO, position);
        let triangle = outwards.iter().find(|crossing| crossing.t > 0.0).unwrap().normal;
        let smooth = reflected(area_light, position, normal, |_| true);
        let cut = reflected(area_light, position, normal, |direction| direction.dot(triangle) > 0.0);
        found[0] += usize::from(differs(got, smooth));
        found[1] += usize::from(differs(got, cut));
        found[2] += 1;
    }
    found
}

/// Images agree for each technique that traces shadow rays, under a point light and under a square. The comparison
/// detects triangles that are black below their own horizons.
#[kernel_test("PENUMBRA_DEVICE")]
fn a_coarse_sphere_darkens_as_the_smooth_one(gpu: &Gpu) {
    for area_light in [false, true] {
        for technique in [Technique::TWO_PASS, Technique::SHADOW_PHOTONS] {
            let [wrong, uncut, pixels] = differences(&render(gpu, area_light, technique, 1), area_light);
            println!("{technique}, area {area_light}: {wrong} differ, {uncut} from cut triangles, of {pixels}");
            assert!(pixels > 10_000, "{pixels} pixels");
            assert_eq!(wrong, 0, "{technique}, area {area_light}: pixels that differ, of {pixels}");
            assert!(uncut > 100, "{technique}, area {area_light}: black triangles are not detected");
        }
    }
}

/// The reference's image has the same mean, within its noise: 64 samples of each of 12,000 pixels.
#[kernel_test("PENUMBRA_DEVICE")]
fn the_path_tracer_agrees_in_the_mean(gpu: &Gpu) {
    for area_light in [false, true] {
        let mean = |technique, spp| {
            let image = render(gpu, area_light, technique, spp);
            let samples = image.channel("G").unwrap();
            samples.iter().map(|x| f64::from(*x)).sum::<f64>() / samples.len() as f64
        };
        let (paths, photons) = (mean(Technique::PATH, 64), mean(Technique::SHADOW_PHOTONS, 16));
        assert!((paths - photons).abs() < 2e-3 * paths, "area {area_light}: {paths} by paths, {photons} by photons");
    }
}
