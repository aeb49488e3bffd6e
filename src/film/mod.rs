//! Images: named channels of scene-linear f32, written to EXR and tone-mapped to PNG.

/// An image: channels of one size, rows top to bottom.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Image {
    /// Width in pixels.
    pub width: u32,
    /// Height in pixels.
    pub height: u32,
    /// Channels by their EXR names: `R`, `G`, `B`, `A`, `direct.R`, `N.X`, `Z`, `shadow.lamp.class`.
    pub channels: Vec<Channel>,
    /// EXR attributes (camera, counts, seed, technique, device, version), in order of name.
    pub metadata: std::collections::BTreeMap<String, Metadata>,
}

/// A channel of an [`Image`].
#[derive(Clone, Debug, PartialEq)]
pub struct Channel {
    /// EXR name.
    pub name: String,
    /// `width * height` samples.
    pub samples: Vec<f32>,
}

/// A value of an EXR attribute.
#[derive(Clone, Debug, PartialEq)]
pub enum Metadata {
    /// Text.
    Text(String),
    /// A whole number.
    Int(i32),
    /// A number.
    Float(f32),
    /// A 4 x 4 matrix, row-major, applied to row vectors as OpenEXR does.
    Matrix([f32; 16]),
}
