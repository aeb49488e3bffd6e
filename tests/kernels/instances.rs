//! Rays through instances (`shaders/lib/{bvh,instance}.wgsl`) against a loop over all triangles in double
//! precision.

use std::sync::Arc;

use glam::{DMat3, DVec3, Mat3, Quat, Vec3, vec3};
use kernel_kit::{Gpu, Resources, kernel_test};
use penumbra::internal::bvh::Bvh;
use penumbra::internal::kernels::compose_source;
use penumbra::internal::scene::{Instance, NO_LIGHT, Scene, SharedMesh, Vertex};
use penumbra::internal::specialisation::features::{Feature, Features};

use crate::kit::{device_features, new_kernel};
use crate::traverse::{
    self, Answer, NO_HIT, Random, Ray, Triangle, answer, closed_box, meeting, random_rays, ray, soup, tables,
};

/// A scene of triangles, and of instances of meshes.
fn scene(flat: &[Triangle], meshes: &[Vec<Triangle>], instances: Vec<Instance>) -> Scene {
    let mut scene = Scene { instances, ..Scene::default() };
    let add = |scene: &mut Scene, triangles: &[Triangle]| {
        let first = (scene.triangles.len(), scene.vertices.len());
        for corners in triangles {
            let vertices = [0, 1, 2].map(|corner| scene.vertices.len() as u32 + corner);
            scene.triangles.push(penumbra::internal::scene::Triangle { vertices, material: 0, light: NO_LIGHT });
            Arc::make_mut(&mut scene.vertices).extend(corners.map(|position| Vertex { position, ..Vertex::default() }));
        }
        SharedMesh { triangles: first.0..scene.triangles.len(), vertices: first.1..scene.vertices.len() }
    };
    add(&mut scene, flat);
    for mesh in meshes {
        let shared = add(&mut scene, mesh);
        scene.shared_meshes.push(shared);
    }
    scene
}

/// An instance that is turned and then stretched, up to five and a half times as much along one axis as along another.
fn instance(random: &mut Random, mesh: usize, size: f32, origin: Vec3) -> Instance {
    let axis = random.direction();
    let turned = Mat3::from_quat(Quat::from_axis_angle(axis, 6.0 * random.number()));
    let stretch = match mesh {
        0 => vec3(1.0, 1.0, 5.5),
        _ => vec3(0.5 + random.number(), 1.0, 0.5 + random.number()),
    };
    let linear = Mat3::from_diagonal(size * stretch) * turned;
    Instance { mesh, linear, origin }
}

/// Soups at many sizes in a soup, some in others, one far from all others, and one that is tiny.
fn crowded() -> Scene {
    let mut random = Random(5);
    let mut instances = Vec::new();
    for i in 0..40 {
        let size = [0.02, 0.1, 0.3][i % 3];
        let at = random.point();
        instances.push(instance(&mut random, i % 2, size, at));
    }
    instances.push(instance(&mut random, 0, 1.0, vec3(40.0, -30.0, 20.0)));
    instances.push(instance(&mut random, 1, 1e-4, vec3(0.3, 0.2, 0.1)));
    let centre = instances[1].origin;
    instances.push(instance(&mut random, 0, 0.01, centre));
    let small = |count: usize, size: f32| -> Vec<Triangle> {
        soup(count, size).into_iter().map(|triangle| triangle.map(|corner| 0.5 * corner)).collect()
    };
    scene(&soup(100, 0.2), &[small(64, 0.5), small(300, 0.2)], instances)
}

/// Rays of all kinds, half of them towards the instances.
fn rays_at(scene: &Scene, count: usize) -> Vec<Ray> {
    let mut random = Random(17);
    let mut rays = random_rays(count);
    for (i, ray) in rays.iter_mut().enumerate().filter(|(i, _)| i % 2 == 0) {
        let instance = &scene.instances[i / 2 % scene.instances.len()];
        let target = instance.apply(0.4 * random.point());
        ray.direction = (target - ray.origin).normalize();
    }
    rays
}

/// A BVH on the device, and its contents.
struct Traced {
    scene: Scene,
    bvh: Bvh,
    features: Features,
}

/// A triangle in the scene, in double precision.
struct Placed {
    primitive: u32,
    corners: [DVec3; 3],
    /// The error of rays and points in its instance's space, in roundings of their distance from the ray's origin.
    roundings: f64,
}

impl Traced {
    fn new(gpu: &Gpu, scene: Scene) -> Self {
        let mut bvh = Bvh::of(&scene).unwrap();
        for primitive in 0..scene.triangles.len() as u32 {
            bvh.set_triangle_word(primitive, 3 * primitive);
        }
        let features = device_features(gpu).with(Feature::Instances, bvh.instances.is_some());
        // Rays are traced one by one.
        Traced { scene, bvh, features: features.with(Feature::Packets, false) }
    }

    /// The instance of each record of the table, by its transform; `None` for triangles that are in no instance.
    fn records(&self) -> Vec<Option<Instance>> {
        let table = self.bvh.instances.unwrap();
        let rows = self.bvh.triangles[table.base as usize..].chunks(7).map(|record| [record[4], record[5], record[6]]);
        let of = |rows: [[f32; 4]; 3]| {
            let own = |i: &&Instance| (0..3).all(|a| rows[a] == i.linear.row(a).extend(i.origin[a]).to_array());
            self.scene.instances.iter().find(own).copied()
        };
        rows.map(of).collect()
    }

    /// All triangles in the scene.
    fn placed(&self) -> Vec<Placed> {
        let table = self.bvh.instances.unwrap();
        let stored = |at: usize| self.scene.triangle_positions(self.bvh.order[at] as usize);
        let mut all = Vec::new();
        for at in 0..table.unshared {
            let corners = stored(at as usize).map(|p| p.as_dvec3());
            all.push(Placed { primitive: at, corners, roundings: 0.0 });
        }
        for (number, instance) in self.records().into_iter().enumerate() {
            let Some(instance) = instance else { continue };
            for (within, at) in self.scene.shared_meshes[instance.mesh].triangles.clone().enumerate() {
                let primitive = table.unshared + ((number as u32) << table.shift) + within as u32;
                let corners = stored(at).map(|p| instance.apply_f64(p));
                // As ray_in_mesh says, without the square root that turns a largest coordinate into a distance.
                all.push(Placed { primitive, corners, roundings: 81.0 });
            }
        }
        all
    }

    fn run(&self, gpu: &Gpu, source: &str, entry: &str, rays: &[Ray], words: usize) -> Vec<[u32; 4]> {
        let composed = compose_source("instances", source, &self.features).unwrap();
        let mut constants = vec![("ray_count", rays.len() as f64), ("primitive_count", 0.0)];
        constants.extend(self.bvh.instances.iter().flat_map(|table| table.constants()));
        let constants = composed.overrides(&constants);
        let kernel = new_kernel(gpu, &composed, &constants, &["rays", "answers"]).unwrap();
        let [nodes, triangles] = tables(gpu, &self.bvh, &self.features);
        let set = Resources::new().with("bvh_nodes", &nodes).with("bvh_triangles", &triangles);
        traverse::trace(gpu, &kernel, entry, rays, words, &set)
    }

    fn trace(&self, gpu: &Gpu, entry: &str, rays: &[Ray]) -> Vec<[u32; 4]> {
        self.run(gpu, include_str!("shaders/traverse.wgsl"), entry, rays, 1)
    }

    fn closest(&self, gpu: &Gpu, rays: &[Ray]) -> Vec<Answer> {
        self.trace(gpu, "closest", rays).into_iter().map(answer).collect()
    }
}

/// What a ray meets of a triangle, with the errors of its instance.
fn met(ray: &Ray, placed: &Placed) -> (f64, f64, [f64; 2]) {
    let met = meeting(ray, placed.corners);
    // `meeting` has eight roundings.
    let more = 1.0 + placed.roundings / 8.0;
    (met.t, met.inside, [more * met.slack, more * met.t_slack])
}

/// Compares hits with a loop over all triangles: what is wrong, and how many answers rounding leaves undecided.
fn compare(traced: &Traced, rays: &[Ray], answers: &[Answer]) -> (Vec<String>, usize) {
    let all = traced.placed();
    let (mut wrong, mut unsure) = (Vec::new(), 0);
    for (i, (ray, answer)) in rays.iter().zip(answers).enumerate() {
        let mut found = answer.primitive == NO_HIT;
        let mut nearer_unsure = false;
        for placed in &all {
            let (t, inside, [slack, t_slack]) = met(ray, placed);
            if placed.primitive == answer.primitive {
                let off = (f64::from(answer.t) - t).abs();
                found = inside >= -slack && off <= t_slack && answer.t <= ray.t_max;
            }
            let before = |slack: f64| t + slack < f64::from(answer.t.min(ray.t_max)) && t - slack > 0.0;
            if inside > slack && before(2.0 * t_slack) {
                wrong.push(format!("ray {i}: {answer:?}, but primitive {} is met at {t}", placed.primitive));
            }
            nearer_unsure |= inside.abs() <= slack && before(0.0);
        }
        if !found {
            wrong.push(format!("ray {i}: {answer:?} is not there"));
        }
        unsure += usize::from(nearer_unsure);
    }
    (wrong, unsure)
}

/// The closest hit is that of a loop over the triangles of all instances: turned, stretched, nested, tiny and far away.
/// Textures and storage buffers give the same bits.
#[kernel_test("PENUMBRA_DEVICE")]
fn closest_hits_are_those_of_all_instances(gpu: &Gpu) {
    let mut traced = Traced::new(gpu, crowded());
    let mut rays = rays_at(&traced.scene, 2000);
    // From afar, and with directions of other lengths.
    for ray in rays.iter_mut().skip(1600) {
        *ray = Ray { origin: 20.0 * ray.origin, direction: -0.7 * ray.origin, ..*ray };
    }
    let answers = traced.closest(gpu, &rays);
    let (wrong, unsure) = compare(&traced, &rays, &answers);
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
    let unshared = traced.bvh.instances.unwrap().unshared;
    let hits = answers.iter().filter(|answer| answer.primitive != NO_HIT).count();
    let of_instances = answers.iter().filter(|answer| (unshared..NO_HIT).contains(&answer.primitive)).count();
    println!("{hits} hits, {of_instances} of instances, {unsure} answers are undecided");
    assert!(unsure < 40, "{unsure} of 2000 answers are undecided");
    assert!((700..1900).contains(&hits) && (300..hits - 100).contains(&of_instances));
    let other_table = !traced.features.has(Feature::TextureLoads);
    traced.features = traced.features.clone().with(Feature::TextureLoads, other_table);
    assert_eq!(answers, traced.closest(gpu, &rays), "the other kind of table");
    traced.features = traced.features.clone().with(Feature::LayeredTexels, true);
    assert_eq!(answers, traced.closest(gpu, &rays), "tables in layers");
}

/// A ray is occluded, and a line counts, by all triangles of all instances.
#[kernel_test("PENUMBRA_DEVICE")]
fn occlusion_and_lines_are_those_of_all_instances(gpu: &Gpu) {
    let traced = Traced::new(gpu, crowded());
    let mut rays = rays_at(&traced.scene, 1000);
    rays.iter_mut().for_each(|ray| ray.t_max = 1.5);
    let (occluded, lines) = (traced.trace(gpu, "occluded", &rays), traced.trace(gpu, "line", &rays));
    let all = traced.placed();
    let (mut sure, mut most) = (0, 0);
    for ((ray, occluded), line) in rays.iter().zip(&occluded).zip(&lines) {
        let (mut count, mut sum, mut unsure) = (0, 0u32, false);
        for placed in &all {
            let (t, inside, [slack, t_slack]) = met(ray, placed);
            unsure |= inside.abs() <= slack && t > -t_slack && t < 1.5 + t_slack;
            unsure |= inside > 0.0 && (t.abs() <= t_slack || (t - 1.5).abs() <= t_slack);
            if inside > 0.0 && t > 0.0 && t <= 1.5 {
                count += 1;
                sum = sum.wrapping_add(placed.primitive);
            }
        }
        if !unsure {
            assert_eq!((*occluded, *line), ([u32::from(count > 0), 0, 0, 0], [count, sum, 0, 0]), "{ray:?}");
            sure += 1;
            most = most.max(count);
        }
    }
    assert!(sure > 900 && most > 5, "{sure} rays are sure, with up to {most} triangles");
}

/// Triangles that are in no shared mesh are hit with the bits that they have without instances.
#[kernel_test("PENUMBRA_DEVICE")]
fn triangles_beside_instances_keep_their_bits(gpu: &Gpu) {
    let flat = soup(200, 0.3);
    let apart = Instance { mesh: 0, linear: Mat3::IDENTITY, origin: vec3(500.0, 0.0, 0.0) };
    let with = Traced::new(gpu, scene(&flat, &[closed_box(0.5)], vec![apart]));
    let without = Traced::new(gpu, scene(&flat, &[], Vec::new()));
    let rays = random_rays(2000);
    let (a, b) = (with.closest(gpu, &rays), without.closest(gpu, &rays));
    let differing = a.iter().zip(&b).position(|(a, b)| a != b);
    assert!(differing.is_none(), "{:?}", differing.map(|i| (rays[i], a[i], b[i])));
    let hits = a.iter().filter(|answer| answer.primitive != NO_HIT).count();
    assert!(hits > 200, "{hits} hits prove nothing");
}

/// No ray leaves a closed mesh, wherever it is and however it is turned and stretched, even towards its edges and
/// corners.
#[kernel_test("PENUMBRA_DEVICE")]
fn instances_of_closed_meshes_have_no_gaps(gpu: &Gpu) {
    let mut random = Random(31);
    let sizes = [1.0, 0.1, 1e-3];
    let mut at = |i: usize| instance(&mut random, i % 2, sizes[i / 2], vec3(0.7 * i as f32, 0.3, -0.1 * i as f32));
    let instances: Vec<Instance> = (0..6).map(&mut at).collect();
    let traced = Traced::new(gpu, scene(&[], &[closed_box(0.5), closed_box(0.5)], instances.clone()));
    let mut rays = Vec::new();
    for i in 0..6000 {
        let instance = &instances[i % 6];
        let [a, b, c] = closed_box(0.5)[i / 6 % 12];
        let (from, to) = [(a, b), (b, c), (c, a)][i / 72 % 3];
        let target = instance.apply(if i % 5 == 0 { from } else { from.lerp(to, random.number()) });
        let origin = instance.apply(0.45 * random.point());
        rays.push(ray(origin, (target - origin).normalize()));
    }
    assert!(traced.closest(gpu, &rays).iter().all(|answer| answer.primitive != NO_HIT));
    assert!(traced.trace(gpu, "occluded", &rays).iter().all(|answer| *answer == [1, 0, 0, 0]));
}

/// Corners, normals and tangents of a hit are those of its instance.
#[kernel_test("PENUMBRA_DEVICE")]
fn surfaces_are_those_of_their_instance(gpu: &Gpu) {
    let traced = Traced::new(gpu, crowded());
    let rays = rays_at(&traced.scene, 1000);
    let table = traced.bvh.instances.unwrap();
    let (all, records) = (traced.placed(), traced.records());
    let words = traced.run(gpu, include_str!("shaders/instances.wgsl"), "met", &rays, 5);
    let vector = |words: &[u32; 4]| Vec3::from_array([0, 1, 2].map(|axis| f32::from_bits(words[axis]))).as_dvec3();
    let mut instances = 0;
    for (ray, words) in rays.iter().zip(words.as_chunks::<5>().0) {
        let primitive = words[0][3];
        if primitive == NO_HIT {
            continue;
        }
        let placed = all.iter().find(|placed| placed.primitive == primitive).unwrap();
        for (found, corner) in words.iter().zip(placed.corners) {
            // Three products and sums.
            assert!((vector(found) - corner).length() <= 4e-7 * (1.0 + corner.length()), "{corner}: {found:?}");
        }
        let stored = words[1][3];
        assert_eq!(words[2][3], 3 * stored, "the word of another triangle");
        let own = ray.direction.as_dvec3().normalize();
        let mut expected = [own; 2];
        if primitive >= table.unshared {
            instances += 1;
            let instance = records[((primitive - table.unshared) >> table.shift) as usize].unwrap();
            let within = (primitive - table.unshared) % (1 << table.shift);
            assert_eq!(stored, traced.scene.shared_meshes[instance.mesh].triangles.start as u32 + within);
            let linear: DMat3 = instance.linear.as_dmat3();
            expected = [linear.inverse().transpose() * own, linear * own];
        } else {
            assert_eq!(stored, primitive);
        }
        for (found, expected) in words[3..].iter().zip(expected) {
            assert!((vector(found) - expected.normalize()).length() < 1e-6, "{expected}: {found:?}");
        }
    }
    assert!(instances > 200, "{instances} hits of instances prove nothing");
}

/// The comparison finds an instance that is moved by a hundredth of its size, one that is turned the wrong way, one
/// that refers to another mesh, and a box of the upper tree that is too small.
#[kernel_test("PENUMBRA_DEVICE")]
fn planted_faults_are_found(gpu: &Gpu) {
    let scene = crowded();
    let rays = rays_at(&scene, 1000);
    let expected = Traced::new(gpu, scene.clone());
    let base = |traced: &Traced| traced.bvh.instances.unwrap().base as usize;
    let faults: [fn(&mut Bvh, usize); 4] = [
        |bvh, base| (0..3).for_each(|row| bvh.triangles[base + 7 * 3 + row][3] += 0.003),
        |bvh, base| {
            for record in bvh.triangles[base..].chunks_mut(7) {
                (record[0][1], record[1][0]) = (record[1][0], record[0][1]);
            }
        },
        |bvh, base| {
            let roots: Vec<f32> = bvh.triangles[base..].chunks(7).map(|record| record[3][0]).collect();
            bvh.triangles[base + 7 * 4 + 3][0] = *roots.iter().find(|root| **root != roots[4]).unwrap();
        },
        |bvh, _| bvh.nodes[1][2] = (bvh.nodes[1][2] / 2) & 0x7f7f_7f7f,
    ];
    for (number, fault) in faults.iter().enumerate() {
        let mut traced = Traced::new(gpu, scene.clone());
        let base = base(&traced);
        fault(&mut traced.bvh, base);
        let answers = traced.closest(gpu, &rays);
        assert!(!compare(&expected, &rays, &answers).0.is_empty(), "fault {number} is not found");
    }
}
