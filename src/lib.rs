//! Penumbra renders glTF scenes with shadow photons (Jensen and Christensen 1995) in Vulkan compute
//! kernels. `ARCHITECTURE.md` maps the paper's steps to files.
#![warn(missing_docs)]

pub mod bvh;
pub mod error;
pub mod film;
pub mod fingerprint;
pub mod gpu;
mod input;
pub mod needs;
pub mod passes;
pub mod procedural;
pub mod report;
pub mod scene;
pub mod settings;
pub mod statistics;
pub mod stress;
pub mod tables;
pub mod techniques;

pub use error::{Error, Result};
pub use film::Image;
pub use scene::{Camera, Scene};
pub use settings::{Aov, Settings, Technique};
pub use statistics::Statistics;
pub use techniques::{Progress, Renderer};
