//! The renderer: prepares a scene, adds samples batch by batch, and gives the image and the statistics at any time.
//! What runs for a sample is the technique's business; see `src/techniques/`.

mod batches;
mod checkpoint;
mod conditioning;
pub mod film;
mod keeping;
mod notes;
mod output;
mod pilot;
pub mod recovery;
mod refinement;
mod renderer;
mod resume;
mod tiles;

pub use batches::Progress;
pub use checkpoint::Checkpoint;
pub use film::Image;
pub use renderer::Renderer;
