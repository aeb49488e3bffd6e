//! Random and low-discrepancy numbers of the CPU.

/// Uniform numbers: SplitMix64 (Steele et al. 2014).
pub struct Random(pub u64);

impl Random {
    /// In [0, 1).
    pub fn uniform(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
    }
}

/// The steps of the sequence R2 (Roberts 2018). Multiples of them, without their whole parts, fill the unit square
/// evenly at any length; their sums over the columns and rows of an image are a dither.
pub const R2_STEPS: [f64; 2] = [0.754_877_666_246_692_7, 0.569_840_290_998_053_2];

/// Point `index` of the sequence R2, in the unit square.
pub fn r2(index: u32) -> [f64; 2] {
    R2_STEPS.map(|step| (0.5 + f64::from(index) * step).fract())
}
