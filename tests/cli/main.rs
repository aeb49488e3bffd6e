//! The program, and the scripts around it, as a user runs them.

#[cfg(unix)]
mod with_vulkan;
