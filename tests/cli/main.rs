//! The program, and the scripts around it, as a user runs them.

mod scenes;
#[cfg(unix)]
mod with_vulkan;
