//! How the time of a render grows with photons, k, triangles, lights and pixels, each over two decades, for direct
//! light alone and for all light.
//!
//! Run it with `cargo bench --bench cost`; the variable `PENUMBRA_DEVICE` names another device than the software one.
//!
//! It prints a table for each of the five: the sizes, and for each kind of light the seconds at each size and the
//! exponent of the power law that fits them best. Expected are exponents of at most 1 for photons, lights and pixels,
//! and logarithmic growth for triangles. Times include photons, grids and all samples, but not import, hierarchy and
//! compilation; they are medians of [`RUNS`] runs.

use std::sync::Arc;

use glam::{Mat3, Vec2, Vec3, Vec4, vec3};
use kernel_kit::Gpu;
use penumbra::internal::scene::{
    Camera, EmitterTriangle, Light, LightKind, Material, NO_LIGHT, Projection, Scene, Specular, Triangle, Vertex,
};
use penumbra::{Renderer, Result, Settings};

/// Runs for each time. The median of three leaves out the first, in which a driver may compile.
const RUNS: usize = 3;

/// Sizes for each growth, over two decades.
const STEPS: usize = 5;

/// A property of the render that grows.
struct Growth {
    name: &'static str,
    sizes: [u32; STEPS],
    /// The scene and the settings for a size.
    of: fn(u32) -> (Scene, Settings),
}

const GROWTHS: [Growth; 5] = [
    Growth {
        name: "photons",
        sizes: [10_000, 32_000, 100_000, 320_000, 1_000_000],
        // Few pixels, so that photons take most of the time.
        of: |photons| {
            (
                room(1, 0),
                square_image(64).with(|s| {
                    s.visibility_map.photons_per_light = Some(photons);
                    s.indirect.photons = Some(photons);
                }),
            )
        },
    },
    Growth {
        name: "k",
        sizes: [5, 16, 50, 158, 500],
        of: |nearest| (room(1, 0), square_image(256).with(|s| s.visibility_map.nearest = nearest)),
    },
    Growth {
        name: "triangles",
        sizes: [1_078, 3_168, 10_648, 33_462, 107_800],
        // Eleven squares, with two triangles for each cell.
        of: |triangles| (room((f64::from(triangles) / 22.0).sqrt() as u32, 0), square_image(256)),
    },
    Growth {
        name: "lights",
        sizes: [2, 6, 20, 63, 200],
        // So few photons for each light that their total stays below every limit.
        of: |lights| (room(1, lights), square_image(128).with(|s| s.visibility_map.photons_per_light = Some(16_384))),
    },
    Growth {
        name: "pixels",
        sizes: [4_096, 12_996, 40_804, 129_600, 409_600],
        of: |pixels| (room(1, 0), square_image(f64::from(pixels).sqrt() as u32)),
    },
];

fn square_image(side: u32) -> Settings {
    Settings::default().with(|s| {
        s.image.width = side;
        s.image.height = side;
        s.image.spp = 4;
    })
}

/// Adds a triangle of a material that belongs to a light.
fn add(scene: &mut Scene, corners: [Vec3; 3], material: u32, light: u32) {
    let first = scene.vertices.len() as u32;
    Arc::make_mut(&mut scene.vertices).extend(corners.map(|position| Vertex {
        position,
        normal: Vec3::ZERO,
        tangent: Vec4::ZERO,
        uv: [Vec2::ZERO; 2],
        colour: Vec4::ONE,
    }));
    scene.triangles.push(Triangle { vertices: [first, first + 1, first + 2], material, light });
}

/// Adds the square `centre` ± `u` ± `v`, facing `u` x `v`, of `n` x `n` cells.
fn add_square(scene: &mut Scene, [centre, u, v]: [Vec3; 3], n: u32, material: u32, light: u32) {
    let at = |i: u32, j: u32| {
        let along = |k: u32| 2.0 * k as f32 / n as f32 - 1.0;
        centre + u * along(i) + v * along(j)
    };
    for (i, j) in (0..n * n).map(|cell| (cell / n, cell % n)) {
        add(scene, [at(i, j), at(i + 1, j), at(i + 1, j + 1)], material, light);
        add(scene, [at(i, j), at(i + 1, j + 1), at(i, j + 1)], material, light);
    }
}

/// A cube in a room, every square cut into `cells` x `cells`, under `lights` point lights, or under a square light
/// where that is 0.
fn room(cells: u32, lights: u32) -> Scene {
    let base_colour = Vec3::splat(0.7).extend(1.0);
    let material = Material { base_colour, metallic: 0.0, specular: Specular::with_factor(0.0), ..Material::default() };
    let emissive = Vec3::splat(if lights == 0 { 10.0 } else { 0.0 });
    let mut scene = Scene { materials: vec![material.clone(), Material { emissive, ..material }], ..Scene::default() };
    let [x, y, z] = [Vec3::X, Vec3::Y, Vec3::Z];
    for [normal, u, v] in [[-y, z, x], [y, x, z], [-x, y, z], [x, z, y], [-z, x, y]] {
        add_square(&mut scene, [normal, u, v].map(|axis| 0.5 * axis), cells, 0, NO_LIGHT);
    }
    let rotation = Mat3::from_rotation_y(0.35);
    for [normal, u, v] in [[x, y, z], [-x, z, y], [y, z, x], [-y, x, z], [z, x, y], [-z, y, x]] {
        let [normal, u, v] = [normal, u, v].map(|axis| 0.17 * (rotation * axis));
        add_square(&mut scene, [vec3(0.15, -0.32, 0.05) + normal, u, v], cells, 0, NO_LIGHT);
    }
    if lights == 0 {
        let first = scene.triangles.len() as u32;
        add_square(&mut scene, [vec3(0.0, 0.49, 0.0), 0.2 * x, 0.2 * z], 1, 1, 0);
        let emitters = (first..first + 2).map(|triangle| EmitterTriangle { triangle, radiance: emissive }).collect();
        scene.lights.push(Light { name: "square".into(), kind: LightKind::Mesh { material: 1, emitters } });
    }
    for light in 0..lights {
        // By the golden ratio and its square: even over the ceiling.
        let along = |step: f32| 0.9 * (light as f32 * step).fract() - 0.45;
        let position = vec3(along(0.618_034), 0.45, along(0.754_878));
        let kind = LightKind::Point { position, intensity: Vec3::splat(1.0 / lights as f32), range: f32::INFINITY };
        scene.lights.push(Light { name: format!("{light}"), kind });
    }
    scene
}

fn camera() -> Camera {
    let projection = Projection::Perspective { yfov: 0.7, aspect: Some(1.0) };
    let axes = [Vec3::X, Vec3::Y, Vec3::Z];
    let position = vec3(0.0, 0.0, 1.8);
    Camera { name: String::new(), position, axes, projection, near: 1e-3, far: 10.0, lens: None }
}

/// Median time of a render in seconds.
fn time(gpu: &Gpu, (scene, settings): (Scene, Settings)) -> Result<f64> {
    let mut times = [0.0; RUNS];
    for time in &mut times {
        let mut renderer = Renderer::new(gpu, scene.clone(), &camera(), &settings)?;
        while renderer.samples() < settings.image.spp {
            renderer.render_batch()?;
        }
        *time = renderer.statistics()?.time.render;
    }
    times.sort_by(f64::total_cmp);
    Ok(times[RUNS / 2])
}

/// The exponent of the power law from sizes to times: least squares on the logarithms.
fn exponent(sizes: &[u32; STEPS], times: &[f64; STEPS]) -> f64 {
    let (x, y) = (sizes.map(|size| f64::from(size).ln()), times.map(f64::ln));
    let mean = |values: &[f64; STEPS]| values.iter().sum::<f64>() / STEPS as f64;
    let (mean_x, mean_y) = (mean(&x), mean(&y));
    let products: f64 = x.iter().zip(&y).map(|(x, y)| (x - mean_x) * (y - mean_y)).sum();
    products / x.iter().map(|x| (x - mean_x).powi(2)).sum::<f64>()
}

fn main() -> Result<()> {
    let device = std::env::var("PENUMBRA_DEVICE").unwrap_or_else(|_| "software".to_owned());
    let gpu = Gpu::open(&device.parse().unwrap())?;
    println!("device: {} ({}, {})", gpu.info.name, gpu.info.kind, gpu.info.driver);
    println!("seconds, and the exponent of the size that fits them\n");
    for growth in GROWTHS {
        println!("{:24}{}", growth.name, growth.sizes.map(|size| format!("{size:>10}")).concat());
        for (light, max_bounces) in [("direct light", 0), ("all light", Settings::default().indirect.max_bounces)] {
            let mut times = [0.0; STEPS];
            for (time_of, size) in times.iter_mut().zip(growth.sizes) {
                let (scene, settings) = (growth.of)(size);
                *time_of = time(&gpu, (scene, settings.with(|s| s.indirect.max_bounces = max_bounces)))?;
            }
            let columns = times.map(|time| format!("{time:>10.3}")).concat();
            println!("    {light:20}{columns}{:>10.2}", exponent(&growth.sizes, &times));
        }
    }
    Ok(())
}
