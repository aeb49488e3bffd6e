//! Composing kernels: WESL imports and `@if(feature)`, so that a kernel holds only what it needs.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::str::FromStr;

use wgpu::naga;

use crate::buffer::{TABLE_LAYER_ROWS, TABLE_WIDTH};
use crate::digest::digest;
use crate::error::{Error, Result, one_line};
use crate::feature::{Feature, Features};

/// Largest number of workgroups in one dimension of a dispatch (WebGPU's limit, and lavapipe's).
pub const MAX_GROUPS: u32 = 65_535;

/// The feature by which `group_index` of `package::kit` interleaves workgroups.
const INTERLEAVE: &str = "interleave";

/// The modules that kernels are composed of, by path: kernels import from the module `lib/noise` as
/// `package::lib::noise::item`. Clones share the text of embedded modules.
///
/// Every composer has the module `package::kit`: `group_index`, `dispatch_groups`, `MAX_GROUPS`, `TABLE_WIDTH`,
/// `TABLE_WIDTH_LOG2` and `TABLE_LAYER_ROWS_LOG2`. What a kernel does not use is left out of it. Where the kernels have
/// a feature `interleave` and it is on, `group_index` alternates between the two halves of a dispatch, for software
/// devices that give each half to a thread.
#[derive(Clone, Debug)]
pub struct Composer {
    modules: BTreeMap<String, Module>,
}

/// A module that kernels import from.
#[derive(Clone, Debug)]
struct Module {
    text: Cow<'static, str>,
    /// Digest of the text, computed once for all kernels that are looked up in a folder.
    digest: u128,
}

impl Module {
    fn new(text: Cow<'static, str>) -> Module {
        let digest = digest(&[&text]);
        Module { text, digest }
    }
}

impl Default for Composer {
    fn default() -> Self {
        Self::new()
    }
}

impl Composer {
    /// A composer that has the module `package::kit` and no other.
    pub fn new() -> Self {
        let constants = [
            ("MAX_GROUPS", MAX_GROUPS),
            ("TABLE_WIDTH", TABLE_WIDTH),
            ("TABLE_WIDTH_LOG2", TABLE_WIDTH.trailing_zeros()),
            ("TABLE_LAYER_ROWS_LOG2", TABLE_LAYER_ROWS.trailing_zeros()),
        ];
        let kit = constants_module(&constants) + include_str!("kit.wgsl");
        Composer { modules: BTreeMap::new() }.with_module("kit", kit)
    }

    /// Adds the module or kernel `path` (`/` between its parts, no extension), or replaces one of the same path.
    #[must_use]
    pub fn with_module(mut self, path: impl Into<String>, wgsl: impl Into<Cow<'static, str>>) -> Self {
        self.modules.insert(path.into(), Module::new(wgsl.into()));
        self
    }

    /// Adds every `.wgsl` and `.wesl` file of a folder, by its path in the folder without the extension.
    /// [`embed!`](crate::embed) returns the folder.
    #[must_use]
    pub fn with_folder(mut self, folder: &'static include_dir::Dir<'static>) -> Self {
        let mut folders = vec![folder];
        while let Some(folder) = folders.pop() {
            folders.extend(folder.dirs());
            for file in folder.files() {
                let path = file.path().with_extension("");
                let is_wgsl = file.path().extension().is_some_and(|e| e == "wgsl" || e == "wesl");
                if let (true, Some(path), Some(text)) = (is_wgsl, path.to_str(), file.contents_utf8()) {
                    self.modules.insert(path.replace('\\', "/"), Module::new(Cow::Borrowed(text)));
                }
            }
        }
        self
    }

    /// The modules and kernels by path.
    pub fn modules(&self) -> impl Iterator<Item = (&str, &str)> {
        self.modules.iter().map(|(path, module)| (path.as_str(), &*module.text))
    }

    /// 128 bits that tell kernels apart: by the kernel, by all modules, which it may import, and by the features.
    pub(crate) fn key<F: Feature>(&self, kernel: &str, features: &Features<F>) -> u128 {
        let modules = self.modules.iter().map(|(path, module)| format!("{path} {:x}\n", module.digest));
        let switches = F::ALL.iter().map(|feature| format!("{} {}\n", feature.name(), features.has(*feature)));
        digest(&[kernel, &modules.collect::<String>(), &switches.collect::<String>()])
    }

    /// Composes the kernel `path`, which is one of the modules.
    ///
    /// # Errors
    /// [`Error::Kernel`] if there is none, with the composer's or the validator's words, or for an `@if` on what is
    /// none of the features `F`.
    pub fn compose<F: Feature>(&self, path: &str, features: &Features<F>) -> Result<Composed> {
        let module = self.modules.get(path);
        let module = module.ok_or_else(|| Error::kernel(path, "the composer has no module of this path"))?;
        self.compose_source(path, &module.text, features)
    }

    /// Composes a kernel from its source. `name` is what errors and timings call it.
    ///
    /// # Errors
    /// As [`Composer::compose`].
    pub fn compose_source<F: Feature>(&self, name: &str, source: &str, features: &Features<F>) -> Result<Composed> {
        let broken = |e: &dyn std::fmt::Display| Error::kernel(name, one_line(&e.to_string()));
        let path = format!("package::{}", name.replace('/', "::"));
        let root: wesl::ModulePath = path.parse().map_err(|e: <wesl::ModulePath as FromStr>::Err| broken(&e))?;
        let sources = Sources { modules: &self.modules, root: &root, source };
        // naga validates what comes out.
        let mut options = wesl::CompileOptions { validate: false, ..Default::default() };
        options.features.default = wesl::Feature::Error;
        // Kernels that have no such feature use the kit's own module without it.
        options.features.flags.insert(INTERLEAVE.to_owned(), false.into());
        for feature in F::ALL {
            options.features.flags.insert(feature.name().to_owned(), features.has(*feature).into());
        }
        let mut wesl = wesl::Wesl::new_barebones().set_custom_resolver(sources);
        // Names are kept as they are, so that bindings and structs are found by the names in the files.
        wesl.set_options(options).set_mangler(wesl::ManglerKind::None);
        let mut unit = wesl.compile(&root).map_err(|e| broken(&e))?.syntax;
        // Modules come in the order of a hash that differs from run to run where a kernel has several entry points.
        // Sorted, the same kernel is the same program, and the driver's cache on disk has it.
        unit.global_declarations.sort_by_cached_key(|declaration| declaration.to_string());
        let wgsl = unit.to_string();
        Composed::new(name, wgsl)
    }
}

/// Finds the modules of a composer, and the kernel that is composed.
struct Sources<'c> {
    modules: &'c BTreeMap<String, Module>,
    root: &'c wesl::ModulePath,
    source: &'c str,
}

impl wesl::Resolver for Sources<'_> {
    fn resolve_source<'a>(&'a self, path: &wesl::ModulePath) -> std::result::Result<Cow<'a, str>, wesl::ResolveError> {
        if path == self.root {
            return read(self.source);
        }
        let own = matches!(path.origin, wesl::syntax::PathOrigin::Absolute);
        let module = self.modules.get(&path.components.join("/")).filter(|_| own);
        let missing = || wesl::ResolveError::ModuleNotFound(path.clone(), "the composer has none of this path".into());
        module.ok_or_else(missing).and_then(|module| read(&module.text))
    }
}

/// The text of a module. Refuses hexadecimal floats, because wesl 0.4.0 misreads them: it makes 2^-36 of `0x1p-9`.
fn read(text: &str) -> std::result::Result<Cow<'_, str>, wesl::ResolveError> {
    let code = text.lines().map(|line| line.split("//").next().unwrap_or_default());
    let mut words = code.flat_map(|line| line.split(|c: char| !c.is_ascii_alphanumeric() && c != '.'));
    let hexadecimal = |word: &&str| (word.starts_with("0x") || word.starts_with("0X")) && word.contains(['p', 'P']);
    match words.find(hexadecimal) {
        None => Ok(Cow::Borrowed(text)),
        Some(word) => {
            let problem = format!("the hexadecimal float '{word}..' would be composed wrongly: write it as a decimal");
            Err(wesl::Diagnostic::from(wesl::Error::Custom(problem)).into())
        }
    }
}

/// A module of constants that host and kernels share: `const NAME: u32 = value;` for each.
pub fn constants_module(constants: &[(&str, u32)]) -> String {
    constants.iter().fold(String::new(), |mut module, (name, value)| {
        let _ = writeln!(module, "const {name}: u32 = {value}u;");
        module
    })
}

/// A composed and validated kernel.
#[derive(Clone, Debug)]
pub struct Composed {
    /// The name it was composed under.
    pub kernel: String,
    /// Plain WGSL.
    pub wgsl: String,
    /// The same, parsed.
    pub module: naga::Module,
    /// naga's information about it.
    pub info: naga::valid::ModuleInfo,
}

/// How many resources an entry point takes of each kind that devices limit.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Taken {
    /// Name of the entry point.
    pub entry: String,
    /// Storage buffers.
    pub storage_buffers: u32,
    /// Storage textures.
    pub storage_textures: u32,
    /// Sampled textures.
    pub sampled_textures: u32,
    /// Uniform buffers.
    pub uniform_buffers: u32,
}

impl Composed {
    /// Parses and validates plain WGSL.
    pub(crate) fn new(name: &str, wgsl: String) -> Result<Composed> {
        let broken = |words: String| Error::kernel(name, one_line(&words));
        let module = naga::front::wgsl::parse_str(&wgsl).map_err(|e| broken(e.emit_to_string(&wgsl)))?;
        let flags = naga::valid::ValidationFlags::all();
        let capabilities = naga::valid::Capabilities::IMMEDIATES | naga::valid::Capabilities::SUBGROUP;
        let info = naga::valid::Validator::new(flags, capabilities)
            .validate(&module)
            .map_err(|e| broken(e.emit_to_string(&wgsl)))?;
        Ok(Composed { kernel: name.to_owned(), wgsl, module, info })
    }

    /// The inputs of each entry point.
    pub fn taken(&self) -> Vec<Taken> {
        let taken_by = |(index, entry): (usize, &naga::EntryPoint)| {
            let uses = self.info.get_entry_point(index);
            let mut taken = Taken { entry: entry.name.clone(), ..Taken::default() };
            let variables = self.module.global_variables.iter();
            for (_, variable) in variables.filter(|(handle, _)| !uses[*handle].is_empty()) {
                match (variable.space, &self.module.types[variable.ty].inner) {
                    (naga::AddressSpace::Storage { .. }, _) => taken.storage_buffers += 1,
                    (naga::AddressSpace::Uniform, _) => taken.uniform_buffers += 1,
                    (_, naga::TypeInner::Image { class: naga::ImageClass::Storage { .. }, .. }) => {
                        taken.storage_textures += 1;
                    }
                    (_, naga::TypeInner::Image { .. }) => taken.sampled_textures += 1,
                    _ => {}
                }
            }
            taken
        };
        self.module.entry_points.iter().enumerate().map(taken_by).collect()
    }

    /// The entries of `constants` that are `override`s of this kernel.
    pub fn overrides<'c>(&self, constants: &[(&'c str, f64)]) -> Vec<(&'c str, f64)> {
        constants.iter().copied().filter(|(name, _)| self.has_override(name)).collect()
    }

    /// Whether the kernel has an `override` of this name.
    pub(crate) fn has_override(&self, name: &str) -> bool {
        self.module.overrides.iter().any(|(_, o)| o.name.as_deref() == Some(name))
    }

    /// Whether the kernel has a module-level variable of this name.
    pub(crate) fn has_variable(&self, name: &str) -> bool {
        self.module.global_variables.iter().any(|(_, v)| v.name.as_deref() == Some(name))
    }
}

/// Embeds a folder of modules into the program, for [`Composer::with_folder`]. The path may begin with an environment
/// variable of the build: `kernel_kit::embed!("$CARGO_MANIFEST_DIR/shaders")`.
///
/// A changed file makes Cargo build the crate anew. A new one is found at the next build of the crate, which comes with
/// the first change of a file that imports it.
#[macro_export]
macro_rules! embed {
    ($path:tt) => {{
        use $crate::include_dir;
        static FOLDER: include_dir::Dir<'static> = include_dir::include_dir!($path);
        &FOLDER
    }};
}
