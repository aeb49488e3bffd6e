//! Cameras that frame the scene.

use glam::{Mat3, Vec3};

use super::camera::{Camera, Projection};
use super::description::Scene;
use super::look_at::DEFAULT_FOV;
use super::triangle::NO_LIGHT;

/// Share of the image's width, and of its height, that stays free at each side.
const MARGIN: f32 = 0.05;

/// Direction from which a camera sees the scene, and the shape of its image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Framing {
    /// Direction in degrees from which the camera looks, counter-clockwise seen from above: 0 is the front (+Z in
    /// glTF), 90 is from +X.
    pub azimuth: f32,
    /// Height of that direction over the horizon in degrees, -90 to 90.
    pub elevation: f32,
    /// Width of the image over its height.
    pub aspect: f32,
    /// Vertical field of view in degrees, more than 0 and less than 180.
    pub fov: f32,
}

impl Framing {
    fn axes(&self) -> [Vec3; 3] {
        let [azimuth, elevation] = [self.azimuth, self.elevation].map(f32::to_radians);
        let turn = Mat3::from_rotation_y(azimuth) * Mat3::from_rotation_x(-elevation);
        [turn.x_axis, turn.y_axis, turn.z_axis]
    }

    /// Half the width and half the height of what the margins leave, at distance 1.
    fn slopes(&self) -> [f32; 2] {
        let up_slope = (0.5 * self.fov.to_radians()).tan() * (1.0 - 2.0 * MARGIN);
        [up_slope * self.aspect, up_slope]
    }
}

impl Default for Framing {
    /// From the front, 15 degrees above the horizon: the view of a model that stands on the ground.
    fn default() -> Self {
        Framing { azimuth: 0.0, elevation: 15.0, aspect: 1.0, fov: DEFAULT_FOV as f32 }
    }
}

impl Scene {
    /// As [`frame`](Self::frame) from the front, for a square image.
    pub fn frame_camera(&self) -> Camera {
        self.frame(&Framing::default())
    }

    /// The perspective camera that sees every surface that emits no light (every surface, if all of them emit) as large
    /// as the image allows, with a margin of 5 % at each side.
    pub fn frame(&self, framing: &Framing) -> Camera {
        self.seen_from(framing.axes(), framing.slopes()).camera(framing.axes(), framing.fov)
    }

    /// `views` cameras around the scene, at equal steps of azimuth; the first has the azimuth of `framing`. They look
    /// at the same point from the same distance, from which each of them sees all that [`Self::frame`] would show.
    pub fn turntable(&self, framing: &Framing, views: u32) -> Vec<Camera> {
        let turned = |view: u32| {
            let azimuth = framing.azimuth + 360.0 * view as f32 / views as f32;
            Framing { azimuth, ..*framing }.axes()
        };
        let bounds = self
            .framed_corners()
            .fold([Vec3::MAX, Vec3::MIN], |[lower, upper], corner| [lower.min(corner), upper.max(corner)]);
        let middle = 0.5 * (bounds[0] + bounds[1]);
        let slopes = framing.slopes();
        let around: Vec<[Vec3; 3]> = (0..views).map(turned).collect();
        // From the middle to the eye, and to the nearest corner.
        let (mut distance, mut nearest) = (0f32, 0f32);
        for axes in &around {
            for corner in self.framed_corners() {
                let [x, y, z] = axes.map(|axis| axis.dot(corner - middle));
                distance = distance.max(z + (x.abs() / slopes[0]).max(y.abs() / slopes[1]));
                nearest = nearest.max(z);
            }
        }
        // A flat scene has some depth, and the eye is in front of the nearest corner.
        let extent = (bounds[1] - bounds[0]).max(Vec3::splat(1e-6));
        let distance = distance.max(nearest + 1e-3 * extent.max_element());
        let camera = |axes: [Vec3; 3]| {
            let [x, y, z] = axes.map(|axis| axis.dot(middle));
            Seen { eye: [x, y, z + distance], nearest: z + nearest, extent }.camera(axes, framing.fov)
        };
        around.into_iter().map(camera).collect()
    }

    /// The eye on the plane nearest to the scene from which all corners are within the slopes to both sides of the
    /// viewing direction, in coordinates along `axes`.
    fn seen_from(&self, axes: [Vec3; 3], slopes: [f32; 2]) -> Seen {
        let corners = self.framed_corners();
        // A corner at (x, z) is inside if the eye's z is at least z + |x - eye.x| / slope. The two sides meet where the
        // largest z + x / slope and the largest z - x / slope allow it.
        let mut limits = [[f32::MIN; 2]; 2];
        let (mut lower, mut upper) = (Vec3::MAX, Vec3::MIN);
        for corner in corners {
            let along = Vec3::from(axes.map(|axis| axis.dot(corner)));
            (lower, upper) = (lower.min(along), upper.max(along));
            for (limit, (across, slope)) in limits.iter_mut().zip([along.x, along.y].into_iter().zip(slopes)) {
                *limit = [limit[0].max(along.z + across / slope), limit[1].max(along.z - across / slope)];
            }
        }
        let eye = |[plus, minus]: [f32; 2], slope: f32| (0.5 * (plus - minus) * slope, 0.5 * (plus + minus));
        let [(x, z_by_x), (y, z_by_y)] = [eye(limits[0], slopes[0]), eye(limits[1], slopes[1])];
        // A scene that is a point is seen from a distance of its own.
        let extent = (upper - lower).max(Vec3::splat(1e-6));
        let z = z_by_x.max(z_by_y).max(upper.z + 1e-3 * extent.max_element());
        Seen { eye: [x, y, z], nearest: upper.z, extent }
    }

    /// The corners of every surface that emits no light, or of every surface if all of them emit.
    fn framed_corners(&self) -> Box<dyn Iterator<Item = Vec3> + '_> {
        let unlit = || {
            let unlit = (0..self.unshared_triangles()).filter(|&i| self.triangles[i].light == NO_LIGHT);
            unlit.flat_map(|i| self.triangle_positions(i)).chain(self.corners_of_others())
        };
        // Not in a list, because instances may have billions of corners.
        match () {
            () if unlit().next().is_some() => Box::new(unlit()),
            () if !self.is_empty() => Box::new(self.corners()),
            // An empty scene gets a box of about unit size.
            () => Box::new([Vec3::splat(-1.0), Vec3::ONE].into_iter()),
        }
    }

    /// Why the camera sees nothing: all of the scene is behind it, nearer than its near plane or beyond its far plane.
    /// `None` otherwise, or if the scene is empty.
    pub fn clipped_away(&self, camera: &Camera) -> Option<String> {
        let depth = |corner: Vec3| (camera.position - corner).dot(camera.axes[2]);
        let depths = self.corners().map(depth).map(|z| [z, z]);
        let [nearest, farthest] = depths.reduce(|[low, high], [z, _]| [low.min(z), high.max(z)])?;
        let metres = |x: f32| x / self.normalisation.scale() as f32;
        let all_is = match () {
            () if farthest < 0.0 => "behind it".to_owned(),
            () if farthest < camera.near => format!("nearer than its znear of {}", metres(camera.near)),
            () if nearest > camera.far => format!("beyond its zfar of {}", metres(camera.far)),
            () => return None,
        };
        Some(format!("the camera sees nothing: all of the scene is {all_is}"))
    }
}

/// The result of [`Scene::seen_from`], in coordinates along the axes of the view.
struct Seen {
    eye: [f32; 3],
    /// The largest coordinate of a corner along the axis that points backward.
    nearest: f32,
    /// Size of the bounding box.
    extent: Vec3,
}

impl Seen {
    /// The camera there, with a vertical field of view in degrees.
    fn camera(&self, axes: [Vec3; 3], fov: f32) -> Camera {
        let radius = 0.5 * self.extent.length();
        let [right, up, backward] = axes;
        Camera {
            name: "framed".into(),
            position: self.eye[0] * right + self.eye[1] * up + self.eye[2] * backward,
            axes,
            projection: Projection::Perspective { yfov: fov.to_radians(), aspect: None },
            // Nothing is nearer than this plane, however near the nearest corner comes.
            near: (0.01 * radius).min(0.5 * (self.eye[2] - self.nearest)).max(1e-6 * radius),
            far: f32::INFINITY,
            lens: None,
        }
    }
}
