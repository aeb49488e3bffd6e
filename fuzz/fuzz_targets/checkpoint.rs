//! The checkpoint: the file as it is, and with its digest set right, so that what lies behind is reached.
#![no_main]

use penumbra::internal::fingerprint::digest;
use penumbra::internal::render::Checkpoint;
use penumbra_fuzz::{bounded, check};

/// Bytes of the first line, and of the digest that follows it.
const MAGIC: usize = 22;
const DIGEST: usize = 32;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    let mut whole = bytes.to_vec();
    if let Some((head, rest)) = whole.split_at_mut_checked(MAGIC + DIGEST) {
        head[MAGIC..].copy_from_slice(digest(rest).as_bytes());
    }
    for bytes in [bytes, whole.as_slice()] {
        // 64 bytes are a value of JSON.
        let honest = bytes.len() + 64 * bytes.iter().filter(|byte| b",:[{".contains(byte)).count();
        match bounded(|| Checkpoint::from_bytes(bytes, "state"), |_| honest) {
            Ok(checkpoint) => _ = checkpoint.samples(),
            Err(error) => check(&error),
        }
    }
});
