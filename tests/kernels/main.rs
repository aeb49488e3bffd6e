//! Each kernel alone on a real device against an oracle on the CPU.

mod classify;
mod grid;
mod house;
mod kit;
mod photons;
mod rooms;
mod sampling;
mod statistics;
mod traverse;
