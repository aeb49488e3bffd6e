// Camera rays (glTF 3.10): the camera looks along -z of its axes.
// In: `camera`; positions and lengths in scene units after normalisation. Out: rays, viewing directions, sizes of
// pixels.
//
// Do not branch on a member of the camera: lavapipe turns such uniforms into constants of the kernel, and compiles it
// again for every dispatch (15 to 70 ms in `shade` and `path`).

import package::lib::ray::Ray;

struct CameraUniform {
    position: vec3f,
    orthographic: u32,
    right: vec3f,
    near: f32,
    up: vec3f,
    far: f32,
    backward: vec3f,
    // 0: a pinhole.
    lens_radius: f32,
    focus_distance: f32,
    // Corners of the iris; below 3 it is round, and never 0.
    iris_blades: f32,
    padding: vec2u,
}

@group(1) @binding(13) var<uniform> camera: CameraUniform;

struct CameraRay {
    ray: Ray,
    // Cosine between the ray and the viewing direction. The distance times this is the depth Z.
    cosine: f32,
}

// The ray through a position of the film (0 to 1 from the left and from the top), from the near to the far plane.
fn camera_ray(film: vec2f) -> CameraRay {
    let offset = (2.0 * film.x - 1.0) * camera.right + (1.0 - 2.0 * film.y) * camera.up;
    let parallel = camera.orthographic == 1u;
    let origin = camera.position + select(vec3f(0.0), offset, parallel);
    let direction = select(normalize(offset - camera.backward), -camera.backward, parallel);
    let cosine = dot(direction, -camera.backward);
    let near = camera.near / cosine;
    return CameraRay(Ray(origin, near, direction, camera.far / cosine), cosine);
}

// Unit vector from a point towards the viewer.
fn view_direction(position: vec3f) -> vec3f {
    return select(normalize(camera.position - position), camera.backward, camera.orthographic == 1u);
}

// Where the image shows a position in front of the lens (0 to 1 from the left and from the top), seen from the lens's
// centre.
@if(thin_lens)
fn film_position(position: vec3f) -> vec2f {
    let offset = position - camera.position;
    let depth = -dot(offset, camera.backward);
    let across = vec2f(dot(offset, camera.right), -dot(offset, camera.up));
    return 0.5 + 0.5 * across / (depth * vec2f(dot(camera.right, camera.right), dot(camera.up, camera.up)));
}

// Height of a pixel at the distance of a visible position. `height` is the image's height in pixels.
fn pixel_size(position: vec3f, height: u32) -> f32 {
    let unit = 2.0 * length(camera.up) / f32(height);
    let distance = abs(dot(camera.position - position, camera.backward));
    return unit * select(distance, 1.0, camera.orthographic == 1u);
}
