//! Lights as the kernels read them: the table of lights, emitter triangles and contours. Each kind of light is a file.

mod contour;
mod directional;
mod emitter;
mod environment;
pub(crate) mod layout;
mod mesh;
mod point;
mod spot;

use std::cell::OnceCell;

use glam::Vec3;
use kernel_kit::{Binding, Bindings, Buffer, Gpu, Table, TableFormat, bindings};
use rayon::prelude::*;

use super::bounds::bounding_sphere_of_scene;
use super::environment::GpuEnvironment;
use super::receivers::ReceiverBounds;
use super::{oct_encode16, sobol};
use crate::Result;
use crate::scene::{Light, LightKind, Scene};

use layout::{EMITTER_TEXELS, LightTexels, NO_AXIS, Packed, SAMPLING_TEXEL, bits};
use mesh::MeshTexels;

pub use layout::{Emission, LightInfo};

/// The scene's lights on the device, bound by the names `light_texels`, `emitter_texels`, `light_vertices`,
/// `environment_texels` and `sobol_directions`.
pub struct GpuLights {
    /// Power, emission and bounds of each light, in the scene's order.
    pub lights: Vec<LightInfo>,
    /// The panorama, where there is one.
    pub environment: Option<GpuEnvironment>,
    /// Bytes of the lights on the device, the panorama included.
    pub bytes: u64,
    lights_table: Table,
    emitters: Table,
    vertices: Table,
    sobol: Buffer,
}

impl GpuLights {
    /// Uploads the lights of a scene whose triangles are in the order of the BVH. With `receivers`, lights emit photons
    /// only towards these bounds.
    ///
    /// # Errors
    /// As [`Gpu::table`].
    pub fn new(gpu: &Gpu, scene: &Scene, receivers: Option<ReceiverBounds>) -> Result<GpuLights> {
        let environment = match scene.lights.last() {
            Some(Light { kind: LightKind::Environment { panorama, turn, strength }, .. }) => {
                Some(GpuEnvironment::new(gpu, panorama, *turn, *strength)?)
            }
            _ => None,
        };
        let irradiance = environment.as_ref().map_or(0.0, |environment| environment.irradiance);
        let lit = LitScene { scene, irradiance, receivers, sphere: OnceCell::new() };
        let mut meshes = MeshTexels::new(&scene.lights);
        let mut lights = Vec::with_capacity(scene.lights.len());
        let mut texels: Vec<LightTexels> = Vec::with_capacity(scene.lights.len());
        for (index, light) in scene.lights.iter().enumerate() {
            let packed = pack(&mut meshes, &lit, index as u32, &light.kind);
            lights.push(packed.info);
            texels.push(packed.texels);
        }
        meshes.primitives.sort_unstable();
        add_sampling(&mut texels, &lights);
        let header = [scene.lights.len() as u32, meshes.emitters.len() as u32 / EMITTER_TEXELS, 0, 0];
        let mut table = vec![header, receivers.map_or([0; 4], |bounds| bits(bounds.centre, bounds.radius))];
        table.extend(texels.into_flattened());
        meshes.emitters.extend(meshes.primitives);
        let records = table.len() + meshes.emitters.len() + meshes.vertices.len();
        let panorama = environment.as_ref().map_or(0, |environment| environment.bytes);
        Ok(GpuLights {
            bytes: records as u64 * 16 + panorama,
            lights,
            environment,
            lights_table: gpu.table("penumbra/scene/light_texels", &table, TableFormat::Uint)?,
            emitters: gpu.table("penumbra/scene/emitter_texels", &meshes.emitters, TableFormat::Uint)?,
            vertices: gpu.table("penumbra/scene/light_vertices", &meshes.vertices, TableFormat::Float)?,
            sobol: sobol::upload(gpu)?,
        })
    }
}

bindings! {
    /// The tables of the lights.
    pub struct LightBindings {
        /// See `shaders/lib/light/table.wgsl`.
        pub light_texels: &Table,
        /// Emitter triangles of mesh lights, and the list in the order of their primitives.
        pub emitter_texels: &Table,
        /// Contours and views of mesh lights.
        pub light_vertices: &Table,
        /// The panorama; see `shaders/lib/environment.wgsl`.
        pub environment_texels: Option<&Table>,
        /// Direction numbers of the Sobol sequence.
        pub sobol_directions: &Buffer,
    }
}

impl GpuLights {
    /// The lights' bindings.
    fn bindings(&self) -> LightBindings<'_> {
        LightBindings {
            light_texels: &self.lights_table,
            emitter_texels: &self.emitters,
            light_vertices: &self.vertices,
            environment_texels: self.environment.as_ref().map(|environment| &environment.table),
            sobol_directions: &self.sobol,
        }
    }
}

impl Bindings for GpuLights {
    fn get(&self, name: &str) -> Option<Binding<'_>> {
        self.bindings().find(name)
    }
}

/// The parts of the scene that packing a light needs.
struct LitScene<'a> {
    scene: &'a Scene,
    /// The environment's.
    irradiance: f64,
    receivers: Option<ReceiverBounds>,
    sphere: OnceCell<(Vec3, f32)>,
}

impl LitScene<'_> {
    /// A sphere around the scene, for the lights that are infinitely far away. All of them share it: for ten thousand
    /// vertices, computing it takes as long as packing a hundred lights.
    fn sphere(&self) -> (Vec3, f32) {
        *self.sphere.get_or_init(|| {
            let objects = self.scene.procedurals.par_iter().flat_map_iter(|object| object.corners());
            bounding_sphere_of_scene(self.scene.placed_vertices().chain(objects))
        })
    }
}

/// Packs the light with the index `index`, by its kind.
fn pack(meshes: &mut MeshTexels, lit: &LitScene<'_>, index: u32, kind: &LightKind) -> Packed {
    let receivers = lit.receivers;
    match kind {
        LightKind::Mesh { material, emitters } => {
            mesh::pack(meshes, lit.scene, index, (*material, emitters), receivers)
        }
        LightKind::Point { position, intensity, range } => point::pack(*position, *intensity, *range, receivers),
        LightKind::Spot { position, direction, intensity, cos_inner, cos_outer, range } => {
            let (position, direction, cos_inner, cos_outer) = (*position, *direction, *cos_inner, *cos_outer);
            spot::pack(spot::Cone { position, direction, cos_inner, cos_outer }, *intensity, *range, receivers)
        }
        LightKind::Directional { direction, irradiance } => directional::pack(lit.sphere(), *direction, *irradiance),
        LightKind::Environment { .. } => environment::pack(lit.sphere(), lit.irradiance),
    }
}

/// Adds the probability with which each light is sampled, and the data of the kernels' `light_potential`. The
/// probability is half by power and half uniform: by power alone, a weak light nearby would get rare samples of large
/// weight.
fn add_sampling(texels: &mut [LightTexels], lights: &[LightInfo]) {
    let count = lights.len() as f64;
    let total: f64 = lights.iter().map(|light| light.power).sum();
    let mut cumulative = 0.0;
    let mut below = 0f32;
    // In units of the strongest light, so that potentials do not depend on the scene's units. Kernels multiply the
    // strength of a punctual light by the irradiance that it sends, so its own strength counts as 1.
    let unit = lights.iter().map(|light| light.emission.strength).fold(f64::MIN_POSITIVE, f64::max);
    for (i, light) in lights.iter().enumerate() {
        cumulative += if total > 0.0 { 0.5 * light.power / total + 0.5 / count } else { 1.0 / count };
        // Kernels compare with the rounded cumulative probabilities, so each probability is a difference of these.
        let end = if i + 1 == lights.len() { 1.0 } else { cumulative as f32 };
        let Emission { strength, axis } = light.emission;
        let strength = if light.punctual { 1.0 / unit } else { strength / unit };
        let axis = axis.map_or(NO_AXIS, oct_encode16);
        texels[i][SAMPLING_TEXEL as usize] =
            [end.to_bits(), (end - below).to_bits(), (strength as f32).to_bits(), axis];
        below = end;
    }
}
