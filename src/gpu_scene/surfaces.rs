//! The attributes of a hit besides the triangle's corners: normals, texture coordinates, colours, tangents, materials.

use glam::{Mat2, Vec3, Vec4};
use kernel_kit::{Gpu, Table, TableFormat};
use rayon::prelude::*;

use super::textures::MaterialTextures;
use super::{growing_table, oct_encode16};
use crate::Result;
use crate::kernels::scene_texels::SURFACE_FLAT;
use crate::scene::{Scene, Triangle};
use crate::specialisation::features::{Feature, Features};
use crate::specialisation::lobes::LOBES;

/// The tables behind `surface_texels` and `material_texels`.
pub struct GpuSurfaces {
    /// Texels of the triangles: as many per triangle as the scene requires.
    pub surfaces: Table,
    /// Texels of the materials: a fixed number per material.
    pub materials: Table,
    layout: Layout,
}

/// The texels of a triangle: only those that the scene needs.
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
        let mut take = |feature: Feature, texels: u32| {
            features.has(feature).then(|| {
                stride += texels;
                stride - texels
            })
        };
        let uv1 = features.has(Feature::Uv1);
        let uv = take(Feature::Textures, if uv1 { 3 } else { 2 });
        let colour = take(Feature::VertexColours, 2);
        let lobes = LOBES.iter().filter(|lobe| lobe.tangents).map(|lobe| lobe.feature);
        let tangents = std::iter::once(Feature::NormalMaps).chain(lobes).find(|feature| features.has(*feature));
        let tangent = tangents.and_then(|feature| take(feature, 1));
        Layout { uv, uv1, colour, tangent, stride }
    }
}

impl GpuSurfaces {
    /// Uploads the surfaces of the scene, whose triangles are in the order of the BVH.
    ///
    /// # Errors
    /// As [`Gpu::table`].
    pub fn new(gpu: &Gpu, scene: &Scene, textures: &[MaterialTextures], features: &Features) -> Result<GpuSurfaces> {
        let layout = Layout::new(features);
        let stride = layout.stride as usize;
        let mut texels = vec![[0; 4]; scene.triangles.len() * stride];
        texels
            .par_chunks_exact_mut(stride)
            .zip(&scene.triangles)
            .for_each(|(own, triangle)| write_triangle(own, scene, triangle, &layout));
        let scale = scene.normalisation.scale();
        let materials: Vec<[u32; 4]> =
            scene.materials.iter().zip(textures).flat_map(|(material, infos)| material.texels(scale, infos)).collect();
        Ok(GpuSurfaces {
            surfaces: growing_table(gpu, features, "penumbra/scene/surface_texels", &texels, TableFormat::Uint)?,
            materials: gpu.table("penumbra/scene/material_texels", &materials, TableFormat::Uint)?,
            layout,
        })
    }

    /// Texels of a triangle.
    pub fn stride(features: &Features) -> usize {
        Layout::new(features).stride as usize
    }

    /// The `override`s of the kernels that read surfaces.
    pub fn constants(&self) -> Vec<(&'static str, f64)> {
        let Layout { uv, colour, tangent, stride, .. } = self.layout;
        let focusing_alpha = f64::from(crate::specialisation::FOCUSING_ALPHA);
        let mut constants = vec![
            ("surface_stride", f64::from(stride)),
            ("focusing_alpha", focusing_alpha),
            ("min_hit_probability", crate::specialisation::MIN_HIT_PROBABILITY),
            ("min_sheen_roughness", crate::scene::sheen::MIN_ROUGHNESS),
        ];
        let optional = [("uv_offset", uv), ("colour_offset", colour), ("tangent_offset", tangent)];
        constants.extend(optional.into_iter().filter_map(|(name, at)| Some((name, f64::from(at?)))));
        constants
    }
}

fn write_triangle(texels: &mut [[u32; 4]], scene: &Scene, triangle: &Triangle, layout: &Layout) {
    let corners = triangle.vertices.map(|v| scene.vertices[v as usize]);
    let flat = scene.is_flat(triangle);
    let [n0, n1, n2] = corners.map(|c| if flat { 0 } else { oct_encode16(c.normal) });
    texels[0] = [n0, n1, n2, triangle.material | if flat { SURFACE_FLAT } else { 0 }];
    if let Some(at) = layout.uv {
        let texels = &mut texels[at as usize..];
        let pair = |set: usize, corner: usize| corners[corner].uv[set].to_array().map(f32::to_bits);
        let pairs = |a: [u32; 2], b: [u32; 2]| [a[0], a[1], b[0], b[1]];
        texels[0] = pairs(pair(0, 0), pair(0, 1));
        texels[1] = pairs(pair(0, 2), if layout.uv1 { pair(1, 0) } else { [0; 2] });
        if layout.uv1 {
            texels[2] = pairs(pair(1, 1), pair(1, 2));
        }
    }
    if let Some(at) = layout.colour {
        let texels = &mut texels[at as usize..];
        let unorm = |v: f32| (v.clamp(0.0, 1.0) * 65535.0).round() as u32;
        let words =
            corners.map(|c| [unorm(c.colour.x) | unorm(c.colour.y) << 16, unorm(c.colour.z) | unorm(c.colour.w) << 16]);
        texels[0] = [words[0][0], words[0][1], words[1][0], words[1][1]];
        texels[1] = [words[2][0], words[2][1], 0, 0];
    }
    if let Some(at) = layout.tangent {
        let computed = uv_tangent(scene, triangle);
        let tangents = corners.map(|c| if c.tangent == Vec4::ZERO { computed } else { c.tangent });
        let signs = (0..3).fold(0, |bits, i| bits | u32::from(tangents[i].w < 0.0) << i);
        let [t0, t1, t2] = tangents.map(|t| oct_encode16(t.truncate()));
        texels[at as usize] = [t0, t1, t2, signs];
    }
}

/// The tangent for files without tangents: the direction of increasing u over the triangle, in the coordinates in which
/// the texture is read (KHR_texture_transform). Its handedness makes the bitangent point up the image, against v, as
/// the green of a normal map does. Unlike MikkTSpace, which glTF names, it does not average between triangles.
fn uv_tangent(scene: &Scene, triangle: &Triangle) -> Vec4 {
    let material = &scene.materials[triangle.material as usize];
    let read = material.tangent_textures().next();
    let (set, matrix) = read.map_or((0, Mat2::IDENTITY), |info| (info.uv_set as usize, info.matrix));
    let [a, b, c] = triangle.vertices.map(|v| scene.vertices[v as usize]);
    let (e1, e2) = (b.position - a.position, c.position - a.position);
    let (d1, d2) = (matrix * (b.uv[set] - a.uv[set]), matrix * (c.uv[set] - a.uv[set]));
    let determinant = d1.x * d2.y - d2.x * d1.y;
    let tangent = (e1 * d2.y - e2 * d1.y) * determinant.signum();
    // If the texture coordinates do not span a plane, any direction in the triangle will do.
    let tangent = tangent.try_normalize().or_else(|| e1.try_normalize()).unwrap_or(Vec3::X);
    tangent.extend(if determinant < 0.0 { 1.0 } else { -1.0 })
}

#[cfg(test)]
mod tests {
    use std::f32::consts::FRAC_PI_2;
    use std::sync::Arc;

    use glam::Vec2;

    use super::*;
    use crate::scene::{Material, NO_LIGHT, TextureInfo, Vertex};

    /// A computed tangent is the direction of u in the texture as it is turned and mirrored. The image is upright on
    /// the triangle: its v runs down.
    #[test]
    fn tangents_follow_the_transform_of_the_texture() {
        let tangent = |matrix: Mat2| {
            let corner = |x: f32, y: f32| Vertex {
                position: Vec3::new(x, y, 0.0),
                uv: [Vec2::new(x, 1.0 - y); 2],
                ..Vertex::default()
            };
            let normal_texture = Some(TextureInfo { texture: 0, uv_set: 0, matrix, offset: Vec2::ZERO });
            let scene = Scene {
                vertices: Arc::new(vec![corner(0.0, 0.0), corner(1.0, 0.0), corner(0.0, 1.0)]),
                materials: vec![Material { normal_texture, ..Material::default() }],
                ..Scene::default()
            };
            uv_tangent(&scene, &Triangle { vertices: [0, 1, 2], material: 0, light: NO_LIGHT })
        };
        let near = |matrix: Mat2, expected: [f32; 4]| (tangent(matrix) - Vec4::from(expected)).length() < 1e-6;
        assert!(near(Mat2::IDENTITY, [1.0, 0.0, 0.0, 1.0]));
        // Texture coordinates are turned: u grows upward.
        assert!(near(Mat2::from_angle(FRAC_PI_2), [0.0, 1.0, 0.0, 1.0]));
        assert!(near(Mat2::from_diagonal(Vec2::new(-2.0, 1.0)), [-1.0, 0.0, 0.0, -1.0]));
    }
}
