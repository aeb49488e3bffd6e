//! What is saved where a scene does not need a feature: `scenes/box.glb`, which needs nearly none, with each of them
//! forced on, and with all of them together.
//!
//! Run it with `cargo bench --bench needs -- -o docs/needs.md`, where the file is that of the page; without it the page
//! is printed. The variable `PENUMBRA_DEVICE` names another device than the software one. The driver compiles the
//! kernels of each feature in the first run on a machine, which takes some minutes.
//!
//! The renders with a feature and without it are made in turn; times are medians of [`ROUNDS`] renders, before which a
//! render of each has filled the driver's cache.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write as _;

use kernel_kit::{Feature as _, Gpu};
use penumbra::internal::kernels::compose;
use penumbra::internal::scene::ImportOptions;
use penumbra::internal::specialisation::features::{Feature, Features};
use penumbra::{Image, Renderer, Result, Scene, Settings};

#[path = "../tests/common/unneeded.rs"]
mod unneeded;

use unneeded::{
    NOT_FORCED, OTHER_RAYS, ROUNDING, UNNEEDED, Unneeded, all_unneeded, relative_differences, share_beyond_rounding,
    values,
};

/// Renders for each time.
const ROUNDS: usize = 5;

/// Side of the image, and samples of each pixel: half a second on two cores of lavapipe.
const SIDE: u32 = 160;
const SPP: u32 = 8;

/// Number of features, and of passes, that the page names as the most expensive.
const LISTED: usize = 5;

/// A switch of each feature that is forced.
type Switches = [(Feature, bool)];

struct Render {
    image: Image,
    /// Seconds.
    render: f64,
    compile: f64,
    /// What the driver has allocated for wgpu at the end.
    bytes: u64,
    allocations: usize,
    /// Seconds on the device of each pass that ran, by kernel and entry point.
    passes: BTreeMap<String, f64>,
    features: Features,
}

fn scene() -> Scene {
    let file = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes/box.glb");
    Scene::load(&file, &ImportOptions::default()).expect("the scene is in the repository")
}

fn settings() -> Settings {
    Settings::default().with(|s| {
        (s.image.width, s.image.height, s.image.spp) = (SIDE, SIDE, SPP);
        // Images of so few samples would have no photons unless their number is requested.
        s.visibility_map.photons_per_light = Some(s.photons_per_light());
    })
}

fn render(gpu: &Gpu, scene: &Scene, settings: &Settings, forced: &Switches) -> Result<Render> {
    let mut renderer = Renderer::with_features(gpu, scene.clone(), &scene.cameras[0], settings, forced)?;
    while renderer.samples() < settings.image.spp {
        renderer.render_batch()?;
    }
    let statistics = renderer.statistics()?;
    let report = gpu.device.generate_allocator_report().expect("Vulkan devices have an allocator of wgpu's");
    Ok(Render {
        image: renderer.image()?,
        render: statistics.time.render,
        compile: statistics.time.compile,
        bytes: report.total_allocated_bytes,
        allocations: report.allocations.len(),
        passes: statistics.time.passes,
        features: renderer.specialisation().features.clone(),
    })
}

/// What the kernels of a render have.
struct Contents {
    operations: usize,
    /// Variables that are bound, as kernel and name.
    bindings: BTreeSet<String>,
}

fn contents(render: &Render) -> Result<Contents> {
    let kernels: BTreeSet<&str> = render.passes.keys().filter_map(|pass| pass.split('/').next()).collect();
    let mut contents = Contents { operations: 0, bindings: BTreeSet::new() };
    for kernel in kernels {
        let module = compose(kernel, &render.features)?.module;
        let functions = module.functions.iter().map(|(_, function)| function);
        let functions = functions.chain(module.entry_points.iter().map(|entry| &entry.function));
        contents.operations += functions.map(|function| operations(&function.body)).sum::<usize>();
        let bound = module.global_variables.iter().filter(|(_, variable)| variable.binding.is_some());
        let names = bound.filter_map(|(_, variable)| variable.name.as_deref());
        contents.bindings.extend(names.map(|name| format!("{kernel}/{name}")));
    }
    Ok(contents)
}

/// The statements of a block, and the expressions that they evaluate.
fn operations(block: &naga::Block) -> usize {
    use naga::Statement as S;
    let one = |statement: &S| match statement {
        S::Emit(range) => range.clone().count(),
        S::Block(inner) => operations(inner),
        S::If { accept, reject, .. } => 1 + operations(accept) + operations(reject),
        S::Switch { cases, .. } => 1 + cases.iter().map(|case| operations(&case.body)).sum::<usize>(),
        S::Loop { body, continuing, .. } => 1 + operations(body) + operations(continuing),
        _ => 1,
    };
    block.iter().map(one).sum()
}

/// How two images differ, relative to the first.
struct Difference {
    /// The largest difference of a value.
    largest: f64,
    /// The share of values whose difference exceeds [`ROUNDING`].
    beyond: f64,
    mean: f64,
}

impl Difference {
    fn of(before: &Image, after: &Image) -> Difference {
        let (before, after) = (values(before), values(after));
        let all = relative_differences(&before, &after);
        Difference {
            largest: all.iter().fold(0.0, |largest, difference| difference.max(largest)),
            beyond: share_beyond_rounding(&all),
            mean: (after.iter().sum::<f64>() / before.iter().sum::<f64>() - 1.0).abs(),
        }
    }

    fn text(&self) -> String {
        match *self {
            Difference { largest: 0.0, .. } => "same bits".to_owned(),
            Difference { largest, beyond: 0.0, .. } => format!("{largest:.0e}"),
            Difference { beyond, mean, .. } => {
                format!("{:.2} % of values by over {ROUNDING:e}, the mean by {mean:.0e}", 100.0 * beyond)
            }
        }
    }
}

/// What a feature costs.
struct Cost {
    /// Seconds without it and with it: of the whole render, of its passes on the device, of composing and compiling.
    render: [f64; 2],
    passes: [f64; 2],
    compile: [f64; 2],
    bytes: [u64; 2],
    operations: [usize; 2],
    difference: Difference,
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

/// Compares renders with two sets of switches, in turn; the last render of each, too.
fn compare(gpu: &Gpu, scene: &Scene, switches: [&Switches; 2]) -> Result<(Cost, [Render; 2])> {
    let settings = settings();
    let mut times: [[Vec<f64>; 2]; 3] = Default::default();
    let mut last = [render(gpu, scene, &settings, switches[0])?, render(gpu, scene, &settings, switches[1])?];
    for _ in 0..ROUNDS {
        for which in [0, 1] {
            last[which] = render(gpu, scene, &settings, switches[which])?;
            times[0][which].push(last[which].render);
            times[1][which].push(last[which].passes.values().sum());
            times[2][which].push(last[which].compile);
        }
    }
    let [render, passes, compile] = times.map(|both| both.map(median));
    let operations = [contents(&last[0])?.operations, contents(&last[1])?.operations];
    let bytes = [last[0].bytes, last[1].bytes];
    let difference = Difference::of(&last[0].image, &last[1].image);
    Ok((Cost { render, passes, compile, bytes, operations, difference }, last))
}

/// A change in thousands of bytes.
fn kilobytes([without, with]: [u64; 2]) -> String {
    format!("{:+} kB", (with as i64 - without as i64) / 1000)
}

fn row(name: &str, cost: &Cost) -> String {
    let [before, after] = cost.operations;
    format!(
        "| {name} | {:.2} | {:.2} | {} | {:+} ({:+.1} %) | {:+.0} ms | {} |\n",
        cost.render[1] / cost.render[0],
        cost.passes[1] / cost.passes[0],
        kilobytes(cost.bytes),
        after as i64 - before as i64,
        100.0 * (after as f64 / before as f64 - 1.0),
        1000.0 * (cost.compile[1] - cost.compile[0]),
        cost.difference.text(),
    )
}

/// The names of features as the page shows them.
fn quoted<'a>(features: impl IntoIterator<Item = &'a Feature>) -> String {
    features.into_iter().map(|feature| format!("`{}`", feature.name())).collect::<Vec<_>>().join(", ")
}

/// The last parts of the names that one render has and another lacks, each once.
fn more(after: &BTreeSet<String>, before: &BTreeSet<String>) -> String {
    let last = |name: &String| name.split('/').next_back().map(|last| format!("`{last}`"));
    let more: BTreeSet<String> = after.difference(before).filter_map(last).collect();
    if more.is_empty() { "none".to_owned() } else { more.into_iter().collect::<Vec<_>>().join(", ") }
}

fn introduction(gpu: &Gpu, all: &Cost) -> String {
    format!(
        "# What a scene does not need\n\n\
         `scripts/with-vulkan cargo bench --bench needs -- -o docs/needs.md` made this page on {}\n\
         ({}). It renders `scenes/box.glb`, a cube in a room under a square light,\n\
         whose surfaces are Lambertian and have no textures: {SIDE} x {SIDE} pixels, {SPP} samples, technique\n\
         `shadow-photons`, all light. The box alone takes {:.2} s, {:.2} s of them in passes on the device, {} kB of\n\
         device memory, {} instructions, and {:.0} ms to compile its kernels.\n\n\
         Each row is the same render with one feature more, which the box does not need, over the render without\n\
         it. Where a feature comes only beside others, both renders have these. *Time* is that of the render, with\n\
         photons and irradiance records; *passes* is the part of it that the device counts, and the rest is the\n\
         host's. Both are ratios of medians of {ROUNDS} renders in turn; values below 1 show how uncertain a\n\
         row is. *Memory* is what wgpu has allocated on the device at the end. *Instructions* are the\n\
         statements and the evaluated expressions of all kernels that ran, as naga parses them, before any\n\
         driver optimises them. *Compile* is the time to compose and compile all kernels, with the driver's cache\n\
         warm. *Image* is how values of R, G and B differ, relative to themselves or to a tenth of the mean.\n\n\
         | feature | time | passes | memory | instructions | compile | image |\n\
         | --- | ---: | ---: | ---: | ---: | ---: | --- |\n",
        gpu.info.name,
        gpu.info.driver,
        all.render[0],
        all.passes[0],
        all.bytes[0] / 1000,
        all.operations[0],
        1000.0 * all.compile[0]
    )
}

/// All features together, beside the row of them.
struct Together {
    /// How the image differs with direct light alone, and without irradiance records.
    direct: Difference,
    uncached: Difference,
    /// Bytes with all but layered tables, whose least size is that of a layer.
    unlayered: u64,
}

impl Together {
    fn new(gpu: &Gpu, scene: &Scene) -> Result<Together> {
        let differ = |settings: &Settings| -> Result<Difference> {
            let [before, after] = [&[], &*all_unneeded()].map(|forced| render(gpu, scene, settings, forced));
            Ok(Difference::of(&before?.image, &after?.image))
        };
        let mut forced = all_unneeded();
        forced.retain(|(feature, _)| *feature != Feature::LayeredTexels);
        Ok(Together {
            direct: differ(&settings().with(|s| s.indirect.max_bounces = 0))?,
            uncached: differ(&settings().with(|s| s.indirect.irradiance_cache.enabled = false))?,
            unlayered: render(gpu, scene, &settings(), &forced)?.bytes,
        })
    }
}

/// What the rows of the page say together.
fn findings(costs: &[(String, Cost)], all: &Cost, renders: &[Render; 2], together: &Together) -> String {
    let Together { direct, uncached, unlayered } = together;
    let share = |both: [f64; 2]| both[0] / both[1];
    let ratio = |cost: &Cost| cost.passes[1] / cost.passes[0];
    let mut costly: Vec<_> = costs.iter().collect();
    costly.sort_by(|a, b| ratio(&b.1).total_cmp(&ratio(&a.1)));
    let costly = costly[..LISTED].iter().map(|(name, cost)| format!("{name} ({:.2})", ratio(cost)));
    let [before, after] = renders;
    let own = |pass: &str| before.passes.get(pass).copied().unwrap_or(0.0);
    let mut grown: Vec<_> = after.passes.iter().map(|(pass, seconds)| (pass, own(pass), *seconds)).collect();
    grown.sort_by(|a, b| (b.2 - b.1).total_cmp(&(a.2 - a.1)));
    let grown = grown[..LISTED].iter();
    let grown = grown.map(|(pass, own, all)| format!("`{pass}` (from {:.0} to {:.0} ms)", 1000.0 * own, 1000.0 * all));
    format!(
        "\nThe box takes {:.2} of the time, {:.2} of the time of passes, {:.2} of the memory, {:.2} of the\n\
         instructions and {:.2} of the time to compile of the same box with all of them. It takes {:.2} of the memory\n\
         of the box with all but `layered_texels`.\n\n\
         All of them together change the image by up to {} with direct light alone (`--max-bounces 0`), and by up\n\
         to {} with all light but without irradiance records (`--no-cache`). Records amplify roundings.\n\
         {} change the rounding of the rays themselves.\n\n\
         The features whose passes cost most: {}.\n\n\
         With all features together, these passes grow most: {}.\n\n\
         Features are decided for the whole scene: if one material needs a feature, its code is in the kernels for\n\
         all surfaces, and its vectors are in the surface of every point.\n",
        share(all.render),
        share(all.passes),
        all.bytes[0] as f64 / all.bytes[1] as f64,
        all.operations[0] as f64 / all.operations[1] as f64,
        share(all.compile),
        all.bytes[0] as f64 / *unlayered as f64,
        direct.text(),
        uncached.text(),
        quoted(&OTHER_RAYS).replace(", ", " and "),
        costly.collect::<Vec<_>>().join(", "),
        grown.collect::<Vec<_>>().join(", "),
    )
}

/// What one render has and another lacks, besides code.
fn rest([without, with]: &[Render; 2]) -> Result<String> {
    let labels = |render: &Render| render.passes.keys().cloned().collect();
    let [own, forced] = [contents(without)?.bindings, contents(with)?.bindings];
    let mut text = format!(
        "\n## What else is left out\n\n\
         | | the box | with all of the features | names of the additional ones |\n\
         | --- | ---: | ---: | --- |\n\
         | passes | {} | {} | {} |\n\
         | bindings of kernels | {} | {} | {} |\n\
         | allocations on the device | {} | {} | |\n\n\
         `penumbra plan scenes/box.glb` gives the reason for each feature that is left out. These are not forced \
         here:\n\n",
        without.passes.len(),
        with.passes.len(),
        more(&labels(with), &labels(without)),
        own.len(),
        forced.len(),
        more(&forced, &own),
        without.allocations,
        with.allocations,
    );
    for (features, why) in NOT_FORCED {
        let _ = writeln!(text, "- {}: {why}", quoted(*features));
    }
    Ok(text)
}

fn name(unneeded: &Unneeded) -> String {
    let negation = if unneeded.on { "" } else { "no " };
    let beside = match unneeded.beside {
        [] => String::new(),
        beside => format!(" beside {}", quoted(beside)),
    };
    format!("{negation}{}{beside}", quoted(&[unneeded.feature]))
}

fn main() -> Result<()> {
    // It keeps no kernels: each render compiles its own, which is a part of what a feature costs.
    let gpu = kernel_kit::test::device("PENUMBRA_DEVICE");
    let scene = scene();
    let mut costs = Vec::new();
    for unneeded in UNNEEDED {
        let (cost, _) = compare(gpu, &scene, [&unneeded.without(), &unneeded.with()])?;
        eprint!("{}", row(&name(unneeded), &cost));
        costs.push((name(unneeded), cost));
    }
    let (all, renders) = compare(gpu, &scene, [&[], &all_unneeded()])?;
    let together = Together::new(gpu, &scene)?;
    let rows: String = costs.iter().map(|(name, cost)| row(name, cost)).collect();
    let page = introduction(gpu, &all)
        + &rows
        + &row("all", &all)
        + &findings(&costs, &all, &renders, &together)
        + &rest(&renders)?;
    match std::env::args().skip_while(|argument| argument != "-o").nth(1) {
        Some(file) => std::fs::write(&file, page).unwrap_or_else(|problem| panic!("{file}: {problem}")),
        None => print!("{page}"),
    }
    Ok(())
}
