//! Oracles for renders: closed forms in f64, and measures of difference.

use std::f64::consts::{PI, TAU};

use glam::DVec3;

use crate::Image;

/// The irradiance at a surface point from a polygon of unit radiance that is entirely above its horizon (Lambert 1760).
/// The corners are clockwise as seen from the point.
pub fn polygon_irradiance(corners: &[DVec3], position: DVec3, normal: DVec3) -> f64 {
    let edge = |i: usize| {
        let (a, b) = (corners[i] - position, corners[(i + 1) % corners.len()] - position);
        let across = a.cross(b - a);
        let sine = across.length();
        if sine == 0.0 { 0.0 } else { sine.atan2(a.dot(b)) * (across.dot(normal) / sine) }
    };
    0.5 * (0..corners.len()).map(edge).sum::<f64>().abs()
}

/// The share of uniform light that a metal with GGX microfacets reflects, without interreflection between microfacets
/// (Heitz 2018): the mean of G2 / G1 over the visible normals. `cosine` is that of the angle between the viewer and the
/// normal.
pub fn ggx_albedo(alpha: f64, cosine: f64) -> f64 {
    // Uniform steps in both dimensions. Their error is far below the bounds on renders.
    const STEPS: u32 = 512;
    let view = DVec3::new((1.0 - cosine * cosine).max(0.0).sqrt(), 0.0, cosine);
    let root = |z: f64| (alpha * alpha + (1.0 - alpha * alpha) * z * z).sqrt();
    let stretched = DVec3::new(alpha * view.x, alpha * view.y, view.z).normalize();
    let mut sum = 0.0;
    for i in 0..STEPS * STEPS {
        let [u, v] = [i % STEPS, i / STEPS].map(|k| (f64::from(k) + 0.5) / f64::from(STEPS));
        let z = (1.0 - v) * (1.0 + stretched.z) - stretched.z;
        let radius = (1.0 - z * z).max(0.0).sqrt();
        let cap = DVec3::new(radius * (TAU * u).cos(), radius * (TAU * u).sin(), z) + stretched;
        let half = DVec3::new(alpha * cap.x, alpha * cap.y, cap.z).normalize();
        let light = half * (2.0 * view.dot(half)) - view;
        if light.z > 0.0 {
            // Height-correlated masking and shadowing of both directions over the masking of the viewer.
            let both = 2.0 * light.z * view.z / (light.z * root(view.z) + view.z * root(light.z));
            sum += both / (2.0 * view.z / (view.z + root(view.z)));
        }
    }
    sum / f64::from(STEPS * STEPS)
}

/// The radiance that a Lambertian surface reflects for an irradiance.
pub fn reflected(albedo: f64, irradiance: f64) -> f64 {
    albedo * irradiance / PI
}

/// Mean of the green channel, which represents all channels in grey scenes.
pub fn mean(image: &Image) -> f64 {
    green(image).sum::<f64>() / image.pixels() as f64
}

/// The samples of the green channel.
pub fn green(image: &Image) -> impl Iterator<Item = f64> {
    image.channel("G").into_iter().flatten().map(|x| f64::from(*x))
}

/// Mean absolute difference of two images over the mean of the second. Infinite if any value is not finite.
pub fn difference(image: &Image, reference: &Image) -> f64 {
    let sum: f64 = green(image).zip(green(reference)).map(|(a, b)| (a - b).abs()).sum();
    let relative = sum / green(reference).sum::<f64>();
    if relative.is_finite() { relative } else { f64::INFINITY }
}

/// The absolute difference of two numbers over the second. Infinite if the quotient is not finite.
pub fn relative(value: f64, expected: f64) -> f64 {
    let relative = (value - expected).abs() / expected.abs();
    if relative.is_finite() { relative } else { f64::INFINITY }
}
