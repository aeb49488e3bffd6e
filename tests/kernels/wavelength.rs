//! Which wavelength dispersive surfaces refract, over all sets of wavelengths.

use glam::Vec3;
use kernel_kit::{Gpu, Resources, kernel_test};
use penumbra::internal::kernels::compose_source;
use penumbra::internal::specialisation::features::Feature;

use crate::kit::{device_features, new_kernel};

/// Numbers of samples, three times all wavelengths.
const NUMBERS: usize = 9;

fn wavelengths_of(bits: usize) -> Vec3 {
    Vec3::from_array([0, 1, 2].map(|bit| (bits >> bit & 1) as f32))
}

/// Whether, for the two sets of bits, the mean of the refracted light is all of it, and each choice refracts some.
fn is_fair(refracted: &[[f32; 4]], carried: usize, passing: usize) -> bool {
    let both = wavelengths_of(carried) * wavelengths_of(passing);
    let of = |number: usize| refracted[number * 64 + passing * 8 + carried];
    let mut sum = Vec3::ZERO;
    for number in 0..NUMBERS {
        let [red, green, blue, wavelength] = of(number);
        let light = both * Vec3::new(red, green, blue);
        sum += light;
        // If nothing passes, the surface still has an index of refraction: that of green light.
        let present: Vec<usize> = (0..3).filter(|i| light[*i] > 0.0).collect();
        let expected = if both == Vec3::ZERO { vec![] } else { vec![wavelength as usize] };
        if present != expected || (both == Vec3::ZERO && wavelength != 1.0) {
            return false;
        }
    }
    // Thirds and halves of small whole numbers are exact in f32 but for the last bit.
    (sum / NUMBERS as f32 - both).abs().max_element() < 1e-6
}

/// A surface that absorbs some wavelengths refracts one of the others, so that it transmits light whatever wavelength a
/// sample has. When the sample's own was chosen in any case, two thirds of the paths took clear red glass for a surface
/// that transmits nothing. All factors and numbers of samples have the same light in the mean.
#[kernel_test("PENUMBRA_DEVICE")]
fn surfaces_refract_wavelengths_that_they_let_pass(gpu: &Gpu) {
    let source = include_str!("shaders/wavelength.wgsl");
    let features = device_features(gpu).with(Feature::Transmission, true).with(Feature::Dispersion, true);
    let composed = compose_source("wavelength", source, &features).unwrap();
    let count = 64 * NUMBERS;
    let kernel = new_kernel(gpu, &composed, &[("count", count as f64)], &[]).unwrap();
    let refracted = gpu.poisoned::<[f32; 4]>("test/refracted", count).unwrap();
    let bound = kernel.bind(gpu, "refract_all", &[&Resources::new().with("refracted", &refracted)]).unwrap();
    let mut frame = gpu.frame("test");
    frame.run(&bound, count as u32, &[0u32; 0]);
    frame.submit().unwrap();
    let found = gpu.read(&refracted, count).unwrap();
    for carried in 0..8 {
        for passing in 0..8 {
            assert!(is_fair(&found, carried, passing), "carried {carried:03b}, passing {passing:03b}");
        }
    }
    // The planted fault: the sample's own wavelength, whatever the surface lets pass.
    let mut own = found.clone();
    for number in 0..NUMBERS {
        for sets in 0..64 {
            own[number * 64 + sets] = found[number * 64 + 63];
        }
    }
    assert!(!is_fair(&own, 7, 1) && is_fair(&own, 7, 7));
}
