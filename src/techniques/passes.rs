//! The two passes of a technique, and what several techniques share of them.

use crate::Result;
use crate::light_transport::first_pass::FirstPass;
use crate::light_transport::second_pass::SecondPass;
use crate::settings::{Settings, Technique};

/// A technique with its passes.
pub(crate) struct Implementation {
    /// Name, help and needs.
    pub technique: Technique,
    /// Whether the image converges to the true one with these settings; see [`Settings::is_unbiased`].
    pub is_unbiased: fn(&Settings) -> bool,
    /// What it does once, before the first sample.
    pub first_pass: fn(&mut FirstPass<'_>) -> Result<()>,
    /// One frame: what it does for each sample of a tile.
    pub second_pass: fn(&mut SecondPass<'_, '_>),
}

/// Indirect light of a frame, as all techniques with direct light of its own have it.
pub(super) fn indirect_light(frame: &mut SecondPass<'_, '_>) {
    frame.interpolate_irradiance();
    frame.trace_paths();
    frame.show_caustics();
}
