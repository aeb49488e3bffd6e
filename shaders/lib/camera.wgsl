// Camera rays (glTF 3.10): the camera looks along -z of its axes.

import package::lib::ray::Ray;

struct CameraUniform {
    position: vec3f,
    orthographic: u32,
    right: vec3f,
    near: f32,
    up: vec3f,
    far: f32,
    backward: vec3f,
    padding: u32,
}

@group(1) @binding(13) var<uniform> camera: CameraUniform;

struct CameraRay {
    ray: Ray,
    // Cosine between the ray and the viewing direction: times the distance, the depth Z.
    cosine: f32,
}

// The ray through the film position (0 to 1 from the left and from the top), from the near to the far plane.
fn camera_ray(film: vec2f) -> CameraRay {
    let offset = (2.0 * film.x - 1.0) * camera.right + (1.0 - 2.0 * film.y) * camera.up;
    var origin = camera.position;
    var direction = -camera.backward;
    if camera.orthographic == 1u {
        origin += offset;
    } else {
        direction = normalize(direction + offset);
    }
    let cosine = dot(direction, -camera.backward);
    let near = camera.near / cosine;
    return CameraRay(Ray(origin, near, direction, camera.far / cosine), cosine);
}

// Unit vector from a point towards the viewer.
fn view_direction(position: vec3f) -> vec3f {
    if camera.orthographic == 1u { return camera.backward; }
    return normalize(camera.position - position);
}

// Height of a pixel of an image of `height` pixels, where the camera sees the position.
fn pixel_size(position: vec3f, height: u32) -> f32 {
    let unit = 2.0 * length(camera.up) / f32(height);
    if camera.orthographic == 1u { return unit; }
    return unit * abs(dot(camera.position - position, camera.backward));
}
