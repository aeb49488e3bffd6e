//! Which file uses which: every path of the Rust sources that begins at the crate, at `super` or at `self`, and every
//! WGSL import.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use proc_macro2::{Delimiter, TokenStream, TokenTree};

/// A file uses another.
pub type Uses = BTreeMap<PathBuf, BTreeSet<PathBuf>>;

/// A path as it is written, from the root of the crate.
type Names = Vec<String>;

/// A crate: its files by module path, and the names that a module exports for another one.
#[derive(Default)]
struct Crate {
    files: BTreeMap<Names, PathBuf>,
    exports: BTreeMap<Names, Vec<(String, Names)>>,
}

/// What a file writes: paths that it uses, and paths that it exports under a name.
#[derive(Default)]
struct Written {
    uses: Vec<Names>,
    exports: Vec<(String, Names)>,
}

/// Who uses whom among the Rust files of a crate at `folder`. `names` are the names that the crate has for itself:
/// `crate`, and what its binary calls it.
pub fn rust(folder: &Path, files: &[(PathBuf, String)], names: &[&str]) -> Uses {
    let mut all = Crate::default();
    let mut written = Vec::new();
    for (path, text) in files {
        let module = module_of(path.strip_prefix(folder).unwrap());
        let tokens: TokenStream = text.parse().unwrap_or_else(|e| panic!("{}: {e}", path.display()));
        let mut found = Written::default();
        scan(tokens, &module, names, &mut found);
        all.files.insert(module.clone(), path.clone());
        all.exports.insert(module, found.exports.clone());
        written.push((path.clone(), found.uses));
    }
    let mut uses = Uses::new();
    for (path, paths) in written {
        let used = paths.iter().filter_map(|names| all.file_of(names, 8)).filter(|used| *used != path).collect();
        uses.insert(path, used);
    }
    uses
}

impl Crate {
    /// The file that defines what the path names: re-exports are followed to where they lead.
    fn file_of(&self, names: &[String], depth: u32) -> Option<PathBuf> {
        let length = (0..=names.len()).rev().find(|n| self.files.contains_key(&names[..*n]))?;
        let (module, rest) = names.split_at(length);
        if let (Some(name), true) = (rest.first(), depth > 0) {
            let exported = self.exports[module].iter().find(|(exported, _)| exported == name);
            if let Some((_, target)) = exported {
                let target: Names = target.iter().chain(&rest[1..]).cloned().collect();
                return self.file_of(&target, depth - 1);
            }
        }
        Some(self.files[module].clone())
    }
}

/// The module that a file is: `scene/mesh.rs` is `scene::mesh`, `scene/mod.rs` is `scene`, `lib.rs` and `main.rs` are
/// the root.
fn module_of(path: &Path) -> Names {
    let mut names: Names = path.with_extension("").iter().map(|part| part.to_str().unwrap().to_owned()).collect();
    if names.last().is_some_and(|name| name == "mod") || names == ["lib"] {
        names.pop();
    }
    names
}

fn scan(tokens: TokenStream, module: &Names, names: &[&str], found: &mut Written) {
    let tokens: Vec<TokenTree> = tokens.into_iter().collect();
    let mut i = 0;
    // Between `use` and its semicolon; and whether it is exported.
    let (mut in_use, mut public) = (false, false);
    while i < tokens.len() {
        let word = word(&tokens[i]);
        let after_path = i >= 2 && is_colon(&tokens[i - 1]) && is_colon(&tokens[i - 2]);
        match (word.as_deref(), &tokens[i]) {
            (Some("use"), _) => {
                in_use = true;
                public = is_public(&tokens[..i]);
            }
            (Some("mod"), _) => {
                if let (Some(name), Some(TokenTree::Group(body))) =
                    (tokens.get(i + 1).and_then(self::word), tokens.get(i + 2))
                {
                    scan(body.stream(), &[module.clone(), vec![name]].concat(), names, found);
                    i += 2;
                }
            }
            (Some(first), _) if !after_path && begins_path(first, names, in_use, &tokens[i + 1..]) => {
                let mut paths = Vec::new();
                i += read_path(&tokens[i..], &mut Vec::new(), &mut paths) - 1;
                for path in paths {
                    let Some(target) = absolute(&path, module, names) else { continue };
                    if public && in_use {
                        found.exports.push((path.last().cloned().unwrap_or_default(), target));
                    } else {
                        found.uses.push(target);
                    }
                }
            }
            (_, TokenTree::Group(group)) => scan(group.stream(), module, names, found),
            (_, TokenTree::Punct(punct)) if punct.as_char() == ';' => in_use = false,
            _ => {}
        }
        i += 1;
    }
}

fn word(token: &TokenTree) -> Option<String> {
    match token {
        TokenTree::Ident(ident) => Some(ident.to_string()),
        _ => None,
    }
}

fn is_colon(token: &TokenTree) -> bool {
    matches!(token, TokenTree::Punct(punct) if punct.as_char() == ':')
}

/// `pub` or `pub(...)` is before.
fn is_public(before: &[TokenTree]) -> bool {
    let is_pub = |token: Option<&TokenTree>| token.and_then(word).as_deref() == Some("pub");
    match before.last() {
        Some(TokenTree::Group(group)) if group.delimiter() == Delimiter::Parenthesis => {
            is_pub(before.len().checked_sub(2).map(|i| &before[i]))
        }
        last => is_pub(last),
    }
}

/// Whether the word begins a path of this crate. In a `use` any word may: it may be a child of the module.
fn begins_path(first: &str, names: &[&str], in_use: bool, after: &[TokenTree]) -> bool {
    let goes_on = after.len() >= 2 && is_colon(&after[0]) && is_colon(&after[1]);
    let own = names.contains(&first) || first == "super" || first == "self";
    goes_on && (own || in_use)
}

/// Reads `a::b::{c, d::e}` into one path each; how many tokens it has.
fn read_path(tokens: &[TokenTree], prefix: &mut Names, paths: &mut Vec<Names>) -> usize {
    let length = prefix.len();
    let mut i = 0;
    let mut ended = false;
    while i < tokens.len() && !ended {
        match &tokens[i] {
            TokenTree::Ident(ident) => prefix.push(ident.to_string()),
            TokenTree::Group(group) if group.delimiter() == Delimiter::Brace => {
                let inner: Vec<TokenTree> = group.stream().into_iter().collect();
                for item in inner.split(|t| matches!(t, TokenTree::Punct(p) if p.as_char() == ',')) {
                    if !item.is_empty() {
                        read_path(item, prefix, paths);
                    }
                }
                prefix.truncate(length);
                return i + 1;
            }
            _ => {}
        }
        i += 1;
        let goes_on = tokens.len() > i + 2 && is_colon(&tokens[i]) && is_colon(&tokens[i + 1]);
        let followed = tokens.get(i + 2).is_some_and(|next| match next {
            TokenTree::Ident(_) => true,
            TokenTree::Group(group) => group.delimiter() == Delimiter::Brace,
            _ => false,
        });
        ended = !(goes_on && followed);
        i += if ended { 0 } else { 2 };
    }
    if prefix.last().is_some_and(|name| name == "self") {
        prefix.pop();
    }
    paths.push(prefix.clone());
    prefix.truncate(length);
    i
}

/// The path from the root; `None` if it leaves the crate.
fn absolute(path: &[String], module: &Names, names: &[&str]) -> Option<Names> {
    let first = path.first()?;
    if names.contains(&first.as_str()) {
        return Some(path[1..].to_vec());
    }
    let mut from = module.clone();
    let supers = path.iter().take_while(|name| *name == "super").count();
    for _ in 0..supers {
        from.pop();
    }
    let rest = &path[supers + usize::from(path.get(supers).is_some_and(|name| name == "self"))..];
    Some(from.into_iter().chain(rest.iter().cloned()).collect())
}

/// Which WGSL file imports which.
pub fn wgsl(files: &[(PathBuf, String)]) -> Uses {
    let path_of = |names: &str| {
        let parts: Vec<&str> = names.split("::").collect();
        let candidates = (1..=parts.len()).rev().map(|n| Path::new("shaders").join(parts[..n].join("/")));
        candidates.map(|path| path.with_extension("wgsl")).find(|path| files.iter().any(|(file, _)| file == path))
    };
    let import = |line: &str| Some(line.split_once("import package::")?.1.split(['{', ';', ' ']).next()?.to_owned());
    let mut uses = Uses::new();
    for (path, text) in files {
        let code = text.lines().filter(|line| !line.trim_start().starts_with("//"));
        let used = code.filter_map(import).filter_map(|names| path_of(names.trim_end_matches(':')));
        uses.insert(path.clone(), used.filter(|used| used != path).collect());
    }
    uses
}

/// The circles: sets of files each of which reaches all others of its set.
pub fn circles(uses: &Uses) -> Vec<BTreeSet<PathBuf>> {
    let reached = |start: &PathBuf| {
        let mut reached = BTreeSet::new();
        let mut pending: Vec<&PathBuf> = uses[start].iter().collect();
        while let Some(file) = pending.pop() {
            if reached.insert(file.clone()) {
                pending.extend(uses.get(file).into_iter().flatten());
            }
        }
        reached
    };
    let reach: BTreeMap<&PathBuf, BTreeSet<PathBuf>> = uses.keys().map(|file| (file, reached(file))).collect();
    let mut circles: Vec<BTreeSet<PathBuf>> = Vec::new();
    for (file, reached) in &reach {
        if reached.contains(*file) && !circles.iter().any(|circle| circle.contains(*file)) {
            circles.push(reached.iter().filter(|other| reach[other].contains(*file)).cloned().collect());
        }
    }
    circles
}

#[cfg(test)]
mod tests {
    use super::*;

    fn files(sources: &[(&str, &str)]) -> Vec<(PathBuf, String)> {
        sources.iter().map(|(path, text)| (Path::new("src").join(path), (*text).to_owned())).collect()
    }

    fn uses(sources: &[(&str, &str)], of: &str) -> Vec<String> {
        let uses = rust(Path::new("src"), &files(sources), &["crate"]);
        uses[&Path::new("src").join(of)].iter().map(|path| path.display().to_string()).collect()
    }

    /// Trees, paths in code, `super`, inline modules and re-exports all lead to the file that defines the name.
    #[test]
    fn every_form_of_a_path_is_found() {
        let sources = [
            ("lib.rs", "mod a; mod b; pub use b::deep::Thing;"),
            ("a.rs", "use crate::{b::{self, deep::Other}, Thing}; fn f() { let x = crate::b::deep::ONE; }"),
            ("b/mod.rs", "pub mod deep; pub fn here() {}"),
            ("b/deep.rs", "use super::here; mod tests { use super::Other; }"),
            ("c.rs", "// use crate::a;\nconst TEXT: &str = \"crate::a\";"),
        ];
        assert_eq!(uses(&sources, "a.rs"), ["src/b/deep.rs", "src/b/mod.rs"]);
        assert_eq!(uses(&sources, "b/deep.rs"), ["src/b/mod.rs"]);
        assert!(uses(&sources, "b/mod.rs").is_empty(), "declaring and exporting children is no use of them");
        assert!(uses(&sources, "c.rs").is_empty(), "neither comments nor texts are code");
        assert!(uses(&sources, "lib.rs").is_empty());
    }

    /// A circle of three files is one circle, whatever else hangs on it.
    #[test]
    fn a_planted_circle_is_found() {
        let sources = [
            ("lib.rs", "mod a; mod b; mod c; mod d;"),
            ("a.rs", "use crate::b::B;"),
            ("b.rs", "fn f() { crate::c::g() }"),
            ("c.rs", "use super::a::A;"),
            ("d.rs", "use crate::a::A;"),
        ];
        let found = circles(&rust(Path::new("src"), &files(&sources), &["crate"]));
        let circle = ["src/a.rs", "src/b.rs", "src/c.rs"].map(PathBuf::from);
        assert_eq!(found, [BTreeSet::from(circle)]);
    }

    /// WGSL's imports, with and without a condition, of a module and of its names.
    #[test]
    fn imports_of_shaders_are_found() {
        let text = "import package::lib::math::PI;\n@if(textures) import package::lib::bsdf::sheen::{a, b};\n\
                    // import package::lib::rng::c;";
        let names = ["shaders/x.wgsl", "shaders/lib/math.wgsl", "shaders/lib/bsdf.wgsl", "shaders/lib/bsdf/sheen.wgsl"];
        let files: Vec<_> = names.iter().map(|name| (PathBuf::from(name), text.to_owned())).collect();
        let expected = ["shaders/lib/bsdf/sheen.wgsl", "shaders/lib/math.wgsl"].map(PathBuf::from);
        assert_eq!(wgsl(&files)[Path::new("shaders/x.wgsl")], BTreeSet::from(expected));
    }
}
