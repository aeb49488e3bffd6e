//! Measures of images against a reference.

pub mod metrics;
