//! Each setting that a message of the library names has a flag, which takes its place in the program's messages.

use std::collections::BTreeSet;

use crate::sources;

/// The groups of settings, by which paths of fields begin.
const GROUPS: [&str; 8] =
    ["image", "visibility_map", "shadow_rays", "light_sampling", "indirect", "cells", "light_buffer", "ward"];

/// The settings that a text names between quotes or backticks.
fn named(text: &str) -> BTreeSet<String> {
    let is_setting = |name: &&str| {
        let mut fields = name.split('.');
        let is_field = |field: &str| !field.is_empty() && field.chars().all(|c| c.is_ascii_lowercase() || c == '_');
        fields.next().is_some_and(|group| GROUPS.contains(&group)) && name.contains('.') && fields.all(is_field)
    };
    let code = text.lines().filter(|line| !line.trim_start().starts_with("//"));
    code.flat_map(|line| line.split(['"', '`']).filter(is_setting)).map(str::to_owned).collect()
}

#[test]
fn settings_in_messages_have_flags() {
    let sources = sources("src", &["rs"]);
    let (flags, library): (Vec<_>, Vec<_>) =
        sources.iter().partition(|(file, _)| file.to_str() == Some("src/cli/flags.rs"));
    let flags = named(&flags[0].1);
    let messages: BTreeSet<String> = library.iter().flat_map(|(_, text)| named(text)).collect();
    assert!(messages.len() > 20, "the names are not found: {messages:?}");
    let missing: Vec<&String> = messages.difference(&flags).collect();
    assert!(missing.is_empty(), "FLAGS in src/cli/flags.rs has no entry for {missing:?}");
}

#[test]
fn planted_names_of_settings_are_found() {
    let text =
        "// \"image.none\"\nError::setting(\"image.spp\", format!(\"beside `indirect.irradiance_cache.enabled`\"))";
    assert_eq!(named(text), ["image.spp", "indirect.irradiance_cache.enabled"].map(str::to_owned).into());
    assert_eq!(named("range(image.width, \"image.png 1\", \"images.spp\")"), BTreeSet::new());
}
