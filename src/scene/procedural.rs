//! Import of the node extension PENUMBRA_procedural, which `docs/procedurals.md` describes.

use glam::{DVec3, Vec3};

use super::container::Resources;
use super::description::Scene;
use super::json::Json;
use super::material::{AlphaMode, Material};
use super::node::Node;
use super::notes::Notes;
use crate::Result;
use crate::procedural::{Builder, MAX_OBJECTS, Procedural, Role, box_corners, to_own};

/// Name of the extension.
pub(super) const EXTENSION: &str = "PENUMBRA_procedural";

/// An object of a node, before its transform is known in normalised space.
pub(super) struct Placed<'a> {
    node: Json<'a>,
    json: Json<'a>,
    world: glam::DAffine3,
    object: Procedural,
    /// Corners of its bounding box in world space.
    pub corners: [DVec3; 8],
}

/// Reads the objects of the visible nodes, and adds their functions and materials to the scene, the first `of_file` of
/// whose materials are those of the file.
pub(super) fn read<'a>(
    nodes: &[Node<'a>],
    of_file: usize,
    resources: &mut Resources,
    scene: &mut Scene,
    notes: &mut Notes,
) -> Result<Vec<Placed<'a>>> {
    let own_materials = vec![None; of_file];
    let builder = Builder::default();
    let mut reader = Reader { resources, scene, notes, builder, own_materials, default_material: None };
    let mut placed: Vec<Placed> = Vec::new();
    for (index, node) in nodes.iter().enumerate() {
        let Some(json) = node.json.extension(EXTENSION)? else { continue };
        if !node.visible {
            reader.note_files(&json);
            continue;
        }
        if placed.len() == MAX_OBJECTS {
            return Err(json.error(format!("the scene has more than {MAX_OBJECTS} procedural objects")));
        }
        placed.push(reader.object(index, node, json)?);
    }
    if let Some(first) = placed.first() {
        reader.scene.functions = reader.builder.finish().map_err(|problem| first.json.error(problem))?;
    }
    Ok(placed)
}

struct Reader<'r> {
    resources: &'r mut Resources,
    scene: &'r mut Scene,
    notes: &'r mut Notes,
    builder: Builder,
    /// For each material of the file, the index of its variant for procedural objects, once it is made.
    own_materials: Vec<Option<u32>>,
    default_material: Option<u32>,
}

impl Reader<'_> {
    /// Reads the files of a hidden object, so that they are among those of the scene: another moment of its animation
    /// may show it. Whether they are there and what they say matters only then.
    fn note_files(&mut self, json: &Json) {
        for holder in [Some(json.clone()), json.get("colour").ok().flatten()].into_iter().flatten() {
            if let Ok(Some(source)) = holder.get("source") {
                let _ = self.resources.resolve(&source);
            }
        }
    }

    fn object<'a>(&mut self, index: usize, node: &Node<'a>, json: Json<'a>) -> Result<Placed<'a>> {
        let kind = json.require("kind")?;
        let role = match kind.string()? {
            "intersection" => Role::Intersection,
            "distance" => Role::Distance,
            other => return Err(kind.error(format!("\"{other}\" is neither intersection nor distance"))),
        };
        let function = self.function(&json, role)?;
        let corner = |key: &str| -> Result<Vec3> {
            json.require(key).and_then(|_| json.numbers_in::<3>(key, 0.0, ..)).map(Vec3::from)
        };
        let bounds = [corner("min")?, corner("max")?];
        if !bounds[0].cmplt(bounds[1]).all() {
            return Err(json.require("max")?.error("is not beyond `min` in each coordinate"));
        }
        let colour = match json.get("colour")? {
            Some(colour) => Some((self.function(&colour, Role::Colour)?, parameters(&colour)?)),
            None => None,
        };
        let material = self.material(&json)?;
        let corners = box_corners(bounds.map(Vec3::as_dvec3)).map(|p| node.world.transform_point3(p));
        let name = node.json.name()?.unwrap_or_else(|| format!("node {index}"));
        let parameters = parameters(&json)?;
        let object = Procedural { name, to_own: Default::default(), bounds, function, parameters, colour, material };
        Ok(Placed { node: node.json.clone(), json, world: node.world, object, corners })
    }

    /// The number of the function that the members `source` and `function` refer to.
    fn function(&mut self, json: &Json, role: Role) -> Result<u32> {
        let source = json.require("source")?;
        let bytes = self.resources.resolve(&source)?;
        let error = |problem: String| {
            let file = source.string().ok().filter(|uri| !uri.starts_with("data:")).unwrap_or("the functions");
            source.error(format!("{file}: {problem}"))
        };
        let text = std::str::from_utf8(&bytes).map_err(|e| {
            let line = 1 + bytes[..e.valid_up_to()].iter().filter(|byte| **byte == b'\n').count();
            error(format!("line {line}: is not text in UTF-8"))
        })?;
        let name = json.require("function")?;
        self.builder.function(text, name.string()?, role).map_err(error)
    }

    /// The index of the object's material in the scene, without the properties that objects do not have.
    fn material(&mut self, json: &Json) -> Result<u32> {
        let of_file = match json.get("material")? {
            Some(material) => Some(material.index(self.own_materials.len(), "material")?),
            None => None,
        };
        let own = match of_file {
            Some(material) => &mut self.own_materials[material],
            None => &mut self.default_material,
        };
        if let Some(material) = *own {
            return Ok(material);
        }
        let material = of_file.map(|material| self.scene.materials[material].clone()).unwrap_or_default();
        self.scene.materials.push(plain(material, self.notes));
        Ok(*own.insert(self.scene.materials.len() as u32 - 1))
    }
}

/// Adds the objects to the scene, in its normalised space.
pub(super) fn place(placed: Vec<Placed>, scene: &mut Scene) -> Result<()> {
    for Placed { node, world, object, .. } in placed {
        let to_own = to_own(&world, &scene.normalisation);
        let to_own = to_own.ok_or_else(|| {
            node.error(
                "has a procedural object, and its matrix has no inverse: it is scaled to nothing or without bound",
            )
        })?;
        scene.procedurals.push(Procedural { to_own, ..object });
    }
    Ok(())
}

/// The member `parameters`: up to four numbers. Missing ones are zero.
fn parameters(json: &Json) -> Result<[f32; 4]> {
    let items = json.list("parameters")?;
    let mut parameters = [0.0; 4];
    if items.len() > parameters.len() {
        return Err(json.require("parameters")?.error(format!("has {} numbers, the maximum is 4", items.len())));
    }
    for (parameter, item) in parameters.iter_mut().zip(items) {
        *parameter = item.number()? as f32;
        if !parameter.is_finite() {
            return Err(item.error("is out of range"));
        }
    }
    Ok(parameters)
}

/// The material without the properties that only triangles have: textures, alpha, anisotropy and emission. Adds a note
/// for each.
fn plain(material: Material, notes: &mut Notes) -> Material {
    let name = &material.name;
    let mut note = |has: bool, what: &str| {
        if has {
            notes.push(format!("procedural objects have no {what}: that of material \"{name}\" is ignored for them"));
        }
    };
    note(material.texture_infos().next().is_some(), "texture coordinates");
    note(material.alpha != AlphaMode::Opaque, "alpha");
    note(material.anisotropy.is_present(), "anisotropy");
    note(material.emissive != Vec3::ZERO, "emission");
    Material {
        alpha: AlphaMode::Opaque,
        anisotropy: Default::default(),
        emissive: Vec3::ZERO,
        ..material.without_textures()
    }
}
