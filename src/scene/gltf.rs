//! glTF import: a file in, a normalised [`Scene`] out, or an error that names the place.
//!
//! The JSON is read as it is, not through a typed model: node transforms keep their f64 digits,
//! every error has a JSON pointer, and a number is checked where it is used.

use std::path::Path;

use super::container::Resources;
use super::geometry::Geometry;
use super::json::{self, Json};
use super::notes::Notes;
use super::{Scene, accessor, camera, container, geometry, light, material, mesh, node, procedural, texture};
use crate::input::read_file;
use crate::{Error, Result};

/// What import does where a file leaves it a choice.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ImportOptions {
    /// Add a soft light above the scene if the file has no light.
    pub default_light: bool,
    /// Drop a primitive with NaN or infinite numbers instead of refusing the file.
    pub lenient: bool,
}

/// Extensions that are rendered.
const SUPPORTED: [&str; 13] = [
    "KHR_lights_punctual",
    "KHR_materials_anisotropy",
    "KHR_materials_clearcoat",
    "KHR_materials_emissive_strength",
    "KHR_materials_ior",
    "KHR_materials_sheen",
    "KHR_materials_specular",
    "KHR_materials_transmission",
    "KHR_materials_unlit",
    "KHR_materials_volume",
    "KHR_mesh_quantization",
    "KHR_texture_transform",
    procedural::EXTENSION,
];

impl Scene {
    /// Reads and checks a .gltf or .glb file and all that it names, and brings its scene into
    /// normalised space.
    ///
    /// # Errors
    /// [`Error::Input`] for a file that is missing, damaged, unsupported or out of range, with the
    /// JSON pointer (for the .glb container, the byte) at fault.
    pub fn load(path: impl AsRef<Path>, options: &ImportOptions) -> Result<Scene> {
        let path = path.as_ref();
        let bytes = read_file(path).map_err(|e| Error::input(path, "file", e))?;
        Scene::from_bytes(&bytes, path, options)
    }

    /// As [`Scene::load`], of a file that is in memory: `path` names it in errors, and what it refers to lies beside that.
    ///
    /// # Errors
    /// As [`Scene::load`].
    pub fn from_bytes(bytes: &[u8], path: &Path, options: &ImportOptions) -> Result<Scene> {
        let (text, bin) = container::chunks(bytes, path)?;
        let value = json::parse(text).map_err(|problem| Error::input(path, "file", problem))?;
        let root = Json::root(&value, path);
        let mut notes = Notes::default();
        let mut resources = Resources::default();
        check_asset(&root)?;
        check_extensions(&root, &mut notes)?;

        let buffers = accessor::read_buffers(&root, bin, &mut resources)?;
        let views = accessor::Views::read(&root, &buffers)?;
        let accessors = views.accessors(&root)?;
        let images = texture::read_images(&root, &views, &mut resources)?;
        let materials = material::read(&root, &images, &mut notes)?;
        let cameras = camera::read(&root)?;
        let lights = light::read(&root, &mut notes)?;
        let (meshes, skipped) = mesh::read(&root, &accessors, &materials.materials, options)?;
        let nodes = node::visible(&root, &mut notes)?;
        let references = check_nodes(&root, &nodes, meshes.len(), cameras.len(), lights.len())?;

        let mut scene = Scene {
            images: texture::decode(&images, &materials.images)?,
            textures: materials.textures,
            materials: materials.materials,
            ..Default::default()
        };
        let mut geometry = Geometry::default();
        geometry::check_size(nodes.iter().zip(&references).filter_map(|(node, r)| Some((node, &*meshes[r.mesh?]))))?;
        for (i, (node, of_node)) in nodes.iter().zip(&references).enumerate() {
            if let Some(mesh) = of_node.mesh {
                geometry.add(i, node, &meshes[mesh], &mut scene.materials)?;
            }
        }
        let procedurals = procedural::read(&nodes, &mut resources, &mut scene, &mut notes)?;
        geometry.procedural_corners = procedurals.iter().flat_map(|placed| placed.corners).collect();
        geometry.find_emitters(&scene);
        let has_light = geometry.emits() || references.iter().any(|r| r.light.is_some_and(|l| lights[l].is_some()));
        if options.default_light && !has_light && geometry.add_default_light(nodes.len(), &mut scene.materials) {
            notes.push("no light in the file: a soft one is added above the scene");
        }
        scene.normalisation = geometry.normalisation();
        procedural::place(procedurals, &mut scene)?;
        let mut mesh_lights = geometry.finish(&mut scene, &mut notes).into_iter().peekable();

        for (i, (node, of_node)) in nodes.iter().zip(&references).enumerate() {
            scene.adopt_mesh_lights(&mut mesh_lights, i, node.json.name()?);
            if let Some(light) = of_node.light.and_then(|l| lights[l].as_ref()) {
                let index = scene.lights.len();
                let light = light.place(&node.json, &node.world, &scene.normalisation, index, &mut notes)?;
                scene.lights.extend(light);
            }
            if let Some(camera) = of_node.camera {
                let index = scene.cameras.len();
                let camera = cameras[camera].place(&node.json, &node.world, &scene.normalisation, index, &mut notes)?;
                scene.cameras.extend(camera);
            }
        }
        scene.adopt_mesh_lights(&mut mesh_lights, nodes.len(), Some("default light".into()));
        note_what_is_not_shown(&root, &scene, &skipped, &mut notes)?;
        scene.notes = notes.into_lines();
        Ok(scene)
    }
}

fn check_asset(root: &Json) -> Result<()> {
    let version = root.require("asset")?.require("version")?;
    let text = version.string()?;
    let is_number = |s: &str| !s.is_empty() && s.bytes().all(|b| b.is_ascii_digit());
    match text.split_once('.') {
        Some(("2", minor)) if is_number(minor) => Ok(()),
        _ => Err(version.error(format!("glTF version `{text}`, only 2.x is supported"))),
    }
}

fn check_extensions(root: &Json, notes: &mut Notes) -> Result<()> {
    for extension in root.list("extensionsRequired")? {
        let name = extension.string()?;
        if !SUPPORTED.contains(&name) {
            return Err(extension.error(format!("the file requires the extension {name}, which is not supported")));
        }
    }
    for extension in root.list("extensionsUsed")? {
        let name = extension.string()?;
        if !SUPPORTED.contains(&name) {
            notes.push(format!("the extension {name} is not supported: what it adds is not shown"));
        }
    }
    Ok(())
}

/// What a node refers to.
struct References {
    mesh: Option<usize>,
    camera: Option<usize>,
    light: Option<usize>,
}

/// Checks what every node of the file refers to; gives those of the visible ones.
fn check_nodes(
    root: &Json,
    visible: &[node::Node],
    meshes: usize,
    cameras: usize,
    lights: usize,
) -> Result<Vec<References>> {
    let references = |node: &Json| -> Result<References> {
        let light = match node.extension("KHR_lights_punctual")? {
            Some(extension) => Some(extension.require("light")?.index(lights, "light")?),
            None => None,
        };
        let index = |key: &str, count: usize| node.get(key)?.map(|i| i.index(count, key)).transpose();
        Ok(References { mesh: index("mesh", meshes)?, camera: index("camera", cameras)?, light })
    };
    for node in root.list("nodes")? {
        references(&node)?;
    }
    visible.iter().map(|node| references(&node.json)).collect()
}

fn note_what_is_not_shown(root: &Json, scene: &Scene, skipped: &mesh::Skipped, notes: &mut Notes) -> Result<()> {
    let mut note = |count: usize, text: &str| {
        if count > 0 {
            notes.push(format!("{count} {text}"));
        }
    };
    note(root.list("skins")?.len(), "skins are not applied: their meshes are shown as they are stored");
    note(root.list("animations")?.len(), "animations are not played");
    note(skipped.morphed, "primitives have morph targets, which are not applied");
    note(skipped.points_and_lines, "primitives are points or lines and are left out");
    note(skipped.without_positions, "primitives have no positions and are left out");
    note(skipped.not_finite, "primitives have numbers that are not finite and are left out");
    if scene.cameras.is_empty() {
        notes.push("no camera in the file");
    }
    if scene.lights.is_empty() {
        notes.push("no light in the file");
    }
    Ok(())
}
