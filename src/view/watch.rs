//! Noticing that files change.

use std::collections::BTreeMap;
use std::fs;
use std::path::PathBuf;
use std::time::{Duration, Instant, SystemTime};

/// Time between two checks of the files.
pub const INTERVAL: Duration = Duration::from_millis(500);

/// The length of a file and the time of its last change; `None` if it is missing.
type Stamp = Option<(u64, SystemTime)>;

fn stamp(file: &PathBuf) -> Stamp {
    fs::metadata(file).ok().and_then(|data| Some((data.len(), data.modified().ok()?)))
}

/// Files, as they were at the last check.
pub struct Watch {
    stamps: BTreeMap<PathBuf, Stamp>,
    at: Instant,
}

impl Watch {
    /// Begins without files.
    pub fn new() -> Watch {
        Watch { stamps: BTreeMap::new(), at: Instant::now() }
    }

    /// Whether the interval since the last check is over.
    pub fn is_due(&self) -> bool {
        self.at.elapsed() >= INTERVAL
    }

    /// Adds files that are new to the list, as they are now.
    pub fn add(&mut self, files: Vec<PathBuf>) {
        for file in files {
            self.stamps.entry(file).or_insert_with_key(stamp);
        }
    }

    /// Whether one of the files has changed since the last check. A file that is new to the list counts as unchanged.
    pub fn changed(&mut self, files: Vec<PathBuf>) -> bool {
        let stamps: BTreeMap<_, _> = files.into_iter().map(|file| (file.clone(), stamp(&file))).collect();
        let changed = stamps.iter().any(|(file, stamp)| self.stamps.get(file).is_some_and(|last| last != stamp));
        (self.stamps, self.at) = (stamps, Instant::now());
        changed
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn changes_are_noticed_once() {
        let file = std::env::temp_dir().join(format!("penumbra-watch-{}", std::process::id()));
        let files = || vec![file.clone()];
        let mut watch = Watch::new();
        assert!(!watch.changed(files()), "a missing file that is new to the list");
        fs::write(&file, "1").unwrap();
        assert!(watch.changed(files()), "it appears");
        assert!(!watch.changed(files()));
        fs::write(&file, "22").unwrap();
        watch.add(files());
        assert!(watch.changed(files()), "it has another length");
        fs::remove_file(&file).unwrap();
        assert!(watch.changed(files()), "it is gone");
        assert!(!watch.changed(Vec::new()));
    }
}
