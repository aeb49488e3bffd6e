//! Each kernel alone on a real device against an oracle on the CPU.

mod bsdf;
mod house;
mod kit;
mod light;
mod path;
mod sampling;
mod statistics;
