// fine_cells: the classes of fine cells (lib/fine_cell) by their photons, after a batch of samples. In: the table. Out:
// the class of each of its cells that is not divided yet. Paper, "Extending the photon map": the three cases, with the
// shadow rays of earlier samples as photons.

import package::kit::group_index;
import package::lib::constants::{CLASS_BOUNDARY, CLASS_LIT, CLASS_MASK, CLASS_SHADOWED, CLASS_UNKNOWN};
import package::lib::fine_cell::{
    FINE_CELL_ABSENT, FineCellKey, MANY_PHOTONS, MOSTLY_LIT, cell_axis, cell_level, find_cell, fine_cell_tags,
    fine_cell_view, fine_cells, is_divided
};

// From this multiple of k on, the photons of a part of a divided cell count as many. That is four times as many as
// decide its class. If n photons are all of one kind, the share of the other kind is probably not much above 1 / n. So
// with many photons, classes are wrong a quarter as often.
const MANY = 2u;

// Photons that decide a cell (k).
override nearest: u32;

@compute @workgroup_size(64)
fn classify_fine_cells(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = group_index(group, groups) * 64u + lane;
    if i >= atomicLoad(&fine_cell_tags[fine_cell_view.mask + 1u]) { return; }
    let entry = fine_cells[i].listed;
    let tag = atomicLoad(&fine_cell_tags[entry]);
    if is_divided(tag & CLASS_MASK) { return; }
    atomicStore(&fine_cell_tags[entry], (tag & ~CLASS_MASK) | code_of_cell(entry));
}

// Illumination and shadow photons of a cell.
fn photons_of(entry: u32) -> vec2u {
    return vec2u(atomicLoad(&fine_cells[entry].illumination), atomicLoad(&fine_cells[entry].shadow));
}

// The code of a cell, from its photons and those of the eight cells around it on its surface. Neighbours in the
// direction of its depth are left out: few surfaces continue there.
fn code_of_cell(entry: u32) -> u32 {
    var photons = photons_of(entry);
    if all(photons > vec2u(0u)) { return divided(photons); }
    let index = fine_cells[entry].index;
    let kind = fine_cells[entry].kind;
    for (var i = 0; i < 9; i++) {
        if i == 4 { continue; }
        let neighbour = find_cell(FineCellKey(index + step_across(cell_axis(kind), i), kind));
        if neighbour.entry == FINE_CELL_ABSENT { continue; }
        photons += photons_of(neighbour.entry);
        if all(photons > vec2u(0u)) { return divided(photons); }
    }
    // Parts of divided cells with so few photons have 16 times the minimum probability of audits (NEAR_AUDITS in
    // src/passes/classify.rs), so mistakes there cost less.
    let enough = select(nearest, (nearest + 1u) / 2u, cell_level(kind) > 0u);
    if photons.x + photons.y < enough { return CLASS_UNKNOWN; }
    let class_ = select(CLASS_SHADOWED, CLASS_LIT, photons.y == 0u);
    let many = cell_level(kind) > 0u && photons.x + photons.y >= MANY * nearest;
    return select(class_, class_ + MANY_PHOTONS, many);
}

fn divided(photons: vec2u) -> u32 {
    return select(CLASS_BOUNDARY, MOSTLY_LIT, photons.x >= photons.y);
}

// To the i-th of the 3 x 3 cells at right angles to the axis.
fn step_across(axis: u32, i: i32) -> vec3i {
    let across = vec2i(i % 3, i / 3) - 1;
    if axis == 0u { return vec3i(0, across); }
    if axis == 1u { return vec3i(across.x, 0, across.y); }
    return vec3i(across, 0);
}
