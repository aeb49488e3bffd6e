//! Light buffers (Haines and Greenberg 1986): the directions around each light are divided into cells, and each cell
//! lists the surfaces that may hide the light from what lies in it, nearest first.
//!
//! The cells of a light with a position are those of the six faces of a cube about its centre; those of a directional
//! light are a square across its direction. The depth of a position is its distance along the axis of its face, or
//! along the direction of the light.
//!
//! A light with a surface lies in a sphere. What stops a ray from a position to a point of the light is no farther from
//! the line between the position and the centre than the radius of that sphere. So a surface is listed in each cell
//! that it comes within this radius of, at a depth that is smaller by the radius.

use std::ops::Range;

use glam::{DVec2, DVec3, Vec3};
use kernel_kit::shared_struct;
use rayon::prelude::*;

use super::lights::LightInfo;
use crate::kernels::occluder;
use crate::procedural::box_corners;
use crate::scene::{AlphaMode, EmitterTriangle, Light, LightKind, Scene};

/// Maximum number of surfaces in a list: its texels are counted in five bits. One more entry marks where the list ends.
const MAX_LISTED: usize = 31;

/// Maximum number of cells of all lights together: 128 MiB of lists if all of them are full.
const MAX_CELLS: usize = 1 << 19;

/// Margin of the bounds of lights, and a further margin as a share of their distance: rays start and end up to 256
/// representable steps per coordinate off their surfaces, 2.6e-5 where coordinates are below 1, and kernels round.
const SPARE: f64 = 4e-5;
const SPARE_OF_DISTANCE: f64 = 4e-7;

/// Distance from a triangle's plane up to which something counts as not beyond it: less than rays are kept clear of
/// surfaces.
const TOUCHING: f64 = 1.0 / (1 << 20) as f64;

/// Components of a unit vector below which it counts as perpendicular to an axis: far above rounding in f64. The depth
/// of such a plane is divided by this component, and would be too large to bound anything.
const PERPENDICULAR: f64 = 1e-9;

shared_struct! {
    /// A light and where its cells are; see `shaders/light_buffer.wgsl`.
    pub struct BufferedLight {
        /// Centre of the sphere around the light; the unit vector towards a directional light.
        pub centre: [f32; 3],
        /// Radius of that sphere, with a margin.
        pub radius: f32,
        /// First axis across a directional light.
        pub right: [f32; 3],
        /// Cells along a side; 0 for the environment, which has no cells.
        pub side: u32,
        /// Second axis across a directional light.
        pub up: [f32; 3],
        /// Index of the first cell.
        pub first_cell: u32,
        /// Coordinates where the cells of a directional light begin.
        pub low: [f32; 2],
        /// Edge of these cells; 0 for other lights.
        pub cell: f32,
        padding: u32,
    }
}

/// The light buffers of all lights, as the kernel reads them.
#[derive(Default)]
pub struct LightBuffers {
    /// One for each light.
    pub lights: Vec<BufferedLight>,
    /// For each cell, the first texel of its list, above [`occluder::COUNT_BITS`] bits for the number of its texels.
    pub cells: Vec<u32>,
    /// Two entries a texel, by depth: a triangle with flags (see [`occluder`]), and the bits of its depth.
    pub lists: Vec<[u32; 4]>,
    /// For each triangle, the unit normal, and the plane's distance from the origin along it.
    pub planes: Vec<[f32; 4]>,
}

impl LightBuffers {
    /// Light buffers with `resolution` cells along a side, or fewer where there are many lights. `lights` are those of
    /// the scene.
    pub fn new(scene: &Scene, lights: &[LightInfo], resolution: u32) -> LightBuffers {
        let planes: Vec<Plane> = (0..scene.triangles.len()).map(|i| Plane::of(scene, i)).collect();
        let side = resolution.min(((MAX_CELLS / (6 * lights.len().max(1))) as f64).sqrt() as u32).max(1);
        let built = (0..lights.len()).into_par_iter().map(|light| {
            let shape = Shape::new(scene, light, &lights[light]);
            shape.map(|shape| shape.buffer(scene, &planes, side))
        });
        let mut all = LightBuffers { planes: planes.iter().map(Plane::texel).collect(), ..LightBuffers::default() };
        let built: Vec<_> = built.collect();
        built.into_iter().for_each(|built| all.push(built));
        all
    }

    /// Appends a light and its lists, face by face.
    fn push(&mut self, built: Option<(BufferedLight, Vec<List>)>) {
        let Some((light, lists)) = built else { return self.lights.push(BufferedLight::default()) };
        self.lights.push(BufferedLight { first_cell: self.cells.len() as u32, ..light });
        for list in lists {
            let entries = list.entries();
            let texels = entries.len().div_ceil(2) as u32;
            self.cells.push((self.lists.len() as u32) << occluder::COUNT_BITS | texels);
            let padding = (occluder::ANYTHING, f32::MAX);
            self.lists.extend(entries.chunks(2).map(|pair| {
                let (first, second) = (pair[0], *pair.get(1).unwrap_or(&padding));
                [first.0, first.1.to_bits(), second.0, second.1.to_bits()]
            }));
        }
    }

    /// Bytes on the device.
    pub fn bytes(&self) -> u64 {
        let LightBuffers { lights, cells, lists, planes } = self;
        (size_of_val(&lights[..]) + size_of_val(&cells[..]) + size_of_val(&lists[..]) + size_of_val(&planes[..])) as u64
    }
}

/// The plane of a triangle: the points p with `normal` * p = `distance`.
#[derive(Clone, Copy)]
struct Plane {
    /// Unit, or zero where the triangle has no area.
    normal: DVec3,
    distance: f64,
}

impl Plane {
    fn of(scene: &Scene, triangle: usize) -> Plane {
        let [a, b, c] = scene.triangle_positions(triangle).map(|p| p.as_dvec3());
        let normal = (b - a).cross(c - a).normalize_or_zero();
        Plane { normal, distance: normal.dot(a) }
    }

    fn texel(&self) -> [f32; 4] {
        self.normal.as_vec3().extend(self.distance as f32).to_array()
    }

    /// Smallest and largest height of points over it.
    fn heights(&self, points: impl Iterator<Item = DVec3>) -> [f64; 2] {
        let heights = points.map(|p| self.normal.dot(p) - self.distance);
        heights.fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], h| [low.min(h), high.max(h)])
    }
}

/// Whether the whole of something is in front of a plane, and whether the whole is behind it. Both hold for what lies
/// in the plane.
#[derive(Clone, Copy)]
struct Sides {
    front: bool,
    back: bool,
}

impl Sides {
    fn of([low, high]: [f64; 2]) -> Sides {
        Sides { front: low >= -TOUCHING, back: high <= TOUCHING }
    }
}

/// What determines the cells of a light.
struct Shape<'s> {
    index: u32,
    /// The middle of the light, or the unit vector towards it.
    centre: DVec3,
    directional: bool,
    /// Without and with the margin.
    radius: f64,
    reach: f64,
    emitters: &'s [EmitterTriangle],
    /// Its own triangles hide no part of the light from where they shine: it is convex, and they have one side.
    convex: bool,
    /// Bounds of the scene.
    bounds: [Vec3; 2],
}

impl<'s> Shape<'s> {
    /// Returns `None` for the environment, which has no cells.
    fn new(scene: &'s Scene, index: usize, info: &LightInfo) -> Option<Shape<'s>> {
        let Light { kind, .. } = &scene.lights[index];
        let none: &[EmitterTriangle] = &[];
        let (centre, directional, emitters) = match kind {
            LightKind::Environment { .. } => return None,
            LightKind::Directional { direction, .. } => (-direction.as_dvec3().normalize(), true, none),
            LightKind::Point { position, .. } | LightKind::Spot { position, .. } => (position.as_dvec3(), false, none),
            LightKind::Mesh { emitters, .. } => (info.centre.as_dvec3(), false, &emitters[..]),
        };
        let bounds = scene.bounds().unwrap_or([Vec3::ZERO; 2]);
        let farthest = f64::from(bounds[0].length().max(bounds[1].length()));
        let distance = if directional { 0.0 } else { centre.length() + farthest };
        let radius = if emitters.is_empty() { 0.0 } else { f64::from(info.radius) };
        let reach = radius + SPARE + SPARE_OF_DISTANCE * distance;
        let mut shape =
            Shape { index: index as u32, centre, directional, radius, reach, emitters, convex: false, bounds };
        shape.convex =
            !info.two_sided && emitters.iter().all(|e| shape.sides(scene, &Plane::of(scene, e.triangle as usize)).back);
        Some(shape)
    }

    fn points(&self, scene: &'s Scene) -> impl Iterator<Item = DVec3> {
        let triangles = self.emitters.iter().map(|e| e.triangle as usize);
        triangles.flat_map(|i| scene.triangle_positions(i)).map(|p| p.as_dvec3())
    }

    /// On which sides of a plane the light is.
    fn sides(&self, scene: &Scene, plane: &Plane) -> Sides {
        if self.directional {
            let cosine = plane.normal.dot(self.centre);
            return Sides { front: cosine >= 0.0, back: cosine <= 0.0 };
        }
        let height = plane.normal.dot(self.centre) - plane.distance;
        match height.abs() > self.radius || self.emitters.is_empty() {
            true => Sides::of([height, height]),
            false => Sides::of(plane.heights(self.points(scene))),
        }
    }

    /// The entry of a triangle in lists; `None` if it hides no part of the light from anything in the scene.
    fn entry(&self, scene: &Scene, triangle: usize, plane: &Plane) -> Option<u32> {
        let own = scene.triangles[triangle].light == self.index;
        if plane.normal == DVec3::ZERO || (own && self.convex) {
            return None;
        }
        let light = self.sides(scene, plane);
        let corners = box_corners(self.bounds.map(|p| p.as_dvec3()));
        let all = Sides::of(plane.heights(corners.into_iter()));
        if (light.front && all.front) || (light.back && all.back) {
            return None;
        }
        let material = &scene.materials[scene.triangles[triangle].material as usize];
        let flag = |flag, on| if on { flag } else { 0 };
        // A triangle with holes does not hide all behind it. One of the light's own does not hide itself.
        let porous = own || material.alpha != AlphaMode::Opaque;
        let flags = flag(occluder::LIGHT_IN_FRONT, light.front)
            | flag(occluder::LIGHT_BEHIND, light.back)
            | flag(occluder::POROUS, porous);
        Some(triangle as u32 | flags)
    }

    /// The light, and the lists of its cells.
    fn buffer(&self, scene: &Scene, planes: &[Plane], side: u32) -> (BufferedLight, Vec<List>) {
        let triangles = 0..scene.triangles.len();
        let entries: Vec<(usize, u32)> =
            triangles.filter_map(|i| self.entry(scene, i, &planes[i]).map(|entry| (i, entry))).collect();
        let faces = if self.directional { vec![self.square(2 * side)] } else { self.cube(side) };
        let lists = faces.par_iter().flat_map_iter(|face| face.lists(scene, &entries)).collect();
        let square = faces.first().filter(|_| self.directional);
        let buffered = BufferedLight {
            centre: self.centre.as_vec3().to_array(),
            radius: (self.reach as f32).next_up(),
            right: square.map_or([0.0; 3], |face| face.axes[0].as_vec3().to_array()),
            side: faces[0].side,
            up: square.map_or([0.0; 3], |face| face.axes[1].as_vec3().to_array()),
            low: square.map_or([0.0; 2], |face| face.low.as_vec2().to_array()),
            cell: square.map_or(0.0, |face| face.cell as f32),
            ..BufferedLight::default()
        };
        (buffered, lists)
    }

    /// The faces of a cube: those along x, y and z, the positive one first. The axes across are the next two.
    fn cube(&self, side: u32) -> Vec<Face> {
        let across = [[DVec3::Y, DVec3::Z], [DVec3::Z, DVec3::X], [DVec3::X, DVec3::Y]];
        let face = |[right, up]: [DVec3; 2], depth: DVec3| Face {
            axes: [right, up, depth],
            centre: self.centre,
            directional: false,
            reach: self.reach,
            low: DVec2::splat(-1.0),
            cell: 2.0 / f64::from(side),
            side,
        };
        across
            .into_iter()
            .flat_map(|[right, up]| [1.0, -1.0].map(|sign| face([right, up], sign * right.cross(up))))
            .collect()
    }

    /// The square across a directional light. It covers the scene.
    fn square(&self, side: u32) -> Face {
        // Rounded as the kernel has them.
        let (right, up) = self.centre.any_orthonormal_pair();
        let [right, up] = [right, up].map(|axis| axis.as_vec3().as_dvec3());
        let corners = box_corners(self.bounds.map(|p| p.as_dvec3()));
        let across = corners.map(|p| DVec2::new(right.dot(p), up.dot(p)));
        let low = across.into_iter().reduce(DVec2::min).unwrap_or_default() - SPARE;
        let high = across.into_iter().reduce(DVec2::max).unwrap_or_default() + SPARE;
        let cell = f64::from(((high - low).max_element() / f64::from(side)) as f32);
        let axes = [right, up, -self.centre];
        Face {
            axes,
            centre: DVec3::ZERO,
            directional: true,
            reach: self.reach,
            low: low.as_vec2().as_dvec2(),
            cell,
            side,
        }
    }
}

/// A square of cells. Positions are taken to its own space, with the axes x and y across and z along the depth. Lines
/// from the light through (x, y) of the square are (x z, y z, z), or (x, y, z) of a directional light.
struct Face {
    axes: [DVec3; 3],
    centre: DVec3,
    directional: bool,
    reach: f64,
    low: DVec2,
    cell: f64,
    side: u32,
}

impl Face {
    /// The lists of all cells. The nearest surfaces come first: they soon fill the lists, and what is farther than all
    /// that the lists have room for is left out early.
    fn lists(&self, scene: &Scene, entries: &[(usize, u32)]) -> Vec<List> {
        let corners = |triangle: usize| scene.triangle_positions(triangle).map(|p| self.own(p));
        let depth = |triangle: usize| self.depth(&Occluder::hull(&corners(triangle)), &self.whole());
        let near = entries.iter().filter_map(|(triangle, entry)| Some((depth(*triangle)?, *triangle, *entry)));
        let mut near: Vec<(f64, usize, u32)> = near.collect();
        near.sort_by(|(a, i, _), (b, j, _)| a.total_cmp(b).then(i.cmp(j)));
        let mut lists = Lists::new(self.side);
        for object in &scene.procedurals {
            let corners = object.corners().map(|p| self.own(p));
            self.add(&Occluder::hull(&corners), occluder::ANYTHING, (1, self.whole()), &mut lists);
        }
        for (_, triangle, entry) in near {
            let surface = Occluder::triangle(&corners(triangle), self.directional);
            self.add(&surface, entry, (1, self.whole()), &mut lists);
        }
        lists.of_cells
    }

    fn whole(&self) -> [Range<u32>; 2] {
        [0..self.side, 0..self.side]
    }

    fn own(&self, position: Vec3) -> DVec3 {
        let p = position.as_dvec3() - self.centre;
        DVec3::from(self.axes.map(|axis| axis.dot(p)))
    }

    /// Adds a surface to those of a node's cells that it may come near.
    fn add(&self, surface: &Occluder, entry: u32, (node, cells): (usize, [Range<u32>; 2]), lists: &mut Lists) {
        let Some(depth) = self.depth(surface, &cells) else { return };
        // Rounded down.
        let depth = (depth as f32).next_down();
        if depth >= lists.ends[node] {
            return;
        }
        let [x, y] = cells;
        if x.len() == 1 && y.len() == 1 {
            let list = &mut lists.of_cells[(y.start * self.side + x.start) as usize];
            list.push(entry, depth);
            lists.ends[node] = list.end;
            return;
        }
        let halves = |range: &Range<u32>| {
            let middle = (range.start + range.end) / 2;
            [range.start..middle, middle..range.end]
        };
        let [first, second] = match x.len() > y.len() {
            true => halves(&x).map(|half| [half, y.clone()]),
            false => halves(&y).map(|half| [x.clone(), half]),
        };
        self.add(surface, entry, (2 * node, first), lists);
        self.add(surface, entry, (2 * node + 1, second), lists);
        lists.ends[node] = lists.ends[2 * node].max(lists.ends[2 * node + 1]);
    }

    /// Minimum depth of what is within reach of a surface and in some of the cells; `None` if nothing is.
    fn depth(&self, surface: &Occluder, cells: &[Range<u32>; 2]) -> Option<f64> {
        let edge = |axis: usize, at: u32| self.low[axis] + self.cell * f64::from(at);
        let edges = [0, 1].map(|axis| [edge(axis, cells[axis].start), edge(axis, cells[axis].end)]);
        let [nearest, farthest] = surface.depths;
        if self.is_beside(surface, &edges) || (!self.directional && farthest < -self.reach) {
            return None;
        }
        let nearest = if self.directional { nearest - self.reach } else { (nearest - self.reach).max(0.0) };
        let corners = [0, 1, 2, 3].map(|i| DVec2::new(edges[0][i & 1], edges[1][i >> 1]));
        let Some((plane, sides)) = &surface.flat else { return Some(nearest) };
        // The planes through the light and the triangle's edges.
        let outside = |side: &Plane| {
            let heights = corners.map(|c| side.normal.dot(c.extend(if self.directional { 0.0 } else { 1.0 })));
            let largest = heights.into_iter().fold(f64::NEG_INFINITY, f64::max) - side.distance;
            match self.directional {
                true => largest < -self.reach,
                false => largest < 0.0 && nearest * largest < -self.reach,
            }
        };
        if sides.iter().any(outside) {
            return None;
        }
        self.depth_of_plane(plane, &corners).map(|depth| depth.max(nearest))
    }

    /// Whether a plane through the light and an edge of the cells separates the surface from them.
    fn is_beside(&self, surface: &Occluder, edges: &[[f64; 2]; 2]) -> bool {
        (0..2).any(|axis| {
            [1.0, -1.0].into_iter().zip(edges[axis]).any(|(sign, edge)| {
                let (scale, slope) = if self.directional { (1.0, 0.0) } else { (edge.hypot(1.0), edge) };
                let offset = if self.directional { edge } else { 0.0 };
                let inside = |p: &DVec3| sign * (p[axis] - slope * p.z - offset) / scale;
                surface.corners.iter().map(inside).fold(f64::NEG_INFINITY, f64::max) < -self.reach
            })
        })
    }

    /// Minimum depth at which lines through the square between the corners are within reach of a plane, whose normal
    /// points away from the light; `None` if they do not meet it.
    fn depth_of_plane(&self, plane: &Plane, corners: &[DVec2; 4]) -> Option<f64> {
        let height = plane.distance - self.reach;
        if self.directional {
            // Nearly parallel to the light, it bounds no depth.
            if plane.normal.z < PERPENDICULAR {
                return Some(f64::NEG_INFINITY);
            }
            let depths = corners.map(|c| (height - plane.normal.dot(c.extend(0.0))) / plane.normal.z);
            return Some(depths.into_iter().fold(f64::INFINITY, f64::min));
        }
        if height <= 0.0 {
            return Some(0.0);
        }
        let slopes = corners.map(|c| plane.normal.dot(c.extend(1.0)));
        let steepest = slopes.into_iter().fold(f64::NEG_INFINITY, f64::max);
        (steepest > 0.0).then(|| height / steepest)
    }
}

/// A surface in the space of a face.
struct Occluder {
    corners: Vec<DVec3>,
    /// Smallest and largest depth.
    depths: [f64; 2],
    /// For a triangle, its plane, whose normal points away from the light, and the planes through the light and each
    /// edge, whose normals point inwards.
    flat: Option<(Plane, Vec<Plane>)>,
}

impl Occluder {
    fn hull(corners: &[DVec3]) -> Occluder {
        let depths = corners.iter().fold([f64::INFINITY, f64::NEG_INFINITY], |[a, b], p| [a.min(p.z), b.max(p.z)]);
        Occluder { corners: corners.to_vec(), depths, flat: None }
    }

    fn triangle(corners: &[DVec3; 3], directional: bool) -> Occluder {
        let [a, b, c] = *corners;
        let mut normal = (b - a).cross(c - a).normalize_or_zero();
        if (if directional { normal.z } else { normal.dot(a) }) < 0.0 {
            normal = -normal;
        }
        let plane = Plane { normal, distance: normal.dot(a) };
        let side = |[a, b, c]: [DVec3; 3]| {
            let across = if directional { (b - a).cross(DVec3::Z) } else { a.cross(b) };
            let mut normal = across.try_normalize()?;
            let distance = if directional { normal.dot(a) } else { 0.0 };
            let inside = normal.dot(c) - distance;
            if inside < 0.0 {
                normal = -normal;
            }
            Some(Plane { normal, distance: if inside < 0.0 { -distance } else { distance } })
        };
        let sides = [[a, b, c], [b, c, a], [c, a, b]].into_iter().filter_map(side).collect();
        Occluder { flat: Some((plane, sides)), ..Occluder::hull(corners) }
    }
}

/// The lists of the cells of a face, while they are filled.
struct Lists {
    of_cells: Vec<List>,
    /// Where the lists of a node's cells end: the largest [`List::end`]. Node 1 has all cells; the halves of node n are
    /// 2n and 2n + 1.
    ends: Vec<f32>,
}

impl Lists {
    fn new(side: u32) -> Lists {
        let nodes = 2 * side.next_power_of_two().pow(2) as usize;
        Lists { of_cells: vec![List::default(); (side * side) as usize], ends: vec![f32::INFINITY; nodes] }
    }
}

/// The surfaces of a cell.
#[derive(Clone)]
struct List {
    listed: Vec<(u32, f32)>,
    /// Minimum depth of the surfaces that are not listed: there was no room for them, or they are no triangles. Only
    /// their depth is known.
    end: f32,
}

impl Default for List {
    fn default() -> List {
        List { listed: Vec::new(), end: f32::INFINITY }
    }
}

impl List {
    fn push(&mut self, entry: u32, depth: f32) {
        if entry == occluder::ANYTHING {
            self.end = self.end.min(depth);
        } else {
            self.listed.push((entry, depth));
        }
        if self.listed.len() > 2 * MAX_LISTED {
            self.shorten();
        }
    }

    /// Keeps the nearest; of equal depth those that come first in the scene.
    fn shorten(&mut self) {
        self.listed.sort_by(|(a, x), (b, y)| x.total_cmp(y).then(a.cmp(b)));
        if let Some((_, dropped)) = self.listed.get(MAX_LISTED) {
            self.end = self.end.min(*dropped);
        }
        let kept = self.listed.partition_point(|(_, depth)| *depth < self.end);
        self.listed.truncate(kept.min(MAX_LISTED));
    }

    /// The entries by depth. The last one marks where the list ends, if there are surfaces that are not listed.
    fn entries(mut self) -> Vec<(u32, f32)> {
        self.shorten();
        if self.end < f32::INFINITY {
            self.listed.push((occluder::ANYTHING, self.end));
        }
        self.listed
    }
}
