//! What users select by its name or its index.

use super::camera::Camera;
use super::description::Scene;
use crate::{Error, Result};

impl Scene {
    /// The camera of that name, or the one with that index if no camera has the name.
    ///
    /// # Errors
    /// [`Error::Usage`] if there is neither.
    pub fn camera(&self, wanted: &str) -> Result<&Camera> {
        select("camera", wanted, &self.cameras, |camera| Some(&camera.name))
    }
}

/// The item of that name, or the one with that index if none has the name; `kind` is what errors call an item.
pub(super) fn select<'a, T>(
    kind: &str,
    wanted: &str,
    items: &'a [T],
    name: impl Fn(&T) -> Option<&str>,
) -> Result<&'a T> {
    let by_name = items.iter().find(|item| name(item) == Some(wanted));
    by_name.or_else(|| items.get(wanted.parse::<usize>().ok()?)).ok_or_else(|| {
        let word = |(i, item): (usize, &T)| name(item).map_or_else(|| i.to_string(), str::to_owned);
        let names: Vec<String> = items.iter().enumerate().map(word).collect();
        let names = if names.is_empty() { "none".to_owned() } else { names.join(", ") };
        Error::Usage(format!("no {kind} is called '{wanted}' or has that index; available: {names}"))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Names come before indices; an item without a name has its index only.
    #[test]
    fn names_come_before_indices() {
        let items = [Some("1"), Some("a"), None];
        let found = |wanted: &str| {
            select("thing", wanted, &items, |item| *item).map(|found| items.iter().position(|item| item == found))
        };
        for (wanted, index) in [("1", 0), ("a", 1), ("0", 0), ("2", 2), ("02", 2)] {
            assert_eq!(found(wanted).unwrap(), Some(index), "{wanted}");
        }
        let error = |wanted: &str| found(wanted).unwrap_err().to_string();
        assert_eq!(error("b"), "no thing is called 'b' or has that index; available: 1, a, 2");
        assert_eq!(error("-1"), "no thing is called '-1' or has that index; available: 1, a, 2");
        assert!(select("thing", "3", &items[..0], |item| *item).unwrap_err().to_string().ends_with("available: none"));
    }
}
