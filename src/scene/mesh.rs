//! Mesh primitives: attributes and triangles in the mesh's own space, checked.

use glam::{Vec2, Vec3, Vec4};

use super::accessor::Accessor;
use super::json::Json;
use super::{ImportOptions, Material};
use crate::Result;

/// A primitive made of triangles.
pub(super) struct Primitive {
    pub positions: Vec<Vec3>,
    /// One for each position, or none; likewise for the other attributes.
    pub normals: Vec<Vec3>,
    pub tangents: Vec<Vec4>,
    pub uvs: [Vec<Vec2>; 2],
    pub colours: Vec<Vec4>,
    /// Counter-clockwise from the front; every index within the positions.
    pub triangles: Vec<[u32; 3]>,
    /// Index into the file's materials.
    pub material: Option<usize>,
}

/// What the primitives of a file hold that is not shown.
#[derive(Default)]
pub(super) struct Skipped {
    pub points_and_lines: usize,
    pub without_positions: usize,
    pub morphed: usize,
    pub not_finite: usize,
}

/// The primitives of each mesh.
pub(super) fn read(
    root: &Json,
    accessors: &[Accessor],
    materials: &[Material],
    options: &ImportOptions,
    skipped: &mut Skipped,
) -> Result<Vec<Vec<Primitive>>> {
    let mut meshes = Vec::new();
    for mesh in root.list("meshes")? {
        let mut primitives = Vec::new();
        let list = mesh.require("primitives")?;
        for json in list.items()? {
            primitives.extend(primitive(&json, accessors, materials, options, skipped)?);
        }
        if list.len() == 0 {
            return Err(list.error("must not be empty"));
        }
        meshes.push(primitives);
    }
    Ok(meshes)
}

/// Reads attributes of `count` elements.
struct Attributes<'r, 'a> {
    json: Json<'a>,
    accessors: &'r [Accessor<'a>],
    count: usize,
    /// Some number read is NaN or infinite, and leniency was asked for.
    not_finite: bool,
    lenient: bool,
}

impl Attributes<'_, '_> {
    /// The attribute `name`, if present; its width must be one of `widths`.
    fn read<const N: usize, T: From<[f32; N]>>(&mut self, name: &str, widths: &[usize]) -> Result<Vec<T>> {
        let Some(json) = self.json.get(name)? else { return Ok(Vec::new()) };
        let accessor = &self.accessors[json.index(self.accessors.len(), "accessor")?];
        if accessor.count != self.count {
            return Err(json.error(format!("has {} elements, POSITION has {}", accessor.count, self.count)));
        }
        let values = accessor.floats::<N>(1.0)?;
        if !widths.contains(&accessor.width) || accessor.component == super::accessor::Component::U32 {
            return Err(json.error("its accessor has a type that this attribute cannot have"));
        }
        if let Some(i) = values.iter().position(|v| v.iter().any(|x| !x.is_finite())) {
            if !self.lenient {
                return Err(json.error(format!("element {i} is not finite")));
            }
            self.not_finite = true;
        }
        Ok(values.into_iter().map(T::from).collect())
    }
}

fn primitive(
    json: &Json,
    accessors: &[Accessor],
    materials: &[Material],
    options: &ImportOptions,
    skipped: &mut Skipped,
) -> Result<Option<Primitive>> {
    let attributes = json.require("attributes")?;
    let mode = json.get("mode")?.map_or(Ok(4), |mode| mode.index(7, "mode"))?;
    let material = json.get("material")?.map(|m| m.index(materials.len(), "material")).transpose()?;
    skipped.morphed += usize::from(json.get("targets")?.is_some());
    let Some(position) = attributes.get("POSITION")? else {
        skipped.without_positions += 1;
        return Ok(None);
    };
    let count = accessors[position.index(accessors.len(), "accessor")?].count;
    if mode < 4 {
        skipped.points_and_lines += 1;
        return Ok(None);
    }
    let mut read = Attributes { json: attributes, accessors, count, not_finite: false, lenient: options.lenient };
    let positions = read.read::<3, Vec3>("POSITION", &[3])?;
    let normals = read.read::<3, Vec3>("NORMAL", &[3])?;
    let tangents = read.read::<4, Vec4>("TANGENT", &[4])?;
    let uvs = [read.read::<2, Vec2>("TEXCOORD_0", &[2])?, read.read::<2, Vec2>("TEXCOORD_1", &[2])?];
    let colours = read.read::<4, Vec4>("COLOR_0", &[3, 4])?;
    if read.not_finite {
        skipped.not_finite += 1;
        return Ok(None);
    }
    if let Some(slot) = material.and_then(|m| materials[m].slots().find(|slot| uvs[slot.uv_set as usize].is_empty())) {
        let place = json.get("material")?.unwrap_or_else(|| json.clone());
        return Err(place.error(format!("its textures need TEXCOORD_{}, which the primitive lacks", slot.uv_set)));
    }
    let corners: Vec<u32> = match json.get("indices")? {
        Some(indices) => {
            let values = accessors[indices.index(accessors.len(), "accessor")?].indices()?;
            if let Some((i, vertex)) = values.iter().enumerate().find(|(_, v)| **v as usize >= count) {
                return Err(indices.error(format!("index {i} is {vertex}, there are {count} vertices")));
            }
            values
        }
        None => {
            u32::try_from(count).map_err(|_| json.error(format!("{count} vertices are too many")))?;
            (0..count as u32).collect()
        }
    };
    Ok(Some(Primitive { positions, normals, tangents, uvs, colours, triangles: assemble(mode, &corners), material }))
}

/// Triangles of `corners` in mode 4 (list), 5 (strip) or 6 (fan), wound as glTF 3.7.2.1 says.
fn assemble(mode: usize, corners: &[u32]) -> Vec<[u32; 3]> {
    match mode {
        4 => corners.as_chunks::<3>().0.to_vec(),
        5 => corners
            .windows(3)
            .enumerate()
            .map(|(i, w)| if i % 2 == 0 { [w[0], w[1], w[2]] } else { [w[0], w[2], w[1]] })
            .collect(),
        _ => corners.windows(2).skip(1).map(|w| [w[0], w[1], corners[0]]).collect(),
    }
}
