//! Image regression tests: cases with baselines and limits, their outcomes, and the reports as HTML page and JUnit XML.

mod cases;
mod comparison;
mod junit;
mod outcome;
mod page;

pub use cases::{Case, Cases, Limits};
pub use comparison::{Comparison, kind_of};
pub use junit::junit;
pub use outcome::{Finding, Outcome};
pub use page::page;
