//! Random input of tests.

use glam::DVec3;
pub use penumbra::internal::random::Random;

/// Numbers and vectors of several kinds.
pub trait RandomInput {
    /// All 32 bits are random.
    fn word(&mut self) -> u32;
    /// Standard normal.
    fn normal(&mut self) -> f64;
    /// Uniform in [-1, 1)^3.
    fn point(&mut self) -> DVec3;
    /// Uniform on the unit sphere.
    fn direction(&mut self) -> DVec3;

    /// From 0 to `end` - 1.
    fn below(&mut self, end: u32) -> u32 {
        self.word() % end
    }

    /// Uniform in [0, 1).
    fn unit(&mut self) -> f32 {
        (self.word() >> 8) as f32 / (1u32 << 24) as f32
    }
}

impl RandomInput for Random {
    fn word(&mut self) -> u32 {
        (self.uniform() * (1u64 << 32) as f64) as u32
    }

    // Box and Muller.
    fn normal(&mut self) -> f64 {
        (-2.0 * (1.0 - self.uniform()).ln()).sqrt() * (std::f64::consts::TAU * self.uniform()).cos()
    }

    fn point(&mut self) -> DVec3 {
        DVec3::new(self.uniform(), self.uniform(), self.uniform()) * 2.0 - 1.0
    }

    fn direction(&mut self) -> DVec3 {
        loop {
            let p = self.point();
            if p.length() < 1.0 && p.length() > 1e-3 {
                return p.normalize();
            }
        }
    }
}
