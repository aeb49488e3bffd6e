//! Whole renders against references, closed forms and each other.

mod adaptive;
#[allow(dead_code)]
#[path = "../scene/builder.rs"]
mod builder;
mod denoised;
#[path = "../common/device.rs"]
mod device;
mod direct;
mod earlier;
mod environment;
mod indirect;
mod instances;
mod limits;
mod many_lights;
#[path = "../common/meshes.rs"]
mod meshes;
mod models;
mod pieces;
mod procedural;
#[path = "../common/procedurals.rs"]
mod procedurals;
#[allow(dead_code)]
#[path = "../common/random.rs"]
mod random;
mod setup;
#[path = "../common/shared_files.rs"]
mod shared_files;
mod shown;
mod smooth;
mod stages;
mod table;
mod table1;
mod time_limit;
mod transmitted;
mod trial;
mod unneeded;
#[allow(dead_code)]
#[path = "../common/unneeded.rs"]
mod unneeded_features;
