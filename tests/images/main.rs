//! Whole renders against references and closed forms.

mod direct;
mod indirect;
mod models;
mod setup;
mod table;
