//! The image and the statistics of a render.

use std::collections::{BTreeMap, HashMap};

use glam::{DVec3, DVec4};

use crate::gpu::Gpu;
use crate::passes::film::Plane;
use crate::render::film::{Channel, Metadata};
use crate::settings::Aov;
use crate::statistics::{Counter, Memory, SceneCounts, Statistics, Times};
use crate::{Image, Result};

use super::checkpoint::Checkpoint;
use super::{Renderer, conditioning};

/// Depth where the ray left the scene: Blender's number, as EXR readers stumble over infinities.
const NO_DEPTH: f64 = 1e10;

/// The image of the film on the device, or of what was kept of it.
pub(super) fn image(renderer: &Renderer<'_>, kept: Option<&Checkpoint>) -> Result<Image> {
    let settings = &renderer.settings;
    let samples = renderer.samples;
    let film = Film { renderer, kept: kept.map(|kept| kept_planes(renderer, kept)) };
    let plane = |pick: &dyn Fn(&super::TileFilm) -> Option<&Plane>| film.means(pick);
    let direct = plane(&|f| Some(&f.direct))?.unwrap_or_default();
    let indirect = plane(&|f| f.indirect.as_ref())?;
    let total: Vec<DVec4> = match &indirect {
        Some(indirect) => direct.iter().zip(indirect).map(|(d, i)| (d.truncate() + i.truncate()).extend(d.w)).collect(),
        None => direct.clone(),
    };
    let mut channels = Vec::new();
    push(&mut channels, ["R", "G", "B"], &total);
    channels.push(Channel { name: "A".into(), samples: total.iter().map(|v| v.w as f32).collect() });
    let black = vec![DVec4::ZERO; direct.len()];
    for aov in &settings.image.aovs {
        match aov {
            Aov::Direct => push(&mut channels, ["direct.R", "direct.G", "direct.B"], &direct),
            Aov::Indirect => {
                push(&mut channels, ["indirect.R", "indirect.G", "indirect.B"], indirect.as_ref().unwrap_or(&black));
            }
            Aov::Albedo => {
                let albedo = plane(&|f| f.albedo.as_ref())?.unwrap_or_default();
                push(&mut channels, ["albedo.R", "albedo.G", "albedo.B"], &albedo);
            }
            Aov::Normal => {
                let mut normals = plane(&|f| f.normal.as_ref())?.unwrap_or_default();
                normals.iter_mut().for_each(|n| *n = n.truncate().normalize_or_zero().extend(0.0));
                push(&mut channels, ["N.X", "N.Y", "N.Z"], &normals);
            }
            Aov::Position => {
                let mut positions = plane(&|f| f.position.as_ref())?.unwrap_or_default();
                for (p, total) in positions.iter_mut().zip(&total) {
                    let seen = total.w;
                    let normalised = if seen > 0.0 { p.truncate() / seen } else { DVec3::ZERO };
                    let world =
                        if seen > 0.0 { renderer.scene.normalisation.undo_f64(normalised) } else { DVec3::ZERO };
                    *p = world.extend(0.0);
                }
                push(&mut channels, ["P.X", "P.Y", "P.Z"], &positions);
            }
            Aov::Depth => {
                let positions = plane(&|f| f.position.as_ref())?.unwrap_or_default();
                let scale = renderer.scene.normalisation.scale();
                let depth = positions
                    .iter()
                    .zip(&total)
                    .map(|(p, total)| (if total.w > 0.0 { p.w / total.w / scale } else { NO_DEPTH }) as f32);
                channels.push(Channel { name: "Z".into(), samples: depth.collect() });
            }
            Aov::Variance => {
                let squares = plane(&|f| f.squares.as_ref())?.unwrap_or_default();
                let n = f64::from(samples);
                let variance = squares.iter().zip(&total).map(|(square, mean)| {
                    // Of the mean of n samples; unknown, and said to be 0, where there is one.
                    if n > 1.0 { ((*square - *mean * *mean) / (n - 1.0)).max(DVec4::ZERO) } else { DVec4::ZERO }
                });
                push(&mut channels, ["variance.R", "variance.G", "variance.B"], &variance.collect::<Vec<_>>());
            }
            Aov::Shadow => shadow_channels(&film, &mut channels)?,
        }
    }
    let mut image = Image { width: settings.image.width, height: settings.image.height, channels, ..Image::default() };
    image.add_camera(&renderer.camera, &renderer.scene.normalisation);
    metadata(renderer, &mut image);
    Ok(image)
}

/// Where the sums of samples are.
struct Film<'a> {
    renderer: &'a Renderer<'a>,
    /// The words of each plane, where not the device but a checkpoint has them.
    kept: Option<HashMap<*const Plane, &'a [u32]>>,
}

fn kept_planes<'a>(renderer: &Renderer<'_>, kept: &'a Checkpoint) -> HashMap<*const Plane, &'a [u32]> {
    let mut rest = kept.words();
    let own = |plane: &Plane| {
        let (own, others) = rest.split_at(plane.state_words());
        rest = others;
        (std::ptr::from_ref(plane), own)
    };
    renderer.planes().map(own).collect()
}

impl Film<'_> {
    /// See [`Plane::means`].
    fn plane_means(&self, plane: &Plane) -> Result<Vec<DVec4>> {
        let samples = self.renderer.samples;
        match &self.kept {
            Some(kept) => Ok(Plane::means_of(kept[&std::ptr::from_ref(plane)], samples)),
            None => plane.means(self.renderer.gpu, samples),
        }
    }

    /// The means of a plane over the whole image, or none where the tiles have no such plane.
    fn means(&self, pick: &dyn Fn(&super::TileFilm) -> Option<&Plane>) -> Result<Option<Vec<DVec4>>> {
        let mut all = Vec::new();
        for tile in &self.renderer.tiles {
            let Some(plane) = pick(tile) else { return Ok(None) };
            all.extend(self.plane_means(plane)?);
        }
        Ok(Some(all))
    }
}

fn push(channels: &mut Vec<Channel>, names: [&str; 3], values: &[DVec4]) {
    for (axis, name) in names.into_iter().enumerate() {
        channels.push(Channel { name: name.to_owned(), samples: values.iter().map(|v| v[axis] as f32).collect() });
    }
}

fn shadow_channels(from: &Film<'_>, channels: &mut Vec<Channel>) -> Result<()> {
    let renderer = from.renderer;
    let mut used = std::collections::HashSet::new();
    for (index, light) in renderer.scene.lights.iter().enumerate() {
        let mut all = Vec::new();
        for tile in &renderer.tiles {
            let Some(film) = tile.shadow.get(index) else { return Ok(()) };
            let mut means = from.plane_means(film.plane())?;
            // Only the first sample wrote its class into the sum.
            means.iter_mut().for_each(|v| v.x *= f64::from(renderer.samples));
            all.extend(means);
        }
        // A dot ends a layer's name, and two lights may share theirs.
        let mut name = light.name.replace('.', "_");
        if !used.insert(name.clone()) {
            name = format!("{name}_{index}");
            used.insert(name.clone());
        }
        for (axis, suffix) in ["class", "visibility", "ni", "ns"].into_iter().enumerate() {
            let samples = all.iter().map(|v| v[axis] as f32).collect();
            channels.push(Channel { name: format!("shadow.{name}.{suffix}"), samples });
        }
    }
    Ok(())
}

fn metadata(renderer: &Renderer<'_>, image: &mut Image) {
    let settings = &renderer.settings;
    let mut put = |name: &str, value: Metadata| {
        image.metadata.insert(name.to_owned(), value);
    };
    put("renderTimeSeconds", Metadata::Float(renderer.totals.time_render as f32));
    put("samplesPerPixel", Metadata::Int(renderer.samples as i32));
    let text = |s: &str| Metadata::Text(s.to_owned());
    put("penumbra:version", text(env!("CARGO_PKG_VERSION")));
    put("penumbra:technique", text(settings.technique.name()));
    put("penumbra:device", text(&renderer.gpu.info.name));
    put("penumbra:driver", text(&renderer.gpu.info.driver));
    put("penumbra:seed", Metadata::Int(settings.image.seed as i32));
    put("penumbra:photons", Metadata::Int(settings.visibility_map.photons_per_light as i32));
    put("penumbra:nearest", Metadata::Int(settings.visibility_map.nearest as i32));
    put("penumbra:shadowSamples", Metadata::Int(settings.shadow_rays.samples as i32));
    let left_out: Vec<&str> = renderer.specialisation.left_out.iter().map(|item| item.name).collect();
    put("penumbra:leftOut", Metadata::Text(left_out.join(" ")));
    let dropped = renderer.totals.get(Counter::NotFinite);
    put("penumbra:notFinite", Metadata::Int(dropped.min(i32::MAX as u64) as i32));
    let warnings = conditioning::warnings(&renderer.totals, &renderer.settings);
    if !warnings.is_empty() {
        let counts: Vec<String> = warnings.iter().map(|w| format!("{}={}", w.name, w.count)).collect();
        put("penumbra:conditioning", Metadata::Text(counts.join(" ")));
    }
}

pub(super) fn statistics(renderer: &Renderer<'_>, passes: BTreeMap<String, f64>) -> Statistics {
    let (totals, scene, gpu): (_, _, &Gpu) = (&renderer.totals, &renderer.scene, renderer.gpu);
    let names = |items: &[crate::specialisation::Item]| items.iter().map(|item| item.name.to_owned()).collect();
    Statistics {
        schema: 1,
        version: env!("CARGO_PKG_VERSION"),
        device: gpu.info.clone(),
        settings: renderer.settings.clone(),
        samples: renderer.samples,
        rays: totals.rays(),
        points: totals.points(),
        photons: totals.photons.clone(),
        indirect: totals.indirect,
        audits: totals.audits(),
        not_finite: totals.get(Counter::NotFinite),
        conditioning: conditioning::conditioning(totals),
        time: Times {
            bvh: totals.time_bvh,
            compile: totals.time_compile,
            render: totals.time_render,
            passes,
            ..Times::default()
        },
        memory: Memory {
            scene: totals.scene_bytes,
            photons: totals.photon_bytes + totals.indirect_bytes,
            frame: totals.frame_bytes,
        },
        scene: SceneCounts {
            triangles: scene.triangles.len() as u64,
            lights: scene.lights.len() as u64,
            materials: scene.materials.len() as u64,
            images: scene.images.len() as u64,
            bvh_depth: totals.bvh_depth,
        },
        kept: names(&renderer.specialisation.kept),
        left_out: names(&renderer.specialisation.left_out),
        notes: renderer
            .notes
            .iter()
            .cloned()
            .chain(conditioning::warnings(totals, &renderer.settings).into_iter().map(|w| w.text))
            .collect(),
    }
}
