//! The image and the statistics of a render.

use std::collections::{BTreeMap, HashMap, HashSet};
use std::ops::Range;

use glam::DVec4;
use kernel_kit::Gpu;

use super::checkpoint::Checkpoint;
use super::conditioning;
use super::picture::{Picture, Quantity, Sums};
use super::pieces::{Piece, PieceSums};
use super::renderer::Renderer;
use super::tiles::{TileFilm, first_half};
use crate::passes::film::{Plane, Sum};
use crate::render::film::{Channel, MAX_NAME_BYTES, Metadata, Window};
use crate::settings::Background;
use crate::statistics::{Counter, Memory, SceneCounts, Statistics, Times};
use crate::{Image, Result};

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
        Ok(statistics(self, self.pass_times()?))
    }

    /// Seconds that this render, all its views together, spent on the device so far, by label of pass.
    ///
    /// # Errors
    /// As [`Gpu::pass_times`].
    pub(crate) fn pass_times(&self) -> Result<BTreeMap<String, f64>> {
        Ok(self.without_earlier_renders(self.gpu.pass_times()?))
    }

    /// The pass times of this render: those of the device minus those of earlier renders.
    pub(super) fn without_earlier_renders(&self, mut passes: BTreeMap<String, f64>) -> BTreeMap<String, f64> {
        passes.retain(|name, seconds| {
            *seconds -= self.earlier_pass_times.get(name).unwrap_or(&0.0);
            *seconds > 0.0
        });
        passes
    }
}

/// The image of the film on the device, or of the state that was `kept`.
pub(super) fn image(renderer: &Renderer<'_>, kept: Option<&Checkpoint>) -> Result<Image> {
    let settings = &renderer.settings;
    let kept = kept.map(|kept| Kept::new(renderer, kept));
    let film = Film { kept: kept.as_ref(), ..Film::of(renderer) };
    let normalisation = &renderer.scene.normalisation;
    let picture = Picture { aovs: &settings.image.aovs, background: settings.image.background, normalisation };
    let crop = settings.image.crop_window();
    let mut channels = Vec::new();
    for tiles in film.tiles_at_once() {
        append(&mut channels, picture.channels(&Film { tiles, ..film })?, crop.pixels() as usize);
    }
    let mut image = Image { width: crop.width, height: crop.height, channels, ..Image::default() };
    image.transparent = settings.image.background == Background::Transparent;
    image.crop = settings
        .image
        .crop
        .map(|crop| Window { at: [crop.x, crop.y], of: [settings.image.width, settings.image.height] });
    image.add_camera(&renderer.camera, &renderer.scene.normalisation);
    add_metadata(renderer, &mut image);
    if let (Some(piece), Some(sums)) = (Piece::of(renderer), film.piece_sums()) {
        piece.add_to(&mut image, sums);
    }
    Ok(image)
}

/// Adds the samples of further pixels to channels, which have `pixels` pixels in the end.
fn append(channels: &mut Vec<Channel>, more: Vec<Channel>, pixels: usize) {
    if channels.is_empty() {
        *channels = more;
        channels.iter_mut().for_each(|channel| channel.samples.reserve_exact(pixels - channel.samples.len()));
    } else {
        channels.iter_mut().zip(more).for_each(|(channel, more)| channel.samples.extend(more.samples));
    }
}

/// The sums of samples, on the device or kept, of some tiles. Pixels are counted from the first of these.
pub(super) struct Film<'a> {
    renderer: &'a Renderer<'a>,
    /// The sums in a checkpoint, if they are not on the device.
    kept: Option<&'a Kept<'a>>,
    tiles: Range<usize>,
}

/// The sums in a checkpoint.
struct Kept<'a> {
    /// The words of each plane.
    planes: HashMap<*const Plane, &'a [u32]>,
    piece_sums: Option<PieceSums>,
}

impl<'a> Kept<'a> {
    fn new(renderer: &Renderer<'_>, kept: &'a Checkpoint) -> Kept<'a> {
        let mut rest = kept.words.as_slice();
        if let Some(sums) = &renderer.piece_sums {
            let piece_sums = sums.restored(kept.header.samples, &mut rest);
            return Kept { planes: HashMap::new(), piece_sums };
        }
        let own = |plane: &Plane| {
            let (own, others) = rest.split_at(plane.state_words());
            rest = others;
            (std::ptr::from_ref(plane), own)
        };
        Kept { planes: renderer.planes().map(own).collect(), piece_sums: None }
    }
}

impl Sums for Film<'_> {
    fn has_lens(&self) -> bool {
        self.renderer.camera.lens.is_some()
    }

    fn sums(&self, quantity: Quantity) -> Result<Option<Vec<Sum>>> {
        match self.piece_sums() {
            Some(sums) => Ok(sums.totals(quantity)),
            None => self.plane_sums(&|f| f.plane(quantity), &|pixel| self.samples_of(pixel)),
        }
    }

    fn first_halves(&self, quantity: Quantity) -> Result<Option<Vec<Sum>>> {
        let component = match quantity {
            Quantity::Direct => 0,
            Quantity::Indirect => 1,
            _ => return Ok(None),
        };
        // A piece may have samples of one half alone.
        if self.renderer.sampling.samples < 2 || self.piece_sums().is_some() {
            return Ok(None);
        }
        let half = |pixel: usize| first_half(self.samples_of(pixel));
        let snapshot = |k: usize| self.plane_sums(&|f| Some(&f.components.get(component)?.snapshots[k]), &half);
        let (Some(even), Some(odd)) = (snapshot(0)?, snapshot(1)?) else { return Ok(None) };
        let pick = |(pixel, sums): (usize, [Sum; 2])| sums[half(pixel).ilog2() as usize % 2];
        Ok(Some(even.into_iter().zip(odd).map(<[Sum; 2]>::from).enumerate().map(pick).collect()))
    }

    fn samples_of(&self, pixel: usize) -> u32 {
        self.renderer.samples_of(self.first_pixel() + pixel)
    }

    fn shared_errors(&self) -> Option<&[f32]> {
        self.renderer.sampling.growth.as_ref()?.errors.as_ref()?.get(self.first_pixel()..)
    }

    fn push_class_channels(&self, channels: &mut Vec<Channel>) -> Result<()> {
        self.push_classes(channels)
    }
}

impl<'a> Film<'a> {
    /// The film on the device, of the whole image.
    pub fn of(renderer: &'a Renderer<'a>) -> Film<'a> {
        Film { renderer, kept: None, tiles: 0..renderer.view.tiles.len() }
    }

    /// The tiles whose channels are made at once: single ones, because sums take more memory than channels. The sums of
    /// a piece are in memory for the whole image.
    fn tiles_at_once(&self) -> Vec<Range<usize>> {
        match self.piece_sums() {
            Some(_) => vec![self.tiles.clone()],
            None => self.tiles.clone().map(|tile| tile..tile + 1).collect(),
        }
    }

    /// The number of the first pixel in the image.
    fn first_pixel(&self) -> usize {
        self.first_pixel_of(&self.renderer.view.tiles[self.tiles.start])
    }

    fn first_pixel_of(&self, tile: &TileFilm) -> usize {
        tile.rows().start as usize * self.renderer.settings.image.crop_window().width as usize
    }

    /// The sums of a tile's plane, by the number of samples of each pixel.
    fn tile_sums(&self, tile: &TileFilm, plane: &Plane, samples: &dyn Fn(usize) -> u32) -> Result<Vec<Sum>> {
        let first = self.first_pixel_of(tile) - self.first_pixel();
        let samples = &|pixel| samples(first + pixel);
        match self.kept {
            Some(kept) => Ok(Plane::sums_of(kept.planes[&std::ptr::from_ref(plane)], samples)),
            None => Ok(Plane::sums_of(&plane.state(self.renderer.gpu)?, samples)),
        }
    }

    /// The sums of a piece.
    fn piece_sums(&self) -> Option<&PieceSums> {
        match &self.kept {
            Some(kept) => kept.piece_sums.as_ref(),
            None => self.renderer.piece_sums.as_ref(),
        }
    }

    /// The sums of a plane over all pixels; `samples` returns the number of samples of a pixel. `None` if the
    /// tiles have no such plane.
    pub fn plane_sums(
        &self,
        pick: &dyn Fn(&TileFilm) -> Option<&Plane>,
        samples: &dyn Fn(usize) -> u32,
    ) -> Result<Option<Vec<Sum>>> {
        let mut all = Vec::new();
        for tile in &self.renderer.view.tiles[self.tiles.clone()] {
            let Some(plane) = pick(tile) else { return Ok(None) };
            all.extend(self.tile_sums(tile, plane, samples)?);
        }
        Ok(Some(all))
    }

    /// Class, visibility, n_i and n_s of each light.
    fn push_classes(&self, channels: &mut Vec<Channel>) -> Result<()> {
        let lights = &self.renderer.scene.lights;
        for (index, layer) in layers_of_lights(lights.iter().map(|light| light.name.as_str())).iter().enumerate() {
            let sums = self.plane_sums(&|f| f.classes.get(index), &|pixel| self.samples_of(pixel))?;
            let Some(sums) = sums else { return Ok(()) };
            // Only the first sample wrote its class into the sum.
            let mean = |sum: &Sum| DVec4 { x: sum.total.x, ..sum.mean() };
            let all: Vec<DVec4> = sums.iter().map(mean).collect();
            for (axis, suffix) in ["class", "visibility", "ni", "ns"].into_iter().enumerate() {
                let samples = all.iter().map(|v| v[axis] as f32).collect();
                channels.push(Channel { name: format!("shadow.{layer}.{suffix}"), samples });
            }
        }
        Ok(())
    }
}

/// The layers of lights with these names: different ones, and short enough for the channels in them. Files may have
/// many lights of one name, and names that are longer than those of channels.
fn layers_of_lights<'a>(names: impl Iterator<Item = &'a str>) -> Vec<String> {
    let max_bytes = MAX_NAME_BYTES - "shadow..visibility".len();
    let mut used = HashSet::new();
    let layer = |(index, name): (usize, &str)| {
        // A dot ends a layer's name.
        let name = name.replace('.', "_");
        let with_end = |end: &str| format!("{}{end}", &name[..name.floor_char_boundary(max_bytes - end.len())]);
        let (mut layer, mut number) = (with_end(""), index);
        while !used.insert(layer.clone()) {
            layer = with_end(&format!("_{number}"));
            number += 1;
        }
        layer
    };
    names.enumerate().map(layer).collect()
}

fn add_metadata(renderer: &Renderer<'_>, image: &mut Image) {
    let settings = &renderer.settings;
    let mut put = |name: &str, value: Metadata| {
        image.metadata.insert(name.to_owned(), value);
    };
    put("samplesPerPixel", Metadata::Int(renderer.mean_samples().round() as i32));
    let text = |s: &str| Metadata::Text(s.to_owned());
    put("penumbra:version", text(env!("CARGO_PKG_VERSION")));
    put("penumbra:technique", text(settings.technique.name()));
    put("penumbra:device", text(&renderer.gpu.info.name));
    put("penumbra:driver", text(&renderer.gpu.info.driver));
    // As text, since integers of EXR end at 2^31 - 1.
    put("penumbra:seed", Metadata::Text(settings.image.seed.to_string()));
    let lights = renderer.scene.placed_lights().len();
    put("penumbra:photons", Metadata::Int(settings.photons_of_light(lights) as i32));
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
            s.indirect.photons = Some(renderer.settings.flux_photons());
            s.indirect.irradiance_cache.gather_rays = Some(renderer.settings.gather_rays());
        }),
        samples: renderer.sampling.samples,
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
            first_sample: totals.time_first_sample,
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

#[cfg(test)]
mod tests {
    use std::collections::HashSet;

    use super::{MAX_NAME_BYTES, layers_of_lights};

    #[test]
    fn layers_of_lights_differ_and_are_short_enough() {
        let layers = |names: &[&str]| layers_of_lights(names.iter().copied());
        assert_eq!(layers(&["Lamp", "a.b", "Lamp"]), ["Lamp", "a_b", "Lamp_2"]);
        assert_eq!(layers(&["Lamp_2", "Lamp", "Lamp", "Lamp"]), ["Lamp_2", "Lamp", "Lamp_3", "Lamp_4"]);
        // Letters of two bytes: the last byte that has room begins one.
        let long = "ä".repeat(300);
        let found = layers(&[&long, &long, &long]);
        assert_eq!(found.iter().collect::<HashSet<_>>().len(), 3, "{found:?}");
        for layer in &found {
            let length = format!("shadow.{layer}.visibility").len();
            assert!(layer.starts_with("ää") && length == MAX_NAME_BYTES - 1, "{layer}");
        }
    }
}
