//! The renderer: prepares a scene, adds samples in batches, and gives the image and the statistics at any time. The
//! files of `src/techniques/` decide what runs for a sample.
//!
//! [`renderer`] prepares, [`batches`] has the loop over batches and tiles, [`tiles`] the films, and [`output`] the
//! image. Other files decide what comes next:
//!
//! - [`trial`]: whether visibility photons pay off.
//! - [`refinement`]: how much indirect light is refined.
//! - [`adaptive_sampling`]: which pixels get samples.
//! - [`time_limit`]: what fits the time.
//!
//! [`checkpoint`], [`resume`] and [`recovery`] continue a render after an interruption, [`views`] changes its camera,
//! and [`pieces`] divides it among machines.

mod adaptive_sampling;
mod backup;
mod batches;
mod checkpoint;
mod conditioning;
pub mod denoise;
mod denoised;
pub mod film;
mod growth;
pub mod host_memory;
mod image_notes;
mod inspection;
mod noisy;
mod notes;
mod output;
mod photon_benefit;
pub mod photons;
mod picture;
pub mod pieces;
mod prepared_view;
pub mod recovery;
mod refinement;
mod renderer;
mod resume;
mod sample_allocation;
mod sampling_state;
mod tiles;
mod time_limit;
mod trial;
mod views;

pub use batches::Progress;
pub use checkpoint::Checkpoint;
pub use denoise::Denoiser;
pub use film::Image;
pub use renderer::Renderer;
