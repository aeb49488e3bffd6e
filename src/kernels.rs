//! Numbers that passes and their kernels share. The kernels import them from `package::lib::constants`.

/// Steps of a photon's encoded flux to a unit.
pub const FLUX_STEPS: u32 = 31;

/// Maximum flux of a photon in units; what a photon carries beyond it is lost, and counted.
pub const MAX_FLUX: u32 = 512;

/// Index of the count of photons stored, the first of the counts of pass `flux`.
pub const FLUX_STORED: u32 = 0;
/// Index of the count of rays whose traversal gave up.
pub const FLUX_OVERRUNS: u32 = 1;
/// Index of the count of rays traced.
pub const FLUX_TRACED: u32 = 2;
/// Index of the count of photons of more than [`MAX_FLUX`].
pub const FLUX_CLIPPED: u32 = 3;
/// Index of the count of photons not stored because their flux is not finite.
pub const FLUX_NOT_FINITE: u32 = 4;
/// Number of the counts of pass `flux`.
pub const FLUX_COUNTS: u32 = 5;

/// Texels of the head of an irradiance record.
pub const RECORD_HEAD_TEXELS: u32 = 2;

/// Texels of a record's values without rotational gradients: for each channel the translational gradient and the
/// irradiance.
pub const RECORD_VALUE_TEXELS_FLAT: u32 = 3;

/// Texels of a record's values with rotational gradients.
pub const RECORD_VALUE_TEXELS_CURVED: u32 = 6;

/// Minimum radius of an irradiance record in pixels: denser records cost more than they improve.
pub const MIN_RADIUS_PIXELS: u32 = 3;

/// Invocations of a workgroup of pass `gather`, by which the rays to be followed are dispatched.
pub const GATHER_GROUP: u32 = 64;

/// Invocations of a workgroup of pass `path`, by which a queue of points is dispatched.
pub const PATH_GROUP: u32 = 64;
