//! From which price of a ray on shadow photons win: render time over that of `two-pass` in `scenes/procedural.glb`,
//! whose distance function is evaluated up to thirty times where one evaluation is enough.
//!
//! Run it with `cargo bench --bench break_even -- docs/break-even.svg`, where the argument is the file of the plot; the
//! variable `PENUMBRA_DEVICE` names another device than the software one.
//!
//! It prints the table of `docs/procedurals.md`: for each number of evaluations the price of a shadow ray of `two-pass`
//! on the device, the render time of `two-pass`, and for each other technique its time over that and its photon rays,
//! shadow rays and audits over the shadow rays of `two-pass`. Techniques render in turn; times are medians of
//! [`ROUNDS`] renders.

use std::path::Path;

use kernel_kit::Gpu;
use penumbra::internal::procedural::{Builder, Role};
use penumbra::internal::report::plot;
use penumbra::internal::scene::ImportOptions;
use penumbra::{Renderer, Result, Scene, Settings, Statistics, Technique};

#[path = "../tests/common/device.rs"]
mod device;

/// Renders for each time. The median of three leaves out one during which the machine did other work.
const ROUNDS: usize = 3;

/// Evaluations of the distance function where one is enough: two per decade.
const EVALUATIONS: [u32; 4] = [1, 3, 10, 30];

/// Name, technique, and whether shadow rays of earlier samples decide, too.
const COMPARED: [(&str, Technique, bool); 4] = [
    ("two-pass", Technique::TWO_PASS, false),
    ("shadow-photons", Technique::SHADOW_PHOTONS, true),
    ("photons alone", Technique::SHADOW_PHOTONS, false),
    ("voxel-tags", Technique::VOXEL_TAGS, false),
];

/// Menger's sponge of `scenes/procedural/menger.wgsl`, evaluated as often as the first parameter says, one after the
/// other. The second parameter is 0, which the compiler does not know, so that all have the same value. The loop over
/// levels is unrolled, because there may be 4096 iterations along a ray.
const DEAR_SPONGE: &str = "
fn dear_sponge(position: vec3f, parameters: vec4f) -> f32 {
    var distance = 0.0;
    for (var i = 0; i < i32(parameters.x); i++) { distance = sponge(position + parameters.y * distance); }
    return distance;
}

fn sponge(position: vec3f) -> f32 {
    let beyond = abs(position) - 1.0;
    let cube = length(max(beyond, vec3f(0.0))) + min(max(beyond.x, max(beyond.y, beyond.z)), 0.0);
    return level(position, 27.0, level(position, 9.0, level(position, 3.0, level(position, 1.0, cube))));
}

fn level(position: vec3f, scale: f32, distance: f32) -> f32 {
    let p = scale * position + 1.0;
    let cell = p - 2.0 * floor(0.5 * p) - 1.0;
    let r = 3.0 * abs(cell) - 1.0;
    let bars = min(max(r.x, r.y), min(max(r.y, r.z), max(r.z, r.x)));
    return max(distance, -bars / (3.0 * scale));
}
";

/// `scenes/procedural.glb` with the dear sponge.
fn scene(evaluations: u32) -> Scene {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes/procedural.glb");
    let mut scene = Scene::load(&file, &ImportOptions::default()).expect("the scene is in the repository");
    let mut functions = Builder::default();
    // In the order of the file, which gives them the same numbers.
    for (source, name, role) in [
        (include_str!("../scenes/procedural/sphere.wgsl"), "sphere", Role::Intersection),
        (include_str!("../scenes/procedural/marble.wgsl"), "marble", Role::Colour),
        (DEAR_SPONGE, "dear_sponge", Role::Distance),
    ] {
        functions.function(source, name, role).expect("the function is valid");
    }
    scene.functions = functions.finish().expect("the functions can be composed");
    let sponge = scene.procedurals.iter_mut().find(|object| object.name == "sponge");
    sponge.expect("the scene has a sponge").parameters = [evaluations as f32, 0.0, 0.0, 0.0];
    scene
}

/// A render: its seconds on the device in pass `shadow`, and its statistics.
fn render(gpu: &Gpu, scene: &Scene, technique: Technique, fine_cells: bool) -> Result<(f64, Statistics)> {
    let camera = scene.cameras[0].clone();
    let settings = Settings::default().with(|s| {
        s.technique = technique;
        (s.image.width, s.image.height) = (240, 160);
        s.image.spp = 64;
        s.indirect.max_bounces = 0;
        s.visibility_map.fine_cells = fine_cells;
    });
    let shadow = |gpu: &Gpu| -> Result<f64> {
        let passes = gpu.pass_times()?;
        Ok(passes.iter().filter(|(name, _)| name.starts_with("shadow/")).map(|(_, seconds)| seconds).sum())
    };
    let before = shadow(gpu)?;
    let mut renderer = Renderer::new(gpu, scene.clone(), &camera, &settings)?;
    while renderer.samples() < settings.image.spp {
        renderer.render_batch()?;
    }
    Ok((shadow(gpu)? - before, renderer.statistics()?))
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

fn main() -> Result<()> {
    let gpu = device::gpu();
    let mut prices = Vec::new();
    let mut ratios = COMPARED[1..].iter().map(|(name, ..)| (*name, Vec::new())).collect::<Vec<_>>();
    println!(
        "| evaluations | ns a shadow ray | `two-pass` | {} |",
        ratios.iter().map(|r| r.0).collect::<Vec<_>>().join(" | ")
    );
    for evaluations in EVALUATIONS {
        let scene = scene(evaluations);
        let mut renders: [Vec<(f64, Statistics)>; COMPARED.len()] = Default::default();
        for _ in 0..ROUNDS {
            for ((_, technique, fine_cells), renders) in COMPARED.into_iter().zip(&mut renders) {
                renders.push(render(gpu, &scene, technique, fine_cells)?);
            }
        }
        let all = renders[0][0].1.rays.shadow as f64;
        let price = median(renders[0].iter().map(|(seconds, _)| seconds / all).collect());
        let time = |renders: &[(f64, Statistics)]| median(renders.iter().map(|(_, s)| s.time.render).collect());
        prices.push(1e6 * price);
        let mut line = format!("| {evaluations} | {:.0} | {:.2} s |", 1e9 * price, time(&renders[0]));
        for ((_, ratios), own) in ratios.iter_mut().zip(&renders[1..]) {
            let rays = own[0].1.rays;
            let ratio = time(own) / time(&renders[0]);
            ratios.push(ratio);
            line += &format!(" {ratio:.2}, {:.2} |", (rays.photon + rays.cell + rays.shadow + rays.audit) as f64 / all);
        }
        println!("{line}");
    }
    if let Some(file) = std::env::args().skip(1).find(|argument| argument.ends_with(".svg")) {
        let plot = plot::break_even(&prices, &ratios)?;
        std::fs::write(&file, plot).unwrap_or_else(|problem| panic!("{file}: {problem}"));
    }
    Ok(())
}
