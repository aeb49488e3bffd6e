//! Invariants of BVHs, checked by decoding the nodes as the kernels do.

use glam::{DVec3, Vec3, vec3};

use super::aabb::Aabb;
use super::binary;
use super::hierarchy::{Bvh, STACK_SIZE};
use super::node::{Node, WIDTH};

type Triangle = [Vec3; 3];

/// Decodes the BVH and returns the first violation of its invariants.
fn fault(bvh: &Bvh, triangles: &[Triangle]) -> Option<String> {
    let mut order = bvh.order.clone();
    order.sort_unstable();
    if !order.iter().copied().eq(0..triangles.len() as u32) {
        return Some("the order is not a permutation".into());
    }
    let mut visited_triangles = vec![false; triangles.len()];
    let mut visited_nodes = vec![false; bvh.nodes.len() / 3];
    // Nodes to visit, with the boxes that contain them and their level.
    let mut open: Vec<(usize, Vec<[DVec3; 2]>, u32)> = vec![(0, Vec::new(), 1)];
    let mut depth = 0;
    while let Some((index, boxes, level)) = open.pop() {
        if std::mem::replace(&mut visited_nodes[index], true) {
            return Some(format!("node {index} has two parents"));
        }
        let node = Node::unpack(&bvh.nodes[3 * index..3 * index + 3]);
        depth = depth.max(level);
        let mut primitive = node.first_triangle as usize;
        for child in 0..WIDTH {
            let mut boxes = boxes.clone();
            boxes.push(node.child_bounds(child));
            // Slightly less than the margin, for the rounding of f64 where corners are much smaller than a step.
            let margin = node.step.as_dvec3() * (0.999_999 / 4096.0);
            if child < node.node_count as usize {
                open.push((node.first_node as usize + child, boxes, level + 1));
                continue;
            }
            for _ in 0..node.leaf_counts[child] {
                if std::mem::replace(&mut visited_triangles[primitive], true) {
                    return Some(format!("triangle {primitive} is in two leaves"));
                }
                let corners = triangles[bvh.order[primitive] as usize];
                let texels = corners.map(|corner| corner.extend(0.0).to_array());
                if bvh.triangles[3 * primitive..3 * primitive + 3] != texels {
                    return Some(format!("primitive {primitive} does not hold its triangle"));
                }
                for corner in corners.map(|corner| corner.as_dvec3()) {
                    let inside = |[low, high]: &[DVec3; 2]| corner.cmpge(*low).all() && corner.cmple(*high).all();
                    let [low, high] = boxes[boxes.len() - 1];
                    if !boxes.iter().all(inside) || !inside(&[low + margin, high - margin]) {
                        return Some(format!("triangle {primitive} reaches out of its boxes"));
                    }
                }
                primitive += 1;
            }
        }
    }
    if let Some(primitive) = visited_triangles.iter().position(|visited| !visited) {
        return Some(format!("triangle {primitive} is in no leaf"));
    }
    if let Some(index) = visited_nodes.iter().position(|visited| !visited) {
        return Some(format!("node {index} has no parent"));
    }
    if depth != bvh.depth || depth > STACK_SIZE + 1 {
        return Some(format!("depth {depth}, but {} is stated", bvh.depth));
    }
    None
}

/// The first fault of the nodes for packets: not each child has the node's link and the box that its triangles span.
fn packet_fault(bvh: &Bvh, texels: &[[f32; 4]]) -> Option<String> {
    let nodes: Vec<_> = bvh.nodes.chunks(3).map(Node::unpack).collect();
    // Corners below a node or in a leaf, the slow way.
    fn corners(bvh: &Bvh, nodes: &[Node], node: &Node, child: usize) -> Vec<Vec3> {
        if child < node.node_count as usize {
            let below = &nodes[node.first_node as usize + child];
            return (0..WIDTH).flat_map(|child| corners(bvh, nodes, below, child)).collect();
        }
        let first = node.first_triangle + node.leaf_counts[..child].iter().sum::<u32>();
        let texels = &bvh.triangles[3 * first as usize..][..3 * node.leaf_counts[child] as usize];
        texels.iter().map(|texel| Vec3::from_slice(texel)).collect()
    }
    let mut largest = 0.0f32;
    for ((index, node), texels) in nodes.iter().enumerate().zip(texels.chunks(8)) {
        let mut primitive = node.first_triangle;
        for child in 0..WIDTH {
            let [lower, upper] = [texels[child], texels[4 + child]].map(|texel| Vec3::from_slice(&texel));
            let count = node.leaf_counts[child];
            let held = corners(bvh, &nodes, node, child);
            if held.is_empty() {
                if !lower.cmpgt(upper).all() {
                    return Some(format!("node {index} has a child {child}"));
                }
                continue;
            }
            let is_node = child < node.node_count as usize;
            let entry = if is_node { node.first_node + child as u32 } else { count << 29 | primitive };
            primitive += count;
            let bounds = held.iter().fold(Aabb::EMPTY, |all, corner| all.extended(*corner));
            if texels[child][3].to_bits() != entry || [bounds.min, bounds.max] != [lower, upper] {
                return Some(format!("child {child} of node {index}"));
            }
            largest = held.iter().fold(largest, |largest, corner| largest.max(corner.abs().max_element()));
        }
    }
    (texels.len() != 8 * nodes.len() || texels[4][3] != largest).then(|| "not of these triangles".into())
}

/// A deterministic number in 0..1.
fn number(seed: usize) -> f32 {
    let mixed = (seed as u32).wrapping_mul(0x9e37_79b9) ^ 0x85eb_ca6b;
    let mixed = (mixed ^ mixed >> 15).wrapping_mul(0x2c1b_3c6d);
    let mixed = (mixed ^ mixed >> 12).wrapping_mul(0x297a_2d39);
    (mixed >> 8) as f32 / (1u32 << 24) as f32
}

fn soup(count: usize, size: f32) -> Vec<Triangle> {
    let point = |seed: usize| vec3(number(3 * seed), number(3 * seed + 1), number(3 * seed + 2)) * 2.0 - 1.0;
    (0..count).map(|i| std::array::from_fn(|corner| point(4 * i) + size * point(4 * i + 1 + corner))).collect()
}

const UNIT: Triangle = [Vec3::ZERO, Vec3::X, Vec3::Y];

/// Every triangle is in one leaf and inside all boxes above it, with the margin that the kernels rely on, and the
/// stated depth is right. The scenes have every small number of triangles, or are hard for builders.
#[test]
fn hierarchies_hold_their_triangles() {
    let scaled = |scale: f32| UNIT.map(|corner| corner * scale);
    let mut scenes: Vec<(String, Vec<Triangle>)> =
        (0..20).map(|count| (format!("{count} triangles"), soup(count, 0.3))).collect();
    scenes.extend([
        ("a soup".into(), soup(30_000, 0.02)),
        ("identical triangles".into(), vec![UNIT; 100_000]),
        ("one centroid".into(), (0..100_000).map(|i| scaled(1.0 + i as f32).map(|p| p * 1e-5)).map(centred).collect()),
        ("a stack".into(), (0..100_000).map(|i| UNIT.map(|p| p + Vec3::Z * (i as f32 * 1e-5))).collect()),
        ("halving sizes".into(), (0..120).flat_map(|i| vec![scaled(2f32.powi(-i)); 7]).collect()),
        ("doubling distances".into(), (0..39).map(|i| UNIT.map(|p| p + 2f32.powi(i))).collect()),
        ("points".into(), (0..100).map(|i| [Vec3::splat(number(i)); 3]).collect()),
        ("far from the origin".into(), soup(1000, 0.1).iter().map(|t| t.map(|p| p + 1e6)).collect()),
        ("huge".into(), soup(1000, 0.1).iter().map(|t| t.map(|p| p * 1e11)).collect()),
        ("tiny".into(), soup(1000, 0.1).iter().map(|t| t.map(|p| p * 1e-30)).collect()),
    ]);
    for (name, triangles) in scenes {
        let bvh = Bvh::build(&triangles).unwrap();
        assert_eq!(fault(&bvh, &triangles), None, "{name}");
    }
}

fn centred(triangle: Triangle) -> Triangle {
    let bounds = Aabb::of(triangle);
    triangle.map(|corner| corner - 0.5 * (bounds.min + bounds.max))
}

/// The check detects a plane that is one step too far in, a leaf that lost a triangle and a wrong depth.
#[test]
fn planted_faults_are_found() {
    let triangles = soup(500, 0.1);
    let bvh = Bvh::build(&triangles).unwrap();
    let faults: [fn(&mut Bvh); 3] = [
        |bvh| bvh.nodes[0][3] += 1,
        |bvh| {
            let leaf = bvh.nodes.len() - 3;
            bvh.nodes[leaf + 2][1] ^= 1 << 28;
        },
        |bvh| bvh.depth += 1,
    ];
    for (number, plant) in faults.iter().enumerate() {
        let mut bvh = bvh.clone();
        plant(&mut bvh);
        assert!(fault(&bvh, &triangles).is_some(), "fault {number} is not detected");
    }
}

/// The nodes for packets have the links of the others and exact boxes, and a fault of each kind is found.
#[test]
fn nodes_for_packets_are_the_same() {
    for count in (0..20).chain([1000]) {
        let bvh = Bvh::build(&soup(count, 0.3)).unwrap();
        let texels = bvh.packet_nodes();
        assert_eq!(texels.len() as u64, bvh.packet_texels());
        assert_eq!(packet_fault(&bvh, &texels), None, "{count} triangles");
        for (texel, component) in [(0, 0), (0, 3), (4, 2), (4, 3)] {
            let mut texels = texels.clone();
            texels[texel][component] = 0.5;
            assert!(count == 0 || packet_fault(&bvh, &texels).is_some(), "{count} triangles: {texel}, {component}");
        }
    }
}

/// A low limit makes the tree as shallow as a balanced one for any triangles.
#[test]
fn depth_is_bounded() {
    let triangles: Vec<Triangle> = (0..1000).map(|i| UNIT.map(|p| p * 0.9f32.powi(i))).collect();
    let build = |max_depth: u32| {
        let item = |(at, corners): (usize, &Triangle)| binary::Item { bounds: Aabb::of(*corners), index: at as u32 };
        let mut items: Vec<_> = triangles.iter().enumerate().map(item).collect();
        let nodes = binary::build(&mut items, max_depth);
        let mut levels = vec![0; nodes.len()];
        for (at, node) in nodes.iter().enumerate().filter(|(_, node)| !node.is_leaf()) {
            for child in node.children(at) {
                levels[child] = levels[at] + 1;
            }
        }
        levels.into_iter().max().unwrap()
    };
    assert!(build(1000) > 40, "the scene does not test the limit");
    for max_depth in [0, 10, 12, 20] {
        assert!(build(max_depth) <= max_depth.max(10), "{max_depth}");
    }
}

/// The BVH is the same for any number of threads.
#[test]
fn hierarchies_do_not_depend_on_threads() {
    let triangles = soup(30_000, 0.02);
    let build = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| Bvh::build(&triangles).unwrap())
    };
    let (one, four) = (build(1), build(4));
    assert!(one.nodes == four.nodes && one.order == four.order);
}

/// Packing and unpacking preserves a node.
#[test]
fn nodes_are_packed_without_loss() {
    let mut node = Node::around(&soup(4, 0.3).into_iter().map(Aabb::of).collect::<Vec<_>>());
    node.node_count = 1;
    node.leaf_counts = [0, 4, 1, 3];
    node.first_node = (1 << 28) - 1;
    node.first_triangle = (1 << 28) - 2;
    assert_eq!(Node::unpack(&node.pack()), node);
}

/// Corners that are not finite, or too large for the arithmetic of the kernels, are refused. The error states the
/// triangle.
#[test]
fn corners_out_of_range_are_refused() {
    for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, 1e20, f32::MIN] {
        let mut triangles = soup(10, 0.1);
        triangles[7][1].y = bad;
        assert!(Bvh::build(&triangles).unwrap_err().to_string().contains("triangle 7"), "{bad}");
    }
}
