//! Image-based lights (EXT_lights_image_based): the sharpest cube map of one becomes the panorama around the scene.

use glam::{DQuat, DVec3};
use rayon::prelude::*;

use super::images::{self, Encoded, Form, Use};
use super::json::Json;
use super::notes::Notes;
use super::panorama::Panorama;
use super::texture::TextureImage;
use crate::Result;

pub(super) const EXTENSION: &str = "EXT_lights_image_based";

/// Maximum height of the panorama. At this height it has about as many texels as a cube map with faces of 2048 texels a
/// side.
const MAX_HEIGHT: u32 = 4096;

/// For each face, as seen from the centre: the direction towards it, the direction to its right and that to its top.
/// The faces are +X, -X, +Y, -Y, +Z, -Z. The extension mirrors the images of OpenGL's cube maps, which are seen from
/// outside.
const FACES: [[DVec3; 3]; 6] = [
    [DVec3::X, DVec3::Z, DVec3::Y],
    [DVec3::NEG_X, DVec3::NEG_Z, DVec3::Y],
    [DVec3::Y, DVec3::NEG_X, DVec3::NEG_Z],
    [DVec3::NEG_Y, DVec3::NEG_X, DVec3::Z],
    [DVec3::Z, DVec3::NEG_X, DVec3::Y],
    [DVec3::NEG_Z, DVec3::X, DVec3::Y],
];

/// An image-based light of the file.
struct ImageLight<'a> {
    json: Json<'a>,
    /// Rotation from directions of its cube map to directions of the scene.
    rotation: DQuat,
    intensity: f32,
    /// Indices of the images of the sharpest cube map.
    faces: [usize; 6],
}

/// Reads and checks all image-based lights, and makes the panorama of the one that the rendered scene has. It ignores
/// its coefficients of irradiance and its blurred cube maps, because paths gather the light.
pub(super) fn read(root: &Json, encoded: &[Encoded], lenient: bool, notes: &mut Notes) -> Result<Option<Panorama>> {
    let lights = root.extension(EXTENSION)?.map_or(Ok(Vec::new()), |extension| extension.list("lights"))?;
    let lights = lights.iter().map(|json| ImageLight::read(json, encoded)).collect::<Result<Vec<_>>>()?;
    let scenes = root.list("scenes")?;
    let mut of_scenes = Vec::with_capacity(scenes.len());
    for scene in &scenes {
        let light = scene.extension(EXTENSION)?.map(|extension| extension.require("light")).transpose()?;
        of_scenes.push(light.map(|light| light.index(lights.len(), "image-based light")).transpose()?);
    }
    let rendered = root.get("scene")?.map_or(Ok(0), |scene| scene.index(scenes.len(), "scene"))?;
    let Some(light) = of_scenes.get(rendered).copied().flatten().map(|light| &lights[light]) else { return Ok(None) };
    if light.faces.iter().any(|face| encoded[*face].is_broken()) {
        return Ok(None);
    }
    let used = light.faces.map(|image| Use { image: encoded[image].first, form: Form::Stored });
    let faces = images::decode(encoded, &used)?.into_iter().collect::<Result<Vec<_>>>();
    match faces {
        Ok(faces) => light.panorama(&faces).map(Some),
        Err(error) if lenient => {
            notes.push(format!("the image-based light is left out: {error}"));
            Ok(None)
        }
        Err(error) => Err(Encoded::with_remedy(error)),
    }
}

impl<'a> ImageLight<'a> {
    fn read(json: &Json<'a>, encoded: &[Encoded]) -> Result<ImageLight<'a>> {
        let rotation = match json.get("rotation")? {
            Some(rotation) => {
                let quaternion = DQuat::from_array(rotation.numbers()?);
                if !(quaternion.length() > 0.0 && quaternion.length().is_finite()) {
                    return Err(rotation.error("is not a rotation: its length must be above 0"));
                }
                quaternion.normalize()
            }
            None => DQuat::IDENTITY,
        };
        let intensity = json.number_in("intensity", 1.0, 0.0..)?;
        let coefficients = json.require("irradianceCoefficients")?;
        let bands = coefficients.items()?;
        if bands.len() != 9 {
            return Err(coefficients.error(format!("has {} coefficients, not 9", bands.len())));
        }
        bands.iter().try_for_each(|band| band.numbers::<3>().map(|_| ()))?;
        let size = json.require("specularImageSize")?.whole()?;
        let list = json.require("specularImages")?;
        let mut faces = [0; 6];
        for (level, images) in list.items()?.iter().enumerate() {
            let images_of_level = images.items()?;
            if images_of_level.len() != 6 {
                return Err(images.error(format!("has {} images, not one for each of 6 faces", images_of_level.len())));
            }
            for (face, image) in faces.iter_mut().zip(&images_of_level) {
                let index = image.index(encoded.len(), "image")?;
                let expected = (size >> level.min(63)).max(1);
                match encoded[index].size() {
                    Some([width, height]) if width as usize == expected && height == width => {}
                    None if encoded[index].is_broken() => {}
                    _ => return Err(image.error(format!("image {index} must have {expected} x {expected} texels"))),
                }
                if level == 0 {
                    *face = index;
                }
            }
        }
        if list.len() == 0 {
            return Err(list.error("must not be empty"));
        }
        Ok(ImageLight { json: json.clone(), rotation, intensity, faces })
    }

    /// The panorama with the radiance of the faces, each between its four nearest texels.
    fn panorama(&self, faces: &[TextureImage]) -> Result<Panorama> {
        let height = (2 * faces[0].width).min(MAX_HEIGHT);
        let width = 2 * height;
        let back = self.rotation.inverse();
        let mut texels = vec![[0.0; 3]; width as usize * height as usize];
        texels.par_chunks_exact_mut(width as usize).enumerate().for_each(|(row, texels)| {
            let (sine, cosine) = (std::f64::consts::PI * (row as f64 + 0.5) / f64::from(height)).sin_cos();
            for (column, texel) in texels.iter_mut().enumerate() {
                // The middle column is seen along +X, that a quarter to the right along +Z.
                let azimuth = std::f64::consts::TAU * ((column as f64 + 0.5) / f64::from(width) - 0.5);
                let direction = DVec3::new(sine * azimuth.cos(), cosine, sine * azimuth.sin());
                *texel = radiance(faces, back * direction).map(|channel| channel * self.intensity);
            }
        });
        let panorama = Panorama { width, height, texels };
        if !panorama.brightest().is_finite() {
            return Err(self.json.error("its radiance is out of range"));
        }
        Ok(panorama)
    }
}

/// The radiance of a cube map in a direction.
fn radiance(faces: &[TextureImage], direction: DVec3) -> [f32; 3] {
    let towards = |face: &usize| direction.dot(FACES[*face][0]);
    let face = (0..6).max_by(|a, b| towards(a).total_cmp(&towards(b))).unwrap_or(0);
    let [_, right, up] = FACES[face];
    let across = [direction.dot(right), -direction.dot(up)].map(|x| 0.5 + 0.5 * x / towards(&face));
    let image = &faces[face];
    let last = f64::from(image.width - 1);
    let [x, y] = across.map(|x| (x * f64::from(image.width) - 0.5).clamp(0.0, last));
    let [left, top] = [x, y].map(|x| x.floor() as u32);
    let at = |dx: u32, dy: u32| image.rgbd([(left + dx).min(last as u32), (top + dy).min(last as u32)]);
    let (weight_x, weight_y) = (x.fract() as f32, y.fract() as f32);
    let rows = [at(0, 0).lerp(at(1, 0), weight_x), at(0, 1).lerp(at(1, 1), weight_x)];
    rows[0].lerp(rows[1], weight_y).to_array()
}
