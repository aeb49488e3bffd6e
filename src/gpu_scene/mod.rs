//! The scene as the kernels read it: tables on the device, bound to kernels by the names of their variables.

mod bounds;
pub mod camera;
mod cumulative;
pub mod environment;
pub mod light_buffer;
pub mod lights;
pub mod receivers;
pub mod sheen;
pub mod sobol;
pub mod surfaces;
pub mod textures;

use std::mem;

use bytemuck::Pod;
pub use camera::CameraUniform;
use kernel_kit::{Binding, Bindings, Buffer, Gpu, Table, TableFormat, bindings};
pub use lights::GpuLights;
pub use receivers::ReceiverBounds;
pub use surfaces::GpuSurfaces;
pub use textures::GpuTextures;

use crate::Result;
use crate::bvh::{Bvh, InstanceTable};
use crate::kernels::scene_texels::{TRIANGLE_ALPHA, TRIANGLE_DOUBLE_SIDED};
use crate::procedural::Procedural;
use crate::scene::{AlphaMode, Camera, Scene};
use crate::specialisation::features::{Feature, Features};

/// A table that grows with the triangles of a scene: in layers, where one texture or buffer is too small.
fn growing_table<T: Pod>(
    gpu: &Gpu,
    features: &Features,
    label: &str,
    texels: &[[T; 4]],
    format: TableFormat,
) -> Result<Table> {
    Ok(match features.has(Feature::LayeredTexels) {
        true => gpu.layered_table(label, texels, format)?,
        false => gpu.table(label, texels, format)?,
    })
}

/// The scene on the device. It binds the variables of the modules in `shaders/lib/`.
pub struct GpuScene {
    /// The lights, on the device and for the host.
    pub lights: GpuLights,
    nodes: Table,
    packet_nodes: Option<Table>,
    triangles: Table,
    instances: Option<InstanceTable>,
    surfaces: GpuSurfaces,
    textures: GpuTextures,
    camera: Buffer,
    procedurals: Table,
    procedural_count: usize,
    /// Numbers of rays that passed through a procedural object since they were last read: because its function took too
    /// many iterations, and because it returned an invalid result.
    pub procedural_misses: Buffer,
    sheen_albedos: Option<Buffer>,
    /// Bytes on the device, padding not counted.
    pub bytes: u64,
}

impl GpuScene {
    /// Uploads a scene whose triangles are in the order of `bvh`.
    ///
    /// # Errors
    /// As [`Gpu::table`].
    pub fn new(
        gpu: &Gpu,
        scene: &Scene,
        mut bvh: Bvh,
        camera: &Camera,
        size: [u32; 2],
        features: &Features,
    ) -> Result<GpuScene> {
        for (index, triangle) in scene.triangles.iter().enumerate() {
            let material = &scene.materials[triangle.material as usize];
            let alpha = if material.alpha == AlphaMode::Opaque { 0 } else { TRIANGLE_ALPHA };
            let sides = if material.double_sided { TRIANGLE_DOUBLE_SIDED } else { 0 };
            bvh.set_triangle_word(index as u32, alpha | sides);
        }
        // Host copies are dropped once they are uploaded, because the largest scenes fill the host's memory.
        let mut hierarchy = 0;
        let packet_nodes = match features.has(Feature::Packets) {
            true => {
                let texels = bvh.packet_nodes();
                hierarchy += texels.len();
                Some(gpu.table("penumbra/scene/packet_nodes", &texels, TableFormat::Float)?)
            }
            false => None,
        };
        hierarchy += bvh.triangles.len() + bvh.nodes.len();
        let label = "penumbra/scene/bvh_triangles";
        let triangles = growing_table(gpu, features, label, &mem::take(&mut bvh.triangles), TableFormat::Float)?;
        let nodes = growing_table(gpu, features, "penumbra/scene/bvh_nodes", &bvh.nodes, TableFormat::Uint)?;
        drop((bvh.nodes, bvh.order));
        let (textures, material_textures) = GpuTextures::new(gpu, scene)?;
        let surfaces = GpuSurfaces::new(gpu, scene, &material_textures, features)?;
        let double_sided = |object: &Procedural| scene.materials[object.material as usize].double_sided;
        let procedurals: Vec<_> = scene.procedurals.iter().flat_map(|o| o.texels(double_sided(o))).collect();
        let texels = procedurals.len() + hierarchy + scene.triangles.len() * GpuSurfaces::stride(features);
        // Equation 1 compares numbers of photons, so each must represent the same share of its light: emission is not
        // restricted to the receiver bounds.
        let receivers = if features.has(Feature::VisibilityEstimate) { None } else { ReceiverBounds::of(scene) };
        let lights = GpuLights::new(gpu, scene, receivers)?;
        Ok(GpuScene {
            bytes: texels as u64 * 16 + textures.bytes + lights.bytes,
            lights,
            nodes,
            packet_nodes,
            triangles,
            camera: gpu.upload("penumbra/scene/camera", &[CameraUniform::new(camera, size[0], size[1])])?,
            sheen_albedos: features.has(Feature::Sheen).then(|| sheen::upload(gpu)).transpose()?,
            instances: bvh.instances,
            surfaces,
            textures,
            procedurals: gpu.table("penumbra/scene/procedural_texels", &procedurals, TableFormat::Float)?,
            procedural_count: scene.procedurals.len(),
            procedural_misses: gpu.buffer::<u32>("penumbra/scene/procedural_misses", 2)?,
        })
    }

    /// Records of the largest table that grows with the triangles.
    pub fn largest_table(scene: &Scene, bvh: &Bvh, features: &Features) -> usize {
        let surfaces = scene.triangles.len() * GpuSurfaces::stride(features);
        surfaces.max(bvh.nodes.len()).max(bvh.triangles.len())
    }

    /// Changes the camera, and the size of its image.
    pub fn set_camera(&self, gpu: &Gpu, camera: &Camera, size: [u32; 2]) {
        gpu.write(&self.camera, &[CameraUniform::new(camera, size[0], size[1])]);
    }

    /// The `override`s of the kernels that read the scene.
    pub fn constants(&self) -> Vec<(&'static str, f64)> {
        let mut constants = self.surfaces.constants();
        constants.extend(self.instances.iter().flat_map(InstanceTable::constants));
        constants.push(("procedural_count", self.procedural_count as f64));
        constants
    }
}

bindings! {
    /// The bindings of a scene without the lights, and the count of lost rays that kernels write.
    pub struct SceneBindings {
        /// The BVH; see `shaders/lib/bvh.wgsl`.
        pub bvh_nodes: &Table,
        /// The same for packets; see `shaders/lib/packet.wgsl`.
        pub packet_nodes: Option<&Table>,
        /// Triangles in the order of the BVH.
        pub bvh_triangles: &Table,
        /// Normals, texture coordinates and materials of the triangles.
        pub surface_texels: &Table,
        /// Materials; see `shaders/lib/material.wgsl`.
        pub material_texels: &Table,
        /// Texture infos; see `shaders/lib/texture.wgsl`.
        pub texture_infos: &Table,
        /// Texels of colours.
        pub colour_texels: &wgpu::TextureView,
        /// Texels of other data.
        pub data_texels: &wgpu::TextureView,
        /// Procedural objects; see `shaders/lib/procedural.wgsl`.
        pub procedural_texels: &Table,
        /// See [`GpuScene::procedural_misses`].
        pub procedural_misses: &Buffer,
        /// A [`CameraUniform`].
        pub camera: &Buffer,
        /// Albedos of the sheen lobe.
        pub sheen_albedos: Option<&Buffer>,
    }
}

impl GpuScene {
    /// The scene's bindings without the lights.
    fn bindings(&self) -> SceneBindings<'_> {
        SceneBindings {
            bvh_nodes: &self.nodes,
            packet_nodes: self.packet_nodes.as_ref(),
            bvh_triangles: &self.triangles,
            surface_texels: &self.surfaces.surfaces,
            material_texels: &self.surfaces.materials,
            texture_infos: &self.textures.infos,
            colour_texels: &self.textures.colour,
            data_texels: &self.textures.data,
            procedural_texels: &self.procedurals,
            procedural_misses: &self.procedural_misses,
            camera: &self.camera,
            sheen_albedos: self.sheen_albedos.as_ref(),
        }
    }
}

impl Bindings for GpuScene {
    fn get(&self, name: &str) -> Option<Binding<'_>> {
        self.bindings().find(name).or_else(|| self.lights.get(name))
    }
}

/// The direction of a position in the octahedral map, -1 to 1 each way, as in the kernels.
pub(crate) fn oct_unwrap(x: f64, y: f64) -> glam::DVec3 {
    let z = 1.0 - x.abs() - y.abs();
    let fold = (-z).max(0.0);
    glam::DVec3::new(x - fold.copysign(x), y - fold.copysign(y), z).normalize()
}

/// The unit vector of [`oct_encode16`].
pub(crate) fn oct_decode16(bits: u32) -> glam::DVec3 {
    let snorm = |bits: u32| (f64::from(bits as u16 as i16) / 32767.0).max(-1.0);
    oct_unwrap(snorm(bits), snorm(bits >> 16))
}

/// The unit vector of a photon's 14 bits; see `oct_encode7` of `shaders/lib/math.wgsl`.
pub(crate) fn oct_decode7(bits: u32) -> glam::DVec3 {
    let level = |bits: u32| (f64::from(bits & 127) - 63.0) / 63.0;
    oct_unwrap(level(bits), level(bits >> 7))
}

/// A unit vector in 32 bits: its octahedral image as two signed 16-bit fractions (Cigolle et al. 2014,
/// "A Survey of Efficient Representations for Independent Unit Vectors"); within 4e-5 rad.
pub(crate) fn oct_encode16(n: glam::Vec3) -> u32 {
    let n = n / (n.x.abs() + n.y.abs() + n.z.abs());
    let fold = |a: f32, b: f32| (1.0 - b.abs()) * if a >= 0.0 { 1.0 } else { -1.0 };
    let (x, y) = if n.z >= 0.0 { (n.x, n.y) } else { (fold(n.x, n.y), fold(n.y, n.x)) };
    let snorm = |v: f32| (v.clamp(-1.0, 1.0) * 32767.0).round() as i16 as u16 as u32;
    snorm(x) | snorm(y) << 16
}
