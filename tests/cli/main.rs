//! The program, and the scripts around it, as a user runs them.

mod bad_input;
mod check;
mod compare;
mod denoise;
mod environment;
mod limits;
mod pieces;
mod plan;
mod program;
mod render;
mod report;
mod scenes;
mod schema;
mod sequence;
mod shell;
mod stress;
mod table1;
mod usage;
mod views;
#[cfg(unix)]
mod with_vulkan;
