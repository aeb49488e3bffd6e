//! Lines that fit a screen.

use crate::sources;

/// Characters in a line, as in rustfmt.toml.
const WIDTH: usize = 120;

fn too_long(text: &str) -> Option<usize> {
    text.lines().position(|line| line.chars().count() > WIDTH).map(|line| line + 1)
}

/// No line of Rust or WGSL is longer than rustfmt's width. (rustfmt itself leaves comments and texts as they are.)
#[test]
fn lines_fit() {
    let rust = ["src", "crates", "tests", "benches", "examples", "scenes", "fuzz", "python"]
        .map(|folder| sources(folder, &["rs"]));
    let wgsl = ["shaders", "tests"].map(|folder| sources(folder, &["wgsl"]));
    let files = rust.into_iter().chain(wgsl).flatten();
    let long = files.filter_map(|(path, text)| Some(format!("{}:{}", path.display(), too_long(&text)?)));
    let long: Vec<String> = long.collect();
    assert!(long.is_empty(), "lines of more than {WIDTH} characters: {long:#?}");
}

/// A line of one character too many is found.
#[test]
fn a_planted_long_line_is_found() {
    let text = format!("short\n{}\n", "é".repeat(WIDTH));
    assert_eq!(too_long(&text), None);
    assert_eq!(too_long(&format!("{text}{}", "x".repeat(WIDTH + 1))), Some(3));
}
