//! Primitives compressed by KHR_draco_mesh_compression. The crate `draco-core` decodes them. The result replaces the
//! data that the primitive's accessors lack.

use std::collections::{HashMap, HashSet};

use draco_core::{DataType, DecodeLimits, DecoderBuffer, Mesh, MeshDecoder, PointAttribute, PointIndex};
use rayon::prelude::*;

use super::accessor::{Component, Views};
use super::json::Json;
use super::limits::{MAX_CORNERS, MAX_VERTICES};
use crate::Result;

/// Name of the extension.
pub(super) const EXTENSION: &str = "KHR_draco_mesh_compression";

/// Every stream may have `FREE` vertices and as many corners, and a longer one `DENSEST` of each for each of its bytes.
/// A vertex of usual meshes takes some bytes; in a plane of triangles in rows, whose deltas repeat, 20 vertices share
/// one, a twelfth of `DENSEST`. `FREE` vertices take at most 2 MiB.
const FREE: usize = 1 << 12;
const DENSEST: usize = 1 << 8;

/// Maximum bytes of all attributes of a vertex. The attributes of glTF, with two sets of everything, have some 200; a
/// stream may have further ones.
const MAX_VERTEX_BYTES: u64 = 512;

/// Decoded elements of accessors, tightly packed, by the accessors' index.
pub(super) type Decoded = HashMap<usize, Vec<u8>>;

/// An accessor that a stream supplies.
struct Target<'a> {
    json: Json<'a>,
    index: usize,
    component: Component,
    width: usize,
    count: usize,
}

impl<'a> Target<'a> {
    /// `None` if the accessor has data of its own, which is then a lossless copy of the compressed data.
    fn read(index: &Json<'a>, accessors: &[Json<'a>]) -> Result<Option<Self>> {
        let index = index.index(accessors.len(), "accessor")?;
        let json = accessors[index].clone();
        if json.get("bufferView")?.is_some() {
            return Ok(None);
        }
        let component = Component::of(&json)?;
        let width = match json.require("type")?.string()? {
            "SCALAR" => 1,
            "VEC2" => 2,
            "VEC3" => 3,
            "VEC4" => 4,
            other => return Err(json.error(format!("type {other} is not that of an attribute"))),
        };
        let count = json.require("count")?.whole()?;
        Ok(Some(Target { json, index, component, width, count }))
    }

    /// Whether its elements can be indices of vertices.
    fn holds_indices(&self) -> bool {
        self.width == 1 && matches!(self.component, Component::U8 | Component::U16 | Component::U32)
    }
}

/// A compressed primitive.
struct Stream<'a> {
    json: Json<'a>,
    bytes: &'a [u8],
    indices: Option<Target<'a>>,
    /// Attributes with their numbers in the stream.
    attributes: Vec<(u32, Target<'a>)>,
}

/// Decodes the compressed primitives of all meshes whose accessors have no data of their own.
pub(super) fn decode(root: &Json, views: &Views) -> Result<Decoded> {
    let accessors = root.list("accessors")?;
    let mut streams = Vec::new();
    // Primitives that differ in their material share accessors.
    let mut supplied = HashSet::new();
    let (mut vertices, mut corners) = (0usize, 0usize);
    for mesh in root.list("meshes")? {
        for primitive in mesh.list("primitives")? {
            let Some(stream) = stream(&primitive, &accessors, views)? else { continue };
            let targets = stream.indices.iter().chain(stream.attributes.iter().map(|(_, target)| target));
            let new = targets.filter(|target| supplied.insert(target.index)).count();
            if new == 0 {
                continue;
            }
            vertices = vertices.saturating_add(stream.vertices());
            corners = corners.saturating_add(stream.corners());
            if vertices > MAX_VERTICES || corners > MAX_CORNERS {
                return Err(stream.json.error(format!(
                    "the compressed meshes have more than {MAX_VERTICES} vertices or {MAX_CORNERS} corners of triangles"
                )));
            }
            streams.push(stream);
        }
    }
    let decoded: Vec<Result<_>> = streams.par_iter().map(Stream::decode).collect();
    let mut all = Decoded::new();
    for decoded in decoded {
        all.extend(decoded?);
    }
    Ok(all)
}

/// The stream of a primitive, if it has one and needs it.
fn stream<'a>(primitive: &Json<'a>, accessors: &[Json<'a>], views: &Views<'a>) -> Result<Option<Stream<'a>>> {
    let Some(json) = primitive.extension(EXTENSION)? else { return Ok(None) };
    let indices = primitive.get("indices")?.map_or(Ok(None), |index| Target::read(&index, accessors))?;
    if let Some(target) = indices.as_ref().filter(|target| !target.holds_indices()) {
        return Err(target.json.error("the indices of a compressed mesh must be plain unsigned scalars"));
    }
    let (plain, of_stream) = (primitive.require("attributes")?, json.require("attributes")?);
    let mut attributes = Vec::new();
    for (name, number) in of_stream.members()? {
        let target = Target::read(&plain.require(name)?, accessors)?;
        let number = u32::try_from(number.whole()?).map_err(|_| number.error("is out of range"))?;
        attributes.extend(target.map(|target| (number, target)));
    }
    if indices.is_none() && attributes.is_empty() {
        return Ok(None);
    }
    let mode = primitive.get("mode")?.map_or(Ok(4), |mode| mode.whole())?;
    if mode != 4 {
        return Err(json.error(format!("mode {mode} of the primitive: only lists of triangles are decoded")));
    }
    let bytes = views.bytes(&json.require("bufferView")?)?;
    let stream = Stream { json, bytes, indices, attributes };
    let most = FREE.max(bytes.len().saturating_mul(DENSEST));
    let elements = stream.vertices().max(stream.corners());
    if elements > most {
        return Err(stream.json.error(format!(
            "{elements} vertices or corners are declared, {} bytes can hold {most} of them",
            bytes.len()
        )));
    }
    Ok(Some(stream))
}

impl Stream<'_> {
    fn vertices(&self) -> usize {
        self.attributes.iter().map(|(_, target)| target.count).max().unwrap_or(0)
    }

    fn corners(&self) -> usize {
        self.indices.as_ref().map_or(0, |indices| indices.count)
    }

    fn decode(&self) -> Result<Vec<(usize, Vec<u8>)>> {
        let (vertices, corners) = (self.vertices() as u64, self.corners() as u64);
        // Without indices in the file, a stream has at most two triangles for each vertex.
        let faces = if self.indices.is_some() { corners / 3 } else { 2 * vertices };
        let limits = DecodeLimits::default()
            .with_max_points(vertices)
            .with_max_faces(faces)
            .with_max_decoded_bytes(vertices * MAX_VERTEX_BYTES);
        let mut mesh = Mesh::new();
        MeshDecoder::new()
            .decode(&mut DecoderBuffer::new(self.bytes).with_limits(limits), &mut mesh)
            .map_err(|problem| self.json.error(format!("cannot be decoded: {problem}")))?;
        let mut decoded = Vec::new();
        if let Some(target) = &self.indices {
            decoded.push((target.index, indices(&mesh, target)?));
        }
        for (number, target) in &self.attributes {
            let attribute = mesh.attribute_by_unique_id(*number);
            let attribute =
                attribute.ok_or_else(|| self.json.error(format!("the stream has no attribute {number}")))?;
            if mesh.num_points() != target.count {
                let problem = format!("has {} elements, the compressed mesh {}", target.count, mesh.num_points());
                return Err(target.json.error(problem));
            }
            decoded.push((target.index, elements(attribute, target)?));
        }
        Ok(decoded)
    }
}

/// The corners of all triangles in the accessor's component type.
fn indices(mesh: &Mesh, target: &Target) -> Result<Vec<u8>> {
    if target.count != 3 * mesh.num_faces() {
        let problem = format!("has {} elements, the compressed mesh {} corners", target.count, 3 * mesh.num_faces());
        return Err(target.json.error(problem));
    }
    let size = target.component.size();
    let mut bytes = Vec::with_capacity(target.count * size);
    for corner in mesh.faces().iter().flatten() {
        let word = corner.0.to_le_bytes();
        let (word, rest) = word.split_at(size);
        if rest.iter().any(|byte| *byte != 0) {
            return Err(target.json.error(format!("vertex {} does not fit its component type", corner.0)));
        }
        bytes.extend_from_slice(word);
    }
    Ok(bytes)
}

/// The values of an attribute, in the order of the vertices.
fn elements(attribute: &PointAttribute, target: &Target) -> Result<Vec<u8>> {
    let component = match attribute.data_type() {
        DataType::Int8 => Some(Component::I8),
        DataType::Uint8 => Some(Component::U8),
        DataType::Int16 => Some(Component::I16),
        DataType::Uint16 => Some(Component::U16),
        DataType::Uint32 => Some(Component::U32),
        DataType::Float32 => Some(Component::F32),
        _ => None,
    };
    if component != Some(target.component) || usize::from(attribute.num_components()) != target.width {
        let (is, width) = (attribute.data_type(), attribute.num_components());
        return Err(target.json.error(format!("the compressed attribute differs in type: {width} times {is:?}")));
    }
    let size = target.width * target.component.size();
    let values = attribute.buffer().data();
    let mut bytes = Vec::with_capacity(target.count * size);
    for vertex in 0..target.count as u32 {
        let at = attribute.mapped_index(PointIndex(vertex)).0 as usize * size;
        let value = values.get(at..at + size);
        bytes.extend_from_slice(value.ok_or_else(|| target.json.error(format!("vertex {vertex} has no value")))?);
    }
    Ok(bytes)
}
