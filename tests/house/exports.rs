//! The size of the public library: what the root of the crate exports is listed here, so that additions are deliberate.

use proc_macro2::{TokenStream, TokenTree};

use crate::root;

/// What `penumbra` exports at its root, sorted. An addition is a promise to users: it needs a doc comment, and an entry
/// in
/// `CHANGELOG.md`.
const EXPORTS: &[&str] = &[
    "Aov",
    "Camera",
    "Channel",
    "Checkpoint",
    "Denoiser",
    "Device",
    "DeviceChoice",
    "DeviceInfo",
    "Error",
    "Focus",
    "Framing",
    "Image",
    "ImportOptions",
    "Iris",
    "Lens",
    "Metadata",
    "MissingSamples",
    "Panorama",
    "Pieces",
    "Progress",
    "Renderer",
    "Result",
    "Scene",
    "Settings",
    "Statistics",
    "Technique",
    "View",
    "Window",
    "internal",
    "settings",
    "statistics",
];

/// The names that a file makes public at its own level, sorted. `pub(crate)` is not public.
fn exported(text: &str) -> Vec<String> {
    let tokens: Vec<TokenTree> = text.parse::<TokenStream>().unwrap().into_iter().collect();
    let mut names = Vec::new();
    for (i, token) in tokens.iter().enumerate() {
        if !matches!(token, TokenTree::Ident(ident) if ident == "pub") {
            continue;
        }
        let words = |token: &TokenTree| matches!(token, TokenTree::Ident(_)).then(|| token.to_string());
        match tokens.get(i + 1).and_then(words).as_deref() {
            Some("use") => {
                let is_end = |token: &&TokenTree| matches!(token, TokenTree::Punct(punct) if punct.as_char() == ';');
                let path: Vec<TokenTree> = tokens[i + 2..].iter().take_while(|token| !is_end(token)).cloned().collect();
                leaves(&path, &mut names);
            }
            // An item: its name follows its kind.
            Some(_) => names.extend(tokens.get(i + 2).and_then(words)),
            None => {}
        }
    }
    names.sort();
    names
}

/// The names that a path of a `use` ends in: `c` and `e` of `a::{b::c, d as e}`; `*` for all of a module.
fn leaves(path: &[TokenTree], names: &mut Vec<String>) {
    match path.last() {
        Some(TokenTree::Group(group)) => {
            let inner: Vec<TokenTree> = group.stream().into_iter().collect();
            let is_comma = |token: &TokenTree| matches!(token, TokenTree::Punct(punct) if punct.as_char() == ',');
            inner.split(is_comma).for_each(|item| leaves(item, names));
        }
        Some(last) => names.push(last.to_string()),
        None => {}
    }
}

/// The root of the crate exports what is listed, no more and no less.
#[test]
fn the_library_exports_what_is_listed() {
    let text = std::fs::read_to_string(root().join("src/lib.rs")).unwrap();
    assert_eq!(exported(&text), EXPORTS, "exports of src/lib.rs against the list in tests/house/exports.rs");
}

/// Each form of an export is read: trees, other names, globs, modules and items; private ones are not.
#[test]
fn planted_exports_are_found() {
    let text = "mod a; use b::C; pub use d::{E, f::{G, H as I}}; pub use j::*; pub mod k { pub fn l() {} }
                pub(crate) use m::N; #[doc(hidden)] pub fn o() {} pub struct P;";
    assert_eq!(exported(text), ["*", "E", "G", "I", "P", "k", "o"]);
}
