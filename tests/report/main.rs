//! Tests of reports: intervals, curves, the reference, and planted faults that a report must name.

#[path = "../common/device.rs"]
mod device;

mod auto;
mod budgets;
mod curves;
mod entrants;
mod honesty;
mod intervals;
mod planted;
mod reference;
mod setup;
