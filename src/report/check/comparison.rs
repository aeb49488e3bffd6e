//! Comparison of an image with its baseline.

use super::cases::Limits;
use crate::render::film::{Image, Metadata};
use crate::report::metrics::{display, flip_of, relmse};
use crate::{Error, Result};

/// How far an image is from its baseline.
#[derive(Clone, Debug)]
pub struct Comparison {
    /// relMSE of linear radiance.
    pub relmse: f64,
    /// The mean of FLIP.
    pub flip: f64,
    /// The share of pixels in which a channel changed by more than the limits' step.
    pub changed: f64,
    /// Pixels that differ in any bit of `R`, `G` or `B`.
    pub different: usize,
    /// FLIP of each pixel, as 8-bit colours of the map `magma`.
    pub map: Vec<u8>,
}

impl Comparison {
    /// Compares an image with its baseline.
    ///
    /// # Errors
    /// As [`relmse`], with the file names `image` and `reference`.
    pub fn new(image: &Image, baseline: &Image, limits: &Limits) -> Result<Comparison> {
        let relmse = relmse(image, baseline)?;
        let (shown, expected) = (display("image", image)?, display("reference", baseline)?);
        let (flip, map) = flip_of([image.width, image.height], &shown, &expected);
        let pixels = image.pixels() as f64;
        let step = |(a, b): (&u8, &u8)| a.abs_diff(*b) > limits.step;
        let has_changed = |(a, b): &(&[u8], &[u8])| a.iter().zip(*b).any(step);
        let changed = shown.chunks(3).zip(expected.chunks(3)).filter(has_changed).count();
        Ok(Comparison {
            relmse,
            flip,
            changed: changed as f64 / pixels,
            different: different_pixels(image, baseline)?,
            map: map.apply_color_lut(&nv_flip::magma_lut()).to_vec(),
        })
    }

    /// The measures that exceed their limits, each as a sentence.
    pub fn exceeded(&self, limits: &Limits) -> Vec<String> {
        let Limits { relmse, flip, changed, step, .. } = *limits;
        let mut exceeded = Vec::new();
        if self.relmse > relmse {
            exceeded.push(format!("relMSE is {:.3e}, above {relmse:e}", self.relmse));
        }
        if self.flip > flip {
            exceeded.push(format!("FLIP is {:.4}, above {flip}", self.flip));
        }
        if self.changed > changed {
            let percent = |share: f64| 100.0 * share;
            let (now, most) = (percent(self.changed), percent(changed));
            exceeded.push(format!("{now:.2} % of the pixels changed by more than {step} of 255, above {most} %"));
        }
        exceeded
    }
}

/// The number of pixels of two images of one size that differ in any bit of `R`, `G` or `B`.
///
/// # Errors
/// [`Error::Input`] for a missing channel.
pub(super) fn different_pixels(a: &Image, b: &Image) -> Result<usize> {
    let missing = |name| move |channel| Error::input(name, channel, "there is no such channel");
    let (a, b) = (a.rgb().map_err(missing("image"))?, b.rgb().map_err(missing("reference"))?);
    let differs = |pixel: &usize| (0..3).any(|c| a[c][*pixel].to_bits() != b[c][*pixel].to_bits());
    Ok((0..a[0].len()).filter(differs).count())
}

/// The kind of device that made an image; `None` if its metadata has no device.
pub(super) fn device_kind(image: &Image) -> Option<&str> {
    match image.metadata.get("penumbra:device") {
        Some(Metadata::Text(name)) => Some(kind_of(name)),
        _ => None,
    }
}

/// The kind of a device: its name, without the driver's remarks in brackets, such as the width of the processor's
/// vectors.
pub fn kind_of(name: &str) -> &str {
    name.split(" (").next().unwrap_or(name)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn image(change: impl Fn(usize) -> f32) -> Image {
        let mut image = Image::new(8, 8);
        for channel in ["R", "G", "B"] {
            image.add_channel(channel, (0..64).map(|i| 0.2 + change(i)).collect());
        }
        image
    }

    #[test]
    fn limits_are_exceeded_one_by_one() {
        let baseline = image(|_| 0.0);
        let limits = Limits { changed: 0.01, ..Limits::default() };
        let same = Comparison::new(&baseline, &baseline, &limits).unwrap();
        assert_eq!((same.relmse, same.flip, same.changed, same.different), (0.0, 0.0, 0.0, 0));
        assert!(same.exceeded(&limits).is_empty());
        // One bit of one pixel.
        let bit = image(|i| if i == 9 { 1e-7 } else { 0.0 });
        let bit = Comparison::new(&bit, &baseline, &limits).unwrap();
        assert_eq!(bit.different, 1);
        assert!(bit.exceeded(&limits).is_empty(), "{bit:?}");
        // One pixel is wrong: relMSE and the share of changed pixels exceed their limits.
        let pixel = image(|i| if i == 9 { 0.3 } else { 0.0 });
        let pixel = Comparison::new(&pixel, &baseline, &limits).unwrap();
        assert_eq!((pixel.different, pixel.changed), (1, 1.0 / 64.0));
        let exceeded = pixel.exceeded(&limits).join("; ");
        assert!(exceeded.contains("relMSE is") && exceeded.contains("1.56 % of the pixels changed"), "{exceeded}");
        let wide = Limits { relmse: 1.0, flip: 1.0, changed: 1.0, step: 0, ..Limits::default() };
        assert!(pixel.exceeded(&wide).is_empty());
        assert_eq!(pixel.map.len(), 64 * 3);
    }

    #[test]
    fn images_that_do_not_fit_are_refused() {
        let mut small = Image::new(4, 4);
        small.add_channel("R", vec![0.0; 16]);
        let error = Comparison::new(&small, &image(|_| 0.0), &Limits::default()).unwrap_err().to_string();
        assert!(error.contains("its size is 4 x 4 pixels, that of the reference 8 x 8"), "{error}");
    }

    #[test]
    fn kinds_of_devices_leave_remarks_out() {
        assert_eq!(kind_of("llvmpipe (LLVM 20.1.2, 256 bits)"), "llvmpipe");
        assert_eq!(kind_of("NVIDIA H100 80GB HBM3"), "NVIDIA H100 80GB HBM3");
    }
}
