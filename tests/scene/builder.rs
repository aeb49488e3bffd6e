//! Makes small glTF files.

use std::path::PathBuf;
use std::sync::atomic::{AtomicU32, Ordering};

use penumbra::Result;
use penumbra::internal::scene::{ImportOptions, Scene};
use serde_json::{Value, json};

/// Component types.
pub const U8: u32 = 5121;
pub const I16: u32 = 5122;
pub const U16: u32 = 5123;
pub const U32: u32 = 5125;
pub const F32: u32 = 5126;

/// A glTF file under construction: its JSON and its binary chunk.
#[derive(Clone)]
pub struct File {
    pub json: Value,
    pub bin: Vec<u8>,
}

/// A new path below the build's folder for tests.
pub fn temporary(extension: &str) -> PathBuf {
    static NEXT: AtomicU32 = AtomicU32::new(0);
    let folder = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join(format!("scene-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    folder.join(format!("{}.{extension}", NEXT.fetch_add(1, Ordering::Relaxed)))
}

pub fn bytes_of<const N: usize>(values: &[[f32; N]]) -> Vec<u8> {
    values.iter().flatten().flat_map(|x| x.to_le_bytes()).collect()
}

impl File {
    pub fn new() -> Self {
        File { json: json!({ "asset": { "version": "2.0" } }), bin: Vec::new() }
    }

    /// A file of one node with one triangle.
    pub fn triangle() -> Self {
        let mut file = File::new();
        file.mesh(&[[0.0, 0.0, 0.0], [4.0, 0.0, 0.0], [0.0, 2.0, 0.0]], json!({}));
        file
    }

    /// Appends to a list of the root, and returns the index.
    pub fn add(&mut self, list: &str, value: Value) -> usize {
        let list = self.json.as_object_mut().unwrap().entry(list).or_insert(json!([])).as_array_mut().unwrap();
        list.push(value);
        list.len() - 1
    }

    pub fn view(&mut self, bytes: &[u8]) -> usize {
        self.bin.resize(self.bin.len().next_multiple_of(4), 0);
        let offset = self.bin.len();
        self.bin.extend(bytes);
        self.add("bufferViews", json!({ "buffer": 0, "byteOffset": offset, "byteLength": bytes.len() }))
    }

    pub fn accessor(&mut self, bytes: &[u8], component: u32, kind: &str, count: usize) -> usize {
        let view = self.view(bytes);
        self.add("accessors", json!({ "bufferView": view, "componentType": component, "type": kind, "count": count }))
    }

    pub fn floats<const N: usize>(&mut self, values: &[[f32; N]]) -> usize {
        let kind = ["", "SCALAR", "VEC2", "VEC3", "VEC4"][N];
        self.accessor(&bytes_of(values), F32, kind, values.len())
    }

    /// Adds a node with a mesh of one primitive, which gets `members`. Returns the index of the node.
    pub fn mesh(&mut self, positions: &[[f32; 3]], members: Value) -> usize {
        let positions = self.floats(positions);
        let mut primitive = json!({ "attributes": { "POSITION": positions } });
        for (key, value) in members.as_object().unwrap() {
            if key == "attributes" {
                primitive[key].as_object_mut().unwrap().extend(value.as_object().unwrap().clone());
            } else {
                primitive[key] = value.clone();
            }
        }
        let mesh = self.add("meshes", json!({ "primitives": [primitive] }));
        self.add("nodes", json!({ "mesh": mesh }))
    }

    pub fn glb(&self) -> Vec<u8> {
        let mut json = self.json.clone();
        let mut bin = self.bin.clone();
        if !bin.is_empty() && json["buffers"].is_null() {
            json["buffers"] = json!([{ "byteLength": bin.len() }]);
        }
        let mut text = json.to_string().into_bytes();
        text.resize(text.len().next_multiple_of(4), b' ');
        bin.resize(bin.len().next_multiple_of(4), 0);
        let mut glb = b"glTF\x02\0\0\0".to_vec();
        let bin_size = if bin.is_empty() { 0 } else { 8 + bin.len() };
        glb.extend((12 + 8 + text.len() as u32 + bin_size as u32).to_le_bytes());
        glb.extend((text.len() as u32).to_le_bytes());
        glb.extend(b"JSON");
        glb.extend(text);
        if !bin.is_empty() {
            glb.extend((bin.len() as u32).to_le_bytes());
            glb.extend(b"BIN\0");
            glb.extend(bin);
        }
        glb
    }

    pub fn load_with(&self, options: &ImportOptions) -> Result<Scene> {
        let path = temporary("glb");
        std::fs::write(&path, self.glb()).unwrap();
        let outcome = Scene::load(&path, options);
        std::fs::remove_file(&path).unwrap();
        outcome
    }

    pub fn load(&self) -> Scene {
        self.load_with(&ImportOptions::default()).unwrap_or_else(|e| panic!("{e}"))
    }
}

/// An 8-bit RGBA PNG.
pub fn png(width: u32, height: u32, texels: &[[u8; 4]]) -> Vec<u8> {
    let image = image::RgbaImage::from_raw(width, height, texels.concat()).unwrap();
    let mut bytes = std::io::Cursor::new(Vec::new());
    image.write_to(&mut bytes, image::ImageFormat::Png).unwrap();
    bytes.into_inner()
}

/// Triangles in world space. They are exact for the small integers of these tests, because normalisation only subtracts
/// a half-integer and scales by a power of two.
pub fn world(scene: &Scene) -> Vec<[[f64; 3]; 3]> {
    let corners = |i| scene.triangle_positions(i).map(|p| scene.normalisation.undo(p).to_array());
    (0..scene.triangles.len()).map(corners).collect()
}
