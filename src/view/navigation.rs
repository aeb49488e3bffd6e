//! Moving a camera: orbit, pan, dolly and fly.

use std::f64::consts::PI;

use glam::{DQuat, DVec3};

use crate::scene::{Camera, Extent, LookAt, Projection, Scene};

/// Minimum angle in radians between the view and the direction that is up, or its opposite. An orbit stops there:
/// beyond it, up and down of the image would change sides.
const STEEPEST: f64 = 0.01;

/// Decimal digits that are kept of a position, relative to the size of the scene. The last one is finer than a pixel of
/// a large image, and short numbers make short commands.
const DIGITS: i32 = 6;

/// A camera counts as upright if its right axis rises or falls by less than this. Rounding leaves less.
const LEVEL: f64 = 1e-5;

/// Turns the camera about its target: `right` = 1 is half a turn to the right, `up` = 1 is half a turn upward. The
/// camera's own up direction stays up.
pub fn orbit(view: &LookAt, [right, up]: [f64; 2]) -> LookAt {
    let arm = view.from - view.at;
    let distance = arm.length();
    let (Some(backward), Some(pole)) = (arm.try_normalize(), view.up.try_normalize()) else { return *view };
    let elevation = backward.angle_between(pole);
    let steps = (elevation - PI * up).clamp(STEEPEST, PI - STEEPEST) - elevation;
    let Some([across, ..]) = view.axes() else { return *view };
    let turned = DQuat::from_axis_angle(pole, PI * right) * DQuat::from_axis_angle(across, steps) * backward;
    LookAt { from: view.at + distance * turned, ..*view }
}

/// Moves the camera and its target parallel to the image, by shares of the image's height. The target appears to move
/// by the same amount the other way.
pub fn pan(view: &LookAt, [right, up]: [f64; 2]) -> LookAt {
    fly(view, DVec3::new(right, up, 0.0) * seen_height(view))
}

/// The height that the camera sees at the distance of its target.
fn seen_height(view: &LookAt) -> f64 {
    match view.extent {
        Extent::FieldOfView(fov) => 2.0 * (0.5 * fov.to_radians()).tan() * view.from.distance(view.at),
        Extent::Height(height) => height,
    }
}

/// Moves the camera towards its target: one step leaves 1 / e of the distance. An orthographic camera stays in place,
/// and the height that it sees shrinks instead.
pub fn dolly(view: &LookAt, steps: f64) -> LookAt {
    scaled(view, (-steps).exp())
}

/// The camera at `share` of its distance.
fn scaled(view: &LookAt, share: f64) -> LookAt {
    match view.extent {
        Extent::FieldOfView(_) => LookAt { from: view.at + (view.from - view.at) * share, ..*view },
        Extent::Height(height) => LookAt { extent: Extent::Height(height * share), ..*view },
    }
}

/// Moves the camera and its target along the camera's axes: right, up and forward, in the units of the file.
pub fn fly(view: &LookAt, movement: DVec3) -> LookAt {
    let Some([right, up, backward]) = view.axes() else { return *view };
    let movement = movement.x * right + movement.y * up - movement.z * backward;
    LookAt { from: view.from + movement, at: view.at + movement, ..*view }
}

/// Looks at another point, after moving straight towards it until `share` of the distance is left. So the point stays
/// in sight.
pub fn centre(view: &LookAt, at: DVec3, share: f64) -> LookAt {
    match view.extent {
        Extent::FieldOfView(_) => LookAt { from: at + share * (view.from - at), at, ..*view },
        Extent::Height(_) => scaled(&LookAt { from: view.from + (at - view.at), at, ..*view }, share),
    }
}

/// A view that sees a ball from the same side, in an image of `aspect` times its height.
pub fn around(view: &LookAt, centre: DVec3, radius: f64, aspect: f64) -> Option<LookAt> {
    let [_, _, backward] = view.axes()?;
    let narrow = aspect.min(1.0);
    let (distance, extent) = match view.extent {
        Extent::FieldOfView(fov) => {
            let slope = (0.5 * fov.to_radians()).tan() * narrow;
            (radius / slope.atan().sin(), view.extent)
        }
        // From far enough that the whole ball is ahead.
        Extent::Height(_) => (2.0 * radius, Extent::Height(2.0 * radius / narrow)),
    };
    Some(LookAt { from: centre + distance * backward, at: centre, up: view.up, extent })
}

/// A camera of the scene as a movable one. Its target is `depth` ahead, in normalised units. A rolled camera keeps its
/// own up direction; for all others +Y is up.
pub fn placed(scene: &Scene, camera: &Camera, depth: f32) -> LookAt {
    let ahead = camera.position - depth * camera.axes[2];
    let extent = match camera.projection {
        Projection::Perspective { yfov, .. } => Extent::FieldOfView(f64::from(yfov).to_degrees()),
        Projection::Orthographic { ymag, .. } => Extent::Height(2.0 * f64::from(ymag) / scene.normalisation.scale()),
    };
    let [right, up, _] = camera.axes.map(|axis| axis.as_dvec3());
    let is_upright = right.y.abs() < LEVEL && up.y > 0.0;
    let up = if is_upright { DVec3::Y } else { up };
    LookAt { from: scene.normalisation.undo(camera.position), at: scene.normalisation.undo(ahead), up, extent }
}

/// The view with as few digits as the scene needs. `scale` is the scene's normalised size over its own.
pub fn rounded(view: &LookAt, scale: f64) -> LookAt {
    let digits = scale.log10().ceil() as i32 + DIGITS;
    let extent = match view.extent {
        Extent::FieldOfView(fov) => Extent::FieldOfView((fov * 1e3).round() / 1e3),
        // However near: as many digits as the number needs.
        Extent::Height(height) => Extent::Height(short(height, DIGITS - height.log10().ceil() as i32)),
    };
    let all = |p: DVec3, digits| DVec3::new(short(p.x, digits), short(p.y, digits), short(p.z, digits));
    LookAt { from: all(view.from, digits), at: all(view.at, digits), up: all(view.up, DIGITS), extent }
}

/// A number rounded to `digits` digits after its point, or before it if `digits` is negative.
fn short(x: f64, digits: i32) -> f64 {
    let unit = 10f64.powi(digits.abs());
    // A power of ten below 1 is not exact, and dividing by one above 1 rounds to the shortest decimal number.
    if digits >= 0 { (x * unit).round() / unit } else { (x / unit).round() * unit }
}

#[cfg(test)]
mod tests {
    use super::*;

    const VIEW: LookAt =
        LookAt::upright(DVec3::new(1.0, 2.0, 5.0), DVec3::new(0.0, 1.0, 0.0), Extent::FieldOfView(40.0));

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

    /// A camera that lies on its side stays so: orbiting turns it about its own up direction.
    #[test]
    fn an_orbit_keeps_the_roll() {
        let rolled = LookAt { up: DVec3::new(2.0, 0.0, 0.0), ..VIEW };
        let there = orbit(&rolled, [0.3, 0.0]);
        assert!((there.from.x - rolled.from.x).abs() < 1e-12, "a turn about x leaves x");
        assert!((there.from.distance(there.at) - rolled.from.distance(rolled.at)).abs() < 1e-12);
        let [right, up, _] = there.axes().unwrap();
        assert!(right.x.abs() < 1e-12 && up.x > 0.0);
        assert_eq!(there.up, rolled.up);
    }

    /// An orthographic camera stays one: a dolly changes what it sees, a pan moves by shares of that.
    #[test]
    fn an_orthographic_camera_stays_orthographic() {
        let view = LookAt { extent: Extent::Height(3.0), ..VIEW };
        assert_eq!(dolly(&view, 2f64.ln()), LookAt { extent: Extent::Height(1.5), ..view });
        let panned = pan(&view, [0.5, 0.0]);
        assert!((panned.at.distance(view.at) - 1.5).abs() < 1e-12);
        let near = centre(&view, DVec3::ONE, 0.5);
        assert_near(near.from - near.at, view.from - view.at);
        assert_eq!((near.at, near.extent), (DVec3::ONE, Extent::Height(1.5)));
        assert_eq!(orbit(&view, [0.3, 0.1]).extent, view.extent);
    }

    /// A ball that is framed touches the sides of the image that are nearest: by its tangent cone.
    #[test]
    fn a_ball_is_framed() {
        let [centre, radius] = [DVec3::new(1.0, -2.0, 0.5), DVec3::splat(0.7)];
        for (aspect, half) in [(2.0, 20f64.to_radians()), (0.5, (0.5 * 20f64.to_radians().tan()).atan())] {
            let seen = around(&VIEW, centre, radius.x, aspect).unwrap();
            assert!((radius.x / seen.from.distance(centre) - half.sin()).abs() < 1e-12);
            let flat = around(&LookAt { extent: Extent::Height(9.0), ..VIEW }, centre, radius.x, aspect).unwrap();
            assert_eq!(flat.extent, Extent::Height(1.4 / aspect.min(1.0)));
        }
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
