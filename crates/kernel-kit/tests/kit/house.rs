//! Files of the kit import in one direction.

use std::collections::BTreeMap;

/// No file imports another that imports it, by whatever way.
#[test]
fn files_import_in_no_circle() {
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/src");
    let files = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    let mut imports: BTreeMap<String, Vec<String>> = BTreeMap::new();
    for path in files.filter(|path| path.extension().is_some_and(|e| e == "rs")) {
        let stem = path.file_stem().unwrap().to_str().unwrap().to_owned();
        let text = std::fs::read_to_string(&path).unwrap();
        let code = text.lines().filter(|line| !line.trim_start().starts_with("//"));
        // What macros write is read where they are used.
        let code: String = code.map(|line| line.replace("$crate::", "") + "\n").collect();
        let names = code.split("crate::").skip(1).map(|rest| name(rest).to_owned());
        imports.insert(stem, names.collect());
    }
    assert!(imports.len() > 10 && imports["frame"].contains(&"kernel".to_owned()));
    imports.remove("lib");
    // Files whose imports are all gone can go: what is left is circles.
    loop {
        let before = imports.len();
        let left: Vec<String> = imports.keys().cloned().collect();
        imports.retain(|_, names| names.iter().any(|name| left.contains(name)));
        if imports.len() == before {
            break;
        }
    }
    assert!(imports.is_empty(), "a circle is among {imports:?}");
}

fn name(text: &str) -> &str {
    text.split(|c: char| !c.is_alphanumeric() && c != '_').next().unwrap_or_default()
}
