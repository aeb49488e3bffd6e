// The class of a point and a light by the exact search for the nearest k photons (paper, "Extending the photon map").
// In: position and normal in normalised space, and the distance within which the nearest k are known to be, or 0. Out:
// class words.
//
// Only which kinds occur among the k matters for the class, so no list of k photons is kept. `class_by_search` widens a
// disc until it holds k photons. `class_by_counts` then narrows the squared distance of the k-th: it counts the photons
// within eight marks, and divides the interval between two marks again, until the k-th is alone in it.

import package::lib::class_word::class_word;
import package::lib::constants::{CLASS_BOUNDARY, CLASS_LIT, CLASS_SHADOWED, CLASS_UNKNOWN};
import package::lib::grid::{
    FAR, FIRST_REACH, GridShape, MAX_REACH, cell_of, counted_distance, expected_reach, load_photon, nearest, point_ball,
    row_photons, rows_about
};
import package::lib::photon::{photon_has_weight, photon_is_shadow, photon_weight_sixteenths};

// Visit budget of a query: the number of photons and rows of cells that it may visit, as a multiple of k within bounds.
// A point that needs more is unknown. Where so many photons nearby belong to other surfaces (foliage), the search costs
// more than the shadow rays that it could save. The minimum is the budget of k = 50, as in the paper's box.
const VISITS_PER_NEAREST = 128u;
const MIN_VISITS = 6400u;
// On lavapipe the eight lanes of a vector share 65,535 iterations: while one visits a long row, all others wait. This
// is an eighth of them, less 600 for the loops around the rows. Other devices have no such limit, and their budget only
// bounds the time.
@if(texture_loads) const MAX_VISITS = 7591u;
@if(!texture_loads) const MAX_VISITS = 48000u;

var<private> visits_left: u32;

fn visit_budget() -> u32 {
    // Without the normals a search covers a ball, not a disc. This counting is there for comparison, not for its speed.
    @if(paper_counting) { return MAX_VISITS; }
    @if(!paper_counting) { return clamp(VISITS_PER_NEAREST * nearest, MIN_VISITS, MAX_VISITS); }
}

// Maximum first reach of a search, in cells, and maximum factor by which it grows. The balls of the paper's counting
// reach other surfaces; if the reach is too large, their photons are visited again and again.
@if(paper_counting) const MAX_FIRST_REACH = 0.5 * MAX_REACH;
@if(paper_counting) const MAX_GROWTH = 1.25;
@if(!paper_counting) const MAX_FIRST_REACH = MAX_REACH;
@if(!paper_counting) const MAX_GROWTH = 2.0;

// Margins for the rounding of cells' borders: positions in cells are up to 2,048, where f32 has steps of 1.2e-4.
const REACH_FACTOR = 1.0001;
const REACH_MARGIN = 1e-3;

// Photons that a search finds within a distance.
struct Found {
    // All photons, and the illumination photons among them. Once there are k, no further rows are visited.
    all: u32,
    lit: u32,
    // The visit budget was enough.
    complete: bool,
}

// Counts the photons within the squared distance `limit`, until there are k.
fn search(grid: GridShape, light: u32, position: vec3f, normal: vec3f, limit: f32) -> Found {
    var result = Found(0u, 0u, false);
    let units = (position - grid.origin) * grid.inverse_cell;
    let ball = point_ball(units, sqrt(limit) * grid.inverse_cell * REACH_FACTOR + REACH_MARGIN, normal);
    let rows = rows_about(grid, ball);
    for (var z = rows.y; z <= rows.w; z++) {
        for (var y = rows.x; y <= rows.z; y++) {
            let row = row_photons(grid, light, vec2i(y, z), ball);
            let visits = row.y - row.x + 1u;
            if visits > visits_left { return result; }
            visits_left -= visits;
            for (var p = row.x; p < row.y; p++) {
                let photon = load_photon(p);
                let within = counted_distance(photon, position, normal) <= limit;
                result.all += u32(within);
                result.lit += u32(within && !photon_is_shadow(photon.w));
            }
            if result.all >= nearest {
                result.complete = true;
                return result;
            }
        }
    }
    result.complete = true;
    return result;
}

// The class word of a point with its exact n_i and n_s. The nearest k, and perhaps more, are within `known_reach` where
// that is not 0.
fn class_by_search(grid: GridShape, light: u32, position: vec3f, normal: vec3f, known_reach: f32) -> u32 {
    visits_left = visit_budget();
    let farthest = MAX_REACH * grid.cell;
    var reach = known_reach;
    if reach == 0.0 {
        // Not below a tenth of a cell, where a single cell holds very many photons.
        reach = grid.cell * max(expected_reach(grid, light, cell_of(grid, position), FIRST_REACH), 0.1);
    }
    reach = min(reach, MAX_FIRST_REACH * grid.cell);
    // The result of the previous search, and its reach.
    var closer = Found(0u, 0u, true);
    var closer_reach = 0.0;
    loop {
        let found = search(grid, light, position, normal, reach * reach);
        if !found.complete { return class_word(CLASS_UNKNOWN, 0u, 0u, 0.5); }
        if found.all >= nearest { break; }
        if reach >= farthest { return class_word(CLASS_UNKNOWN, found.lit, found.all - found.lit, 0.5); }
        // By the density so far, so that the disc is expected to hold 1.3 k photons. Few photons say little about the
        // density, so the factor is bounded.
        let more = 1.15 * sqrt(f32(nearest) / f32(max(found.all, 1u)));
        closer = found;
        closer_reach = reach;
        reach = min(reach * clamp(more, 1.25, MAX_GROWTH), farthest);
    }
    let floor_ = closer_reach * closer_reach;
    // A margin for rounding: the photons that ended the search are within the last mark.
    let marks = Marks(floor_, 1.0001 * reach * reach - floor_);
    return class_by_counts(grid, light, position, normal, marks, closer);
}

// Counts of photons within eight marks of squared distance: `floor_` plus eighths of `span`.
struct Tally {
    // All photons within marks 0-3 and 4-7, and illumination photons of them.
    all_a: vec4u,
    all_b: vec4u,
    lit_a: vec4u,
    lit_b: vec4u,
    // Sixteenths of hits that shadow photons represent beyond one each: within the last mark, within the floor.
    excess: u32,
    excess_below: u32,
    // The visit budget was enough.
    complete: bool,
}

// The photons within a mark.
fn within_mark(counts: Tally, mark: u32) -> Found {
    let i = mark & 3u;
    let all = select(counts.all_b[i], counts.all_a[i], mark < 4u);
    let lit = select(counts.lit_b[i], counts.lit_a[i], mark < 4u);
    return Found(all, lit, true);
}

// The first mark with k photons or more within it.
fn mark_of_nearest(counts: Tally) -> u32 {
    let fewer = vec4u(counts.all_a < vec4u(nearest)) + vec4u(counts.all_b < vec4u(nearest));
    return fewer.x + fewer.y + fewer.z + fewer.w;
}

// The marks of a tally: squared distances.
struct Marks {
    floor_: f32,
    span: f32,
}

// Visits the photons within `reach` of the point.
fn tally(grid: GridShape, light: u32, position: vec3f, normal: vec3f, reach: f32, marks: Marks) -> Tally {
    let marks_a = marks.floor_ + marks.span * vec4f(0.125, 0.25, 0.375, 0.5);
    let marks_b = marks.floor_ + marks.span * vec4f(0.625, 0.75, 0.875, 1.0);
    var result = Tally(vec4u(0u), vec4u(0u), vec4u(0u), vec4u(0u), 0u, 0u, false);
    let units = (position - grid.origin) * grid.inverse_cell;
    let ball = point_ball(units, reach * grid.inverse_cell * REACH_FACTOR + REACH_MARGIN, normal);
    let rows = rows_about(grid, ball);
    for (var z = rows.y; z <= rows.w; z++) {
        for (var y = rows.x; y <= rows.z; y++) {
            let row = row_photons(grid, light, vec2i(y, z), ball);
            let visits = row.y - row.x + 1u;
            if visits > visits_left { return result; }
            visits_left -= visits;
            for (var p = row.x; p < row.y; p++) {
                let photon = load_photon(p);
                let d = counted_distance(photon, position, normal);
                let d_lit = select(d, FAR, photon_is_shadow(photon.w));
                result.all_a += vec4u(vec4f(d) <= marks_a);
                result.all_b += vec4u(vec4f(d) <= marks_b);
                result.lit_a += vec4u(vec4f(d_lit) <= marks_a);
                result.lit_b += vec4u(vec4f(d_lit) <= marks_b);
                if photon_has_weight(photon.w) && d <= marks_b.w {
                    let excess = photon_weight_sixteenths(photon.w) - 16u;
                    result.excess += excess;
                    result.excess_below += select(0u, excess, d <= marks.floor_);
                }
            }
        }
    }
    result.complete = true;
    return result;
}

// The visibility by equation 1, for `n_i` illumination photons among the nearest k, where shadow photons may represent
// several hits each. `below` has the photons within the floor of the marks, `within` those within the last mark; the
// k-th photon is between the two, and of the shadow photons there only those that belong to the k count.
fn weighted_visibility(n_i: u32, below: Found, within: Found, counts: Tally) -> f32 {
    let shadow_below = below.all - below.lit;
    let shadow_between = (within.all - within.lit) - shadow_below;
    let taken = f32((nearest - n_i) - shadow_below) / f32(max(shadow_between, 1u));
    let excess = f32(counts.excess_below) + taken * f32(counts.excess - counts.excess_below);
    return f32(n_i) / (f32(nearest) + excess / 16.0);
}

// After this many narrowings, photons that remain between the same two marks count as tied. Each narrowing leaves an
// eighth of the interval, so 12 leave 2^-36 of it: less than a step of f32.
const MAX_NARROWINGS = 12u;

// The class word of a point with exact n_i and n_s. `closer` has the photons within the floor of the marks `first`; k
// or more are within their last mark.
fn class_by_counts(grid: GridShape, light: u32, position: vec3f, normal: vec3f, first: Marks, closer: Found) -> u32 {
    let unknown = class_word(CLASS_UNKNOWN, 0u, 0u, 0.5);
    let lit = class_word(CLASS_LIT, nearest, 0u, 1.0);
    let shadowed = class_word(CLASS_SHADOWED, 0u, nearest, 0.0);
    let reach = sqrt(first.floor_ + first.span);
    var marks = first;
    var counts = tally(grid, light, position, normal, reach, marks);
    if !counts.complete { return unknown; }

    // The k-th photon is between two marks; narrow them until it is alone between them.
    var below = closer;
    for (var narrowing = 0u; ; narrowing++) {
        let mark = mark_of_nearest(counts);
        let within = within_mark(counts, mark);
        if within.lit == within.all { return lit; }
        if within.lit == 0u { return shadowed; }
        if mark > 0u { below = within_mark(counts, mark - 1u); }
        let span = marks.span * 0.125;
        let floor_ = marks.floor_ + span * f32(mark);
        // Photons are tied if no float lies between their distances. Illumination photons then count first, so that
        // the result does not depend on the order of the photons.
        let tied = narrowing > MAX_NARROWINGS || floor_ + span * 0.125 <= floor_;
        if within.all == nearest || tied {
            var n_i = within.lit;
            if within.all > nearest { n_i = below.lit + min(within.lit - below.lit, nearest - below.all); }
            if n_i == nearest { return lit; }
            if n_i == 0u { return shadowed; }
            var visibility = f32(n_i) / f32(nearest);
            if counts.excess > 0u {
                let end = floor_ + span;
                let last = Marks(floor_, end - floor_);
                let weighted = tally(grid, light, position, normal, sqrt(end) * 1.0001, last);
                if !weighted.complete { return unknown; }
                visibility = weighted_visibility(n_i, below, within, weighted);
            }
            return class_word(CLASS_BOUNDARY, n_i, nearest - n_i, visibility);
        }
        marks = Marks(floor_, span);
        counts = tally(grid, light, position, normal, min(sqrt(floor_ + span) * 1.0001, reach), marks);
        if !counts.complete { return unknown; }
    }
    return unknown;
}
