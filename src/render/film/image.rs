//! The image: named channels of scene-linear f32, and metadata.

use std::borrow::Cow;

/// An image. Its channels have the same size, with rows from top to bottom.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Image {
    /// Width in pixels.
    pub width: u32,
    /// Height in pixels.
    pub height: u32,
    /// Channels with EXR names, such as `R`, `G`, `B`, `A`, `direct.R`, `N.X`, `Z`, `shadow.lamp.class`.
    pub channels: Vec<Channel>,
    /// Whether a PNG of it has an alpha channel. Else it is over black.
    pub transparent: bool,
    /// Where it lies in a larger image, if it is a part of one. An EXR has that as its data window.
    pub crop: Option<Window>,
    /// EXR attributes (camera, counts, seed, technique, device, version), sorted by name.
    pub metadata: std::collections::BTreeMap<String, Metadata>,
}

/// Where an image lies in a larger one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Window {
    /// Column and row of its first pixel.
    pub at: [u32; 2],
    /// Width and height of the larger image.
    pub of: [u32; 2],
}

/// Key of the metadata that identifies the scene and the settings of an image file.
pub(super) const FINGERPRINT: &str = "penumbra:fingerprint";

/// A channel of an [`Image`].
#[derive(Clone, Debug, PartialEq)]
pub struct Channel {
    /// Name in the EXR file.
    pub name: String,
    /// `width * height` samples.
    pub samples: Vec<f32>,
}

/// The value of an EXR attribute.
#[derive(Clone, Debug, PartialEq)]
pub enum Metadata {
    /// Text.
    Text(String),
    /// An integer.
    Int(i32),
    /// A floating-point number.
    Float(f32),
    /// A row-major 4 x 4 matrix for row vectors, as in OpenEXR.
    Matrix([f32; 16]),
}

impl Image {
    /// An image of `width * height` pixels without channels.
    pub fn new(width: u32, height: u32) -> Self {
        Image { width, height, ..Default::default() }
    }

    /// The number of pixels, `width * height`.
    pub fn pixels(&self) -> usize {
        self.width as usize * self.height as usize
    }

    /// The samples of the channel `name`, row by row from the top.
    pub fn channel(&self, name: &str) -> Option<&[f32]> {
        self.channels.iter().find(|channel| channel.name == name).map(|channel| channel.samples.as_slice())
    }

    /// The image with those of its channels that are `R`, `G` or `B`.
    pub fn colour(&self) -> Image {
        let is_colour = |channel: &&Channel| ["R", "G", "B"].contains(&channel.name.as_str());
        let channels = self.channels.iter().filter(is_colour).cloned().collect();
        let Image { width, height, ref metadata, crop, transparent, .. } = *self;
        Image { width, height, channels, metadata: metadata.clone(), crop, transparent }
    }

    /// The root channels `R`, `G` and `B`.
    ///
    /// # Errors
    /// The name of the first missing channel.
    pub fn rgb(&self) -> std::result::Result<[&[f32]; 3], &'static str> {
        let find = |name| self.channel(name).ok_or(name);
        Ok([find("R")?, find("G")?, find("B")?])
    }

    /// The image to show: the denoised one if there is one.
    pub fn shown(&self) -> Cow<'_, Image> {
        self.denoised().map_or(Cow::Borrowed(self), Cow::Owned)
    }

    /// The image with its channels `denoised.R`, `denoised.G` and `denoised.B` in place of `R`, `G` and `B`; `None` if
    /// there are none.
    pub fn denoised(&self) -> Option<Image> {
        self.channel("denoised.R")?;
        let mut image = self.clone();
        for (name, root) in [("denoised.R", "R"), ("denoised.G", "G"), ("denoised.B", "B")] {
            let index = image.channels.iter().position(|channel| channel.name == name)?;
            let channel = image.channels.remove(index);
            image.add_channel(root, channel.samples);
        }
        Some(image)
    }

    /// The exposure in stops for a picture that would be mostly white or black at `exposure`; `None` for any other
    /// picture. For a white one, it makes the median luminance 18 % of white; for a black one, it makes the brightest
    /// tenth half of white. Pixels that show nothing do not count.
    pub fn suggested_exposure(&self, exposure: f32) -> Option<f32> {
        let [r, g, b] = self.rgb().ok()?;
        let is_there = |i: &usize| self.channel("A").is_none_or(|alpha| alpha[*i] > 0.5);
        let luminance = |i: usize| 0.2126 * r[i] + 0.7152 * g[i] + 0.0722 * b[i];
        let mut luminances: Vec<f32> = (0..r.len()).filter(is_there).map(luminance).filter(|l| l.is_finite()).collect();
        if luminances.is_empty() {
            return None;
        }
        let mut below = |share: f64| {
            let at = (share * luminances.len() as f64) as usize;
            *luminances.select_nth_unstable_by(at, f32::total_cmp).1
        };
        let (median, bright) = (below(0.5), below(0.9));
        let shown = |luminance: f32| luminance * exposure.exp2();
        // Not -0, which would be shown as such.
        let stops = |from: f32, to: f32| (to / from).log2().round() + 0.0;
        // Two stops above white no view leaves anything to see.
        if shown(median) > 4.0 {
            return Some(stops(median, 0.18));
        }
        // Of 255 steps of the standard view, such a pixel has at most 7.
        (bright > 0.0 && shown(bright) < 0.002).then(|| stops(bright, 0.5))
    }

    /// Adds a channel of `width * height` samples, or replaces the channel with the same name.
    ///
    /// # Panics
    /// If the number of samples is not the number of pixels.
    pub fn add_channel(&mut self, name: impl Into<String>, samples: Vec<f32>) {
        let name = name.into();
        assert_eq!(samples.len(), self.pixels(), "channel {name} does not fit the image");
        match self.channels.iter_mut().find(|channel| channel.name == name) {
            Some(channel) => channel.samples = samples,
            None => self.channels.push(Channel { name, samples }),
        }
    }
}
