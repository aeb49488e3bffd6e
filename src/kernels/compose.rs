//! Composing the kernels from the files below `shaders/`.

use std::sync::LazyLock;

use kernel_kit::{Composed, Composer, embed};

use super::constants;
use super::each::expand_each;
use crate::Result;
use crate::specialisation::features::Features;

/// Every file below `shaders/` by its path there, with all lobes in place of `@each`, and the generated module
/// `lib/constants`.
static COMPOSER: LazyLock<Composer> = LazyLock::new(|| {
    let written = Composer::new().with_folder(embed!("$CARGO_MANIFEST_DIR/shaders"));
    let with_each = written.modules().filter(|(_, text)| text.contains("@each"));
    let expanded: Vec<_> = with_each.map(|(path, text)| (path.to_owned(), expand_each(text))).collect();
    let composer = expanded.into_iter().fold(written, |composer, (path, text)| composer.with_module(path, text));
    composer.with_module("lib/constants", constants::module())
});

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
