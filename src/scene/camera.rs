//! Cameras, and their import.

use glam::{DAffine3, Vec3};

use super::json::Json;
use super::normalisation::Normalisation;
use super::notes::Notes;
use crate::Result;

/// A camera. It looks along the -z axis of its own frame, with +y up (glTF 3.10).
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
    /// Distance of the near plane.
    pub near: f32,
    /// Distance of the far plane. Infinite if the file has none.
    pub far: f32,
    /// Its lens. `None`: a pinhole, as all cameras of glTF are.
    pub lens: Option<Lens>,
}

/// A thin lens, in normalised space.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lens {
    /// Radius of the iris; of the circle around it, if it is a polygon.
    pub radius: f32,
    /// Distance along the viewing direction at which points are in focus.
    pub distance: f32,
    /// Blades of the iris, at least 3, which make it a regular polygon. 0: it is round.
    pub blades: u32,
}

/// Projection of a camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Projection {
    /// Perspective.
    Perspective {
        /// Vertical field of view in radians.
        yfov: f32,
        /// Width over height, if the file states it.
        aspect: Option<f32>,
    },
    /// Orthographic.
    Orthographic {
        /// Half the width of the view.
        xmag: f32,
        /// Half the height of the view.
        ymag: f32,
    },
}

impl Camera {
    /// Half the width and half the height of the view, at unit distance if perspective, for an image of this width over
    /// height. If the camera's own aspect ratio differs, the vertical field of view is kept, as in glTF viewers.
    pub fn half_extent(&self, aspect: f32) -> [f32; 2] {
        let half = match self.projection {
            Projection::Perspective { yfov, .. } => (0.5 * yfov).tan(),
            Projection::Orthographic { ymag, .. } => ymag,
        };
        [half * aspect, half]
    }

    /// The same camera in another normalised space: the same world at another time, when the scene has another size or
    /// centre.
    #[must_use]
    pub fn renormalised(&self, from: &Normalisation, to: &Normalisation) -> Camera {
        // A power of two.
        let scale = (to.scale() / from.scale()) as f32;
        let projection = match self.projection {
            Projection::Orthographic { xmag, ymag } => {
                Projection::Orthographic { xmag: xmag * scale, ymag: ymag * scale }
            }
            perspective => perspective,
        };
        let (near, far) = (self.near * scale, self.far * scale);
        let scaled = |lens: Lens| Lens { radius: lens.radius * scale, distance: lens.distance * scale, ..lens };
        let (position, lens) = (to.apply(from.undo(self.position)), self.lens.map(scaled));
        Camera { position, projection, near, far, lens, ..self.clone() }
    }
}

/// A camera of the file, before a node places it.
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
                // glTF advises against negative values, which mirror the view. The sign is ignored.
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
        _ => return Err(json.error(format!("unknown type \"{kind}\""))),
    };
    if far <= near {
        let properties = perspective.or(orthographic).unwrap_or_else(|| json.clone());
        return Err(properties.error(format!("zfar {far} must be greater than znear {near}")));
    }
    Ok(CameraKind { name: json.name()?, projection, near, far })
}

impl CameraKind {
    /// The camera in normalised space with the transform of `node`, whose scale is ignored. Returns `None` and adds a
    /// note if the node's scale of zero leaves the camera without an orientation.
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
            notes
                .push(format!("camera \"{name}\" is left out: its node has a scale of zero, so it has no orientation"));
            return Ok(None);
        };
        let (near, far) = ((self.near * scale) as f32, (self.far * scale) as f32);
        Ok(Some(Camera { name, position, axes, projection, near, far, lens: None }))
    }
}
