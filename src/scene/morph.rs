//! Morph targets: displacements of a mesh's vertices, scaled by weights (glTF 3.7.2.2).

use glam::{DVec3, Vec2, Vec4};

use super::accessor::{Accessor, Component};
use super::json::Json;
use super::normalisation::is_in_range;
use crate::Result;

/// The attributes that targets displace, and the numbers of components that their displacements may have.
const ATTRIBUTES: [(&str, &[usize]); 6] = [
    ("POSITION", &[3]),
    ("NORMAL", &[3]),
    ("TANGENT", &[3]),
    ("TEXCOORD_0", &[2]),
    ("TEXCOORD_1", &[2]),
    ("COLOR_0", &[3, 4]),
];

/// Attributes that a target must not displace if the primitive lacks them. Other displaced attributes that the
/// primitive lacks only give a note.
const SHAPE: [&str; 3] = ["POSITION", "NORMAL", "TANGENT"];

/// Vertex attributes to displace: positions, normals, tangents, two sets of texture coordinates, colours. Each has an
/// entry for every vertex, or is empty.
pub(super) struct Displaced<'d> {
    pub vectors: [&'d mut [DVec3]; 3],
    pub uvs: [&'d mut [Vec2]; 2],
    pub colours: &'d mut [Vec4],
}

/// The morph targets of a primitive. Their displacements stay in the file's accessors: many targets may share them.
pub(super) struct Morph<'r, 'a> {
    targets: Vec<[Option<&'r Accessor<'a>>; ATTRIBUTES.len()]>,
    /// The vertices of the accessors that the primitive uses; `None` for all of them.
    which: Option<Vec<u32>>,
}

/// A target as the file has it: accessors by attribute, with their references.
pub(super) type Target<'r, 'a> = [Option<(&'r Accessor<'a>, Json<'a>)>; ATTRIBUTES.len()];

/// Reads one target of a primitive with `count` vertices. `base` returns whether the primitive has an attribute. The
/// second result is whether the target displaces other attributes.
pub(super) fn target<'r, 'a>(
    json: &Json<'a>,
    accessors: &'r [Accessor<'a>],
    base: impl Fn(&str) -> Result<bool>,
    count: usize,
) -> Result<(Target<'r, 'a>, bool)> {
    let mut target = [const { None }; ATTRIBUTES.len()];
    for (attribute, (name, widths)) in target.iter_mut().zip(ATTRIBUTES) {
        let Some(index) = json.get(name)? else { continue };
        let accessor = &accessors[index.index(accessors.len(), "accessor")?];
        if !base(name)? {
            if !SHAPE.contains(&name) {
                continue;
            }
            return Err(index.error(format!("the primitive itself has no {name}")));
        }
        if accessor.count != count {
            return Err(index.error(format!("has {} elements, POSITION has {count}", accessor.count)));
        }
        if !widths.contains(&accessor.width) || accessor.component == Component::U32 {
            return Err(index.error("the type of its accessor is not allowed for displacements"));
        }
        *attribute = Some((accessor, index));
    }
    let known = target.iter().flatten().count();
    Ok((target, json.len() > known))
}

impl<'r, 'a> Morph<'r, 'a> {
    /// The morph of these targets, for the vertices `which` or for all. The second result is the first reference to an
    /// accessor with a number that is not finite, and the index of the element.
    pub fn new(targets: Vec<Target<'r, 'a>>, which: Option<Vec<u32>>) -> Result<(Self, Option<(Json<'a>, usize)>)> {
        let mut wrong = None;
        for (accessor, json) in targets.iter().flatten().flatten() {
            let values = accessor.floats::<4>(0.0, which.as_deref())?;
            if let Some(i) = values.iter().position(|v| v.iter().any(|x| !x.is_finite())) {
                let element = which.as_ref().map_or(i, |which| which[i] as usize);
                wrong.get_or_insert((json.clone(), element));
            }
        }
        let accessor = |attribute: Option<(&'r Accessor<'a>, Json<'a>)>| attribute.map(|(accessor, _)| accessor);
        let targets = targets.into_iter().map(|target| target.map(accessor)).collect();
        Ok((Morph { targets, which }, wrong))
    }

    /// Adds the displacements of attribute `index` of [`ATTRIBUTES`] by weight. `add` returns whether the sum is in
    /// range.
    fn displace<const N: usize, T>(
        &self,
        index: usize,
        values: &mut [T],
        weights: &[f64],
        add: impl Fn(&mut T, [f32; N], f64) -> bool,
    ) -> Result<()> {
        for (target, weight) in self.targets.iter().zip(weights).filter(|(_, weight)| **weight != 0.0) {
            let Some(accessor) = target[index] else { continue };
            let displacements = accessor.floats::<N>(0.0, self.which.as_deref())?;
            for (value, by) in values.iter_mut().zip(displacements) {
                if !add(value, by, *weight) {
                    return Err(
                        accessor.error(format!("its displacements times a weight of {weight:e} are out of range"))
                    );
                }
            }
        }
        Ok(())
    }

    /// Displaces all attributes by weight. Colours stay within 0 and 1.
    pub fn apply(&self, displaced: Displaced, weights: &[f64]) -> Result<()> {
        for (i, values) in displaced.vectors.into_iter().enumerate() {
            self.displace::<3, _>(i, values, weights, |value, by, weight| {
                *value += weight * DVec3::from(by.map(f64::from));
                is_in_range(*value)
            })?;
        }
        for (i, values) in displaced.uvs.into_iter().enumerate() {
            self.displace::<2, _>(3 + i, values, weights, |value, by, weight| {
                *value = (value.as_dvec2() + weight * Vec2::from(by).as_dvec2()).as_vec2();
                value.is_finite()
            })?;
        }
        let colours = displaced.colours;
        self.displace::<4, _>(5, colours, weights, |value, by, weight| {
            *value = (value.as_dvec4() + weight * Vec4::from(by).as_dvec4()).as_vec4();
            value.is_finite()
        })?;
        if self.targets.iter().zip(weights).any(|(target, weight)| target[5].is_some() && *weight != 0.0) {
            colours.iter_mut().for_each(|colour| *colour = colour.clamp(Vec4::ZERO, Vec4::ONE));
        }
        Ok(())
    }
}
