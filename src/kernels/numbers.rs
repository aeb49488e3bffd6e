//! Enumerations, bit layouts, limits and sizes that host and kernels share.

use crate::settings::Settings;

/// The class of a candidate (a point and a light) by the photons.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum Class {
    /// The whole light is behind the surface's plane, or emits away from it.
    Dark = 0,
    /// The nearest k photons are illumination photons.
    Lit = 1,
    /// The nearest k photons are shadow photons.
    Shadowed = 2,
    /// There are both among the nearest k.
    Boundary = 3,
    /// Fewer than k photons are within the largest search radius, or there are too many to visit.
    Unknown = 4,
}

impl Class {
    /// How many classes there are.
    pub const COUNT: usize = 5;
}

/// Bits of a class word: class, illumination photons, shadow photons, visibility. See `shaders/lib/class_word.wgsl`.
pub mod class_word {
    /// Bits 0-2: the class.
    pub const CLASS_MASK: u32 = 7;
    /// Bits 3-11: illumination photons among the nearest k.
    pub const ILLUMINATION_SHIFT: u32 = 3;
    /// Bits 12-20: shadow photons among the nearest k.
    pub const SHADOW_SHIFT: u32 = 12;
    /// Largest count of either kind.
    pub const MAX_COUNT: u32 = 511;
    /// Bits 21-31: the visibility, in steps of 1 / [`VISIBILITY_STEPS`].
    pub const VISIBILITY_SHIFT: u32 = 21;
    /// The word of a visibility of 1.
    pub const VISIBILITY_STEPS: u32 = 2047;
}

/// Bits of the word of a cell that decides a point. See `show_cells` of `shaders/classify.wgsl`.
pub mod cell_word {
    /// Bits 3-4: the kind of the cell, a [`super::CellKind`]; the class is in the bits below.
    pub const KIND_SHIFT: u32 = 3;
    /// The largest kind.
    pub const KIND_MASK: u32 = 3;
    /// Bits 5-7: how often the cell was divided.
    pub const LEVEL_SHIFT: u32 = 5;
    /// The largest level.
    pub const LEVEL_MASK: u32 = 7;
    /// Bits 8-31: a hash of the cell.
    pub const HASH_SHIFT: u32 = 8;
}

/// Where the class of a point comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum CellKind {
    /// No cell decides the point.
    None = 0,
    /// A fine cell, whose photons are shadow rays.
    Fine = 1,
    /// A cell of the visibility map, by its own photons.
    Map = 2,
    /// A cell of the visibility map that points requested.
    Requested = 3,
}

/// The cell that decides a point for a light.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ShownCell {
    /// The class of the cell; unknown without a cell, and dark without a point.
    pub class: Class,
    /// What kind of cell it is.
    pub kind: CellKind,
    /// How often it was divided.
    pub level: u32,
    /// A hash by which cells can be distinguished.
    pub hash: u32,
}

impl ShownCell {
    /// Takes the word of a cell apart.
    pub fn new(word: u32) -> ShownCell {
        use cell_word::{HASH_SHIFT, KIND_MASK, KIND_SHIFT, LEVEL_MASK, LEVEL_SHIFT};
        let kinds = [CellKind::None, CellKind::Fine, CellKind::Map, CellKind::Requested];
        ShownCell {
            class: Classified::new(word).class,
            kind: kinds[((word >> KIND_SHIFT) & KIND_MASK) as usize],
            level: (word >> LEVEL_SHIFT) & LEVEL_MASK,
            hash: word >> HASH_SHIFT,
        }
    }
}

/// Weight of a photon's squared offset along a point's normal, added to the squared distance that ranks the nearest
/// photons. An offset along the normal counts four times, because photons there lie on other surfaces.
pub const NORMAL_OFFSET_WEIGHT: u32 = 15;

/// Photons whose normals differ from a point's by more than 45 degrees, of this cosine, belong to another surface.
/// Without this rule, the paper has false shadows along the side of its cube.
pub const COMPATIBLE_COSINE: f64 = std::f64::consts::FRAC_1_SQRT_2;

/// A class word, taken apart.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Classified {
    /// The class.
    pub class: Class,
    /// Illumination photons among the nearest k.
    pub n_i: u32,
    /// Shadow photons among the nearest k.
    pub n_s: u32,
    /// n_i over the hits that the k photons represent, in steps of 1/2047.
    pub visibility: f32,
}

impl Classified {
    /// Takes a class word apart.
    pub fn new(word: u32) -> Classified {
        use class_word::{CLASS_MASK, ILLUMINATION_SHIFT, MAX_COUNT, SHADOW_SHIFT, VISIBILITY_SHIFT, VISIBILITY_STEPS};
        let classes = [Class::Dark, Class::Lit, Class::Shadowed, Class::Boundary];
        let class = classes.get((word & CLASS_MASK) as usize).copied().unwrap_or(Class::Unknown);
        let count = |shift: u32| (word >> shift) & MAX_COUNT;
        let visibility = (word >> VISIBILITY_SHIFT) as f32 / VISIBILITY_STEPS as f32;
        Classified { class, n_i: count(ILLUMINATION_SHIFT), n_s: count(SHADOW_SHIFT), visibility }
    }
}

/// A queue of the passes of direct light. The device compacts it; an indirect dispatch consumes it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum Queue {
    /// Candidates that no cell class decides. Pass `classify` fills and consumes it.
    Query = 0,
    /// Boundary and unknown candidates, for shadow rays.
    Boundary = 1,
    /// Lit and shadowed candidates that are audited.
    Audit = 2,
    /// Points (not candidates) whose light is sampled. Pass `shade` fills and consumes it.
    Sampled = 3,
    /// No queue: its length is that of the boundary queue before dilation.
    Undilated = 4,
}

impl Queue {
    /// How many lengths there are.
    pub const COUNT: usize = 5;

    /// The queues of candidates, in their order in the buffer that they share.
    pub const CANDIDATES: [Queue; 3] = [Queue::Query, Queue::Boundary, Queue::Audit];

    /// Words of a queue's indirect arguments: three and one unused.
    pub const ARGUMENT_WORDS: u32 = 4;

    /// Byte offset of the queue's indirect arguments in the buffer `queue_arguments`.
    pub fn arguments_offset(self) -> u64 {
        u64::from(self as u32 * Queue::ARGUMENT_WORDS) * size_of::<u32>() as u64
    }
}

/// Word at which the photons of audits begin, after their number: where a part of a buffer may begin.
pub const REPAIR_PHOTONS: u32 = (kernel_kit::PART_ALIGNMENT / 4) as u32;

/// Bits of a photon's word. The visibility map has the light in bits 14-24 and the weight's exponent in bits 25-30; the
/// global map has flux in bits 14-30. See `shaders/lib/photon.wgsl`.
pub mod photon_word {
    /// Bits 0-13: octahedral normal, 7 bits a coordinate.
    pub const NORMAL_MASK: u32 = 0x3fff;
    /// Bits 14-24: the light.
    pub const LIGHT_SHIFT: u32 = 14;
    /// Bits 25-30: the exponent w of the weight 2^(w/4), the hits that the photon represents.
    pub const WEIGHT_SHIFT: u32 = 25;
    /// Largest exponent.
    pub const MAX_WEIGHT_EXPONENT: u32 = 63;
    /// Bit 31: a shadow photon.
    pub const SHADOW: u32 = 0x8000_0000;
    /// Bit 31 where there are no shadow photons: only focusing surfaces have scattered it.
    pub const CAUSTIC: u32 = SHADOW;
}

/// An entry in a list of a light buffer: a triangle, and flags. See `shaders/light_buffer.wgsl`.
pub mod occluder {
    /// Bits 0-27: the triangle.
    pub const TRIANGLE_MASK: u32 = 0x0fff_ffff;
    /// No part of the light is behind the triangle's plane.
    pub const LIGHT_IN_FRONT: u32 = 1 << 28;
    /// No part of the light is in front of the triangle's plane.
    pub const LIGHT_BEHIND: u32 = 1 << 29;
    /// It may let light through, so that it does not hide what is behind it.
    pub const POROUS: u32 = 1 << 30;
    /// In place of an entry: some surface, of which nothing but its depth is known.
    pub const ANYTHING: u32 = u32::MAX;
    /// Bits of the number of texels in the word of a cell.
    pub const COUNT_BITS: u32 = 5;
}

/// Maximum number of lights of a photon map: a photon's word has eleven bits for its light.
pub const MAX_LIGHTS: u32 = 2048;

const _: () = assert!(Settings::MAX_NEAREST <= class_word::MAX_COUNT, "a class word has room for both counts");
const _: () = assert!(Settings::MAX_SAMPLED_LIGHTS <= ZONE_LIGHTS, "a zone lists as many lights as a point samples");

/// The largest search radius in cells. With `grid_shape::PHOTONS_PER_CELL` it finds k photons where they are 32 times
/// sparser than on average; points in sparser regions are unknown. Six cells would take two thirds of the time, most of
/// which goes into searches that find nothing, but leave seven times as many points of the paper's box unknown.
pub const REACH_CELLS: u32 = 8;

/// Maximum number of lights that a zone lists, a multiple of four; one word each. Audits sample the lights that do not
/// fit, with more variance. The lists of 64 points share a workgroup's memory: longer ones would not fit every device.
pub const ZONE_LIGHTS: u32 = 64;

/// Light index of a candidate without a light: fewer lights were sampled than there is room for.
pub const NO_SAMPLED_LIGHT: u32 = u32::MAX;

/// Normal of a point where nothing is to be lit: the ray left the scene, or hit an unlit surface. No normal has this
/// code, as -32768 is no signed 16-bit fraction.
pub const INVALID_POINT: u32 = 0x8000_8000;

/// Index in the list of sampled pixels of a pixel that is not in it.
pub const NOT_SAMPLED: u32 = u32::MAX;

/// Cells that one invocation of the grid's scan adds up. On lavapipe, 64 to 256 take the same time.
pub const SCAN_SERIAL: u32 = 64;

/// Words of the photon counts before those of the lights: photons stored, and rays that met the loop budget.
pub const PHOTON_COUNT_HEADER: u32 = 2;

/// Words of a light's photon counts: illumination photons and shadow photons.
pub const PHOTON_COUNTS_PER_LIGHT: u32 = 2;

/// Steps of a photon's encoded flux to a unit: a channel has five bits.
pub const FLUX_STEPS: u32 = 31;

/// Maximum flux of a photon in units: 8^3, because two bits hold the exponent of a factor of 8. What a photon carries
/// beyond it is lost, and counted.
pub const MAX_FLUX: u32 = 512;

/// Maximum number of lights whose unshadowed light a dispatch of pass `irradiance` adds: lavapipe ends all loops of an
/// invocation after 65,535 iterations. Probes take a quarter of these, photons up to 18,000 (nine rows of cells in
/// `shaders/irradiance.wgsl`), and a light at most some twenty.
pub const UNSHADOWED_LIGHTS: u32 = 1024;

/// Index of the count of photons stored, the first of the counts of pass `flux`.
pub const FLUX_STORED: u32 = 0;
/// Index of the count of rays whose traversal exceeded the loop budget.
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

/// Weight of the squared offset along a record's normal, added to the squared distance. Such offsets count ten times
/// (1 + 99 = 10 squared), so that a record is not used for a surface above or below its own.
pub const RECORD_OFF_PLANE: f32 = 99.0;

/// 1 over the length of the difference of unit normals 20 degrees apart: a record is not used for normals farther from
/// its own. Other angles were not compared.
pub const RECORD_PER_NORMAL: f32 = 1.0 / 0.347_296_36;

/// Minimum sum of the weights of a point's records; one weight is at most 1. A point below it lies at the rims of its
/// records, far out on their gradients, and needs one of its own. Other sums were not compared.
pub const RECORD_MIN_WEIGHT: f32 = 0.3;

/// Vectors of a pixel for the statistical denoiser: mean and variance of direct light, then of indirect light, albedo,
/// normal, position.
pub const DENOISE_VECTORS: u32 = 7;

/// Width of the border around the image in the tables of the statistical denoiser: no window reaches farther.
pub const DENOISE_BORDER: u32 = 5;

/// Minimum width of undivided fine cells in pixels. Widths are rounded up to powers of two, so cells are up to twice as
/// wide. With 2 pixels, relMSE of `scenes/crowd.glb` was 8.7e-4 instead of 1.15e-4 (docs/experiments.md, "Fine cells").
pub const FINE_CELL_PIXELS: u32 = 4;

/// Sizes of fine cells: the width halves from each to the next, to a quarter of a pixel. The last division saves a
/// twentieth of the shadow rays in `scenes/crowd.glb`, with the same error (docs/experiments.md, "Fine cells").
pub const FINE_CELL_LEVELS: u32 = 5;

/// Depth of a fine cell along the dominant axis of its normal, in widths: few surfaces cross its faces there.
pub const FINE_CELL_DEPTH: u32 = 4;

/// Maximum number of entries that are searched for a fine cell. In a table that is half full, about two are. In
/// a full one the search ends after a 64th of the iterations that lavapipe allows an invocation.
pub const FINE_CELL_PROBES: u32 = 1024;

/// Invocations of a workgroup of pass `gather`, by which the rays to be followed are dispatched. On lavapipe, rays take
/// the same time in workgroups of 32 to 256.
pub const GATHER_GROUP: u32 = 64;

/// Consecutive candidates that an invocation of pass `classify` classifies, 1 to 32: one barrier and one set of atomics
/// for all of them. On software devices these took longer than the classes of the candidates themselves.
pub const CLASSIFY_CANDIDATES: u32 = 16;

/// Invocations of a workgroup of pass `path`, by which a queue of points is dispatched; as [`GATHER_GROUP`].
pub const PATH_GROUP: u32 = 64;
