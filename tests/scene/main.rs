//! Scene import: files made here against the glTF specification, and files of other projects.

mod bad_input;
mod builder;
mod cameras;
mod compressed;
mod geometry;
mod instances;
mod lights;
mod materials;
mod procedurals;
mod shared;
#[path = "../common/shared_files.rs"]
mod shared_files;
