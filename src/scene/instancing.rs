//! The node extension EXT_mesh_gpu_instancing: copies of a node's mesh, each with a transform of its own.

use glam::{DAffine3, DQuat, DVec3};

use super::accessor::{Accessor, Component};
use super::json::Json;
use crate::Result;

/// Name of the extension.
pub(super) const EXTENSION: &str = "EXT_mesh_gpu_instancing";

/// Transforms that are read together, so that memory does not grow with the number of copies.
const CHUNK: usize = 1 << 10;

/// The copies of a node's mesh.
pub(super) struct Instances<'r, 'a> {
    json: Json<'a>,
    /// Number of copies, at least 1.
    pub count: usize,
    translation: Option<&'r Accessor<'a>>,
    rotation: Option<&'r Accessor<'a>>,
    scale: Option<&'r Accessor<'a>>,
}

impl<'r, 'a> Instances<'r, 'a> {
    /// The copies of `node`'s mesh; `None` if the mesh is there once, at the node itself.
    pub fn read(node: &Json<'a>, accessors: &'r [Accessor<'a>]) -> Result<Option<Self>> {
        let Some(json) = node.extension(EXTENSION)? else { return Ok(None) };
        let attributes = json.require("attributes")?;
        let mut count = None;
        let mut attribute = |name: &str, width: usize| -> Result<Option<&'r Accessor<'a>>> {
            let Some(json) = attributes.get(name)? else { return Ok(None) };
            let accessor = &accessors[json.index(accessors.len(), "accessor")?];
            if accessor.width != width || accessor.component == Component::U32 {
                return Err(json.error("the type of its accessor is not allowed for this attribute"));
            }
            let first = *count.get_or_insert(accessor.count);
            if accessor.count != first {
                return Err(json.error(format!("has {} elements, an attribute before it has {first}", accessor.count)));
            }
            Ok(Some(accessor))
        };
        let translation = attribute("TRANSLATION", 3)?;
        let rotation = attribute("ROTATION", 4)?;
        let scale = attribute("SCALE", 3)?;
        Ok(count.map(|count| Instances { json, count, translation, rotation, scale }))
    }

    /// Calls `place` with the transform of each copy, relative to the node.
    pub fn each(&self, mut place: impl FnMut(DAffine3) -> Result<()>) -> Result<()> {
        for first in (0..self.count).step_by(CHUNK) {
            let which: Vec<u32> = (first..self.count.min(first + CHUNK)).map(|i| i as u32).collect();
            let vectors = |accessor: Option<&Accessor>, absent: f32| match accessor {
                Some(accessor) => accessor.floats::<3>(0.0, Some(&which)),
                None => Ok(vec![[absent; 3]; which.len()]),
            };
            let (translations, scales) = (vectors(self.translation, 0.0)?, vectors(self.scale, 1.0)?);
            let rotations = match self.rotation {
                Some(accessor) => accessor.floats::<4>(0.0, Some(&which))?,
                None => vec![[0.0, 0.0, 0.0, 1.0]; which.len()],
            };
            for (i, translation) in translations.into_iter().enumerate() {
                let [translation, scale] = [translation, scales[i]].map(|v| DVec3::from_array(v.map(f64::from)));
                let rotation = DQuat::from_array(rotations[i].map(f64::from));
                // Filters of compressed files leave rotations whose length is not quite 1.
                let length = rotation.length();
                if !translation.is_finite() || !scale.is_finite() || !length.is_finite() || length == 0.0 {
                    return Err(self.json.error(format!("instance {} has no finite transform", first + i)));
                }
                place(DAffine3::from_scale_rotation_translation(scale, rotation / length, translation))?;
            }
        }
        Ok(())
    }
}
