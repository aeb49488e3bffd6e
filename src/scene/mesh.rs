//! Mesh primitives: checked attributes and triangles in the mesh's own space.

use glam::{Vec2, Vec3, Vec4};

use super::accessor::{Accessor, Component};
use super::import_options::ImportOptions;
use super::json::Json;
use super::limits::{MAX_CORNERS, MAX_VERTICES};
use super::material::Material;
use super::variants::Variants;
use crate::Result;

/// A primitive of triangles.
pub(super) struct Primitive {
    pub positions: Vec<Vec3>,
    /// One for each position, or empty. The same holds for the other attributes.
    pub normals: Vec<Vec3>,
    pub tangents: Vec<Vec4>,
    pub uvs: [Vec<Vec2>; 2],
    pub colours: Vec<Vec4>,
    /// Vertex indices, counter-clockwise as seen from the front, each within the positions.
    pub triangles: Vec<[u32; 3]>,
    /// Index into the file's materials.
    pub material: Option<usize>,
}

/// Counts of primitives that are not rendered, or only in part.
#[derive(Default)]
pub(super) struct Skipped {
    pub points_and_lines: usize,
    pub without_positions: usize,
    pub morphed: usize,
    pub not_finite: usize,
}

/// Reads the primitives of each mesh.
pub(super) fn read(
    root: &Json,
    accessors: &[Accessor],
    materials: &[Material],
    variants: &Variants,
    options: &ImportOptions,
) -> Result<(Vec<Vec<Primitive>>, Skipped)> {
    let (lenient, skipped) = (options.lenient, Skipped::default());
    let mut reader = Reader { accessors, materials, variants, lenient, corners: 0, vertices: 0, skipped };
    let mut meshes = Vec::new();
    for mesh in root.list("meshes")? {
        let list = mesh.require("primitives")?;
        let mut primitives = Vec::new();
        for json in list.items()? {
            primitives.extend(reader.primitive(&json)?);
        }
        if list.len() == 0 {
            return Err(list.error("must not be empty"));
        }
        meshes.push(primitives);
    }
    Ok((meshes, reader.skipped))
}

struct Reader<'r, 'a> {
    accessors: &'r [Accessor<'a>],
    materials: &'r [Material],
    variants: &'r Variants,
    lenient: bool,
    /// Number of corners read so far. Accessors may be shared, so the size of the file does not bound it.
    corners: usize,
    /// Number of vertices read so far.
    vertices: usize,
    skipped: Skipped,
}

impl<'r, 'a> Reader<'r, 'a> {
    fn primitive(&mut self, json: &Json<'a>) -> Result<Option<Primitive>> {
        let attributes = json.require("attributes")?;
        let mode = json.get("mode")?.map_or(Ok(4), |mode| mode.index(7, "mode"))?;
        let material = json.get("material")?.map(|m| m.index(self.materials.len(), "material")).transpose()?;
        let material = self.variants.material(json, self.materials.len())?.or(material);
        self.skipped.morphed += usize::from(json.get("targets")?.is_some());
        let Some(position) = attributes.get("POSITION")? else {
            self.skipped.without_positions += 1;
            return Ok(None);
        };
        let count = self.accessor(&position)?.count;
        if mode < 4 {
            self.skipped.points_and_lines += 1;
            return Ok(None);
        }
        let mut corners = self.corners(json, count)?;
        let which = used(&corners, count);
        self.vertices += which.as_ref().map_or(count, Vec::len);
        if self.vertices > MAX_VERTICES {
            return Err(json.error(format!("the meshes have more than {MAX_VERTICES} vertices")));
        }
        if let Some(which) = &which {
            for corner in &mut corners {
                *corner = which.partition_point(|vertex| vertex < corner) as u32;
            }
        }
        let mut read = Attributes { json: attributes, reader: self, count, which: which.as_deref(), not_finite: false };
        let positions = read.read::<3, Vec3>("POSITION", &[3])?;
        let normals = read.read::<3, Vec3>("NORMAL", &[3])?;
        let tangents = read.read::<4, Vec4>("TANGENT", &[4])?;
        let uvs = [read.read::<2, Vec2>("TEXCOORD_0", &[2])?, read.read::<2, Vec2>("TEXCOORD_1", &[2])?];
        let colours = read.read::<4, Vec4>("COLOR_0", &[3, 4])?;
        if read.not_finite {
            self.skipped.not_finite += 1;
            return Ok(None);
        }
        let mut textures = material.into_iter().flat_map(|m| self.materials[m].texture_infos());
        if let Some(texture) = textures.find(|texture| uvs[texture.uv_set as usize].is_empty()) {
            let material = json.require("material")?;
            let problem = format!("its textures need TEXCOORD_{}, which the primitive lacks", texture.uv_set);
            return Err(material.error(problem));
        }
        let triangles = assemble(mode, &corners);
        if triangles.is_empty() {
            return Ok(None);
        }
        Ok(Some(Primitive { positions, normals, tangents, uvs, colours, triangles, material }))
    }

    fn accessor(&self, index: &Json) -> Result<&'r Accessor<'a>> {
        Ok(&self.accessors[index.index(self.accessors.len(), "accessor")?])
    }

    /// The vertex indices of the corners of a primitive with `count` vertices, in the order of the file.
    fn corners(&mut self, json: &Json, count: usize) -> Result<Vec<u32>> {
        let indices =
            json.get("indices")?.map(|json| self.accessor(&json).map(|accessor| (accessor, json))).transpose()?;
        self.corners += indices.as_ref().map_or(count, |(indices, _)| indices.count);
        if self.corners > MAX_CORNERS {
            return Err(json.error(format!("the meshes have more than {MAX_CORNERS} corners of triangles")));
        }
        let Some((indices, index_json)) = indices else { return Ok((0..count as u32).collect()) };
        let values = indices.indices()?;
        match values.iter().position(|&vertex| vertex as usize >= count) {
            Some(i) => Err(index_json.error(format!("index {i} is {}, but there are {count} vertices", values[i]))),
            None => Ok(values),
        }
    }
}

/// The sorted indices of the vertices that occur in `corners`. None if all `count` vertices do. Exporters share one set
/// of vertices between many primitives, so the time to read a primitive must not grow with the size of the set.
fn used(corners: &[u32], count: usize) -> Option<Vec<u32>> {
    let which = if corners.len() < count {
        let mut which = corners.to_vec();
        which.sort_unstable();
        which.dedup();
        which
    } else {
        let mut occurs = vec![false; count];
        corners.iter().for_each(|&vertex| occurs[vertex as usize] = true);
        (0..count as u32).filter(|&vertex| occurs[vertex as usize]).collect()
    };
    (which.len() < count).then_some(which)
}

/// Reads the attributes of a primitive with `count` vertices: those of the vertices `which`, or of all.
struct Attributes<'r, 'a> {
    json: Json<'a>,
    reader: &'r Reader<'r, 'a>,
    count: usize,
    which: Option<&'r [u32]>,
    /// Whether a lenient import has read a NaN or infinite number.
    not_finite: bool,
}

impl Attributes<'_, '_> {
    /// The values of the attribute `name`, empty if it is absent. Its number of components must be one of `widths`.
    fn read<const N: usize, T: From<[f32; N]>>(&mut self, name: &str, widths: &[usize]) -> Result<Vec<T>> {
        let Some(json) = self.json.get(name)? else { return Ok(Vec::new()) };
        let accessor = self.reader.accessor(&json)?;
        if accessor.count != self.count {
            return Err(json.error(format!("has {} elements, POSITION has {}", accessor.count, self.count)));
        }
        let values = accessor.floats::<N>(1.0, self.which)?;
        if !widths.contains(&accessor.width) || accessor.component == Component::U32 {
            return Err(json.error("the type of its accessor is not allowed for this attribute"));
        }
        if let Some(i) = values.iter().position(|v| v.iter().any(|x| !x.is_finite())) {
            if !self.reader.lenient {
                let element = self.which.map_or(i, |which| which[i] as usize);
                return Err(json.error(format!("element {element} is not finite")));
            }
            self.not_finite = true;
        }
        Ok(values.into_iter().map(T::from).collect())
    }
}

/// Triangles of `corners` in mode 4 (list), 5 (strip) or 6 (fan), with the winding of glTF 3.7.2.1.
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
