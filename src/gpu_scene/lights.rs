//! Lights as `shaders/lib/light.wgsl` reads them: records, emitter triangles, contours.

use std::collections::HashMap;

use glam::{DVec3, Vec3};

use crate::Result;
use crate::gpu::buffer::TableFormat;
use crate::gpu::{Binding, Bindings, Buffer, Gpu, Table};
use crate::scene::{AlphaMode, EmitterTriangle, Light, LightKind, Scene};
pub(crate) use crate::specialisation::lights::FEW_EMITTERS;
use crate::specialisation::lights::is_closed_mesh;
pub use crate::specialisation::lights::{has_many_emitters, is_closed};

use super::aim::Receivers;
use super::environment::GpuEnvironment;
use super::{oct_encode16, sobol};

/// Kinds of lights, and flags, in the first word of a light's records.
pub(crate) const MESH: u32 = 0;
pub(crate) const POINT: u32 = 1;
pub(crate) const SPOT: u32 = 2;
pub(crate) const DIRECTIONAL: u32 = 3;
pub(crate) const ENVIRONMENT: u32 = 4;
pub(crate) const KIND_MASK: u32 = 7;
pub(crate) const TWO_SIDED: u32 = 8;
pub(crate) const CLOSED_FORM: u32 = 16;
/// Some of the surface may be missing: its material is an alpha mask or blends.
pub(crate) const COVERAGE: u32 = 32;
pub(crate) const VIEWED: u32 = 64;
/// Records before the first light's, of a light, and of an emitter triangle.
pub(crate) const HEADER: u32 = 2;
pub(crate) const RECORDS: u32 = 6;
pub(crate) const EMITTER_RECORDS: u32 = 4;

/// Most contour edges of a light that has a closed form: beyond them the formula costs more than the shadow ray
/// that a sample would need anyway.
const MAX_CONTOUR_EDGES: usize = 64;

/// Cells a side of the octahedral map from which a convex light is seen, some 7 degrees wide each. What the points of a sphere
/// bring then spreads by 8 % about its mean; by 59 % where power alone chooses them.
pub(crate) const VIEW_SIDE: u32 = 16;

/// Radii of a light from whose middle it is far. Nearer, what its triangles show hangs on the place and not on the direction
/// alone.
pub(crate) const NEAR_LIGHT: f64 = 2.0;

/// Most triangles of a light all of which are asked where it is near: each costs some tenth of a shadow ray.
pub(crate) const FEW_NEAR_EMITTERS: u32 = 15;

/// Triangles of a light that is worth views: of fewer, those that face the other way are all that matters; more would take
/// more than 4 MB.
const VIEWED_TRIANGLES: std::ops::RangeInclusive<usize> = FEW_NEAR_EMITTERS as usize + 1..=1 << 12;

/// How far corners may lie from their contour's plane or edge, relative to the light's radius, to count as in it:
/// a few roundings of f32 coordinates of a scene of unit size.
const COPLANAR: f64 = 2e-6;

/// The scene's lights on the device, bound by the names `light_records`, `emitter_records`, `light_vertices`,
/// `environment_records` and `sobol_directions`.
pub struct GpuLights {
    /// What the host wants to know of each light, in the scene's order.
    pub lights: Vec<LightInfo>,
    /// The panorama, where there is one.
    pub environment: Option<GpuEnvironment>,
    records: Table,
    emitters: Table,
    vertices: Table,
    sobol: Buffer,
}

/// What the host wants to know of a light.
#[derive(Clone, Debug, PartialEq)]
pub struct LightInfo {
    /// Emitted power, mean of the three channels, in the units of the file over normalised lengths squared. Of a
    /// directional light and of the environment: through the disc that covers the scene.
    pub power: f64,
    /// The share of that which photons carry: they are sent to what there is to light, if that is known.
    pub aimed: f64,
    /// What it sends where, about.
    pub emission: Emission,
    /// [`crate::scene::LightKind::Mesh`] of uniform radiance and few edges, or a punctual light.
    pub closed_form: bool,
    /// Edges of its contours; 0 where there is no closed form and of punctual lights.
    pub contour_edges: usize,
    /// Both sides emit.
    pub two_sided: bool,
    /// A point, spot or directional light: one shadow ray tells all.
    pub punctual: bool,
    /// All its emitter triangles lie in one plane and face the same way.
    pub planar: bool,
    /// Centre of a sphere around the light; of a directional light around the scene.
    pub centre: Vec3,
    /// Radius of that sphere; 0 of point and spot lights, and of the environment.
    pub radius: f32,
}

/// About what a light sends into a direction, mean of the three channels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Emission {
    /// Largest radiant intensity, or the mean over all directions where there is no axis; of directional lights and the
    /// environment irradiance.
    pub strength: f64,
    /// The normal of a light that lies in a plane and shines from one side, by the cosine law.
    pub axis: Option<Vec3>,
}

/// [`Emission::axis`] where there is none, in the records: no normal has this code, as -32768 is no signed 16-bit fraction.
pub(crate) const NO_AXIS: u32 = 0x8000_8000;

impl GpuLights {
    /// Uploads the lights of a scene whose triangles are in the order of the BVH. Photons are sent towards the receivers, or
    /// wherever the light shines.
    ///
    /// # Errors
    /// As [`Gpu::table`].
    pub fn new(gpu: &Gpu, scene: &Scene, receivers: Option<Receivers>) -> Result<GpuLights> {
        let mut build = Build::default();
        if let Some(Light { kind: LightKind::Environment { panorama, turn, strength }, .. }) = scene.lights.last() {
            build.environment = Some(GpuEnvironment::new(gpu, panorama, *turn, *strength)?);
        }
        for (index, light) in scene.lights.iter().enumerate() {
            let aimed = receivers.map_or(1.0, |receivers| receivers.share_of(scene, &light.kind));
            build.push(scene, index as u32, light, aimed);
        }
        build.slots.sort_unstable();
        build.choose();
        let header = [scene.lights.len() as u32, build.emitters.len() as u32 / EMITTER_RECORDS, 0, 0];
        let mut records = vec![header, receivers.map_or([0; 4], |receivers| bits(receivers.centre, receivers.radius))];
        records.extend(build.records);
        build.emitters.extend(build.slots);
        Ok(GpuLights {
            lights: build.lights,
            environment: build.environment,
            records: gpu.table("penumbra/scene/light_records", &records, TableFormat::Uint)?,
            emitters: gpu.table("penumbra/scene/emitter_records", &build.emitters, TableFormat::Uint)?,
            vertices: gpu.table("penumbra/scene/light_vertices", &build.vertices, TableFormat::Float)?,
            sobol: sobol::upload(gpu)?,
        })
    }
}

impl Bindings for GpuLights {
    fn get(&self, name: &str) -> Option<Binding<'_>> {
        match name {
            "light_records" => Some((&self.records).into()),
            "emitter_records" => Some((&self.emitters).into()),
            "light_vertices" => Some((&self.vertices).into()),
            "environment_records" => self.environment.as_ref().map(|environment| (&environment.records).into()),
            "sobol_directions" => Some((&self.sobol).into()),
            _ => None,
        }
    }
}

#[derive(Default)]
struct Build {
    lights: Vec<LightInfo>,
    environment: Option<GpuEnvironment>,
    records: Vec<[u32; 4]>,
    emitters: Vec<[u32; 4]>,
    /// By BVH slot of an emitter triangle: its light and its place in `emitters`.
    slots: Vec<[u32; 4]>,
    vertices: Vec<[f32; 4]>,
}

fn bits(v: Vec3, w: f32) -> [u32; 4] {
    v.extend(w).to_array().map(f32::to_bits)
}

impl Build {
    /// Writes how likely each light is to be chosen: half by power, half alike, so that a weak light near by is not
    /// left to rare samples of great weight; and what the kernels' `light_potential` needs.
    fn choose(&mut self) {
        let count = self.lights.len() as f64;
        let total: f64 = self.lights.iter().map(|light| light.power).sum();
        let mut cumulative = 0.0;
        let mut below = 0f32;
        // In units of the strongest: its weight anywhere is about 1 over a squared distance, whatever the scene's units.
        let unit = self.lights.iter().map(|light| light.emission.strength).fold(f64::MIN_POSITIVE, f64::max);
        for (i, light) in self.lights.iter().enumerate() {
            cumulative += if total > 0.0 { 0.5 * light.power / total + 0.5 / count } else { 1.0 / count };
            // As for emitter triangles, the probabilities are those of the rounded numbers.
            let end = if i + 1 == self.lights.len() { 1.0 } else { cumulative as f32 };
            let Emission { strength, axis } = light.emission;
            let strength = if light.punctual { 1.0 / unit } else { strength / unit };
            let axis = axis.map_or(NO_AXIS, oct_encode16);
            self.records[(i + 1) * RECORDS as usize - 1] =
                [end.to_bits(), (end - below).to_bits(), (strength as f32).to_bits(), axis];
            below = end;
        }
    }

    fn push(&mut self, scene: &Scene, index: u32, light: &Light, aimed: f64) {
        let punctual = |power, strength, centre, radius| LightInfo {
            power,
            aimed,
            emission: Emission { strength, axis: None },
            closed_form: true,
            contour_edges: 0,
            two_sided: false,
            punctual: true,
            planar: false,
            centre,
            radius,
        };
        let mean = |v: Vec3| v.as_dvec3().element_sum() / 3.0;
        // An infinite range has no finite twin that matters: at 3e38 the window is 1 everywhere.
        let finite = |range: f32| range.min(f32::MAX);
        let none = [0; 4];
        let info = match &light.kind {
            LightKind::Mesh { material, emitters } => self.push_mesh(scene, index, *material, emitters, aimed),
            LightKind::Point { position, intensity, range } => {
                let kind = [POINT | CLOSED_FORM, 0, 0, 0];
                self.records.extend([kind, bits(*position, finite(*range)), bits(*intensity, 0.0), none, none, none]);
                let strength = mean(*intensity);
                punctual(strength * 4.0 * std::f64::consts::PI, strength, *position, 0.0)
            }
            LightKind::Spot { position, direction, intensity, cos_inner, cos_outer, range } => {
                let kind = [SPOT | CLOSED_FORM, 0, 0, 0];
                let cone = [cos_inner.to_bits(), 0, 0, 0];
                let place = bits(*position, finite(*range));
                self.records.extend([kind, place, bits(*intensity, 0.0), bits(*direction, *cos_outer), cone, none]);
                let height = spot_height(f64::from(*cos_inner), f64::from(*cos_outer));
                let steradians = 2.0 * std::f64::consts::PI * height;
                punctual(mean(*intensity) * steradians, mean(*intensity), *position, 0.0)
            }
            LightKind::Directional { direction, irradiance } => {
                let kind = [DIRECTIONAL | CLOSED_FORM, 0, 0, 0];
                let (centre, radius) = bounding_sphere(scene.vertices.iter().map(|v| v.position));
                let disc = bits(centre, radius);
                self.records.extend([kind, none, bits(*irradiance, 0.0), bits(*direction, 0.0), disc, none]);
                let area = std::f64::consts::PI * f64::from(radius).powi(2);
                punctual(mean(*irradiance) * area, mean(*irradiance), centre, radius)
            }
            LightKind::Environment { .. } => self.push_environment(scene),
        };
        self.lights.push(info);
    }

    fn push_environment(&mut self, scene: &Scene) -> LightInfo {
        let none = [0; 4];
        let (centre, radius) = bounding_sphere(scene.vertices.iter().map(|v| v.position));
        self.records.extend([[ENVIRONMENT, 0, 0, 0], none, none, none, bits(centre, radius), none]);
        let irradiance = self.environment.as_ref().map_or(0.0, |environment| environment.irradiance);
        LightInfo {
            power: irradiance * std::f64::consts::PI * f64::from(radius).powi(2),
            aimed: 1.0,
            // A surface gets about half of what comes across all directions.
            emission: Emission { strength: irradiance / 2.0, axis: None },
            closed_form: false,
            contour_edges: 0,
            two_sided: false,
            punctual: false,
            planar: false,
            centre,
            radius: 0.0,
        }
    }

    fn push_mesh(
        &mut self,
        scene: &Scene,
        index: u32,
        material: u32,
        emitters: &[EmitterTriangle],
        aimed: f64,
    ) -> LightInfo {
        let material = &scene.materials[material as usize];
        let corners = |e: &EmitterTriangle| scene.triangle_positions(e.triangle as usize);
        let (centre, radius) = bounding_sphere(emitters.iter().flat_map(corners));
        let first = self.emitters.len() as u32 / EMITTER_RECORDS;
        let area = |[a, b, c]: [Vec3; 3]| (b - a).as_dvec3().cross((c - a).as_dvec3()).length() / 2.0;
        let power = |e: &EmitterTriangle| area(corners(e)) * e.radiance.as_dvec3().element_sum() / 3.0;
        let total: f64 = emitters.iter().map(power).sum();
        // Both sides of a double-sided triangle shine: none faces away.
        let partners = match material.double_sided {
            true => (0..emitters.len() as u32).collect(),
            false => partners(&emitters.iter().map(corners).collect::<Vec<_>>()),
        };
        let mut cumulative = 0.0;
        let mut below = 0f32;
        for (i, emitter) in emitters.iter().enumerate() {
            let [a, b, c] = corners(emitter);
            cumulative += power(emitter);
            // The kernels compare with the rounded numbers: the probabilities are made of them too.
            let end = if i + 1 == emitters.len() { 1.0 } else { (cumulative / total) as f32 };
            let density = f64::from(end - below) / area([a, b, c]);
            self.slots.push([emitter.triangle, index, first + i as u32, 0]);
            self.emitters.extend([
                [a.x.to_bits(), a.y.to_bits(), a.z.to_bits(), emitter.triangle],
                bits(b, 0.0),
                bits(c, density as f32),
                [first + partners[i], (end - below).to_bits(), end.to_bits(), 0],
            ]);
            below = end;
        }
        let two_sided = material.double_sided;
        let whole = material.alpha == AlphaMode::Opaque;
        let uniform = material.emissive_texture.is_none() && whole;
        let triangles: Vec<[Vec3; 3]> = emitters.iter().map(corners).collect();
        let contours = if uniform { contours(&triangles, f64::from(radius)) } else { None };
        let start = self.vertices.len() as u32;
        for contour in contours.iter().flatten() {
            self.vertices.push(contour.normal.extend(contour.vertices.len() as f32 + 1.0).to_array());
            // Closed: the kernels need not remember the first vertex.
            let closed = contour.vertices.iter().chain(&contour.vertices[..1]);
            self.vertices.extend(closed.map(|v| v.extend(0.0).to_array()));
        }
        let viewed = is_closed_mesh(&triangles, two_sided)
            && VIEWED_TRIANGLES.contains(&emitters.len())
            && convex(&triangles, f64::from(radius));
        let views = self.vertices.len() as u32;
        if viewed {
            let powers: Vec<f64> = emitters.iter().map(|e| power(e) / total).collect();
            self.vertices.extend(cumulative_views(&triangles, &powers));
        }
        let none = [0; 4];
        let flag = |flag, on| if on { flag } else { 0 };
        let kind = MESH
            | flag(TWO_SIDED, two_sided)
            | flag(CLOSED_FORM, contours.is_some())
            | flag(COVERAGE, !whole)
            | flag(VIEWED, viewed);
        self.records.extend([
            [kind, first, emitters.len() as u32, start],
            bits(centre, radius),
            bits(material.emissive, 0.0),
            [views - start, views, 0, 0],
            none,
            none,
        ]);
        let sides = if two_sided { 2.0 } else { 1.0 };
        let normals = contours.iter().flatten().map(|contour| contour.normal);
        let power = total * std::f64::consts::PI * sides;
        let planar = contours.is_some() && normals.clone().all(|n| normals.clone().all(|m| m == n));
        let axis = normals.clone().next().filter(|_| planar && !two_sided);
        LightInfo {
            power,
            aimed,
            // Along the axis the radiance times the area; without one, the mean over all directions.
            emission: Emission { strength: axis.map_or(power / (4.0 * std::f64::consts::PI), |_| total), axis },
            closed_form: contours.is_some(),
            contour_edges: contours.iter().flatten().map(|contour| contour.vertices.len()).sum(),
            two_sided,
            punctual: false,
            planar,
            centre,
            radius,
        }
    }
}

/// Whether no corner lies above a triangle: from anywhere outside only triangles are seen that face the direction from the middle.
fn convex(triangles: &[[Vec3; 3]], radius: f64) -> bool {
    triangles.iter().all(|[a, b, c]| {
        let normal = (*b - *a).cross(*c - *a).as_dvec3().normalize_or_zero();
        let above = |corner: &Vec3| (*corner - *a).as_dvec3().dot(normal) > 1e-3 * radius;
        !triangles.iter().flatten().any(above)
    })
}

/// The cumulative probabilities of a light's triangles by what they show, power times cosine, in each direction of the
/// octahedral map, row by row; four to a record, the last ones 1.
fn cumulative_views(triangles: &[[Vec3; 3]], powers: &[f64]) -> Vec<[f32; 4]> {
    /// Directions of a cell a side, its border included, over which cosines are averaged.
    const DIRECTIONS: u32 = 5;
    /// A triangle that shows in some direction of the cell has this for a cosine at least.
    const LEAST: f64 = 1.0 / 64.0;
    // For directions between those that are tried.
    let turned = -0.25 / f64::from(VIEW_SIDE);
    let normals: Vec<DVec3> =
        triangles.iter().map(|[a, b, c]| (*b - *a).cross(*c - *a).as_dvec3().normalize_or_zero()).collect();
    let mut records = Vec::new();
    for cell in 0..VIEW_SIDE * VIEW_SIDE {
        let (column, row) = (cell % VIEW_SIDE, cell / VIEW_SIDE);
        let at = |place: u32, i: u32| {
            2.0 * (f64::from(place) + f64::from(i) / f64::from(DIRECTIONS - 1)) / f64::from(VIEW_SIDE) - 1.0
        };
        let directions: Vec<DVec3> = (0..DIRECTIONS * DIRECTIONS)
            .map(|i| oct_unwrap(at(column, i % DIRECTIONS), at(row, i / DIRECTIONS)))
            .collect();
        let shown = normals.iter().zip(powers).map(|(normal, power)| {
            let cosines = directions.iter().map(|direction| direction.dot(*normal));
            let mean = cosines.clone().map(|cosine| cosine.max(0.0)).sum::<f64>() / directions.len() as f64;
            let seen = cosines.fold(-1.0, f64::max) > turned;
            power * if seen { mean.max(LEAST) } else { 0.0 }
        });
        let shown: Vec<f64> = shown.collect();
        let total: f64 = shown.iter().sum();
        let mut sum = 0.0;
        let mut cumulative: Vec<f32> = shown
            .iter()
            .map(|shown| {
                sum += shown;
                (sum / total) as f32
            })
            .collect();
        cumulative.resize(cumulative.len().next_multiple_of(4), 1.0);
        if let Some(last) = cumulative.get_mut(triangles.len() - 1) {
            *last = 1.0;
        }
        records.extend(cumulative.chunks_exact(4).map(|four| [four[0], four[1], four[2], four[3]]));
    }
    records
}

/// The direction of a place in the octahedral map, -1 to 1 each way: as the kernels have it.
fn oct_unwrap(x: f64, y: f64) -> DVec3 {
    let z = 1.0 - x.abs() - y.abs();
    let fold = (-z).max(0.0);
    DVec3::new(x - fold.copysign(x), y - fold.copysign(y), z).normalize()
}

/// For each triangle one that faces about the other way and is its partner in turn, or itself where none is left.
fn partners(triangles: &[[Vec3; 3]]) -> Vec<u32> {
    /// Steps of a normal's coordinates that make a bucket: about 15 degrees.
    const STEPS: f32 = 4.0;
    let bucket = |n: Vec3| (n * STEPS).round().as_ivec3().to_array();
    let normals: Vec<Vec3> = triangles.iter().map(|[a, b, c]| (b - a).cross(c - a).normalize_or_zero()).collect();
    let mut waiting: std::collections::HashMap<[i32; 3], Vec<u32>> = std::collections::HashMap::new();
    let mut partners: Vec<u32> = (0..triangles.len() as u32).collect();
    for (i, normal) in normals.iter().enumerate() {
        match waiting.get_mut(&bucket(-*normal)).and_then(Vec::pop) {
            Some(other) => {
                partners[i] = other;
                partners[other as usize] = i as u32;
            }
            None => waiting.entry(bucket(*normal)).or_default().push(i as u32),
        }
    }
    partners
}

/// Height of the spherical cap into which a spot light of full intensity sends the same power.
pub(super) fn spot_height(cos_inner: f64, cos_outer: f64) -> f64 {
    // The falloff is the square of a ramp in the cosine: a third of it counts between the cones.
    (1.0 - cos_inner) + (cos_inner - cos_outer) / 3.0
}

/// A sphere around the points: about the middle of their box, of radius 0 where there is none.
pub(super) fn bounding_sphere(points: impl Iterator<Item = Vec3> + Clone) -> (Vec3, f32) {
    let (low, high) = points
        .clone()
        .fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(low, high), point| (low.min(point), high.max(point)));
    if low.x > high.x {
        return (Vec3::ZERO, 0.0);
    }
    let centre = (low + high) / 2.0;
    let radius = points.map(|point| point.as_dvec3().distance(centre.as_dvec3())).fold(0.0, f64::max);
    // Up, so that rounding leaves no point outside.
    (centre, (radius as f32).next_up())
}

/// A closed chain of edges in a plane, counter-clockwise about its normal; the edges of holes run clockwise.
struct Contour {
    normal: Vec3,
    vertices: Vec<Vec3>,
}

/// The contours of the triangles, those in one plane that face the same way merged; none where there are more than
/// [`MAX_CONTOUR_EDGES`] edges.
fn contours(triangles: &[[Vec3; 3]], radius: f64) -> Option<Vec<Contour>> {
    let mut planes: Vec<(DVec3, DVec3, Vec<usize>)> = Vec::new();
    // Large triangles first: their planes are the most exact.
    let normal = |[a, b, c]: [Vec3; 3]| (b - a).as_dvec3().cross((c - a).as_dvec3());
    let mut order: Vec<usize> = (0..triangles.len()).collect();
    order.sort_by(|&i, &j| normal(triangles[j]).length_squared().total_cmp(&normal(triangles[i]).length_squared()));
    for i in order {
        let n = normal(triangles[i]).normalize();
        let within = |plane: &(DVec3, DVec3, Vec<usize>)| {
            let near = |corner: Vec3| (corner.as_dvec3() - plane.1).dot(plane.0).abs() <= COPLANAR * radius;
            n.dot(plane.0) > 0.0 && triangles[i].into_iter().all(near)
        };
        match planes.iter().position(within) {
            Some(plane) => planes[plane].2.push(i),
            // Each plane has three edges at least.
            None if planes.len() * 3 >= MAX_CONTOUR_EDGES => return None,
            None => planes.push((n, triangles[i][0].as_dvec3(), vec![i])),
        }
    }
    let mut contours = Vec::new();
    for (normal, _, members) in planes {
        for chain in boundary(members.iter().map(|&i| triangles[i])) {
            let vertices = without_straight_corners(chain, COPLANAR * radius);
            // A chain that runs to and fro encloses nothing.
            if vertices.len() >= 3 {
                contours.push(Contour { normal: normal.as_vec3(), vertices });
            }
        }
    }
    let edges: usize = contours.iter().map(|contour| contour.vertices.len()).sum();
    (edges <= MAX_CONTOUR_EDGES).then_some(contours)
}

type Corner = [u32; 3];

/// The edges of triangles that no other triangle runs along the other way, joined to closed chains. Any way to join
/// them will do: the closed form sums over edges.
fn boundary(triangles: impl Iterator<Item = [Vec3; 3]>) -> Vec<Vec<Vec3>> {
    // Adding zero makes -0 and 0 the same corner.
    let key = |v: Vec3| (v + Vec3::ZERO).to_array().map(f32::to_bits);
    let mut edges: HashMap<(Corner, Corner), usize> = HashMap::new();
    let mut order: Vec<(Vec3, Vec3)> = Vec::new();
    for [a, b, c] in triangles {
        for (from, to) in [(a, b), (b, c), (c, a)] {
            let back = edges.entry((key(to), key(from))).or_default();
            if *back > 0 {
                *back -= 1;
            } else {
                *edges.entry((key(from), key(to))).or_default() += 1;
                order.push((from, to));
            }
        }
    }
    let mut next: HashMap<Corner, Vec<Vec3>> = HashMap::new();
    let mut starts = Vec::new();
    for (from, to) in order {
        let left = edges.entry((key(from), key(to))).or_default();
        if *left > 0 {
            *left -= 1;
            next.entry(key(from)).or_default().push(to);
            starts.push(from);
        }
    }
    let mut chains = Vec::new();
    for start in starts {
        let mut chain = Vec::new();
        let mut at = start;
        // Every corner has as many edges that leave as arrive, so that a chain ends where it began.
        while let Some(to) = next.get_mut(&key(at)).and_then(Vec::pop) {
            chain.push(at);
            at = to;
        }
        if !chain.is_empty() {
            chains.push(chain);
        }
    }
    chains
}

/// The chain without corners that lie within `tolerance` of the line between their neighbours.
fn without_straight_corners(mut chain: Vec<Vec3>, tolerance: f64) -> Vec<Vec3> {
    let mut i = 0;
    let mut kept = 0;
    // Once around without a corner to drop, and it is done.
    while chain.len() >= 3 && kept < chain.len() {
        let n = chain.len();
        let [a, b, c] = [(i + n - 1) % n, i % n, (i + 1) % n].map(|k| chain[k].as_dvec3());
        let along = (c - a).try_normalize();
        let off = along.map_or(0.0, |along| (b - a).cross(along).length());
        let between = (b - a).dot(c - b) >= 0.0;
        if off <= tolerance && (between || along.is_none()) {
            chain.remove(i % n);
            kept = 0;
            i %= chain.len();
        } else {
            kept += 1;
            i = (i + 1) % n;
        }
    }
    chain
}
