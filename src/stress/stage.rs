//! Small scenes made in code and written as glTF in memory, so that measurements include the import.

use std::path::Path;

use glam::{DAffine3, DMat3, DVec3};
use serde_json::{Value, json};

use crate::scene::{ImportOptions, Scene};
use crate::{Camera, Error, Result};

/// The corners of a triangle, counter-clockwise as seen from the front.
pub type Corners = [DVec3; 3];

/// The material of a surface, grey throughout.
#[derive(Clone, Copy, Debug)]
pub struct Paint {
    /// Base colour, 0 to 1.
    pub colour: f64,
    /// Emitted radiance.
    pub radiance: f64,
    /// Opacity, 0 to 1: the share of rays that the surface stops.
    pub alpha: f64,
    /// glTF's `metallicFactor`, 0 or 1.
    pub metallic: f64,
    /// glTF's `roughnessFactor`, 0 to 1.
    pub roughness: f64,
    /// Whether both faces reflect and emit.
    pub double_sided: bool,
}

impl Paint {
    /// A Lambertian surface that reflects the share `albedo`.
    pub const fn matte(albedo: f64) -> Paint {
        Paint { colour: albedo, radiance: 0.0, alpha: 1.0, metallic: 0.0, roughness: 1.0, double_sided: false }
    }

    /// A black surface that emits `radiance`.
    pub const fn lamp(radiance: f64) -> Paint {
        Paint { radiance, ..Paint::matte(0.0) }
    }

    fn json(&self) -> Value {
        let Paint { colour, radiance, alpha, metallic, roughness, double_sided } = *self;
        let mut material = json!({
            "pbrMetallicRoughness": {
                "baseColorFactor": [colour, colour, colour, alpha],
                "metallicFactor": metallic,
                "roughnessFactor": roughness
            },
            "doubleSided": double_sided,
            // Without the dielectric layer every surface that is not a metal is Lambertian.
            "extensions": { "KHR_materials_specular": { "specularFactor": 0.0 } }
        });
        if radiance > 0.0 {
            material["emissiveFactor"] = json!([1.0, 1.0, 1.0]);
            material["extensions"]["KHR_materials_emissive_strength"] = json!({ "emissiveStrength": radiance });
        }
        if alpha < 1.0 {
            material["alphaMode"] = json!("BLEND");
        }
        material
    }
}

/// Triangles of one material and their instances. Each instance of an emissive part is a light.
#[derive(Clone, Debug)]
pub struct Part {
    /// In the file's coordinates, which are rounded to f32.
    pub triangles: Vec<Corners>,
    /// The material of all triangles.
    pub paint: Paint,
    /// World matrices of the instances, in f64.
    pub instances: Vec<DAffine3>,
}

/// A point light.
#[derive(Clone, Copy, Debug)]
pub struct PointLight {
    /// In world space.
    pub position: DVec3,
    /// Radiant intensity, as in glTF.
    pub intensity: f64,
}

/// The camera of a stage.
#[derive(Clone, Copy, Debug)]
pub struct Eye {
    /// In world space.
    pub position: DVec3,
    /// Viewing direction; need not be a unit vector.
    pub towards: DVec3,
    /// Projection and width of the view.
    pub view: View,
}

/// The projection of a square image.
#[derive(Clone, Copy, Debug)]
pub enum View {
    /// Field of view in radians.
    Perspective(f64),
    /// Half the side of the view, in world units.
    Orthographic(f64),
}

/// A scene to be written as glTF.
#[derive(Clone, Debug)]
pub struct Stage {
    /// Surfaces.
    pub parts: Vec<Part>,
    /// Point lights.
    pub lights: Vec<PointLight>,
    /// The camera.
    pub eye: Eye,
}

impl Stage {
    /// An empty stage.
    pub fn new(eye: Eye) -> Stage {
        Stage { parts: Vec::new(), lights: Vec::new(), eye }
    }

    /// Adds a part with one instance, whose matrix is the identity.
    pub fn with(mut self, triangles: Vec<Corners>, paint: Paint) -> Stage {
        self.parts.push(Part { triangles, paint, instances: vec![DAffine3::IDENTITY] });
        self
    }

    /// Scales everything, coordinates included. Point lights are scaled so that the irradiance stays the same.
    pub fn scaled(mut self, factor: f64) -> Stage {
        for part in &mut self.parts {
            part.triangles.iter_mut().flatten().for_each(|corner| *corner *= factor);
            part.instances.iter_mut().for_each(|instance| instance.translation *= factor);
        }
        for light in &mut self.lights {
            light.position *= factor;
            light.intensity *= factor * factor;
        }
        self.eye.position *= factor;
        if let View::Orthographic(half) = &mut self.eye.view {
            *half *= factor;
        }
        self
    }

    /// Transforms everything by the matrices of the nodes.
    pub fn transformed(mut self, transform: DAffine3) -> Stage {
        let instances = self.parts.iter_mut().flat_map(|part| &mut part.instances);
        instances.for_each(|instance| *instance = transform * *instance);
        self.lights.iter_mut().for_each(|light| light.position = transform.transform_point3(light.position));
        self.eye.position = transform.transform_point3(self.eye.position);
        self.eye.towards = transform.transform_vector3(self.eye.towards);
        self
    }

    /// Moves everything by `offset`, surfaces by the coordinates of their vertices.
    pub fn moved(mut self, offset: DVec3) -> Stage {
        self.parts.iter_mut().flat_map(|part| &mut part.triangles).flatten().for_each(|corner| *corner += offset);
        self.lights.iter_mut().for_each(|light| light.position += offset);
        self.eye.position += offset;
        self
    }

    /// Writes the stage as a glTF file and imports it. Returns the scene and its camera.
    ///
    /// # Errors
    /// As [`Scene::load`].
    pub fn import(&self) -> Result<(Scene, Camera)> {
        let file = Path::new("stage.glb");
        let scene = Scene::from_bytes(&self.glb(), file, &ImportOptions::default())?;
        let camera = scene.cameras.first().cloned();
        let camera = camera.ok_or_else(|| Error::input(file, "/cameras/0", "has no orientation"))?;
        Ok((scene, camera))
    }

    /// The stage as a .glb file.
    pub fn glb(&self) -> Vec<u8> {
        let Meshes { bin, views, accessors, meshes, instances } = self.meshes();
        let mut nodes = vec![self.eye.node()];
        nodes.extend(instances);
        for (index, light) in self.lights.iter().enumerate() {
            let of_light = json!({ "KHR_lights_punctual": { "light": index } });
            nodes.push(json!({ "translation": light.position.to_array(), "extensions": of_light }));
        }
        let materials: Vec<Value> = self.parts.iter().map(|part| part.paint.json()).collect();
        let mut root = json!({
            "asset": { "version": "2.0" },
            "extensionsUsed": ["KHR_materials_specular", "KHR_materials_emissive_strength", "KHR_lights_punctual"],
            "scene": 0,
            "scenes": [{ "nodes": (0..nodes.len()).collect::<Vec<_>>() }],
            "nodes": nodes,
            "cameras": [self.eye.camera()]
        });
        if !self.parts.is_empty() {
            root["buffers"] = json!([{ "byteLength": bin.len() }]);
            for (name, list) in
                [("bufferViews", views), ("accessors", accessors), ("meshes", meshes), ("materials", materials)]
            {
                root[name] = Value::Array(list);
            }
        }
        if !self.lights.is_empty() {
            let lights = self.lights.iter().map(|light| json!({ "type": "point", "intensity": light.intensity }));
            root["extensions"] = json!({ "KHR_lights_punctual": { "lights": lights.collect::<Vec<_>>() } });
        }
        container(&root, bin)
    }

    /// The parts as meshes, with their positions in one buffer.
    fn meshes(&self) -> Meshes {
        let mut found = Meshes::default();
        for (index, part) in self.parts.iter().enumerate() {
            let corners: Vec<_> = part.triangles.iter().flatten().map(|corner| corner.as_vec3()).collect();
            let start = found.bin.len();
            found.bin.extend(corners.iter().flat_map(|corner| corner.to_array()).flat_map(f32::to_le_bytes));
            let (lower, upper) =
                (corners.iter().copied().reduce(glam::Vec3::min), corners.iter().copied().reduce(glam::Vec3::max));
            let length = found.bin.len() - start;
            found.views.push(json!({ "buffer": 0, "byteOffset": start, "byteLength": length }));
            found.accessors.push(json!({
                "bufferView": index, "componentType": 5126, "type": "VEC3", "count": corners.len(),
                "min": lower.unwrap_or_default().to_array(), "max": upper.unwrap_or_default().to_array()
            }));
            found.meshes.push(json!({ "primitives": [{ "attributes": { "POSITION": index }, "material": index }] }));
            for instance in &part.instances {
                found.instances.push(json!({ "mesh": index, "matrix": columns(instance) }));
            }
        }
        found
    }
}

/// The meshes of a .glb file: glTF objects by kind, and the binary chunk.
#[derive(Default)]
struct Meshes {
    bin: Vec<u8>,
    views: Vec<Value>,
    accessors: Vec<Value>,
    meshes: Vec<Value>,
    /// Nodes, one per instance.
    instances: Vec<Value>,
}

impl Eye {
    /// The axes of the camera: unit vectors to the right, up and backward.
    pub fn axes(&self) -> DMat3 {
        let backward = -self.towards.normalize();
        // Any direction that is not nearly parallel.
        let other = if backward.y.abs() > 0.9 { DVec3::X } else { DVec3::Y };
        let right = other.cross(backward).normalize();
        DMat3::from_cols(right, backward.cross(right), backward)
    }

    /// Origin and direction of the ray through the centre of pixel (x, y) in an image of `side` by `side` pixels.
    pub fn ray(&self, [x, y]: [u32; 2], side: u32) -> (DVec3, DVec3) {
        let at = |pixel: u32| (2.0 * f64::from(pixel) + 1.0) / f64::from(side) - 1.0;
        let axes = self.axes();
        let across = axes.x_axis * at(x) - axes.y_axis * at(y);
        match self.view {
            View::Perspective(angle) => (self.position, across * (0.5 * angle).tan() - axes.z_axis),
            View::Orthographic(half) => (self.position + across * half, -axes.z_axis),
        }
    }

    fn node(&self) -> Value {
        let transform = DAffine3 { matrix3: self.axes(), translation: self.position };
        json!({ "camera": 0, "matrix": columns(&transform) })
    }

    fn camera(&self) -> Value {
        match self.view {
            // The smallest near plane, so that nothing is clipped at any scale.
            View::Perspective(yfov) => {
                json!({ "type": "perspective", "perspective": { "yfov": yfov, "znear": f32::MIN_POSITIVE } })
            }
            View::Orthographic(half) => json!({
                "type": "orthographic",
                "orthographic": { "xmag": half, "ymag": half, "znear": 0.0, "zfar": f32::MAX }
            }),
        }
    }
}

/// A matrix in glTF's form: 16 numbers, column by column.
fn columns(transform: &DAffine3) -> Vec<f64> {
    let DAffine3 { matrix3: m, translation: t } = *transform;
    let columns = [m.x_axis.extend(0.0), m.y_axis.extend(0.0), m.z_axis.extend(0.0), t.extend(1.0)];
    columns.iter().flat_map(|column| column.to_array()).collect()
}

/// A .glb file of a JSON chunk and a binary chunk.
fn container(json: &Value, mut bin: Vec<u8>) -> Vec<u8> {
    let mut text = json.to_string().into_bytes();
    text.resize(text.len().next_multiple_of(4), b' ');
    bin.resize(bin.len().next_multiple_of(4), 0);
    let chunks = [(text, b"JSON"), (bin, b"BIN\0")];
    let chunks: Vec<_> = chunks.iter().filter(|(bytes, _)| !bytes.is_empty()).collect();
    let size: usize = 12 + chunks.iter().map(|(bytes, _)| 8 + bytes.len()).sum::<usize>();
    let mut glb = b"glTF\x02\0\0\0".to_vec();
    glb.extend((size as u32).to_le_bytes());
    for (bytes, kind) in chunks {
        glb.extend((bytes.len() as u32).to_le_bytes());
        glb.extend(*kind);
        glb.extend(bytes);
    }
    glb
}

/// A parallelogram around `centre` with the half sides `half` and `other`. Its normal is along their cross product.
pub fn square(centre: DVec3, half: DVec3, other: DVec3) -> Vec<Corners> {
    let [a, b, c, d] = [-half - other, half - other, half + other, other - half].map(|v| centre + v);
    vec![[a, b, c], [a, c, d]]
}

/// The corners of a [`square`], in order.
pub fn outline(square: &[Corners]) -> [DVec3; 4] {
    let [[a, b, c], [_, _, d]] = [square[0], square[1]];
    [a, b, c, d]
}

/// A cube with outward normals.
pub fn cube(centre: DVec3, half: f64) -> Vec<Corners> {
    let axes = [DVec3::X, DVec3::Y, DVec3::Z];
    let sides = (0..3).flat_map(|i| {
        let [n, s, t] = [axes[i], axes[(i + 1) % 3], axes[(i + 2) % 3]].map(|axis| axis * half);
        [square(centre + n, s, t), square(centre - n, t, s)].concat()
    });
    sides.collect()
}

/// The same triangles with reversed normals.
pub fn inside_out(triangles: Vec<Corners>) -> Vec<Corners> {
    triangles.into_iter().map(|[a, b, c]| [a, c, b]).collect()
}

/// A convex polygon, counter-clockwise around its normal, as a fan of triangles around its centre.
pub fn polygon(corners: &[DVec3]) -> Vec<Corners> {
    let centre = corners.iter().sum::<DVec3>() / corners.len() as f64;
    (0..corners.len()).map(|i| [centre, corners[i], corners[(i + 1) % corners.len()]]).collect()
}
