//! The list of extreme cases in `tests/extremes/main.rs` names tests that exist.

use crate::sources;

/// The tests that the list names, as `folder::module::test`, or as `folder::module` for all tests of a module.
fn named(list: &str) -> Vec<String> {
    let header: Vec<&str> = list.lines().filter_map(|line| line.strip_prefix("//!")).collect();
    let header = header.join("\n");
    let quoted = header.split('`').skip(1).step_by(2).filter(|name| name.contains("::"));
    // A name that begins with a module is a test of this folder.
    let folder = |name: &str| crate::root().join("tests").join(name.split("::").next().unwrap()).is_dir();
    quoted.map(|name| if folder(name) { name.to_owned() } else { format!("extremes::{name}") }).collect()
}

/// The names of the functions that an attribute makes tests.
fn tests_of(text: &str) -> Vec<&str> {
    let mut tests = Vec::new();
    let mut is_test = false;
    for line in text.lines().map(str::trim) {
        if line.starts_with("#[test]") || line.starts_with("#[kernel_test") {
            is_test = true;
        } else if let Some(name) = line.strip_prefix("fn ") {
            tests.extend(name.split(['(', '<']).next().filter(|_| is_test));
            is_test = false;
        }
    }
    tests
}

/// The names that are no tests.
fn missing(list: &str) -> Vec<String> {
    let files = sources("tests", &["rs"]);
    let is_test = |name: &String| {
        let parts: Vec<&str> = name.split("::").collect();
        let path = format!("tests/{}/{}.rs", parts[0], parts[1]);
        let Some((_, text)) = files.iter().find(|(file, _)| file.to_str() == Some(&path)) else { return false };
        let tests = tests_of(text);
        parts.get(2).map_or(!tests.is_empty(), |test| tests.contains(test))
    };
    named(list).into_iter().filter(|name| !is_test(name)).collect()
}

/// Every test that the list of extreme cases names exists.
#[test]
fn extreme_cases_name_tests_that_exist() {
    let list = std::fs::read_to_string(crate::root().join("tests/extremes/main.rs")).unwrap();
    assert!(named(&list).len() > 50, "the list is not found");
    let missing = missing(&list);
    assert!(missing.is_empty(), "tests/extremes/main.rs names tests that do not exist: {missing:#?}");
}

/// A name that is no test is found, whether its module exists, its name is that of a helper, or neither.
#[test]
fn planted_names_of_tests_are_found() {
    let list = "//! `placement::offsets_change_nothing`, `placement::planted`, `planted::offsets_change_nothing`,\n\
                //! `house::cases::planted_names_of_tests_are_found`, `house::cases::tests_of`, `house::planted`";
    let expected =
        ["extremes::placement::planted", "extremes::planted::offsets_change_nothing", "house::cases::tests_of"];
    assert_eq!(missing(list), [&expected[..], &["house::planted"]].concat());
}
