//! Reading panoramas from OpenEXR or Radiance HDR.

use std::path::Path;

use super::image::Image;
use crate::count::count;
use crate::scene::Panorama;
use crate::{Error, Result};

impl Panorama {
    /// Reads a panorama from an `.exr` (channels `R`, `G`, `B`) or `.hdr` file. Returns it with notes of one line each.
    /// With `lenient`, radiance that is NaN, infinite or negative becomes 0.
    ///
    /// # Errors
    /// Those of [`Image::read`], and [`Error::Input`] if a channel is missing, if a side is too large, or, with the
    /// first such texel, if radiance is NaN, infinite or negative.
    pub fn load(path: &Path, lenient: bool) -> Result<(Panorama, Vec<String>)> {
        let refuse = |location: &str, problem: String| Error::input(path, location, problem);
        let extension = path.extension().unwrap_or_default().to_string_lossy().to_lowercase();
        if !["exr", "hdr"].contains(&extension.as_str()) {
            return Err(refuse("file", "a panorama must be .exr or .hdr".into()));
        }
        let image = Image::read(path)?;
        let Image { width, height, .. } = image;
        let channels = image.rgb().map_err(|name| refuse(name, "there is no such channel".into()))?;
        if width.max(height) > Self::MAX_SIDE || image.pixels() == 0 {
            let max = Self::MAX_SIDE;
            return Err(refuse("file", format!("{width} x {height} texels: each side must be from 1 to {max}")));
        }
        let mut texels: Vec<[f32; 3]> = (0..image.pixels()).map(|i| channels.map(|channel| channel[i])).collect();
        let is_invalid = |radiance: &f32| !(radiance.is_finite() && *radiance >= 0.0);
        let mut notes = Vec::new();
        let mut invalid = texels.iter().enumerate().filter(|(_, texel)| texel.iter().any(is_invalid));
        if let Some((first, texel)) = invalid.next() {
            let (x, y) = (first % width as usize, first / width as usize);
            if !lenient {
                let channel = texel.iter().position(is_invalid).unwrap_or(0);
                let problem = format!(
                    "{} is {}: radiance must be finite and not negative; `lenient` import replaces such values with 0",
                    ["R", "G", "B"][channel],
                    texel[channel]
                );
                return Err(refuse(&format!("texel {x}, {y}"), problem));
            }
            let one = format!("texel of the panorama, at {x}, {y}, has");
            let many = format!("texels of the panorama, the first at {x}, {y}, have");
            let which = count(1 + invalid.count(), &one, &many);
            notes.push(format!("{which} values that are negative or not finite: these are replaced with 0"));
            for radiance in texels.as_flattened_mut().iter_mut().filter(|radiance| is_invalid(radiance)) {
                *radiance = 0.0;
            }
        }
        if width != 2 * height {
            notes.push(format!(
                "the panorama has {width} x {height} texels, but a full panorama is twice as wide as it is high"
            ));
        }
        Ok((Panorama { width, height, texels }, notes))
    }
}
