//! Octahedral codes of unit vectors in double precision.

use glam::DVec3;

/// The vector of an octahedral code of 16 bits a coordinate, or of 7 (levels 0 to 126).
pub fn oct_decode(bits: u32, levels: u32) -> DVec3 {
    let [x, y] = match levels {
        7 => [bits & 127, bits >> 7 & 127].map(|level| (f64::from(level) - 63.0) / 63.0),
        _ => [bits as u16, (bits >> 16) as u16].map(|level| (f64::from(level as i16) / 32767.0).max(-1.0)),
    };
    let z = 1.0 - x.abs() - y.abs();
    let fold = |p: f64| p - (-z).max(0.0).copysign(p);
    DVec3::new(fold(x), fold(y), z).normalize()
}

/// The octahedral code of a unit vector, 16 bits a coordinate; exact for the axes.
pub fn oct_encode(n: DVec3) -> u32 {
    let [x, y] = octahedral(n).map(|v| u32::from((v * 32767.0).round() as i16 as u16));
    x | y << 16
}

/// The octahedral code of a unit vector, 7 bits a coordinate; exact for the axes.
pub fn oct_encode7(n: DVec3) -> u32 {
    let [x, y] = octahedral(n).map(|v| (v * 63.0 + 63.0).round() as u32);
    x | y << 7
}

/// The coordinates of a unit vector on the unfolded octahedron, -1 to 1 each.
fn octahedral(n: DVec3) -> [f64; 2] {
    let p = n / n.abs().element_sum();
    let fold = |a: f64, b: f64| (1.0 - b.abs()).copysign(a);
    if p.z >= 0.0 { [p.x, p.y] } else { [fold(p.x, p.y), fold(p.y, p.x)] }
}
