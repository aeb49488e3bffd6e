//! The image and the statistics of a render.

use std::collections::{BTreeMap, HashMap};

use glam::{DVec3, DVec4};
use kernel_kit::Gpu;

use super::checkpoint::Checkpoint;
use super::conditioning;
use super::renderer::Renderer;
use super::tiles::TileFilm;
use crate::passes::film::{Plane, Sum, variance_of_mean};
use crate::render::film::{Channel, Metadata, Window};
use crate::settings::{Aov, Background, Settings};
use crate::statistics::{Counter, Memory, SceneCounts, Statistics, Times};
use crate::{Image, Result};

/// Depth of rays that leave the scene: Blender's value, because some EXR readers fail on infinities.
const NO_DEPTH: f64 = 1e10;

impl Renderer<'_> {
    /// The image so far, with the channels that the settings request.
    ///
    /// # Errors
    /// As [`Gpu::read`].
    pub fn image(&self) -> Result<Image> {
        image(self, None)
    }

    /// The statistics so far. The times that the library does not know (start, import, total) are 0.
    ///
    /// # Errors
    /// As [`Gpu::pass_times`].
    pub fn statistics(&self) -> Result<Statistics> {
        Ok(statistics(self, self.gpu.pass_times()?))
    }
}

/// The image of the film, on the device or as it was kept.
pub(super) fn image(renderer: &Renderer<'_>, kept: Option<&Checkpoint>) -> Result<Image> {
    let settings = &renderer.settings;
    let film = Film { renderer, kept: kept.map(|kept| kept_planes(renderer, kept)) };
    let direct = film.means(&|f| Some(&f.direct))?.unwrap_or_default();
    let indirect = film.means(&|f| f.indirect.as_ref())?;
    let total: Vec<DVec4> = match &indirect {
        Some(indirect) => direct.iter().zip(indirect).map(|(d, i)| (d.truncate() + i.truncate()).extend(d.w)).collect(),
        None => direct.clone(),
    };
    let indirect = indirect.unwrap_or_else(|| vec![DVec4::ZERO; direct.len()]);
    let mut channels = Vec::new();
    let background = background_colour(settings);
    let over = |v: &DVec4| background.map_or(*v, |colour| (v.truncate() + colour * (1.0 - v.w)).extend(1.0));
    let shown: Vec<DVec4> = total.iter().map(over).collect();
    push(&mut channels, ["R", "G", "B"], &shown);
    channels.push(Channel { name: "A".into(), samples: shown.iter().map(|v| v.w as f32).collect() });
    let positioned = settings.image.aovs.iter().any(|aov| matches!(aov, Aov::Position | Aov::Depth));
    let shares = if positioned { film.surface_shares(&total)? } else { Vec::new() };
    for aov in &settings.image.aovs {
        match aov {
            Aov::Direct => push(&mut channels, ["direct.R", "direct.G", "direct.B"], &direct),
            Aov::Indirect => push(&mut channels, ["indirect.R", "indirect.G", "indirect.B"], &indirect),
            Aov::Albedo => {
                let albedo = film.means(&|f| f.albedo.as_ref())?.unwrap_or_default();
                push(&mut channels, ["albedo.R", "albedo.G", "albedo.B"], &albedo);
            }
            Aov::Normal => push(&mut channels, ["N.X", "N.Y", "N.Z"], &film.normals()?),
            Aov::Position => push(&mut channels, ["P.X", "P.Y", "P.Z"], &film.positions(&shares)?),
            Aov::Depth => channels.push(Channel { name: "Z".into(), samples: film.depths(&shares)? }),
            Aov::Variance => {
                push(&mut channels, ["variance.R", "variance.G", "variance.B"], &film.variances(&total)?);
            }
            Aov::Samples => {
                let samples = (0..total.len()).map(|pixel| renderer.samples_of(pixel) as f32).collect();
                channels.push(Channel { name: "samples".into(), samples });
            }
            Aov::Shadow => film.push_class_channels(&mut channels)?,
        }
    }
    let part = settings.image.part();
    let mut image = Image { width: part.width, height: part.height, channels, ..Image::default() };
    image.transparent = settings.image.background == Background::Transparent;
    image.crop = settings
        .image
        .crop
        .map(|crop| Window { at: [crop.x, crop.y], of: [settings.image.width, settings.image.height] });
    image.add_camera(&renderer.camera, &renderer.scene.normalisation);
    add_metadata(renderer, &mut image);
    Ok(image)
}

/// The colour behind the scene, if one takes the place of what the camera sees there.
pub(super) fn background_colour(settings: &Settings) -> Option<DVec3> {
    match settings.image.background {
        Background::Colour(colour) => Some(colour.map(f64::from).into()),
        Background::Environment | Background::Transparent => None,
    }
}

/// The sums of samples, on the device or kept.
pub(super) struct Film<'a> {
    renderer: &'a Renderer<'a>,
    /// The words of each plane, if they are in a checkpoint and not on the device.
    kept: Option<HashMap<*const Plane, &'a [u32]>>,
}

fn kept_planes<'a>(renderer: &Renderer<'_>, kept: &'a Checkpoint) -> HashMap<*const Plane, &'a [u32]> {
    let mut rest = kept.words.as_slice();
    let own = |plane: &Plane| {
        let (own, others) = rest.split_at(plane.state_words());
        rest = others;
        (std::ptr::from_ref(plane), own)
    };
    renderer.planes().map(own).collect()
}

impl<'a> Film<'a> {
    /// The film on the device.
    pub fn of(renderer: &'a Renderer<'a>) -> Film<'a> {
        Film { renderer, kept: None }
    }

    /// The sums of a tile's plane, by the number of samples of each pixel of the image.
    fn plane_sums(&self, tile: &TileFilm, plane: &Plane, samples: &dyn Fn(usize) -> u32) -> Result<Vec<Sum>> {
        let first = tile.rows().start as usize * self.renderer.settings.image.part().width as usize;
        let samples = &|pixel| samples(first + pixel);
        match &self.kept {
            Some(kept) => Ok(Plane::sums_of(kept[&std::ptr::from_ref(plane)], samples)),
            None => Ok(Plane::sums_of(&plane.state(self.renderer.gpu)?, samples)),
        }
    }

    /// The sums of a plane over the whole image, by the number of samples of each pixel; none if the tiles have no such
    /// plane.
    pub fn sums(
        &self,
        pick: &dyn Fn(&TileFilm) -> Option<&Plane>,
        samples: &dyn Fn(usize) -> u32,
    ) -> Result<Option<Vec<Sum>>> {
        let mut all = Vec::new();
        for tile in &self.renderer.tiles {
            let Some(plane) = pick(tile) else { return Ok(None) };
            all.extend(self.plane_sums(tile, plane, samples)?);
        }
        Ok(Some(all))
    }

    /// The means of a plane over the whole image; none if the tiles have no such plane.
    pub fn means(&self, pick: &dyn Fn(&TileFilm) -> Option<&Plane>) -> Result<Option<Vec<DVec4>>> {
        let sums = self.sums(pick, &|pixel| self.renderer.samples_of(pixel))?;
        Ok(sums.map(|sums| sums.iter().map(Sum::mean).collect()))
    }

    fn normals(&self) -> Result<Vec<DVec4>> {
        let mut normals = self.means(&|f| f.normal.as_ref())?.unwrap_or_default();
        normals.iter_mut().for_each(|n| *n = n.truncate().normalize_or_zero().extend(0.0));
        Ok(normals)
    }

    /// The share of each pixel's rays that hit a surface. It is w of `total` if the camera sees no environment; else
    /// there is a plane of albedo, whose w it is.
    fn surface_shares(&self, total: &[DVec4]) -> Result<Vec<f64>> {
        let albedo = self.means(&|f| f.albedo.as_ref())?;
        Ok(albedo.as_deref().unwrap_or(total).iter().map(|mean| mean.w).collect())
    }

    /// Positions in world space, by the share of each pixel's rays that hit a surface.
    fn positions(&self, shares: &[f64]) -> Result<Vec<DVec4>> {
        let mut positions = self.means(&|f| f.position.as_ref())?.unwrap_or_default();
        for (p, share) in positions.iter_mut().zip(shares) {
            let normalised = if *share > 0.0 { p.truncate() / *share } else { DVec3::ZERO };
            let normalisation = &self.renderer.scene.normalisation;
            let world = if *share > 0.0 { normalisation.undo_f64(normalised) } else { DVec3::ZERO };
            *p = world.extend(0.0);
        }
        Ok(positions)
    }

    /// Depth in world units; `shares` as for [`Film::positions`].
    fn depths(&self, shares: &[f64]) -> Result<Vec<f32>> {
        let positions = self.means(&|f| f.position.as_ref())?.unwrap_or_default();
        let scale = self.renderer.scene.normalisation.scale();
        let depth = |(p, share): (&DVec4, &f64)| (if *share > 0.0 { p.w / share / scale } else { NO_DEPTH }) as f32;
        Ok(positions.iter().zip(shares).map(depth).collect())
    }

    /// See [`variance_of_mean`].
    fn variances(&self, total: &[DVec4]) -> Result<Vec<DVec4>> {
        let squares = self.means(&|f| f.squares.as_ref())?.unwrap_or_default();
        let variance = |(pixel, (square, mean)): (usize, (&DVec4, &DVec4))| {
            variance_of_mean(*mean, *square, f64::from(self.renderer.samples_of(pixel)))
        };
        Ok(squares.iter().zip(total).enumerate().map(variance).collect())
    }

    /// Class, visibility, n_i and n_s of each light.
    fn push_class_channels(&self, channels: &mut Vec<Channel>) -> Result<()> {
        let renderer = self.renderer;
        let mut used = std::collections::HashSet::new();
        for (index, light) in renderer.scene.lights.iter().enumerate() {
            let Some(mut all) = self.means(&|f| f.classes.get(index))? else { return Ok(()) };
            // Only the first sample wrote its class into the sum.
            all.iter_mut().enumerate().for_each(|(pixel, v)| v.x *= f64::from(renderer.samples_of(pixel)));
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
}

fn push(channels: &mut Vec<Channel>, names: [&str; 3], values: &[DVec4]) {
    for (axis, name) in names.into_iter().enumerate() {
        channels.push(Channel { name: name.to_owned(), samples: values.iter().map(|v| v[axis] as f32).collect() });
    }
}

fn add_metadata(renderer: &Renderer<'_>, image: &mut Image) {
    let settings = &renderer.settings;
    let mut put = |name: &str, value: Metadata| {
        image.metadata.insert(name.to_owned(), value);
    };
    put("renderTimeSeconds", Metadata::Float(renderer.totals.time_render as f32));
    put("samplesPerPixel", Metadata::Int(renderer.mean_samples().round() as i32));
    let text = |s: &str| Metadata::Text(s.to_owned());
    put("penumbra:version", text(env!("CARGO_PKG_VERSION")));
    put("penumbra:technique", text(settings.technique.name()));
    put("penumbra:device", text(&renderer.gpu.info.name));
    put("penumbra:driver", text(&renderer.gpu.info.driver));
    put("penumbra:seed", Metadata::Int(settings.image.seed as i32));
    put("penumbra:photons", Metadata::Int(settings.photons_per_light() as i32));
    put("penumbra:nearest", Metadata::Int(settings.visibility_map.nearest as i32));
    put("penumbra:shadowSamples", Metadata::Int(settings.shadow_rays.samples as i32));
    let left_out: Vec<&str> = renderer.specialisation.left_out.iter().map(|item| item.name()).collect();
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
    let names = |items: &[crate::specialisation::Item]| items.iter().map(|item| item.name().to_owned()).collect();
    Statistics {
        schema: 2,
        version: env!("CARGO_PKG_VERSION"),
        device: gpu.info.clone(),
        settings: renderer.settings.clone().with(|s| {
            s.visibility_map.photons_per_light = Some(renderer.settings.photons_per_light());
        }),
        samples: renderer.samples,
        mean_samples: renderer.mean_samples(),
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
            instances: scene.instances.len() as u64,
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
