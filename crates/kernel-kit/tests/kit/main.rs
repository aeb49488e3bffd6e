//! The kit on a real device.

mod bindings;
mod comparisons;
mod composing;
mod devices;
mod dispatches;
mod house;
mod layouts;
mod slices;
mod validation;
