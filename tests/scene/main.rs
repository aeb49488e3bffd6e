//! Scene import: files made here against the glTF specification, and files of other projects.

mod animations;
mod bad_input;
mod builder;
mod cameras;
mod compressed;
mod deformed;
mod geometry;
mod image_lights;
mod instances;
mod lights;
mod materials;
mod poses;
mod procedurals;
mod shared;
#[path = "../common/shared_files.rs"]
mod shared_files;
