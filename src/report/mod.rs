//! Measures of images against a reference, reports of error against run time, and the paper's table.

pub mod classes;
pub mod curve;
pub mod document;
pub mod estimate;
pub mod interval;
pub mod metrics;
pub mod page;
pub mod plot;
pub mod reference;
pub mod run;
pub mod sweep;
pub mod table1;
pub mod verdict;
