//! The reference cache of reports. The first four bytes are the length of the first half.
#![no_main]

use penumbra::Image;
use penumbra::internal::report::reference::Reference;
use penumbra_fuzz::check;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    let Some((at, bytes)) = bytes.split_first_chunk::<4>() else { return };
    let (a, b) = bytes.split_at((u32::from_le_bytes(*at) as usize).min(bytes.len()));
    let halves = (Image::from_bytes(a, "half-0.exr"), Image::from_bytes(b, "half-1.exr"));
    let (Ok(a), Ok(b)) = halves else { return };
    match Reference::of_halves(&a, &b) {
        Ok(reference) => {
            assert!(reference.standard_error().is_none_or(|error| error >= 0.0 || error.is_nan()));
            reference.floor();
            reference.samples();
        }
        Err(error) => check(&error),
    }
});
