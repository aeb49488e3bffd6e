//! Mesh primitives: checked attributes and triangles in the mesh's own space.

use glam::{Vec2, Vec3, Vec4};

use super::accessor::{Accessor, Component};
use super::import_options::ImportOptions;
use super::json::Json;
use super::limits::{MAX_CORNERS, MAX_DISPLACEMENTS, MAX_VERTICES};
use super::material::Material;
use super::morph::{self, Morph};
use super::skin::{self, Influences};
use super::variants::Variants;
use crate::Result;

/// A mesh.
pub(super) struct Mesh<'r, 'a> {
    /// The primitives that are rendered.
    pub primitives: Vec<Primitive<'r, 'a>>,
    /// Default weights of its morph targets, one for each.
    pub weights: Vec<f64>,
}

/// A primitive of triangles.
pub(super) struct Primitive<'r, 'a> {
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
    /// Its morph targets, as many as the mesh has.
    pub morph: Option<Morph<'r, 'a>>,
    /// How the joints of a skin move it.
    pub influences: Option<Influences<'a>>,
}

/// Counts of primitives that are not rendered, or only in part.
#[derive(Default)]
pub(super) struct Skipped {
    pub points_and_lines: usize,
    pub without_positions: usize,
    pub not_finite: usize,
    /// Morph targets displace attributes for which there is no support.
    pub partly_morphed: usize,
    /// Weights of joints have a sum that is not 1.
    pub uneven: usize,
    /// Textures have no coordinates, which a lenient import accepts.
    pub without_coordinates: usize,
}

/// Reads the primitives of each mesh.
pub(super) fn read<'r, 'a>(
    root: &Json<'a>,
    accessors: &'r [Accessor<'a>],
    materials: &[Material],
    variants: &Variants,
    options: &ImportOptions,
) -> Result<(Vec<Mesh<'r, 'a>>, Skipped)> {
    let (corners, vertices, displacements, skipped) = Default::default();
    let lenient = options.lenient;
    let mut reader = Reader { accessors, materials, variants, lenient, corners, vertices, displacements, skipped };
    let mut meshes = Vec::new();
    for mesh in root.list("meshes")? {
        let list = mesh.require("primitives")?;
        let mut primitives = Vec::new();
        let mut targets = None;
        for json in list.items()? {
            let count = json.list_len("targets")?;
            if *targets.get_or_insert(count) != count {
                return Err(json.error("has a different number of morph targets from the first primitive"));
            }
            primitives.extend(reader.primitive(&json)?);
        }
        if list.len() == 0 {
            return Err(list.error("must not be empty"));
        }
        let count = targets.unwrap_or(0);
        let weights = weights(&mesh, count)?.unwrap_or_else(|| vec![0.0; count]);
        meshes.push(Mesh { primitives, weights });
    }
    Ok((meshes, reader.skipped))
}

/// The weights that a node or mesh states for the `count` morph targets of its mesh.
pub(super) fn weights(json: &Json, count: usize) -> Result<Option<Vec<f64>>> {
    let Some(list) = json.get("weights")? else { return Ok(None) };
    let weights = list.items()?.iter().map(Json::number).collect::<Result<Vec<_>>>()?;
    if weights.len() != count {
        return Err(list.error(format!("has {} weights for {count} morph targets", weights.len())));
    }
    Ok(Some(weights))
}

struct Reader<'m, 'r, 'a> {
    accessors: &'r [Accessor<'a>],
    materials: &'m [Material],
    variants: &'m Variants,
    lenient: bool,
    /// Number of corners read so far. Accessors may be shared, so the size of the file does not bound it.
    corners: usize,
    /// Number of vertices read so far.
    vertices: usize,
    /// Number of displacements by morph targets read so far. Targets may share their accessors.
    displacements: usize,
    skipped: Skipped,
}

impl<'r, 'a> Reader<'_, 'r, 'a> {
    fn primitive(&mut self, json: &Json<'a>) -> Result<Option<Primitive<'r, 'a>>> {
        let attributes = json.require("attributes")?;
        let mode = json.get("mode")?.map_or(Ok(4), |mode| mode.index(7, "mode"))?;
        let material = json.get("material")?.map(|m| m.index(self.materials.len(), "material")).transpose()?;
        let material = self.variants.material(json, self.materials.len())?.or(material);
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
        if let Some(which) = &which {
            renumber(&mut corners, which);
        }
        let targets = self.targets(json, &attributes, count)?;
        self.count(json, which.as_ref().map_or(count, Vec::len), targets.len())?;
        let mut read = Attributes { json: attributes, reader: self, count, which: which.as_deref(), not_finite: false };
        let positions = read.read::<3, Vec3>("POSITION", &[3])?;
        let normals = read.read::<3, Vec3>("NORMAL", &[3])?;
        let tangents = read.read::<4, Vec4>("TANGENT", &[4])?;
        let uvs = [read.read::<2, Vec2>("TEXCOORD_0", &[2])?, read.read::<2, Vec2>("TEXCOORD_1", &[2])?];
        let colours = read.read::<4, Vec4>("COLOR_0", &[3, 4])?;
        let influences = read.influences()?;
        let not_finite = read.not_finite;
        let (morph, morph_not_finite) = self.morph(targets, which)?;
        if not_finite || morph_not_finite {
            self.skipped.not_finite += 1;
            return Ok(None);
        }
        self.skipped.uneven += usize::from(influences.as_ref().is_some_and(Influences::is_uneven));
        self.check_coordinates(json, material, &uvs)?;
        let triangles = assemble(mode, &corners);
        if triangles.is_empty() {
            return Ok(None);
        }
        Ok(Some(Primitive { positions, normals, tangents, uvs, colours, triangles, material, morph, influences }))
    }

    /// Counts the vertices of a primitive, and their displacements by `targets` morph targets. Refuses too many.
    fn count(&mut self, json: &Json, vertices: usize, targets: usize) -> Result<()> {
        self.vertices += vertices;
        if self.vertices > MAX_VERTICES {
            return Err(json.error(format!("the meshes have more than {MAX_VERTICES} vertices")));
        }
        self.displacements += targets * vertices;
        if self.displacements > MAX_DISPLACEMENTS {
            let problem = format!("the meshes have more than {MAX_DISPLACEMENTS} displacements by morph targets");
            return Err(json.error(problem));
        }
        Ok(())
    }

    /// The morph targets of the vertices `which`, or of all; `None` if there are no targets. Also returns whether a
    /// lenient import found a number in them that is not finite.
    fn morph(
        &self,
        targets: Vec<morph::Target<'r, 'a>>,
        which: Option<Vec<u32>>,
    ) -> Result<(Option<Morph<'r, 'a>>, bool)> {
        if targets.is_empty() {
            return Ok((None, false));
        }
        let (morph, wrong) = Morph::new(targets, which)?;
        match &wrong {
            Some((json, element)) if !self.lenient => Err(json.error(format!("element {element} is not finite"))),
            _ => Ok((Some(morph), wrong.is_some())),
        }
    }

    /// Checks that the primitive has the coordinates of all textures of its material, which a variant may have given.
    fn check_coordinates(&mut self, json: &Json<'a>, material: Option<usize>, uvs: &[Vec<Vec2>; 2]) -> Result<()> {
        let mut textures = material.into_iter().flat_map(|m| self.materials[m].texture_infos());
        let Some(texture) = textures.find(|texture| uvs[texture.uv_set as usize].is_empty()) else { return Ok(()) };
        if !self.lenient {
            let problem = format!("the textures of its material need TEXCOORD_{}, which it lacks", texture.uv_set);
            return Err(json.error(problem + "; `lenient` import reads them at 0, 0"));
        }
        self.skipped.without_coordinates += 1;
        Ok(())
    }

    /// The morph targets of a primitive with `count` vertices.
    fn targets(&mut self, json: &Json<'a>, attributes: &Json<'a>, count: usize) -> Result<Vec<morph::Target<'r, 'a>>> {
        let Some(list) = json.get("targets")? else { return Ok(Vec::new()) };
        let mut targets = Vec::new();
        let mut has_others = false;
        for target in list.items()? {
            let base = |name: &str| attributes.get(name).map(|attribute| attribute.is_some());
            let (target, others) = morph::target(&target, self.accessors, base, count)?;
            targets.push(target);
            has_others |= others;
        }
        if targets.is_empty() {
            return Err(list.error("must not be empty"));
        }
        self.skipped.partly_morphed += usize::from(has_others);
        Ok(targets)
    }

    fn accessor(&self, index: &Json) -> Result<&'r Accessor<'a>> {
        Ok(&self.accessors[index.index(self.accessors.len(), "accessor")?])
    }

    /// The vertex indices of the corners of a primitive with `count` vertices, in the order of the file.
    fn corners(&mut self, json: &Json, count: usize) -> Result<Vec<u32>> {
        let indices =
            json.get("indices")?.map(|json| self.accessor(&json).map(|accessor| (accessor, json))).transpose()?;
        let corners = indices.as_ref().map_or(count, |(indices, _)| indices.count);
        self.corners = self.corners.saturating_add(corners);
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

/// The sorted indices of the vertices that occur in `corners`. `None` if all `count` vertices do. Exporters share one
/// set of vertices between many primitives, so the time to read a primitive must not grow with the size of the set.
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

/// Replaces vertex indices by their positions in `which`, which has all of them.
fn renumber(corners: &mut [u32], which: &[u32]) {
    for corner in corners {
        *corner = which.partition_point(|vertex| vertex < corner) as u32;
    }
}

/// Reads the attributes of a primitive with `count` vertices: those of the vertices `which`, or of all.
struct Attributes<'p, 'r, 'a> {
    json: Json<'a>,
    reader: &'p Reader<'p, 'r, 'a>,
    count: usize,
    which: Option<&'p [u32]>,
    /// Whether a lenient import has read a NaN or infinite number.
    not_finite: bool,
}

impl<'a> Attributes<'_, '_, 'a> {
    /// The joints and weights of the vertices.
    fn influences(&mut self) -> Result<Option<Influences<'a>>> {
        let mut sets = Vec::new();
        loop {
            let [joints_name, weights_name] = ["JOINTS", "WEIGHTS"].map(|name| format!("{name}_{}", sets.len()));
            let (joints, weights) = match (self.json.get(&joints_name)?, self.json.get(&weights_name)?) {
                (Some(joints), Some(weights)) => (joints, weights),
                (None, None) => break,
                (Some(one), None) | (None, Some(one)) => {
                    return Err(one.error(format!("{joints_name} and {weights_name} need each other")));
                }
            };
            if sets.len() == skin::MAX_SETS {
                return Err(joints.error(format!("more than {} sets of joints are not supported", skin::MAX_SETS)));
            }
            let of = |json: &Json<'a>| self.reader.accessor(json);
            skin::check_set((&joints, of(&joints)?), (&weights, of(&weights)?))?;
            // The numbers have at most 16 bits, so they are exact as floats.
            let numbers = self.read::<4, [f32; 4]>(&joints_name, &[4])?;
            let shares = self.read::<4, [f32; 4]>(&weights_name, &[4])?;
            if let Some(i) = shares.iter().position(|weights| weights.iter().any(|weight| *weight < 0.0)) {
                let element = self.which.map_or(i, |which| which[i] as usize);
                return Err(weights.error(format!("element {element} has a negative weight")));
            }
            let numbers = numbers.into_iter().map(|joints| joints.map(|joint| joint as u16)).collect();
            sets.push(skin::Set { json: joints, joints: numbers, weights: shares });
        }
        Ok((!sets.is_empty()).then(|| Influences::new(sets)))
    }

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
