// Random numbers: hashes of 32 bits, and uniform numbers in [0, 1) from them.

// PCG's output permutation over one step of its generator (Jarzynski and Olano 2020).
fn hash1(x: u32) -> u32 {
    let state = x * 747796405u + 2891336453u;
    let word = ((state >> ((state >> 28u) + 4u)) ^ state) * 277803737u;
    return (word >> 22u) ^ word;
}

fn hash2(x: u32, y: u32) -> u32 {
    return hash1(x + hash1(y));
}

fn hash3(x: u32, y: u32, z: u32) -> u32 {
    return hash1(x + hash2(y, z));
}

// The largest number below 1.
const BELOW_ONE = 1.0 - 1.0 / 16777216.0;

// The upper 24 bits as a fraction: 0 to BELOW_ONE.
fn uniform_from_bits(bits: u32) -> f32 {
    return f32(bits >> 8u) * (1.0 / 16777216.0);
}
