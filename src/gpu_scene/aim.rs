//! Where photons are sent: to what can be seen by their light. A lamp over a lone object would lose nineteen of twenty past it
//! (Jensen 1996 sends them by projection maps; one sphere around all that there is to light needs no search).

use glam::{DVec3, Vec3};

use crate::scene::{LightKind, Material, Scene};

use super::lights::{bounding_sphere, spot_height};

/// A sphere around all surfaces at which photons are stored or go on, normalised.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Receivers {
    /// Its centre.
    pub centre: Vec3,
    /// Its radius, above 0.
    pub radius: f32,
}

/// Rays start off their surfaces by 2^-16 of the scene's radius, and directions are rounded: some times that.
const SPARE: f32 = 1e-4;

impl Receivers {
    /// Those of a scene: everything but lamps that reflect nothing. None where there is nothing else.
    pub fn of(scene: &Scene) -> Option<Receivers> {
        let receives = |material: u32| !is_black_lamp(&scene.materials[material as usize]);
        let triangles = (0..scene.triangles.len()).filter(|i| receives(scene.triangles[*i].material));
        let corners = triangles.flat_map(|i| scene.triangle_positions(i));
        let (centre, radius) = bounding_sphere(corners.chain(scene.procedurals.iter().flat_map(|o| o.corners())));
        (radius > 0.0).then_some(Receivers { centre, radius: radius * (1.0 + SPARE) + SPARE })
    }

    /// The share of what the light emits that is sent towards them, between 0 and 1; 1 where it is not aimed, as from places
    /// among them. Of a mesh light the mean over its triangles' middles.
    pub(super) fn share_of(&self, scene: &Scene, light: &LightKind) -> f64 {
        match light {
            LightKind::Point { position, .. } => self.cap_from(*position).map_or(1.0, |cap| cap.height / 2.0),
            LightKind::Spot { position, cos_inner, cos_outer, .. } => {
                let (inner, outer) = (f64::from(*cos_inner), f64::from(*cos_outer));
                let cap = self.cap_from(*position).filter(|cap| cap.height < 1.0 - outer);
                // As if they were in the brightest part.
                cap.map_or(1.0, |cap| (cap.height / spot_height(inner, outer)).min(1.0))
            }
            LightKind::Mesh { material, emitters } => {
                let two_sided = scene.materials[*material as usize].double_sided;
                let (mut sum, mut total) = (0.0, 0.0);
                for emitter in emitters {
                    let [a, b, c] = scene.triangle_positions(emitter.triangle as usize);
                    let across = (b - a).as_dvec3().cross((c - a).as_dvec3());
                    let power = across.length() * emitter.radiance.as_dvec3().element_sum();
                    let cap = self.cap_from((a + b + c) / 3.0);
                    let share = |normal: DVec3| cap.as_ref().map_or(1.0, |cap| cap.share(normal));
                    let normal = across.normalize();
                    sum += power * if two_sided { (share(normal) + share(-normal)) / 2.0 } else { share(normal) };
                    total += power;
                }
                if total > 0.0 { sum / total } else { 1.0 }
            }
            LightKind::Directional { .. } | LightKind::Environment { .. } => 1.0,
        }
    }

    /// The directions from a place to them; none from among them.
    fn cap_from(&self, place: Vec3) -> Option<Cap> {
        let offset = (self.centre - place).as_dvec3();
        let squared_sine = f64::from(self.radius).powi(2) / offset.length_squared();
        // As `receivers_from` in shaders/lib/light.wgsl.
        let height = squared_sine / (1.0 + (1.0 - squared_sine).sqrt());
        (squared_sine < 1.0).then(|| Cap { axis: offset.normalize(), squared_sine, height })
    }
}

/// Directions about an axis.
struct Cap {
    axis: DVec3,
    /// Of the angle between the axis and the rim.
    squared_sine: f64,
    /// 1 less the cosine of that angle.
    height: f64,
}

impl Cap {
    /// The share of the directions about the normal, by the cosine law, to which the cap narrows them.
    fn share(&self, normal: DVec3) -> f64 {
        let cosine = self.axis.dot(normal);
        if cosine > 0.0 && cosine * cosine > self.squared_sine { self.squared_sine * cosine } else { 1.0 }
    }
}

fn is_black_lamp(material: &Material) -> bool {
    let reflects = material.base_colour.truncate() != Vec3::ZERO || material.specular.factor > 0.0;
    let coated = material.clearcoat.is_present() || material.sheen.is_present();
    material.emissive != Vec3::ZERO && !reflects && !coated
}
