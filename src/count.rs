//! Numbers with what they count, for users.

use std::fmt::Display;

/// A number, and `one` or `many` by its value. Both may contain a verb: "1 light is", "2 lights are".
pub(crate) fn count<N: Display + PartialEq + From<u8>>(n: N, one: &str, many: &str) -> String {
    let what = if n == N::from(1) { one } else { many };
    format!("{n} {what}")
}
