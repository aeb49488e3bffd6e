//! Measures of images against a reference.
