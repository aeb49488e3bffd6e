//! Checkpoints: the input unchanged, and with a corrected digest, so that the data behind it is reached.
#![no_main]

use penumbra::internal::fingerprint::digest;
use penumbra::internal::render::Checkpoint;
use penumbra_fuzz::{bounded, check};

/// Lengths of the first line and of the digest that follows it, in bytes.
const MAGIC: usize = 22;
const DIGEST: usize = 32;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    let mut whole = bytes.to_vec();
    if let Some((head, rest)) = whole.split_at_mut_checked(MAGIC + DIGEST) {
        head[MAGIC..].copy_from_slice(digest(rest).as_bytes());
    }
    for bytes in [bytes, whole.as_slice()] {
        // A JSON value takes 64 bytes.
        let honest = bytes.len() + 64 * bytes.iter().filter(|byte| b",:[{".contains(byte)).count();
        match bounded(|| Checkpoint::from_bytes(bytes, "state"), |_| honest) {
            Ok(checkpoint) => _ = checkpoint.samples(),
            Err(error) => check(&error),
        }
    }
});
