//! Emission towards the receiver bounds, against emission in all directions.

use glam::{DVec3, Vec3};
use kernel_kit::{Gpu, kernel_test};
use penumbra::internal::gpu_scene::{GpuLights, ReceiverBounds};
use penumbra::internal::scene::{DiffuseTransmission, LightKind, Material, Scene, Specular};

use crate::light::{Emitted, cube, emit, scene, sphere, square};

const RECEIVERS: ReceiverBounds = ReceiverBounds { centre: Vec3::new(0.1, -0.2, 0.05), radius: 0.3 };

/// Lights of every kind: near the receivers, far from them, and among them. The last ones emit in all directions.
fn lights() -> Scene {
    let over = DVec3::new(0.3, 0.9, 0.1);
    let meshes = [
        // Facing down, tilted, wide compared with its distance, far away, and with the receivers across its horizon.
        (square(over, DVec3::X * 0.2, DVec3::Z * 0.2), false),
        (square(over, DVec3::new(0.2, 0.1, 0.0), DVec3::Z * 0.2), true),
        (square(DVec3::Y * 0.4, DVec3::X * 0.6, DVec3::Z * 0.6), false),
        (square(DVec3::new(-20.0, 30.0, 5.0), DVec3::X, DVec3::Z), false),
        (square(DVec3::new(0.9, -0.1, 0.0), DVec3::X * 0.1, DVec3::Z * 0.1), false),
        (sphere(over, 0.2, 8), false),
        (square(DVec3::NEG_Y * 0.1, DVec3::X * 0.1, DVec3::Z * 0.1), false),
    ];
    let (position, intensity, range) = (over.as_vec3(), Vec3::ONE, f32::INFINITY);
    let direction = Vec3::new(-0.3, -1.0, 0.1).normalize();
    let spot = |cos_outer| LightKind::Spot { position, direction, intensity, cos_inner: 0.99, cos_outer, range };
    let punctual = [
        LightKind::Point { position, intensity, range },
        LightKind::Point { position: Vec3::new(-20.0, 30.0, 5.0), intensity, range },
        LightKind::Point { position: RECEIVERS.centre, intensity, range },
        spot(0.3),
        spot(0.97),
    ];
    scene(&meshes, &punctual)
}

/// The part of the receivers' sphere that a ray passes: the octant of the ray's point nearest to the centre, and
/// whether that point is in the inner or the outer half. `None` if the ray misses the sphere.
fn part(ray: &Emitted, spare: f64) -> Option<usize> {
    let (centre, radius) = (RECEIVERS.centre.as_dvec3(), f64::from(RECEIVERS.radius));
    let ahead = (centre - ray.origin).dot(ray.direction);
    let beside = ray.origin + ray.direction * ahead - centre;
    let inside = ray.origin.distance(centre) < radius;
    if beside.length() > radius + spare || (ahead < 0.0 && !inside) {
        return None;
    }
    let octant = (0..3).map(|i| usize::from(beside[i] > 0.0) << i).sum::<usize>();
    Some(octant + 8 * usize::from(beside.length() < radius * 0.5f64.sqrt()))
}

/// For each part: the power that it receives, the variance of that estimate, and the number of rays.
fn powers(rays: &[Emitted]) -> Vec<[f64; 3]> {
    let n = rays.len() as f64;
    let mut sums = vec![[0.0; 3]; 16];
    for ray in rays {
        if let Some(part) = part(ray, 0.0) {
            sums[part][0] += ray.flux;
            sums[part][1] += ray.flux * ray.flux;
            sums[part][2] += 1.0;
        }
    }
    sums.iter().map(|[sum, squares, met]| [sum / n, (squares / n - (sum / n).powi(2)) / n, *met]).collect()
}

/// With emission towards the receiver bounds, each part of them receives the same power as with emission in all
/// directions. A z-test compares the parts that at least a hundred rays of the latter reach (Sobol points have less
/// error than the independent points that it assumes); it detects an excess of a tenth. No ray misses the bounds, and
/// the share of power that the host states is the measured one.
#[kernel_test("PENUMBRA_DEVICE")]
fn emission_towards_receivers_brings_the_same_power(gpu: &Gpu) {
    const RAYS: usize = 1 << 18;
    let scene = lights();
    let gpu_lights = GpuLights::new(gpu, &scene, Some(RECEIVERS)).unwrap();
    let (mut narrowed, mut compared) = (0, 0);
    let mut largest: [f64; 2] = [0.0; 2];
    for (light, info) in gpu_lights.lights.iter().enumerate() {
        let (anywhere, towards) =
            (emit(gpu, &scene, None, light, RAYS), emit(gpu, &scene, Some(RECEIVERS), light, RAYS));
        for ([a, variance_a, met], [b, variance_b, _]) in powers(&anywhere).into_iter().zip(powers(&towards)) {
            if met >= 100.0 {
                compared += 1;
                let error = (variance_a + variance_b).sqrt();
                for (largest, b) in largest.iter_mut().zip([b, 1.1 * b]) {
                    *largest = largest.max((a - b).abs() / error);
                }
            }
        }
        let total = |rays: &[Emitted]| rays.iter().map(|ray| ray.flux).sum::<f64>();
        let share = total(&towards) / total(&anywhere);
        println!("light {light}: share {share}, as the host has it {}", info.received_share);
        // The share only distributes rays among lights, so it may be approximate: it uses the centres of triangles,
        // which differ from the mean for a few nearby triangles.
        assert!(
            (share / info.received_share).ln().abs() < 1.5f64.ln(),
            "light {light}: {share}, {}",
            info.received_share
        );
        // The farthest lights are 36 units away: directions and origins are off by 36 * 6e-8 = 2e-6.
        let met = towards.iter().filter(|ray| part(ray, 1e-5).is_some()).count();
        if share < 0.5 {
            narrowed += 1;
            // Triangles of the spherical light that face away from the receivers emit in all directions.
            assert!(met == RAYS || light == 5, "light {light}: {} of {RAYS} rays pass by", RAYS - met);
        }
        if [6, 9, 11].contains(&light) {
            assert_eq!(share, 1.0, "light {light}");
        }
    }
    assert!(narrowed >= 6, "{narrowed} lights emit towards the receivers");
    // By chance one of a hundred comparisons passes 4.5 once in a thousand runs.
    println!(
        "{compared} compared, largest deviation {:.2}, of a tenth more {:.2} standard errors",
        largest[0], largest[1]
    );
    assert!(compared > 80 && largest[0] < 4.5 && largest[1] > 4.5, "{compared}, {largest:?}");
}

/// The receivers are all surfaces except lamps that reflect nothing; a scene of such lamps alone has no receivers.
#[test]
fn black_lamps_receive_nothing() {
    let black = Material {
        base_colour: Vec3::ZERO.extend(1.0),
        metallic: 0.0,
        specular: Specular::with_factor(0.0),
        emissive: Vec3::ONE,
        ..Material::default()
    };
    let mut scene = crate::meshes::scene(
        &[(cube(DVec3::X * 0.5, 0.1), Material::default()), (cube(DVec3::NEG_X * 0.8, 0.1), black.clone())],
        Vec::new(),
    );
    let receivers = ReceiverBounds::of(&scene).unwrap();
    assert_eq!(receivers.centre, Vec3::X * 0.5);
    let radius = 0.03f32.sqrt();
    // The bounds are larger by 1e-4, and by 1e-4 of the radius.
    assert!(receivers.radius > radius && receivers.radius < radius + 2e-4, "{receivers:?}");
    scene.materials[1].specular.factor = 0.5;
    // Half of the distance from 0.6 to -0.9 is 0.75.
    assert!(ReceiverBounds::of(&scene).unwrap().radius > 0.7, "a lamp that reflects is a receiver");
    let shade = Material { diffuse_transmission: DiffuseTransmission::new(0.5, Vec3::ONE), ..black.clone() };
    scene.materials[1] = shade;
    assert!(ReceiverBounds::of(&scene).unwrap().radius > 0.7, "a lamp that lets light pass is a receiver");
    scene.materials = vec![black.clone(), black];
    assert_eq!(ReceiverBounds::of(&scene), None);
}
