//! What a hit needs beyond the triangle's corners: normals, texture coordinates, colours, tangents, materials.

use glam::{Vec3, Vec4};

use crate::Result;
use crate::gpu::buffer::TableFormat;
use crate::gpu::{Features, Gpu, Table};
use crate::scene::{AlphaMode, Material, Scene, Triangle, Volume};

use super::oct_encode16;
use super::textures::MaterialSlots;

/// The tables behind `surface_records` and `material_records`.
pub struct GpuSurfaces {
    /// As many records a triangle as the scene needs.
    pub surfaces: Table,
    /// A fixed number of records a material.
    pub materials: Table,
    layout: Layout,
}

/// Which records a triangle has: only those that the scene needs.
#[derive(Clone, Copy, Debug)]
struct Layout {
    uv: Option<u32>,
    uv1: bool,
    colour: Option<u32>,
    tangent: Option<u32>,
    stride: u32,
}

impl Layout {
    fn new(features: &Features) -> Self {
        let mut stride = 1;
        let mut take = |feature: &str, records: u32| {
            features.has(feature).then(|| {
                stride += records;
                stride - records
            })
        };
        let uv1 = features.has("uv1");
        let uv = take("textures", if uv1 { 3 } else { 2 });
        let colour = take("vertex_colours", 2);
        let tangents = ["normal_maps", "coat_normals", "anisotropy"].into_iter().find(|name| features.has(name));
        let tangent = tangents.and_then(|name| take(name, 1));
        Layout { uv, uv1, colour, tangent, stride }
    }
}

/// Bit of a triangle's material word: it is flat, and its corners' normals say nothing.
pub(crate) const FLAT: u32 = 1 << 31;

impl GpuSurfaces {
    /// Uploads the surfaces of the scene, whose triangles are in the order of the BVH.
    ///
    /// # Errors
    /// As [`Gpu::table`].
    pub fn new(gpu: &Gpu, scene: &Scene, slots: &[MaterialSlots], features: &Features) -> Result<GpuSurfaces> {
        let layout = Layout::new(features);
        let mut records = Vec::with_capacity(scene.triangles.len() * layout.stride as usize);
        for triangle in &scene.triangles {
            push_triangle(&mut records, scene, triangle, &layout);
        }
        let materials: Vec<[u32; 4]> =
            scene.materials.iter().zip(slots).flat_map(|(m, s)| material_records(scene, m, s)).collect();
        Ok(GpuSurfaces {
            surfaces: gpu.table("penumbra/scene/surface_records", &records, TableFormat::Uint)?,
            materials: gpu.table("penumbra/scene/material_records", &materials, TableFormat::Uint)?,
            layout,
        })
    }

    /// Records a triangle.
    pub fn stride(&self) -> usize {
        self.layout.stride as usize
    }

    /// The `override`s of the kernels that read surfaces.
    pub fn constants(&self) -> Vec<(&'static str, f64)> {
        let Layout { uv, colour, tangent, stride, .. } = self.layout;
        let focusing_alpha = f64::from(crate::specialisation::FOCUSING_ALPHA);
        let mut constants = vec![
            ("surface_stride", f64::from(stride)),
            ("focusing_alpha", focusing_alpha),
            ("least_sheen_roughness", super::sheen::LEAST_ROUGHNESS),
        ];
        let optional = [("uv_record", uv), ("colour_record", colour), ("tangent_record", tangent)];
        constants.extend(optional.into_iter().filter_map(|(name, at)| Some((name, f64::from(at?)))));
        constants
    }
}

fn push_triangle(records: &mut Vec<[u32; 4]>, scene: &Scene, triangle: &Triangle, layout: &Layout) {
    let corners = triangle.vertices.map(|v| scene.vertices[v as usize]);
    let flat = scene.is_flat(triangle);
    let [n0, n1, n2] = corners.map(|c| if flat { 0 } else { oct_encode16(c.normal) });
    records.push([n0, n1, n2, triangle.material | if flat { FLAT } else { 0 }]);
    if layout.uv.is_some() {
        let pair = |set: usize, corner: usize| corners[corner].uv[set].to_array().map(f32::to_bits);
        let record = |a: [u32; 2], b: [u32; 2]| [a[0], a[1], b[0], b[1]];
        records.push(record(pair(0, 0), pair(0, 1)));
        records.push(record(pair(0, 2), if layout.uv1 { pair(1, 0) } else { [0; 2] }));
        if layout.uv1 {
            records.push(record(pair(1, 1), pair(1, 2)));
        }
    }
    if layout.colour.is_some() {
        let unorm = |v: f32| (v.clamp(0.0, 1.0) * 65535.0).round() as u32;
        let words =
            corners.map(|c| [unorm(c.colour.x) | unorm(c.colour.y) << 16, unorm(c.colour.z) | unorm(c.colour.w) << 16]);
        records.push([words[0][0], words[0][1], words[1][0], words[1][1]]);
        records.push([words[2][0], words[2][1], 0, 0]);
    }
    if layout.tangent.is_some() {
        let computed = uv_tangent(scene, triangle);
        let tangents = corners.map(|c| if c.tangent == Vec4::ZERO { computed } else { c.tangent });
        let signs = (0..3).fold(0, |bits, i| bits | u32::from(tangents[i].w < 0.0) << i);
        let [t0, t1, t2] = tangents.map(|t| oct_encode16(t.truncate()));
        records.push([t0, t1, t2, signs]);
    }
}

/// The direction of growing u over the triangle, and the handedness of u and v: what glTF asks for where a file
/// has no tangents, without MikkTSpace's averaging between triangles.
fn uv_tangent(scene: &Scene, triangle: &Triangle) -> Vec4 {
    let material = &scene.materials[triangle.material as usize];
    let set = [material.normal_texture, material.clearcoat_normal_texture, material.anisotropy_texture];
    let set = set.into_iter().flatten().next().map_or(0, |slot| slot.uv_set as usize);
    let [a, b, c] = triangle.vertices.map(|v| scene.vertices[v as usize]);
    let (e1, e2) = (b.position - a.position, c.position - a.position);
    let (d1, d2) = (b.uv[set] - a.uv[set], c.uv[set] - a.uv[set]);
    let determinant = d1.x * d2.y - d2.x * d1.y;
    let tangent = (e1 * d2.y - e2 * d1.y) * determinant.signum();
    // Texture coordinates that do not span a plane: any direction in the triangle will do.
    let tangent = tangent.try_normalize().or_else(|| e1.try_normalize()).unwrap_or(Vec3::X);
    tangent.extend(if determinant < 0.0 { -1.0 } else { 1.0 })
}

/// Bits of a material's flags.
pub(crate) const DOUBLE_SIDED: u32 = 1;
pub(crate) const UNLIT: u32 = 2;
pub(crate) const MASK: u32 = 4;
pub(crate) const BLEND: u32 = 8;
/// Records a material.
pub(crate) const MATERIAL_RECORDS: u32 = 12;

/// Indices of refraction nearer to 1 bend light by less than its half vector, a difference, has digits for.
const LEAST_BENDING: f32 = 1e-3;

/// Absorption by normalised length: over the attenuation distance, light becomes the attenuation colour (Beer and Lambert).
fn absorption(volume: &Volume, scale: f64) -> [f32; 3] {
    let distance = f64::from(volume.attenuation_distance) * scale;
    // What nothing passes still has a logarithm: e^-80 is less than any radiance that shows.
    volume.attenuation_colour.to_array().map(|c| (-f64::from(c).ln().max(-80.0) / distance) as f32)
}

fn material_records(scene: &Scene, m: &Material, slots: &MaterialSlots) -> [[u32; 4]; MATERIAL_RECORDS as usize] {
    let bits = |v: [f32; 4]| v.map(f32::to_bits);
    let (alpha, cutoff) = match m.alpha {
        AlphaMode::Opaque => (0, 0.0),
        AlphaMode::Mask { cutoff } => (MASK, cutoff),
        AlphaMode::Blend => (BLEND, 0.0),
    };
    let flags = alpha | if m.double_sided { DOUBLE_SIDED } else { 0 } | if m.unlit { UNLIT } else { 0 };
    // Reflectance at normal incidence, KHR_materials_ior.
    let f0 = ((m.ior - 1.0) / (m.ior + 1.0)).powi(2);
    let emissive = m.emissive.to_array();
    let bends = m.volume.is_some() && (m.ior - 1.0).abs() >= LEAST_BENDING;
    // An index of 0 stands for an infinite one, which reflects all.
    let refraction = if bends && m.ior > 0.0 { m.ior } else { 1.0 };
    let [red, green, blue] = m.volume.map_or([0.0; 3], |volume| absorption(&volume, scene.normalisation.scale()));
    [
        bits(m.base_colour.to_array()),
        bits([emissive[0], emissive[1], emissive[2], m.metallic]),
        bits([m.roughness, f0, m.specular, m.normal_scale]),
        bits(m.specular_colour.extend(cutoff).to_array()),
        [flags, slots.base_colour, slots.metallic_roughness, slots.normal],
        [slots.emissive, slots.specular, slots.specular_colour, slots.clearcoat_normal],
        bits([m.transmission, red, green, blue]),
        bits([refraction, m.clearcoat, m.clearcoat_roughness, m.clearcoat_normal_scale]),
        [slots.transmission, slots.clearcoat, slots.clearcoat_roughness, slots.anisotropy],
        bits([m.anisotropy, m.anisotropy_rotation.cos(), m.anisotropy_rotation.sin(), 0.0]),
        bits(m.sheen_colour.extend(m.sheen_roughness).to_array()),
        [slots.sheen_colour, slots.sheen_roughness, 0, 0],
    ]
}
