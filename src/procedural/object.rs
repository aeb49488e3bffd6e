//! Procedural objects, and what the kernels read of them.

use glam::{DAffine3, DVec3, Vec3};

use crate::scene::normalisation::Normalisation;

/// Records an object; [`Procedural::records`] has their table.
pub(crate) const RECORDS: u32 = 8;

/// Number of the colour function of an object that has none: no scene has as many.
const NO_COLOUR: u32 = 0xffff;

/// Places nearer to each other than this part of the box's diagonal are the same. Coordinates of the size of the box are
/// rounded at 2^-24; in a scene of unit size it is below the distance by which rays leave a surface anyway (2^-16).
const EPSILON: f64 = 1.0 / 262_144.0;

/// An object of a scene, in normalised space.
#[derive(Clone, Debug, PartialEq)]
pub struct Procedural {
    /// The node's name, or `node N`.
    pub name: String,
    /// From normalised space to the object's own, in which its functions work.
    pub to_own: DAffine3,
    /// Lower and upper corner of its box, in its own space. Beyond it there is nothing of the object.
    pub bounds: [Vec3; 2],
    /// Number of its intersection or distance function among the scene's.
    pub function: u32,
    /// What that is given.
    pub parameters: [f32; 4],
    /// Number of its colour function among the scene's, and what that is given.
    pub colour: Option<(u32, [f32; 4])>,
    /// Index into [`crate::Scene::materials`]: one that emits nothing and has neither textures nor alpha.
    pub material: u32,
}

impl Procedural {
    /// The eight corners of its box, normalised.
    pub fn corners(&self) -> [Vec3; 8] {
        let to_scene = self.to_own.inverse();
        box_corners(self.bounds.map(|p| p.as_dvec3())).map(|p| to_scene.transform_point3(p).as_vec3())
    }

    /// Area of its box, normalised: what there is to know of that of its surface.
    pub fn box_area(&self) -> f32 {
        let edges =
            self.to_own.inverse().matrix3 * glam::DMat3::from_diagonal((self.bounds[1] - self.bounds[0]).as_dvec3());
        let [x, y, z] = [edges.x_axis, edges.y_axis, edges.z_axis];
        2.0 * (x.cross(y).length() + y.cross(z).length() + z.cross(x).length()) as f32
    }

    /// As the kernels read it: three rows of the way to own space; lower corner and function; upper corner and material;
    /// the function's parameters; the colour's; epsilon, clearance, colour function, whether it is double-sided.
    pub(crate) fn records(&self, double_sided: bool) -> [[f32; 4]; RECORDS as usize] {
        let rows = self.to_own.matrix3.transpose();
        let row = |row: DVec3, offset: f64| [row.x as f32, row.y as f32, row.z as f32, offset as f32];
        let offset = self.to_own.translation;
        let [low, high] = self.bounds.map(|p| p.as_dvec3());
        let epsilon = EPSILON * (high - low).length();
        // Four times epsilon: surfaces that end with the box are looked for from outside.
        let margin = DVec3::splat(4.0 * epsilon);
        let (colour, colour_parameters) = self.colour.unwrap_or((NO_COLOUR, [0.0; 4]));
        // What lies epsilon apart here lies no farther apart there than by the longest of the axes' images, times the root of 3.
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

/// From normalised space to that of a node; None where its matrix has no inverse.
pub(crate) fn to_own(world: &DAffine3, normalisation: &Normalisation) -> Option<DAffine3> {
    let scale = normalisation.scale();
    let to_world = DAffine3::from_translation(normalisation.centre) * DAffine3::from_scale(DVec3::splat(1.0 / scale));
    let to_own = world.inverse() * to_world;
    // Both as the kernels have it.
    let finite = to_own.matrix3.to_cols_array().iter().all(|x| (*x as f32).is_finite())
        && to_own.translation.as_vec3().is_finite();
    (finite && to_own.matrix3.determinant() != 0.0 && to_own.inverse().is_finite()).then_some(to_own)
}
