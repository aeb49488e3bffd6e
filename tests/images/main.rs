//! Whole renders against references and closed forms.

mod direct;
mod setup;
mod table;
