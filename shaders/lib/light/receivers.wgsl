// Emission towards receiver bounds: lights emit photons only into the cone of directions that contains all surfaces
// that receive light.

import package::lib::constants::LIGHT_RECEIVERS_TEXEL;
import package::lib::light::table::load_light_texel;
@if(mesh_lights) import package::lib::math::{basis, safe_sqrt};
@if(mesh_lights) import package::lib::sampling::{sample_cosine, sample_disc};

// The cone of directions from a position to the sphere that bounds all surfaces that receive light.
struct ReceiverCone {
    axis: vec3f,
    // Squared sine of the angle between the axis and the rim; 1 if the position is within the bounds, or there are
    // none.
    squared_sine: f32,
    // 1 minus the cosine of that angle; in those cases 2, which is all directions.
    height: f32,
}

fn receiver_cone(position: vec3f) -> ReceiverCone {
    let sphere = bitcast<vec4f>(load_light_texel(LIGHT_RECEIVERS_TEXEL));
    let offset = sphere.xyz - position;
    let squared_sine = sphere.w * sphere.w / dot(offset, offset);
    if sphere.w == 0.0 || !(squared_sine < 1.0) { return ReceiverCone(vec3f(0.0, 0.0, 1.0), 1.0, 2.0); }
    return ReceiverCone(normalize(offset), squared_sine, squared_sine / (1.0 + sqrt(1.0 - squared_sine)));
}

@if(mesh_lights)
struct BoundedDirection {
    direction: vec3f,
    // Share of the cosine-weighted hemisphere.
    share: f32,
}

// Samples a direction by the cosine law about the normal, within the cone if the whole cone is above the horizon. By
// Nusselt's analogue, such directions project to uniform points of the unit disc, and the rim of the cone to an
// ellipse.
@if(mesh_lights)
fn sample_bounded_cosine(normal: vec3f, cone: ReceiverCone, u: vec2f) -> BoundedDirection {
    let cosine = dot(cone.axis, normal);
    let frame = basis(normal);
    if cosine <= 0.0 || cosine * cosine <= cone.squared_sine { return BoundedDirection(frame * sample_cosine(u), 1.0); }
    let along = cone.axis - cosine * normal;
    let sine = length(along);
    var radial = frame[0];
    // With the cone along the normal, the ellipse is a circle.
    if sine > 1e-4 { radial = along / sine; }
    let p = sqrt(cone.squared_sine) * sample_disc(u);
    let below = along * (1.0 - cone.height) + radial * (cosine * p.x) + cross(normal, radial) * p.y;
    let up = safe_sqrt(1.0 - dot(below, below));
    return BoundedDirection(below + up * normal, cone.squared_sine * cosine);
}
