//! Measures of images against a reference, and the paper's table made of them.

pub mod metrics;
pub mod table1;
