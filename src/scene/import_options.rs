//! The choices that import leaves to its caller.

/// What import does where a file leaves it a choice.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ImportOptions {
    /// Add a soft light above the scene if the file has no light.
    pub default_light: bool,
    /// Drop a primitive with NaN or infinite numbers instead of refusing the file.
    pub lenient: bool,
}
