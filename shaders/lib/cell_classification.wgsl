// The class of all points of a surface in a cell, from bounds of the distances between any of them and each photon
// (paper, "Extending the photon map": the three cases, here for whole cells). In: the surface's slab and cone in the
// cell, and the sorted photons, in normalised space. Out: a cell class in two words (lib/cell_class), 0 where nothing
// is certain.
//
// Each photon has bounds of its distance from the points. Once k photons are surely within a distance of all points,
// the nearest k of every point are within it. If no shadow photon may be that near, the whole cell is lit; if no
// illumination photon may be, it is shadowed; if one of each kind is surely among the nearest k, it is a boundary.

import package::lib::cell_class::{CellClass, VISIBILITY_STEPS, decode_cell_class, encode_cell_class};
import package::lib::constants::{CLASS_BOUNDARY, CLASS_DARK, CLASS_LIT, CLASS_SHADOWED, CLASS_UNKNOWN};
import package::lib::grid::{
    COMPATIBLE_COSINE_SQUARED, FAR, FIRST_REACH, GridShape, MAX_REACH, OFFSET_WEIGHT, SearchBall, cell_centre,
    expected_reach, load_photon, nearest, row_photons, rows_about
};
import package::lib::math::{oct_decode7, oct_within7, safe_sqrt};
import package::lib::photon::photon_is_shadow;

// Visit budget for the class of a cell's own photons: photons and rows of cells, as a multiple of k. On an even surface
// five times k are enough; where many photons are of other surfaces (foliage), a class costs more than it saves.
const VISITS_PER_NEAREST = 24u;
// Maximum budget, and the budget of a requested cell, whose class many points share. On lavapipe the eight lanes of a
// vector share 65,535 iterations: in nested loops of different lengths each lane waits for all others, and which cells
// share a vector is random. This is seven eighths of a lane's share.
const MAX_VISITS = 7168u;

// Marks a decided cell that has photons of the other kind within reach, but not among the nearest k: a boundary is
// near. One step of the packed visibility.
const NEAR_STEP = 1.0 / VISIBILITY_STEPS;

// Margin of a cone of normals for roundings, of its cosines and of |n - normal|. A cosine of two unit vectors is off by
// up to 5e-7: each length by 2e-7, and the sum of products by 1e-7. At the narrowest cone, one SPREAD_UNIT, whose sine
// is 0.038, that is an angle of 1.3e-5. The margin is seven times that, and far less than a step of the cone.
const CONE_MARGIN = 1e-4;

// Points of one surface in a cell: offsets from the cell's centre along the code's normal are between `low` and `high`,
// cosines to that normal at least `cos_spread`.
struct Cluster {
    light: u32,
    cell: vec3u,
    normal_code: u32,
    low: f32,
    high: f32,
    cos_spread: f32,
}

// Common bounds of the points of a cluster, from which bounds of their distances follow.
struct Extent {
    normal: vec3f,
    centre: vec3f,
    // Box around the points, from the centre.
    low: vec3f,
    high: vec3f,
    // Slab around the points, from the centre along the normal.
    offset: f32,
    thickness: f32,
    // |n - normal| of any normal n in the cone.
    tilt: f32,
    // Squared cosines to the normal: of photons that count for all normals in the cone, and for some.
    sure_cosine_squared: f32,
    maybe_cosine_squared: f32,
}

// The cell class to be found, rounded as its packed form is. It has the bounds of its points, but no class yet.
fn packed_cluster(grid: GridShape, cluster: Cluster) -> CellClass {
    let cell = grid.cell;
    let normal = oct_decode7(cluster.normal_code);
    // A margin of 0.03 radians for the points between the photons. The error of the octahedral code itself is at most
    // 0.034, and less than 0.027 for 99 of 100 normals.
    let sine = safe_sqrt(1.0 - cluster.cos_spread * cluster.cos_spread);
    let cos_spread = cluster.cos_spread * 0.99955 - sine * 0.03;
    let offset = 0.5 * (cluster.low + cluster.high);
    // Room for the points between and beyond the photons. The class holds in the whole slab however thick it is, but a
    // thick slab is decided less often, and a point outside of it requests a class.
    let thickness = 0.6 * (cluster.high - cluster.low) + 0.02 * cell;
    let class_ = CellClass(CLASS_DARK, normal, cos_spread, offset, thickness, 0.0, 0.0);
    return decode_cell_class(encode_cell_class(class_, cluster.normal_code, grid.inverse_cell), cell);
}

fn extent_of(grid: GridShape, cluster: Cluster, class_: CellClass) -> Extent {
    let normal = oct_decode7(cluster.normal_code);
    // Rounding may put a point this far outside its cell.
    let half_size = 0.5005 * grid.cell;
    let sin_spread = safe_sqrt(1.0 - class_.cos_spread * class_.cos_spread);
    // Cosines of 45 degrees less the spread, and of 45 degrees and the spread; both angles are below 90.
    let half_angle = sqrt(COMPATIBLE_COSINE_SQUARED);
    let cos_sure = min(half_angle * (class_.cos_spread + sin_spread) + CONE_MARGIN, 1.0);
    let cos_maybe = half_angle * (class_.cos_spread - sin_spread) - CONE_MARGIN;
    var low = vec3f(-half_size);
    var high = vec3f(half_size);
    @if(!paper_counting) {
        let others = half_size * (abs(normal.yzx) + abs(normal.zxy));
        let slab_low = (class_.offset - class_.thickness) - others;
        let slab_high = (class_.offset + class_.thickness) + others;
        // Along an axis in the surface's plane, the slab bounds nothing.
        let scale = 1.0 / max(abs(normal), vec3f(1e-6));
        let positive = normal >= vec3f(0.0);
        low = max(low, select(-slab_high, slab_low, positive) * scale);
        high = min(high, select(-slab_low, slab_high, positive) * scale);
    }
    return Extent(
        normal,
        cell_centre(grid, cluster.cell),
        low,
        high,
        class_.offset,
        class_.thickness,
        safe_sqrt(2.0 - 2.0 * class_.cos_spread) + CONE_MARGIN,
        cos_sure * cos_sure,
        cos_maybe * cos_maybe,
    );
}

// Squared distances of a photon to the points: no less than `lower`, no more than `upper`. `lower` is FAR if the photon
// counts for none of them, `upper` if it may not count for all.
struct DistanceBounds {
    lower: f32,
    upper: f32,
}

fn distance_bounds(photon: vec4u, extent: Extent) -> DistanceBounds {
    var counts_surely = true;
    var may_count = true;
    @if(!paper_counting) {
        counts_surely = oct_within7(photon.w, extent.normal, extent.sure_cosine_squared);
        may_count = oct_within7(photon.w, extent.normal, extent.maybe_cosine_squared);
    }
    let from_centre = bitcast<vec3f>(photon.xyz) - extent.centre;
    let min_offset = max(max(from_centre - extent.high, extent.low - from_centre), vec3f(0.0));
    let max_offset = max(from_centre - extent.low, extent.high - from_centre);
    let max_squared = dot(max_offset, max_offset);
    let along = abs(dot(from_centre, extent.normal) - extent.offset);
    let slack = extent.thickness + extent.tilt * sqrt(max_squared);
    let min_along = max(along - slack, 0.0);
    let max_along = along + slack;
    // Margins for the rounding of both distances, this one's and the query's. Coordinates of up to 1 are rounded by
    // 6e-8, which is less than 1.5e-4 of any distance above 4e-4; cells are wider, and k photons seldom nearer.
    return DistanceBounds(
        select(FAR, 0.9997 * (dot(min_offset, min_offset) + OFFSET_WEIGHT * min_along * min_along), may_count),
        select(FAR, 1.0003 * (max_squared + OFFSET_WEIGHT * max_along * max_along), counts_surely),
    );
}

// The squared distances that counts are for: the limit and, where `counting`, its eighths.
struct Marks {
    limit: f32,
    counting: bool,
    a: vec4f,
    b: vec4f,
}

// Counts of photons that are within a distance of all points of a cluster (sure), and of some (maybe).
struct Counts {
    // Within the limit.
    sure: u32,
    maybe: u32,
    sure_lit: u32,
    // Within the eighths of the limit.
    sure_a: vec4u,
    sure_b: vec4u,
    maybe_a: vec4u,
    maybe_b: vec4u,
    // Squared distances: of the nearest photon that may count, and of the nearest that surely does, at most.
    nearest_maybe_lit: f32,
    nearest_maybe_shadow: f32,
    nearest_sure_lit: f32,
    nearest_sure_shadow: f32,
    // The visit budget was enough.
    complete: bool,
}

fn no_counts() -> Counts {
    let none = vec4u(0u);
    return Counts(0u, 0u, 0u, none, none, none, none, FAR, FAR, FAR, FAR, false);
}

var<private> visits_left: u32;

// Visits the photons within the reach of the ball.
fn count_photons(grid: GridShape, light: u32, extent: Extent, ball: SearchBall, marks: Marks) -> Counts {
    var counts = no_counts();
    let rows = rows_about(grid, ball);
    for (var z = rows.y; z <= rows.w; z++) {
        for (var y = rows.x; y <= rows.z; y++) {
            let row = row_photons(grid, light, vec2i(y, z), ball);
            let visits = row.y - row.x + 1u;
            if visits > visits_left { return counts; }
            visits_left -= visits;
            for (var p = row.x; p < row.y; p++) {
                let photon = load_photon(p);
                let bounds = distance_bounds(photon, extent);
                let shadow = photon_is_shadow(photon.w);
                let is_sure = bounds.upper <= marks.limit;
                counts.sure += u32(is_sure);
                counts.maybe += u32(bounds.lower <= marks.limit);
                counts.sure_lit += u32(is_sure && !shadow);
                counts.nearest_maybe_lit = min(counts.nearest_maybe_lit, select(bounds.lower, FAR, shadow));
                counts.nearest_maybe_shadow = min(counts.nearest_maybe_shadow, select(FAR, bounds.lower, shadow));
                if marks.counting {
                    counts.sure_a += vec4u(vec4f(bounds.upper) <= marks.a);
                    counts.sure_b += vec4u(vec4f(bounds.upper) <= marks.b);
                    counts.maybe_a += vec4u(vec4f(bounds.lower) <= marks.a);
                    counts.maybe_b += vec4u(vec4f(bounds.lower) <= marks.b);
                    counts.nearest_sure_lit = min(counts.nearest_sure_lit, select(bounds.upper, FAR, shadow));
                    counts.nearest_sure_shadow = min(counts.nearest_sure_shadow, select(FAR, bounds.upper, shadow));
                }
            }
        }
    }
    counts.complete = true;
    return counts;
}

// A squared distance within which every point has its nearest k.
fn bound_of(counts: Counts, marks: Marks) -> f32 {
    if !marks.counting { return marks.limit; }
    // The first mark with enough photons below it.
    let below = vec4u(counts.sure_a < vec4u(nearest)) + vec4u(counts.sure_b < vec4u(nearest));
    return marks.limit * 0.125 * f32(below.x + below.y + below.z + below.w + 1u);
}

// Whether both kinds are surely among the nearest k of every point. Take the nearest photon of each kind that surely
// counts: both are, if no more than k photons can be as near as the farther of these two.
fn both_are_near(counts: Counts, marks: Marks) -> bool {
    let both = max(counts.nearest_sure_lit, counts.nearest_sure_shadow);
    if both > marks.limit { return false; }
    let closer = vec4u(marks.a < vec4f(both)) + vec4u(marks.b < vec4f(both));
    let mark = closer.x + closer.y + closer.z + closer.w;
    let rivals = select(counts.maybe_b[mark & 3u], counts.maybe_a[mark & 3u], mark < 4u);
    return rivals <= nearest;
}

// The first reach of a search, in cells, estimated from the photons in the cluster's cell. Distances are to the
// farthest point of the cell's surface, which is half a diagonal, 0.7 cells, from the middle of the surface.
fn first_reach(grid: GridShape, cluster: Cluster) -> f32 {
    let reach = expected_reach(grid, cluster.light, cluster.cell, FIRST_REACH) + 0.7;
    return clamp(reach, 1.0, MAX_REACH);
}

// The next reach if `sure`, fewer than k, photons are within `reach` of all points: by the density so far, so that
// 1.2 k are expected. Few photons say little about the density, so the reach grows by a quarter at least, and doubles
// at most.
fn wider_reach(reach: f32, sure: u32) -> f32 {
    let growth = sqrt(f32(nearest) / f32(max(sure, 1u))) * 1.1;
    return min(reach * clamp(growth, 1.25, 2.0), MAX_REACH);
}

// The same marks with their eighths, for a search that counts the photons within each.
fn with_eighths(marks: Marks) -> Marks {
    let a = marks.limit * vec4f(0.125, 0.25, 0.375, 0.5);
    let b = marks.limit * vec4f(0.625, 0.75, 0.875, 1.0);
    return Marks(marks.limit, true, a, b);
}

// The class of all points if each has its nearest k within `bound`; dark where the counts do not tell.
fn class_within(counts: Counts, marks: Marks, bound: f32) -> u32 {
    if counts.nearest_maybe_shadow > bound { return CLASS_LIT; }
    if counts.nearest_maybe_lit > bound { return CLASS_SHADOWED; }
    if marks.counting && both_are_near(counts, marks) { return CLASS_BOUNDARY; }
    return CLASS_DARK;
}

// The packed class of a cluster of points; `visits` is the budget of photons and rows of cells.
fn classify_cluster(grid: GridShape, cluster: Cluster, visits: u32) -> vec2u {
    visits_left = visits;
    let cell = grid.cell;
    var result = packed_cluster(grid, cluster);
    let extent = extent_of(grid, cluster, result);
    // Margins for the rounding of cells' borders, as in lib/photon_search.
    let low = (extent.centre + extent.low - grid.origin) * grid.inverse_cell - 1e-3;
    let high = (extent.centre + extent.high - grid.origin) * grid.inverse_cell + 1e-3;

    // The reach grows until it holds k photons. If both kinds are among them, a second search counts them by eighths
    // of the squared reach, which are about equal shares of a surface.
    var reach = first_reach(grid, cluster);
    var marks = Marks(0.0, false, vec4f(0.0), vec4f(0.0));
    loop {
        marks.limit = reach * reach * cell * cell;
        let ball = SearchBall(low, high, reach + 2e-3, extent.normal, extent.tilt);
        let counts = count_photons(grid, cluster.light, extent, ball, marks);
        if !counts.complete { return vec2u(0u); }
        if counts.sure < nearest {
            if reach >= MAX_REACH {
                if counts.maybe >= nearest { return vec2u(0u); }
                result.class_ = CLASS_UNKNOWN;
                result.reach = MAX_REACH * cell;
                break;
            }
            reach = wider_reach(reach, counts.sure);
            continue;
        }
        let bound = bound_of(counts, marks);
        result.class_ = class_within(counts, marks, bound);
        if result.class_ == CLASS_DARK && !marks.counting {
            marks = with_eighths(marks);
            continue;
        }
        result.reach = 1.0001 * sqrt(bound);
        result.visibility = f32(counts.sure_lit) / f32(counts.sure);
        // Both kinds were in reach if photons were counted by eighths: a boundary is near.
        let near = marks.counting;
        if result.class_ == CLASS_LIT { result.visibility = select(1.0, 1.0 - NEAR_STEP, near); }
        if result.class_ == CLASS_SHADOWED { result.visibility = select(0.0, NEAR_STEP, near); }
        break;
    }
    return encode_cell_class(result, cluster.normal_code, grid.inverse_cell);
}
