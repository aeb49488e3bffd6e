//! What `compare` reads: the first byte chooses the format, the rest is the file.
#![no_main]

use penumbra::Image;
use penumbra::internal::report::metrics::{self, Measures};
use penumbra_fuzz::{bounded, check};

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    let Some((choice, bytes)) = bytes.split_first() else { return };
    let path = ["a.exr", "a.png", "a.hdr"][usize::from(*choice) % 3];
    let samples = |image: &Image| image.channels.iter().map(|channel| 4 * channel.samples.len()).sum::<usize>();
    // A pixel, and a channel, may be a bit of the file; what it stands for is then what is honest.
    let size = |image: &Image| 64 * image.channels.len() + samples(image);
    let read = || Image::from_bytes(bytes, path);
    // Memory is taken for what a header promises before the pixels turn out to be damaged: what a byte may stand for at most,
    // by the densest coding.
    match bounded(read, |outcome| outcome.as_ref().map_or(1024 * bytes.len(), |image| bytes.len() + size(image))) {
        Err(error) => check(&error),
        Ok(image) => {
            assert!(image.channels.iter().all(|channel| channel.samples.len() == image.pixels()));
            // FLIP's own code is slow; a few pixels show what it does.
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
