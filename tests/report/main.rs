//! What reports say: intervals, curves, and faults that are planted and must be named.

#[path = "../common/device.rs"]
mod device;

mod budgets;
mod curves;
mod honesty;
mod intervals;
mod planted;
mod reference;
mod setup;
