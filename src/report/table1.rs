//! Table 1 of the paper, repeated: its two scenes, four techniques and settings, next to its own figures.

use std::fmt::Write;
use std::path::Path;

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use kernel_kit::Gpu;

use super::format::{escaped, grouped, percent};
use super::metrics;
use crate::render::film::View;
use crate::scene::ImportOptions;
use crate::{Aov, Error, Image, Progress, Renderer, Result, Scene, Settings, Statistics, Technique};

/// The paper's techniques, in the order of its table.
pub const TECHNIQUES: [Technique; 4] =
    [Technique::PATH, Technique::TWO_PASS, Technique::SHADOW_PHOTONS, Technique::VISIBILITY_ESTIMATE];

/// Width and height of the images in pixels. The paper does not state them. But its path tracer sends one shadow ray
/// and one other ray from every surface that a path meets, so its images have (all rays - 2 shadow rays) / samples
/// pixels: 132,000 and 117,000.
const SIDE: u32 = 350;

/// A scene of the paper with its settings and the paper's figures.
pub struct PaperScene {
    /// The paper's name for the scene.
    pub title: &'static str,
    file: &'static str,
    bytes: &'static [u8],
    /// Photons that the light emits.
    photons: u32,
    nearest: u32,
    /// Samples per pixel of the path-traced reference.
    reference_spp: u32,
    /// Samples per pixel of the other techniques.
    spp: u32,
    /// Photons in the paper's map.
    paper_photons: &'static str,
    figures: [Figures; 4],
}

/// A row of the paper's table.
struct Figures {
    time: &'static str,
    shadow_rays: u64,
    rays: u64,
}

/// The scenes of the paper. The paper does not state the samples of the techniques other than the reference. Those here
/// make two-pass rendering, with one shadow ray per point, reach the paper's number of shadow rays within 7 %.
pub const SCENES: [PaperScene; 2] = [
    PaperScene {
        title: "Marble sphere",
        file: "sphere.glb",
        bytes: include_bytes!("../../scenes/sphere.glb"),
        // The paper counts stored photons. One in six of the photons that the light emits in all directions meets the
        // scene.
        photons: 190_000,
        nearest: 30,
        reference_spp: 100,
        spp: 4,
        paper_photons: "33,000 photons, 3,420 of them shadow photons",
        figures: [
            Figures { time: "2100 s", shadow_rays: 8_574_150, rays: 30_325_200 },
            Figures { time: "31 s", shadow_rays: 248_259, rays: 452_185 },
            Figures { time: "28 s", shadow_rays: 13_104, rays: 246_718 },
            Figures { time: "28 s", shadow_rays: 0, rays: 234_001 },
        ],
    },
    PaperScene {
        title: "Box scene",
        file: "box.glb",
        bytes: include_bytes!("../../scenes/box.glb"),
        // The paper's map contains indirect photons too; it does not state how many.
        photons: 176_000,
        nearest: 50,
        reference_spp: 1000,
        spp: 24,
        paper_photons: "176,000 photons, direct and indirect, and 10,690 shadow photons",
        figures: [
            Figures { time: "16 h", shadow_rays: 269_361_500, rays: 656_126_500 },
            Figures { time: "915 s", shadow_rays: 2_033_070, rays: 3_073_938 },
            Figures { time: "847 s", shadow_rays: 182_556, rays: 1_226_560 },
            Figures { time: "843 s", shadow_rays: 0, rays: 1_044_132 },
        ],
    },
];

/// Deviations from the paper's settings.
#[derive(Clone, Copy, Debug, Default)]
pub struct Options {
    /// Width and height of the images in pixels. `None`: the paper's.
    pub width: Option<u32>,
    /// Samples per pixel of every technique. `None`: the paper's.
    pub spp: Option<u32>,
    /// Count photons regardless of their normals, as the paper does.
    pub paper_counting: bool,
}

impl PaperScene {
    /// The paper's settings of a technique, without audits and dilation.
    pub fn settings(&self, technique: Technique, options: &Options) -> Settings {
        let path = technique == Technique::PATH;
        let side = options.width.unwrap_or(SIDE);
        Settings::default().with(|s| {
            s.technique = technique;
            s.image.width = side;
            s.image.height = side;
            s.image.spp = options.spp.unwrap_or(if path { self.reference_spp } else { self.spp });
            // The reference has its own seed: with the same random numbers the noise would be correlated.
            s.image.seed = u32::from(path);
            s.visibility_map.photons_per_light = Some(self.photons);
            s.visibility_map.nearest = self.nearest;
            s.shadow_rays.samples = 1;
            s.visibility_map.dilate = Some(0);
            s.visibility_map.audit = 0.0;
            s.visibility_map.paper_counting = options.paper_counting;
            // The variance gives the reference's own noise. With the classes shown, every point counts its own nearest
            // photons, as in the paper; otherwise cells decide, and slightly fewer rays are saved in less time.
            s.image.aovs = vec![Aov::Direct, if path { Aov::Variance } else { Aov::Shadow }];
        })
    }

    /// Renders the scene and calls `after_batch` with the progress.
    ///
    /// # Errors
    /// Those of [`Renderer`].
    pub fn render(&self, gpu: &Gpu, settings: &Settings, after_batch: impl FnMut(&Progress)) -> Result<Render> {
        // Drivers compile kernels on first use. A tiny render before the timed one excludes that from the time.
        self.render_once(
            gpu,
            &settings.clone().with(|s| {
                s.image.width = 8;
                s.image.height = 8;
                s.image.spp = 1;
            }),
            |_| (),
        )?;
        self.render_once(gpu, settings, after_batch)
    }

    fn render_once(&self, gpu: &Gpu, settings: &Settings, mut after_batch: impl FnMut(&Progress)) -> Result<Render> {
        let scene = Scene::from_bytes(self.bytes, Path::new(self.file), &ImportOptions::default())?;
        let camera = scene.cameras.first().cloned().unwrap_or_else(|| scene.frame_camera());
        let mut renderer = Renderer::new(gpu, scene, &camera, settings)?;
        while renderer.samples() < settings.image.spp {
            after_batch(&renderer.render_batch()?);
        }
        Ok(Render { image: renderer.image()?, statistics: renderer.statistics()? })
    }
}

/// A render of a scene by one technique.
pub struct Render {
    /// The image.
    pub image: Image,
    /// Times and ray counts.
    pub statistics: Statistics,
}

/// A scene rendered by all four techniques.
pub struct Comparison {
    scene: &'static PaperScene,
    renders: [Render; 4],
    relmse: [f64; 4],
    relmse_direct: [f64; 3],
}

impl Comparison {
    /// From renders in the order of [`TECHNIQUES`]. Computes their relMSE against the first.
    ///
    /// # Errors
    /// Those of [`metrics::relmse`].
    pub fn new(scene: &'static PaperScene, renders: [Render; 4]) -> Result<Comparison> {
        let reference = &renders[0].image;
        let direct = direct_light(reference);
        let mut relmse = [metrics::relmse_of_noise(reference)?; 4];
        let mut relmse_direct = [0.0; 3];
        for (i, Render { image, .. }) in renders[1..].iter().enumerate() {
            relmse[i + 1] = metrics::relmse(image, reference)?;
            relmse_direct[i] = metrics::relmse(&direct_light(image), &direct)?;
        }
        Ok(Comparison { scene, renders, relmse, relmse_direct })
    }

    /// relMSE of direct light against `path`, for the other three of [`TECHNIQUES`].
    pub fn relmse_direct(&self) -> [f64; 3] {
        self.relmse_direct
    }

    /// relMSE in the order of [`TECHNIQUES`]: for `path` its own noise, for the others their difference from it.
    pub fn relmse(&self) -> [f64; 4] {
        self.relmse
    }

    /// 1 - shadow rays over those of `two-pass`, in the order of [`TECHNIQUES`]. `None` for `path` and `two-pass`
    /// itself.
    pub fn reductions(&self) -> [Option<f64>; 4] {
        reductions(std::array::from_fn(|i| self.renders[i].statistics.rays.shadow))
    }

    /// The table as text with aligned columns.
    pub fn text(&self) -> String {
        let mut text = format!("{}\n", self.headline());
        let table =
            [["", "paper", "", "", "", "here", "", "", "", "", ""].map(str::to_owned), COLUMNS.map(str::to_owned)];
        let rows: Vec<_> = table.into_iter().chain(self.cells()).collect();
        let widths: [usize; 11] = std::array::from_fn(|c| rows.iter().map(|row| row[c].len()).max().unwrap_or(0));
        for row in rows {
            let mut line = format!("{:1$}", row[0], widths[0]);
            for (cell, width) in row[1..].iter().zip(&widths[1..]) {
                let _ = write!(line, "  {cell:>width$}");
            }
            let _ = writeln!(text, "{}", line.trim_end());
        }
        text
    }

    fn headline(&self) -> String {
        let [path, _, shadow, _] = &self.renders;
        let (width, height, spp, nearest) = (
            shadow.statistics.settings.image.width,
            shadow.statistics.settings.image.height,
            shadow.statistics.settings.image.spp,
            shadow.statistics.settings.visibility_map.nearest,
        );
        let sum = |count: fn(&crate::statistics::LightPhotons) -> u64| {
            grouped(shadow.statistics.photons.iter().map(count).sum())
        };
        format!(
            "{}: {width} x {height} pixels, {} spp ({spp} without paths), k {nearest}; {} photons emitted, {} \
             illumination and {} shadow photons stored (the paper: {})",
            self.scene.title,
            path.statistics.settings.image.spp,
            sum(|p| p.emitted),
            sum(|p| p.illumination),
            sum(|p| p.shadow),
            self.scene.paper_photons
        )
    }

    /// The cells under [`COLUMNS`].
    fn cells(&self) -> [[String; 11]; 4] {
        let percent = |share: Option<f64>| share.map_or("-".to_owned(), percent);
        let (paper, here) = (reductions(self.scene.figures.each_ref().map(|row| row.shadow_rays)), self.reductions());
        std::array::from_fn(|i| {
            let figures = &self.scene.figures[i];
            let Statistics { rays, time, .. } = &self.renders[i].statistics;
            [
                TECHNIQUES[i].name().to_owned(),
                figures.time.to_owned(),
                grouped(figures.shadow_rays),
                grouped(figures.rays),
                percent(paper[i]),
                format!("{:.2} s", time.bvh + time.render),
                grouped(rays.shadow),
                grouped(rays.total),
                percent(here[i]),
                format!("{:.1e}", self.relmse[i]),
                i.checked_sub(1).map_or("-".to_owned(), |i| format!("{:.1e}", self.relmse_direct[i])),
            ]
        })
    }

    fn html(&self) -> Result<String> {
        let mut html = format!("<h2>{}</h2>\n<p>{}</p>\n<div class=\"images\">\n", self.scene.title, self.headline());
        for (technique, render) in TECHNIQUES.iter().zip(&self.renders) {
            let mut png = Vec::new();
            let Image { width, height, .. } = render.image;
            render.image.encode_png(&mut png, View::default(), 0.0).map_err(|e| Error::output("the page", e))?;
            let data = STANDARD.encode(png);
            let _ = writeln!(
                html,
                "<figure><img src=\"data:image/png;base64,{data}\" width=\"{width}\" height=\"{height}\" \
                 alt=\"{title} by {technique}\"><figcaption>{technique}</figcaption></figure>",
                title = self.scene.title
            );
        }
        html += "</div>\n<table>\n<tr><th></th><th colspan=\"4\">paper</th><th colspan=\"6\">here</th></tr>\n";
        let row = |kind: &str, cells: &[String]| {
            let cells: Vec<_> = cells.iter().map(|cell| format!("<{kind}>{cell}</{kind}>")).collect();
            format!("<tr>{}</tr>\n", cells.concat())
        };
        html += &row("th", &COLUMNS.map(str::to_owned));
        html.extend(self.cells().iter().map(|cells| row("td", cells)));
        html += "</table>\n";
        Ok(html)
    }
}

const COLUMNS: [&str; 11] = [
    "technique",
    "time",
    "shadow rays",
    "all rays",
    "reduction",
    "time",
    "shadow rays",
    "all rays",
    "reduction",
    "relMSE",
    "direct",
];

/// Notes on how to read the tables, one sentence each.
pub fn notes(options: &Options) -> Vec<&'static str> {
    vec![
        "Time: BVH, photons and all samples of one run; kernels were compiled beforehand.",
        "Reduction: 1 - shadow rays over those of two-pass.",
        "relMSE: against path, for all light and for direct light. For path itself: its own noise, estimated from \
         its samples; the other numbers contain that noise too.",
        if options.paper_counting {
            "Photons are counted regardless of their normals, as in the paper."
        } else {
            "Only photons with a similar normal are counted; `visibility_map.paper_counting` counts all, as the paper \
             does."
        },
        "Audits and dilation are off, as the paper has neither.",
    ]
}

/// A self-contained page of all scenes, with the four images of each side by side.
///
/// # Errors
/// [`Error::Output`] if an image cannot be encoded.
pub fn page(comparisons: &[Comparison], options: &Options) -> Result<String> {
    let mut html = String::from(HEAD);
    if let Some(Render { statistics, .. }) = comparisons.first().map(|comparison| &comparison.renders[0]) {
        let device = escaped(&statistics.device.name);
        let _ = writeln!(html, "<p>Penumbra {}, on {device}.</p>", statistics.version);
    }
    for comparison in comparisons {
        html += &comparison.html()?;
    }
    for note in notes(options) {
        let _ = writeln!(html, "<p>{note}</p>");
    }
    html += "</body>\n</html>\n";
    Ok(html)
}

const HEAD: &str = "<!DOCTYPE html>
<html lang=\"en\">
<head>
<meta charset=\"utf-8\">
<title>Table 1, repeated</title>
<style>
body { font: 15px/1.5 sans-serif; max-width: 1460px; margin: 2em auto; padding: 0 1em; }
.images { display: grid; grid-template-columns: repeat(4, 1fr); gap: 8px; }
figure { margin: 0; }
img { width: 100%; height: auto; }
table { border-collapse: collapse; margin: 1em 0; font-variant-numeric: tabular-nums; }
th, td { padding: 2px 12px; text-align: right; border-bottom: 1px solid #ccc; }
th:first-child, td:first-child { text-align: left; }
</style>
</head>
<body>
<h1>Table 1, repeated</h1>
<p>Jensen and Christensen, <i>Efficiently rendering shadows using the photon map</i> (1995).</p>
";

/// The image of direct light only, from the channels `direct.R` and so on.
fn direct_light(image: &Image) -> Image {
    let mut direct = Image::new(image.width, image.height);
    for name in ["R", "G", "B"] {
        if let Some(samples) = image.channel(&format!("direct.{name}")) {
            direct.add_channel(name, samples.to_vec());
        }
    }
    direct
}

/// 1 - shadow rays over those of the second technique.
fn reductions([_, all, some, none]: [u64; 4]) -> [Option<f64>; 4] {
    let reduction = |rays: u64| (all > 0).then(|| 1.0 - rays as f64 / all as f64);
    [None, None, reduction(some), reduction(none)]
}
