//! Whole renders against references and closed forms.

mod direct;
mod indirect;
mod setup;
mod table;
