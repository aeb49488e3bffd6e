//! Scene import, against what the glTF specification says of files made here, and against files of others.

mod bad_input;
mod builder;
mod cameras;
mod geometry;
mod lights;
mod materials;
mod procedurals;
mod shared;
#[path = "../common/shared_files.rs"]
mod shared_files;
