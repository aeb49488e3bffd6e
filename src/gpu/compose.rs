//! Composing kernels: WESL imports and `@if(feature)`, so that a kernel holds only what the scene needs.

use std::borrow::Cow;
use std::collections::BTreeSet;

use crate::{Error, Result};

macro_rules! shaders {
    ($($path:literal),* $(,)?) => {
        /// Every file under `shaders/`, by its path there without extension.
        pub const SHADERS: &[(&str, &str)] = &[$(($path, include_str!(concat!("../../shaders/", $path, ".wgsl")))),*];
    };
}

shaders!("classify", "grid", "lib/dispatch", "lib/grid", "lib/math", "lib/photon", "lib/rng");

/// Every feature that an `@if` may ask for. An `@if` on another name fails to compose.
pub const FEATURES: &[&str] = &[
    // Device: tables are textures.
    "texture_loads",
    // Device: workgroups are interleaved between two threads.
    "interleave",
    // Photons are counted as in the paper: whatever their normals, by plain distance.
    "paper_counting",
    // Points may lie where the whole light is behind their surface, or emits away from it.
    "dark_points",
];

/// The features that a kernel is composed with: a subset of [`FEATURES`].
#[derive(Clone, Debug, Default, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Features(BTreeSet<&'static str>);

impl Features {
    /// All of [`FEATURES`].
    pub fn all() -> Self {
        Features(FEATURES.iter().copied().collect())
    }

    /// With `name` in or out.
    ///
    /// # Panics
    /// If `name` is not one of [`FEATURES`]: a defect of the caller.
    pub fn with(mut self, name: &'static str, on: bool) -> Self {
        assert!(FEATURES.contains(&name), "'{name}' is no feature of the kernels");
        if on {
            self.0.insert(name);
        } else {
            self.0.remove(name);
        }
        self
    }

    /// Whether `name` is in.
    pub fn has(&self, name: &str) -> bool {
        self.0.contains(name)
    }

    /// The names, sorted.
    pub fn names(&self) -> impl Iterator<Item = &'static str> + '_ {
        self.0.iter().copied()
    }
}

/// A composed and validated kernel.
pub struct Composed {
    /// Stem of the kernel's file.
    pub kernel: String,
    /// Plain WGSL.
    pub wgsl: String,
    /// The same, parsed.
    pub module: wgpu::naga::Module,
    /// What naga found out about it.
    pub info: wgpu::naga::valid::ModuleInfo,
}

/// Composes `shaders/<kernel>.wgsl`.
///
/// # Errors
/// [`Error::Kernel`] with the composer's or the validator's words.
pub fn compose(kernel: &str, features: &Features) -> Result<Composed> {
    let source = SHADERS.iter().find(|(path, _)| *path == kernel);
    let (_, source) = source.ok_or_else(|| Error::kernel(kernel, "there is no such file in shaders/"))?;
    compose_source(kernel, source, features)
}

/// Composes a kernel from its source; it imports the shipped modules as `package::lib::<module>`.
///
/// # Errors
/// As [`compose`].
pub fn compose_source(kernel: &str, source: &str, features: &Features) -> Result<Composed> {
    let mut resolver = wesl::VirtualResolver::new();
    let path = |path: &str| format!("package::{}", path.replace('/', "::")).parse::<wesl::ModulePath>();
    let broken = |e: &dyn std::fmt::Display| Error::kernel(kernel, e);
    for (name, text) in SHADERS.iter().filter(|(name, _)| name.starts_with("lib/")) {
        resolver.add_module(path(name).map_err(|e| broken(&e))?, Cow::Borrowed(text));
    }
    let root = path(kernel).map_err(|e| broken(&e))?;
    resolver.add_module(root.clone(), Cow::Borrowed(source));
    let mut options = wesl::CompileOptions::default();
    options.features.default = wesl::Feature::Error;
    for name in FEATURES {
        options.features.flags.insert((*name).to_owned(), features.has(name).into());
    }
    let mut wesl = wesl::Wesl::new_barebones().set_custom_resolver(resolver);
    // Names are kept as they are, so that bindings and structs are found by the names in the files.
    wesl.set_options(options).set_mangler(wesl::ManglerKind::None);
    let wgsl = wesl.compile(&root).map_err(|e| broken(&e))?.to_string();
    let module = wgpu::naga::front::wgsl::parse_str(&wgsl).map_err(|e| broken(&e.emit_to_string(&wgsl)))?;
    let info = wgpu::naga::valid::Validator::new(
        wgpu::naga::valid::ValidationFlags::all(),
        wgpu::naga::valid::Capabilities::IMMEDIATES,
    )
    .validate(&module)
    .map_err(|e| broken(&e.emit_to_string(&wgsl)))?;
    Ok(Composed { kernel: kernel.to_owned(), wgsl, module, info })
}
