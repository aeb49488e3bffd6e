//! Pass `cache` against interpolation in f64 over all records that reach the point's block of the image.

use std::f64::consts::PI;

use bytemuck::Zeroable;
use glam::{DVec3, Vec3, Vec4};
use kernel_kit::{Gpu, POISON, Resources, kernel_test, whole_rows};
use penumbra::internal::gpu_scene::CameraUniform;
use penumbra::internal::kernels::{INVALID_POINT, PATH_GROUP};
use penumbra::internal::passes::cache::{Cache, CacheBuffers, ViewRecords, wanted};
use penumbra::internal::passes::gather::RecordHead;
use penumbra::internal::passes::path::PathQueue;
use penumbra::internal::passes::{Point, Tile, TileBuffers};
use penumbra::internal::specialisation::features::{Feature, Features};

use crate::kit::{device_features, published};
use crate::octahedral::oct_encode;
use crate::random::{Random, RandomInput as _};
use crate::rooms::{point, point_normal};
use crate::stage::whole;

/// Pixels of a block's side.
const BLOCK: f64 = 8.0;

/// A point whose records weigh less than this in total needs a record of its own.
const MIN_WEIGHT: f64 = 0.3;

/// Towards the viewer, at a grazing angle, where a glossy layer takes a fifth of the base's light.
const VIEW: DVec3 = DVec3::new(1.0, 0.2, 0.3);

/// Reflectance of the glossy layers at normal incidence, and their width.
const F0: f64 = 0.04;
const ALPHA: f64 = 0.3;

/// A record, and the part of the image that it reaches.
#[derive(Clone)]
struct Record {
    head: RecordHead,
    irradiance: DVec3,
    /// The translational gradient, by channel.
    translation: [DVec3; 3],
    rotation: [DVec3; 3],
    reach: Option<[[f32; 2]; 2]>,
}

struct Setup {
    /// Size of the image that is divided into blocks.
    size: [u32; 2],
    tile: Tile,
    points: Vec<Point>,
    albedos: Vec<Vec3>,
    records: Vec<Record>,
    features: Features,
}

struct Outcome {
    wanted: Vec<u32>,
    path_points: Vec<u32>,
    uncovered: Vec<u32>,
    radiance: Vec<[f32; 4]>,
}

/// Points in a slab and records among them; some points are invalid and some are black.
fn setup(size: [u32; 2], tile: Tile, record_count: usize, features: Features, random: &mut Random) -> Setup {
    let slab = |random: &mut Random| (random.point() * DVec3::new(0.5, 0.5, 0.01)).as_vec3();
    let about_z = |random: &mut Random| {
        let tilt = [0.0, 0.1, 0.5][(random.uniform() * 3.0) as usize];
        (DVec3::Z + tilt * random.direction()).normalize()
    };
    let count = tile.point_count as usize;
    let points = (0..count)
        .map(|_| {
            let valid = point(slab(random), Vec3::Z);
            if random.uniform() < 0.05 { Point { normal: INVALID_POINT, ..valid } } else { valid }
        })
        .collect();
    let albedos =
        (0..count).map(|_| if random.uniform() < 0.05 { Vec3::ZERO } else { random.point().abs().as_vec3() }).collect();
    let records = (0..record_count)
        .map(|_| {
            let head = RecordHead {
                position: slab(random).to_array(),
                size: (0.02 + 0.2 * random.uniform()) as f32,
                normal: about_z(random).as_vec3().to_array(),
                distance: 1.0,
            };
            // Gradients of up to ten times the irradiance over the unit: some are clamped.
            let mut vectors = || [0; 3].map(|_| (random.point() * 10.0).as_vec3().as_dvec3());
            let (translation, rotation) = (vectors(), vectors());
            let irradiance = random.point().abs().as_vec3().as_dvec3();
            let low = [0; 2].map(|_| random.uniform() as f32 * 1.2 - 0.2);
            let reach = [low, low.map(|from| from + random.uniform() as f32 * 0.7)];
            let reach = (random.uniform() < 0.9).then_some(reach);
            Record { head, irradiance, translation, rotation, reach }
        })
        .collect();
    Setup { size, tile, points, albedos, records, features: features.with(Feature::Indirect, true) }
}

/// The same points without records.
fn setup_like(other: &Setup) -> Setup {
    let Setup { size, tile, points, albedos, features, .. } = other;
    let (points, albedos) = (points.clone(), albedos.clone());
    Setup { size: *size, tile: *tile, points, albedos, records: Vec::new(), features: features.clone() }
}

/// The point's shading normal, which differs from its geometric normal.
fn shading_normal(i: usize) -> DVec3 {
    let angle = i as f64 * 0.37;
    DVec3::new(0.2 * angle.cos(), 0.2 * angle.sin(), 1.0).normalize()
}

impl Setup {
    fn bent(&self) -> bool {
        self.features.has(Feature::SmoothNormals) || self.features.has(Feature::NormalMaps)
    }

    /// The points next to each other, as those of a plane that the camera sees from above: most records in a block's
    /// list reach none of neighbouring points.
    fn on_a_plane(mut self) -> Setup {
        let Tile { width, height, first_row, samples_per_pixel, .. } = self.tile;
        for (i, point) in self.points.iter_mut().enumerate() {
            let pixel = i as u32 / samples_per_pixel;
            point.position[0] = (pixel % width) as f32 / width as f32 - 0.5;
            point.position[1] = (first_row + pixel / width) as f32 / height as f32 - 0.5;
        }
        self
    }

    fn view_records(&self, gpu: &Gpu) -> ViewRecords {
        let vectors = if self.bent() { 6 } else { 3 };
        let mut values = vec![[f32::NAN; 4]; whole_rows(self.records.len() * vectors)];
        for (values, record) in values.chunks_mut(vectors).zip(&self.records) {
            for c in 0..3 {
                values[c] = record.translation[c].as_vec3().extend(record.irradiance[c] as f32).to_array();
                if self.bent() {
                    values[3 + c] = record.rotation[c].as_vec3().extend(0.0).to_array();
                }
            }
        }
        let values = gpu.upload("test/values", &values).unwrap();
        let heads: Vec<RecordHead> = self.records.iter().map(|record| record.head).collect();
        let reach = |head: &RecordHead| {
            self.records.iter().find(|record| record.head.position == head.position).and_then(|record| record.reach)
        };
        ViewRecords::new(gpu, &heads, &values, self.size, reach).unwrap()
    }

    /// What the pass writes: where a subgroup interpolates at its points together, the same bits as where each lane
    /// interpolates alone.
    fn run(&self, gpu: &Gpu) -> Outcome {
        let outcome = self.run_with(gpu, &self.features);
        let alone = self.run_with(gpu, &self.features.clone().with(Feature::Packets, false));
        let bits = |outcome: &Outcome| outcome.radiance.iter().map(|light| light.map(f32::to_bits)).collect::<Vec<_>>();
        assert_eq!(bits(&outcome), bits(&alone), "together and alone");
        let lists = |outcome: &Outcome| [&outcome.wanted, &outcome.path_points, &outcome.uncovered].map(Clone::clone);
        assert_eq!(lists(&outcome), lists(&alone), "together and alone");
        outcome
    }

    fn run_with(&self, gpu: &Gpu, features: &Features) -> Outcome {
        self.run_after(gpu, features, None)
    }

    /// If there are other records `before`, the radiance is the change from their light to these records' light.
    fn run_after(&self, gpu: &Gpu, features: &Features, before: Option<&Setup>) -> Outcome {
        let count = self.points.len();
        let records = self.view_records(gpu);
        let mut tile = TileBuffers::new(gpu, features, self.tile.point_count, true).unwrap();
        let mut surfaces = Vec::new();
        for (i, albedo) in self.albedos.iter().enumerate() {
            surfaces.push(albedo.extend(f32::from_bits(oct_encode(shading_normal(i)))));
            if self.features.has(Feature::Glossy) {
                let [f0, f90] = [F0 as f32, 1.0].map(|part| if is_glossy(i) { part } else { 0.0 });
                surfaces.extend([Vec3::splat(f0).extend(f90), Vec4::new(f0, f90, ALPHA as f32, f32::NAN)]);
            }
        }
        tile.points = published(gpu, "test/points", &self.points);
        tile.surfaces = published(gpu, "test/surfaces", &surfaces);
        tile.radiance_indirect = Some(gpu.poisoned::<[f32; 4]>("test/radiance", count + 3).unwrap());
        let mut buffers = CacheBuffers::new(gpu, self.tile.point_count).unwrap();
        for queue in [&mut buffers.paths, &mut buffers.uncovered] {
            queue.points = gpu.poisoned::<u32>("test/path_points", count + 3).unwrap();
            queue.arguments = gpu.poisoned::<u32>("test/arguments", 4).unwrap();
        }
        let pass = Cache::new(gpu, features, &[]).unwrap();
        let backward = VIEW.normalize().as_vec3().to_array();
        let camera = CameraUniform { orthographic: 1, backward, ..CameraUniform::zeroed() };
        let camera = gpu.upload("test/camera", &[camera]).unwrap();
        let scene = Resources::new().with("camera", &camera);
        let bind = |records: &ViewRecords| pass.bind(gpu, &tile, &buffers, records, &[&scene]).unwrap();
        let bound = bind(&records);
        let before = before.map(|before| bind(&before.view_records(gpu)));
        let mut frame = gpu.frame("test");
        bound.record_requests(&mut frame, &buffers, &self.tile);
        match before {
            Some(before) => bound.record_change(&mut frame, &before, &buffers, &self.tile),
            None => bound.record_interpolate(&mut frame, &buffers, &self.tile),
        }
        frame.submit().unwrap();
        let mut radiance: Vec<[f32; 4]> = gpu.read(tile.radiance_indirect.as_ref().unwrap(), count + 3).unwrap();
        let beyond = radiance.split_off(count);
        assert!(beyond.iter().flatten().all(|v| v.to_bits() == POISON), "written behind the points");
        let [path_points, uncovered] = [&buffers.paths, &buffers.uncovered].map(|queue| queued(gpu, queue, count + 3));
        Outcome { wanted: wanted(gpu, &buffers).unwrap(), path_points, uncovered, radiance }
    }

    /// The share of the diffuse base that a viewer sees: a glossy layer takes what it reflects of light at the view's
    /// angle (Schlick), a tenth less at grazing angles for each tenth of its width.
    fn seen(&self, i: usize) -> f64 {
        if !(self.features.has(Feature::Glossy) && is_glossy(i)) {
            return 1.0;
        }
        let cosine = VIEW.normalize().dot(point_normal(oct_encode(shading_normal(i))));
        1.0 - (F0 + (1.0 - 0.9 * ALPHA - F0) * (1.0 - cosine).powi(5))
    }

    /// Irradiance and weight at a point, and the maximum rounding error of each.
    fn expected(&self, i: usize) -> (DVec3, f64, f64, f64) {
        let Tile { width, height, first_row, samples_per_pixel, .. } = self.tile;
        let pixel = i as u32 / samples_per_pixel;
        let film = [(pixel % width, width), (first_row + pixel / width, height)];
        // The block's span along each axis, in blocks.
        let block = [0, 1].map(|axis| {
            let (at, of) = film[axis];
            let last = (f64::from(self.size[axis]) / BLOCK).ceil() - 1.0;
            ((f64::from(at) + 0.5) / f64::from(of) * f64::from(self.size[axis]) / BLOCK).floor().min(last)
        });
        let reaches = |record: &&Record| {
            record.reach.is_some_and(|[low, high]| {
                (0..2).all(|axis| {
                    let blocks = f64::from(self.size[axis]) / BLOCK;
                    let [low, high] = [low, high].map(|end| f64::from(end[axis]) * blocks);
                    // A reach that ends outside the image includes its first blocks: the coordinates of corners are
                    // clamped.
                    low.max(0.0) < block[axis] + 1.0 && high.max(0.0) >= block[axis]
                })
            })
        };
        let x = Vec3::from(self.points[i].position).as_dvec3();
        let n = point_normal(oct_encode(shading_normal(i)));
        let (mut sum, mut weight) = (DVec3::ZERO, 0.0);
        // Errors of the weight, and of the sum.
        let (mut off, mut sum_off) = (0.0, 0.0);
        for Record { head, irradiance, translation, rotation, .. } in self.records.iter().filter(reaches) {
            let side = Vec3::from(head.normal).as_dvec3();
            let offset = x - Vec3::from(head.position).as_dvec3();
            let off_plane = offset.dot((n + side) / 2.0);
            let distance = (offset.length_squared() + 99.0 * off_plane.powi(2)).sqrt() / f64::from(head.size);
            // 20 degrees.
            let normal_distance = ((1.0 - n.dot(side)).max(0.0) / (1.0 - 20f64.to_radians().cos())).sqrt();
            let w = (1.0 - distance.max(normal_distance)).max(0.0);
            // Error of coordinates in f32, and of the root of the small difference of cosines, which is at least 3e-4.
            let w_off = 1e-5 + 3e-6 / normal_distance.max(2e-3);
            if distance.max(normal_distance) > 1.0 + w_off {
                continue;
            }
            let mut change = DVec3::from([0, 1, 2].map(|c| translation[c].dot(offset)));
            if self.bent() {
                change += DVec3::from([0, 1, 2].map(|c| rotation[c].dot(side.cross(n))));
            }
            let value = *irradiance + change.clamp(-*irradiance, *irradiance);
            sum += w * value;
            weight += w;
            off += w_off;
            // Six products of gradients up to 10 with coordinates, of three roundings of 6e-8 each: 1.1e-5.
            sum_off += w_off * value.max_element() + w * 2e-5;
        }
        let mean = if weight > 0.0 { sum / weight } else { DVec3::ZERO };
        let error = (sum_off + off * mean.max_element()) / (weight - off).max(1e-9);
        (mean, weight, off, error)
    }

    /// Numbers of points whose light or lists are wrong, and of points whose result depends on rounding.
    fn compare(&self, outcome: &Outcome) -> (usize, usize) {
        let (mut wrong, mut doubtful) = (0, 0);
        for i in 0..self.points.len() {
            let is_in = |list: &[u32]| list.binary_search(&(i as u32)).is_ok();
            let [wanted, queued, uncovered] =
                [&outcome.wanted, &outcome.path_points, &outcome.uncovered].map(|list| is_in(list));
            let got = outcome.radiance[i].map(f64::from);
            let light = DVec3::new(got[0], got[1], got[2]);
            let beyond = self.features.has(Feature::Glossy) && is_glossy(i) && self.points[i].normal != INVALID_POINT;
            if self.points[i].normal == INVALID_POINT || self.albedos[i] == Vec3::ZERO {
                wrong += usize::from(wanted || uncovered || queued != beyond || light != DVec3::ZERO || got[3] != 1.0);
                continue;
            }
            let (irradiance, weight, off, error) = self.expected(i);
            if (weight - MIN_WEIGHT).abs() <= off || (off > 0.0 && weight <= 2.0 * off) {
                doubtful += 1;
                continue;
            }
            let covered = weight > 0.0;
            let right = self.albedos[i].as_dvec3() * irradiance * self.seen(i) / PI;
            let queues = queued == (covered && beyond) && uncovered != covered;
            let lists = wanted == (weight < MIN_WEIGHT) && queues;
            // A few roundings of light that is below 1.
            let lit = (light - right).abs().max_element() <= error + 1e-6 && got[3] == f64::from(u8::from(covered));
            wrong += usize::from(!(lists && lit));
        }
        (wrong, doubtful)
    }
}

/// The points of a queue with room for `room`, sorted. What follows them is poison, and the arguments dispatch them.
fn queued(gpu: &Gpu, queue: &PathQueue, room: usize) -> Vec<u32> {
    let count = gpu.read::<u32>(&queue.count, 1).unwrap()[0];
    let mut points: Vec<u32> = gpu.read(&queue.points, room).unwrap();
    let beyond = points.split_off(count as usize);
    assert!(beyond.iter().all(|word| *word == POISON), "queued behind {count}");
    points.sort_unstable();
    let [x, y, z, beyond]: [u32; 4] = gpu.read::<[u32; 4]>(&queue.arguments, 1).unwrap()[0];
    let groups = count.div_ceil(PATH_GROUP);
    assert!(x * y >= groups && x * y < groups + x.max(1) && (z, beyond) == (1, POISON), "{x} {y} {z} of {groups}");
    points
}

/// Which points are glossy.
fn is_glossy(i: usize) -> bool {
    i.is_multiple_of(3)
}

fn tile_of([width, height]: [u32; 2], first_row: u32, rows: u32, samples_per_pixel: u32) -> Tile {
    Tile { height, first_row, ..whole([width, rows], samples_per_pixel) }
}

/// Errors of interpolated light, relative to the light times the largest coordinate in units of the smallest radius of
/// a record; for points that need no record of their own.
pub fn rounding(gpu: &Gpu) -> Vec<f64> {
    let features = device_features(gpu).with(Feature::SmoothNormals, true);
    let setup = setup([128, 64], tile_of([128, 64], 0, 64, 1), 500, features, &mut Random(13));
    let outcome = setup.run(gpu);
    let largest = 0.5 / 0.02;
    (0..setup.points.len())
        .filter(|&i| setup.points[i].normal != INVALID_POINT && setup.albedos[i].min_element() > 0.0)
        .filter_map(|i| {
            let (irradiance, weight, ..) = setup.expected(i);
            let right = setup.albedos[i].as_dvec3() * irradiance / PI;
            let [r, g, b, _] = outcome.radiance[i].map(f64::from);
            let off = (DVec3::new(r, g, b) - right).abs().max_element() / (right.max_element() * largest);
            (weight >= MIN_WEIGHT).then_some(off)
        })
        .collect()
}

/// Light and all lists equal brute force, with and without rotational gradients and glossy surfaces. The cases: images
/// whose sides are no multiple of a block's, tiles, coarser images over the same blocks, several samples per pixel, no
/// points and numbers of points around the size of a workgroup, few and many records.
#[kernel_test("PENUMBRA_DEVICE")]
fn light_is_that_of_all_records_in_reach(gpu: &Gpu) {
    let plain = device_features(gpu);
    let bent = plain.clone().with(Feature::SmoothNormals, true).with(Feature::Glossy, true);
    let mut random = Random(6);
    let whole = [70, 45];
    let cases = [
        (whole, tile_of(whole, 0, 45, 2), 500, plain.clone()),
        (whole, tile_of(whole, 20, 13, 1), 500, bent.clone()),
        // The image of one pixel for eight.
        (whole, tile_of([9, 6], 0, 6, 1), 500, plain.clone()),
        ([63, 1], tile_of([63, 1], 0, 1, 1), 40, bent.clone()),
        ([64, 1], tile_of([64, 1], 0, 1, 1), 40, plain.clone()),
        ([5, 13], tile_of([5, 13], 0, 13, 1), 1, plain.clone()),
        ([1, 1], tile_of([1, 1], 0, 1, 1), 0, plain.clone()),
        ([9, 9], Tile { point_count: 0, ..tile_of([9, 9], 0, 9, 1) }, 10, bent),
    ];
    let (mut checked, mut doubts, mut listed, mut queued, mut uncovered) = (0, 0, 0, 0, 0);
    for (size, tile, records, features) in cases {
        let setup = setup(size, tile, records, features, &mut random);
        let outcome = setup.run(gpu);
        let (wrong, doubtful) = setup.compare(&outcome);
        assert_eq!(wrong, 0, "{size:?}, {tile:?}");
        checked += setup.points.len();
        doubts += doubtful;
        listed += outcome.wanted.len();
        queued += outcome.path_points.len();
        uncovered += outcome.uncovered.len();
    }
    println!("{checked} points, {doubts} undecided, {listed} need records, {uncovered} have none, {queued} are glossy");
    // Guards: rounding leaves few points undecided, and there are points of each kind.
    assert!(doubts * 20 < checked && queued > 100 && uncovered > 100);
    assert!(uncovered + 100 < listed && listed + 1000 < checked);
}

/// The same holds for points that lie side by side, so that the records which reach none of a subgroup's points are
/// left out. The cases: subgroups in one block and in several, with points that are missing, and lists of few records
/// and of none.
#[kernel_test("PENUMBRA_DEVICE")]
fn light_of_neighbouring_points_is_that_of_all_records_in_reach(gpu: &Gpu) {
    let plain = device_features(gpu);
    let bent = plain.clone().with(Feature::SmoothNormals, true).with(Feature::Glossy, true);
    let mut random = Random(21);
    let cases = [
        ([64, 48], 600, 2, plain.clone()),
        ([64, 48], 600, 1, bent.clone()),
        ([61, 37], 600, 3, plain.clone()),
        ([3, 43], 300, 1, bent.clone()),
        ([65, 1], 9, 1, plain.clone()),
        ([40, 40], 8, 1, bent.clone()),
        ([40, 40], 1, 1, plain.clone()),
        ([17, 9], 0, 1, bent),
    ];
    let (mut checked, mut doubts, mut covered) = (0, 0, 0);
    for (size, records, samples_per_pixel, features) in cases {
        let tile = tile_of(size, 0, size[1], samples_per_pixel);
        let setup = setup(size, tile, records, features, &mut random).on_a_plane();
        let outcome = setup.run(gpu);
        let (wrong, doubtful) = setup.compare(&outcome);
        assert_eq!(wrong, 0, "{size:?}, {records} records");
        checked += setup.points.len();
        doubts += doubtful;
        covered += outcome.radiance.iter().filter(|light| light[0] > 0.0).count();
    }
    println!("{checked} points, {doubts} undecided, {covered} lit by records");
    // Guards: rounding leaves few points undecided, and records light many.
    assert!(doubts * 20 < checked && covered * 2 > checked);
}

/// A change is the difference of the light by two sets of records, and 0 where either leaves a point to a path: to the
/// bit on software devices. GPUs order and fuse the sums of the two kernels each in its own way.
#[kernel_test("PENUMBRA_DEVICE")]
fn changes_are_differences(gpu: &Gpu) {
    let plain = device_features(gpu);
    let bent = plain.clone().with(Feature::SmoothNormals, true).with(Feature::Glossy, true);
    let mut random = Random(31);
    let (mut changed, mut left) = (0, 0);
    for (size, records, features) in [([70, 45], 300, plain.clone()), ([65, 1], 60, bent.clone()), ([1, 1], 0, plain)] {
        let mut before = setup(size, tile_of(size, 0, size[1], 1), records, features.clone(), &mut random).on_a_plane();
        let after = Setup { records: before.records.clone(), ..setup_like(&before) };
        before.records.iter_mut().skip(1).step_by(2).for_each(|record| record.irradiance *= 0.5);
        before.records.iter_mut().skip(2).step_by(9).for_each(|record| record.reach = None);
        let [old, new] = [&before, &after].map(|setup| setup.run_with(gpu, &setup.features).radiance);
        let change = after.run_after(gpu, &after.features, Some(&before)).radiance;
        for (i, ((old, new), change)) in old.iter().zip(&new).zip(&change).enumerate() {
            let covered = old[3] > 0.0 && new[3] > 0.0;
            let difference = [0, 1, 2].map(|c| if covered { new[c] - old[c] } else { 0.0 });
            // A few roundings of the light.
            let rounding = if gpu.is_software() { 0.0 } else { 1e-6 };
            let close = |c: usize| (change[c] - difference[c]).abs() <= rounding * (old[c].abs() + new[c].abs());
            assert!((0..3).all(close) && change[3] == 0.0, "point {i} of {size:?}: {change:?}, not {difference:?}");
            changed += usize::from(difference != [0.0; 3]);
            left += usize::from(!covered && old[..3] != new[..3]);
        }
    }
    assert!(changed > 500 && left > 20, "{changed} points change, {left} are left to paths: the test proves nothing");
}

/// The comparison finds records that are moved, rotated, missing or too far-reaching, and gradients that are left out
/// or not bounded.
#[kernel_test("PENUMBRA_DEVICE")]
fn the_comparison_sees_planted_faults(gpu: &Gpu) {
    let features = device_features(gpu).with(Feature::SmoothNormals, true);
    let mut setup = setup([64, 64], tile_of([64, 64], 0, 64, 1), 400, features, &mut Random(9));
    let outcome = setup.run(gpu);
    assert_eq!(setup.compare(&outcome).0, 0);
    let right = setup.records.clone();
    type Fault = fn(&mut Record);
    let faults: [(&str, Fault); 7] = [
        ("moved", |r| r.head.position[0] += 0.01),
        ("turned", |r| r.head.normal = (Vec3::from(r.head.normal) + Vec3::X * 0.1).normalize().to_array()),
        ("no translational gradient", |r| r.translation = [DVec3::ZERO; 3]),
        ("no rotational gradient", |r| r.rotation = [DVec3::ZERO; 3]),
        ("wider", |r| r.head.size *= 1.1),
        ("visible nowhere", |r| r.reach = None),
        ("channels exchanged", |r| r.translation.swap(0, 1)),
    ];
    for (name, fault) in faults {
        setup.records = right.clone();
        setup.records.iter_mut().for_each(fault);
        let wrong = setup.compare(&outcome).0;
        assert!(wrong > 1000, "{name}: {wrong} points are wrong");
        setup.records = right.clone();
        fault(&mut setup.records[0]);
        println!("{name}: {wrong}, of one record {}", setup.compare(&outcome).0);
    }
}

/// With more points than fit in 65,535 workgroups and no record, each point requests a record and is queued exactly
/// once.
#[kernel_test("PENUMBRA_DEVICE")]
fn every_point_is_listed_past_the_dispatch_limit(gpu: &Gpu) {
    let size = [2050, 2049];
    let tile = tile_of(size, 0, size[1], 1);
    let count = tile.point_count as usize;
    assert!(count > 65_535 * 64);
    let points = vec![point(Vec3::ZERO, Vec3::Z); count];
    let albedos = vec![Vec3::ONE; count];
    let features = device_features(gpu).with(Feature::Indirect, true);
    let outcome =
        Setup { size, tile, points, albedos, records: Vec::new(), features: features.clone() }.run_with(gpu, &features);
    assert!(outcome.wanted.iter().copied().eq(0..count as u32));
    assert!(outcome.uncovered.iter().copied().eq(0..count as u32) && outcome.path_points.is_empty());
    assert!(outcome.radiance.iter().flatten().all(|v| *v == 0.0));
}
