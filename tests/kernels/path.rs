//! Pass `path` against known results (furnace tests, the closed sphere, a rectangle's irradiance) and against the
//! images of an independent renderer.

use std::f64::consts::PI;

use glam::{DVec3, Vec3};
use kernel_kit::{Gpu, Resources, kernel_test};
use penumbra::internal::kernels::PATH_GROUP;
use penumbra::internal::passes::path::{GatherHit, Path, PathParameters, PathQueue};
use penumbra::internal::passes::primary::Primary;
use penumbra::internal::passes::{Point, Tile, TileBuffers};
use penumbra::internal::render::film::Image;
use penumbra::internal::scene::{Camera, ImportOptions, LightKind, Material, Scene, Specular};
use penumbra::internal::specialisation::features::{Feature, Features};
use penumbra::internal::statistics::Counter;
use penumbra::settings::{Settings, Technique};

use crate::light::{cube, form_factor, sphere, square};
use crate::stage::{Stage, whole};
use crate::statistics::{mean_and_error, z_test};

pub use crate::meshes::{camera, inside_out, scene, surface};

/// Result of a render: for each sample of each pixel, those of a pixel one after the other, direct and indirect light;
/// and the counters.
pub struct Rendered {
    direct: Vec<[f32; 4]>,
    indirect: Vec<[f32; 4]>,
    counters: Vec<u32>,
}

impl Rendered {
    /// Red of direct and indirect light together, for the `samples` samples of a pixel.
    fn pixel(&self, pixel: usize, samples: u32) -> impl Iterator<Item = f64> + Clone {
        self.all().skip(pixel * samples as usize).take(samples as usize)
    }

    pub fn all(&self) -> impl Iterator<Item = f64> + Clone {
        self.direct.iter().zip(&self.indirect).map(|(d, i)| f64::from(d[0]) + f64::from(i[0]))
    }
}

/// Renders a square image of `size` pixels a side by running the passes, with `spp` samples for each pixel at once.
fn render(gpu: &Gpu, scene: Scene, camera: &Camera, size: u32, spp: u32, max_bounces: u32) -> Rendered {
    render_with(gpu, scene, camera, size, spp, max_bounces, |features| features)
}

/// As [`render`], with the scene's features modified by `changed`.
pub fn render_with(
    gpu: &Gpu,
    scene: Scene,
    camera: &Camera,
    size: u32,
    spp: u32,
    max_bounces: u32,
    changed: impl Fn(Features) -> Features,
) -> Rendered {
    render_clamped(gpu, scene, camera, [size, spp, max_bounces], f32::MAX, changed)
}

/// As [`render_with`], with a limit of the indirect light of each path.
fn render_clamped(
    gpu: &Gpu,
    scene: Scene,
    camera: &Camera,
    [size, spp, max_bounces]: [u32; 3],
    max_indirect: f32,
    changed: impl Fn(Features) -> Features,
) -> Rendered {
    let Stage { features, gpu_scene, .. } = Stage::new(gpu, scene, camera, [size, size], Technique::PATH, changed);
    let constants = gpu_scene.constants();
    let primary = Primary::new(gpu, &features, &constants).unwrap();
    let path = Path::new(gpu, &features, &constants).unwrap();
    let point_count = size * size * spp;
    let mut buffers = TileBuffers::new(gpu, &features, point_count, true).unwrap();
    buffers.radiance_direct = gpu.poisoned::<[f32; 4]>("test/direct", point_count as usize).unwrap();
    let indirect = gpu.poisoned::<[f32; 4]>("test/indirect", point_count as usize).unwrap();
    buffers.radiance_indirect = Some(indirect);
    let primary = primary.bind(gpu, &buffers, &gpu_scene).unwrap();
    let bound = path.bind(gpu, &buffers, &[&gpu_scene]).unwrap();
    let tile = Tile { seed: 1, ..whole([size, size], spp) };
    let mut frame = gpu.frame("test");
    frame.clear(&buffers.counters);
    primary.record(&mut frame, &tile);
    bound.record(&mut frame, &PathParameters { max_bounces, max_indirect, ..one_path(tile) });
    frame.submit().unwrap();
    let read = |buffer: &kernel_kit::Buffer| gpu.read::<[f32; 4]>(buffer, point_count as usize).unwrap();
    let rendered = Rendered {
        direct: read(&buffers.radiance_direct),
        indirect: read(buffers.radiance_indirect.as_ref().unwrap()),
        counters: gpu.read(&buffers.counters, Counter::COUNT).unwrap(),
    };
    assert_eq!(rendered.counters[Counter::Overrun as usize], 0);
    let results = rendered.direct.iter().chain(&rendered.indirect);
    assert!(results.flatten().all(|v| v.is_finite()), "poison or worse in the radiance");
    rendered
}

/// One path from each point of a tile.
fn one_path(tile: Tile) -> PathParameters {
    PathParameters {
        tile,
        max_bounces: 64,
        light_samples: 1,
        max_indirect: f32::MAX,
        from_hits: 0,
        paths_per_point: 1,
        path_number: 0,
    }
}

/// Four paths from each point of a queue add the mean of four samples that each have one, with the same rays. Points
/// are the centres of pixels, so that all samples of a pixel have one point.
#[kernel_test("PENUMBRA_DEVICE")]
fn paths_of_a_point_are_its_samples(gpu: &Gpu) {
    const SIZE: u32 = 24;
    const PATHS: u32 = 4;
    let lamp = square(DVec3::new(0.0, 0.4, 0.0), DVec3::X * 0.1, DVec3::Z * 0.1);
    let room = scene(&[(inside_out(cube(DVec3::ZERO, 0.5)), surface(0.7, 0.0)), (lamp, surface(0.5, 8.0))], Vec::new());
    let view = camera(DVec3::new(0.1, -0.2, 0.3), DVec3::new(0.3, 0.5, -1.0), 1.5);
    let stage = Stage::new(gpu, room, &view, [SIZE, SIZE], Technique::PATH, |features| features);
    let Stage { features, gpu_scene, .. } = stage;
    let constants = gpu_scene.constants();
    // Direct and indirect light by point, and the number of bounce rays. With `queued`, the points are in a queue.
    let trace = |samples: u32, queued: Option<&[u32]>| -> ([Vec<[f32; 4]>; 2], u32) {
        let features = features.clone().with(Feature::IrradianceCache, queued.is_some());
        let tile = Tile { seed: 1, centred: 1.0, ..whole([SIZE, SIZE], samples) };
        let count = tile.point_count as usize;
        let mut buffers = TileBuffers::new(gpu, &features, tile.point_count, true).unwrap();
        // As pass `cache` leaves points that no record covers.
        buffers.radiance_indirect = Some(gpu.upload("test/indirect", &vec![[0f32; 4]; count]).unwrap());
        let primary = Primary::new(gpu, &features, &constants).unwrap().bind(gpu, &buffers, &gpu_scene).unwrap();
        let path = Path::new(gpu, &features, &constants).unwrap();
        let mut frame = gpu.frame("test");
        frame.clear(&buffers.counters);
        primary.record(&mut frame, &tile);
        if let Some(points) = queued {
            let queue = [points.len() as u32, points.len().div_ceil(PATH_GROUP as usize) as u32];
            let list = gpu.upload("test/path_points", points).unwrap();
            let length = gpu.upload("test/path_count", &queue[..1]).unwrap();
            let arguments = gpu.upload("test/arguments", &[queue[1], 1, 1]).unwrap();
            let no_hits = gpu.buffer::<GatherHit>("test/no_hits", 1).unwrap();
            let bindings =
                Resources::new().with("path_count", &length).with("path_points", &list).with("gather_hits", &no_hits);
            let bound = path.bind(gpu, &buffers, &[&gpu_scene, &bindings]).unwrap();
            let parameters = PathParameters { paths_per_point: PATHS, ..one_path(tile) };
            bound.record_queued(&mut frame, &arguments, &parameters);
        } else {
            path.bind(gpu, &buffers, &[&gpu_scene]).unwrap().record(&mut frame, &one_path(tile));
        }
        frame.submit().unwrap();
        let light = [&buffers.radiance_direct, buffers.radiance_indirect.as_ref().unwrap()];
        let counters: Vec<u32> = gpu.read(&buffers.counters, Counter::COUNT).unwrap();
        assert_eq!(counters[Counter::Overrun as usize], 0);
        (light.map(|buffer| gpu.read(buffer, count).unwrap()), counters[Counter::BounceRays as usize])
    };
    // Two samples of each pixel: their paths are the first four and the last four of eight.
    for samples in [1, 2] {
        let points: Vec<u32> = (0..SIZE * SIZE * samples).collect();
        let (found, rays) = trace(samples, Some(&points));
        let (single, single_rays) = trace(samples * PATHS, None);
        assert_eq!(rays, single_rays);
        // The largest difference of a point from the mean of some of its samples, over their light.
        let difference = |used: usize| {
            let of_light = |(found, single): (&Vec<[f32; 4]>, &Vec<[f32; 4]>)| {
                let of_point = |(found, single): (&[f32; 4], &[[f32; 4]])| {
                    let mean = single[..used].iter().map(|v| f64::from(v[0])).sum::<f64>() / used as f64;
                    (f64::from(found[0]) - mean).abs() / mean.max(1e-3)
                };
                found.iter().zip(single.chunks(PATHS as usize)).map(of_point).fold(0.0, f64::max)
            };
            found.iter().zip(&single).map(of_light).fold(0.0, f64::max)
        };
        // Sums of four f32 in another order: four roundings of 6e-8.
        assert!(difference(4) < 1e-6, "{samples} samples: {}", difference(4));
        assert!(difference(3) > 0.1, "a path that is missing");
    }
    // Points that are not queued keep the light that they had.
    let (some, _) = trace(1, Some(&[5]));
    assert!(some[1].iter().enumerate().all(|(i, v)| (i == 5) == (v[0] > 0.0)));
}

/// A limit of indirect light is the lower one of the path's light and the limit, component by component; direct light
/// has none.
#[kernel_test("PENUMBRA_DEVICE")]
fn indirect_light_is_clamped(gpu: &Gpu) {
    const LIMIT: f32 = 0.05;
    // Under a small lamp, paths differ in what they gather.
    let lamp = square(DVec3::new(0.0, 0.4, 0.0), DVec3::X * 0.1, DVec3::Z * 0.1);
    let parts = [(inside_out(cube(DVec3::ZERO, 0.5)), surface(0.7, 0.0)), (lamp, surface(0.5, 8.0))];
    let view = camera(DVec3::new(0.1, -0.2, 0.3), DVec3::new(0.3, 0.5, -1.0), 1.5);
    let render = |limit| render_clamped(gpu, scene(&parts, Vec::new()), &view, [16, 8, 4], limit, |features| features);
    let (free, clamped) = (render(f32::MAX), render(LIMIT));
    assert_eq!(free.direct, clamped.direct);
    let expected: Vec<[f32; 4]> =
        free.indirect.iter().map(|[r, g, b, w]| [r.min(LIMIT), g.min(LIMIT), b.min(LIMIT), *w]).collect();
    assert_eq!(clamped.indirect, expected);
    let above = free.indirect.iter().filter(|v| v[0] > LIMIT).count();
    assert!(above > 0 && above < expected.len(), "{above} paths exceed the limit");
}

/// In a closed room that emits 1 and reflects the share a everywhere, the radiance is 1 + a + a^2 + ... = 1 / (1 - a)
/// in every direction; with at most m bounces of indirect light the sum ends at a^(m + 1).
#[kernel_test("PENUMBRA_DEVICE")]
fn furnaces_are_white(gpu: &Gpu) {
    let room = |albedo| scene(&[(inside_out(cube(DVec3::ZERO, 0.5)), surface(albedo, 1.0))], Vec::new());
    let view = camera(DVec3::new(0.1, -0.2, 0.3), DVec3::new(0.3, 0.5, -1.0), 1.5);
    let cases: [(f32, u32, f64); 7] = [
        (0.0, 200, 1.0),
        (0.5, 200, 2.0),
        (0.8, 200, 5.0),
        (0.8, 0, 1.8),
        (0.8, 1, 1.8 + 0.64),
        (0.8, 2, 1.8 + 0.64 + 0.512),
        // Nothing is absorbed: Russian roulette ends the paths, and the sum is its number of terms.
        (1.0, 30, 32.0),
    ];
    for (albedo, max_bounces, expected) in cases {
        let rendered = render(gpu, room(albedo), &view, 16, 64, max_bounces);
        let (mean, error) = mean_and_error(rendered.all());
        // 1e-5: albedo and sums are f32.
        let error = error + 1e-5 * expected;
        z_test(mean, error, expected, 7).unwrap_or_else(|e| panic!("albedo {albedo}, {max_bounces} bounces: {e}"));
        assert!(error < 0.02 * expected, "{error} is no test of {expected}");
        if albedo > 0.0 {
            z_test(mean, error, expected * 1.1, 7).expect_err("a tenth too much");
        }
    }
}

/// In a closed sphere of albedo a around a point light of intensity I, the total light that arrives is 4 pi I / (1 -
/// a). The radiance is the same everywhere, a / pi of that over the sphere's area: 1 for I = pi, a = 1/2, radius 1 (as
/// in pbrt's tests of its integrators).
#[kernel_test("PENUMBRA_DEVICE")]
fn the_closed_sphere_has_its_known_radiance(gpu: &Gpu) {
    let mesh = inside_out(sphere(DVec3::ZERO, 1.0, 32));
    let area: f64 = mesh.iter().map(|[a, b, c]| (b - a).cross(c - a).length() / 2.0).sum();
    let light = LightKind::Point { position: Vec3::ZERO, intensity: Vec3::splat(PI as f32), range: f32::INFINITY };
    let rendered = render(
        gpu,
        scene(&[(mesh, surface(0.5, 0.0))], vec![light]),
        &camera(DVec3::new(0.2, 0.1, 0.3), DVec3::new(-0.5, 0.3, -1.0), 2.0),
        16,
        64,
        200,
    );
    let expected = 0.5 / PI * 4.0 * PI * PI / 0.5 / area;
    let (mean, error) = mean_and_error(rendered.all());
    // The centres of facets are nearer to the light, by a sagitta of (pi / 32)^2 / 8 of the radius. Irradiance changes
    // by twice that, and by as much again for the tilt at the rims.
    let error = error + 0.005 * expected / 3.0;
    z_test(mean, error, expected, 1).unwrap();
    z_test(mean, error, expected * 1.05, 1).expect_err("a twentieth too much");
    // At this albedo direct light is half of the whole.
    let (direct, error) = mean_and_error(rendered.direct.iter().map(|v| f64::from(v[0])));
    z_test(direct, error + 0.005 * expected / 3.0, expected / 2.0, 1).unwrap();
}

/// Light from a rectangle on a white floor is Lambert's closed form, pixel by pixel, up to where light and floor nearly
/// touch. There is no indirect light.
#[kernel_test("PENUMBRA_DEVICE")]
fn a_floor_under_a_rectangle_has_lamberts_irradiance(gpu: &Gpu) {
    const SIZE: usize = 12;
    const SPP: u32 = 400;
    // Upright, its lower edge 1e-3 over the floor, facing +z: the floor in front of it is lit down to grazing angles.
    let light = square(DVec3::new(0.0, 0.151, -0.3), DVec3::X * 0.2, DVec3::Y * 0.15);
    let floor = square(DVec3::ZERO, DVec3::Z * 0.6, DVec3::X * 0.6);
    let all = scene(&[(floor, surface(1.0, 0.0)), (light.clone(), surface(0.0, 3.0))], Vec::new());
    // From straight above, so that pixels are squares on the floor.
    let view = camera(DVec3::new(0.0, 0.5, 0.0), DVec3::NEG_Y, 2.0 * (0.5f32 / 0.5).atan());
    let rendered = render(gpu, all, &view, SIZE as u32, SPP, 4);
    let pixels = SIZE * SIZE;
    let mut tested = 0;
    let mut caught = 0;
    for pixel in 0..pixels {
        let (column, row) = ((pixel % SIZE) as f64, (pixel / SIZE) as f64);
        let at = |x: f64, y: f64| {
            let f = |v: f64| 2.0 * v / SIZE as f64 - 1.0;
            let [right, up] = [view.axes[0].as_dvec3(), view.axes[1].as_dvec3()];
            right * f(column + x) * 0.5 - up * f(row + y) * 0.5
        };
        // The mean over the pixel by midpoints, where the light is not in view and its edge is not near.
        if (0..4).any(|i| at(f64::from(i & 1), f64::from(i >> 1)).z < -0.28) {
            continue;
        }
        const N: usize = 8;
        let midpoint = |k: usize| (k as f64 + 0.5) / N as f64;
        let values =
            (0..N * N).map(|k| form_factor(&light, false, at(midpoint(k / N), midpoint(k % N)), DVec3::Y, true));
        let expected = 3.0 / PI * values.sum::<f64>() / (N * N) as f64;
        let (mean, error) = mean_and_error(rendered.pixel(pixel, SPP));
        // In a pixel next to the light the irradiance changes by a factor of a few: the error of the midpoint rule is a
        // few thousandths.
        let error = error + 2e-3 * expected;
        z_test(mean, error, expected, pixels as u32).unwrap_or_else(|e| panic!("pixel {column}, {row}: {e}"));
        tested += 1;
        caught += usize::from(z_test(mean, error, expected * 1.2, pixels as u32).is_err());
    }
    // Guards: pixels are tested, and a fifth too much is found at half of them.
    assert!(tested > 80 && caught > tested / 2, "{caught} of {tested}");
    assert!(rendered.indirect.iter().all(|v| v[..3] == [0.0; 3]), "the light reflects nothing, the floor is flat");
}

/// Compares blocks of pixels with Mitsuba's images of the same box; the means of the whole agree within a thousandth,
/// plus noise.
#[kernel_test("PENUMBRA_DEVICE")]
fn an_independent_renderer_agrees(gpu: &Gpu) {
    let Some(shared) = std::env::var_os("PENUMBRA_SHARED") else {
        println!("PENUMBRA_SHARED is not set: the comparison with an independent renderer is left out");
        return;
    };
    const SIZE: usize = 256;
    const BLOCK: usize = 16;
    const BLOCKS: usize = (SIZE / BLOCK) * (SIZE / BLOCK);
    const SPP: u32 = 16;
    let folder = std::path::Path::new(&shared).join("reference");
    let box_scene = Scene::load(folder.join("box.glb"), &ImportOptions::default()).unwrap();
    let view = box_scene.cameras[0].clone();
    for (file, max_bounces) in [("box-direct.exr", 0), ("box-gi.exr", 64)] {
        let reference = Image::read_exr(folder.join(file)).unwrap();
        let [reference, _, _] = reference.rgb().unwrap();
        let rendered = render(gpu, box_scene.clone(), &view, SIZE as u32, SPP, max_bounces);
        // Number of blocks that differ if the reference is shifted by some pixels.
        let outside = |shift: usize| {
            let differs = |block: &usize| {
                let corner = block / (SIZE / BLOCK) * BLOCK * SIZE + block % (SIZE / BLOCK) * BLOCK;
                let difference = (0..BLOCK * BLOCK).map(|k| {
                    let pixel = corner + k / BLOCK * SIZE + k % BLOCK;
                    let samples = rendered.pixel(pixel, SPP);
                    let moved = (pixel + shift).min(SIZE * SIZE - 1);
                    samples.sum::<f64>() / f64::from(SPP) - f64::from(reference[moved])
                });
                let (mean, error) = mean_and_error(difference);
                mean.abs() > 3.0 * error + 1e-4
            };
            (0..BLOCKS).filter(differs).count()
        };
        // By chance one block in 370 deviates by more than three standard errors. The test allows twice as many plus
        // two, as the tails are longer than those of a normal distribution.
        let found = outside(0);
        assert!(found <= 2 + 2 * BLOCKS / 370, "{file}: {found} of {BLOCKS} blocks differ");
        assert!(outside(2) > BLOCKS / 20, "a reference that is moved by two pixels");
        let mean = rendered.all().sum::<f64>() / f64::from(SPP) / (SIZE * SIZE) as f64;
        let expected = reference.iter().map(|v| f64::from(*v)).sum::<f64>() / (SIZE * SIZE) as f64;
        // Standard error of the mean of all pixels, from the spread within each pixel.
        let errors = (0..SIZE * SIZE).map(|pixel| mean_and_error(rendered.pixel(pixel, SPP)).1);
        let error = errors.map(|e| e * e).sum::<f64>().sqrt() / (SIZE * SIZE) as f64;
        assert!((mean - expected).abs() < 1e-3 * expected + 4.0 * error, "{file}: mean {mean}, not {expected}");
        assert!(error < 1e-3 * expected, "{file}: an error of {error} is no test");
    }
}

/// Without bounces, only points where a ray sampled from the BSDF may hit the lamp trace one: where the maximum density
/// of the BSDF times the solid angle of the lamp's bounding sphere is at least 1 (in f64). The rays of all other points
/// would add nothing.
#[kernel_test("PENUMBRA_DEVICE")]
fn rays_are_traced_where_they_may_hit_a_light(gpu: &Gpu) {
    const SIZE: u32 = 64;
    const SPP: u32 = 4;
    const RADIUS: f64 = 0.12 * std::f64::consts::SQRT_2;
    let lamp = DVec3::new(0.0, 0.5, -0.2);
    let panel = |x: f64| square(DVec3::new(x, 0.0, 0.0), DVec3::Z * 0.5, DVec3::X * 0.16);
    let metal =
        |roughness| Material { metallic: 1.0, roughness, specular: Specular::with_factor(1.0), ..surface(0.9, 0.0) };
    let roughness = [0.1, 0.5];
    let all = scene(
        &[
            (panel(-0.33), metal(roughness[0])),
            (panel(0.0), metal(roughness[1])),
            (panel(0.33), surface(0.9, 0.0)),
            (square(lamp, DVec3::X * 0.12, DVec3::Z * 0.12), surface(0.0, 3.0)),
        ],
        Vec::new(),
    );
    let eye = DVec3::new(0.0, 0.3, 0.7);
    let view = camera(eye, -eye, 1.2);
    let settings = Settings::default().with(|s| {
        s.image.width = SIZE;
        s.image.height = SIZE;
        s.technique = Technique::TWO_PASS;
        s.indirect.max_bounces = 0;
    });
    let Stage { features, gpu_scene, .. } = Stage::of_settings(gpu, all, &view, &settings, |features| features);
    assert!(features.has(Feature::BsdfRays) && features.has(Feature::Highlights));
    let constants = gpu_scene.constants();
    let tile = Tile { seed: 5, ..whole([SIZE, SIZE], SPP) };
    let count = tile.point_count as usize;
    let queue = PathQueue {
        points: gpu.poisoned::<u32>("test/path_points", count + 1).unwrap(),
        ..PathQueue::new(gpu, "test", tile.point_count).unwrap()
    };
    // Points, direct light and the number of rays.
    let trace = |highlights: bool| -> (Vec<Point>, Vec<[u32; 4]>, u32) {
        let features = features.clone().with(Feature::Highlights, highlights);
        let mut buffers = TileBuffers::new(gpu, &features, tile.point_count, true).unwrap();
        buffers.radiance_indirect = Some(gpu.poisoned::<[f32; 4]>("test/indirect", count).unwrap());
        let primary = Primary::new(gpu, &features, &constants).unwrap().bind(gpu, &buffers, &gpu_scene).unwrap();
        let path = Path::new(gpu, &features, &constants).unwrap();
        let parameters = PathParameters { max_bounces: 0, light_samples: 4, ..one_path(tile) };
        let mut frame = gpu.frame("test");
        frame.clear(&buffers.counters);
        primary.record(&mut frame, &tile);
        if highlights {
            path.bind_highlights(gpu, &buffers, &queue, &gpu_scene).unwrap().record(&mut frame, &queue, &parameters);
        } else {
            path.bind(gpu, &buffers, &[&gpu_scene]).unwrap().record(&mut frame, &parameters);
        }
        frame.submit().unwrap();
        let indirect: Vec<[f32; 4]> = gpu.read(buffers.radiance_indirect.as_ref().unwrap(), count).unwrap();
        assert!(indirect.iter().all(|v| v[..3] == [0.0; 3]), "nothing bounces");
        let counters: Vec<u32> = gpu.read(&buffers.counters, Counter::COUNT).unwrap();
        let points = gpu.read(&buffers.points.buffer, count).unwrap();
        let direct: Vec<[f32; 4]> = gpu.read(&buffers.radiance_direct, count).unwrap();
        let bits = direct.iter().map(|v| v.map(f32::to_bits)).collect();
        (points, bits, counters[Counter::BounceRays as usize])
    };
    let (points, of_all, all_rays) = trace(false);
    let (_, of_queued, rays) = trace(true);
    let differing = of_all.iter().zip(&of_queued).filter(|(a, b)| a[..3] != b[..3]).count();
    assert_eq!(differing, 0, "points that were not queued miss light");
    let length = gpu.read::<u32>(&queue.count, 1).unwrap()[0] as usize;
    let mut queued: Vec<u32> = gpu.read(&queue.points, count + 1).unwrap();
    assert!(queued.split_off(length).iter().all(|word| *word == kernel_kit::POISON), "past the queue");
    queued.sort_unstable();
    assert!(rays as usize <= length && 2 * rays < all_rays, "{rays} rays, not {all_rays}");

    // The probability that a ray from a point hits the lamp, at most; with a fault, for a view from above.
    let bound = |point: &Point, faulty: bool| -> f64 {
        let position = Vec3::from(point.position).as_dvec3();
        if position.y > 0.1 || position.x > 0.165 {
            return 0.0;
        }
        let alpha = if position.x < -0.165 { roughness[0] } else { roughness[1] };
        let alpha = f64::from(alpha).powi(2);
        let z = if faulty { 1.0 } else { (eye - position).normalize().y };
        let root = (alpha * alpha * (1.0 - z * z) + z * z).sqrt();
        let density = 0.5 / (PI * alpha * alpha * (z + root));
        let sine = RADIUS / (lamp - position).length();
        density * 2.0 * PI * (1.0 - (1.0 - sine * sine).sqrt())
    };
    let is_queued = |i: usize| queued.binary_search(&(i as u32)).is_ok();
    let wrong = |faulty: bool| {
        let decided = |i: &usize| (bound(&points[*i], faulty) - 1.0).abs() > 1e-3;
        let is_wrong = |i: &usize| {
            let seen = points[*i].normal != penumbra::internal::kernels::INVALID_POINT;
            is_queued(*i) != (seen && bound(&points[*i], faulty) >= 1.0)
        };
        (0..count).filter(decided).filter(is_wrong).count()
    };
    assert_eq!(wrong(false), 0, "{length} of {count} are queued");
    assert!(wrong(true) > 20, "the test does not see the view");
}
