//! Features: the enum is their only list, and kernels name no others.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use proc_macro2::{Delimiter, Group, TokenStream, TokenTree};

use crate::{root, shaders, sources};

/// `TextureLoads` as kernels name it: `texture_loads`.
fn snake(camel: &str) -> String {
    let mut name = String::new();
    for c in camel.chars() {
        if c.is_uppercase() && !name.is_empty() {
            name.push('_');
        }
        name.extend(c.to_lowercase());
    }
    name
}

fn tokens(text: &str) -> Vec<TokenTree> {
    text.parse::<TokenStream>().unwrap().into_iter().collect()
}

fn is_word(token: &TokenTree, word: &str) -> bool {
    matches!(token, TokenTree::Ident(ident) if ident == word)
}

/// The names of the variants of `enum Feature`, wherever in the tokens that is.
fn variants(tokens: &[TokenTree]) -> BTreeSet<String> {
    let mut found = BTreeSet::new();
    for (i, token) in tokens.iter().enumerate() {
        let TokenTree::Group(group) = token else { continue };
        let inner: Vec<TokenTree> = group.stream().into_iter().collect();
        if i >= 2 && is_word(&tokens[i - 2], "enum") && is_word(&tokens[i - 1], "Feature") {
            let words = inner.iter().filter(|token| matches!(token, TokenTree::Ident(_)));
            found.extend(words.map(|word| snake(&word.to_string())));
        } else {
            found.extend(variants(&inner));
        }
    }
    found
}

/// The features of `src/specialisation/features.rs`.
fn features() -> BTreeSet<String> {
    let text = std::fs::read_to_string(root().join("src/specialisation/features.rs")).unwrap();
    let features = variants(&tokens(&text));
    assert!(features.len() > 40, "{features:?}");
    features
}

/// The condition of each `@if(...)` or `@elif(...)` of a shader, without comments; and of each `@each(...)` whose group
/// there is not, which is therefore left.
fn conditions(text: &str) -> Vec<String> {
    let code: Vec<&str> = text.lines().map(|line| line.split("//").next().unwrap()).collect();
    let code = code.join("\n");
    let begins = ["@if(", "@elif(", "@each(", "@each_from_top("].into_iter().flat_map(|word| code.match_indices(word));
    begins
        .map(|(at, word)| {
            let rest = &code[at + word.len()..];
            let mut depth = 1;
            let end = rest.find(|c| {
                depth += i32::from(c == '(') - i32::from(c == ')');
                depth == 0
            });
            rest[..end.expect("a condition that ends")].to_owned()
        })
        .collect()
}

/// Names in conditions of shaders that are no features.
fn unknown(files: &[(PathBuf, String)], features: &BTreeSet<String>) -> Vec<String> {
    let mut unknown = Vec::new();
    for (path, text) in files {
        for condition in conditions(text) {
            let words = condition.split(|c: char| !(c.is_alphanumeric() || c == '_'));
            let names = words.filter(|word| !["", "true", "false"].contains(word) && !features.contains(*word));
            unknown.extend(names.map(|name| format!("{}: @if({name})", path.display())));
        }
    }
    unknown
}

/// Calls `has`, `set` or `with` of what a text names: any such `has`, and the others with the name of a feature.
fn named_by_text(tokens: &[TokenTree], features: &BTreeSet<String>) -> Vec<String> {
    let mut found = Vec::new();
    for (i, token) in tokens.iter().enumerate() {
        let TokenTree::Group(group) = token else { continue };
        let called = i.checked_sub(1).map(|before| tokens[before].to_string()).unwrap_or_default();
        if let Some(text) = first_text(group)
            && (called == "has" || (["set", "with"].contains(&called.as_str()) && features.contains(&text)))
        {
            found.push(format!("{called}({text:?})"));
        }
        let inner: Vec<TokenTree> = group.stream().into_iter().collect();
        found.extend(named_by_text(&inner, features));
    }
    found
}

/// The text that is the first argument of a call.
fn first_text(arguments: &Group) -> Option<String> {
    let first = arguments.stream().into_iter().next().filter(|_| arguments.delimiter() == Delimiter::Parenthesis)?;
    let text = first.to_string();
    text.strip_prefix('"')?.strip_suffix('"').map(str::to_owned)
}

/// Every name in an `@if(...)` of the shaders is a feature.
#[test]
fn conditions_of_shaders_name_features() {
    let files = [shaders(), sources("tests/kernels/shaders", &["wgsl"])].concat();
    let unknown = unknown(&files, &features());
    assert!(unknown.is_empty(), "names that are no features: {unknown:#?}");
}

/// The library names features by the enum alone, never by a text, in which a typing error would go unseen.
#[test]
fn the_library_names_features_by_the_enum() {
    let features = features();
    let mut found = Vec::new();
    for (path, text) in sources("src", &["rs"]) {
        let calls = named_by_text(&tokens(&text), &features);
        found.extend(calls.into_iter().map(|call| format!("{}: {call}", path.display())));
    }
    assert!(found.is_empty(), "features named by a text: {found:#?}");
}

/// A condition on what is neither feature nor group and a feature named by a text are found; comments, and bindings by
/// name, are not faults.
#[test]
fn planted_names_of_features_are_found() {
    let features = variants(&tokens("features! { /// All.\n pub enum Feature { /// One.\n Textures, LightTags } }"));
    assert_eq!(features, BTreeSet::from(["textures", "light_tags"].map(str::to_owned)));
    let shader = "@if(textures && !(light_tags || planted)) fn f() {} // @if(comment)\n\
                  @elif(other) const a = 1;\n\
                  @each(lobes) const b = 2;";
    let found = unknown(&[(Path::new("shaders/x.wgsl").to_owned(), shader.to_owned())], &features);
    assert_eq!(found, ["planted", "other", "lobes"].map(|name| format!("shaders/x.wgsl: @if({name})")));
    let code =
        "fn f() { if g.has(\"typo\") { g.set(\"textures\", true).with(\"light_tags\", h.with(\"buffer\", &b)) } }";
    assert_eq!(named_by_text(&tokens(code), &features), ["has(\"typo\")", "set(\"textures\")", "with(\"light_tags\")"]);
}
