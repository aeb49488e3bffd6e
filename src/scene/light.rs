//! Lights: punctual ones, what emissive triangles emit, and the default light.

use std::f64::consts::{FRAC_PI_2, FRAC_PI_4, PI};
use std::sync::{Arc, OnceLock};

use glam::{DAffine3, DVec3, Vec2, Vec3};

use super::json::Json;
use super::material::Material;
use super::normalisation::Normalisation;
use super::notes::Notes;
use super::panorama::Panorama;
use super::texture::{Texture, TextureImage};
use crate::Result;

/// A light. The photons of the visibility map refer to it by its index.
#[derive(Clone, Debug, PartialEq)]
pub struct Light {
    /// The node's or light's name, or `light N`.
    pub name: String,
    /// Its kind, position and emission.
    pub kind: LightKind,
}

/// The kind of a light, with its position and emission.
#[derive(Clone, Debug, PartialEq)]
pub enum LightKind {
    /// A mesh light: the triangles of one node, or of one of its instances, with the same emissive material.
    Mesh {
        /// Index into [`Scene::materials`](super::Scene::materials). The material determines whether both faces emit.
        material: u32,
        /// The triangles that emit light.
        emitters: Vec<EmitterTriangle>,
    },
    /// KHR_lights_punctual point light.
    Point {
        /// Position.
        position: Vec3,
        /// Radiant intensity in normalised space: the file's value times the scale squared.
        intensity: Vec3,
        /// Range. Infinite if the file has none.
        range: f32,
    },
    /// KHR_lights_punctual spot light.
    Spot {
        /// Position.
        position: Vec3,
        /// Unit vector along the axis of the cone, away from the light.
        direction: Vec3,
        /// See [`LightKind::Point`].
        intensity: Vec3,
        /// Cosine of the inner cone angle; greater than [`cos_outer`](LightKind::Spot::cos_outer).
        cos_inner: f32,
        /// Cosine of the outer cone angle.
        cos_outer: f32,
        /// See [`LightKind::Point`].
        range: f32,
    },
    /// KHR_lights_punctual directional light.
    Directional {
        /// Unit vector in which the light travels.
        direction: Vec3,
        /// Irradiance on a plane perpendicular to the direction.
        irradiance: Vec3,
    },
    /// The environment, infinitely far away; see [`Scene::set_environment`](super::Scene::set_environment).
    Environment {
        /// The radiance from each direction. It is shared because it may be large.
        panorama: Arc<Panorama>,
        /// Rotation about +Y as a fraction of a full turn, 0 to 1, counter-clockwise as seen from above.
        turn: f32,
        /// Factor on the radiance, at least 0.
        strength: f32,
    },
}

impl LightKind {
    /// The number of light points that a surface point samples, at most `most`. It is 1 for a light whose light comes
    /// from a single direction. The same rule is in `shaders/lib/light/table.wgsl`.
    pub(crate) fn max_light_points(&self, most: u32) -> u32 {
        match self {
            LightKind::Point { .. } | LightKind::Spot { .. } | LightKind::Directional { .. } => 1,
            LightKind::Mesh { .. } | LightKind::Environment { .. } => most,
        }
    }
}

/// A triangle of a mesh light.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EmitterTriangle {
    /// Index into [`Scene::triangles`](super::Scene::triangles).
    pub triangle: u32,
    /// Mean emitted radiance over the triangle, with the emissive texture.
    pub radiance: Vec3,
}

/// A light of KHR_lights_punctual, as the file states it.
pub(super) struct Punctual {
    name: Option<String>,
    kind: Kind,
    /// Colour times intensity: candela, or lux for a directional light.
    strength: DVec3,
    range: f64,
}

enum Kind {
    Point,
    Spot { inner: f64, outer: f64 },
    Directional,
}

/// Reads the file's punctual lights; `None` for one of an unknown type.
pub(super) fn read(root: &Json, notes: &mut Notes) -> Result<Vec<Option<Punctual>>> {
    let Some(extension) = root.extension("KHR_lights_punctual")? else { return Ok(Vec::new()) };
    let list = extension.require("lights")?;
    if list.items()?.is_empty() {
        return Err(list.error("must not be empty"));
    }
    list.items()?.iter().enumerate().map(|(i, light)| punctual(i, light, notes)).collect()
}

fn punctual(index: usize, json: &Json, notes: &mut Notes) -> Result<Option<Punctual>> {
    let kind = match json.require("type")?.string()? {
        "point" => Kind::Point,
        "directional" => Kind::Directional,
        "spot" => {
            let spot = json.require("spot")?;
            let angle = |key: &str, default: f64| match spot.get(key)? {
                Some(angle) => angle.number().map(|radians| (radians, angle)),
                None => Ok((default, spot.clone())),
            };
            let (inner, _) = angle("innerConeAngle", 0.0)?;
            let (outer, place) = angle("outerConeAngle", FRAC_PI_4)?;
            // The largest angle is rounded to f32 by most writers, which can lie above the f64 value.
            let limit = f64::from((FRAC_PI_2 as f32).next_up());
            if inner < 0.0 || inner >= outer || outer > limit {
                return Err(place.error(format!("cone angles {inner} and {outer}: must be 0 <= inner < outer <= pi/2")));
            }
            Kind::Spot { inner, outer }
        }
        other => {
            notes.push(format!("light {index} has the unknown type \"{other}\" and is left out"));
            return Ok(None);
        }
    };
    let colour = json.numbers_in::<3>("color", 1.0, 0.0..)?;
    let intensity = json.number_in("intensity", 1.0, 0.0..)?;
    let range = match json.get("range")? {
        // A directional light has no range; one that is stated is ignored.
        Some(_) if matches!(kind, Kind::Directional) => f64::INFINITY,
        Some(range) => match range.number()? {
            metres if metres > 0.0 => metres,
            metres => return Err(range.error(format!("{metres} is out of range: must be greater than 0"))),
        },
        None => f64::INFINITY,
    };
    let strength = Vec3::from(colour).as_dvec3() * f64::from(intensity);
    Ok(Some(Punctual { name: json.name()?, kind, strength, range }))
}

/// The direction of light that a node has.
fn direction(world: &DAffine3) -> Option<DVec3> {
    (-world.matrix3.z_axis).try_normalize()
}

impl Punctual {
    /// Whether a node that places it has light: it may be off, or have no direction there.
    pub fn emits(&self, world: &DAffine3) -> bool {
        self.strength != DVec3::ZERO && (matches!(self.kind, Kind::Point) || direction(world).is_some())
    }

    /// The light as `node` places it. `None`, and a note, if it emits nothing or has no direction.
    pub fn place(
        &self,
        node: &Json,
        world: &DAffine3,
        normalisation: &Normalisation,
        index: usize,
        notes: &mut Notes,
    ) -> Result<Option<Light>> {
        let name = node.name()?.or(self.name.clone()).unwrap_or_else(|| format!("light {index}"));
        let scale = normalisation.scale();
        let position = normalisation.apply(world.translation);
        let strength = match self.kind {
            Kind::Directional => self.strength.as_vec3(),
            // Irradiance falls with the distance squared, which has shrunk by scale squared.
            _ => (self.strength * scale * scale).as_vec3(),
        };
        if !strength.is_finite() || !position.is_finite() {
            return Err(node.error("its light is out of range for a scene of this size"));
        }
        if strength == Vec3::ZERO {
            notes.push(format!("light \"{name}\" emits nothing and is left out"));
            return Ok(None);
        }
        let direction = direction(world).map(|d| d.as_vec3());
        let range = (self.range * scale) as f32;
        let kind = match (&self.kind, direction) {
            (Kind::Point, _) => LightKind::Point { position, intensity: strength, range },
            (Kind::Spot { inner, outer }, Some(direction)) => {
                let cos_outer = outer.cos().max(0.0) as f32;
                // Angles that differ in f64 may have the same cosine in f32.
                let cos_inner = (inner.cos() as f32).max(cos_outer.next_up());
                LightKind::Spot { position, direction, intensity: strength, cos_inner, cos_outer, range }
            }
            (Kind::Directional, Some(direction)) => LightKind::Directional { direction, irradiance: strength },
            (_, None) => {
                notes.push(format!(
                    "light \"{name}\" is left out: its node has a scale of zero, so it has no direction"
                ));
                return Ok(None);
            }
        };
        Ok(Some(Light { name, kind }))
    }
}

/// Minimum and maximum number of points per axis at which an emissive texture is looked up over a triangle. Within
/// these bounds there are as many points as texels. With fewer points, the mean of small bright spots is far off, and
/// photons from spots that were missed carry more flux than can be stored.
const STRATA: [usize; 2] = [8, 64];

/// Maximum number of points of all triangles together, unless each has the fewest: some seconds. Below 65,536 triangles
/// it has no effect.
const MAX_LOOKUPS: usize = 1 << 28;

/// The emission of emissive materials, triangle by triangle.
pub(super) struct Emission<'a> {
    materials: &'a [Material],
    textures: &'a [Texture],
    images: &'a [TextureImage],
    /// For each image, computed at the first request: how many texels that are not black lie above and to the left of a
    /// corner, (width + 1) x (height + 1) values.
    bright: Vec<OnceLock<Vec<u32>>>,
    /// Maximum of points per axis.
    max_strata: usize,
}

impl<'a> Emission<'a> {
    /// The emission of these materials through these textures, for the given number of triangles.
    pub fn new(
        materials: &'a [Material],
        textures: &'a [Texture],
        images: &'a [TextureImage],
        triangles: usize,
    ) -> Self {
        let max_strata = (MAX_LOOKUPS / triangles.max(1)).isqrt().clamp(STRATA[0], STRATA[1]);
        Emission { materials, textures, images, bright: vec![OnceLock::new(); images.len()], max_strata }
    }

    /// Mean radiance that a triangle with those texture coordinates at its corners emits.
    pub fn mean(&self, material: usize, uvs: [[Vec2; 2]; 3]) -> Vec3 {
        let material = &self.materials[material];
        let Some(info) = material.emissive_texture.filter(|_| material.emissive != Vec3::ZERO) else {
            return material.emissive;
        };
        let texture = &self.textures[info.texture as usize];
        let image = &self.images[texture.image as usize];
        let uvs = uvs.map(|sets| info.matrix * sets[info.uv_set as usize] + info.offset);
        let mut sum = Vec3::ZERO;
        // An area that overflows has the most points, and one that is NaN the fewest.
        let texels = 0.5 * (uvs[1] - uvs[0]).perp_dot(uvs[2] - uvs[0]).abs() * (image.width * image.height) as f32;
        let strata = (texels.sqrt().ceil() as usize).clamp(STRATA[0], self.max_strata);
        for i in 0..strata * strata {
            let at = |k: usize| (k as f32 + 0.5) / strata as f32;
            // Maps the unit square to the triangle with constant density.
            let (root, t) = (at(i / strata).sqrt(), at(i % strata));
            let uv = uvs[0] * (1.0 - root) + uvs[1] * (root * (1.0 - t)) + uvs[2] * (root * t);
            sum += image.sample(texture, uv).truncate();
        }
        if !sum.is_finite() {
            // Coordinates of 1e38 texels and more show no texel in particular.
            return Vec3::ZERO;
        }
        let count = (strata * strata) as f32;
        if sum == Vec3::ZERO {
            // What these points missed fills at most about one stratum.
            sum = Vec3::splat(self.bright_share(texture, image, &uvs));
        }
        // In this order a bright material does not overflow.
        material.emissive * (sum / count)
    }

    /// The share of texels that are not black in the bounds of `uvs`.
    fn bright_share(&self, texture: &Texture, image: &TextureImage, uvs: &[Vec2; 3]) -> f32 {
        let table = self.bright[texture.image as usize].get_or_init(|| count_bright(image));
        let size = [image.width, image.height];
        let ranges = [0, 1].map(|axis| {
            let n = size[axis] as f32;
            let (lower, upper) = uvs.iter().fold((f32::MAX, f32::MIN), |(l, u), uv| (l.min(uv[axis]), u.max(uv[axis])));
            // One more texel to each side, as the bilinear filter reaches half of one.
            let texel = |x: f32| (x * n).floor() as i64;
            let (first, last) = (texel(lower).saturating_sub(1), texel(upper).saturating_add(1));
            let (a, b) = (texture.wrap[axis].texel(first, size[axis]), texture.wrap[axis].texel(last, size[axis]));
            // Bounds that cross an edge of the image are taken as all of it.
            let crosses = first < 0 || last >= i64::from(size[axis]);
            if crosses { (0, size[axis]) } else { (a.min(b), a.max(b) + 1) }
        });
        let [(x0, x1), (y0, y1)] = ranges;
        let at = |x: u32, y: u32| i64::from(table[y as usize * (size[0] as usize + 1) + x as usize]);
        let count = at(x1, y1) + at(x0, y0) - at(x0, y1) - at(x1, y0);
        count as f32 / ((x1 - x0) as f32 * (y1 - y0) as f32)
    }
}

fn count_bright(image: &TextureImage) -> Vec<u32> {
    let (width, stride) = (image.width as usize, image.width as usize + 1);
    let mut table = vec![0; stride * (image.height as usize + 1)];
    for (y, row) in image.texels.chunks_exact(width).enumerate() {
        let mut in_row = 0;
        for (x, texel) in row.iter().enumerate() {
            in_row += u32::from(texel[..3] != [0; 3]);
            table[(y + 1) * stride + x + 1] = table[y * stride + x + 1] + in_row;
        }
    }
    table
}

/// Half the edge of the default light, and its distance from the scene's centre, in radii of the scene's bounding
/// sphere. It is near enough for soft shadows.
const DEFAULT_LIGHT: [f64; 2] = [1.0, 2.4];

/// Direction from the centre to the default light. Like a photographer's key light, it is above, before and to the left
/// of a model whose front is +Z, as in glTF. It is above the region that [`super::Scene::frame_camera`] shows. A lamp
/// right above a model leaves its front dark.
const TOWARDS_DEFAULT_LIGHT: DVec3 = DVec3::new(-0.4, 1.0, 0.6);

/// The default light: a square that faces the centre of a scene of that centre and radius. Gives its corners,
/// counter-clockwise seen from there, and its material.
pub(super) fn default_light(centre: DVec3, radius: f64) -> ([DVec3; 4], Material) {
    let [half, distance] = DEFAULT_LIGHT;
    let towards = TOWARDS_DEFAULT_LIGHT.normalize();
    let right = DVec3::Y.cross(towards).normalize();
    let up = towards.cross(right);
    let corners = [(-half, -half), (-half, half), (half, half), (half, -half)];
    let corners = corners.map(|(x, y)| centre + radius * (distance * towards + x * right + y * up));
    // A white diffuse surface at the centre that faces the light has the radiance of the light times its form factor
    // there: this makes it 1.
    let form_factor = 4.0 * corner_form_factor(half / distance, half / distance);
    let material = Material {
        name: "default light".into(),
        base_colour: glam::Vec4::new(0.0, 0.0, 0.0, 1.0),
        metallic: 0.0,
        specular: super::Specular::with_factor(0.0),
        emissive: Vec3::splat((1.0 / form_factor) as f32),
        ..Default::default()
    };
    (corners, material)
}

/// Form factor from a surface element to a parallel rectangle a x b at unit distance, one corner of
/// which is straight above it (Siegel and Howell, Thermal Radiation Heat Transfer, configuration 4).
fn corner_form_factor(a: f64, b: f64) -> f64 {
    let (p, q) = ((1.0 + a * a).sqrt(), (1.0 + b * b).sqrt());
    (a / p * (b / p).atan() + b / q * (a / q).atan()) / (2.0 * PI)
}
