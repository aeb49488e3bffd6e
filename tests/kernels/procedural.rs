//! `shaders/lib/procedural.wgsl`: intersections of rays with procedural objects, against closed forms.

use glam::{DAffine3, DQuat, DVec3, Vec3};
use kernel_kit::{Gpu, kernel_test};
use penumbra::internal::kernels::compose_source;
use penumbra::internal::procedural::Role;
use penumbra::internal::scene::Scene;
use penumbra::settings::Technique;

use crate::kit::new_kernel;
use crate::meshes::{camera, scene, square, surface};
use crate::procedurals::{Object, place, sphere};
use crate::rooms::Random;
use crate::stage::Stage;
use crate::traverse::{Ray, trace};

const OBJECT: u32 = 1 << 31;
const NO_HIT: u32 = u32::MAX;

/// Runs an entry point of `shaders/traverse.wgsl` on rays. Returns its answers, and the counts of lost rays.
fn run(gpu: &Gpu, stage: &Stage, entry: &str, rays: &[Ray]) -> (Vec<[u32; 4]>, [u32; 2]) {
    let composed = compose_source("traverse", include_str!("shaders/traverse.wgsl"), &stage.features).unwrap();
    let mut constants = stage.gpu_scene.constants();
    constants.extend([("ray_count", rays.len() as f64), ("primitive_count", 0.0)]);
    let kernel = new_kernel(gpu, &composed, &composed.overrides(&constants), &["rays", "answers"]).unwrap();
    let answers = trace(gpu, &kernel, entry, rays, 1, &stage.gpu_scene);
    let misses: Vec<u32> = gpu.read(&stage.gpu_scene.procedural_misses, 2).unwrap();
    (answers, [misses[0], misses[1]])
}

fn stage(gpu: &Gpu, scene: Scene) -> Stage {
    let view = camera(DVec3::Z, DVec3::NEG_Z, 1.0);
    Stage::new(gpu, scene, &view, [1, 1], Technique::PATH, |features| features)
}

/// An ellipsoid, rotated and off the origin.
fn ellipsoid() -> DAffine3 {
    let rotation = DQuat::from_axis_angle(DVec3::new(0.3, 0.5, -0.8).normalize(), 0.7);
    DAffine3::from_scale_rotation_translation(DVec3::new(0.2, 0.35, 0.1), rotation, DVec3::new(0.15, -0.1, 0.2))
}

/// Rays from near, from far and from inside; some are short, some have directions that are not unit vectors.
fn rays(count: usize) -> Vec<Ray> {
    let mut random = Random(11);
    let mut ray = |i: usize| {
        let towards = Vec3::new(0.15, -0.1, 0.2) + 0.3 * random.direction();
        let distance = [0.1, 0.6, 4.0][i % 3];
        let origin = towards + distance * random.direction();
        let direction = (towards - origin) * [1.0 / distance, 1.0, 0.01][i / 3 % 3];
        let length = if i.is_multiple_of(5) { distance * random.unit() } else { 1e9 };
        Ray { origin, direction, t_max: length / direction.length() }
    };
    (0..count).map(&mut ray).collect()
}

/// Both crossings of a ray's line with the unit sphere of an object's space, or none; and the distance, in radii, of
/// the line from a tangent.
fn crossings(world: &DAffine3, ray: &Ray) -> (Option<[f64; 2]>, f64) {
    let own = world.inverse();
    let o = own.transform_point3(ray.origin.as_dvec3());
    let d = own.transform_vector3(ray.direction.as_dvec3());
    let along = -o.dot(d) / d.length_squared();
    let offset = (o + along * d).length();
    let half = (1.0 - offset * offset).max(0.0).sqrt() / d.length();
    ((offset < 1.0).then_some([along - half, along + half]), (1.0 - offset).abs())
}

/// Of the rays whose answer does not depend on rounding, the number of wrong answers, and the number of rays.
fn wrong(world: &DAffine3, rays: &[Ray], answers: &[[u32; 4]], occluded: &[[u32; 4]]) -> (usize, usize) {
    let (mut wrong, mut checked) = (0, 0);
    for ((ray, [t, u, v, id]), [stopped, ..]) in rays.iter().zip(answers).zip(occluded) {
        let (found, doubt) = crossings(world, ray);
        let length = f64::from(ray.direction.length());
        // Lengths in the object's space are up to ten times those of the scene, and positions there are exact to 2^-18
        // of the box's diagonal.
        let tolerance = 2e-5 / length;
        let t_max = f64::from(ray.t_max);
        let near = |t: f64| t.abs() < tolerance || (t - t_max).abs() < tolerance;
        if doubt < 1e-3 || found.is_some_and(|found| found.into_iter().any(near)) {
            continue;
        }
        checked += 1;
        let first = found.and_then(|found| found.into_iter().find(|t| *t > 0.0 && *t <= t_max));
        let right = match first {
            None => *id == NO_HIT && *stopped == 0,
            Some(first) => {
                let at = world.inverse().transform_point3(ray.origin.as_dvec3() + first * ray.direction.as_dvec3());
                let normal = world.inverse().matrix3.transpose() * at;
                let [u, v] = [u, v].map(|word| f64::from(f32::from_bits(*word)));
                let z = 1.0 - u.abs() - v.abs();
                let fold = |p: f64| p - (-z).max(0.0).copysign(p);
                let given = DVec3::new(fold(u), fold(v), z).normalize();
                let off = (f64::from(f32::from_bits(*t)) - first).abs() * length;
                // At a grazing angle a step of epsilon along the ray is a larger error.
                let cosine = (normal.normalize().dot(ray.direction.as_dvec3()) / length).abs();
                *id == OBJECT
                    && *stopped == 1
                    && off < 1e-5 + 1e-6 / cosine
                    && given.dot(normal.normalize()) > 1.0 - 1e-6
            }
        };
        wrong += usize::from(!right);
    }
    (wrong, checked)
}

/// An ellipsoid given by its closed form and by its distance: first hits, normals and occlusion are those of the
/// quadratic equation. The comparison finds an ellipsoid that is a thousandth larger.
#[kernel_test("PENUMBRA_DEVICE")]
fn ellipsoids_are_met_where_they_are(gpu: &Gpu) {
    let rays = rays(6000);
    for role in [Role::Intersection, Role::Distance] {
        let traced = |parameter| {
            let mut scene = Scene::default();
            place(&mut scene, &[Object { parameter, ..sphere(role, ellipsoid(), surface(0.5, 0.0)) }]);
            let stage = stage(gpu, scene);
            let (closest, misses) = run(gpu, &stage, "closest", &rays);
            assert_eq!(misses, [0; 2]);
            (closest, run(gpu, &stage, "occluded", &rays).0)
        };
        let (closest, occluded) = traced(1.0);
        let (found, checked) = wrong(&ellipsoid(), &rays, &closest, &occluded);
        assert!(found == 0 && checked > 5000, "{role:?}: {found} of {checked} rays are wrong");
        let (closest, occluded) = traced(0.999);
        let (found, checked) = wrong(&ellipsoid(), &rays, &closest, &occluded);
        assert!(2 * found > checked / 2, "{role:?}: a thousandth is found by {found} of {checked} rays");
    }
}

/// Rays hit the nearest of a triangle and several objects, each with its own function.
#[kernel_test("PENUMBRA_DEVICE")]
fn the_nearest_of_all_is_met(gpu: &Gpu) {
    let at = |z: f64| DAffine3::from_scale_rotation_translation(DVec3::splat(0.1), DQuat::IDENTITY, DVec3::Z * z);
    let wall = square(DVec3::Z * 0.25, 0.5 * DVec3::X, 0.5 * DVec3::Y);
    let mut scene = scene(&[(wall, surface(0.5, 0.0))], Vec::new());
    let objects = [(Role::Distance, 0.5), (Role::Intersection, 0.0)];
    place(&mut scene, &objects.map(|(role, z)| sphere(role, at(z), surface(0.5, 0.0))));
    let stage = stage(gpu, scene);
    let down = |z: f32| Ray { origin: Vec3::new(0.001, 0.002, z), direction: Vec3::NEG_Z, t_max: 1e30 };
    let (answers, misses) = run(gpu, &stage, "closest", &[down(1.0), down(0.35), down(0.2), down(0.0), down(-0.2)]);
    let met: Vec<u32> = answers.iter().map(|answer| answer[3]).collect();
    assert_eq!((met[0], met[2], met[3], met[4]), (OBJECT, OBJECT | 1, OBJECT | 1, NO_HIT));
    assert!(met[1] < 2, "{met:?}: the wall is before the second sphere");
    let t: Vec<f32> = answers.iter().map(|answer| f32::from_bits(answer[0])).collect();
    for (t, expected) in t.iter().zip([0.4, 0.1, 0.1, 0.1]) {
        // Rays are 0.0022 beside the axis, where a sphere of 0.1 is 0.0022^2 / 0.2 = 2.5e-5 farther.
        assert!((t - expected).abs() < 1e-3, "{t}, not {expected}");
    }
    assert_eq!(misses, [0; 2]);
}

/// Functions that loop without end, by every kind of loop, or whose results are not finite: rays pass through and are
/// counted, and other objects are hit as usual.
#[kernel_test("PENUMBRA_DEVICE")]
fn bad_functions_are_counted_and_passed_through(gpu: &Gpu) {
    let intersection = |body: &str| {
        format!("fn f(origin: vec3f, direction: vec3f, nearest: f32, parameters: vec4f) -> vec4f {{ {body} }}")
    };
    let distance = |body: &str| format!("fn f(position: vec3f, parameters: vec4f) -> f32 {{ {body} }}");
    let (iterations, invalid) = (0, 1);
    let cases = [
        (Role::Intersection, intersection("loop {} return vec4f(0.0);"), iterations),
        (Role::Intersection, intersection("while true {} return vec4f(0.0);"), iterations),
        (Role::Intersection, intersection("for (var i = 0; i < 10; i += 0) {} return vec4f(0.0);"), iterations),
        (
            Role::Intersection,
            intersection("loop { continuing { break if nearest < -1.0; } } return vec4f(0.0);"),
            iterations,
        ),
        (
            Role::Intersection,
            intersection("for (var i = 0; i < 1000; i++) { for (var j = 0; j < 1000; j++) {} } return vec4f(1.0);"),
            iterations,
        ),
        (Role::Intersection, intersection("return vec4f(sqrt(parameters.x - 2.0));"), invalid),
        (Role::Intersection, intersection("return vec4f(0.0, 0.0, 0.0, nearest + 0.1);"), invalid),
        (Role::Intersection, intersection("return vec4f(1.0, 0.0, 0.0, 1.0 / (parameters.x - 1.0));"), invalid),
        (Role::Distance, distance("loop {} return 1.0;"), iterations),
        (Role::Distance, distance("return sqrt(-abs(position.x) - parameters.x);"), invalid),
    ];
    let world = |z: f64| DAffine3::from_scale_rotation_translation(DVec3::splat(0.1), DQuat::IDENTITY, DVec3::Z * z);
    let rays: Vec<Ray> = (0..100)
        .map(|i| Ray { origin: Vec3::new(0.0005 * i as f32, 0.002, 1.0), direction: Vec3::NEG_Z, t_max: 1e30 })
        .collect();
    for (role, source, kind) in &cases {
        let mut scene = Scene::default();
        let bad = Object {
            source,
            function: "f",
            role: *role,
            parameter: 1.0,
            world: world(0.5),
            material: surface(0.5, 0.0),
        };
        place(&mut scene, &[bad, sphere(Role::Intersection, world(0.0), surface(0.5, 0.0))]);
        let stage = stage(gpu, scene);
        let (answers, misses) = run(gpu, &stage, "closest", &rays);
        assert!(answers.iter().all(|answer| answer[3] == OBJECT | 1), "{source}: {:x?}", answers[0]);
        assert_eq!((misses[*kind], misses[1 - kind]), (100, 0), "{source}");
    }
}
