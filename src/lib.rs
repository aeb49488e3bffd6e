//! Penumbra renders glTF scenes with shadow photons (Jensen and Christensen 1995) in Vulkan compute
//! kernels. `ARCHITECTURE.md` maps the paper's steps to files.
#![warn(missing_docs)]

pub mod bvh;
pub mod error;
pub mod fingerprint;
pub mod gpu;
pub mod gpu_scene;
mod input;
pub mod kernels;
pub mod light_transport;
pub mod passes;
pub mod procedural;
pub mod render;
pub mod report;
pub mod scene;
pub mod settings;
pub mod specialisation;
pub mod statistics;
pub mod stress;

pub use error::{Error, Result};
pub use render::Image;
pub use render::{Progress, Renderer};
pub use scene::{Camera, Scene};
pub use settings::{Aov, Settings, Technique};
pub use statistics::Statistics;
