//! Each kernel alone on a real device against an oracle on the CPU.

mod bsdf;
mod cache;
mod cells;
mod classify;
mod denoise;
mod environment;
mod features;
mod film;
mod fine_cells;
mod flux;
mod gather;
mod grid;
mod instances;
mod irradiance;
mod kit;
mod lens;
mod light;
mod light_buffer;
#[path = "../common/meshes.rs"]
mod meshes;
#[path = "../common/octahedral.rs"]
mod octahedral;
mod path;
mod photon_lights;
mod photons;
mod precision;
mod primary;
mod procedural;
#[path = "../common/procedurals.rs"]
mod procedurals;
#[allow(dead_code)]
#[path = "../common/random.rs"]
mod random;
mod receivers;
mod rooms;
mod sample_lights;
mod sampling;
mod shade;
mod shadow;
mod stage;
mod statistics;
mod terminator;
mod traverse;
mod ward;
mod wavelength;
mod zones;
