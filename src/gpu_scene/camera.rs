//! The camera as the kernels read it.

use glam::{DVec3, Vec3};

use crate::scene::{Camera, Projection};

kernel_kit::shared_struct! {
    /// A camera. The ray through (x, y) of the image's unit square starts at `position` and has the direction
    /// `-backward` + (2 x - 1) `right` + (1 - 2 y) `up`. For an orthographic camera, `right` and `up` offset the origin
    /// instead.
    pub struct CameraUniform {
        /// Position, normalised.
        pub position: [f32; 3],
        /// 1 if orthographic.
        pub orthographic: u32,
        /// Half the width of the view; at unit distance if perspective.
        pub right: [f32; 3],
        /// Near plane distance.
        pub near: f32,
        /// Half the height of the view; at unit distance if perspective.
        pub up: [f32; 3],
        /// Far plane distance; infinite planes are 1e30, far outside the unit-size scene.
        pub far: f32,
        /// Unit vector.
        pub backward: [f32; 3],
        /// Radius of the iris; 0 for a pinhole.
        pub lens_radius: f32,
        /// Distance along the viewing direction at which points are in focus.
        pub focus_distance: f32,
        /// Corners of the iris; 1 if it is round, since a kernel divides by them.
        pub iris_blades: f32,
        /// To a multiple of 16 bytes.
        pub padding: [u32; 2],
    }
}

impl CameraUniform {
    /// The camera for an image of the given size.
    pub fn new(camera: &Camera, width: u32, height: u32) -> Self {
        let [half_width, half_height] = camera.half_extent(width as f32 / height as f32);
        let orthographic = matches!(camera.projection, Projection::Orthographic { .. }).into();
        let [right, up, backward]: [Vec3; 3] = camera.axes;
        CameraUniform {
            position: camera.position.into(),
            orthographic,
            right: (right * half_width).into(),
            near: camera.near,
            up: (up * half_height).into(),
            // Kernels have no infinity.
            far: camera.far.min(1e30),
            backward: backward.into(),
            lens_radius: camera.lens.map_or(0.0, |lens| lens.radius),
            focus_distance: camera.lens.map_or(1.0, |lens| lens.distance),
            iris_blades: camera.lens.map_or(1.0, |lens| (lens.blades as f32).max(1.0)),
            padding: [0; 2],
        }
    }

    /// The ray through a point of the image's unit square, its origin at the top left: where it starts, and its
    /// direction, whose component along the direction of view is 1. It passes through the centre of the lens.
    pub fn ray(&self, [x, y]: [f64; 2]) -> (DVec3, DVec3) {
        let vector = |v: [f32; 3]| Vec3::from(v).as_dvec3();
        let across = (2.0 * x - 1.0) * vector(self.right) + (1.0 - 2.0 * y) * vector(self.up);
        let (position, ahead) = (vector(self.position), -vector(self.backward));
        if self.orthographic == 1 { (position + across, ahead) } else { (position, ahead + across) }
    }

    /// The camera's own ratio of width to height, 1 if it has none.
    pub fn aspect(camera: &Camera) -> f32 {
        match camera.projection {
            Projection::Perspective { aspect, .. } => aspect.unwrap_or(1.0),
            Projection::Orthographic { xmag, ymag } => xmag / ymag,
        }
    }
}
