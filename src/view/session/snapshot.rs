//! What a session shows: a picture, and data about it.

use std::sync::Arc;

use super::picture::Picture;
use crate::render::photons::{NearestPhotons, SurfacePoint};
use crate::view::pick::Hit;

/// The photons' classification of a pixel for a light.
#[derive(Clone, Debug, PartialEq)]
pub struct PickedLight {
    /// The light's name.
    pub name: String,
    /// Its class.
    pub class: &'static str,
    /// Visibility of the light, 0 to 1.
    pub visibility: f32,
    /// Illumination photons and shadow photons among the nearest.
    pub photons: [f32; 2],
}

/// Data about a pixel.
#[derive(Clone, Debug, PartialEq)]
pub struct Picked {
    /// The point of the image, from 0 to 1 each way.
    pub at: [f32; 2],
    /// The surface; `None` where there is nothing.
    pub hit: Option<Hit>,
    /// The picture's radiance.
    pub radiance: Option<[f32; 3]>,
    /// The photons' classification for each light; empty unless the overlay of classes is shown.
    pub lights: Vec<PickedLight>,
    /// The point that is shaded there, behind mirrors and glass; `None` before the picture is there.
    pub point: Option<SurfacePoint>,
    /// The photons that decide it for the light that is shown; `None` without a visibility map.
    pub nearest: Option<NearestPhotons>,
}

/// A picture to show, and data about it.
#[derive(Clone, Debug)]
pub struct Snapshot {
    /// 8-bit RGB, row by row from the top.
    pub pixels: Arc<Vec<u8>>,
    /// Width and height of `pixels`; smaller than the picture's while the camera moves.
    pub size: [u32; 2],
    /// Samples of the pixels that have most.
    pub samples: u32,
    /// Whether the picture has all its samples.
    pub is_complete: bool,
    /// Seconds that the last step took.
    pub seconds: f64,
    /// All that decides the picture.
    pub picture: Picture,
    /// The field of view in degrees; `None` if the camera is orthographic.
    pub fov: Option<f64>,
    /// Names of the file's cameras.
    pub cameras: Vec<String>,
    /// Names of the lights.
    pub lights: Vec<String>,
    /// Names of the variants of the materials.
    pub variants: Vec<String>,
    /// End of the animation in seconds; `None` without one.
    pub animation_end: Option<f64>,
    /// Whether the scene is shown with a panorama of the command line.
    pub has_panorama: bool,
    /// The last message, an error or what was done.
    pub message: Option<String>,
    /// Data about the pixel that was clicked last.
    pub picked: Option<Picked>,
}
