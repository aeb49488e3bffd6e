//! Generators of Penumbra's scenes: geometry, textures and glTF.
//!
//! The files are the same on every machine: coordinates are rounded to digits on which every libm agrees
//! ([`mesh::tidy`]), and noise uses an integer hash.

use serde_json::{Value, json};

mod atrium;
mod cornell_box;
mod crowd;
mod glb;
mod lamps;
mod marble_sphere;
mod materials;
mod mesh;
mod noise;
mod procedural;
mod rooms;
mod sky;
mod still_life;

/// File name and contents of each scene, and of the panorama.
pub fn scenes() -> [(&'static str, Vec<u8>); 10] {
    [
        ("sphere.glb", marble_sphere::glb()),
        ("box.glb", cornell_box::glb()),
        ("still_life.glb", still_life::glb()),
        ("materials.glb", materials::glb()),
        ("lamps.glb", lamps::glb()),
        ("crowd.glb", crowd::glb()),
        ("procedural.glb", procedural::glb()),
        ("door.glb", rooms::door()),
        ("uplight.glb", rooms::uplight()),
        ("sky.exr", sky::exr(sky::with_sun)),
    ]
}

/// The atrium, which is too large for a repository, with textures of `side` x `side` texels, and its sky.
pub fn atrium(side: u32) -> [(&'static str, Vec<u8>); 2] {
    [("atrium.glb", atrium::glb(side)), ("atrium.exr", sky::exr(|direction| sky::without_sun(direction, atrium::SUN)))]
}

/// A Lambertian glTF material with a linear RGB colour.
fn lambertian(name: &str, albedo: [f64; 3]) -> Value {
    let [r, g, b] = albedo;
    json!({
        "name": name,
        "pbrMetallicRoughness": { "baseColorFactor": [r, g, b, 1], "metallicFactor": 0, "roughnessFactor": 1 },
        "extensions": { "KHR_materials_specular": { "specularFactor": 0 } },
    })
}

/// A black glTF material that emits white `radiance` from its front face.
fn emitter(name: &str, radiance: f64) -> Value {
    let mut material = lambertian(name, [0.0; 3]);
    material["emissiveFactor"] = json!([1, 1, 1]);
    material["extensions"]["KHR_materials_emissive_strength"] = json!({ "emissiveStrength": radiance });
    material
}
