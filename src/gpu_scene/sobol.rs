//! Direction numbers of the Sobol sequence.

use kernel_kit::{Buffer, Gpu};

use crate::Result;

/// Primitive polynomials of dimensions 2 to 4 and their first direction numbers: degree, inner coefficients as bits,
/// odd numbers m (Joe and Kuo 2008, new-joe-kuo-6).
const PRIMITIVES: [(usize, u32, &[u32]); 3] = [(1, 0, &[1]), (2, 1, &[1, 3]), (3, 1, &[1, 3, 1])];

/// For each bit of the index, the direction numbers of the first four dimensions; their highest bit is 1/2.
pub fn directions() -> [[u32; 4]; 32] {
    let mut directions = [[0; 4]; 32];
    for (bit, numbers) in directions.iter_mut().enumerate() {
        numbers[0] = 1 << (31 - bit);
    }
    for (dimension, (degree, coefficients, first)) in PRIMITIVES.iter().enumerate() {
        let dimension = dimension + 1;
        for bit in 0..32 {
            directions[bit][dimension] = if bit < *degree {
                first[bit] << (31 - bit)
            } else {
                let earlier = |back: usize| directions[bit - back][dimension];
                (1..*degree)
                    .filter(|back| coefficients >> (degree - 1 - back) & 1 == 1)
                    .fold(earlier(*degree) ^ (earlier(*degree) >> degree), |sum, back| sum ^ earlier(back))
            };
        }
    }
    directions
}

/// The uniform buffer `sobol_directions` of `shaders/lib/sampling.wgsl`.
///
/// # Errors
/// As [`Gpu::upload`].
pub fn upload(gpu: &Gpu) -> Result<Buffer> {
    Ok(gpu.upload("penumbra/scene/sobol_directions", &directions())?)
}
