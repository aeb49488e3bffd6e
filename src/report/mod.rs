//! Error measures, reports of error against run time, and the paper's table 1.
//!
//! From the lowest file to the highest: [`entrant`], `format`, [`interval`] and [`metrics`]; [`curve`], [`run`] and
//! [`mod@reference`]; [`classes`], [`sweep`] and [`finding`]; [`document`], the contents of a report; then what makes
//! and shows one.

mod advice;
mod assemble;
pub mod check;
pub mod classes;
pub mod curve;
pub mod document;
pub mod entrant;
pub mod estimate;
pub mod finding;
mod format;
pub mod interval;
mod measure;
pub mod metrics;
pub mod page;
pub mod plot;
pub mod prediction;
pub mod reference;
pub mod run;
pub mod sweep;
pub mod table1;
