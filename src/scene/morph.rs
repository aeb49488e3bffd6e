//! Morph targets: displacements of a mesh's vertices, scaled by weights (glTF 3.7.2.2).

use glam::DVec3;

use super::accessor::{Accessor, Component};
use super::json::Json;
use crate::Result;

/// The attributes that targets displace.
const ATTRIBUTES: [&str; 3] = ["POSITION", "NORMAL", "TANGENT"];

/// The morph targets of a primitive. Their displacements stay in the file's accessors: many targets may share them.
pub(super) struct Morph<'r, 'a> {
    targets: Vec<[Option<&'r Accessor<'a>>; 3]>,
    /// The vertices of the accessors that the primitive uses; none for all of them.
    which: Option<Vec<u32>>,
}

/// A target as the file has it: accessors by attribute, with their references.
pub(super) type Target<'r, 'a> = [Option<(&'r Accessor<'a>, Json<'a>)>; 3];

/// Reads one target of a primitive with `count` vertices. `base` tells which attributes the primitive has. The second
/// result says whether it has displacements of other attributes.
pub(super) fn target<'r, 'a>(
    json: &Json<'a>,
    accessors: &'r [Accessor<'a>],
    base: impl Fn(&str) -> Result<bool>,
    count: usize,
) -> Result<(Target<'r, 'a>, bool)> {
    let mut target = [None, None, None];
    for (attribute, name) in target.iter_mut().zip(ATTRIBUTES) {
        let Some(index) = json.get(name)? else { continue };
        let accessor = &accessors[index.index(accessors.len(), "accessor")?];
        if !base(name)? {
            return Err(index.error(format!("the primitive itself has no {name}")));
        }
        if accessor.count != count {
            return Err(index.error(format!("has {} elements, POSITION has {count}", accessor.count)));
        }
        if accessor.width != 3 || accessor.component == Component::U32 {
            return Err(index.error("the type of its accessor is not allowed for displacements"));
        }
        *attribute = Some((accessor, index));
    }
    let known = target.iter().flatten().count();
    Ok((target, json.len() > known))
}

impl<'r, 'a> Morph<'r, 'a> {
    /// Of those targets, of which the vertices `which` are used, or all. The second result is the first reference to an
    /// accessor with a number that is not finite, and the element.
    pub fn new(targets: Vec<Target<'r, 'a>>, which: Option<Vec<u32>>) -> Result<(Self, Option<(Json<'a>, usize)>)> {
        let mut wrong = None;
        for (accessor, json) in targets.iter().flatten().flatten() {
            let values = accessor.floats::<3>(0.0, which.as_deref())?;
            if let Some(i) = values.iter().position(|v| v.iter().any(|x| !x.is_finite())) {
                let element = which.as_ref().map_or(i, |which| which[i] as usize);
                wrong.get_or_insert((json.clone(), element));
            }
        }
        let accessor = |attribute: Option<(&'r Accessor<'a>, Json<'a>)>| attribute.map(|(accessor, _)| accessor);
        let targets = targets.into_iter().map(|target| target.map(accessor)).collect();
        Ok((Morph { targets, which }, wrong))
    }

    /// Adds the displacements of attribute `index` (position, normal, tangent) by weight.
    fn displace(&self, index: usize, values: &mut [DVec3], weights: &[f64]) -> Result<()> {
        for (target, weight) in self.targets.iter().zip(weights).filter(|(_, weight)| **weight != 0.0) {
            let Some(accessor) = target[index] else { continue };
            let displacements = accessor.floats::<3>(0.0, self.which.as_deref())?;
            for (value, [x, y, z]) in values.iter_mut().zip(displacements) {
                *value += *weight * DVec3::new(x.into(), y.into(), z.into());
            }
        }
        Ok(())
    }

    /// Displaces positions, normals and tangents, each of all vertices or empty.
    pub fn apply(&self, attributes: [&mut [DVec3]; 3], weights: &[f64]) -> Result<()> {
        attributes.into_iter().enumerate().try_for_each(|(i, values)| self.displace(i, values, weights))
    }
}
