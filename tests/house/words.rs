//! Words: one meaning a word, the field's terms. What is retired, and what to say in its place.

use std::path::Path;

use crate::sources;

/// Parts of identifiers and words of comments, messages and documents that are retired, whatever they are a part of:
/// `slot` stands for `slot_count`, `FreeSlot` and "a slot".
const RETIRED: &[(&str, &str)] = &[
    ("slot", "candidate (a point and a light), primitive (of the hierarchy) or texture info (glTF)"),
    ("slots", "candidates, primitives or texture infos"),
    ("verdict", "class of a cell; finding (of a report)"),
    ("verdicts", "classes of cells; findings (of a report)"),
    ("judge", "classify"),
    ("judges", "classifies"),
    ("judged", "classified"),
    ("judging", "classifying"),
    ("walk", "traversal (of the hierarchy) or path tracing"),
    ("walks", "traversals or paths"),
    ("walked", "traversed or traced"),
    ("spoilt", "invalid"),
    ("nonsense", "invalid"),
    ("lots", "random numbers (xi)"),
    ("aim", "emission towards the receivers' bounding cone"),
    ("aims", "emits towards"),
    ("aimed", "emitted towards the receivers' bounds"),
];

/// Parts that are retired in identifiers alone: as words they are plain English.
const RETIRED_NAMES: &[(&str, &str)] = &[
    ("least", "min"),
    ("most", "max"),
    ("place", "position, texel or index"),
    ("places", "positions, irradiance points"),
    ("turns", "iterations"),
    ("asks", "queries, requests"),
    ("asked", "requested"),
    ("ask", "query, request"),
    ("chosen", "sampled, selected"),
    ("needs", "specialisation, requirements"),
    ("tables", "GPU scene"),
    ("lot", "xi"),
    ("looks", "visits, visit budget"),
];

/// Phrases that stopped a reader.
const RETIRED_PHRASES: &[&str] = &[
    "light choice",
    "chosen light",
    "visibility looks",
    "asks photons",
    "asks no photons",
    "it does not know",
    "everything that stands still",
];

/// The words that an identifier is made of, in lower case: `MaxSlotCount`, `max_slot_count` and `MAX_SLOT_COUNT` alike.
fn parts(identifier: &str) -> Vec<String> {
    let mut parts = vec![String::new()];
    let mut after_lower = false;
    for c in identifier.chars() {
        if c == '_' || c == '-' || (c.is_uppercase() && after_lower) {
            parts.push(String::new());
        }
        if c != '_' && c != '-' {
            parts.last_mut().unwrap().extend(c.to_lowercase());
        }
        after_lower = c.is_lowercase() || c.is_ascii_digit();
    }
    parts
}

/// What is retired on a line, with what to say in its place.
fn retired(line: &str) -> Vec<String> {
    let is_part = |c: char| c.is_alphanumeric() || c == '_';
    let mut found = Vec::new();
    for word in line.split(|c: char| !is_part(c)).filter(|word| !word.is_empty()) {
        let parts = parts(word);
        let is_name = parts.len() > 1;
        let of = |list: &'static [(&str, &str)]| list.iter().filter(|(part, _)| parts.iter().any(|p| p == part));
        let names = of(RETIRED_NAMES).filter(|_| is_name);
        found.extend(of(RETIRED).chain(names).map(|(part, instead)| format!("'{word}' ({part}): say {instead}")));
    }
    let lower = line.to_lowercase();
    found.extend(RETIRED_PHRASES.iter().filter(|phrase| lower.contains(**phrase)).map(|phrase| format!("'{phrase}'")));
    let comment = line.trim_start().trim_start_matches(['/', '!', '#']).trim_start();
    if line.trim_start().starts_with("//") && (comment.starts_with("Most ") || comment.starts_with("Least ")) {
        found.push("'Most' and 'Least' at the beginning: say maximum and minimum".to_owned());
    }
    found
}

/// No source, help, error or document uses a retired word.
#[test]
fn retired_words_stay_retired() {
    let code = ["src", "crates", "shaders", "tests", "benches", "examples", "scenes", "fuzz", "python", "docs"];
    let files = code.iter().flat_map(|folder| sources(folder, &["rs", "wgsl", "md"]));
    let top = ["README.md", "ARCHITECTURE.md", "CONTRIBUTING.md"]
        .map(|name| (Path::new(name).to_owned(), std::fs::read_to_string(crate::root().join(name)).unwrap()));
    // This list, and the page that says what to write in place of these words.
    let exempt = ["tests/house/words.rs", "CONTRIBUTING.md"];
    let files = files.chain(top).filter(|(path, _)| !exempt.iter().any(|name| path == Path::new(name)));
    let mut found = Vec::new();
    for (path, text) in files {
        for (number, line) in text.lines().enumerate() {
            found.extend(retired(line).into_iter().map(|what| format!("{}:{}: {what}", path.display(), number + 1)));
        }
    }
    assert!(found.is_empty(), "{} retired words:\n{}", found.len(), found.join("\n"));
}

/// A retired word is found in each of its forms, and its plain English is left alone.
#[test]
fn planted_words_are_found() {
    for line in ["let slot_count = 1;", "struct FreeSlot;", "const MAX_SLOTS: u32 = 1;", "// of a slot", "least_bytes"]
    {
        assert_eq!(retired(line).len(), 1, "{line}");
    }
    assert_eq!(retired("/// Most bounces of a path.").len(), 1);
    for line in ["at most as many, at least one, in place of", "translate, placement, allot", "what was asked for"] {
        assert!(retired(line).is_empty(), "{line}: {:?}", retired(line));
    }
}
