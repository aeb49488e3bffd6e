// The environment: an equirectangular panorama infinitely far away. A patch is the rectangle between the centres of
// four texels; radiance is bilinear over it. Importance sampling picks a cell of whole patches by its radiance, then a
// uniform direction within the cell. src/gpu_scene/environment.rs makes the tables.

import package::lib::constants::ENVIRONMENT_HEADER;
import package::lib::math::{PI, angle_of, circle_point, safe_sqrt};
@if(texture_loads) import package::lib::table::table_texel;

// First a header: size in texels, patches along a side of a cell, rotation in turns; numbers of columns and rows of
// cells, strength. Then for each row of cells: cumulative probability; height below the nearer pole at its beginning,
// and the change of height to its end; one over the solid angle of one column of patches, negative where the nearer
// pole is the nadir. Then for each cell, four to a texel: cumulative probability within the row. Then for each texel of
// the panorama: radiance.
@if(texture_loads) @group(1) @binding(21) var environment_texels: texture_storage_2d<rgba32float, read>;
@if(!texture_loads) @group(1) @binding(21) var<storage, read> environment_texels: array<vec4f>;

fn load_environment_texel(i: u32) -> vec4f {
    @if(texture_loads) { return textureLoad(environment_texels, table_texel(i)); }
    @else { return environment_texels[i]; }
}

struct EnvironmentShape {
    size: vec2u,
    step: u32,
    turn: f32,
    cells: vec2u,
    strength: f32,
}

fn environment_shape() -> EnvironmentShape {
    let a = load_environment_texel(0u);
    let b = load_environment_texel(1u);
    return EnvironmentShape(vec2u(a.xy), u32(a.z), a.w, vec2u(b.xy), b.z);
}

// Cumulative probability of a cell within its row.
fn environment_cell(shape: EnvironmentShape, row: u32, column: u32) -> f32 {
    let i = row * shape.cells.x + column;
    return load_environment_texel(ENVIRONMENT_HEADER + shape.cells.y + (i >> 2u))[i & 3u];
}

// Patches along the width of a column of cells.
fn environment_cell_width(shape: EnvironmentShape, column: u32) -> f32 {
    return f32(min(shape.step, shape.size.x - column * shape.step));
}

// Probability density by solid angle, within a cell.
fn environment_density(shape: EnvironmentShape, row: u32, column: u32) -> f32 {
    let own = load_environment_texel(ENVIRONMENT_HEADER + row);
    var of_row = own.x;
    if row > 0u { of_row -= load_environment_texel(ENVIRONMENT_HEADER + row - 1u).x; }
    var of_cell = environment_cell(shape, row, column);
    if column > 0u { of_cell -= environment_cell(shape, row, column - 1u); }
    return of_row * of_cell * abs(own.w) / environment_cell_width(shape, column);
}

// The patch that contains a direction, and the position within it, 0 to 1.
struct EnvironmentPatch {
    column: u32,
    row: u32,
    within: vec2f,
}

fn environment_patch(shape: EnvironmentShape, direction: vec3f) -> EnvironmentPatch {
    // At the poles any azimuth will do, but the angle of a null vector is undefined. Devices may take subnormals for 0.
    let across = abs(direction.xz);
    let azimuth = angle_of(across.y, select(direction.x, 1.0, max(across.x, across.y) < 1e-30));
    let u = fract(select(azimuth, -azimuth, direction.z < 0.0) * (0.5 / PI) + 0.5 + shape.turn);
    // The arc cosine would lose precision at the poles.
    let v = angle_of(length(direction.xz), direction.y) / PI;
    // A patch begins at the centre of a texel; those of the first row begin at the zenith.
    let x = u * f32(shape.size.x) - 0.5;
    let y = v * f32(shape.size.y) + 0.5;
    let column = i32(floor(x));
    let row = min(u32(y), shape.size.y);
    return EnvironmentPatch(select(u32(column), shape.size.x - 1u, column < 0), row, vec2f(x - floor(x), y - f32(row)));
}

fn environment_texel(shape: EnvironmentShape, column: u32, row: u32) -> vec3f {
    let cells = shape.cells.x * shape.cells.y;
    let base = ENVIRONMENT_HEADER + shape.cells.y + ((cells + 3u) >> 2u);
    return load_environment_texel(base + row * shape.size.x + column).xyz;
}

fn environment_radiance_at(shape: EnvironmentShape, patch_: EnvironmentPatch) -> vec3f {
    let right = select(patch_.column + 1u, 0u, patch_.column + 1u == shape.size.x);
    let upper = max(patch_.row, 1u) - 1u;
    let lower = min(patch_.row, shape.size.y - 1u);
    let upper_left = environment_texel(shape, patch_.column, upper);
    let above = mix(upper_left, environment_texel(shape, right, upper), patch_.within.x);
    let lower_left = environment_texel(shape, patch_.column, lower);
    let below = mix(lower_left, environment_texel(shape, right, lower), patch_.within.x);
    return shape.strength * mix(above, below, patch_.within.y);
}

// Radiance from a direction.
fn environment_radiance(direction: vec3f) -> vec3f {
    let shape = environment_shape();
    return environment_radiance_at(shape, environment_patch(shape, direction));
}

// Radiance from a direction, and the density by solid angle with which `environment_sample` samples it.
fn environment_met(direction: vec3f) -> vec4f {
    let shape = environment_shape();
    let patch_ = environment_patch(shape, direction);
    let pdf = environment_density(shape, patch_.row / shape.step, patch_.column / shape.step);
    return vec4f(environment_radiance_at(shape, patch_), pdf);
}

struct EnvironmentSample {
    // Unit, towards the environment.
    direction: vec3f,
    // Density by solid angle.
    pdf: f32,
    radiance: vec3f,
}

fn environment_sample(u: vec2f) -> EnvironmentSample {
    let shape = environment_shape();
    // Finds the first row, and within it the first column, whose cumulative probability exceeds the random number. The
    // remainder is uniform again.
    var row = 0u;
    var last = shape.cells.y - 1u;
    while row < last {
        let middle = (row + last) / 2u;
        if load_environment_texel(ENVIRONMENT_HEADER + middle).x > u.x { last = middle; } else { row = middle + 1u; }
    }
    var column = 0u;
    last = shape.cells.x - 1u;
    while column < last {
        let middle = (column + last) / 2u;
        if environment_cell(shape, row, middle) > u.y { last = middle; } else { column = middle + 1u; }
    }
    let own = load_environment_texel(ENVIRONMENT_HEADER + row);
    var before = vec2f(0.0);
    if row > 0u { before.y = load_environment_texel(ENVIRONMENT_HEADER + row - 1u).x; }
    if column > 0u { before.x = environment_cell(shape, row, column - 1u); }
    let share = vec2f(environment_cell(shape, row, column), own.x) - before;
    let left = clamp((u.yx - before) / share, vec2f(0.0), vec2f(1.0));

    let width = environment_cell_width(shape, column);
    let along = (f32(column * shape.step) + 0.5 + left.x * width) / f32(shape.size.x);
    let towards = circle_point(along - 0.5 - shape.turn);
    let below = own.y + left.y * own.z;
    let across = safe_sqrt(below * (2.0 - below));
    let direction = vec3f(across * towards.x, select(1.0 - below, below - 1.0, own.w < 0.0), across * towards.y);
    let pdf = share.x * share.y * abs(own.w) / width;
    return EnvironmentSample(direction, pdf, environment_radiance_at(shape, environment_patch(shape, direction)));
}
