//! A glTF 2.0 document under construction, and its binary form.

use std::collections::BTreeSet;
use std::io::Cursor;

use glam::{DMat3, DQuat, DVec3};
use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{DynamicImage, ImageEncoder};
use serde_json::{Map, Value, json};

use super::mesh::{Mesh, tidy};

/// glTF component types (section 3.6.2.2 of the specification).
const UNSIGNED_SHORT: u32 = 5123;
const UNSIGNED_INT: u32 = 5125;
const FLOAT: u32 = 5126;
/// glTF buffer view targets.
const ARRAY_BUFFER: u32 = 34962;
const ELEMENT_ARRAY_BUFFER: u32 = 34963;

/// The document: its top-level arrays by name, and its single buffer.
#[derive(Default)]
pub struct Glb {
    lists: Map<String, Value>,
    bin: Vec<u8>,
}

impl Glb {
    /// Appends to a top-level array (`materials`, `nodes`, ...) and returns the index there.
    pub fn push(&mut self, list: &str, item: Value) -> usize {
        let list = self.lists.entry(list).or_insert_with(|| json!([])).as_array_mut().expect("lists hold arrays");
        list.push(item);
        list.len() - 1
    }

    /// Adds a mesh of one primitive. Texture coordinates are written only if the material has a texture.
    pub fn mesh(&mut self, name: &str, mesh: &Mesh, material: usize) -> usize {
        let mut attributes = Map::new();
        let position = self.floats("VEC3", mesh.positions.iter().map(|p| p.to_array()));
        let (low, high) = mesh.bounds();
        let accessor = &mut self.lists["accessors"][position];
        accessor["min"] = json!(low);
        accessor["max"] = json!(high);
        attributes.insert("POSITION".into(), json!(position));
        if !mesh.normals.is_empty() {
            let normals = self.floats("VEC3", mesh.normals.iter().map(|n| n.to_array()));
            attributes.insert("NORMAL".into(), json!(normals));
        }
        if !mesh.tangents.is_empty() {
            let tangents = self.floats("VEC4", mesh.tangents.iter().map(|t| t.to_array()));
            attributes.insert("TANGENT".into(), json!(tangents));
        }
        if has_texture(&self.lists["materials"][material]) {
            let uvs = self.floats("VEC2", mesh.uvs.iter().map(|uv| uv.to_array()));
            attributes.insert("TEXCOORD_0".into(), json!(uvs));
        }
        if !mesh.colours.is_empty() {
            let colours = self.floats("VEC3", mesh.colours.iter().map(|c| c.to_array()));
            attributes.insert("COLOR_0".into(), json!(colours));
        }
        let indices = self.indices(mesh.triangles.as_flattened());
        let primitive = json!({ "attributes": attributes, "indices": indices, "material": material });
        self.push("meshes", json!({ "name": name, "primitives": [primitive] }))
    }

    /// Adds an image as PNG with its own sampler, and returns the texture.
    pub fn texture(&mut self, name: &str, image: impl Into<DynamicImage>, wrap: Wrap) -> usize {
        self.encoded(name, &encode(&image.into()), wrap)
    }

    /// Adds a PNG file with its own sampler, and returns the texture.
    pub fn encoded(&mut self, name: &str, png: &[u8], wrap: Wrap) -> usize {
        let view = self.view(png, None);
        let source = self.push("images", json!({ "name": name, "bufferView": view, "mimeType": "image/png" }));
        let sampler = self.push("samplers", json!({ "wrapS": wrap as u32, "wrapT": wrap as u32 }));
        self.push("textures", json!({ "name": name, "source": source, "sampler": sampler }))
    }

    /// Adds a perspective camera at `eye` that looks along `direction`, with +y up.
    pub fn camera(&mut self, eye: DVec3, direction: DVec3, yfov_degrees: f64, aspect_ratio: f64) {
        let perspective = json!({ "yfov": yfov_degrees.to_radians(), "aspectRatio": aspect_ratio, "znear": 0.01 });
        let camera = self.push("cameras", json!({ "type": "perspective", "perspective": perspective }));
        self.push(
            "nodes",
            json!({
                "name": "camera", "camera": camera,
                "translation": eye.to_array(), "rotation": rotation_towards(direction),
            }),
        );
    }

    /// Adds a KHR_lights_punctual light at `position`. Spot lights emit along `direction`.
    pub fn punctual_light(&mut self, name: &str, light: Value, position: DVec3, direction: DVec3) {
        let lights = self.lists.entry("lights").or_insert_with(|| json!([])).as_array_mut().expect("an array");
        lights.push(light);
        let extension = json!({ "KHR_lights_punctual": { "light": lights.len() - 1 } });
        self.push(
            "nodes",
            json!({
                "name": name, "extensions": extension,
                "translation": position.to_array(), "rotation": rotation_towards(direction),
            }),
        );
    }

    /// The .glb file.
    pub fn finish(mut self, name: &str) -> Vec<u8> {
        if let Some(lights) = self.lists.remove("lights") {
            self.lists.insert("extensions".into(), json!({ "KHR_lights_punctual": { "lights": lights } }));
        }
        let nodes = self.lists["nodes"].as_array().expect("an array");
        let children: BTreeSet<u64> =
            nodes.iter().filter_map(|node| node["children"].as_array()).flatten().filter_map(Value::as_u64).collect();
        let roots: Vec<u64> = (0..nodes.len() as u64).filter(|node| !children.contains(node)).collect();

        pad(&mut self.bin, 0);
        let mut document = self.lists;
        document.insert("asset".into(), json!({ "version": "2.0", "generator": "Penumbra make_scenes" }));
        document.insert("scene".into(), json!(0));
        document.insert("scenes".into(), json!([{ "name": name, "nodes": roots }]));
        document.insert("buffers".into(), json!([{ "byteLength": self.bin.len() }]));
        let mut document = Value::Object(document);
        let mut extensions = BTreeSet::new();
        collect_extensions(&document, &mut extensions);
        if !extensions.is_empty() {
            document["extensionsUsed"] = json!(extensions);
        }

        let mut json = document.to_string().into_bytes();
        pad(&mut json, b' ');
        let mut glb = Vec::new();
        glb.extend(b"glTF");
        let length = 12 + 8 + json.len() + 8 + self.bin.len();
        glb.extend([2, length as u32].into_iter().flat_map(u32::to_le_bytes));
        for (kind, chunk) in [(b"JSON", json), (b"BIN\0", self.bin)] {
            glb.extend((chunk.len() as u32).to_le_bytes());
            glb.extend(kind);
            glb.extend(chunk);
        }
        glb
    }

    fn view(&mut self, bytes: &[u8], target: Option<u32>) -> usize {
        // Components have at most four bytes and must be aligned to their size.
        pad(&mut self.bin, 0);
        let mut view = json!({ "buffer": 0, "byteOffset": self.bin.len(), "byteLength": bytes.len() });
        if let Some(target) = target {
            view["target"] = json!(target);
        }
        self.bin.extend(bytes);
        self.push("bufferViews", view)
    }

    fn floats<const N: usize>(&mut self, kind: &str, items: impl ExactSizeIterator<Item = [f64; N]>) -> usize {
        let count = items.len();
        let bytes: Vec<u8> = items.flatten().flat_map(|x| (x as f32).to_le_bytes()).collect();
        let view = self.view(&bytes, Some(ARRAY_BUFFER));
        self.push("accessors", json!({ "bufferView": view, "componentType": FLOAT, "count": count, "type": kind }))
    }

    fn indices(&mut self, indices: &[u32]) -> usize {
        // The largest index of a type means primitive restart and is not allowed.
        let short = indices.iter().all(|&index| index < u16::MAX.into());
        let (bytes, kind): (Vec<u8>, u32) = if short {
            (indices.iter().flat_map(|&index| (index as u16).to_le_bytes()).collect(), UNSIGNED_SHORT)
        } else {
            (indices.iter().flat_map(|index| index.to_le_bytes()).collect(), UNSIGNED_INT)
        };
        let view = self.view(&bytes, Some(ELEMENT_ARRAY_BUFFER));
        let accessor = json!({ "bufferView": view, "componentType": kind, "count": indices.len(), "type": "SCALAR" });
        self.push("accessors", accessor)
    }
}

/// Wrap modes, with their numbers in glTF.
#[derive(Clone, Copy)]
pub enum Wrap {
    Clamp = 33071,
    Mirror = 33648,
    Repeat = 10497,
}

/// An 8-bit image as a PNG file.
pub fn encode(image: &DynamicImage) -> Vec<u8> {
    let mut png = Cursor::new(Vec::new());
    PngEncoder::new_with_quality(&mut png, CompressionType::Best, FilterType::Adaptive)
        .write_image(image.as_bytes(), image.width(), image.height(), image.color().into())
        .expect("an 8-bit image in memory");
    png.into_inner()
}

/// The glTF rotation by `angle` degrees about an axis.
pub fn rotation_about(axis: DVec3, degrees: f64) -> [f64; 4] {
    DQuat::from_axis_angle(axis, degrees.to_radians()).to_array().map(tidy)
}

/// The glTF rotation of a camera or light along `direction`, with +y as close to up as possible.
fn rotation_towards(direction: DVec3) -> [f64; 4] {
    let backward = -direction.normalize();
    let right = DVec3::Y.cross(backward).normalize_or(DVec3::X);
    DQuat::from_mat3(&DMat3::from_cols(right, backward.cross(right), backward)).to_array().map(tidy)
}

fn pad(bytes: &mut Vec<u8>, filler: u8) {
    bytes.resize(bytes.len().next_multiple_of(4), filler);
}

fn has_texture(material: &Value) -> bool {
    let members = |value: &Value| value.as_object().is_some_and(|m| m.keys().any(|key| key.ends_with("Texture")));
    members(material) || members(&material["pbrMetallicRoughness"])
}

fn collect_extensions(value: &Value, found: &mut BTreeSet<String>) {
    match value {
        Value::Object(members) => {
            if let Some(Value::Object(extensions)) = members.get("extensions") {
                found.extend(extensions.keys().cloned());
            }
            members.values().for_each(|member| collect_extensions(member, found));
        }
        Value::Array(items) => items.iter().for_each(|item| collect_extensions(item, found)),
        _ => {}
    }
}
