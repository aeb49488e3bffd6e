//! The two passes of a technique, and steps that several techniques share.

use crate::Result;
use crate::light_transport::first_pass::FirstPass;
use crate::light_transport::second_pass::SecondPass;
use crate::passes::classify::Chunk;
use crate::settings::Technique;

/// A technique with its passes.
pub(crate) struct Implementation {
    /// Name, help and requirements.
    pub technique: Technique,
    /// Runs once, before the first sample.
    pub first_pass: fn(&mut FirstPass<'_>) -> Result<()>,
    /// A frame: runs for each tile, and adds one or more samples.
    pub second_pass: fn(&mut SecondPass<'_, '_>),
}

/// A frame of the earlier methods in which a pass of their own classifies the points before any shadow ray. `classify`
/// gives each point its class for a chunk of lights; points that remain boundary or unknown trace shadow rays.
pub(super) fn second_pass_by_classes<'a, 'g>(
    frame: &mut SecondPass<'a, 'g>,
    classify: fn(&mut SecondPass<'a, 'g>, &Chunk),
) {
    frame.trace_camera_rays();
    for lights in frame.light_chunks() {
        classify(frame, &lights);
        frame.queue_shadow_rays(&lights);
        frame.trace_shadow_rays(&lights);
        frame.shade(&lights);
        frame.add_classes_to_film(&lights);
    }
    indirect_light(frame);
    frame.add_to_film();
}

/// Indirect light of a frame, for all techniques with separate direct light.
pub(super) fn indirect_light(frame: &mut SecondPass<'_, '_>) {
    frame.interpolate_irradiance();
    frame.trace_paths();
    frame.show_caustics();
}
