//! Fingerprints: 128 bits that identify the input of a render, as 32 hexadecimal digits.
//!
//! Two inputs that differ have the same fingerprint with a probability of 2^-128. It is no proof against an attacker.

use std::fmt;
use std::hash::Hasher;

use siphasher::sip128::{Hasher128, SipHasher24};

/// The fingerprint of `bytes`, used to check that a file is complete.
pub fn digest(bytes: &[u8]) -> String {
    let mut fingerprint = Fingerprint::default();
    fingerprint.write_bytes(bytes);
    fingerprint.finish()
}

/// Collects text and bytes. Writing never fails.
pub(crate) struct Fingerprint(SipHasher24);

impl Default for Fingerprint {
    fn default() -> Self {
        Fingerprint(SipHasher24::new())
    }
}

impl Fingerprint {
    pub fn write_bytes(&mut self, bytes: &[u8]) {
        self.0.write(bytes);
    }

    pub fn finish(self) -> String {
        format!("{:032x}", self.0.finish128().as_u128())
    }
}

impl fmt::Write for Fingerprint {
    fn write_str(&mut self, text: &str) -> fmt::Result {
        self.write_bytes(text.as_bytes());
        Ok(())
    }
}
