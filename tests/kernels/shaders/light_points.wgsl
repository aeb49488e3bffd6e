// The light points of the candidates of a chunk, for a test to compare.

import package::kit::group_index;
import package::lib::tile::{Tile, tile_sample, pixel_seed};
import package::lib::light::table::LightSample;
import package::lib::sampled_light::{nth_light_sample, audit_light_sample};
import package::lib::math::oct_decode16;
import package::lib::point::Point;
import package::lib::ray::offset_origin;

override first_light: u32;
override candidates: u32;
override samples: u32;

@group(0) @binding(0) var<storage, read> points: array<Point>;
// Three vectors per light point: origin of the shadow ray and density, direction and distance, radiance.
@group(0) @binding(1) var<storage, read_write> sampled: array<vec4f>;

var<immediate> tile: Tile;

@compute @workgroup_size(64)
fn sample_light_points(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let candidate = group_index(group, groups) * 64u + lane;
    if candidate >= candidates { return; }
    let i = candidate % tile.point_count;
    let light = first_light + candidate / tile.point_count;
    let position = points[i].position;
    let origin = offset_origin(position, oct_decode16(points[i].normal));
    let seed = pixel_seed(tile, i);
    let sample_index = tile_sample(tile, i);
    for (var j = 0u; j <= samples; j++) {
        var s: LightSample;
        if j < samples {
            s = nth_light_sample(light, position, seed, sample_index, j, samples);
        } else {
            s = audit_light_sample(light, position, seed, sample_index);
        }
        let at = 3u * (candidate * (samples + 1u) + j);
        sampled[at] = vec4f(origin, s.pdf);
        sampled[at + 1u] = vec4f(s.direction, s.distance);
        sampled[at + 2u] = vec4f(s.radiance, 0.0);
    }
}
