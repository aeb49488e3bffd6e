//! Composing the kernels from the files below `shaders/`.

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::sync::LazyLock;

use kernel_kit::{Composed, Composer, Feature as _, Gpu, embed};

use super::constants;
use super::each::expand_each;
use crate::Result;
use crate::specialisation::features::{Feature, Features};

/// Every file below `shaders/` by its path there, with all lobes in place of `@each`, and the generated module
/// `lib/constants`.
static COMPOSER: LazyLock<Composer> = LazyLock::new(|| {
    let written = Composer::new().with_folder(embed!("$CARGO_MANIFEST_DIR/shaders"));
    let with_each = written.modules().filter(|(_, text)| text.contains("@each"));
    let expanded: Vec<_> = with_each.map(|(path, text)| (path.to_owned(), expand_each(text))).collect();
    let composer = expanded.into_iter().fold(written, |composer, (path, text)| composer.with_module(path, text));
    composer.with_module("lib/constants", constants::module())
});

/// The names in a module: the features that it mentions, in code or in comments, and the modules that it imports.
struct Names {
    features: BTreeSet<Feature>,
    imports: Vec<String>,
}

/// The features on which each kernel may depend: those that it, or a module that it imports, names.
static NAMED: LazyLock<BTreeMap<&str, BTreeSet<Feature>>> = LazyLock::new(|| {
    let composer = composer(&Features::default());
    let texts: BTreeMap<&str, &str> = composer.modules().collect();
    let features: HashMap<&str, Feature> = Feature::ALL.iter().map(|feature| (feature.name(), *feature)).collect();
    // Each text is read once, for all kernels: this is part of every start.
    let names = texts.iter().map(|(path, text)| (*path, names_in(text, &features, |path| texts.contains_key(path))));
    let names = names.collect();
    kernel_stems().into_iter().map(|stem| (stem, named_from(stem, &names))).collect()
});

fn is_of_name(c: char) -> bool {
    c.is_ascii_alphanumeric() || c == '_'
}

fn names_in(text: &str, features: &HashMap<&str, Feature>, is_module: impl Fn(&str) -> bool) -> Names {
    let imports = text.split("package::").skip(1).map(|import| {
        let end = import.find(|c| !is_of_name(c) && c != ':').unwrap_or(import.len());
        let names: Vec<&str> = import[..end].split("::").collect();
        // The last names are those of items in the module.
        let mut paths = (1..=names.len()).rev().map(|length| names[..length].join("/"));
        paths.find(|path| is_module(path)).unwrap_or_else(|| names.join("/"))
    });
    let words = text.split(|c| !is_of_name(c));
    Names { features: words.filter_map(|word| features.get(word).copied()).collect(), imports: imports.collect() }
}

/// The features that a kernel and the modules that it imports name: all features if an import names no module.
fn named_from(kernel: &str, names: &BTreeMap<&str, Names>) -> BTreeSet<Feature> {
    let (mut waiting, mut seen, mut named) = (vec![kernel], BTreeSet::new(), BTreeSet::new());
    while let Some(path) = waiting.pop() {
        let Some(module) = names.get(path) else { return Feature::ALL.iter().copied().collect() };
        if seen.insert(path) {
            named.extend(&module.features);
            waiting.extend(module.imports.iter().map(String::as_str));
        }
    }
    named
}

/// Whether `shaders/<kernel>.wgsl` may depend on the feature. If not, it is the same with and without it.
fn depends_on(kernel: &str, feature: Feature) -> bool {
    NAMED.get(kernel).is_none_or(|named| named.contains(&feature))
}

/// The features on which a kernel may depend: composed with these alone, it is the same.
pub fn features_of(kernel: &str, features: &Features) -> Features {
    let mut own = features.clone();
    features.iter().filter(|feature| !depends_on(kernel, *feature)).for_each(|feature| own.set(feature, false));
    own
}

/// The composer with the functions of procedural objects.
fn composer(features: &Features) -> Composer {
    COMPOSER.clone().with_module("lib/procedural_functions", features.functions().wesl.to_string())
}

/// Composes `shaders/<kernel>.wgsl`.
///
/// # Errors
/// [`crate::Error::Kernel`] with the composer's or the validator's words.
pub fn compose(kernel: &str, features: &Features) -> Result<Composed> {
    Ok(composer(features).compose(kernel, features.kit())?)
}

/// As [`compose`], from the device's folder of kernels if it has one ([`Gpu::keep_composed`]).
///
/// # Errors
/// As [`compose`].
pub fn compose_for(gpu: &Gpu, kernel: &str, features: &Features) -> Result<Composed> {
    Ok(gpu.compose(&composer(features), kernel, features.kit())?)
}

/// Composes a kernel from its source; it imports the shipped modules as `package::lib::<module>`.
///
/// # Errors
/// As [`compose`].
pub fn compose_source(kernel: &str, source: &str, features: &Features) -> Result<Composed> {
    Ok(composer(features).compose_source(kernel, source, features.kit())?)
}

/// The stems of all kernels, sorted.
pub fn kernel_stems() -> Vec<&'static str> {
    COMPOSER.modules().map(|(path, _)| path).filter(|path| !path.contains('/') && *path != "kit").collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A kernel that is kept for renders with other features is theirs.
    #[test]
    fn features_on_which_a_kernel_does_not_depend_leave_it() {
        let mut composed = 0;
        for kernel in kernel_stems() {
            let depends = |feature: &&Feature| depends_on(kernel, **feature);
            let (named, others): (Vec<_>, Vec<_>) = Feature::ALL.iter().partition(depends);
            let with = |features: Features, more: &[&Feature]| more.iter().fold(features, |all, f| all.with(**f, true));
            let text = |features| compose(kernel, &features).map(|composed| composed.wgsl).map_err(|e| e.to_string());
            for start in [Features::default(), with(Features::default(), &named)] {
                let plain = text(start.clone());
                composed += usize::from(plain.is_ok());
                assert!(plain == text(with(start, &others)), "{kernel}");
            }
        }
        // Some kernels do not compose without a feature, or with two that exclude each other.
        assert!(composed > kernel_stems().len(), "{composed}");
        assert!(!depends_on("primary", Feature::Audit) && depends_on("shade", Feature::Audit));
        // By an import of an import.
        assert!(depends_on("path", Feature::LayeredTexels));
    }
}
