// irradiance: density estimation on the global map. `irradiance` precomputes the irradiance at irradiance points all
// over the scene (Christensen 1999). `show` visualises the map: it estimates the irradiance at the points of a tile.
// `caustics` adds the light of the caustic map at these points.
// In: a map of photons, sorted by cell; the irradiance points, or `points` and `surfaces`.
// Out: `irradiances`, for each irradiance point the irradiance, the radius of the disc and, with `caustic_irradiance`,
// the part of the irradiance that only focusing surfaces have scattered; or `radiance_indirect`. Lengths are in scene
// units after normalisation; irradiance is in units of radiance times steradian.

import package::lib::bvh::{hit_normal, traversal_iterations, traversal_overrun};
@if(negative_photons) import package::lib::bvh::trace_closest;
import package::lib::packet::{no_ray, trace_closest_together};
import package::kit::group_index;
import package::lib::irradiance::{IRRADIANCE_TEXELS, NO_ESTIMATE, encode_disc};
import package::lib::grid::{
    COMPATIBLE_COSINE_SQUARED, GridShape, OFFSET_WEIGHT, cell_of, counted_distance, expected_reach, load_photon,
    point_ball, row_photons, rows_about
};
@if(!(photon_map || caustics)) import package::lib::math::{PI, basis, circle_point, is_finite3};
@if(photon_map || caustics) import package::lib::math::{
    PI, basis, circle_point, invalid_sample, is_finite3, oct_decode16
};
@if(photon_map || caustics) import package::lib::point::{Point, VisibleSurface};
@if(photon_map || caustics) import package::lib::bsdf::bsdf_diffuse;
@if(photon_map || caustics) import package::lib::visible_point::{load_point, load_surface, visible_surface};
@if(photon_map || caustics) import package::lib::constants::{COUNTER_OVERRUN, INVALID_POINT};
import package::lib::constants::COUNTER_NOT_FINITE_IRRADIANCE;
@if(negative_photons) import package::lib::constants::UNSHADOWED_LIGHTS;
@if(negative_photons) import package::lib::light::table::{light_count, light_has_closed_form};
@if(negative_photons) import package::lib::light::{light_sample, light_unshadowed_irradiance};
@if(negative_photons) import package::lib::sampling::sobol2;
import package::lib::photon::{Photon, flux_of, photon_normal};
@if(caustic_irradiance) import package::lib::photon::photon_is_caustic;
import package::lib::ray::{NO_HIT, Ray, RaySample, offset_origin};
@if(negative_photons) import package::lib::ray::Hit;
import package::lib::rng::{hash1, hash3, uniform_from_bits};
@if(negative_photons) import package::lib::shading_normal::share_of_sky;
@if(negative_photons) import package::lib::surface::{ray_behind, stores_photons, surface_at};
import package::lib::surface::shows_photons;

struct IrradianceParameters {
    // The grid of the map.
    grid: GridShape,
    // Number of irradiance points, or of points of the tile.
    count: u32,
    // Power of one step of a photon's encoded flux.
    step: f32,
    // Radius of a disc, relative to that of a disc with k photons.
    shrink: f32,
    // The first of the lights whose unshadowed light is added. Later dispatches with further lights add nothing else.
    first_light: u32,
    // This grid of the caustic map serves only the points in a shell between two cubes around a centre: farther from it
    // than the faces of the inner cube, at `inner`, and no farther than those of the outer one, at `outer`.
    centre: vec3f,
    inner: f32,
    outer: f32,
    padding: u32,
    more_padding: vec2u,
}

var<immediate> irradiance_pass: IrradianceParameters;

@group(0) @binding(0) var<storage, read> irradiance_points: array<Photon>;
@group(0) @binding(1) var<storage, read_write> irradiances: array<vec4f>;

@if(photon_map || caustics) @group(0) @binding(4) var<storage, read_write> radiance_indirect: array<vec4f>;
@group(0) @binding(5) var<storage, read_write> counters: array<atomic<u32>>;

// Maximum number of photons and rows that an estimate visits.
const MAX_VISITS = 16384u;

// Maximum number of photons that a lane visits before the other lanes of its vector may go on to their next rows. On
// lavapipe the lanes share 65,535 loop iterations. If each visited its rows to their ends, eight lanes whose long rows
// come in turn would need eight times MAX_VISITS, and all loops would end in silence. So in each turn a lane visits
// this many photons of its row, or ends the row. A lane has at most 9 x 9 rows, so there are at most
// 81 + MAX_VISITS / PHOTONS_OF_TURN turns, of at most PHOTONS_OF_TURN + 2 iterations: 27,200 in all. Most rows have
// fewer photons than this.
const PHOTONS_OF_TURN = 128u;

// Maximum number of iterations of the probes, with which those of the photons must fit into the 65,535. The lanes of a
// packet have the same iterations, of which a third more are not counted with alpha tests (lib/packet). Of rays that
// are traced one by one, as all that look for hidden surfaces, this is a quarter of what software devices allow: the
// slowest lane may differ between rays (PATH_ITERATIONS in lib/path_tracing).
@if(packets && !negative_photons) const PROBE_ITERATIONS = 28000u;
@if(!packets || negative_photons) const PROBE_ITERATIONS = 16384u;

// Maximum radius of the disc of an irradiance point, in cells. Where photons are sparse, such as in a room that is lit
// through a door ajar, discs of one cell hold few photons, and are valid for few of the gather rays that land there.
// The other rays continue as paths, which are slower and have more variance. Eight cells were no better than four in
// scenes/door.glb.
const MAX_REACH_WHERE_SPARSE = 4.0;

// The same at the points of a tile: within one cell a disc holds no more photons than the 27 cells around it, so that
// no dense spot exceeds MAX_VISITS, which would make the sample invalid.
@if(photon_map || caustics) const MAX_REACH_OF_POINTS = 1.0;

// Probes of a disc. At edges the relative error of the measured area is about an eighth, and independent from one
// irradiance point to the next.
const PROBES = 16u;

@compute @workgroup_size(64)
fn irradiance(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = group_index(group, groups) * 64u + lane;
    // Lanes without a point trace no rays together with the others.
    let is_active = i < irradiance_pass.count;
    let photon = irradiance_points[min(i, irradiance_pass.count - 1u)];
    let found = irradiance_at(photon.position, photon_normal(photon.word), MAX_REACH_WHERE_SPARSE, is_active, lane);
    if !is_active { return; }
    let finite = is_finite3(found.value);
    if !finite { atomicAdd(&counters[COUNTER_NOT_FINITE_IRRADIANCE], 1u); }
    let texels = IRRADIANCE_TEXELS * i;
    irradiances[texels] = select(vec4f(0.0, 0.0, 0.0, NO_ESTIMATE), vec4f(found.value, found.disc), finite);
    @if(caustic_irradiance) {
        irradiances[texels + 1u] = vec4f(select(vec3f(0.0), found.caustic, finite), 0.0);
    }
}

@if(photon_map)
@compute @workgroup_size(64)
fn show(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = group_index(group, groups) * 64u + lane;
    var is_active = i < irradiance_pass.count;
    let index = min(i, irradiance_pass.count - 1u);
    var before = vec3f(0.0);
    @if(negative_photons) {
        if irradiance_pass.first_light > 0u { before = radiance_indirect[index].xyz; }
        // An invalid sample stays one, and is counted once.
        is_active &= is_finite3(before);
    }
    let point = load_point(index);
    let surface = load_surface(index);
    let shown = is_active && point.normal != INVALID_POINT;
    let query = photon_query(surface, point);
    let found = irradiance_at(query.position, query.normal, MAX_REACH_OF_POINTS, shown, lane);
    if !is_active { return; }
    var radiance = vec3f(0.0);
    if shown {
        let seen = visible_surface(surface, point);
        radiance = bsdf_diffuse(seen) * found.value;
        // With negative photons, irradiance is that of the triangle.
        @if(negative_photons) { radiance *= share_of_sky(seen.shading_normal, query.normal); }
        @if(specular_chains) { radiance *= surface.chain.xyz; }
        radiance = checked(radiance, i);
    }
    radiance_indirect[i] = vec4f(before + radiance, 1.0);
}

// Adds the light of the caustic map at the points of a tile. Focused light is far denser in some spots than around
// them, so the discs are small, and probes do not measure the part of a disc that is surface.
@if(caustics)
@compute @workgroup_size(64)
fn caustics(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = group_index(group, groups) * 64u + lane;
    if i >= irradiance_pass.count { return; }
    let point = load_point(i);
    let surface = load_surface(i);
    if point.normal == INVALID_POINT || !any(surface.packed.base.xyz > vec3f(0.0)) { return; }
    var reflected = bsdf_diffuse(visible_surface(surface, point));
    @if(specular_chains) { reflected *= surface.chain.xyz; }
    let query = photon_query(surface, point);
    let offset = abs(query.position - irradiance_pass.centre);
    let distance = max(max(offset.x, offset.y), offset.z);
    if distance <= irradiance_pass.inner || distance > irradiance_pass.outer { return; }
    let reach = reach_at(query.position, MAX_REACH_OF_POINTS);
    let disc = flux_about(query.position, query.normal, reach, Walls(NO_WALL, NO_WALL));
    if disc.radius <= 0.0 && !traversal_overrun { return; }
    let radiance = reflected * disc.flux / (PI * disc.radius * disc.radius);
    radiance_indirect[i] += vec4f(checked(radiance, i), 0.0);
}

@if(photon_map || caustics)
struct PhotonQuery {
    position: vec3f,
    normal: vec3f,
}

// The position at which photons of point i are stored: on the triangle, not on the smooth surface that it approximates.
@if(photon_map || caustics)
fn photon_query(surface: VisibleSurface, point: Point) -> PhotonQuery {
    @if(smooth_normals) {
        let stored = surface.triangle;
        return PhotonQuery(stored.xyz, oct_decode16(bitcast<u32>(stored.w)));
    }
    @else { return PhotonQuery(point.position, oct_decode16(point.normal)); }
}

// The radiance of point i, or an invalid sample where there were too many photons to visit. Counts radiance that is not
// finite.
@if(photon_map || caustics)
fn checked(radiance: vec3f, i: u32) -> vec3f {
    if traversal_overrun {
        atomicAdd(&counters[COUNTER_OVERRUN], 1u);
        return vec3f(invalid_sample(i));
    }
    if !is_finite3(radiance) { atomicAdd(&counters[COUNTER_NOT_FINITE_IRRADIANCE], 1u); }
    return radiance;
}

struct Estimate {
    // Irradiance.
    value: vec3f,
    // The encoded disc (lib/irradiance).
    disc: f32,
    // The part of the irradiance that only focusing surfaces have scattered.
    @if(caustic_irradiance) caustic: vec3f,
}

// Irradiance at a position, by density estimation. With negative photons, direct light is added as unshadowed, and
// shadow photons subtract the excess. Shadow photons also lie on hidden surfaces within the disc: just below the point,
// or behind a wall. So unshadowed light is added for the hidden surfaces too. The mean then equals that of a map of
// positive photons alone, which has no photons there. All lanes of a subgroup trace at the same time (lib/packet);
// those that are not active trace no rays.
fn irradiance_at(position: vec3f, normal: vec3f, max_reach: f32, is_active: bool, lane: u32) -> Estimate {
    let reach = reach_at(position, max_reach);
    let share = covered(position, normal, select(0.0, reach * irradiance_pass.grid.cell, is_active), lane);
    traversal_overrun |= traversal_iterations > PROBE_ITERATIONS;
    var disc: Disc;
    if is_active && !traversal_overrun { disc = flux_about(position, normal, reach, share.walls); }
    // In a gap too narrow for every probe, the area is unknown, and so it is where the probes met the loop budget.
    var found: Estimate;
    found.disc = NO_ESTIMATE;
    if disc.radius <= 0.0 || share.area == 0.0 || traversal_overrun { return found; }
    let area = PI * disc.radius * disc.radius * share.area;
    var light = disc.flux / area;
    @if(negative_photons) {
        let surfaces = 1.0 + share.hidden / share.area;
        let first = irradiance_pass.first_light;
        if first > 0u { light = vec3f(0.0); }
        let end = min(first + UNSHADOWED_LIGHTS, light_count());
        for (var l = first; l < end; l++) { light += surfaces * unshadowed(l, position, normal); }
    }
    found.value = light;
    found.disc = encode_disc(disc.radius, share.clear);
    @if(caustic_irradiance) { found.caustic = disc.caustic / area; }
    return found;
}

// Light points that sample a light without a closed form: as many as direct light samples by default.
@if(negative_photons) const UNSHADOWED_SAMPLES = 4u;

// The irradiance from a light without occlusion.
@if(negative_photons)
fn unshadowed(light: u32, position: vec3f, normal: vec3f) -> vec3f {
    if light_has_closed_form(light) { return light_unshadowed_irradiance(light, position, normal); }
    let bits = bitcast<vec3u>(position);
    let seed = hash3(bits.x, bits.y, bits.z + light);
    var sum = vec3f(0.0);
    for (var j = 0u; j < UNSHADOWED_SAMPLES; j++) {
        let lit = light_sample(light, position, sobol2(j, seed));
        let cosine = dot(lit.direction, normal);
        if lit.pdf > 0.0 && cosine > 0.0 { sum += lit.radiance * (cosine / lit.pdf); }
    }
    return sum / f32(UNSHADOWED_SAMPLES);
}

struct Disc {
    // Power of its photons.
    flux: vec3f,
    // 0 where there were too many photons to visit.
    radius: f32,
    // Power of those that only focusing surfaces have scattered.
    @if(caustic_irradiance) caustic: vec3f,
}

// The radius of the disc around a position, in cells, at most `max_reach`: that of a disc that holds k photons at the
// mean density of the 27 cells around it. Because it does not depend on which photons lie in the disc, it adds no bias
// for any k.
fn reach_at(position: vec3f, max_reach: f32) -> f32 {
    let grid = irradiance_pass.grid;
    return min(expected_reach(grid, 0u, cell_of(grid, position), irradiance_pass.shrink), max_reach);
}

// Sums the photons of the disc around a position, less those behind walls. `reach` is in cells.
fn flux_about(position: vec3f, normal: vec3f, reach: f32, walls: Walls) -> Disc {
    let grid = irradiance_pass.grid;
    let at = (position - grid.origin) * grid.inverse_cell;
    let radius = reach * grid.cell;
    let limit = radius * radius;
    var sum = vec3i(0);
    @if(caustic_irradiance) var caustic = vec3i(0);
    var visits = 0u;
    let ball = point_ball(at, reach, normal);
    let rows = rows_about(grid, ball);
    let size = max(rows.zw - rows.xy + 1, vec2i(0));
    // The photons of the present row that are not visited yet.
    var row = vec2u(0u);
    var next = 0;
    while next < size.x * size.y || row.x < row.y {
        if row.x >= row.y {
            row = row_photons(grid, 0u, rows.xy + vec2i(next % size.x, next / size.x), ball);
            next++;
            visits += row.y - row.x + 1u;
            if visits > MAX_VISITS {
                traversal_overrun = true;
                return Disc();
            }
        }
        let end = min(row.x + PHOTONS_OF_TURN, row.y);
        for (var p = row.x; p < end; p++) {
            let photon = load_photon(p);
            let v = bitcast<vec3f>(photon.xyz) - position;
            let is_hidden = is_behind(walls.first, v) || is_behind(walls.second, v);
            let counts = !is_hidden && counted_distance(photon, position, normal) <= limit;
            let flux = select(vec3i(0), flux_of(photon.w), counts);
            sum += flux;
            @if(caustic_irradiance) { caustic += select(vec3i(0), flux, photon_is_caustic(photon.w)); }
        }
        row.x = end;
    }
    var disc: Disc;
    disc.flux = vec3f(sum) * irradiance_pass.step;
    disc.radius = radius;
    @if(caustic_irradiance) { disc.caustic = vec3f(caustic) * irradiance_pass.step; }
    return disc;
}

// How far behind a wall's plane a position must be to be behind the wall, in radii: photons of the wall itself are not,
// whatever rounding does.
const BEHIND = 1e-3;

// The walls that hide a part of a disc from its centre: of the positions v behind a wall, relative to the centre,
// dot(xyz, v) is less than w. `NO_WALL` has none. A disc in a corner has two.
struct Walls {
    first: vec4f,
    second: vec4f,
}

const NO_WALL = vec4f(0.0, 0.0, 0.0, -1.0);

// Planes whose numbers differ by less are one plane. Positions are up to 1 and rounded.
const SAME_PLANE = 1e-5;

fn is_behind(wall: vec4f, at: vec3f) -> bool { return dot(wall.xyz, at) < wall.w; }

// Adds the plane of a wall that has stopped a probe. A third is left out.
fn with_wall(walls: Walls, plane: vec4f) -> Walls {
    if all(walls.first == NO_WALL) { return Walls(plane, NO_WALL); }
    let is_known = all(abs(walls.first - plane) < vec4f(SAME_PLANE));
    if is_known || any(walls.second != NO_WALL) { return walls; }
    return Walls(walls.first, plane);
}

struct Covered {
    // Area of surface over that of the disc; 0 for a disc without a radius.
    area: f32,
    // Distance from the position, in radii, within which the probes found no edge, wall or gap.
    clear: f32,
    // The walls that hide a part of it. `area` leaves out what is behind them, so photons there must not count either:
    // the light of a bright room would leak into a dark one through a thin wall. With negative photons there are none:
    // `hidden` counts what is behind walls.
    walls: Walls,
    // Area within the ellipsoid that is hidden from the position, over that of the disc.
    @if(negative_photons) hidden: f32,
}

// Beyond this part of the radius the probes may miss an edge: the segment that it cuts off is smaller than the area of
// one probe.
const MAX_CLEAR = 0.8;

// The part of the disc's area that is nearer to its centre than a probe.
fn part_of_disc(probe: u32) -> f32 { return (f32(probe) + 0.5) / f32(PROBES); }

// A disc as its probes see it: columns of `frame` are two tangents and the normal; the spiral is turned by `rotation`.
struct ProbedDisc {
    position: vec3f,
    normal: vec3f,
    frame: mat3x3f,
    radius: f32,
    rotation: f32,
}

// Where a probe is sent on the disc, from its centre: a golden-angle spiral, with equal areas.
fn probe_on_disc(disc: ProbedDisc, probe: u32) -> vec3f {
    let direction = circle_point(disc.rotation + f32(probe) * 0.61803399);
    return disc.frame * vec3f(disc.radius * sqrt(part_of_disc(probe)) * direction, 0.0);
}

// Measures how much of a disc is surface: the area within the search ellipsoid that is visible from the position, over
// the area of the disc. At edges and in corners, photons lie on only a part of the disc, and dividing by the whole disc
// makes the estimate too dark (boundary bias; Hey and Purgathofer 2002 also correct it by the geometry). A disc without
// a radius has no probes.
fn covered(position: vec3f, normal: vec3f, radius: f32, lane: u32) -> Covered {
    let bits = bitcast<vec3u>(position);
    let rotation = uniform_from_bits(hash3(bits.z, bits.y, bits.x));
    let disc = ProbedDisc(position, normal, basis(normal), radius, rotation);
    let hits = trace_probes(disc, lane);
    @if(!negative_photons) let walls = without_passed_walls(hits.walls, hits.stopped, disc);
    if radius <= 0.0 { return Covered(); }
    // (n + 1) / (found + 1) is a nearly unbiased estimate of 1 over the share; n / found is not. Without those discs of
    // which no probe finds the surface, the mean over all would be too small: at alpha 0.1, by half.
    let slant = select(1.0, hits.slant / f32(max(hits.found, 1u)), hits.found > 0u);
    let area = slant * (f32(hits.found + 1u) / f32(PROBES + 1u));
    let clear = clear_distance(hits.found);
    @if(negative_photons) { return Covered(area, clear, Walls(NO_WALL, NO_WALL), hits.hidden / f32(PROBES)); }
    @else { return Covered(area, clear, walls); }
}

struct ProbeHits {
    // Probes that hit the surface, and the sum over them of its area over that of its projection onto the disc.
    found: u32,
    slant: f32,
    // Walls that stopped probes, and a bit for each of these probes.
    @if(!negative_photons) walls: Walls,
    @if(!negative_photons) stopped: u32,
    // Sum over the probes of what `hidden_surfaces` finds.
    @if(negative_photons) hidden: f32,
}

// Each probe traces from the position to a point above its sample of the disc, and from there down to the surface.
fn trace_probes(disc: ProbedDisc, lane: u32) -> ProbeHits {
    let origin = offset_origin(disc.position, disc.normal);
    // By all three coordinates: the points of a plane across an axis have one of them in common.
    let bits = bitcast<vec3u>(disc.position);
    let seed = hash3(bits.x, bits.y, bits.z);
    var hits: ProbeHits;
    @if(!negative_photons) { hits.walls = Walls(NO_WALL, NO_WALL); }
    // Whether anything stopped the probe on its way up.
    var blocked = false;
    // Both rays of a probe in one place, as lavapipe compiles each place that traces: it took twice as long with two.
    for (var i = 0u; i < 2u * PROBES; i++) {
        let probe = i >> 1u;
        let is_down = (i & 1u) != 0u;
        var ray = no_ray();
        @if(negative_photons) let traces = disc.radius > 0.0;
        @if(!negative_photons) let traces = disc.radius > 0.0 && !(is_down && blocked);
        if traces { ray = probe_ray(disc, probe, is_down, origin); }
        let sample = RaySample(hash1(seed + probe), 0u);
        let hit = trace_closest_together(ray, sample, lane);
        let met = hit.triangle != NO_HIT;
        if !is_down { blocked = met; }
        if !met { continue; }
        @if(negative_photons) {
            if !is_down { continue; }
            hits.hidden += hidden_surfaces(ray, hit, blocked, disc.normal, sample);
            if blocked { continue; }
        }
        let facing = normalize(hit_normal(hit));
        if is_down {
            let cosine = abs(dot(facing, disc.normal));
            if cosine * cosine >= COMPATIBLE_COSINE_SQUARED && shows_photons(hit) {
                hits.found++;
                hits.slant += 1.0 / cosine;
            }
        }
        @if(!negative_photons) {
            if !is_down {
                let towards = select(facing, -facing, dot(facing, ray.direction) > 0.0);
                let at = origin - disc.position + hit.t * ray.direction;
                hits.walls = with_wall(hits.walls, vec4f(towards, dot(towards, at) - BEHIND * disc.radius));
                hits.stopped |= 1u << probe;
            }
        }
    }
    return hits;
}

// The ray of a probe from the position (`origin`, off its surface) up to a point above its sample of the disc, as high
// as the search ellipsoid; or the ray down from there, through the ellipsoid.
fn probe_ray(disc: ProbedDisc, probe: u32, is_down: bool, origin: vec3f) -> Ray {
    // Half the height of the ellipsoid at its centre, and at this sample.
    let height = disc.radius * inverseSqrt(1.0 + OFFSET_WEIGHT);
    let reach = height * sqrt(1.0 - part_of_disc(probe));
    let above = disc.position + probe_on_disc(disc, probe) + height * disc.normal;
    if !is_down { return Ray(origin, 0.0, above - origin, 1.0); }
    return Ray(above, height - reach, -disc.normal, height + reach);
}

// The walls less those whose planes a probe has passed: such a wall has an end, beyond which the position sees photons.
@if(!negative_photons)
fn without_passed_walls(all: Walls, stopped: u32, disc: ProbedDisc) -> Walls {
    var walls = all;
    for (var probe = 0u; probe < PROBES; probe++) {
        let across = probe_on_disc(disc, probe);
        if ((stopped >> probe) & 1u) == 0u {
            if is_behind(walls.first, across) { walls.first = NO_WALL; }
            if is_behind(walls.second, across) { walls.second = NO_WALL; }
        }
    }
    return walls;
}

// The distance of the nearest edge, in radii, by the number of probes that hit the surface. A straight edge at a
// distance of x radii cuts off at most 0.5 (1 - x)^1.6 of the disc; several edges together cut off more. One extra
// probe counts as missing, for edges between the probes.
fn clear_distance(found: u32) -> f32 {
    let missing = f32(PROBES - found + 1u) / f32(PROBES);
    return select(max(1.0 - pow(2.0 * missing, 0.63), 0.0), MAX_CLEAR, found == PROBES);
}

// The area of the hidden surfaces that a probe hits, over the area of the probe: the surfaces behind the visible one,
// or all of them where the probe is blocked. Only surfaces that store photons count.
@if(negative_photons)
fn hidden_surfaces(probe: Ray, first: Hit, blocked: bool, normal: vec3f, sample: RaySample) -> f32 {
    var ray = probe;
    var hit = first;
    var is_hidden = blocked;
    var area = 0.0;
    while hit.triangle != NO_HIT && !traversal_overrun {
        let found = surface_at(hit, ray);
        let cosine = abs(dot(found.triangle_normal, normal));
        let compatible = cosine * cosine >= COMPATIBLE_COSINE_SQUARED;
        if is_hidden && compatible && stores_photons(hit) { area += 1.0 / cosine; }
        is_hidden = true;
        ray = ray_behind(found, ray.direction, ray.t_max - hit.t);
        hit = trace_closest(ray, sample);
    }
    return area;
}
