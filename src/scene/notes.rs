//! What import has to say about a file that it took.

use std::collections::HashSet;

use crate::input::printable;

/// Most notes that are kept: nobody reads more, and a file may give reason for as many as it has nodes.
const MAX_NOTES: usize = 100;

/// Notes, each said once.
#[derive(Default)]
pub(super) struct Notes {
    lines: Vec<String>,
    said: HashSet<String>,
    more: usize,
}

impl Notes {
    /// Adds a note that has not been said.
    pub fn push(&mut self, note: impl AsRef<str>) {
        let note = printable(note.as_ref());
        if self.said.contains(&note) {
            return;
        }
        if self.lines.len() == MAX_NOTES {
            self.more += 1;
            return;
        }
        self.said.insert(note.clone());
        self.lines.push(note);
    }

    /// All of them, in order.
    pub fn into_lines(mut self) -> Vec<String> {
        if self.more > 0 {
            self.lines.push(format!("{} more notes on the file are left out", self.more));
        }
        self.lines
    }
}
