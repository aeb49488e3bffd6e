//! Procedural objects, and their data for the kernels.

use glam::{DAffine3, DVec3, Vec3};

use crate::scene::normalisation::Normalisation;

/// Texels per object; see [`Procedural::texels`].
pub(crate) const TEXELS: u32 = 8;
/// First of the three texels with the rows of the matrix from normalised space to the object's own space.
pub(crate) const TO_OBJECT: u32 = 0;
/// Texel of the lower corner of the box; w is the number of the function.
pub(crate) const LOW: u32 = 3;
/// Texel of the upper corner of the box; w is the index of the material.
pub(crate) const HIGH: u32 = 4;
/// Texel of the function's parameters.
pub(crate) const PARAMETERS: u32 = 5;
/// Texel of the colour function's parameters.
pub(crate) const COLOUR_PARAMETERS: u32 = 6;
/// Texel of epsilon, clearance, the number of the colour function, and 1 for double-sided.
pub(crate) const TRAITS: u32 = 7;

/// Number of the colour function of an object without one.
const NO_COLOUR: u32 = 0xffff;

/// Distance, over the diagonal of the box, below which two positions count as equal. Coordinates of the size of the box
/// are rounded at 2^-24. In a scene of unit size this is less than the offset of rays from surfaces (2^-16).
const EPSILON: f64 = 1.0 / 262_144.0;

/// An object of a scene, in normalised space.
#[derive(Clone, Debug, PartialEq)]
pub struct Procedural {
    /// The node's name, or `node N`.
    pub name: String,
    /// Transform from normalised space to the object's own space, in which its functions work.
    pub to_own: DAffine3,
    /// Lower and upper corner of its bounding box, in its own space. The object is clipped to it.
    pub bounds: [Vec3; 2],
    /// Number of its intersection or distance function in the scene.
    pub function: u32,
    /// Parameters of that function.
    pub parameters: [f32; 4],
    /// Number of its colour function in the scene, and the parameters of that function.
    pub colour: Option<(u32, [f32; 4])>,
    /// Index into the materials of the scene. The material does not emit, and has neither textures nor alpha.
    pub material: u32,
}

impl Procedural {
    /// The eight corners of its bounding box, in normalised space.
    pub fn corners(&self) -> [Vec3; 8] {
        let to_scene = self.to_own.inverse();
        box_corners(self.bounds.map(|p| p.as_dvec3())).map(|p| to_scene.transform_point3(p).as_vec3())
    }

    /// Surface area of its bounding box in normalised space. The area of the object itself is not known.
    pub fn box_area(&self) -> f32 {
        let edges =
            self.to_own.inverse().matrix3 * glam::DMat3::from_diagonal((self.bounds[1] - self.bounds[0]).as_dvec3());
        let [x, y, z] = [edges.x_axis, edges.y_axis, edges.z_axis];
        2.0 * (x.cross(y).length() + y.cross(z).length() + z.cross(x).length()) as f32
    }

    /// The texels that kernels read: three rows of `to_own`; lower corner and function; upper corner and material;
    /// parameters of the function; parameters of the colour function; epsilon, clearance, colour function, whether the
    /// material is double-sided.
    pub(crate) fn texels(&self, double_sided: bool) -> [[f32; 4]; TEXELS as usize] {
        let rows = self.to_own.matrix3.transpose();
        let row = |row: DVec3, offset: f64| [row.x as f32, row.y as f32, row.z as f32, offset as f32];
        let offset = self.to_own.translation;
        let [low, high] = self.bounds.map(|p| p.as_dvec3());
        let epsilon = EPSILON * (high - low).length();
        // The box grows by four times epsilon, so that rays search for surfaces on its faces from outside.
        let margin = DVec3::splat(4.0 * epsilon);
        let (colour, colour_parameters) = self.colour.unwrap_or((NO_COLOUR, [0.0; 4]));
        // A distance of epsilon in own space is at most epsilon times the longest image of an axis, times the root of
        // 3, in scene space.
        let to_scene = self.to_own.inverse().matrix3;
        let longest = to_scene.x_axis.length().max(to_scene.y_axis.length()).max(to_scene.z_axis.length());
        let clearance = 2.0 * epsilon * 3f64.sqrt() * longest;
        let corner = |p: DVec3, word: u32| [p.x as f32, p.y as f32, p.z as f32, f32::from_bits(word)];
        [
            row(rows.x_axis, offset.x),
            row(rows.y_axis, offset.y),
            row(rows.z_axis, offset.z),
            corner(low - margin, self.function),
            corner(high + margin, self.material),
            self.parameters,
            colour_parameters,
            [epsilon as f32, clearance as f32, f32::from_bits(colour), f32::from(u8::from(double_sided))],
        ]
    }
}

/// The eight corners of a box.
pub(crate) fn box_corners([low, high]: [DVec3; 2]) -> [DVec3; 8] {
    std::array::from_fn(|i| DVec3::select(glam::BVec3::new(i & 1 != 0, i & 2 != 0, i & 4 != 0), high, low))
}

/// Transform from normalised space to the space of a node. `None` if the matrix of the node has no inverse.
pub(crate) fn to_own(world: &DAffine3, normalisation: &Normalisation) -> Option<DAffine3> {
    let scale = normalisation.scale();
    let to_world = DAffine3::from_translation(normalisation.centre) * DAffine3::from_scale(DVec3::splat(1.0 / scale));
    let to_own = world.inverse() * to_world;
    // Kernels read both parts in f32.
    let finite = to_own.matrix3.to_cols_array().iter().all(|x| (*x as f32).is_finite())
        && to_own.translation.as_vec3().is_finite();
    (finite && to_own.matrix3.determinant() != 0.0 && to_own.inverse().is_finite()).then_some(to_own)
}
