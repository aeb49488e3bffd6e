//! Low-discrepancy sequences against the definition of a net; warps against their densities.

use glam::DVec3;
use kernel_kit::{Gpu, Resources, kernel_test};
use penumbra::internal::gpu_scene::sobol;
use penumbra::internal::kernels::compose_source;

use crate::kit::{device_features, new_kernel};
use crate::statistics::chi_square;

/// Runs an entry of the test kernel: `per_item` results for each of `count` items.
fn run(
    gpu: &Gpu,
    entry: &str,
    count: u32,
    constants: &[(&str, f64)],
    directions: &[[f32; 4]],
    per_item: usize,
) -> Vec<[f32; 4]> {
    let source = include_str!("shaders/sampling.wgsl");
    let composed = compose_source("sampling", source, &device_features(gpu)).unwrap();
    let mut all = vec![("count", f64::from(count)), ("seed", 0.0), ("warp", 0.0), ("cos_max", 0.0)];
    for (name, value) in constants {
        all.iter_mut().find(|(n, _)| n == name).unwrap().1 = *value;
    }
    let kernel = new_kernel(gpu, &composed, &all, &[]).unwrap();
    let points = gpu.poisoned::<[f32; 4]>("test/points", count as usize * per_item).unwrap();
    let directions = gpu.upload("test/directions", directions).unwrap();
    let sobol = sobol::upload(gpu).unwrap();
    let sets =
        Resources::new().with("points", &points).with("directions", &directions).with("sobol_directions", &sobol);
    let bound = kernel.bind(gpu, entry, &[&sets]).unwrap();
    let mut frame = gpu.frame("test");
    frame.run(&bound, count, &[0u32; 0]);
    frame.submit().unwrap();
    gpu.read(&points, count as usize * per_item).unwrap()
}

/// The number of elementary intervals, of all shapes 2^-a by 2^-(m-a), that do not hold exactly one of the 2^m points.
fn misplaced(points: &[[f32; 4]], x: usize, y: usize) -> usize {
    let m = points.len().ilog2();
    let cell = |v: f32, bits: u32| (f64::from(v) * f64::from(1 << bits)) as usize;
    (0..=m)
        .map(|a| {
            let mut counts = vec![0; points.len()];
            for p in points {
                counts[(cell(p[x], a) << (m - a)) + cell(p[y], m - a)] += 1;
            }
            counts.iter().filter(|c| **c != 1).count()
        })
        .sum()
}

/// The first two dimensions of both sequences are (0, 2)-sequences for every seed: each elementary interval of each
/// power of two holds one point. Independent random points would fill 63 % of the intervals.
#[kernel_test("PENUMBRA_DEVICE")]
fn elementary_intervals_hold_one_point_each(gpu: &Gpu) {
    for seed in [0u32, 1, 0x9e37_79b9, u32::MAX] {
        for entry in ["two", "four"] {
            let points = run(gpu, entry, 1 << 10, &[("seed", f64::from(seed))], &[], 1);
            assert_eq!(misplaced(&points, 0, 1), 0, "{entry}, seed {seed}");
            for point in &points {
                assert!(point.iter().all(|v| (0.0..1.0).contains(v)), "{point:?}");
                assert!(entry == "four" || point[2] == point[0], "one dimension: {point:?}");
            }
        }
    }
}

/// Each dimension is stratified, and so is each pair of dimensions in cells as small as Joe and Kuo's direction numbers
/// allow.
#[kernel_test("PENUMBRA_DEVICE")]
fn four_dimensions_are_stratified_each_and_in_pairs(gpu: &Gpu) {
    for seed in [3u32, 77] {
        let points = run(gpu, "four", 1 << 10, &[("seed", f64::from(seed))], &[], 1);
        for d in 0..4 {
            let mut seen = vec![0; points.len()];
            points.iter().for_each(|p| seen[(p[d] * 1024.0) as usize] += 1);
            assert!(seen.iter().all(|c| *c == 1), "dimension {d}, seed {seed}");
        }
        for (x, y) in [(0, 2), (0, 3), (1, 2), (1, 3), (2, 3)] {
            // A (t, m, 2)-net has 2^t points in each cell of 2^(m - t); t is at most 3 for these pairs, the sum of
            // the polynomials' degrees less one, each (Niederreiter).
            let t = 3;
            let side = 1 << ((10 - t) / 2);
            let mut counts = vec![0; side * side];
            points
                .iter()
                .for_each(|p| counts[(p[x] * side as f32) as usize * side + (p[y] * side as f32) as usize] += 1);
            assert!(counts.iter().all(|c| *c == 1024 / (side * side)), "dimensions {x} and {y}, seed {seed}");
        }
    }
}

/// Different seeds scramble a sequence to different, unrelated points.
#[kernel_test("PENUMBRA_DEVICE")]
fn seeds_give_different_points(gpu: &Gpu) {
    let a = run(gpu, "two", 256, &[("seed", 5.0)], &[], 1);
    let b = run(gpu, "two", 256, &[("seed", 6.0)], &[], 1);
    // Unrelated points of 24 bits a coordinate are equal once in 2^48.
    assert!(a.iter().zip(&b).filter(|(a, b)| a == b).count() < 3);
    // Points paired from two seeds fill the 16 x 16 cells of a square like random points.
    let a = run(gpu, "two", 1 << 14, &[("seed", 5.0)], &[], 1);
    let b = run(gpu, "two", 1 << 14, &[("seed", 6.0)], &[], 1);
    let mut counts = [0u64; 256];
    for (a, b) in a.iter().zip(&b) {
        counts[(a[0] * 16.0) as usize * 16 + (b[0] * 16.0) as usize] += 1;
    }
    chi_square(&counts, &[64.0; 256], 1).unwrap();
}

/// The count of misplaced points detects a point that was moved to another interval.
#[kernel_test("PENUMBRA_DEVICE")]
fn a_misplaced_point_is_found(gpu: &Gpu) {
    let mut points = run(gpu, "two", 1 << 10, &[], &[], 1);
    points[17][0] = 1.0 - points[17][0];
    assert!(misplaced(&points, 0, 1) > 0);
}

/// Warped points are distributed by their density: cells of equal probability hold equal counts.
#[kernel_test("PENUMBRA_DEVICE")]
fn warps_follow_their_densities(gpu: &Gpu) {
    const N: u32 = 1 << 16;
    // Each warp, with coordinates in [0, 1)^2 in which its distribution is uniform. The coordinates follow from the
    // density, not from the formula of the warp.
    type Uniform = fn([f64; 3]) -> [f64; 2];
    let warps: [(f64, f64, Uniform); 5] = [
        (0.0, 0.0, |p| [1.0 - p[2] * p[2], (p[1].atan2(p[0]) / std::f64::consts::TAU).rem_euclid(1.0)]),
        (1.0, 0.0, |p| [p[0].hypot(p[1]).powi(2), (p[1].atan2(p[0]) / std::f64::consts::TAU).rem_euclid(1.0)]),
        (2.0, 0.0, |p| [0.5 - 0.5 * p[2], (p[1].atan2(p[0]) / std::f64::consts::TAU).rem_euclid(1.0)]),
        (3.0, 0.75, |p| [(1.0 - p[2]) / 0.25, (p[1].atan2(p[0]) / std::f64::consts::TAU).rem_euclid(1.0)]),
        // A triangle: the strip at a first coordinate x is 1 - x long, and 1 - (1 - x)^2 is uniform.
        (4.0, 0.0, |p| [1.0 - (1.0 - p[0]).powi(2), p[1] / (1.0 - p[0])]),
    ];
    for (warp, cos_max, uniform) in warps {
        // Different seeds and indices give independent points: one from each of N sequences.
        let points = run(gpu, "warped", N, &[("warp", warp), ("cos_max", cos_max), ("seed", 11.0)], &[], 1);
        let cells = |fault: f64| {
            let mut counts = [0u64; 256];
            for p in &points {
                let [a, b] = uniform([p[0], p[1], p[2]].map(f64::from));
                let a = a.clamp(0.0, 1.0).powf(1.0 + fault);
                counts[((a * 16.0) as usize).min(15) * 16 + ((b * 16.0) as usize).min(15)] += 1;
            }
            counts
        };
        chi_square(&cells(0.0), &[f64::from(N) / 256.0; 256], 5).unwrap_or_else(|e| panic!("warp {warp}: {e}"));
        chi_square(&cells(0.1), &[f64::from(N) / 256.0; 256], 5).expect_err("a density that is off by a tenth");
        let length = |p: &[f32; 4]| p[..3].iter().map(|v| f64::from(*v).powi(2)).sum::<f64>();
        if warp == 0.0 || (2.0..4.0).contains(&warp) {
            // A few roundings of f32.
            assert!(points.iter().all(|p| (length(p) - 1.0).abs() < 1e-6), "warp {warp}: unit length");
        }
    }
}

/// A triangle in barycentric coordinates of a larger one.
type Cell = [DVec3; 3];

/// Solid angle of a triangle seen from the origin (Van Oosterom and Strackee 1983).
fn solid_angle([a, b, c]: [DVec3; 3]) -> f64 {
    let across = (b - a).cross(c - a);
    let lengths = [a, b, c].map(DVec3::length);
    let rest = lengths.iter().product::<f64>() + a.dot(b) * lengths[2] + a.dot(c) * lengths[1] + b.dot(c) * lengths[0];
    2.0 * a.dot(across).abs().atan2(rest)
}

/// Divides a triangle, given by its corners relative to the viewer, into cells of about the same solid angle: it halves
/// the longest edge, by angle, of the largest cell.
fn cells(corners: [DVec3; 3], count: usize) -> Vec<(Cell, f64)> {
    let point = |at: DVec3| corners[0] * at.x + corners[1] * at.y + corners[2] * at.z;
    let angle = |cell: Cell| solid_angle(cell.map(point));
    let whole = [DVec3::X, DVec3::Y, DVec3::Z];
    let mut cells = vec![(whole, angle(whole))];
    while cells.len() < count {
        let largest = (0..cells.len()).max_by(|&i, &j| cells[i].1.total_cmp(&cells[j].1)).unwrap();
        let (cell, _) = cells.swap_remove(largest);
        let span = |i: usize| {
            let (a, b) = (point(cell[i]), point(cell[(i + 1) % 3]));
            a.cross(b).length().atan2(a.dot(b))
        };
        let longest = (0..3).max_by(|&i, &j| span(i).total_cmp(&span(j))).unwrap();
        let [a, b, c] = [0, 1, 2].map(|i| cell[(longest + i) % 3]);
        let (near, far) = (1.0 / point(a).length(), 1.0 / point(b).length());
        let middle = (a * near + b * far) / (near + far);
        cells.extend([[a, middle, c], [middle, b, c]].map(|cell| (cell, angle(cell))));
    }
    cells
}

/// Whether a point in barycentric coordinates is in the cell.
fn holds(cell: &Cell, at: DVec3) -> bool {
    let volume = |a: DVec3, b: DVec3, c: DVec3| a.cross(b).dot(c);
    let [a, b, c] = *cell;
    let sides = [volume(a, b, at), volume(b, c, at), volume(c, a, at)];
    sides.iter().all(|side| *side >= 0.0) || sides.iter().all(|side| *side <= 0.0)
}

/// Points sampled by solid angle are uniform over the solid angle of a triangle of any size and shape, from any
/// position, and that solid angle is right. Points uniform over the area fail the same test.
#[kernel_test("PENUMBRA_DEVICE")]
fn triangles_are_seen_evenly(gpu: &Gpu) {
    const N: u32 = 1 << 14;
    const CELLS: usize = 64;
    let flat = |size: f64| [[0.0, 0.0, 0.0], [size, 0.0, 0.0], [0.3 * size, 0.0, size]];
    let moved = |triangle: [[f64; 3]; 3], by: [f64; 3]| triangle.map(|c| [c[0] + by[0], c[1] + by[1], c[2] + by[2]]);
    // Name, corners, position, and the relative error of the solid angle in f32. Coordinates of unit size and heights
    // over the plane have an error of 2^-24; where the solid angle is proportional to the height, its relative error is
    // that over the height.
    let cases = [
        ("an octant", [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]], [0.0, 0.0, 0.0], 1e-6),
        ("at its own size", flat(1.0), [0.4, 1.0, 0.3], 1e-6),
        ("far", flat(0.01), [0.4, 0.9, 0.3], 1e-6),
        ("tiny", flat(1e-9), [0.4, 0.9, 0.3], 1e-6),
        ("tiny, away from the origin", moved(flat(1e-4), [0.7, 0.2, -0.4]), [-0.3, 0.9, 0.1], 1e-6),
        ("near", flat(1.0), [0.43, 1e-2, 0.31], 1e-5),
        ("nearer", flat(1.0), [0.43, 1e-3, 0.31], 1e-5),
        ("touching", flat(1.0), [0.43, 1e-4, 0.31], 1e-5),
        ("over a corner", flat(1.0), [1e-3, 1e-3, 2e-3], 1e-3),
        ("over an edge", flat(1.0), [0.5, 1e-3, 0.0], 1e-3),
        ("beside it, grazing", flat(1.0), [-0.2, 1e-4, -0.1], 1e-3),
        ("a sliver", [[-1.0, 0.0, 0.0], [1.0, 0.0, 1e-4], [1.0, 0.0, 0.0]], [0.1, 0.7, 0.2], 1e-3),
        ("a sliver from near", [[-1.0, 0.0, 0.0], [1.0, 0.0, 1e-3], [1.0, 0.0, 0.0]], [0.1, 1e-2, 5e-4], 1e-3),
        ("from behind", flat(0.5), [0.2, -0.4, 0.1], 1e-6),
    ];
    let mut uneven = 0;
    for (name, corners, position, tolerance) in cases {
        let as_f32 = |v: [f64; 3]| [v[0] as f32, v[1] as f32, v[2] as f32, 0.0];
        let input = [corners[0], corners[1], corners[2], position].map(as_f32);
        let vec = |v: &[f32; 4]| DVec3::new(v[0].into(), v[1].into(), v[2].into());
        let seen = [0, 1, 2].map(|i| vec(&input[i]) - vec(&input[3]));
        let points = run(gpu, "seen", N, &[("seed", 5.0)], &input, 2);
        let exact = solid_angle(seen);
        let got = f64::from(points[0][2]);
        assert!((got - exact).abs() <= tolerance * exact, "{name}: solid angle {got}, expected {exact}");
        let cells = cells(seen, CELLS);
        let total: f64 = cells.iter().map(|(_, angle)| angle).sum();
        // As accurate as the kernel must be: both are in f64.
        assert!((total - exact).abs() <= tolerance * exact, "{name}: the cells do not add up");
        let expected: Vec<f64> = cells.iter().map(|(_, angle)| angle / total * f64::from(N)).collect();
        let counts = |which: usize| {
            let mut counts = vec![0u64; CELLS];
            for p in points.iter().skip(which).step_by(2) {
                let (b, c) = (f64::from(p[0]), f64::from(p[1]));
                let at = DVec3::new(1.0 - b - c, b, c);
                // The two coordinates that the kernel returns are rounded.
                assert!(at.min_element() > -2e-7, "{name}: {at} is outside");
                let at = at.max(DVec3::ZERO);
                let cell = cells.iter().position(|(cell, _)| holds(cell, at)).expect("cells leave no gap");
                counts[cell] += 1;
            }
            counts
        };
        let family = cases.len() as u32;
        chi_square(&counts(0), &expected, family).unwrap_or_else(|e| panic!("{name}: {e}"));
        uneven += usize::from(chi_square(&counts(1), &expected, family).is_err());
    }
    // Sampling by area differs from sampling by solid angle in all cases except the distant ones.
    assert!(uneven >= 8, "points even over the area are found in {uneven} cases only");
    // In the plane and at corners the triangle is invisible, but the results are still finite.
    for position in [[0.4, 0.0, 0.3], [0.0, 0.0, 0.0], [0.5, 0.0, 0.0], [-1.0, 0.0, 0.0]] {
        let [a, b, c] = flat(1.0);
        let input = [a, b, c, position].map(|v| [v[0] as f32, v[1] as f32, v[2] as f32, 0.0]);
        for p in run(gpu, "seen", 256, &[], &input, 2) {
            // Coordinates with a few roundings, and a solid angle of at most 2 pi.
            assert!(p.iter().all(|v| (-1e-6..7.0).contains(v)), "{position:?}: {p:?}");
        }
    }
}

/// Directions survive octahedral coding within the stated error, axes, diagonals and signed zeros included, and bases
/// are orthonormal and right-handed.
#[kernel_test("PENUMBRA_DEVICE")]
fn directions_survive_coding(gpu: &Gpu) {
    let mut directions: Vec<[f32; 4]> = Vec::new();
    for x in -12..=12i32 {
        for y in -12..=12i32 {
            for z in -12..=12i32 {
                let v = glam::Vec3::new(x as f32, y as f32, z as f32);
                if let Some(n) = v.try_normalize() {
                    directions.push(n.extend(0.0).to_array());
                    directions.push((n * glam::Vec3::new(1.0, 1.0, -1.0)).extend(0.0).to_array());
                }
            }
        }
    }
    directions.push([-0.0, -0.0, -1.0, 0.0]);
    directions.push([1e-20, -1e-20, -1.0, 0.0]);
    let results = run(gpu, "coded", directions.len() as u32, &[], &directions, 4);
    let vec = |v: &[f32; 4]| glam::DVec3::new(v[0].into(), v[1].into(), v[2].into());
    let angle = |a: glam::DVec3, b: glam::DVec3| a.cross(b).length().atan2(a.dot(b));
    for (n, r) in directions.iter().zip(results.chunks_exact(4)) {
        let n = vec(n);
        // Half a step of 1/32767 or 1/63 in both coordinates, stretched threefold: 6.5e-5 and 0.0337.
        assert!(angle(n, vec(&r[0])) < 7e-5, "16 bits: {n}");
        assert!(angle(n, vec(&r[1])) < 0.034, "7 bits: {n}, {}", vec(&r[1]));
        assert!(r[1][3] < f32::from(1u16 << 14));
        let (t, b) = (vec(&r[2]), vec(&r[3]));
        // A few roundings of f32.
        assert!(t.cross(b).distance(n) < 2e-6, "basis of {n}: {t}, {b}");
        assert!((t.length() - 1.0).abs() < 2e-6 && t.dot(b).abs() < 2e-6, "basis of {n}: {t}, {b}");
    }
}
