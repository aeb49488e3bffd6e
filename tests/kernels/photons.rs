//! Pass `photons` against a loop over all triangles along the same rays.

use std::sync::Arc;

use glam::{DAffine3, DQuat, DVec2, DVec3, Mat2, Vec2, Vec3, Vec4};
use kernel_kit::{Gpu, Resources, kernel_test};
use penumbra::Settings;
use penumbra::internal::bvh::Bvh;
use penumbra::internal::gpu_scene::GpuScene;
use penumbra::internal::kernels::compose_source;
use penumbra::internal::passes::grid::Photon;
use penumbra::internal::passes::photons::Photons;
use penumbra::internal::procedural::Role;
use penumbra::internal::scene::{
    AlphaMode, Camera, ColourSpace, EmitterTriangle, Filter, Light, LightKind, Material, NO_LIGHT, Projection, Scene,
    Texture, TextureImage, TextureInfo, Triangle, Vertex, Wrap,
};
use penumbra::internal::specialisation::Specialisation;
use penumbra::internal::specialisation::features::Features;

use crate::kit::new_kernel;
use crate::procedurals;
use crate::rooms::{Rectangle, Room, photon_normal};

const PLAIN: u32 = 0;
const DOUBLE_SIDED: u32 = 1;
const EMISSIVE: u32 = 2;
const MASKED: u32 = 3;

/// Alphas of the masked material's 4 x 4 texels; its cutoff is a half.
const HOLES: [u8; 16] = [0, 255, 100, 200, 130, 40, 255, 0, 255, 120, 0, 140, 90, 255, 200, 30];

fn material(double_sided: bool, emissive: Vec3) -> Material {
    Material { metallic: 0.0, emissive, double_sided, ..Material::default() }
}

/// A scene of rectangles in the order of its BVH. The rectangles of the emissive material are light 0; `more` lights
/// follow.
fn scene(rectangles: &[(Rectangle, u32)], more: Vec<LightKind>) -> (Scene, Bvh) {
    let mut corners = Vec::new();
    let mut materials = Vec::new();
    for (Rectangle(p, a, b), material) in rectangles {
        corners.extend([[*p, *p + *a, *p + *a + *b], [*p, *p + *a + *b, *p + *b]]);
        materials.extend([*material; 2]);
    }
    let bvh = Bvh::build(&corners).unwrap();
    let mut scene = Scene {
        materials: vec![material(false, Vec3::ZERO), material(true, Vec3::ZERO), material(false, Vec3::ONE)],
        ..Scene::default()
    };
    if materials.contains(&MASKED) {
        let texture = TextureInfo { texture: 0, uv_set: 0, matrix: Mat2::IDENTITY, offset: Vec2::ZERO };
        scene.materials.push(Material {
            alpha: AlphaMode::Mask { cutoff: 0.5 },
            base_colour_texture: Some(texture),
            ..material(true, Vec3::ZERO)
        });
        let texels = HOLES.map(|alpha| [255, 255, 255, alpha]).into();
        scene.images = vec![TextureImage { name: String::new(), width: 4, height: 4, texels }].into();
        let (wrap, filter, space) = ([Wrap::Clamp; 2], Filter::Nearest, ColourSpace::Srgb);
        scene.textures = vec![Texture { image: 0, wrap, filter, space }];
    }
    let mut emitters = Vec::new();
    for (primitive, at) in bvh.order.iter().enumerate() {
        let first = scene.vertices.len() as u32;
        // The two triangles of a rectangle, one after the other.
        let last = if at % 2 == 0 { [Vec2::X, Vec2::ONE] } else { [Vec2::ONE, Vec2::Y] };
        let uvs = [Vec2::ZERO, last[0], last[1]];
        let vertex = |(position, uv): (&Vec3, Vec2)| Vertex {
            position: *position,
            uv: [uv; 2],
            colour: Vec4::ONE,
            ..Vertex::default()
        };
        Arc::make_mut(&mut scene.vertices).extend(corners[*at as usize].iter().zip(uvs).map(vertex));
        let material = materials[*at as usize];
        let light = if material == EMISSIVE { 0 } else { NO_LIGHT };
        scene.triangles.push(Triangle { vertices: [first, first + 1, first + 2], material, light });
        if material == EMISSIVE {
            emitters.push(EmitterTriangle { triangle: primitive as u32, radiance: Vec3::ONE });
        }
    }
    let mesh = (!emitters.is_empty()).then_some(LightKind::Mesh { material: EMISSIVE, emitters });
    scene.lights = mesh.into_iter().chain(more).map(|kind| Light { name: String::new(), kind }).collect();
    (scene, bvh)
}

fn gpu_scene(gpu: &Gpu, scene: &Scene, bvh: Bvh, features: &Features) -> GpuScene {
    let camera = Camera {
        name: String::new(),
        position: Vec3::Z,
        axes: Vec3::AXES,
        projection: Projection::Perspective { yfov: 1.0, aspect: None },
        near: 0.0,
        far: f32::INFINITY,
        lens: None,
    };
    GpuScene::new(gpu, scene, bvh, &camera, [1, 1], features).unwrap()
}

struct Traced {
    photons: Vec<Photon>,
    emitted: Vec<u32>,
    stored: Vec<[u32; 2]>,
    /// Origin and direction, light by light, in the order of their numbers.
    rays: Vec<Vec<[Vec3; 2]>>,
}

const EMIT: &str = "
import package::lib::light::light_emit;
import package::lib::ray::offset_origin;
import package::lib::rng::hash3;
import package::lib::sampling::sobol4;
import package::lib::constants::DIMENSION_PHOTON;
@group(0) @binding(0) var<storage, read_write> rays: array<vec4f>;
@group(0) @binding(1) var<storage, read> request: array<u32, 3>;
@compute @workgroup_size(64)
fn emit(@builtin(global_invocation_id) id: vec3u) {
    if id.x >= request[2] { return; }
    let emitted = light_emit(request[0], sobol4(id.x, hash3(request[1], DIMENSION_PHOTON, request[0])));
    rays[2u * id.x] = vec4f(offset_origin(emitted.origin, emitted.normal), 0.0);
    rays[2u * id.x + 1u] = vec4f(emitted.direction, 0.0);
}";

fn trace(gpu: &Gpu, scene: &Scene, bvh: Bvh, per_light: u32, kept: u32) -> Traced {
    let specialisation = Specialisation::new(scene, None, &Settings::default());
    let features = penumbra::internal::specialisation::device_features(gpu, specialisation.features);
    let gpu_scene = gpu_scene(gpu, scene, bvh, &features);
    let pass = Photons::new(gpu, &features, &gpu_scene.constants(), kept).unwrap();
    let lights = scene.lights.len() as u32;
    let traced = pass.trace(gpu, &gpu_scene, lights, per_light, 9, 5).unwrap();
    let composed = compose_source("emit", EMIT, &features).unwrap();
    let kernel = new_kernel(gpu, &composed, &composed.overrides(&gpu_scene.constants()), &[]).unwrap();
    let rays = (0..lights).map(|light| {
        let rays = gpu.poisoned::<[f32; 4]>("test/rays", 2 * per_light as usize).unwrap();
        let request = gpu.upload("test/request", &[light, 9, per_light]).unwrap();
        let own = Resources::new().with("rays", &rays).with("request", &request);
        let bound = kernel.bind(gpu, "emit", &[&own, &gpu_scene]).unwrap();
        let mut frame = gpu.frame("test");
        frame.run(&bound, per_light, &[0u32; 0]);
        frame.submit().unwrap();
        let rays: Vec<[f32; 4]> = gpu.read(&rays, 2 * per_light as usize).unwrap();
        let vector = |v: [f32; 4]| Vec3::new(v[0], v[1], v[2]);
        rays.chunks_exact(2).map(|r| [vector(r[0]), vector(r[1])]).collect()
    });
    let rays = rays.collect();
    Traced {
        photons: gpu.read(&traced.photons, traced.count as usize).unwrap(),
        emitted: traced.emitted,
        stored: traced.stored,
        rays,
    }
}

/// The photons that a ray should store: position, normal, whether a shadow photon. `None` if a hit is within 1e-5 of an
/// edge, where rounding decides.
fn expected(scene: &Scene, ray: &[Vec3; 2]) -> Option<Vec<(DVec3, DVec3, bool)>> {
    let (origin, direction) = (ray[0].as_dvec3(), ray[1].as_dvec3());
    let mut hits: Vec<(f64, bool, DVec3)> = Vec::new();
    for triangle in &scene.triangles {
        let [a, b, c] = triangle.vertices.map(|v| scene.vertices[v as usize].position.as_dvec3());
        let (e1, e2) = (b - a, c - a);
        let n = e1.cross(e2);
        let determinant = -direction.dot(n);
        if determinant == 0.0 {
            continue;
        }
        let t = (origin - a).dot(n) / determinant;
        let p = origin + direction * t - a;
        let v = n.dot(e1.cross(p)) / n.length_squared();
        let u = n.dot(p.cross(e2)) / n.length_squared();
        let inside = u.min(v).min(1.0 - u - v);
        // The diagonal of a rectangle is not an edge: both sides belong to the same surface.
        let diagonal = (u.min(v) < 1e-5) as u32 + ((1.0 - u - v) < 1e-5) as u32 > 0;
        if inside.abs() < 1e-5 && diagonal {
            return None;
        }
        if triangle.material == MASKED {
            let uvs = triangle.vertices.map(|v| scene.vertices[v as usize].uv[0].as_dvec2());
            let texel = (uvs[0] + u * (uvs[1] - uvs[0]) + v * (uvs[2] - uvs[0])) * 4.0;
            // Barycentric coordinates that are off by 1e-5 move the position by 4e-5 of a texel.
            if inside > 0.0 && (texel - texel.round()).abs().min_element() < 1e-4 {
                return None;
            }
            let at = texel.clamp(DVec2::ZERO, DVec2::splat(3.5)).as_uvec2();
            if HOLES[(at.x + 4 * at.y) as usize] < 128 {
                continue;
            }
        }
        if inside > 0.0 && t > 1e-7 {
            let double_sided = scene.materials[triangle.material as usize].double_sided;
            let faces = determinant > 0.0;
            hits.push((t, faces || double_sided, n.normalize() * if faces { 1.0 } else { -1.0 }));
        }
    }
    // Procedural objects are spheres of radius 1 in their own space.
    for object in &scene.procedurals {
        let o = object.to_own.transform_point3(origin);
        let d = object.to_own.transform_vector3(direction);
        let along = -o.dot(d) / d.length_squared();
        let offset = (o + along * d).length();
        if (offset - 1.0).abs() < 0.01 {
            return None;
        }
        let half = (1.0 - offset * offset).max(0.0).sqrt() / d.length();
        for t in [along - half, along + half] {
            if half > 0.0 && t > 1e-7 {
                let outward = (object.to_own.matrix3.transpose() * (o + t * d)).normalize();
                let faces = outward.dot(direction) < 0.0;
                let double_sided = scene.materials[object.material as usize].double_sided;
                hits.push((t, faces || double_sided, outward * if faces { 1.0 } else { -1.0 }));
            }
        }
    }
    hits.sort_by(|a, b| a.0.total_cmp(&b.0));
    // Of coplanar twins, the one that stores the photon comes first.
    hits.dedup_by(|twin, kept| {
        let same = twin.0 - kept.0 < 1e-6;
        if same && !kept.1 {
            *kept = *twin;
        }
        same
    });
    let photon = |(rank, hit): (usize, &(f64, bool, DVec3))| (origin + direction * hit.0, hit.2, rank > 0);
    Some(hits.iter().enumerate().filter(|(_, hit)| hit.1).map(photon).collect())
}

/// Photons of `traced` that match no expected one, expected photons that match none of `traced`, and undecided rays.
fn compare(scene: &Scene, traced: &Traced) -> (usize, usize, usize) {
    let mut left: Vec<Photon> = traced.photons.clone();
    left.sort_by(|a, b| a.position[0].total_cmp(&b.position[0]));
    let mut taken = vec![false; left.len()];
    let (mut missing, mut doubtful) = (0, 0);
    for (light, rays) in traced.rays.iter().enumerate() {
        for ray in rays {
            let Some(photons) = expected(scene, ray) else {
                doubtful += 1;
                continue;
            };
            for (position, normal, shadow) in photons {
                let near = |x: f32| f64::from(x) > position.x - 1e-5;
                let first = left.partition_point(|p| !near(p.position[0]));
                let found =
                    (first..left.len()).take_while(|i| f64::from(left[*i].position[0]) < position.x + 1e-5).find(|i| {
                        let p = &left[*i];
                        !taken[*i]
                            && Vec3::from(p.position).as_dvec3().distance(position) < 1e-5
                            && (p.word >> 31 != 0) == shadow
                            && (p.word >> 14) & 0x7ff == light as u32
                            // The maximum error of the normal's code.
                            && photon_normal(p.word).dot(normal) > 0.035f64.cos()
                    });
                match found {
                    Some(i) => taken[i] = true,
                    None => missing += 1,
                }
            }
        }
    }
    (taken.iter().filter(|t| !**t).count(), missing, doubtful)
}

fn room_scene(more: Vec<LightKind>) -> (Scene, Bvh) {
    let v = Vec3::new;
    let mut rectangles: Vec<_> = Room::new(0.2).rectangles.into_iter().map(|r| (r, PLAIN)).collect();
    rectangles.push((Rectangle(v(-0.2, 0.495, -0.2), v(0.4, 0.0, 0.0), v(0.0, 0.0, 0.4)), EMISSIVE));
    // A double-sided shelf, and a sheet of two coplanar rectangles back to back.
    rectangles.push((Rectangle(v(-0.45, 0.1, -0.3), v(0.0, 0.0, 0.3), v(0.3, 0.1, 0.0)), DOUBLE_SIDED));
    rectangles.push((Rectangle(v(-0.3, -0.2, 0.0), v(0.0, 0.0, 0.3), v(0.3, 0.0, 0.0)), PLAIN));
    rectangles.push((Rectangle(v(-0.3, -0.2, 0.0), v(0.3, 0.0, 0.0), v(0.0, 0.0, 0.3)), PLAIN));
    scene(&rectangles, more)
}

/// A room with a double-sided shelf, coplanar twins and three kinds of lights: photons and counts equal those of a loop
/// over all triangles. A photon that is lost, moved, or of another light is detected.
#[kernel_test("PENUMBRA_DEVICE")]
fn photons_are_those_of_a_loop_over_all_triangles(gpu: &Gpu) {
    let point = LightKind::Point { position: Vec3::new(0.2, 0.3, 0.3), intensity: Vec3::ONE, range: f32::INFINITY };
    let sun = LightKind::Directional { direction: Vec3::new(0.3, -0.9, -0.2).normalize(), irradiance: Vec3::ONE };
    let (scene, bvh) = room_scene(vec![point, sun]);
    let mut traced = trace(gpu, &scene, bvh, 3001, 10);
    let (extra, missing, doubtful) = compare(&scene, &traced);
    assert_eq!(missing, 0);
    // Undecided rays store photons too, at most one for each rectangle.
    assert!(doubtful < 30 && extra <= doubtful * 8, "{doubtful} in doubt, {extra} more");
    assert_eq!(traced.emitted, [3001; 3]);
    for (light, stored) in traced.stored.iter().enumerate() {
        let of = |shadow: u32| {
            let matches = |p: &&Photon| (p.word >> 14) & 0x7ff == light as u32 && p.word >> 31 == shadow;
            traced.photons.iter().filter(matches).count() as u32
        };
        assert_eq!(*stored, [of(0), of(1)]);
        // Sunlight mostly hits the outside of the ceiling first, which stores nothing.
        assert!(stored[0] > 200 && stored[1] > 100, "{stored:?}");
    }
    let dropped = traced.photons.pop().unwrap();
    assert_eq!(compare(&scene, &traced).1, 1);
    for fault in [1 << 31, 1 << 14, 40] {
        traced.photons.push(Photon { word: dropped.word ^ fault, ..dropped });
        assert_eq!(compare(&scene, &traced).1, 1, "fault {fault:x}");
        traced.photons.pop();
    }
}

/// Photons pass through the holes of a mask, and the rest of the mask stops them: the surface behind is partly lit and
/// partly shadowed. A mask that stops all photons, and one that stops none, are detected.
#[kernel_test("PENUMBRA_DEVICE")]
fn holes_of_masks_let_photons_through(gpu: &Gpu) {
    let v = Vec3::new;
    let light = LightKind::Point { position: v(0.1, 0.6, 0.0), intensity: Vec3::ONE, range: f32::INFINITY };
    let square = |y: f32, half: f32| Rectangle(v(-half, y, -half), v(0.0, 0.0, 2.0 * half), v(2.0 * half, 0.0, 0.0));
    let (scene, bvh) = scene(&[(square(0.0, 0.7), PLAIN), (square(0.3, 0.35), MASKED)], vec![light]);
    let traced = trace(gpu, &scene, bvh, 20_000, 10);
    let (extra, missing, doubtful) = compare(&scene, &traced);
    assert_eq!(missing, 0);
    assert!(doubtful < 200 && extra <= 2 * doubtful, "{doubtful} in doubt, {extra} more");
    let [lit, shadow] = traced.stored[0];
    assert!(lit > 1000 && shadow > 500, "{lit} lit, {shadow} shadow photons");
    for alpha in [AlphaMode::Opaque, AlphaMode::Mask { cutoff: 1.1 }] {
        let (mut other, bvh) = self::scene(
            &[(square(0.0, 0.7), PLAIN), (square(0.3, 0.35), MASKED)],
            scene.lights.iter().map(|light| light.kind.clone()).collect(),
        );
        other.materials[MASKED as usize].alpha = alpha;
        assert!(compare(&scene, &trace(gpu, &other, bvh, 20_000, 10)).1 > 500, "{alpha:?} is not detected");
    }
}

/// A rectangle and its light: each ray stores one photon or none, and no shadow photon.
#[kernel_test("PENUMBRA_DEVICE")]
fn one_rectangle_takes_no_shadow_photons(gpu: &Gpu) {
    let v = Vec3::new;
    let light = LightKind::Point { position: v(0.0, 0.5, 0.0), intensity: Vec3::ONE, range: f32::INFINITY };
    let floor = Rectangle(v(-0.5, 0.0, -0.5), v(0.0, 0.0, 1.0), v(1.0, 0.0, 0.0));
    let (scene, bvh) = scene(&[(floor, PLAIN)], vec![light]);
    let traced = trace(gpu, &scene, bvh, 5000, 10);
    assert_eq!(traced.stored[0][1], 0);
    assert_eq!(traced.stored[0][0] as usize, traced.photons.len());
    // From half its edge above its centre, a square covers a sixth of all directions.
    // Two standard deviations of a binomial, 26 each. Rays are stratified, so their number varies less.
    assert!((traced.photons.len() as f64 - 5000.0 / 6.0).abs() < 5000.0 * 0.01, "{}", traced.photons.len());
}

/// A wall 1e-5 thick has illumination photons on the lit side only, and no shadow photons: its other side faces away
/// from the light.
#[kernel_test("PENUMBRA_DEVICE")]
fn thin_walls_are_lit_on_one_side(gpu: &Gpu) {
    let v = Vec3::new;
    let light = LightKind::Point { position: v(0.0, 0.5, 0.0), intensity: Vec3::ONE, range: f32::INFINITY };
    let up = Rectangle(v(-0.5, 0.0, -0.5), v(0.0, 0.0, 1.0), v(1.0, 0.0, 0.0));
    let down = Rectangle(v(-0.5, -1e-5, -0.5), v(1.0, 0.0, 0.0), v(0.0, 0.0, 1.0));
    let (scene, bvh) = scene(&[(up, PLAIN), (down, PLAIN)], vec![light]);
    let traced = trace(gpu, &scene, bvh, 5000, 10);
    assert!(traced.photons.len() > 500);
    for photon in &traced.photons {
        assert!(photon.word >> 31 == 0 && photon.position[1] == 0.0 && photon_normal(photon.word).y == 1.0);
    }
}

/// Ten thousand layers: ten shadow photons per ray, each of which represents a tenth of the hits, spread over the
/// layers.
#[kernel_test("PENUMBRA_DEVICE")]
fn layers_beyond_the_cap_are_weighted(gpu: &Gpu) {
    let v = Vec3::new;
    let light = LightKind::Directional { direction: -Vec3::Y, irradiance: Vec3::ONE };
    let layer = |i: u32| (Rectangle(v(-0.5, -1e-4 * i as f32, -0.5), v(0.0, 0.0, 1.0), v(1.0, 0.0, 0.0)), PLAIN);
    let (scene, bvh) = scene(&(0..10_000).map(layer).collect::<Vec<_>>(), vec![light]);
    let traced = trace(gpu, &scene, bvh, 200, 10);
    let [lit, shadow] = traced.stored[0];
    assert!(lit > 50 && shadow == 10 * lit, "{lit} lit, {shadow} shadow photons");
    let shadows: Vec<_> = traced.photons.iter().filter(|p| p.word >> 31 != 0).collect();
    for photon in &shadows {
        let weight = 2f64.powf(f64::from((photon.word >> 25) & 63) / 4.0);
        // Quarter powers of two are within 9.1 %.
        assert!((weight / 999.9).ln().abs() < 0.091, "{weight}");
    }
    // The mean depth of n layers sampled uniformly from depths 0 to 1 is within 5 standard errors of 1/2.
    let mean = shadows.iter().map(|p| -f64::from(p.position[1])).sum::<f64>() / shadows.len() as f64;
    assert!((mean - 0.5).abs() < 5.0 / (12.0 * shadows.len() as f64).sqrt(), "{mean}");
}

/// Coplanar surfaces count as one, also where more are hit than are kept, and where only some are doubled.
#[kernel_test("PENUMBRA_DEVICE")]
fn coplanar_layers_beyond_the_cap_count_once(gpu: &Gpu) {
    let v = Vec3::new;
    let (a, b) = (v(0.0, 0.0, 1.0), v(1.0, 0.0, 0.0));
    for doubled in [1, 2] {
        let light = LightKind::Directional { direction: -Vec3::Y, irradiance: Vec3::ONE };
        // The other rectangle has the other diagonal.
        let layer = |i: usize| {
            let corner = v(-0.5, -1e-3 * i as f32, -0.5);
            let all = [(Rectangle(corner, a, b), PLAIN), (Rectangle(corner + a, b, -a), PLAIN)];
            all.into_iter().take(if i.is_multiple_of(doubled) { 2 } else { 1 })
        };
        let (scene, bvh) = scene(&(0..1000).flat_map(layer).collect::<Vec<_>>(), vec![light]);
        let traced = trace(gpu, &scene, bvh, 200, 10);
        let [lit, shadow] = traced.stored[0];
        assert!(lit > 50 && shadow == 10 * lit, "{lit} lit, {shadow} shadow photons");
        let shadows: Vec<_> = traced.photons.iter().filter(|p| p.word >> 31 != 0).collect();
        let weight = |photon: &&Photon| 2f64.powf(f64::from((photon.word >> 25) & 63) / 4.0);
        let mean = shadows.iter().map(weight).sum::<f64>() / shadows.len() as f64;
        // Quarter powers of two are within 9.1 %, and the ratio of all hits to those of ten layers is 1 % too large on
        // average. If all hits counted, it would be twice or one and a half times as much.
        println!("one in {doubled} doubled: {mean:.1} layers each");
        assert!((mean / 99.9).ln().abs() < 0.1, "one in {doubled}: {mean}");
        // Doubled layers are kept no more often than others: a half of them, or all.
        let is_doubled = |p: &&&Photon| ((-1e3 * p.position[1]).round() as usize).is_multiple_of(doubled);
        let share = shadows.iter().filter(is_doubled).count() as f64 / shadows.len() as f64;
        let expected = 1.0 / doubled as f64;
        // Five standard errors, as of independent photons.
        assert!((share - expected).abs() <= 5.0 * (0.25 / shadows.len() as f64).sqrt(), "{share}, not {expected}");
    }
}

/// With more rays than a batch and more photons than the first buffer holds, no photon is lost, and another run gives
/// the same set.
#[kernel_test("PENUMBRA_DEVICE")]
fn batches_lose_nothing(gpu: &Gpu) {
    let v = Vec3::new;
    let light = LightKind::Directional { direction: -Vec3::Y, irradiance: Vec3::ONE };
    let layer = |i: u32| (Rectangle(v(-0.5, -0.1 * i as f32, -0.5), v(0.0, 0.0, 1.0), v(1.0, 0.0, 0.0)), PLAIN);
    let (scene, bvh) = scene(&(0..8).map(layer).collect::<Vec<_>>(), vec![light]);
    let mut sets = [bvh.clone(), bvh].map(|bvh| {
        let traced = trace(gpu, &scene, bvh, 150_001, 64);
        let [lit, shadow] = traced.stored[0];
        assert!(shadow == 7 * lit && lit > 50_000, "{lit} lit, {shadow} shadow photons");
        assert_eq!((lit + shadow) as usize, traced.photons.len());
        traced.photons.iter().map(|p| (p.position.map(f32::to_bits), p.word)).collect::<Vec<_>>()
    });
    sets.iter_mut().for_each(|set| set.sort_unstable());
    assert!(sets[0] == sets[1]);
}

/// Nested procedural spheres and an ellipsoid, single- and double-sided: photons are stored at every crossing of a
/// straight line, by closed form. An object that is a hundredth larger is detected.
#[kernel_test("PENUMBRA_DEVICE")]
fn photons_meet_every_crossing_of_procedural_objects(gpu: &Gpu) {
    let point = LightKind::Point { position: Vec3::new(0.2, 0.3, 0.3), intensity: Vec3::ONE, range: f32::INFINITY };
    let (mut scene, bvh) = room_scene(vec![point]);
    let at = |size: DVec3, x: f64| {
        DAffine3::from_scale_rotation_translation(size, DQuat::from_rotation_y(0.5), DVec3::new(x, -0.1, 0.1))
    };
    procedurals::place(
        &mut scene,
        &[
            procedurals::sphere(Role::Intersection, at(DVec3::splat(0.2), 0.0), material(false, Vec3::ZERO)),
            procedurals::sphere(Role::Distance, at(DVec3::splat(0.1), 0.02), material(true, Vec3::ZERO)),
            procedurals::sphere(Role::Intersection, at(DVec3::new(0.1, 0.2, 0.07), -0.3), material(true, Vec3::ZERO)),
        ],
    );
    let traced = trace(gpu, &scene, bvh, 3001, 10);
    let (extra, missing, doubtful) = compare(&scene, &traced);
    assert_eq!(missing, 0);
    assert!(doubtful < 300 && extra <= doubtful * 12, "{doubtful} in doubt, {extra} more");
    scene.procedurals[0].to_own.matrix3 /= 1.01;
    let (_, missing, _) = compare(&scene, &traced);
    assert!(missing > 100, "a hundredth more is {missing} photons");
}
