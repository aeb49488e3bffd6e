//! The files of pieces: EXR images with the sums in further channels, and a description as an attribute.
//!
//! The channel `piece.8-16.direct.R` has the sum of red over the samples 8 to 15 of direct light, `A` that of the
//! coverage; `piece.8-16.direct.rest.R` has what rounding has cut off that sum, and `rest.A` the number of samples left
//! out.

use std::path::Path;

use glam::DVec3;
use serde::{Deserialize, Serialize};

use super::sums::{Node, PieceSums, Total, half_of, nodes_of};
use crate::fingerprint::Fingerprint;
use crate::render::film::{Channel, Image, Metadata, decode_metadata, read_file};
use crate::render::picture::Quantity;
use crate::render::renderer::Renderer;
use crate::render::tiles::first_half;
use crate::scene::Normalisation;
use crate::settings::values::SettingValues;
use crate::settings::{Aov, Background, Crop, Denoise, SampleRange};
use crate::statistics::Counter;
use crate::{Error, Result};

/// The attribute with the description.
pub(super) const DESCRIPTION: &str = "penumbra:piece";

/// The number rises when the format changes.
const FORMAT: u32 = 3;

/// Data that all pieces of an image have in common.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Whole {
    pub format: u32,
    pub version: String,
    /// Name and driver of the device: other ones round differently.
    pub device: String,
    /// Fingerprint of scene, camera and settings, without crop and sample range.
    pub fingerprint: String,
    /// The same settings, for errors.
    pub settings: SettingValues,
    pub size: [u32; 2],
    pub samples: u32,
    pub aovs: Vec<String>,
    transparent: bool,
    /// The bits of a colour: decimals may round.
    colour: Option<[u32; 3]>,
    centre: [u64; 3],
    exponent: i32,
    /// The camera has a lens, so rays of a pixel that shows the environment alone have random directions.
    pub has_lens: bool,
    pub quantities: Vec<Quantity>,
    /// Samples of the first half that denoisers need; `None` if the pieces keep nothing for them. See
    /// [`super::sums::nodes_of`].
    pub half: Option<u32>,
}

impl Whole {
    pub fn background(&self) -> Background {
        match self.colour {
            _ if self.transparent => Background::Transparent,
            Some(colour) => Background::Colour(colour.map(f32::from_bits)),
            None => Background::Environment,
        }
    }

    pub fn normalisation(&self) -> Normalisation {
        Normalisation { centre: DVec3::from(self.centre.map(f64::from_bits)), exponent: self.exponent }
    }

    pub fn aovs(&self) -> Option<Vec<Aov>> {
        self.aovs.iter().map(|name| name.parse().ok()).collect()
    }
}

/// The description of a piece.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Description {
    pub whole: Whole,
    /// Number of the first sample, and the number after the last.
    samples: [u32; 2],
    /// Column and row of its first pixel, width and height.
    crop: [u32; 4],
    /// Number of samples that were left out because they are not finite.
    pub not_finite: u64,
    /// Hash of everything else, and of the sums.
    digest: String,
}

impl Description {
    pub fn range(&self) -> SampleRange {
        let [first, end] = self.samples;
        SampleRange { first, end }
    }

    pub fn crop(&self) -> Crop {
        let [x, y, width, height] = self.crop;
        Crop { x, y, width, height }
    }

    /// Whether its numbers fit each other.
    fn is_sound(&self) -> bool {
        let Crop { x, y, width, height } = self.crop();
        let SampleRange { first, end } = self.range();
        let [whole_width, whole_height] = self.whole.size;
        let fits = |first: u32, side: u32, whole: u32| side > 0 && first.checked_add(side).is_some_and(|e| e <= whole);
        first <= end
            && end <= self.whole.samples
            && fits(x, width, whole_width)
            && fits(y, height, whole_height)
            && self.whole.aovs().is_some()
            && self.whole.half.is_none_or(|half| self.whole.samples > 1 && half == first_half(self.whole.samples))
    }

    /// The digest of the description and of the sums.
    fn digest_with<'a>(&self, sums: impl Iterator<Item = &'a [f32]>) -> String {
        let mut fingerprint = Fingerprint::default();
        let own = Description { digest: String::new(), ..self.clone() };
        fingerprint.write_bytes(format!("{own:?}").as_bytes());
        sums.for_each(|samples| fingerprint.write_bytes(bytemuck::cast_slice(samples)));
        fingerprint.finish()
    }

    /// The description in the metadata of a file.
    fn of(metadata: Option<&Metadata>, path: &Path) -> Result<Description> {
        let refuse = |problem: &str| Error::input(path, "file", problem);
        let Some(Metadata::Text(text)) = metadata else {
            return Err(refuse("the file is not a piece that `image.piece` makes"));
        };
        let known: serde_json::Value = serde_json::from_str(text).map_err(|_| refuse("the file is damaged"))?;
        if known["whole"]["format"] != FORMAT || known["whole"]["version"] != env!("CARGO_PKG_VERSION") {
            let version = known["whole"]["version"].as_str().unwrap_or("another");
            return Err(refuse(&format!("the file was written by version {version} of Penumbra")));
        }
        let description: Description = serde_json::from_value(known).map_err(|_| refuse("the file is damaged"))?;
        if description.is_sound() { Ok(description) } else { Err(refuse("the file is damaged")) }
    }

    /// Reads the description of a file, without decoding its pixels.
    pub fn read(path: &Path) -> Result<Description> {
        let metadata = decode_metadata(&read_file(path)?, path)?;
        Description::of(metadata.get(DESCRIPTION), path)
    }
}

/// A piece in a file.
pub(super) struct File {
    pub description: Description,
    /// The nodes of its samples, in order.
    pub nodes: Vec<Node>,
    pub metadata: std::collections::BTreeMap<String, Metadata>,
}

impl File {
    /// Reads and checks a file.
    pub fn read(path: &Path) -> Result<File> {
        let mut image = Image::read_exr(path)?;
        let description = Description::of(image.metadata.get(DESCRIPTION), path)?;
        let damaged = || Error::input(path, "file", "the file is damaged");
        let Crop { width, height, .. } = description.crop();
        if [image.width, image.height] != [width, height] {
            return Err(damaged());
        }
        let named: std::collections::HashMap<&str, &[f32]> =
            image.channels.iter().map(|channel| (channel.name.as_str(), channel.samples.as_slice())).collect();
        let mut read = Vec::new();
        let mut nodes = Vec::new();
        for range in nodes_of(description.range(), description.whole.half) {
            let mut node = Node { range, quantities: Vec::new() };
            for quantity in &description.whole.quantities {
                let mut totals = vec![Total::default(); image.pixels()];
                for (component, name) in names(range, *quantity).into_iter().enumerate() {
                    let samples = *named.get(name.as_str()).ok_or_else(damaged)?;
                    for (total, sample) in totals.iter_mut().zip(samples) {
                        *component_of(total, component) = *sample;
                    }
                    read.push(samples);
                }
                node.quantities.push(totals);
            }
            nodes.push(node);
        }
        if description.digest_with(read.into_iter()) != description.digest {
            return Err(damaged());
        }
        Ok(File { description, nodes, metadata: std::mem::take(&mut image.metadata) })
    }
}

/// The names of the channels of a quantity of a node: x, y, z and w of the values, then of the rests.
fn names(SampleRange { first, end }: SampleRange, quantity: Quantity) -> [String; 8] {
    let quantity = quantity.name();
    ["R", "G", "B", "A", "rest.R", "rest.G", "rest.B", "rest.A"]
        .map(|component| format!("piece.{first}-{end}.{quantity}.{component}"))
}

fn component_of(total: &mut Total, component: usize) -> &mut f32 {
    match component {
        0..4 => &mut total.value[component],
        _ => &mut total.rest[component - 4],
    }
}

/// The description that makes an image a piece.
pub(in crate::render) struct Piece(Description);

impl Piece {
    /// The piece that a renderer makes; `None` if it makes a whole image.
    pub fn of(renderer: &Renderer<'_>) -> Option<Piece> {
        let sums = renderer.piece_sums.as_ref()?;
        let settings = &renderer.settings;
        let image = &settings.image;
        let uncut = settings.clone().with(|s| {
            (s.image.crop, s.image.piece) = (None, None);
            // All denoisers need the same sums, so pieces for different ones can be merged.
            s.image.denoise = if s.image.denoise == Denoise::None { Denoise::None } else { Denoise::Auto };
        });
        let device = &renderer.gpu.info;
        let Crop { x, y, width, height } = image.crop_window();
        let Normalisation { centre, exponent } = renderer.scene.normalisation;
        let whole = Whole {
            format: FORMAT,
            version: env!("CARGO_PKG_VERSION").to_owned(),
            device: format!("{} ({})", device.name, device.driver),
            fingerprint: renderer.scene.fingerprint(&(&renderer.camera, &uncut)),
            settings: uncut.values(),
            size: [image.width, image.height],
            samples: image.spp,
            aovs: image.aovs.iter().map(|aov| aov.name().to_owned()).collect(),
            transparent: image.background == Background::Transparent,
            colour: match image.background {
                Background::Colour(colour) => Some(colour.map(f32::to_bits)),
                _ => None,
            },
            centre: centre.to_array().map(f64::to_bits),
            exponent,
            has_lens: renderer.camera.lens.is_some(),
            quantities: sums.quantities.clone(),
            half: half_of(image),
        };
        let not_finite = renderer.totals.get(Counter::NotFinite);
        let crop = [x, y, width, height];
        Some(Piece(Description { whole, samples: [0; 2], crop, not_finite, digest: String::new() }))
    }

    /// Adds the sums and the description to the image of these sums.
    pub fn add_to(self, image: &mut Image, sums: &PieceSums) {
        let Piece(mut description) = self;
        description.samples = [sums.range.first, sums.range.end];
        let before = image.channels.len();
        for Node { range, quantities } in &sums.nodes {
            for (quantity, totals) in sums.quantities.iter().zip(quantities) {
                for (component, name) in names(*range, *quantity).into_iter().enumerate() {
                    let samples = totals.iter().map(|total| *component_of(&mut total.clone(), component)).collect();
                    image.channels.push(Channel { name, samples });
                }
            }
        }
        let sums = image.channels[before..].iter().map(|channel| channel.samples.as_slice());
        description.digest = description.digest_with(sums);
        // Numbers and text are always JSON.
        let text = serde_json::to_string(&description).unwrap_or_default();
        image.metadata.insert(DESCRIPTION.to_owned(), Metadata::Text(text));
    }
}
