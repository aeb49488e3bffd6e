//! JSON against the tables in `docs/`, so that they cannot go stale.

use serde_json::Value;

const DOCUMENT: &str = concat!(include_str!("../../docs/statistics.md"), "\n", include_str!("../../docs/report.md"));

/// The rows of a section's table: key and type.
fn table(section: &str) -> Vec<(&'static str, &'static str)> {
    let heading = format!("\n## {section}\n");
    let text = DOCUMENT.split_once(&heading).unwrap_or_else(|| panic!("no section {section}")).1;
    let end = ["\n## ", "\n# "].iter().filter_map(|heading| text.find(heading)).min();
    let text = &text[..end.unwrap_or(text.len())];
    let row = |line: &'static str| {
        let mut cells = line.strip_prefix("| `")?.split(" | ");
        Some((cells.next()?.trim_end_matches('`'), cells.next()?))
    };
    let rows: Vec<_> = text.lines().filter_map(row).collect();
    assert!(!rows.is_empty(), "section {section} has no table");
    rows
}

/// Every leaf value, with its key as in the tables.
fn leaves<'a>(value: &'a Value, key: String, found: &mut Vec<(String, &'a Value)>) {
    match value {
        Value::Object(members) => {
            for (name, value) in members {
                let key = if key.is_empty() { name.clone() } else { format!("{key}.{name}") };
                leaves(value, key, found);
            }
        }
        Value::Array(items) => items.iter().for_each(|item| leaves(item, format!("{key}[]"), found)),
        value => found.push((key, value)),
    }
}

fn is_of_type(value: &Value, name: &str) -> bool {
    match name {
        "integer" => value.is_u64(),
        "number" => value.is_number(),
        "text" => value.is_string(),
        "boolean" => value.is_boolean(),
        "text or null" => value.is_string() || value.is_null(),
        "integer or null" => value.is_u64() || value.is_null(),
        "number or null" => value.is_number() || value.is_null(),
        "any" => true,
        _ => panic!("{name} is no type of the documents"),
    }
}

/// The lists and objects that would hold the key are present and empty.
fn is_empty(json: &Value, key: &str) -> bool {
    let mut values = vec![json];
    for part in key.split('.') {
        let name = part.trim_end_matches("[]");
        if name == "*" {
            return values.iter().all(|value| value.as_object().is_some_and(|members| members.is_empty()));
        }
        values = values.into_iter().map(|value| &value[name]).collect();
        if part.ends_with("[]") && values.iter().all(|value| value.is_array()) {
            values = values.into_iter().flat_map(|value| value.as_array().unwrap()).collect();
            if values.is_empty() {
                return true;
            }
        }
    }
    false
}

/// `json` has the keys of the section's table with their types, and no others.
#[track_caller]
pub fn assert_documented(section: &str, json: &Value) {
    let table = table(section);
    let mut found = Vec::new();
    leaves(json, String::new(), &mut found);
    // An object that may be null is then a key without members.
    let matches = |documented: &str, key: &str| match documented.strip_suffix(".*") {
        Some(prefix) => key.strip_prefix(prefix).is_some_and(|rest| rest.is_empty() || rest.starts_with('.')),
        None => key == documented,
    };
    for (key, value) in &found {
        let row = table.iter().find(|(documented, _)| matches(documented, key));
        let (_, name) = row.unwrap_or_else(|| panic!("{section}: {key} is not documented"));
        assert!(is_of_type(value, name), "{section}: {key} is {value}, not of type {name}");
    }
    for (documented, _) in table {
        let there = found.iter().any(|(key, _)| matches(documented, key)) || is_empty(json, documented);
        assert!(there, "{section}: {documented} is not there");
    }
}

#[test]
fn faults_are_found() {
    let good = serde_json::json!({"rmse": 0.0, "relmse": 1, "mae": 0.5, "p99": 1, "flip": 0.0});
    assert_documented("Comparison", &good);
    for (key, value) in [("mae", Value::Null), ("mae", "0".into()), ("psnr", 1.into())] {
        let mut bad = good.clone();
        bad[key] = value;
        assert!(std::panic::catch_unwind(|| assert_documented("Comparison", &bad)).is_err(), "{bad}");
    }
    let mut bad = good;
    bad.as_object_mut().unwrap().remove("flip");
    assert!(std::panic::catch_unwind(|| assert_documented("Comparison", &bad)).is_err(), "{bad}");
}
