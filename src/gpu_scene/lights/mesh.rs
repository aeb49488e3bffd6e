//! Mesh lights: the triangles of one node and one emissive material.

use std::f64::consts::PI;
use std::ops::RangeInclusive;

use glam::{DVec3, Vec3};

use super::contour::{Contour, contours, plane_normal};
use super::emitter::{ConvexLamp, is_convex, partners};
use super::layout::{self, EMITTER_TEXELS, Emission, LightInfo, Packed, bits, texels};
use crate::gpu_scene::bounds::{area, centre_of_area, sphere_about};
use crate::gpu_scene::receivers::{ReceiverBounds, ReceiverCone};
use crate::scene::{AlphaMode, EmitterTriangle, Light, LightKind, Material, Scene};
use crate::specialisation::lights::{has_many_emitters, is_closed_mesh};

/// Numbers of triangles for which a light gets views. With fewer, it is enough to exclude triangles that face away;
/// with more, the smallest views would take more than 4 MB.
const VIEWED_TRIANGLES: RangeInclusive<usize> = layout::FEW_NEAR_EMITTERS as usize + 1..=1 << 12;

/// Cells along a side of the octahedral map of directions from which a convex light is seen; each is 7 to 2.4 degrees
/// wide. The contributions of the points of a sphere spread by 19 % about their mean with 16 cells, by 10 % with 48 and
/// by 8 % with 64 (320 triangles, seen from 40 radii), and by 59 % where triangles are sampled by power alone. In
/// `scenes/sphere.glb` relMSE of direct light with 16 samples was 1.6e-4, 0.8e-4 and 0.7e-4, measured before views took
/// the distance of the receivers into account.
const VIEW_SIDES: RangeInclusive<u32> = 16..=48;

/// Maximum bytes of the views of all lights, unless even the smallest take more. 3 MB take some 15 ms while kernels
/// compile.
const VIEW_BYTES: usize = 8 << 20;

/// Limit on the bytes of the smallest views of all lights. Beyond it no light gets views, and triangles are sampled by
/// power: 64 lamps of 1,000 triangles reach it. Views of a street of 1,500 such lamps would need more than a buffer of
/// many devices holds.
const MAX_VIEW_BYTES: usize = 64 << 20;

/// The data of mesh lights besides their texels in the table of lights.
pub(super) struct MeshTexels {
    /// Number of lights of many triangles, which may share [`VIEW_BYTES`].
    lamps: usize,
    /// Whether the views of all lights fit into [`MAX_VIEW_BYTES`].
    may_view: bool,
    /// Emitter triangles, [`EMITTER_TEXELS`] each.
    pub emitters: Vec<[u32; 4]>,
    /// For each emitter triangle, its primitive index, its light, and its index among the emitter triangles.
    pub primitives: Vec<[u32; 4]>,
    /// Contours and views.
    pub vertices: Vec<[f32; 4]>,
}

impl MeshTexels {
    /// Room for the lights of a scene.
    pub fn new(lights: &[Light]) -> MeshTexels {
        let lamps = lights.iter().filter(|light| has_many_emitters(light)).count();
        let fewest = |light: &Light| match &light.kind {
            LightKind::Mesh { emitters, .. } if VIEWED_TRIANGLES.contains(&emitters.len()) => {
                (VIEW_SIDES.start() * VIEW_SIDES.start()) as usize * bytes_of_cell(emitters.len())
            }
            _ => 0,
        };
        let may_view = lights.iter().map(fewest).sum::<usize>() <= MAX_VIEW_BYTES;
        MeshTexels { lamps, may_view, emitters: Vec::new(), primitives: Vec::new(), vertices: Vec::new() }
    }
}

/// A mesh light during packing.
struct MeshLight<'s> {
    material: &'s Material,
    emitters: &'s [EmitterTriangle],
    triangles: Vec<[Vec3; 3]>,
    /// Power of each triangle over pi and the number of its sides.
    powers: Vec<f64>,
    total: f64,
}

impl MeshLight<'_> {
    fn new<'s>(scene: &'s Scene, material: u32, emitters: &'s [EmitterTriangle]) -> MeshLight<'s> {
        let triangles: Vec<_> = emitters.iter().map(|e| scene.triangle_positions(e.triangle as usize)).collect();
        let power =
            |(e, triangle): (&EmitterTriangle, &[Vec3; 3])| area(triangle) * e.radiance.as_dvec3().element_sum() / 3.0;
        let powers: Vec<f64> = emitters.iter().zip(&triangles).map(power).collect();
        let total = powers.iter().sum();
        MeshLight { material: &scene.materials[material as usize], emitters, triangles, powers, total }
    }

    /// Adds its emitter triangles, and returns the index of the first.
    fn push_emitters(&self, tables: &mut MeshTexels, light: u32) -> u32 {
        let first = tables.emitters.len() as u32 / EMITTER_TEXELS;
        // Both sides of a double-sided triangle emit, so none faces away.
        let partners = match self.material.double_sided {
            true => (0..self.emitters.len() as u32).collect(),
            false => partners(&self.triangles),
        };
        let mut cumulative = 0.0;
        let mut below = 0f32;
        for (i, (emitter, triangle)) in self.emitters.iter().zip(&self.triangles).enumerate() {
            let [a, b, c] = *triangle;
            cumulative += self.powers[i];
            // Kernels compare with the rounded cumulative probabilities, so each probability is a difference of these.
            let rounded = (cumulative / self.total) as f32;
            // Of millions of triangles, many have a probability below an ULP. Raised to an ULP, they still give light.
            let least = if self.powers[i] > 0.0 { below.next_up().min(1.0) } else { below };
            let end = if i + 1 == self.emitters.len() { 1.0 } else { rounded.max(least) };
            let density = f64::from(end - below) / area(triangle);
            tables.primitives.push([emitter.triangle, light, first + i as u32, 0]);
            tables.emitters.extend([
                [a.x.to_bits(), a.y.to_bits(), a.z.to_bits(), emitter.triangle],
                bits(b, 0.0),
                bits(c, density as f32),
                [first + partners[i], (end - below).to_bits(), end.to_bits(), 0],
            ]);
            below = end;
        }
        first
    }

    /// Adds the views of the light, if it gets any, and returns the number of cells a side.
    fn push_views(
        &self,
        tables: &mut MeshTexels,
        (centre, radius): (Vec3, f32),
        receivers: Option<ReceiverBounds>,
    ) -> Option<u32> {
        let viewed = tables.may_view
            && is_closed_mesh(&self.triangles, self.material.double_sided)
            && VIEWED_TRIANGLES.contains(&self.emitters.len())
            && is_convex(&self.triangles, f64::from(radius));
        viewed.then(|| {
            let side = view_side(self.emitters.len(), tables.lamps);
            let powers: Vec<f64> = self.powers.iter().map(|power| power / self.total).collect();
            let lamp = ConvexLamp { triangles: &self.triangles, powers: &powers, centre, radius };
            tables.vertices.extend(lamp.cumulative_views(side, receivers));
            side
        })
    }

    /// The share of its emission towards the receiver bounds: the mean over the centroids of its triangles.
    fn received_share(&self, bounds: ReceiverBounds) -> f64 {
        let (mut sum, mut total) = (0.0, 0.0);
        for (emitter, [a, b, c]) in self.emitters.iter().zip(&self.triangles) {
            let across = (*b - *a).as_dvec3().cross((*c - *a).as_dvec3());
            let power = across.length() * emitter.radiance.as_dvec3().element_sum();
            let cone = bounds.cone_from((*a + *b + *c) / 3.0);
            let share = |normal: DVec3| cone.as_ref().map_or(1.0, |cone: &ReceiverCone| cone.share(normal));
            let normal = across.normalize();
            let two_sided = self.material.double_sided;
            sum += power * if two_sided { (share(normal) + share(-normal)) / 2.0 } else { share(normal) };
            total += power;
        }
        if total > 0.0 { sum / total } else { 1.0 }
    }
}

/// Cells along a side of the views of a light with `triangles` triangles, if `lamps` lights get views. It is even; see
/// [`ConvexLamp::cumulative_views`].
fn view_side(triangles: usize, lamps: usize) -> u32 {
    let cells = VIEW_BYTES / lamps / bytes_of_cell(triangles);
    (cells.isqrt() as u32 / 2 * 2).clamp(*VIEW_SIDES.start(), *VIEW_SIDES.end())
}

/// Bytes of a cell of the views of a light with this number of triangles.
fn bytes_of_cell(triangles: usize) -> usize {
    triangles.div_ceil(4) * size_of::<[f32; 4]>()
}

fn push_contours(tables: &mut MeshTexels, contours: &[Contour]) {
    for contour in contours {
        tables.vertices.push(contour.normal.extend(contour.vertices.len() as f32 + 1.0).to_array());
        // The first vertex is repeated at the end, so that kernels need not remember it.
        let closed = contour.vertices.iter().chain(&contour.vertices[..1]);
        tables.vertices.extend(closed.map(|v| v.extend(0.0).to_array()));
    }
}

/// Packs the mesh light of index `light` in the scene.
pub(super) fn pack(
    tables: &mut MeshTexels,
    scene: &Scene,
    light: u32,
    (material, emitters): (u32, &[EmitterTriangle]),
    receivers: Option<ReceiverBounds>,
) -> Packed {
    let mesh = MeshLight::new(scene, material, emitters);
    let material = mesh.material;
    let (centre, radius) = sphere_about(centre_of_area(&mesh.triangles), mesh.triangles.iter().flatten().copied());
    let first = mesh.push_emitters(tables, light);
    let two_sided = material.double_sided;
    let whole = material.alpha == AlphaMode::Opaque;
    let uniform = material.emissive_texture.is_none() && whole && !material.emits_into_volume();
    let contours = if uniform { contours(&mesh.triangles, f64::from(radius)) } else { None };
    let start = tables.vertices.len() as u32;
    push_contours(tables, contours.as_deref().unwrap_or_default());
    let views = tables.vertices.len() as u32;
    let view_side = mesh.push_views(tables, (centre, radius), receivers);
    let flag = |flag, on| if on { flag } else { 0 };
    let kind = layout::MESH
        | flag(layout::TWO_SIDED, two_sided)
        | flag(layout::CLOSED_FORM, contours.is_some())
        | flag(layout::COVERAGE, !whole)
        | flag(layout::VIEWED, view_side.is_some());
    let sides = if two_sided { 2.0 } else { 1.0 };
    let power = mesh.total * PI * sides;
    let axis = contours.as_deref().filter(|_| !two_sided).and_then(|all| plane_normal(all, f64::from(radius)));
    Packed {
        texels: texels([
            (layout::KIND_TEXEL, [kind, first, emitters.len() as u32, start]),
            (layout::SPHERE_TEXEL, bits(centre, radius)),
            (layout::EMISSION_TEXEL, bits(material.emissive, 0.0)),
            (layout::CONTOUR_TEXEL, [views - start, views, view_side.unwrap_or(0), 0]),
        ]),
        info: LightInfo {
            power,
            received_share: receivers.map_or(1.0, |bounds| mesh.received_share(bounds)),
            // With an axis, radiance times area along it; without one, the mean over all directions.
            emission: Emission { strength: axis.map_or(power / (4.0 * PI), |_| mesh.total), axis },
            closed_form: contours.is_some(),
            contour_edges: contours.iter().flatten().map(|contour| contour.vertices.len()).sum(),
            two_sided,
            punctual: false,
            viewed: view_side.is_some(),
            centre,
            radius,
        },
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Triangles whose share of the power is less than an ULP get a probability above 0, and their density takes it
    /// into account.
    #[test]
    fn the_faintest_triangles_are_sampled() {
        let triangles = vec![[Vec3::ZERO, Vec3::X, Vec3::Y]; 4];
        let emitters: Vec<_> = (0..4).map(|triangle| EmitterTriangle { triangle, radiance: Vec3::ONE }).collect();
        let powers = vec![1.0, 1e-9, 1e-9, 1.0];
        let material = Material::default();
        let mesh =
            MeshLight { material: &material, emitters: &emitters, triangles, total: powers.iter().sum(), powers };
        let mut tables = MeshTexels::new(&[]);
        mesh.push_emitters(&mut tables, 0);
        for texels in tables.emitters.chunks(EMITTER_TEXELS as usize) {
            let [density, probability] = [texels[2][3], texels[3][1]].map(f32::from_bits);
            // The triangles have an area of a half.
            assert!(probability > 0.0 && density == 2.0 * probability, "{probability}, {density}");
        }
    }

    /// 64 lamps of 1,000 triangles get views; of 66 lamps, none does.
    #[test]
    fn views_of_many_lamps_are_left_out() {
        let emitter = EmitterTriangle { triangle: 0, radiance: Vec3::ONE };
        let mesh = || LightKind::Mesh { material: 0, emitters: vec![emitter; 1000] };
        let lamp = || Light { name: String::new(), kind: mesh() };
        let may_view = |count: usize| MeshTexels::new(&vec![lamp(); count]).may_view;
        assert!(may_view(64) && !may_view(66));
    }
}
