//! A panorama: a clear sky with the sun above grey ground.

use std::f64::consts::{PI, TAU};
use std::io::Cursor;

use exr::image::write::WritableImage;
use exr::image::{AnyChannel, AnyChannels, Encoding, FlatSamples, Image, Layer};
use exr::meta::header::LayerAttributes;
use glam::DVec3;
use half::f16;

const WIDTH: usize = 256;
const HEIGHT: usize = 128;

/// Direction to the sun: 40 degrees above the horizon, in front of and to the left of a camera that looks along -Z.
const SUN: DVec3 = DVec3::new(-0.54, 0.64, -0.55);

/// Radiance of the sun's disc. A surface perpendicular to it receives an irradiance of about 9, and 2 from the sky.
const SUNLIGHT: DVec3 = DVec3::new(1600.0, 1450.0, 1200.0);

/// Cosines of the angles at which the disc starts to fade and ends: 2.2 and 3 degrees. The fade over two texels makes
/// it round.
const DISC: [f64; 2] = [0.99926, 0.99863];

/// An OpenEXR file of 16-bit floats. Radiance is that of `sky`.
pub fn exr(sky: impl Fn(DVec3) -> DVec3) -> Vec<u8> {
    let texels: Vec<DVec3> = (0..WIDTH * HEIGHT).map(|i| sky(direction(i % WIDTH, i / WIDTH))).collect();
    let channel = |name: &str, c: usize| {
        AnyChannel::new(name, FlatSamples::F16(texels.iter().map(|texel| f16::from_f64(texel[c])).collect()))
    };
    let channels = AnyChannels::sort([channel("R", 0), channel("G", 1), channel("B", 2)].into_iter().collect());
    let layer = Layer::new((WIDTH, HEIGHT), LayerAttributes::default(), Encoding::SMALL_LOSSLESS, channels);
    let mut bytes = Cursor::new(Vec::new());
    Image::from_layer(layer).write().to_buffered(&mut bytes).expect("a vector takes what is written");
    bytes.into_inner()
}

/// The direction of the centre of a texel.
fn direction(x: usize, y: usize) -> DVec3 {
    let azimuth = ((x as f64 + 0.5) / WIDTH as f64) * TAU - PI;
    let below = ((y as f64 + 0.5) / HEIGHT as f64) * PI;
    DVec3::new(below.sin() * azimuth.cos(), below.cos(), below.sin() * azimuth.sin())
}

/// The sky with the sun's disc.
pub fn with_sun(direction: DVec3) -> DVec3 {
    let cosine = direction.dot(SUN.normalize());
    let disc = ((cosine - DISC[1]) / (DISC[0] - DISC[1])).clamp(0.0, 1.0);
    without_sun(direction, SUN) + if direction.y < 0.0 { DVec3::ZERO } else { disc * SUNLIGHT }
}

/// Ground, and a sky that glows around the sun, which is a light of its own.
pub fn without_sun(direction: DVec3, sun: DVec3) -> DVec3 {
    if direction.y < 0.0 {
        return DVec3::new(0.30, 0.28, 0.25);
    }
    let horizon = DVec3::new(0.95, 0.95, 0.90);
    let zenith = DVec3::new(0.18, 0.36, 0.80);
    let glow = direction.dot(sun.normalize()).max(0.0).powi(32) * DVec3::new(0.8, 0.7, 0.5);
    horizon.lerp(zenith, direction.y.sqrt()) + glow
}
