//! Images as read by `compare`. The first byte selects the format, the rest is the file.
#![no_main]

use penumbra::Image;
use penumbra::internal::report::metrics::{self, Measures};
use penumbra_fuzz::{bounded, check};

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    let Some((choice, bytes)) = bytes.split_first() else { return };
    let path = ["a.exr", "a.png", "a.hdr"][usize::from(*choice) % 3];
    let samples = |image: &Image| image.channels.iter().map(|channel| 4 * channel.samples.len()).sum::<usize>();
    // A pixel or a channel may take less than a bit of the file, so the honest size is that of the decoded image.
    let size = |image: &Image| 64 * image.channels.len() + samples(image);
    let read = || Image::from_bytes(bytes, path);
    // Decoders allocate the size in the header before they detect damaged pixels: at most 1024 bytes per byte of the
    // file, in the densest coding.
    match bounded(read, |outcome| outcome.as_ref().map_or(1024 * bytes.len(), |image| bytes.len() + size(image))) {
        Err(error) => check(&error),
        Ok(image) => {
            assert!(image.channels.iter().all(|channel| channel.samples.len() == image.pixels()));
            // FLIP is slow, so it runs on small images only.
            let few = image.pixels() < 256;
            let measured =
                if few { Measures::new(&image, &image).map(drop) } else { metrics::rmse(&image, &image).map(drop) };
            match measured {
                Ok(()) => {}
                Err(error) => check(&error),
            }
        }
    }
});
