//! The image: named channels of scene-linear f32, and metadata.

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

/// The metadata by which an image file tells what it shows.
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

    /// The root channels `R`, `G` and `B`.
    ///
    /// # Errors
    /// The name of the first missing channel.
    pub fn rgb(&self) -> std::result::Result<[&[f32]; 3], &'static str> {
        let find = |name| self.channel(name).ok_or(name);
        Ok([find("R")?, find("G")?, find("B")?])
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
