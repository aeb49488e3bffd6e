//! Cameras: those of the file, and one that frames a scene without any.

use glam::{DAffine3, Vec3};

use super::json::Json;
use super::normalisation::Normalisation;
use super::notes::Notes;
use crate::Result;

/// A camera: looks along -z of its own axes, +y up (glTF 3.10).
#[derive(Clone, Debug, PartialEq)]
pub struct Camera {
    /// The node's or camera's name, or `camera N`.
    pub name: String,
    /// Position.
    pub position: Vec3,
    /// Unit axes: right (+x), up (+y), backward (+z).
    pub axes: [Vec3; 3],
    /// Projection.
    pub projection: Projection,
    /// Near plane distance, normalised.
    pub near: f32,
    /// Far plane distance, normalised; infinite where the file has none.
    pub far: f32,
}

/// Projection of a camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Projection {
    /// Perspective.
    Perspective {
        /// Vertical field of view in radians.
        yfov: f32,
        /// Width over height, where the file states one.
        aspect: Option<f32>,
    },
    /// Orthographic.
    Orthographic {
        /// Half the width of the view, normalised.
        xmag: f32,
        /// Half the height of the view, normalised.
        ymag: f32,
    },
}

/// A camera, as the file states it.
pub(super) struct CameraKind {
    name: Option<String>,
    projection: Projection,
    near: f64,
    far: f64,
}

/// Reads the file's cameras.
pub(super) fn read(root: &Json) -> Result<Vec<CameraKind>> {
    root.list("cameras")?.iter().map(camera).collect()
}

fn camera(json: &Json) -> Result<CameraKind> {
    let kind = json.require("type")?.string()?;
    let (perspective, orthographic) = (json.get("perspective")?, json.get("orthographic")?);
    let positive = |holder: &Json, key: &str| -> Result<f64> {
        let number = holder.require(key)?;
        match number.number()? {
            x if x > 0.0 && (x as f32).is_normal() => Ok(x),
            x => Err(number.error(format!("{x} is out of range: must be greater than 0"))),
        }
    };
    let (projection, near, far) = match (kind, &perspective, &orthographic) {
        ("perspective", Some(p), None) => {
            let yfov = positive(p, "yfov")?;
            if yfov >= std::f64::consts::PI {
                return Err(p.error(format!("yfov {yfov} is out of range: must be less than pi")));
            }
            let aspect = p.get("aspectRatio")?.map(|_| positive(p, "aspectRatio")).transpose()?;
            let far = p.get("zfar")?.map(|_| positive(p, "zfar")).transpose()?.unwrap_or(f64::INFINITY);
            let projection = Projection::Perspective { yfov: yfov as f32, aspect: aspect.map(|a| a as f32) };
            (projection, positive(p, "znear")?, far)
        }
        ("orthographic", None, Some(o)) => {
            let size = |key: &str| -> Result<f32> {
                let number = o.require(key)?;
                // A negative one mirrors the view, which glTF advises against; its size is what counts.
                match number.number()?.abs() as f32 {
                    x if x.is_normal() => Ok(x),
                    x => Err(number.error(format!("{x} is out of range"))),
                }
            };
            let projection = Projection::Orthographic { xmag: size("xmag")?, ymag: size("ymag")? };
            let near = f64::from(o.require("znear").and_then(|_| o.number_in("znear", 0.0, 0.0..))?);
            (projection, near, positive(o, "zfar")?)
        }
        ("perspective" | "orthographic", ..) => {
            return Err(json.error(format!("needs the property `{kind}` and no other projection")));
        }
        _ => return Err(json.error(format!("unknown type `{kind}`"))),
    };
    if far <= near {
        let place = perspective.or(orthographic).unwrap_or_else(|| json.clone());
        return Err(place.error(format!("zfar {far} must be greater than znear {near}")));
    }
    Ok(CameraKind { name: json.name()?, projection, near, far })
}

impl CameraKind {
    /// The camera as `node` places it; the node's scale is ignored. None, and a note, where that
    /// leaves it no orientation.
    pub fn place(
        &self,
        node: &Json,
        world: &DAffine3,
        normalisation: &Normalisation,
        index: usize,
        notes: &mut Notes,
    ) -> Result<Option<Camera>> {
        let name = node.name()?.or(self.name.clone()).unwrap_or_else(|| format!("camera {index}"));
        let scale = normalisation.scale();
        let projection = match self.projection {
            Projection::Orthographic { xmag, ymag } => {
                let size = |x: f32| (f64::from(x) * scale) as f32;
                Projection::Orthographic { xmag: size(xmag), ymag: size(ymag) }
            }
            perspective => perspective,
        };
        let position = normalisation.apply(world.translation);
        if !position.is_finite() {
            return Err(node.error("its camera is too far away for a scene of this size"));
        }
        let m = world.matrix3;
        let axes = m.z_axis.try_normalize().and_then(|backward| {
            let up = m.y_axis.try_normalize()?.reject_from_normalized(backward).try_normalize()?;
            Some([up.cross(backward), up, backward].map(|axis| axis.as_vec3()))
        });
        let Some(axes) = axes else {
            notes.push(format!("camera `{name}` has no orientation, its node is scaled to nothing: it is left out"));
            return Ok(None);
        };
        let (near, far) = ((self.near * scale) as f32, (self.far * scale) as f32);
        Ok(Some(Camera { name, position, axes, projection, near, far }))
    }
}
