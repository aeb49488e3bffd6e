//! Stress tests: small scenes with a known image, with one parameter varied over decades until the image is wrong.
//!
//! A [`Family`] is such a parameter. Each of its [`Series`] is a technique or a way to describe the scene. It renders
//! the scene at each value through the library, and measures the deviation of the image from an invariant or a closed
//! form. The method breaks down where the deviation exceeds the stated bound. `docs/stability.md` has the charts and
//! the reasons for the bounds.

pub mod density;
pub mod families;
pub mod family;
pub mod lights;
pub mod materials;
pub mod oracle;
pub mod placement;
pub mod stage;

pub use families::FAMILIES;
pub use family::{Family, Measure, Reading, Series, breakdown, render, settings};
pub use stage::Stage;
