//! glTF import: reads a file into a normalised [`Scene`].
//!
//! Import works on the JSON document itself, not on a typed model of it. Node transforms keep their f64 digits, every
//! error has a JSON pointer, and every number is checked where it is used.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use glam::DAffine3;

use super::accessor::Accessor;
use super::camera::CameraKind;
use super::container::Resources;
use super::description::Scene;
use super::environment::NO_LIGHT_NOTE;
use super::geometry::{Geometry, PlacedMesh, PlacedMeshLight};
use super::images::Encoded;
use super::import_options::ImportOptions;
use super::instancing::Instances;
use super::json::{self, Json};
use super::light::Punctual;
use super::material::{LOBE_EXTENSIONS, Material, Materials};
use super::mesh::Mesh;
use super::node::Node;
use super::notes::Notes;
use super::panorama::Panorama;
use super::repeats::Repeats;
use super::skin::Skin;
use super::texture::TextureImage;
use super::triangle::Triangle;
use super::variants::Variants;
use super::{
    accessor, animation, camera, container, draco, geometry, image_light, images, immersion, instancing, light,
    material, mesh, meshopt, node, procedural, repeats, skin,
};
use crate::count::count;
use crate::input::read_file;
use crate::{Error, Result};

/// Supported extensions, in addition to those of a material's lobes.
const SUPPORTED: &[&str] = &[
    animation::POINTER_EXTENSION,
    "KHR_lights_punctual",
    "KHR_materials_emissive_strength",
    "KHR_materials_ior",
    "KHR_materials_unlit",
    "KHR_materials_variants",
    "KHR_mesh_quantization",
    "KHR_node_visibility",
    "KHR_texture_transform",
    draco::EXTENSION,
    image_light::EXTENSION,
    images::BASIS,
    images::WEBP,
    instancing::EXTENSION,
    material::specular_glossiness::EXTENSION,
    procedural::EXTENSION,
];

fn is_supported(extension: &str) -> bool {
    SUPPORTED.contains(&extension) || LOBE_EXTENSIONS.contains(&extension) || meshopt::EXTENSIONS.contains(&extension)
}

impl Scene {
    /// Reads and checks a .gltf or .glb file and the files that it refers to, and transforms its scene to normalised
    /// space.
    ///
    /// # Errors
    /// [`Error::Input`] if a file is missing, damaged, unsupported or out of range. Its location is a JSON pointer, or
    /// a byte offset in the .glb container. [`Error::Usage`] if the file lacks the animation or the
    /// variant of the options.
    pub fn load(path: impl AsRef<Path>, options: &ImportOptions) -> Result<Scene> {
        load_and_list(path.as_ref(), options, &mut Vec::new())
    }

    /// [`Scene::load`] for a file in memory. `path` names it in errors, and references are relative to the folder of
    /// `path`.
    ///
    /// # Errors
    /// As [`Scene::load`].
    pub fn from_bytes(bytes: &[u8], path: &Path, options: &ImportOptions) -> Result<Scene> {
        Scene::read(bytes, path, options, &mut Resources::default())
    }

    fn read(bytes: &[u8], path: &Path, options: &ImportOptions, resources: &mut Resources) -> Result<Scene> {
        let (text, bin) = container::chunks(bytes, path)?;
        let value = json::parse(text).map_err(|problem| Error::input(path, "file", problem))?;
        let root = Json::root(&value, path);
        let mut notes = Notes::default();
        check_asset(&root, &mut notes)?;
        check_extensions(&root, &mut notes)?;

        let buffers = accessor::read_buffers(&root, bin, resources)?;
        let decoded = meshopt::decode(&root, &buffers)?;
        let views = accessor::Views::read(&root, &buffers, &decoded)?;
        let decoded = draco::decode(&root, &views)?;
        let accessors = views.accessors(&root, &decoded)?;
        let posed = animation::pose(&root, &accessors, options, &mut notes)?;
        let root = posed.document.as_ref().map_or(root, |document| Json::root(document, path));
        let encoded = images::read_images(&root, &views, resources, options.lenient, &mut notes)?;
        let panorama = image_light::read(&root, &encoded, options.lenient, &mut notes)?;
        let (materials, images) = materials(&root, encoded, options, &mut notes)?;
        let cameras = camera::read(&root)?;
        let lights = light::read(&root, &mut notes)?;
        let variants = Variants::read(&root, options.variant.as_deref(), &mut notes)?;
        let (meshes, skipped) = mesh::read(&root, &accessors, &materials.materials, &variants, options)?;
        let nodes = node::of_scene(&root, &mut notes)?;
        let skins = skin::read(&root, &accessors)?;
        let counts = Counts { skins: skins.len(), cameras: cameras.len(), lights: lights.len() };
        let references = check_nodes(&root, &nodes, &meshes, &counts, &accessors)?;
        let document = Document { nodes, references, meshes, skins, cameras, lights };

        let mut scene = Scene {
            images: images.into(),
            textures: materials.textures,
            materials: materials.materials,
            ..Default::default()
        };
        // Geometry without a material adds another one.
        let of_file = scene.materials.len();
        let mut geometry = document.geometry(&mut scene.materials, options)?;
        let procedurals = procedural::read(&document.nodes, of_file, resources, &mut scene, &mut notes)?;
        immersion::immerse(&mut geometry, &mut scene.materials, &mut notes);
        geometry.procedural_corners = procedurals.iter().flat_map(|placed| placed.corners).collect();
        geometry.find_emitters(&scene);
        if options.default_light {
            document.add_default_light(&mut geometry, &mut scene.materials, panorama.as_ref(), &mut notes);
        }
        scene.normalisation = geometry.normalisation();
        procedural::place(procedurals, &mut scene)?;
        let mesh_lights = geometry.finish(&mut scene, &mut notes);
        document.add_lights_and_cameras(&mut scene, mesh_lights, &mut notes)?;
        if let Some(panorama) = panorama {
            let too_bright = |_| root.error("the radiance of its image-based light is out of range");
            scene.set_environment(Arc::new(panorama), 0.0, 1.0).map_err(too_bright)?;
        }
        note_omissions(&scene, &skipped, options.default_light, &mut notes)?;
        scene.notes = notes.into_lines();
        scene.files = resources.files(path);
        (scene.variants, scene.animation_end) = (variants.into_names(), posed.end);
        Ok(scene)
    }
}

/// [`Scene::load`], which lists in `files` what [`Scene::files`] would have of a scene that is refused, too: the files
/// that it refers to as far as it was read.
///
/// # Errors
/// As [`Scene::load`].
pub fn load_and_list(path: &Path, options: &ImportOptions, files: &mut Vec<PathBuf>) -> Result<Scene> {
    files.clear();
    let bytes = read_file(path).map_err(|e| Error::input(path, "file", e))?;
    let mut resources = Resources::default();
    let scene = Scene::read(&bytes, path, options, &mut resources);
    *files = resources.files(path);
    scene
}

/// The materials, and the images that they use. A lenient import leaves out the images that turn out to be damaged, and
/// reads the materials again without them.
fn materials(
    root: &Json,
    mut encoded: Vec<Encoded>,
    options: &ImportOptions,
    notes: &mut Notes,
) -> Result<(Materials, Vec<TextureImage>)> {
    loop {
        let materials = material::read(root, &encoded, notes)?;
        let mut images = Vec::with_capacity(materials.images.len());
        let used = materials.images_in_spaces();
        for ((shown, _), image) in used.iter().zip(images::decode_textures(&encoded, &used, notes)?) {
            match image {
                Ok(image) => images.push(image),
                Err(error) if options.lenient => encoded[shown.image].leave_out(&error, notes),
                Err(error) => return Err(Encoded::with_remedy(error)),
            }
        }
        if images.len() == materials.images.len() {
            return Ok((materials, images));
        }
    }
}

/// The checked parts of a document that nodes refer to.
struct Document<'r, 'a> {
    /// The nodes of the rendered scene.
    nodes: Vec<Node<'a>>,
    /// The references of each of these nodes.
    references: Vec<References<'r, 'a>>,
    meshes: Vec<Mesh<'r, 'a>>,
    skins: Vec<Skin<'r, 'a>>,
    cameras: Vec<CameraKind>,
    /// `None` for lights of an unknown type.
    lights: Vec<Option<Punctual>>,
}

impl<'r, 'a> Document<'r, 'a> {
    /// Adds a light if neither surfaces nor the panorama nor a punctual light emit.
    fn add_default_light(
        &self,
        geometry: &mut Geometry,
        materials: &mut Vec<Material>,
        panorama: Option<&Panorama>,
        notes: &mut Notes,
    ) {
        let is_bright = |panorama: &Panorama| panorama.brightest() > 0.0;
        let has_light = geometry.emits() || self.has_punctual_light() || panorama.is_some_and(is_bright);
        if !has_light && geometry.add_default_light(self.nodes.len(), materials) {
            notes.push("no light in the file: a soft one is added above and in front of the scene");
        }
    }

    /// The triangles of all nodes in world space. Adds a default material if a primitive needs it.
    fn geometry(&self, materials: &mut Vec<Material>, options: &ImportOptions) -> Result<Geometry> {
        let meshes = || {
            let nodes = self.nodes.iter().zip(&self.references).enumerate();
            nodes.filter_map(|(i, (node, of_node))| Some((i, node, of_node, &self.meshes[of_node.mesh?])))
        };
        let repeats = self.repeats(materials, options.max_copied_triangles)?;
        // For a shared mesh: the copies that are not instances, and the one that all instances share.
        let mut stored = vec![false; self.meshes.len()];
        let placed = meshes().map(|(_, node, of_node, mesh)| {
            let instances = of_node.mesh.map_or(0, |mesh| repeats.instances_at(node.index, mesh));
            let again = of_node.mesh.filter(|_| instances > 0).map(|mesh| std::mem::replace(&mut stored[mesh], true));
            let copies = of_node.copies() - instances + usize::from(again == Some(false));
            (node, mesh, of_node.weights(mesh), copies)
        });
        geometry::check_size(placed)?;
        let mut geometry = Geometry::default();
        let mut joints_of_skins: Vec<Option<Arc<[DAffine3]>>> = vec![None; self.skins.len()];
        for (i, node, of_node, mesh) in meshes().filter(|(_, _, _, mesh)| !mesh.primitives.is_empty()) {
            let joints = match of_node.skin {
                None => None,
                Some(skin) => {
                    self.check_influences(skin, node, mesh)?;
                    if joints_of_skins[skin].is_none() {
                        joints_of_skins[skin] = Some(self.skins[skin].matrices(&self.nodes)?);
                    }
                    joints_of_skins[skin].clone()
                }
            };
            let weights = of_node.weights(mesh);
            let shared = of_node.mesh.filter(|mesh| repeats.instances_at(node.index, *mesh) > 0);
            let mut add = |placed: PlacedMesh| match shared {
                Some(mesh) if repeats::is_shareable(&placed.node.world) => {
                    geometry.add_instance(mesh, &placed, materials)
                }
                _ => geometry.add(i, &placed, materials),
            };
            match &of_node.instances {
                None => add(PlacedMesh { node, mesh, weights, joints })?,
                // A skinned mesh is placed by its joints alone, so that its copies would be at the same place.
                Some(instances) => instances.each(|local| {
                    let copy = node.moved(local);
                    add(PlacedMesh { node: &copy, mesh, weights, joints: joints.clone() })
                })?,
            }
        }
        Ok(geometry)
    }

    /// Which meshes are stored once.
    fn repeats(&self, materials: &[Material], limit: Option<usize>) -> Result<Repeats> {
        let mut repeats = Repeats::new(&self.meshes, limit);
        let placed = || {
            let nodes = self.nodes.iter().zip(&self.references);
            nodes.filter_map(|(node, of_node)| Some((node, of_node, of_node.mesh?)))
        };
        placed().for_each(|(_, of_node, mesh)| repeats.add_copies(mesh, of_node.copies()));
        if !repeats.are_worthwhile() {
            return Ok(repeats);
        }
        for (node, of_node, mesh) in placed() {
            let weights = of_node.weights(&self.meshes[mesh]);
            if repeats::is_rigid(&self.meshes[mesh], weights, of_node.skin.is_some(), materials) {
                let mut count = 0;
                let mut add = |node: &Node| count += usize::from(repeats::is_shareable(&node.world));
                match &of_node.instances {
                    None => add(node),
                    Some(instances) => instances.each(|local| {
                        add(&node.moved(local));
                        Ok(())
                    })?,
                }
                repeats.add_shareable(mesh, node.index, count);
            }
        }
        repeats.decide();
        Ok(repeats)
    }

    /// Checks that a skin can move a mesh at a node.
    fn check_influences(&self, skin: usize, node: &Node, mesh: &Mesh) -> Result<()> {
        for primitive in &mesh.primitives {
            match &primitive.influences {
                Some(influences) => influences.check(self.skins[skin].joint_count(), node.index)?,
                None => return Err(node.json.error("has a skin, but a primitive of its mesh has no JOINTS_0")),
            }
        }
        Ok(())
    }

    /// Whether a punctual light emits light.
    fn has_punctual_light(&self) -> bool {
        self.nodes.iter().zip(&self.references).any(|(node, of_node)| {
            of_node.light.and_then(|light| self.lights[light].as_ref()).is_some_and(|light| light.emits(&node.world))
        })
    }

    /// Adds lights and cameras to the scene in the order of their nodes.
    fn add_lights_and_cameras(
        &self,
        scene: &mut Scene,
        mesh_lights: Vec<PlacedMeshLight>,
        notes: &mut Notes,
    ) -> Result<()> {
        let mut mesh_lights = mesh_lights.into_iter().peekable();
        for (i, (node, of_node)) in self.nodes.iter().zip(&self.references).enumerate() {
            scene.adopt_mesh_lights(&mut mesh_lights, i, node.json.name()?);
            if let Some(light) = of_node.light.and_then(|light| self.lights[light].as_ref()) {
                let index = scene.lights.len();
                let light = light.place(&node.json, &node.world, &scene.normalisation, index, notes)?;
                scene.lights.extend(light);
            }
            if let Some(camera) = of_node.camera {
                let index = scene.cameras.len();
                let camera = self.cameras[camera].place(&node.json, &node.world, &scene.normalisation, index, notes)?;
                scene.cameras.extend(camera);
            }
        }
        scene.adopt_mesh_lights(&mut mesh_lights, self.nodes.len(), Some("default light".into()));
        Ok(())
    }
}

fn check_asset(root: &Json, notes: &mut Notes) -> Result<()> {
    let version = root.require("asset")?.require("version")?;
    let text = version.string()?;
    let is_number = |s: &str| !s.is_empty() && s.bytes().all(|b| b.is_ascii_digit());
    if !text.split_once('.').is_some_and(|(major, minor)| major == "2" && is_number(minor)) {
        return Err(version.error(format!("glTF version \"{text}\", only 2.x is supported")));
    }
    // A later version 2.x renders as 2.0 does, unless the file says that it does not.
    if let Some(needed) = root.require("asset")?.get("minVersion")?
        && needed.string()? != "2.0"
    {
        notes.push(format!("the file needs glTF version {}: only what 2.0 has is rendered", needed.string()?));
    }
    Ok(())
}

fn check_extensions(root: &Json, notes: &mut Notes) -> Result<()> {
    for extension in root.list("extensionsRequired")? {
        let name = extension.string()?;
        if !is_supported(name) {
            return Err(extension.error(format!("the file requires the extension {name}, which is not supported")));
        }
    }
    for extension in root.list("extensionsUsed")? {
        let name = extension.string()?;
        if !is_supported(name) {
            notes.push(format!("the extension {name} is not supported: its content is not rendered"));
        }
    }
    Ok(())
}

/// Numbers of things that nodes may refer to.
struct Counts {
    skins: usize,
    cameras: usize,
    lights: usize,
}

/// Indices of what a node refers to.
struct References<'r, 'a> {
    mesh: Option<usize>,
    /// Its own weights of the mesh's morph targets.
    weights: Option<Vec<f64>>,
    skin: Option<usize>,
    camera: Option<usize>,
    light: Option<usize>,
    /// The copies of the mesh.
    instances: Option<Instances<'r, 'a>>,
}

impl References<'_, '_> {
    /// The weights of the mesh's morph targets at the node.
    fn weights<'p>(&'p self, mesh: &'p Mesh) -> &'p [f64] {
        self.weights.as_ref().unwrap_or(&mesh.weights)
    }

    /// The number of times that the mesh is there.
    fn copies(&self) -> usize {
        self.instances.as_ref().map_or(1, |instances| instances.count)
    }
}

/// Checks the references of every node of the file. Returns those of the nodes `of_scene`, as far as they are visible.
fn check_nodes<'r, 'a>(
    root: &Json<'a>,
    of_scene: &[Node<'a>],
    meshes: &[Mesh],
    counts: &Counts,
    accessors: &'r [Accessor<'a>],
) -> Result<Vec<References<'r, 'a>>> {
    let references = |node: &Json<'a>| -> Result<References<'r, 'a>> {
        let light = match node.extension("KHR_lights_punctual")? {
            Some(extension) => Some(extension.require("light")?.index(counts.lights, "light")?),
            None => None,
        };
        let index = |key: &str, count: usize| node.get(key)?.map(|i| i.index(count, key)).transpose();
        let (mesh, skin) = (index("mesh", meshes.len())?, index("skin", counts.skins)?);
        if mesh.is_none()
            && let Some(skin) = node.get("skin")?
        {
            return Err(skin.error("a node with a skin needs a mesh"));
        }
        let weights = mesh::weights(node, mesh.map_or(0, |mesh| meshes[mesh].weights.len()))?;
        let (camera, instances) = (index("camera", counts.cameras)?, Instances::read(node, accessors)?);
        Ok(References { mesh, weights, skin, camera, light, instances })
    };
    for node in root.list("nodes")? {
        references(&node)?;
    }
    let shown = |node: &Node<'a>| match references(&node.json)? {
        shown if node.visible => Ok(shown),
        hidden => Ok(References { mesh: None, light: None, ..hidden }),
    };
    of_scene.iter().map(shown).collect()
}

/// Adds notes on content of the file that is not rendered.
fn note_omissions(scene: &Scene, skipped: &mesh::Skipped, default_light: bool, notes: &mut Notes) -> Result<()> {
    let mut note = |number: usize, one: &str, many: &str, text: &str| {
        if number > 0 {
            let primitives = count(number, &format!("primitive {one}"), &format!("primitives {many}"));
            notes.push(format!("{primitives} {text}"));
        }
    };
    let (has, have) = ("has", "have");
    let targets = "morph targets for missing attributes, or for attributes that are not supported: these do not change";
    note(skipped.partly_morphed, has, have, targets);
    note(skipped.uneven, has, have, "joint weights whose sum is not 1: they are divided by the sum");
    note(skipped.without_coordinates, "lacks", "lack", "coordinates for textures, which are read at 0, 0");
    note(skipped.points_and_lines, "consists", "consist", "of points or lines: left out");
    note(skipped.without_positions, has, have, "no positions: left out");
    note(skipped.not_finite, has, have, "numbers that are not finite: left out");
    for (index, material) in scene.materials.iter().enumerate().filter(|(_, material)| material.encloses_volume()) {
        let is_faded = |vertex: &u32| scene.vertices[*vertex as usize].colour.w < 1.0;
        let fades = |triangle: &Triangle| triangle.material as usize == index && triangle.vertices.iter().any(is_faded);
        if !material.has_gaps(|| scene.triangles.iter().any(fades)) {
            continue;
        }
        notes.push(format!(
            "material \"{}\" has a volume, and its alpha may be below 1: rays that pass its surface are absorbed too \
            much or not at all; with the alphaMode OPAQUE they are absorbed as they should be",
            material.name
        ));
    }
    if scene.cameras.is_empty() {
        notes.push("no camera in the scene");
    }
    if scene.lights.is_empty() {
        let rest = match default_light {
            true => ", and `default_light` adds none because nothing would be lit",
            false => ": `default_light` adds one",
        };
        notes.push(format!("{NO_LIGHT_NOTE}{rest}"));
    }
    Ok(())
}
