//! The exceptions: those of the library as one class, with keywords in place of the names of settings.

use pyo3::exceptions::{PyException, PyKeyboardInterrupt};
use pyo3::prelude::*;

use crate::keywords;

pyo3::create_exception!(
    penumbra,
    Error,
    PyException,
    "What went wrong, and where.\n\n`result` has what a failed render had finished, or None."
);
pyo3::create_exception!(
    penumbra,
    Interrupted,
    PyKeyboardInterrupt,
    "A render was interrupted by Ctrl-C.\n\n`result` has its samples so far, or None before the first."
);

/// The exception with this text of the library's.
pub fn error(text: &str) -> PyErr {
    Error::new_err(keywords::with_keywords(text))
}

/// The exception of an error of the library's.
pub fn of_library(problem: penumbra::Error) -> PyErr {
    error(&problem.to_string())
}
