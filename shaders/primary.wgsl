// primary: traces one camera ray for each sample of the tile. Where the ray meets mirrors or clear glass, follows it to
// the surface seen in or through them.
// In: the scene, the camera.
// Out: `points` and `surfaces`, the visible surface of each sample; `radiance_direct`, the emission that the ray meets;
// the AOVs that were requested; the guides of denoisers. w of `radiance_direct` is the image's alpha: 1 where the ray
// met a surface, or the environment unless that is hidden. Guides are of the surface at the end of a specular chain,
// with the random choices that led there. Positions are in scene units after normalisation.

import package::kit::group_index;
import package::lib::tile::{Tile, tile_pixel, tile_sample, pixel_seed};
import package::lib::camera::{CameraRay, camera_ray};
@if(thin_lens) import package::lib::lens::through_lens;
@if(thin_lens) import package::lib::constants::DIMENSION_LENS;
import package::lib::bvh::traversal_overrun;
import package::lib::packet::{no_ray, trace_closest_together};
@if(specular_chains) import package::lib::packet::in_any_lane;
@if(environment && (!hidden_environment || specular_chains)) import package::lib::environment::environment_radiance;
import package::lib::ray::{Hit, NO_HIT, RaySample};
import package::lib::surface::{SurfaceHit, surface_at};
import package::lib::math::{is_finite4, oct_encode16, invalid_sample};
import package::lib::rng::hash2;
@if(dispersion) import package::lib::wavelength::begin_wavelengths;
@if(dispersion && specular_chains) import package::lib::wavelength::carry;
import package::lib::sampling::sobol2;
@if(specular_chains) import package::lib::sampling::sobol1;
import package::lib::point::{Point, VisibleSurface, visible_surface_of};
@if(specular_chains) import package::lib::bsdf::{bsdf_sample, is_clear, leaving_normal};
@if(specular_chains) import package::lib::constants::{COUNTER_BOUNCE_RAYS, DIMENSION_CHAIN};
@if(specular_chains) import package::lib::light::BEYOND_SCENE;
@if(specular_chains) import package::lib::ray::{Ray, offset_origin};
@if(specular_chains && transmission && guides) import package::lib::bsdf::bsdf_passes;
@if(specular_chains && transmission && guides) import package::lib::bsdf::transmission::transmission_is_present;
@if(alpha_test && guides) import package::lib::alpha::{last_stopping, nearest_passed};
@if(specular_chains) import package::lib::rng::hash3;
import package::lib::constants::{INVALID_POINT, DIMENSION_CAMERA, DIMENSION_ALPHA};
import package::lib::constants::{COUNTER_NOT_FINITE_PRIMARY, COUNTER_OVERRUN};

@group(0) @binding(0) var<storage, read_write> points: array<Point>;
@group(0) @binding(1) var<storage, read_write> surfaces: array<VisibleSurface>;
@group(0) @binding(2) var<storage, read_write> radiance_direct: array<vec4f>;
@group(0) @binding(6) var<storage, read_write> counters: array<atomic<u32>>;
@if(aov_albedo) @group(0) @binding(3) var<storage, read_write> albedo_samples: array<vec4f>;
@if(aov_normal) @group(0) @binding(4) var<storage, read_write> normal_samples: array<vec4f>;
@if(aov_position) @group(0) @binding(5) var<storage, read_write> position_samples: array<vec4f>;
// Albedos, normals and positions, of equal lengths: in one binding, of which devices allow few.
@if(guides) @group(0) @binding(7) var<storage, read_write> guide_samples: array<vec4f>;

var<immediate> tile: Tile;

@compute @workgroup_size(64)
fn primary(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = group_index(group, groups) * 64u + lane;
    let has_point = i < tile.point_count;
    let seed = pixel_seed(tile, i);
    let sample_index = tile_sample(tile, i);
    let within = (1.0 - tile.centred) * sobol2(sample_index, hash2(seed, DIMENSION_CAMERA)) + 0.5 * tile.centred;
    let film = (vec2f(tile_pixel(tile, i)) + within) / vec2f(f32(tile.width), f32(tile.height));
    @if(!thin_lens) let camera = camera_ray(film);
    @if(thin_lens) let camera = through_lens(camera_ray(film), sobol2(sample_index, hash2(seed, DIMENSION_LENS)));
    @if(dispersion) { begin_wavelengths(seed, sample_index, vec3f(1.0)); }
    var view = view_along(camera, seed, sample_index, has_point, lane);
    let found = view.found;
    if !has_point { return; }
    @if(guides) { store_guides(i, &view); }

    var point = Point(vec3f(0.0), INVALID_POINT);
    if view.met {
        @if(specular_chains) let ends = found.unlit || is_clear(found.surface);
        @if(!specular_chains) let ends = found.unlit;
        if !ends { point = Point(found.position, oct_encode16(found.surface.geometric_normal)); }
        var surface = visible_surface_of(found);
        @if(specular_chains) { surface.chain = vec4f(view.throughput, bitcast<f32>(view.way_back)); }
        @if(thin_lens) { surface.eye = vec4f(camera.ray.origin, 0.0); }
        surfaces[i] = surface;
    }
    var direct = view.direct;
    if !is_finite4(direct + vec4f(point.position, 0.0)) { atomicAdd(&counters[COUNTER_NOT_FINITE_PRIMARY], 1u); }
    // The hit of a traversal that gave up is wrong.
    if traversal_overrun {
        atomicAdd(&counters[COUNTER_OVERRUN], 1u);
        point.normal = INVALID_POINT;
        direct = vec4f(invalid_sample(i));
    }
    points[i] = point;
    radiance_direct[i] = direct;
    @if(aov_albedo) { albedo_samples[i] = view.albedo; }
    @if(aov_normal) { normal_samples[i] = view.normal; }
    @if(aov_position) { position_samples[i] = view.position; }
}

// Writes the guides of sample i.
@if(guides)
fn store_guides(i: u32, view: ptr<function, View>) {
    var albedo = vec3f(0.0);
    var normal = vec3f(0.0);
    var position = vec4f(0.0);
    if (*view).met {
        albedo = (*view).found.base_colour;
        @if(specular_chains) { albedo *= (*view).throughput; }
        normal = (*view).found.surface.shading_normal;
        position = vec4f((*view).found.triangle_position, 1.0);
    }
    let room = arrayLength(&guide_samples) / 3u;
    guide_samples[i] = vec4f(albedo, chance.x);
    guide_samples[room + i] = vec4f(normal, chance.y);
    guide_samples[2u * room + i] = position;
}

// Random choices of the camera ray: x is 1 if the surface that the ray shows was chosen at random; y is 1 if it is a
// reflection in glass or a blended surface, and not the surface behind.
@if(guides) var<private> chance: vec2f;

@if(guides && alpha_test)
fn chance_of_blending(hit: Hit) -> vec2f {
    let stopped = hit.triangle != NO_HIT && hit.triangle == last_stopping;
    let passed = nearest_passed < hit.t;
    return vec2f(f32(stopped || passed), f32(stopped));
}

// Maximum number of links of a specular chain. After this many, a few thousandths of the light that entered glass are
// left in it.
@if(specular_chains) const MAX_LINKS = 32u;

// What the camera's ray shows.
struct View {
    // The ray met a surface.
    met: bool,
    // That surface. If the ray continued through clear glass and over mirrors: the first surface that is neither, or
    // the last one if there is none.
    found: SurfaceHit,
    // Emission on the way, as `radiance_direct` has it.
    direct: vec4f,
    // The throughput of the specular chain and the direction back along it, as VisibleSurface has them.
    @if(specular_chains) throughput: vec3f,
    @if(specular_chains) way_back: u32,
    // Where the camera's ray itself arrived.
    @if(aov_albedo) albedo: vec4f,
    @if(aov_normal) normal: vec4f,
    @if(aov_position) position: vec4f,
}

@if(!specular_chains)
fn view_along(camera: CameraRay, seed: u32, sample_index: u32, has_point: bool, lane: u32) -> View {
    var view: View;
    var ray = no_ray();
    if has_point { ray = camera.ray; }
    let hit = trace_closest_together(ray, RaySample(hash2(seed, DIMENSION_ALPHA), sample_index), lane);
    @if(guides && alpha_test) { chance = chance_of_blending(hit); }
    view.met = hit.triangle != NO_HIT;
    @if(environment && !hidden_environment) {
        if !view.met { view.direct = vec4f(environment_radiance(camera.ray.direction), 1.0); }
    }
    if view.met {
        view.found = surface_at(hit, camera.ray);
        view.direct = vec4f(view.found.emission, 1.0);
        add_channels(&view, hit, camera.cosine);
    }
    return view;
}

// The ray that continues a specular chain; the BSDF may end the chain instead.
@if(specular_chains)
struct Link {
    goes_on: bool,
    ray: Ray,
}

// Samples the ray that leaves the view's surface, which is a mirror or clear glass, and adds it to the chain.
@if(specular_chains)
fn next_link(view: ptr<function, View>, sample_index: u32, link_seed: u32) -> Link {
    let found = (*view).found;
    let lobe = sobol1(sample_index, hash2(link_seed, 1u));
    let scattered = bsdf_sample(found.surface, vec3f(sobol2(sample_index, link_seed), lobe));
    if !(scattered.pdf > 0.0) { return Link(false, no_ray()); }
    (*view).throughput *= scattered.weight;
    @if(guides && transmission) {
        if transmission_is_present(found.surface.transmission) {
            chance.x = 1.0;
            if !bsdf_passes(found.surface, scattered.direction) { chance.y = 1.0; }
        }
    }
    let normal = leaving_normal(found.surface, scattered.direction);
    return Link(true, Ray(offset_origin(found.position, normal), 0.0, scattered.direction, BEYOND_SCENE));
}

// Follows the camera's ray, through clear glass and over mirrors, to a surface that is neither. The camera's ray and
// those after it are traced in one place, because lavapipe compiles every place on its own: with two, compilation took
// half as long again.
@if(specular_chains)
fn view_along(camera: CameraRay, seed: u32, sample_index: u32, has_point: bool, lane: u32) -> View {
    var view: View;
    view.throughput = vec3f(1.0);
    view.way_back = INVALID_POINT;
    var ray = no_ray();
    if has_point { ray = camera.ray; }
    var sample = RaySample(hash2(seed, DIMENSION_ALPHA), sample_index);
    var goes_on = has_point;
    var links = 0u;
    for (var link = 0u; ; link++) {
        let is_first = link == 0u;
        let hit = trace_closest_together(ray, sample, lane);
        @if(guides && alpha_test) { if is_first { chance = chance_of_blending(hit); } }
        let ends = hit.triangle == NO_HIT || (traversal_overrun && !is_first);
        // The image's alpha.
        let alpha = select(0.0, 1.0, is_first);
        @if(environment && hidden_environment) let shows = !is_first;
        @if(environment && !hidden_environment) let shows = true;
        @if(environment) {
            if goes_on && ends && shows {
                view.direct += vec4f(view.throughput * environment_radiance(ray.direction), alpha);
            }
        }
        goes_on &= !ends;
        if goes_on {
            @if(dispersion) { if !is_first { carry(view.throughput); } }
            view.found = surface_at(hit, ray);
            @if(transmission) { if !is_first { view.throughput *= view.found.transmittance; } }
            view.direct += vec4f(view.throughput * view.found.emission, alpha);
            if is_first {
                view.met = true;
                add_channels(&view, hit, camera.cosine);
            } else {
                view.way_back = oct_encode16(-ray.direction);
            }
        }
        goes_on &= link < MAX_LINKS && !view.found.unlit && is_clear(view.found.surface);
        let link_seed = hash3(seed, DIMENSION_CHAIN, link);
        sample = RaySample(~link_seed, sample_index);
        ray = no_ray();
        if goes_on {
            let next = next_link(&view, sample_index, link_seed);
            goes_on = next.goes_on;
            ray = next.ray;
            links += u32(goes_on);
        }
        if !in_any_lane(goes_on, lane) { break; }
    }
    if links > 0u { atomicAdd(&counters[COUNTER_BOUNCE_RAYS], links); }
    return view;
}

// Fills in the AOVs of the surface that the camera's ray itself met.
fn add_channels(view: ptr<function, View>, hit: Hit, cosine: f32) {
    @if(aov_albedo) { (*view).albedo = vec4f((*view).found.base_colour, 1.0); }
    @if(aov_normal) { (*view).normal = vec4f((*view).found.surface.shading_normal, 1.0); }
    @if(aov_position) { (*view).position = vec4f((*view).found.triangle_position, hit.t * cosine); }
}
