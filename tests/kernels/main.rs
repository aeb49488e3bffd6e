//! Each kernel alone on a real device against an oracle on the CPU.

mod house;
mod kit;
mod sampling;
mod statistics;
mod traverse;
