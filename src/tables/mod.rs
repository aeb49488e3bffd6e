//! The scene as the kernels read it: tables on the device, bound by name to every kernel that asks.

pub mod camera;
pub mod lights;
pub mod sobol;
pub mod surfaces;
pub mod textures;

pub use camera::CameraUniform;
pub use lights::LightTables;
pub use surfaces::SurfaceTables;
pub use textures::TextureTables;

/// A unit vector in 32 bits: its octahedral image as two signed 16-bit fractions (Cigolle et al. 2014,
/// "A Survey of Efficient Representations for Independent Unit Vectors"); within 4e-5 rad.
pub(crate) fn oct_encode16(n: glam::Vec3) -> u32 {
    let n = n / (n.x.abs() + n.y.abs() + n.z.abs());
    let fold = |a: f32, b: f32| (1.0 - b.abs()) * if a >= 0.0 { 1.0 } else { -1.0 };
    let (x, y) = if n.z >= 0.0 { (n.x, n.y) } else { (fold(n.x, n.y), fold(n.y, n.x)) };
    let snorm = |v: f32| (v.clamp(-1.0, 1.0) * 32767.0).round() as i16 as u16 as u32;
    snorm(x) | snorm(y) << 16
}
