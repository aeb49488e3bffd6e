//! Putting pieces together.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use glam::DVec4;
use kernel_kit::Gpu;

use super::coverage::{Cells, Extent, MissingSamples, is_within, missing, overlap};
use super::file::{DESCRIPTION, Description, File, Whole};
use super::sums::{Node, Total, first_half_totals, nodes_of, push, totals};
use crate::passes::film::Sum;
use crate::render::denoise::Denoiser;
use crate::render::film::{Channel, Image, Metadata};
use crate::render::host_memory::{channels, denoisers, refuse_without_room};
use crate::render::noisy::add_denoised;
use crate::render::picture::{Picture, Quantity, Sums};
use crate::settings::values::difference;
use crate::settings::{Background, Crop};
use crate::{Error, Result};

/// Pieces of an image, in files that fit each other.
#[derive(Debug)]
pub struct Pieces {
    whole: Whole,
    /// In the order of their samples, then from the top and from the left.
    files: Vec<(PathBuf, Description)>,
}

impl Pieces {
    /// Reads the descriptions of pieces, in any order.
    ///
    /// # Errors
    /// [`Error::Input`] that names a file that is missing, damaged, no piece, of another scene, other settings, another
    /// version or another kind of device than the first one, or that has samples that another one has too;
    /// [`Error::Usage`] for no files.
    pub fn open(paths: &[impl AsRef<Path>]) -> Result<Pieces> {
        let read = |path: &Path| Ok((path.to_owned(), Description::read(path)?));
        let mut files = paths.iter().map(|path| read(path.as_ref())).collect::<Result<Vec<_>>>()?;
        let Some((first, Description { whole, .. })) = files.first().cloned() else {
            return Err(Error::Usage("no pieces are given".into()));
        };
        for (path, Description { whole: other, .. }) in &files {
            if *other == whole {
                continue;
            }
            let what = if other.device != whole.device {
                format!("another device, {},", other.device)
            } else if let Some(difference) = difference(&other.settings, &whole.settings) {
                format!("other settings ({difference})")
            } else {
                "another scene or camera".to_owned()
            };
            return Err(Error::input(path, "file", format!("the piece is of {what} than {}", first.display())));
        }
        files.sort_by_key(|(_, description)| {
            let (range, crop) = (description.range(), description.crop());
            (range.first, crop.y, crop.x)
        });
        for (i, (path, description)) in files.iter().enumerate() {
            let extent = extent_of(description);
            let others = files[..i].iter().find(|(_, other)| overlap(&extent, &extent_of(other)));
            if let Some((other, _)) = others {
                let (range, crop) = extent;
                let problem = format!(
                    "the piece has samples {range} of the pixels {crop}, some of which {} has too",
                    other.display()
                );
                return Err(Error::input(path, "file", problem));
            }
        }
        Ok(Pieces { whole, files })
    }

    /// The samples that no piece has.
    pub fn missing(&self) -> Vec<MissingSamples> {
        missing(self.whole.size, self.whole.samples, &self.extents())
    }

    fn extents(&self) -> Vec<Extent> {
        self.files.iter().map(|(_, description)| extent_of(description)).collect()
    }

    /// The image of all samples of the pieces. If none is [`Pieces::missing`], it has the same bits however it was
    /// divided. Pixels without samples are black. One piece at a time is in memory.
    ///
    /// # Errors
    /// [`Error::Input`] that names a file that is damaged; [`Error::Memory`] if the machine has too little.
    pub fn merge(&self) -> Result<Image> {
        self.check_memory(0, "merge pieces of fewer `image.aovs` or of a smaller image")?;
        self.merge_and(|_, _| Ok(()))
    }

    /// Refuses pieces that have no room in the memory that is available: without it the system would end the process
    /// without a word. `denoisers` are the bytes that they take of a pixel.
    fn check_memory(&self, denoisers: u64, remedy: &str) -> Result<()> {
        let Whole { size: [width, height], half, ref quantities, .. } = self.whole;
        let total = (quantities.len() * size_of::<Total>()) as u64;
        // Descriptions may state any size.
        let bytes = |crop: &Crop, each: u64| crop.pixels().saturating_mul(each);
        let mut sums = 0u64;
        for cell in Cells::new(self.whole.size, &self.extents()).all() {
            let mut nodes = Vec::new();
            for (_, piece) in self.files.iter().filter(|(_, piece)| is_within(&cell, &piece.crop())) {
                let ranges = nodes_of(piece.range(), half);
                ranges.into_iter().for_each(|range| push(&mut nodes, Node { range, quantities: Vec::new() }, half));
            }
            sums = sums.saturating_add(bytes(&cell, nodes.len() as u64 * total));
        }
        // The totals of a file are in its channels first.
        let read = |(_, piece): &(PathBuf, Description)| {
            bytes(&piece.crop(), 2 * nodes_of(piece.range(), half).len() as u64 * total)
        };
        let file = self.files.iter().map(read).max().unwrap_or(0);
        // Channels are made from means of direct light, of indirect light, of their sum and of what is shown.
        let means = 4 * size_of::<DVec4>() as u64;
        let pixel = size_of::<u32>() as u64 + channels(&self.whole.aovs().unwrap_or_default()) + means.max(denoisers);
        let all = Crop { x: 0, y: 0, width, height };
        let needed = file.max(sums.saturating_add(bytes(&all, pixel)));
        refuse_without_room(self.whole.size, needed, || remedy.to_owned())
    }

    /// Whether they keep what denoisers need.
    pub fn have_guides(&self) -> bool {
        let guides = [Quantity::GuideAlbedo, Quantity::GuideNormal, Quantity::GuidePosition];
        guides.iter().all(|guide| self.whole.quantities.contains(guide))
    }

    /// As [`Pieces::merge`], with the channels that [`Renderer::denoised_image`](crate::Renderer::denoised_image) adds.
    /// The statistical denoiser runs on `gpu`, and has the same bits on devices of one kind.
    ///
    /// # Errors
    /// As [`Pieces::merge`]; [`Error::Input`] if samples are missing, or the pieces keep nothing for denoisers;
    /// [`Error::Input`] with the library of a denoiser that fails.
    pub fn merge_denoised(&self, gpu: &Gpu, denoiser: &Denoiser) -> Result<Image> {
        let refuse = |problem: &str| Err(Error::input(&self.files[0].0, "file", problem));
        if !self.have_guides() {
            return refuse("the pieces keep nothing for denoisers: `image.denoise` was none when they were rendered");
        }
        if !self.missing().is_empty() {
            return refuse("the pieces lack samples, and denoisers need all of them");
        }
        let has_indirect = self.whole.quantities.contains(&Quantity::Indirect);
        self.check_memory(denoisers(has_indirect, self.whole.half.is_some()), "choose `image.denoise` none")?;
        let (size, background) = (self.whole.size, self.whole.background());
        self.merge_and(|image, merged| add_denoised(image, denoiser, gpu, merged, size, background))
    }

    /// Like [`Pieces::merge`]; `add` may add channels to the image from the sums.
    fn merge_and(&self, add: impl FnOnce(&mut Image, &Merged<'_>) -> Result<()>) -> Result<Image> {
        let cells = Cells::new(self.whole.size, &self.extents()).all();
        let mut sums = vec![Vec::new(); cells.len()];
        let mut samples = vec![0; cells.len()];
        let mut metadata = None;
        let mut not_finite = 0;
        for (path, described) in &self.files {
            let File { description, nodes, metadata: of_file } = File::read(path)?;
            if description != *described {
                return Err(Error::input(path, "file", "the file has changed since it was read first"));
            }
            not_finite += description.not_finite;
            metadata.get_or_insert(of_file);
            let crop = description.crop();
            for (index, cell) in cells.iter().enumerate().filter(|(_, cell)| is_within(cell, &crop)) {
                let half = self.whole.half;
                nodes.iter().for_each(|node| push(&mut sums[index], part_of(node, &crop, cell), half));
                samples[index] += description.range().count();
            }
        }
        let pixels = |cell: usize| cells[cell].pixels() as usize;
        let samples = spread(self.whole.size, &cells, |cell| Some(vec![samples[cell]; pixels(cell)]));
        let mean = samples.iter().map(|n| f64::from(*n)).sum::<f64>() / samples.len() as f64;
        let merged = Merged { whole: &self.whole, cells: &cells, sums: &sums, samples };
        let mut image = self.image(&merged)?;
        add(&mut image, &merged)?;
        image.metadata = self.metadata(metadata.unwrap_or_default(), mean, not_finite);
        Ok(image)
    }

    fn image(&self, merged: &Merged<'_>) -> Result<Image> {
        let whole = &self.whole;
        let aovs = whole.aovs().unwrap_or_default();
        let (background, normalisation) = (whole.background(), whole.normalisation());
        let picture = Picture { aovs: &aovs, background, normalisation: &normalisation };
        let [width, height] = whole.size;
        let transparent = background == Background::Transparent;
        Ok(Image { width, height, channels: picture.channels(merged)?, transparent, ..Image::default() })
    }

    /// The image's metadata, from that of a piece.
    fn metadata(
        &self,
        mut metadata: BTreeMap<String, Metadata>,
        samples: f64,
        not_finite: u64,
    ) -> BTreeMap<String, Metadata> {
        // These describe the piece alone.
        for name in [DESCRIPTION, "penumbra:conditioning", "penumbra:fingerprint"] {
            metadata.remove(name);
        }
        metadata.insert("samplesPerPixel".into(), Metadata::Int(samples.round() as i32));
        metadata.insert("penumbra:notFinite".into(), Metadata::Int(not_finite.min(i32::MAX as u64) as i32));
        metadata
    }
}

fn extent_of(description: &Description) -> Extent {
    (description.range(), description.crop())
}

/// The pixels of a node that are in a cell.
fn part_of(node: &Node, crop: &Crop, cell: &Crop) -> Node {
    let rows = |totals: &Vec<Total>| -> Vec<Total> {
        let row = |y: u32| {
            let first = (y - crop.y) as usize * crop.width as usize + (cell.x - crop.x) as usize;
            &totals[first..first + cell.width as usize]
        };
        (cell.y..cell.y + cell.height).flat_map(row).copied().collect()
    };
    Node { range: node.range, quantities: node.quantities.iter().map(rows).collect() }
}

/// The sums of merged pieces.
struct Merged<'a> {
    whole: &'a Whole,
    cells: &'a [Crop],
    /// The nodes of each cell.
    sums: &'a [Vec<Node>],
    /// The number of samples of each pixel.
    samples: Vec<u32>,
}

/// The values of all pixels, from the values of each cell.
fn spread<T: Clone + Default>(
    [width, height]: [u32; 2],
    cells: &[Crop],
    values: impl Fn(usize) -> Option<Vec<T>>,
) -> Vec<T> {
    let mut image = vec![T::default(); width as usize * height as usize];
    for (index, cell) in cells.iter().enumerate() {
        for (y, row) in values(index).unwrap_or_default().chunks(cell.width as usize).enumerate() {
            let first = (cell.y as usize + y) * width as usize + cell.x as usize;
            image[first..][..row.len()].clone_from_slice(row);
        }
    }
    image
}

impl Sums for Merged<'_> {
    fn has_lens(&self) -> bool {
        self.whole.has_lens
    }

    fn sums(&self, quantity: Quantity) -> Result<Option<Vec<Sum>>> {
        let Some(index) = self.whole.quantities.iter().position(|own| *own == quantity) else { return Ok(None) };
        let all = spread(self.whole.size, self.cells, |cell| totals(&self.sums[cell], index));
        Ok(Some(all.into_iter().zip(&self.samples).map(|(total, samples)| total.sum(*samples)).collect()))
    }

    fn first_halves(&self, quantity: Quantity) -> Result<Option<Vec<Sum>>> {
        let index = self.whole.quantities.iter().position(|own| *own == quantity);
        let (Some(index), Some(half)) = (index, self.whole.half) else { return Ok(None) };
        let all = spread(self.whole.size, self.cells, |cell| first_half_totals(&self.sums[cell], index, half));
        Ok(Some(all.into_iter().map(|total| total.sum(half)).collect()))
    }

    fn samples_of(&self, pixel: usize) -> u32 {
        self.samples[pixel]
    }

    fn shared_errors(&self) -> Option<&[f32]> {
        // Pieces have the rays that they start with, so no change shows their error.
        None
    }

    fn push_class_channels(&self, _: &mut Vec<Channel>) -> Result<()> {
        Ok(())
    }
}
