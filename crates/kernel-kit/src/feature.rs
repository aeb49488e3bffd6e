//! Features: what an `@if` in a kernel may name, as a type.

use std::collections::BTreeSet;

/// A set of things that kernels can have or do without, one value each. Made by [`features!`](crate::features).
pub trait Feature: Copy + Ord + Send + Sync + 'static {
    /// All there are.
    const ALL: &'static [Self];

    /// The name that kernels use: `@if(name)`.
    fn name(self) -> &'static str;

    /// What it is for, in words for a reader of a plan or a log.
    fn why(self) -> &'static str;
}

/// The features of kernels that have none.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum NoFeature {}

impl Feature for NoFeature {
    const ALL: &'static [Self] = &[];

    fn name(self) -> &'static str {
        match self {}
    }

    fn why(self) -> &'static str {
        match self {}
    }
}

/// The features that a kernel is composed with.
#[derive(Clone, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Features<F>(BTreeSet<F>);

impl<F> Default for Features<F> {
    fn default() -> Self {
        Features(BTreeSet::new())
    }
}

impl Features<NoFeature> {
    /// For kernels that have no features.
    pub fn none() -> Self {
        Self::default()
    }
}

impl<F: Feature> Features<F> {
    /// No feature.
    pub fn new() -> Self {
        Self::default()
    }

    /// All of [`Feature::ALL`].
    pub fn all() -> Self {
        F::ALL.iter().copied().collect()
    }

    /// The features with `feature` switched on or off.
    #[must_use]
    pub fn with(mut self, feature: F, on: bool) -> Self {
        self.set(feature, on);
        self
    }

    /// Puts `feature` in or takes it out.
    pub fn set(&mut self, feature: F, on: bool) {
        if on {
            self.0.insert(feature);
        } else {
            self.0.remove(&feature);
        }
    }

    /// Whether `feature` is in.
    pub fn has(&self, feature: F) -> bool {
        self.0.contains(&feature)
    }

    /// The features that are on, in their own order.
    pub fn iter(&self) -> impl Iterator<Item = F> + '_ {
        self.0.iter().copied()
    }

    /// The names that kernels know them by, in the features' order.
    pub fn names(&self) -> impl Iterator<Item = &'static str> + '_ {
        self.iter().map(F::name)
    }
}

impl<F: Feature> FromIterator<F> for Features<F> {
    fn from_iter<I: IntoIterator<Item = F>>(features: I) -> Self {
        Features(features.into_iter().collect())
    }
}

impl<F: Feature> Extend<F> for Features<F> {
    fn extend<I: IntoIterator<Item = F>>(&mut self, features: I) {
        self.0.extend(features);
    }
}

/// Declares the features of some kernels: an enum whose variants kernels know by their names in snake case, and whose
/// doc comments [`Feature::why`] returns. `Variant = "name"` gives another name.
///
/// ```
/// use kernel_kit::Feature;
/// kernel_kit::features! {
///     /// What the kernels of this program can have.
///     pub enum Mode {
///         /// Device: tables are textures.
///         TextureLoads,
///         /// Input: some values are not finite.
///         NotFinite = "checks",
///     }
/// }
/// assert_eq!(Mode::TextureLoads.name(), "texture_loads");
/// assert_eq!(Mode::NotFinite.name(), "checks");
/// assert_eq!(Mode::TextureLoads.why(), "Device: tables are textures.");
/// ```
#[macro_export]
macro_rules! features {
    ($(#[$meta:meta])* $vis:vis enum $name:ident {
        $($(#[doc = $why:literal])+ $variant:ident $(= $wgsl:literal)?),* $(,)?
    }) => {
        $(#[$meta])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
        $vis enum $name { $($(#[doc = $why])+ $variant),* }

        impl $crate::Feature for $name {
            const ALL: &'static [Self] = &[$($name::$variant),*];

            fn name(self) -> &'static str {
                match self { $($name::$variant => $crate::features!(@name $variant $($wgsl)?)),* }
            }

            fn why(self) -> &'static str {
                match self { $($name::$variant => concat!($($why),+).trim_ascii()),* }
            }
        }
    };
    (@name $variant:ident $wgsl:literal) => { $wgsl };
    (@name $variant:ident) => {{
        const CAMEL: &str = stringify!($variant);
        const SNAKE: [u8; $crate::__snake_length(CAMEL)] = $crate::__snake(CAMEL);
        const NAME: &str = match std::str::from_utf8(&SNAKE) {
            Ok(name) => name,
            Err(_) => panic!("names of features are ASCII"),
        };
        NAME
    }};
}

/// Bytes of [`snake`]'s result.
#[doc(hidden)]
pub const fn snake_length(camel: &str) -> usize {
    let (camel, mut length, mut i) = (camel.as_bytes(), 0, 0);
    while i < camel.len() {
        length += if camel[i].is_ascii_uppercase() && i > 0 { 2 } else { 1 };
        i += 1;
    }
    length
}

/// `TextureLoads` as `texture_loads`.
#[doc(hidden)]
pub const fn snake<const N: usize>(camel: &str) -> [u8; N] {
    let (camel, mut name, mut length, mut i) = (camel.as_bytes(), [0; N], 0, 0);
    while i < camel.len() {
        if camel[i].is_ascii_uppercase() && i > 0 {
            name[length] = b'_';
            length += 1;
        }
        name[length] = camel[i].to_ascii_lowercase();
        length += 1;
        i += 1;
    }
    name
}
