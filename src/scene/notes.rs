//! Notes: remarks of import on a file that it accepted.

use std::collections::HashSet;

use crate::input::printable;

/// Maximum number of notes. A file can cause one note per node, and nobody reads that many.
const MAX_NOTES: usize = 100;

/// A list of notes without repetition.
#[derive(Default)]
pub(super) struct Notes {
    lines: Vec<String>,
    /// All notes, those that are not shown too.
    known: HashSet<String>,
}

impl Notes {
    /// Adds a note unless it is already in the list.
    pub fn push(&mut self, note: impl AsRef<str>) {
        let note = printable(note.as_ref());
        if self.known.insert(note.clone()) && self.lines.len() < MAX_NOTES {
            self.lines.push(note);
        }
    }

    /// The notes in the order of their addition.
    pub fn into_lines(mut self) -> Vec<String> {
        let dropped = self.known.len() - self.lines.len();
        if dropped > 0 {
            self.lines.push(format!("{dropped} more notes on the file are not shown"));
        }
        self.lines
    }
}
