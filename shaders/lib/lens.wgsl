// A thin lens, whose points in focus lie in a plane in front of it. In: the ray through the lens's centre, and a point
// of the unit square. Out: the ray to the same point in focus, from another point of the iris.

import package::lib::camera::{CameraRay, camera};
import package::lib::math::circle_point;
import package::lib::ray::Ray;
import package::lib::sampling::{sample_disc, sample_triangle};

// A uniformly distributed point of the iris, a regular polygon with a corner to the right. Both shapes are evaluated,
// because lib/camera forbids branches on the camera.
fn iris_point(u: vec2f) -> vec2f {
    let side = min(floor(u.x * camera.iris_blades), camera.iris_blades - 1.0);
    let weights = sample_triangle(vec2f(u.x * camera.iris_blades - side, u.y));
    let within = 1.0 / camera.iris_blades;
    let polygon = weights.x * circle_point(side * within) + weights.y * circle_point((side + 1.0) * within);
    return select(polygon, sample_disc(u), camera.iris_blades < 3.0);
}

fn through_lens(pinhole: CameraRay, u: vec2f) -> CameraRay {
    let iris = camera.lens_radius * iris_point(u);
    let ray = pinhole.ray;
    let origin = ray.origin + iris.x * normalize(camera.right) + iris.y * normalize(camera.up);
    let in_focus = ray.origin + ray.direction * (camera.focus_distance / pinhole.cosine);
    let direction = normalize(in_focus - origin);
    // The near and the far plane are parallel to the lens.
    let cosine = dot(direction, -camera.backward);
    return CameraRay(Ray(origin, camera.near / cosine, direction, camera.far / cosine), cosine);
}
