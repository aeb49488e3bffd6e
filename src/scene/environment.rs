//! The environment: a panorama infinitely far away, read from OpenEXR or Radiance HDR.

use std::fmt;
use std::path::Path;
use std::sync::Arc;

use super::{Light, LightKind, Scene};
use crate::{Error, Image, Result};

/// An equirectangular panorama of linear Rec.709 radiance, rows from the zenith (+Y) to the nadir.
///
/// It is turned as in Blender and in the Khronos viewers: its middle column is seen along +X, the column a quarter of the
/// width to the left of it along -Z, the one a quarter to the right along +Z, and its edges meet along -X.
#[derive(Clone, PartialEq)]
pub struct Panorama {
    /// Width in texels, 1 to [`Panorama::MAX_SIDE`].
    pub width: u32,
    /// Height in texels, 1 to [`Panorama::MAX_SIDE`].
    pub height: u32,
    /// Radiance, row by row from the top: `width * height` texels, no channel negative or infinite.
    pub texels: Vec<[f32; 3]>,
}

impl fmt::Debug for Panorama {
    /// Its size: the texels are millions.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Panorama({} x {})", self.width, self.height)
    }
}

/// Most radiance of a texel, strength included: its quotient by the least density that the sampling table has is a float.
const MOST_RADIANCE: f32 = 1e30;

impl Panorama {
    /// Largest side in texels: what graphics devices take of a texture.
    pub const MAX_SIDE: u32 = 16_384;

    /// Reads a panorama from `.exr` (channels `R`, `G`, `B`) or `.hdr`; and what there is to say of it, a line each. With
    /// `lenient` a channel that is NaN, infinite or negative becomes 0.
    ///
    /// # Errors
    /// [`Error::Input`] as [`Image::read`], where a channel is missing or a side too large, and, naming the first such texel,
    /// where radiance is NaN, infinite or negative.
    pub fn load(path: impl AsRef<Path>, lenient: bool) -> Result<(Panorama, Vec<String>)> {
        let path = path.as_ref();
        let refuse = |place: &str, problem: String| Error::input(path, place, problem);
        let extension = path.extension().unwrap_or_default().to_string_lossy().to_lowercase();
        if !["exr", "hdr"].contains(&extension.as_str()) {
            return Err(refuse("file", "a panorama must be .exr or .hdr".into()));
        }
        let image = Image::read(path)?;
        let Image { width, height, .. } = image;
        let channels = image.rgb().map_err(|name| refuse(name, "there is no such channel".into()))?;
        if width.max(height) > Self::MAX_SIDE || image.pixels() == 0 {
            let most = Self::MAX_SIDE;
            return Err(refuse("file", format!("{width} x {height} texels: each side must be from 1 to {most}")));
        }
        let mut texels: Vec<[f32; 3]> = (0..image.pixels()).map(|i| channels.map(|channel| channel[i])).collect();
        let is_wrong = |radiance: &f32| !(radiance.is_finite() && *radiance >= 0.0);
        let mut notes = Vec::new();
        let mut wrong = texels.iter().enumerate().filter(|(_, texel)| texel.iter().any(is_wrong));
        if let Some((first, texel)) = wrong.next() {
            let (x, y) = (first % width as usize, first / width as usize);
            if !lenient {
                let channel = texel.iter().position(is_wrong).unwrap_or(0);
                let problem = format!(
                    "{} is {}: radiance must be finite and not negative; `lenient` import sets such texels to 0",
                    ["R", "G", "B"][channel],
                    texel[channel]
                );
                return Err(refuse(&format!("texel {x}, {y}"), problem));
            }
            let count = 1 + wrong.count();
            notes.push(format!(
                "{count} texels of the panorama, the first at {x}, {y}, are negative or not finite: taken as 0"
            ));
            for radiance in texels.as_flattened_mut().iter_mut().filter(|radiance| is_wrong(radiance)) {
                *radiance = 0.0;
            }
        }
        if width != 2 * height {
            notes.push(format!(
                "the panorama is {width} x {height} texels: one of all directions is twice as wide as high"
            ));
        }
        Ok((Panorama { width, height, texels }, notes))
    }

    /// The largest channel of any texel.
    fn brightest(&self) -> f32 {
        self.texels.as_flattened().iter().copied().fold(0.0, f32::max)
    }
}

impl Scene {
    /// Puts the scene into a panorama, in place of one that it may have: turned by `rotation` degrees about +Y,
    /// counter-clockwise seen from above as a node would be, its radiance multiplied by `strength`.
    ///
    /// # Errors
    /// [`Error::Usage`] where the rotation is not finite, or the strength negative or so large that radiance overflows.
    pub fn set_environment(&mut self, panorama: Arc<Panorama>, rotation: f64, strength: f32) -> Result<()> {
        if !rotation.is_finite() {
            return Err(Error::Usage(format!("`environment_rotation` is {rotation}; it must be finite")));
        }
        if !(strength >= 0.0 && panorama.brightest() * strength <= MOST_RADIANCE) {
            let problem = format!("it must be 0 or more, and bring no texel above {MOST_RADIANCE:e}");
            return Err(Error::Usage(format!("`environment_strength` is {strength}; {problem}")));
        }
        let turn = (rotation / 360.0).rem_euclid(1.0) as f32;
        self.lights.truncate(self.placed_lights().len());
        let kind = LightKind::Environment { panorama, turn, strength };
        self.lights.push(Light { name: "environment".into(), kind });
        Ok(())
    }

    /// The lights of which photons can tell lit points from shadowed ones: all but the environment, which is the last.
    pub fn placed_lights(&self) -> &[Light] {
        match self.lights.split_last() {
            Some((Light { kind: LightKind::Environment { .. }, .. }, others)) => others,
            _ => &self.lights,
        }
    }

    /// The panorama around the scene, where there is one.
    pub fn environment(&self) -> Option<&Panorama> {
        self.lights.last().and_then(|light| match &light.kind {
            LightKind::Environment { panorama, .. } => Some(panorama.as_ref()),
            _ => None,
        })
    }
}
