//! The camera as the kernels read it.

use glam::Vec3;

use crate::scene::{Camera, Projection};

kernel_kit::shared_struct! {
    /// A camera. The ray of position (x, y) on the unit square of the image starts at `position` (offset by `right` and
    /// `up` where orthographic) and goes along `-backward` + (2 x - 1) `right` + (1 - 2 y) `up`.
    pub struct CameraUniform {
        /// Position, normalised.
        pub position: [f32; 3],
        /// 1 where orthographic.
        pub orthographic: u32,
        /// Half the width of the view: at unit distance where perspective.
        pub right: [f32; 3],
        /// Near plane distance.
        pub near: f32,
        /// Half the height of the view: at unit distance where perspective.
        pub up: [f32; 3],
        /// Far plane distance; infinite planes are 1e30, far outside the unit-size scene.
        pub far: f32,
        /// Unit vector.
        pub backward: [f32; 3],
        /// To a multiple of 16 bytes.
        pub padding: u32,
    }
}

impl CameraUniform {
    /// The camera for an image of that size. Where the camera states an aspect ratio that is not the image's, the
    /// vertical field of view is kept, as glTF viewers do.
    pub fn new(camera: &Camera, width: u32, height: u32) -> Self {
        let aspect = width as f32 / height as f32;
        let (half_width, half_height, orthographic) = match camera.projection {
            Projection::Perspective { yfov, .. } => {
                let half = (0.5 * yfov).tan();
                (half * aspect, half, 0)
            }
            Projection::Orthographic { ymag, .. } => (ymag * aspect, ymag, 1),
        };
        let [right, up, backward]: [Vec3; 3] = camera.axes;
        CameraUniform {
            position: camera.position.into(),
            orthographic,
            right: (right * half_width).into(),
            near: camera.near,
            up: (up * half_height).into(),
            far: camera.far.min(1e30),
            backward: backward.into(),
            padding: 0,
        }
    }

    /// The camera's own ratio of width to height, 1 where it has none.
    pub fn aspect(camera: &Camera) -> f32 {
        match camera.projection {
            Projection::Perspective { aspect, .. } => aspect.unwrap_or(1.0),
            Projection::Orthographic { xmag, ymag } => xmag / ymag,
        }
    }
}
