//! Properties of a document that can be animated: by the path of an animation channel, or by a JSON pointer
//! (KHR_animation_pointer).
//!
//! An animated value replaces that in the document, which import then reads as any other.

use serde_json::{Map, Value};

use super::json::whole;
use super::keyframes::Values::{self, Rotation, Scalars, Switch, Vector};

/// Numbers without limits.
const ANY: [f64; 2] = [f64::NEG_INFINITY, f64::INFINITY];
/// Numbers of at least 0.
const NON_NEGATIVE: [f64; 2] = [0.0, f64::INFINITY];
/// Numbers from 0 to 1.
const UNIT: [f64; 2] = [0.0, 1.0];

/// The known properties: pointer, in which `*` stands for one part and `**` for one or more; the values of a key; and
/// the range to which they are clamped, because a spline may leave the range of its keys. The range has no end where
/// import itself refuses values beyond one.
const KNOWN: &[(&str, Values, [f64; 2])] = &[
    ("/nodes/*/translation", Vector(3), ANY),
    ("/nodes/*/rotation", Rotation, ANY),
    ("/nodes/*/scale", Vector(3), ANY),
    ("/nodes/*/extensions/KHR_node_visibility/visible", Switch, UNIT),
    ("/nodes/*/weights/*", Vector(1), ANY),
    ("/meshes/*/weights/*", Vector(1), ANY),
    ("/cameras/*/orthographic/xmag", Vector(1), ANY),
    ("/cameras/*/orthographic/ymag", Vector(1), ANY),
    ("/cameras/*/orthographic/zfar", Vector(1), ANY),
    ("/cameras/*/orthographic/znear", Vector(1), NON_NEGATIVE),
    ("/cameras/*/perspective/aspectRatio", Vector(1), ANY),
    ("/cameras/*/perspective/yfov", Vector(1), ANY),
    ("/cameras/*/perspective/zfar", Vector(1), ANY),
    ("/cameras/*/perspective/znear", Vector(1), ANY),
    ("/extensions/KHR_lights_punctual/lights/*/color", Vector(3), NON_NEGATIVE),
    ("/extensions/KHR_lights_punctual/lights/*/intensity", Vector(1), NON_NEGATIVE),
    ("/extensions/KHR_lights_punctual/lights/*/range", Vector(1), ANY),
    ("/extensions/KHR_lights_punctual/lights/*/spot/innerConeAngle", Vector(1), NON_NEGATIVE),
    ("/extensions/KHR_lights_punctual/lights/*/spot/outerConeAngle", Vector(1), ANY),
    ("/materials/*/pbrMetallicRoughness/baseColorFactor", Vector(4), UNIT),
    ("/materials/*/pbrMetallicRoughness/metallicFactor", Vector(1), UNIT),
    ("/materials/*/pbrMetallicRoughness/roughnessFactor", Vector(1), UNIT),
    ("/materials/*/alphaCutoff", Vector(1), NON_NEGATIVE),
    ("/materials/*/emissiveFactor", Vector(3), NON_NEGATIVE),
    ("/materials/*/normalTexture/scale", Vector(1), ANY),
    ("/materials/*/**/extensions/KHR_texture_transform/offset", Vector(2), ANY),
    ("/materials/*/**/extensions/KHR_texture_transform/rotation", Vector(1), ANY),
    ("/materials/*/**/extensions/KHR_texture_transform/scale", Vector(2), ANY),
    ("/materials/*/extensions/KHR_materials_anisotropy/anisotropyRotation", Vector(1), ANY),
    ("/materials/*/extensions/KHR_materials_anisotropy/anisotropyStrength", Vector(1), UNIT),
    ("/materials/*/extensions/KHR_materials_clearcoat/clearcoatFactor", Vector(1), UNIT),
    ("/materials/*/extensions/KHR_materials_clearcoat/clearcoatNormalTexture/scale", Vector(1), ANY),
    ("/materials/*/extensions/KHR_materials_clearcoat/clearcoatRoughnessFactor", Vector(1), UNIT),
    ("/materials/*/extensions/KHR_materials_diffuse_transmission/diffuseTransmissionColorFactor", Vector(3), UNIT),
    ("/materials/*/extensions/KHR_materials_diffuse_transmission/diffuseTransmissionFactor", Vector(1), UNIT),
    ("/materials/*/extensions/KHR_materials_dispersion/dispersion", Vector(1), NON_NEGATIVE),
    ("/materials/*/extensions/KHR_materials_emissive_strength/emissiveStrength", Vector(1), NON_NEGATIVE),
    ("/materials/*/extensions/KHR_materials_ior/ior", Vector(1), NON_NEGATIVE),
    ("/materials/*/extensions/KHR_materials_iridescence/iridescenceFactor", Vector(1), UNIT),
    ("/materials/*/extensions/KHR_materials_iridescence/iridescenceIor", Vector(1), [1.0, f64::INFINITY]),
    ("/materials/*/extensions/KHR_materials_iridescence/iridescenceThicknessMaximum", Vector(1), NON_NEGATIVE),
    ("/materials/*/extensions/KHR_materials_iridescence/iridescenceThicknessMinimum", Vector(1), NON_NEGATIVE),
    ("/materials/*/extensions/KHR_materials_sheen/sheenColorFactor", Vector(3), UNIT),
    ("/materials/*/extensions/KHR_materials_sheen/sheenRoughnessFactor", Vector(1), UNIT),
    ("/materials/*/extensions/KHR_materials_specular/specularColorFactor", Vector(3), NON_NEGATIVE),
    ("/materials/*/extensions/KHR_materials_specular/specularFactor", Vector(1), UNIT),
    ("/materials/*/extensions/KHR_materials_transmission/transmissionFactor", Vector(1), UNIT),
    ("/materials/*/extensions/KHR_materials_volume/attenuationColor", Vector(3), UNIT),
    ("/materials/*/extensions/KHR_materials_volume/attenuationDistance", Vector(1), ANY),
    ("/materials/*/extensions/KHR_materials_volume/thicknessFactor", Vector(1), NON_NEGATIVE),
];

/// The property with the weights of all morph targets of a node or mesh.
const WEIGHTS: &str = "weights";

/// A property of a document.
#[derive(Debug, PartialEq)]
pub(super) struct Property {
    pointer: String,
    /// The values of a key.
    pub values: Values,
    range: [f64; 2],
    /// It is the weight of one morph target.
    is_weight: bool,
}

impl Property {
    /// The property of `document` that `pointer` leads to; `None` if it is not a known property.
    ///
    /// # Errors
    /// What is wrong with the pointer.
    pub fn find(document: &Value, pointer: &str) -> Result<Option<Property>, String> {
        if !pointer.is_empty() && !pointer.starts_with('/') {
            return Err(format!("\"{pointer}\" is not a JSON pointer: it must begin with /"));
        }
        let parts: Vec<&str> = pointer.split('/').skip(1).collect();
        let (values, range) = match parts[..] {
            ["nodes" | "meshes", _, WEIGHTS] => (Scalars(0), ANY),
            _ => match KNOWN.iter().find(|(pattern, ..)| matches(pattern, &parts)) {
                Some((_, values, range)) => (*values, *range),
                None => return Ok(None),
            },
        };
        let missing = |at: &str| format!("\"{pointer}\" leads to nothing: there is no \"{at}\"");
        let (last, parents) = parts.split_last().ok_or_else(|| missing(""))?;
        let owner = match parts[..] {
            [list, index, ..] => document.get(list).and_then(|list| list.get(index_of(index)?)),
            _ => None,
        };
        if let ["nodes" | "meshes", index, rest @ ..] = &parts[..]
            && rest.first() == Some(&WEIGHTS)
        {
            let owner = owner.ok_or_else(|| missing(index))?;
            let count = mesh_of(document, owner).map_or(0, target_count);
            if count == 0 {
                return Err(format!("\"{pointer}\" is of a mesh that has no morph targets"));
            }
            let is_weight = rest.len() > 1;
            if is_weight && index_of(last).is_none_or(|index| index >= count) {
                return Err(missing(last));
            }
            let values = if is_weight { Vector(1) } else { Scalars(count) };
            return Ok(Some(Property { pointer: pointer.to_owned(), values, range, is_weight }));
        }
        let mut value = Some(document);
        for part in parents {
            value = match value {
                Some(Value::Array(items)) => {
                    Some(index_of(part).and_then(|index| items.get(index)).ok_or_else(|| missing(part))?)
                }
                Some(Value::Object(members)) => {
                    let member = members.get(*part);
                    if member.is_none() && !may_be_absent(part) {
                        return Err(missing(part));
                    }
                    member
                }
                // Below an object that is absent, and filled in.
                None if may_be_absent(part) => None,
                _ => return Err(missing(part)),
            };
        }
        let is_transform = matches!(parts[..], ["nodes", _, _]);
        if is_transform && owner.is_some_and(|node| node.get("matrix").is_some()) {
            return Err(format!("\"{pointer}\" is of a node that has a matrix"));
        }
        Ok(Some(Property { pointer: pointer.to_owned(), values, range, is_weight: false }))
    }

    /// Sets the property to these finite numbers in `document`, in which it was found.
    pub fn set(&self, document: &mut Value, numbers: &[f64]) {
        let [low, high] = self.range;
        let mut numbers: Vec<Value> = numbers.iter().map(|x| Value::from(x.clamp(low, high))).collect();
        if self.is_weight {
            self.add_weights(document);
        }
        let mut value = document;
        for part in self.pointer.split('/').skip(1) {
            value = match value {
                Value::Array(items) => match index_of(part).and_then(|index| items.get_mut(index)) {
                    Some(item) => item,
                    None => return,
                },
                Value::Object(members) => members.entry(part).or_insert_with(|| Value::Object(Map::new())),
                _ => return,
            };
        }
        *value = match self.values {
            Switch => Value::Bool(numbers[0] != 0.0),
            Vector(1) => numbers.swap_remove(0),
            _ => Value::Array(numbers),
        };
    }
}

impl Property {
    /// Gives a node or mesh that states no weights its default ones: those of its mesh, or zeros.
    fn add_weights(&self, document: &mut Value) {
        let mut parts = self.pointer.split('/').skip(1);
        let (Some(list), Some(index)) = (parts.next(), parts.next().and_then(index_of)) else { return };
        let Some(owner) = document.get(list).and_then(|list| list.get(index)) else { return };
        if owner.get(WEIGHTS).is_some() {
            return;
        }
        let mesh = mesh_of(document, owner);
        let count = mesh.map_or(0, target_count);
        let stated = mesh.and_then(|mesh| mesh.get(WEIGHTS)?.as_array()).filter(|stated| stated.len() == count);
        let weights = stated.cloned().unwrap_or_else(|| vec![Value::from(0.0); count]);
        document[list][index][WEIGHTS] = Value::Array(weights);
    }
}

/// Whether an object may be absent and then has its defaults.
fn may_be_absent(part: &str) -> bool {
    part == "extensions" || part == "pbrMetallicRoughness" || part.starts_with("KHR_")
}

/// A part of a pointer as the index of an array (RFC 6901 section 4).
fn index_of(part: &str) -> Option<usize> {
    let is_canonical = part == "0" || !part.starts_with(['0', '+']);
    part.parse().ok().filter(|_| is_canonical)
}

fn matches(pattern: &str, parts: &[&str]) -> bool {
    fn rest(pattern: &[&str], parts: &[&str]) -> bool {
        match (pattern, parts) {
            ([], []) => true,
            (["**", after @ ..], [_, others @ ..]) => rest(after, others) || rest(pattern, others),
            ([first, after @ ..], [part, others @ ..]) => (*first == "*" || first == part) && rest(after, others),
            _ => false,
        }
    }
    rest(&pattern.split('/').skip(1).collect::<Vec<_>>(), parts)
}

/// The mesh of a node, or the mesh itself.
fn mesh_of<'v>(document: &'v Value, owner: &'v Value) -> Option<&'v Value> {
    if owner.get("primitives").is_some() {
        return Some(owner);
    }
    document.get("meshes")?.get(whole(owner.get("mesh")?)?)
}

/// Number of morph targets of a mesh.
fn target_count(mesh: &Value) -> usize {
    let targets = mesh.get("primitives").and_then(|primitives| primitives.get(0)?.get("targets")?.as_array());
    targets.map_or(0, Vec::len)
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    fn document() -> Value {
        json!({
            "nodes": [{ "mesh": 0 }, { "matrix": [] }],
            "meshes": [{ "primitives": [{ "targets": [{}, {}] }], "weights": [0.25, 0.5] }, { "primitives": [{}] }],
            "materials": [{ "emissiveTexture": { "index": 0 } }],
        })
    }

    fn set(pointer: &str, numbers: &[f64]) -> Value {
        let mut document = document();
        Property::find(&document, pointer).unwrap().unwrap().set(&mut document, numbers);
        document
    }

    #[test]
    fn values_arrive_where_pointers_lead() {
        assert_eq!(set("/nodes/0/translation", &[1.0, 2.0, 3.0])["nodes"][0]["translation"], json!([1.0, 2.0, 3.0]));
        assert_eq!(set("/nodes/0/weights/1", &[2.0])["nodes"][0]["weights"], json!([0.25, 2.0]));
        assert_eq!(set("/meshes/0/weights", &[3.0, 4.0])["meshes"][0]["weights"], json!([3.0, 4.0]));
        // Absent objects are made, and values beyond the range of a property limited.
        let material = &set("/materials/0/pbrMetallicRoughness/metallicFactor", &[1.5])["materials"][0];
        assert_eq!(material["pbrMetallicRoughness"], json!({ "metallicFactor": 1.0 }));
        let offset = "/materials/0/emissiveTexture/extensions/KHR_texture_transform/offset";
        let moved = &set(offset, &[0.5, -2.0])["materials"][0]["emissiveTexture"];
        let extension = json!({ "KHR_texture_transform": { "offset": [0.5, -2.0] } });
        assert_eq!(*moved, json!({ "index": 0, "extensions": extension }));
    }

    #[test]
    fn pointers_to_nothing_are_refused_and_unknown_ones_left_out() {
        let find = |pointer: &str| Property::find(&document(), pointer);
        for wrong in [
            "nodes/0/scale",
            "/nodes/2/scale",
            "/nodes/00/scale",
            "/nodes/1/scale",
            "/nodes/1/weights",
            "/nodes/0/weights/2",
            "/meshes/1/weights/0",
            "/meshes/2/weights",
            "/cameras/0/perspective/yfov",
            "/materials/0/normalTexture/scale",
            "/materials/0/normalTexture/extensions/KHR_texture_transform/scale",
            "/extensions/KHR_lights_punctual/lights/0/color",
        ] {
            assert!(find(wrong).is_err(), "{wrong}: {:?}", find(wrong));
        }
        for unknown in ["", "/", "/nodes/0/name", "/materials/0/extensions/ACME_glow/power", "/scene"] {
            assert_eq!(find(unknown), Ok(None), "{unknown}");
        }
    }
}
