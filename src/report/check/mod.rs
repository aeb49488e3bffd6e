//! Pictures as tests: cases with baselines and limits, what came of them, and the page and the XML that tell it.

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
