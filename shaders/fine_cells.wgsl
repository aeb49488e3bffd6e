// fine_cells: the classes of fine cells (lib/fine_cell) by their photons, after a batch of samples. In: the table. Out:
// `class_` of each of its cells. Paper, "Extending the photon map": the three cases, with the shadow rays of earlier
// samples as photons.

import package::kit::group_index;
import package::lib::constants::{CLASS_BOUNDARY, CLASS_LIT, CLASS_SHADOWED, CLASS_UNKNOWN};
import package::lib::fine_cell::{
    FINE_CELL_ABSENT, FineCellKey, find_fine_cell, fine_cell_count, fine_cell_list, fine_cells
};

const DIVK = 18u;
// Photons that decide a cell (k).
override nearest: u32;

@compute @workgroup_size(64)
fn classify_fine_cells(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let i = group_index(group, groups) * 64u + lane;
    if i >= atomicLoad(&fine_cell_count) { return; }
    let slot = fine_cell_list[i];
    if fine_cells[slot].class_ != CLASS_BOUNDARY { fine_cells[slot].class_ = class_by_neighbours(slot); }
}

// Illumination and shadow photons of a cell.
fn photons_of(slot: u32) -> vec2u {
    return vec2u(atomicLoad(&fine_cells[slot].illumination), atomicLoad(&fine_cells[slot].shadow));
}

// The class of a cell by its photons and those of the 26 cells around it, on the same side of a surface.
fn class_by_neighbours(slot: u32) -> u32 {
    var photons = photons_of(slot);
    if all(photons > vec2u(0u)) { return CLASS_BOUNDARY; }
    let place = fine_cells[slot].place;
    let kind = fine_cells[slot].kind;
    let axis = (kind >> 12u) & 3u;
    for (var i = 0; i < 9; i++) {
        if i == 4 { continue; }
        let across = vec2i(i % 3, i / 3) - 1;
        var step = vec3i(0, across);
        if axis == 1u { step = vec3i(across.x, 0, across.y); }
        if axis == 2u { step = vec3i(across, 0); }
        let neighbour = find_fine_cell(FineCellKey(place + step, kind));
        if neighbour == FINE_CELL_ABSENT { continue; }
        photons += photons_of(neighbour);
        if all(photons > vec2u(0u)) { return CLASS_BOUNDARY; }
    }
    if photons.x + photons.y < select(nearest, DIVK, (kind >> 20u) > 0u) { return CLASS_UNKNOWN; }
    return select(CLASS_SHADOWED, CLASS_LIT, photons.y == 0u);
}
