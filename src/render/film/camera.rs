//! The camera as standard OpenEXR attributes.

use glam::{DMat4, DVec3, DVec4};

use super::image::{Image, Metadata};
use crate::scene::{Camera, Normalisation, Projection};

impl Image {
    /// Adds the attributes `worldToCamera` and `worldToNDC` as OpenEXR defines them (`ImfStandardAttributes.h`), in the
    /// units of the file's world space.
    ///
    /// Camera space is left-handed: +x right, +y up, +z forward. NDC has (0, 0) at the upper left corner of the image
    /// and (1, 1) at the lower right one, of the whole image if it is a part of one. OpenEXR does not define its z,
    /// which runs from 1/2 at the near plane to 1 at the far plane, as pbrt has it. The width of the view follows from
    /// the aspect ratio of the image.
    pub fn add_camera(&mut self, camera: &Camera, normalisation: &Normalisation) {
        let [right, up, backward] = camera.axes.map(|axis| axis.as_dvec3());
        let rotation =
            DMat4::from_cols(right.extend(0.0), up.extend(0.0), (-backward).extend(0.0), DVec4::W).transpose();
        let world_to_camera = rotation * DMat4::from_translation(-normalisation.undo(camera.position));

        let [width, height] = self.crop.map_or([self.width, self.height], |window| window.of).map(f64::from);
        let length = |normalised: f32| f64::from(normalised) / normalisation.scale();
        let (near, far) = (length(camera.near), length(camera.far));
        let depth = if far.is_finite() { 1.0 / (far - near) } else { 0.0 };
        let camera_to_screen = match camera.projection {
            Projection::Perspective { yfov, .. } => {
                let y = 1.0 / (f64::from(yfov) / 2.0).tan();
                let x = y * height / width;
                // far / (far - near), whose limit is 1.
                let z = if far.is_finite() { far * depth } else { 1.0 };
                DMat4::from_cols(DVec4::X * x, DVec4::Y * y, DVec4::new(0.0, 0.0, z, 1.0), DVec4::Z * (-near * z))
            }
            Projection::Orthographic { ymag, .. } => {
                let y = 1.0 / length(ymag);
                let scale = DVec3::new(y * height / width, y, depth);
                DMat4::from_scale(scale) * DMat4::from_translation(DVec3::Z * -near)
            }
        };
        let screen_to_ndc = DMat4::from_translation(DVec3::splat(0.5)) * DMat4::from_scale(DVec3::new(0.5, -0.5, 0.5));

        // The columns of a matrix for column vectors are the rows of the matrix for row vectors.
        let attribute = |matrix: DMat4| Metadata::Matrix(matrix.as_mat4().to_cols_array());
        self.metadata.insert("worldToCamera".into(), attribute(world_to_camera));
        self.metadata.insert("worldToNDC".into(), attribute(screen_to_ndc * camera_to_screen * world_to_camera));
    }
}
