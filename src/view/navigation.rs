//! Moving a camera: orbit, pan, dolly and fly.

use std::f64::consts::PI;

use glam::{DQuat, DVec3};

use crate::scene::{Camera, LookAt, Projection, Scene};

/// Angle from the vertical at which an orbit stops, in radians: beyond it, up and down of the image would change sides.
const STEEPEST: f64 = 0.01;

/// Digits that are kept of a position, by the size of the scene: a pixel of a large image sees less, and short numbers
/// make short commands.
const DIGITS: i32 = 6;

/// Turns the camera about what it looks at: by half a turn to the right for 1 of `right`, and by half a turn upward for
/// 1 of `up`.
pub fn orbit(view: &LookAt, [right, up]: [f64; 2]) -> LookAt {
    let arm = view.from - view.at;
    let distance = arm.length();
    let Some(backward) = arm.try_normalize() else { return *view };
    let elevation = backward.angle_between(DVec3::Y);
    let steps = (elevation - PI * up).clamp(STEEPEST, PI - STEEPEST) - elevation;
    let Some([across, ..]) = view.axes() else { return *view };
    let turned = DQuat::from_rotation_y(PI * right) * DQuat::from_axis_angle(across, steps) * backward;
    LookAt { from: view.at + distance * turned, ..*view }
}

/// Moves the camera and what it looks at along the image, by shares of its height: what it looks at moves in the image
/// by as much the other way.
pub fn pan(view: &LookAt, [right, up]: [f64; 2]) -> LookAt {
    let height = 2.0 * (0.5 * view.fov.to_radians()).tan() * view.from.distance(view.at);
    fly(view, DVec3::new(right, up, 0.0) * height)
}

/// Moves the camera towards what it looks at: by 1 to 1 / e of the distance.
pub fn dolly(view: &LookAt, steps: f64) -> LookAt {
    LookAt { from: view.at + (view.from - view.at) * (-steps).exp(), ..*view }
}

/// Moves the camera and what it looks at along its axes: right, up and forward, in the units of the file.
pub fn fly(view: &LookAt, way: DVec3) -> LookAt {
    let Some([right, up, backward]) = view.axes() else { return *view };
    let way = way.x * right + way.y * up - way.z * backward;
    LookAt { from: view.from + way, at: view.at + way, ..*view }
}

/// Looks at another point, on the way to which the camera keeps a share of the distance: it stays in sight.
pub fn centre(view: &LookAt, at: DVec3, share: f64) -> LookAt {
    LookAt { from: at + share * (view.from - at), at, ..*view }
}

/// A camera of the scene as one that can be moved. It looks at the point `depth` ahead, in normalised units, and is
/// upright. One that is orthographic sees about as much at that depth.
pub fn placed(scene: &Scene, camera: &Camera, depth: f32) -> LookAt {
    let ahead = camera.position - depth * camera.axes[2];
    let fov = match camera.projection {
        Projection::Perspective { yfov, .. } => f64::from(yfov).to_degrees(),
        Projection::Orthographic { ymag, .. } => 2.0 * f64::from(ymag / depth).atan().to_degrees(),
    };
    LookAt { from: scene.normalisation.undo(camera.position), at: scene.normalisation.undo(ahead), fov }
}

/// The view with as few digits as a scene needs whose normalised size is `scale` of its own.
pub fn rounded(view: &LookAt, scale: f64) -> LookAt {
    let digits = scale.log10().ceil() as i32 + DIGITS;
    let unit = 10f64.powi(digits.abs());
    // A power of ten below 1 is not exact, and dividing by one above 1 rounds to the shortest decimal number.
    let short = |x: f64| if digits >= 0 { (x * unit).round() / unit } else { (x / unit).round() * unit };
    let fov = (view.fov * 1e3).round() / 1e3;
    let short = |p: DVec3| DVec3::new(short(p.x), short(p.y), short(p.z));
    LookAt { from: short(view.from), at: short(view.at), fov }
}

#[cfg(test)]
mod tests {
    use super::*;

    const VIEW: LookAt = LookAt { from: DVec3::new(1.0, 2.0, 5.0), at: DVec3::new(0.0, 1.0, 0.0), fov: 40.0 };

    fn assert_near(a: DVec3, b: DVec3) {
        // Some operations of numbers of size 10.
        assert!(a.distance(b) < 1e-13, "{a} is not {b}");
    }

    #[test]
    fn an_orbit_keeps_distance_and_centre_and_returns() {
        let there = orbit(&VIEW, [0.3, 0.1]);
        assert_eq!(there.at, VIEW.at);
        assert!((there.from.distance(there.at) - VIEW.from.distance(VIEW.at)).abs() < 1e-12);
        assert!(there.from.y > VIEW.from.y, "up is up");
        assert_near(orbit(&orbit(&there, [0.0, -0.1]), [-0.3, 0.0]).from, VIEW.from);
        assert_near(orbit(&VIEW, [2.0, 0.0]).from, VIEW.from);
    }

    #[test]
    fn an_orbit_stops_before_the_poles() {
        for up in [10.0, -10.0] {
            let pole = orbit(&VIEW, [0.0, up]);
            let [_, image_up, _] = pole.axes().unwrap();
            assert!(image_up.y > 0.0 && (pole.from.y - VIEW.at.y).signum() == f64::signum(up));
        }
    }

    #[test]
    fn a_pan_moves_the_centre_by_a_share_of_the_height() {
        let panned = pan(&VIEW, [0.5, 0.0]);
        let [right, ..] = VIEW.axes().unwrap();
        let half_height = 20f64.to_radians().tan() * VIEW.from.distance(VIEW.at);
        assert_near(panned.at, VIEW.at + right * half_height);
        assert_near(panned.from - panned.at, VIEW.from - VIEW.at);
    }

    #[test]
    fn a_dolly_approaches_without_arriving() {
        let near = dolly(&VIEW, 1.0);
        assert!((near.from.distance(near.at) * 1f64.exp() - VIEW.from.distance(VIEW.at)).abs() < 1e-12);
        assert_near(dolly(&near, -1.0).from, VIEW.from);
    }

    #[test]
    fn forward_is_towards_the_centre() {
        let there = fly(&VIEW, DVec3::Z);
        assert!((VIEW.from.distance(VIEW.at) - there.from.distance(VIEW.at) - 1.0).abs() < 1e-12);
    }

    #[test]
    fn rounding_leaves_short_decimals() {
        let long = LookAt { from: DVec3::new(1.0 / 3.0, -2e3 / 3.0, 0.1 + 0.2), ..VIEW };
        let short = rounded(&long, 1.0);
        assert_eq!(short.from.to_string(), "[0.333333, -666.666667, 0.3]");
        assert_eq!(rounded(&short, 1.0), short);
        assert_eq!(rounded(&long, 1e-9).from, DVec3::new(0.0, -1e3, 0.0));
    }
}
