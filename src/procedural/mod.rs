//! Procedural objects: surfaces that WGSL functions beside the scene describe, composed into the kernels that trace.
//!
//! `docs/procedurals.md` says how a file asks for them and what its functions are to give. [`Builder`] takes the files, and
//! makes of the functions that a scene names the module `package::lib::procedural_functions`, which `shaders/lib/procedural.wgsl`
//! calls.

mod check;

use std::fmt::Write;
use std::sync::{Arc, LazyLock};

use check::File;
use glam::{DAffine3, DVec3, Vec3};

use crate::scene::Normalisation;

/// Most objects of a scene: each ray looks at the box of each of them.
pub const MAX_OBJECTS: usize = 64;

/// Bit of a hit's primitive that tells an object from a triangle.
pub(crate) const PROCEDURAL: u32 = 1 << 31;

/// Bits of a hit's primitive that hold the object's number.
pub(crate) const INDEX_MASK: u32 = 0xff;
const _: () = assert!(MAX_OBJECTS <= INDEX_MASK as usize);

/// Texels of an object; [`Procedural::texels`] gives them.
pub(crate) const TEXELS: u32 = 8;
/// First of the three texels with the rows of the matrix from the scene to the object's space.
pub(crate) const TO_OBJECT: u32 = 0;
/// Texel of the box's low corner; w is the number of the function.
pub(crate) const LOW: u32 = 3;
/// Texel of the box's high corner; w is the material.
pub(crate) const HIGH: u32 = 4;
/// Texel of the function's parameters.
pub(crate) const PARAMETERS: u32 = 5;
/// Texel of the colour function's parameters.
pub(crate) const COLOUR_PARAMETERS: u32 = 6;
/// Texel of epsilon, clearance, the number of the colour function, and 1 for double-sided.
pub(crate) const TRAITS: u32 = 7;

/// Turns of all loops of a function and of the search along a ray, until the next crossing: 16 times what a fractal at a
/// grazing angle takes, and a sixteenth of what software devices grant all rays of an invocation together.
pub(crate) const TURNS: u32 = 4096;

/// Turns of a ray in all objects together, after which it looks for no more. Lanes of a software device wait for each other, so
/// that its loops may take several times as many.
pub(crate) const RAY_TURNS: u32 = 2 * TURNS;

/// Number of the colour function of an object that has none: no scene has as many.
const NO_COLOUR: u32 = 0xffff;

/// Places nearer to each other than this part of the box's diagonal are the same. Coordinates of the size of the box are
/// rounded at 2^-24; in a scene of unit size it is below the distance by which rays leave a surface anyway (2^-16).
const EPSILON: f64 = 1.0 / 262_144.0;

/// What a function is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Role {
    /// `fn(origin: vec3f, direction: vec3f, nearest: f32, parameters: vec4f) -> vec4f`: normal, and length to the first
    /// crossing beyond `nearest`.
    Intersection,
    /// `fn(position: vec3f, parameters: vec4f) -> f32`: distance to the surface, negative within.
    Distance,
    /// `fn(base: vec3f, position: vec3f, parameters: vec4f) -> vec3f`: base colour at a point of the surface.
    Colour,
}

/// The functions of a scene's procedural objects, as the kernels are composed with them.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Functions {
    /// WESL: the module `package::lib::procedural_functions`.
    pub(crate) wesl: Arc<str>,
}

impl Default for Functions {
    /// None at all.
    fn default() -> Self {
        static NONE: LazyLock<Functions> = LazyLock::new(|| Builder::default().finish().expect("there is no file"));
        NONE.clone()
    }
}

/// Collects functions from files.
#[derive(Default)]
pub struct Builder {
    files: Vec<File>,
    surfaces: Vec<Role>,
    colours: u32,
    /// File, name, role and number of each function that is used.
    used: Vec<(usize, String, Role, u32)>,
}

impl Builder {
    /// The number of a function of a WGSL file of that text, among the colours or among the other functions.
    ///
    /// # Errors
    /// What is wrong with the file or the function, in one line.
    pub fn function(&mut self, source: &str, name: &str, role: Role) -> std::result::Result<u32, String> {
        let file = match self.files.iter().position(|file| file.source == source) {
            Some(file) => file,
            None => {
                self.files.push(File::read(source)?);
                self.files.len() - 1
            }
        };
        self.files[file].check(name, role)?;
        if let Some(used) = self.used.iter().find(|used| (used.0, used.1.as_str(), used.2) == (file, name, role)) {
            return Ok(used.3);
        }
        let number = if role == Role::Colour {
            self.colours += 1;
            self.colours - 1
        } else {
            self.surfaces.push(role);
            self.surfaces.len() as u32 - 1
        };
        self.used.push((file, name.to_owned(), role, number));
        Ok(number)
    }

    /// The module of all of them.
    ///
    /// # Errors
    /// What naga cannot write of a file, though it can read it.
    pub fn finish(self) -> std::result::Result<Functions, String> {
        let mut wesl = include_str!("functions.wgsl").to_owned();
        for (i, file) in self.files.into_iter().enumerate() {
            let used = self.used.iter().filter(|used| used.0 == i);
            let named: Vec<_> = used.map(|(_, name, role, number)| (name.as_str(), alias(*role, *number))).collect();
            wesl += &file.write(&format!("procedural_{}", letters(i as u32)), &named)?;
        }
        for (number, role) in (0..).zip(&self.surfaces) {
            let template = match role {
                Role::Distance => include_str!("distance.wgsl"),
                _ => include_str!("intersection.wgsl"),
            };
            wesl += &template.replace("SUFFIX", &letters(number));
        }
        let mut switch = |head: &str, otherwise: &str, cases: &mut dyn Iterator<Item = (u32, String)>| {
            // A string takes whatever is written.
            let _ = write!(wesl, "\n{head} {{\n    switch function {{\n");
            for (number, call) in cases {
                let _ = writeln!(wesl, "        case {number}u: {{ return {call}; }}");
            }
            let _ = write!(wesl, "        default: {{ return {otherwise}; }}\n    }}\n}}\n");
        };
        let numbers = 0..self.surfaces.len() as u32;
        switch(
            "fn procedural_next(function: u32, origin: vec3f, direction: vec3f, so_far: f32, end: f32, epsilon: f32, parameters: vec4f) -> vec4f",
            "NO_CROSSING",
            &mut numbers.clone().map(|i| {
                (i, format!("procedural_next_{}(origin, direction, so_far, end, epsilon, parameters)", letters(i)))
            }),
        );
        let distances = numbers.filter(|i| self.surfaces[*i as usize] == Role::Distance);
        switch(
            "fn procedural_gradient(function: u32, place: vec3f, given: vec3f, epsilon: f32, parameters: vec4f) -> vec3f",
            "given",
            &mut distances.map(|i| (i, format!("procedural_gradient_{}(place, epsilon, parameters)", letters(i)))),
        );
        switch(
            "fn procedural_base(function: u32, base: vec3f, place: vec3f, parameters: vec4f) -> vec3f",
            "base",
            &mut (0..self.colours).map(|i| (i, format!("{}(base, place, parameters)", alias(Role::Colour, i)))),
        );
        Ok(Functions { wesl: wesl.into() })
    }
}

/// What the module calls a function of a scene.
fn alias(role: Role, number: u32) -> String {
    match role {
        Role::Colour => format!("procedural_colour_{}", letters(number)),
        _ => format!("procedural_function_{}", letters(number)),
    }
}

/// A number in letters: naga changes names that end in digits.
fn letters(number: u32) -> String {
    format!("{number:02}").bytes().map(|digit| char::from(digit - b'0' + b'a')).collect()
}

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
    pub(crate) fn texels(&self, double_sided: bool) -> [[f32; 4]; TEXELS as usize] {
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
