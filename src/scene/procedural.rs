//! The node extension PENUMBRA_procedural; `docs/procedurals.md` describes it.

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

/// An object as its node has it, and the corners of its box in world space.
pub(super) struct Placed<'a> {
    node: Json<'a>,
    json: Json<'a>,
    world: glam::DAffine3,
    object: Procedural,
    pub corners: [DVec3; 8],
}

/// Reads the objects of the nodes that the scene shows, and adds their functions and materials to it.
pub(super) fn read<'a>(
    nodes: &[Node<'a>],
    resources: &mut Resources,
    scene: &mut Scene,
    notes: &mut Notes,
) -> Result<Vec<Placed<'a>>> {
    let mut builder = Builder::default();
    let mut placed: Vec<Placed> = Vec::new();
    let materials = scene.materials.len();
    let mut own_materials: Vec<Option<u32>> = vec![None; materials];
    let mut default_material = None;
    for (index, node) in nodes.iter().enumerate() {
        let Some(json) = node.json.extension(EXTENSION)? else { continue };
        if placed.len() == MAX_OBJECTS {
            return Err(json.error(format!("the scene has more than {MAX_OBJECTS} procedural objects")));
        }
        let kind = json.require("kind")?;
        let role = match kind.string()? {
            "intersection" => Role::Intersection,
            "distance" => Role::Distance,
            other => return Err(kind.error(format!("`{other}` is neither intersection nor distance"))),
        };
        let function = function(&json, role, resources, &mut builder)?;
        let corner = |key: &str| -> Result<Vec3> {
            json.require(key).and_then(|_| json.numbers_in::<3>(key, 0.0, ..)).map(Vec3::from)
        };
        let bounds = [corner("min")?, corner("max")?];
        if !bounds[0].cmplt(bounds[1]).all() {
            return Err(json.require("max")?.error("is not beyond `min` in each coordinate"));
        }
        let colour = match json.get("colour")? {
            Some(colour) => {
                Some((self::function(&colour, Role::Colour, resources, &mut builder)?, parameters(&colour)?))
            }
            None => None,
        };
        let own = match json.get("material")? {
            Some(material) => &mut own_materials[material.index(materials, "material")?],
            None => &mut default_material,
        };
        let material = match *own {
            Some(material) => material,
            None => {
                let of_file = json.get("material")?.map(|m| m.whole()).transpose()?;
                scene.materials.push(plain(of_file.map(|m| scene.materials[m].clone()).unwrap_or_default(), notes));
                *own.insert(scene.materials.len() as u32 - 1)
            }
        };
        let corners = box_corners(bounds.map(Vec3::as_dvec3)).map(|p| node.world.transform_point3(p));
        let name = node.json.name()?.unwrap_or_else(|| format!("node {index}"));
        let parameters = parameters(&json)?;
        let object = Procedural { name, to_own: Default::default(), bounds, function, parameters, colour, material };
        placed.push(Placed { node: node.json.clone(), json, world: node.world, object, corners });
    }
    if let Some(first) = placed.first() {
        scene.functions = builder.finish().map_err(|problem| first.json.error(problem))?;
    }
    Ok(placed)
}

/// Brings the objects into normalised space.
pub(super) fn place(placed: Vec<Placed>, scene: &mut Scene) -> Result<()> {
    for Placed { node, world, object, .. } in placed {
        let to_own = to_own(&world, &scene.normalisation);
        let to_own =
            to_own.ok_or_else(|| node.error("has a procedural object, and is scaled to nothing or without bound"))?;
        scene.procedurals.push(Procedural { to_own, ..object });
    }
    Ok(())
}

/// The function that `source` and `function` name.
fn function(json: &Json, role: Role, resources: &mut Resources, builder: &mut Builder) -> Result<u32> {
    let source = json.require("source")?;
    let bytes = resources.resolve(&source)?;
    let named = |problem: String| {
        let file = source.string().ok().filter(|uri| !uri.starts_with("data:")).unwrap_or("the functions");
        source.error(format!("{file}: {problem}"))
    };
    let text = std::str::from_utf8(&bytes).map_err(|e| {
        let line = 1 + bytes[..e.valid_up_to()].iter().filter(|byte| **byte == b'\n').count();
        named(format!("line {line}: is not text in UTF-8"))
    })?;
    let name = json.require("function")?;
    builder.function(text, name.string()?, role).map_err(named)
}

/// Up to four numbers; zeros where there are fewer.
fn parameters(json: &Json) -> Result<[f32; 4]> {
    let items = json.list("parameters")?;
    let mut parameters = [0.0; 4];
    if items.len() > parameters.len() {
        return Err(json.require("parameters")?.error(format!("has {} numbers, at most 4 can be", items.len())));
    }
    for (parameter, item) in parameters.iter_mut().zip(items) {
        *parameter = item.number()? as f32;
        if !parameter.is_finite() {
            return Err(item.error("is out of range"));
        }
    }
    Ok(parameters)
}

/// A material without what needs triangles: textures, alpha, tangents, and emission, which lights are made of.
fn plain(material: Material, notes: &mut Notes) -> Material {
    let name = &material.name;
    let mut note = |has: bool, what: &str| {
        if has {
            notes.push(format!("procedural objects have no {what}: that of material `{name}` is not shown on them"));
        }
    };
    note(material.slots().next().is_some(), "texture coordinates");
    note(material.alpha != AlphaMode::Opaque, "alpha");
    note(material.anisotropy > 0.0, "anisotropy");
    note(material.emissive != Vec3::ZERO, "emission");
    Material { alpha: AlphaMode::Opaque, anisotropy: 0.0, emissive: Vec3::ZERO, ..material.without_textures() }
}
