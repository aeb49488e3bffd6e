//! Composing kernels: WESL imports and `@if(feature)`, so that a kernel holds only what the scene needs.

use std::borrow::Cow;
use std::collections::BTreeSet;

use crate::procedural::Functions;
use crate::statistics::Counter;
use crate::{Error, Result};

macro_rules! shaders {
    ($($path:literal),* $(,)?) => {
        /// Every file under `shaders/`, by its path there without extension.
        pub const SHADERS: &[(&str, &str)] = &[$(($path, include_str!(concat!("../../shaders/", $path, ".wgsl")))),*];
    };
}

shaders!(
    "cache",
    "cells",
    "sample_lights",
    "classify",
    "film",
    "flux",
    "gather",
    "grid",
    "irradiance",
    "photons",
    "path",
    "primary",
    "shade",
    "shadow",
    "ward",
    "zones",
    "lib/alpha",
    "lib/bsdf",
    "lib/bvh",
    "lib/camera",
    "lib/dispatch",
    "lib/environment",
    "lib/grid",
    "lib/irradiance",
    "lib/light",
    "lib/sampled_light",
    "lib/math",
    "lib/photon",
    "lib/point",
    "lib/procedural",
    "lib/ray",
    "lib/record",
    "lib/rng",
    "lib/sampling",
    "lib/seen",
    "lib/surface",
    "lib/table",
    "lib/tile",
    "lib/walk",
);

/// Every feature that an `@if` may ask for. An `@if` on another name fails to compose.
pub const FEATURES: &[&str] = &[
    // Device: tables are textures.
    "texture_loads",
    // Device: workgroups are interleaved between two threads.
    "interleave",
    // Scene: the hierarchy has few levels.
    "shallow_bvh",
    // Scene: some triangles are so much longer than wide that their corners' weights round to another distance.
    "needles",
    // Scene: some material has a texture.
    "textures",
    // Scene: some material uses the second set of texture coordinates.
    "uv1",
    // Scene: some vertex has a colour other than white.
    "vertex_colours",
    // Scene: some material has a normal texture.
    "normal_maps",
    // Scene: some triangle stands for a piece of a smooth surface.
    "smooth_normals",
    // Scene: some material reflects other than as a Lambertian.
    "glossy",
    // Scene: some material lets light pass.
    "transmission",
    // Scene: some material has a clear coat.
    "clearcoat",
    // Scene: some material has a coat whose normal is not its base's.
    "coat_normals",
    // Scene: some material spreads its reflections more along its tangent than across.
    "anisotropy",
    // Scene: some material has a sheen of fibres.
    "sheen",
    // Scene: some material is an alpha mask or blends, so that rays test the triangles they meet.
    "alpha_test",
    // Scene: some material is unlit.
    "unlit",
    // Scene: some objects are functions.
    "procedurals",
    // Scene: kinds of lights.
    "mesh_lights",
    "point_lights",
    "spot_lights",
    "directional_lights",
    // Scene: a panorama is all around it.
    "environment",
    // Scene: some mesh light has more than a few triangles, so that points do not ask all of them.
    "many_emitters",
    // Scene: some mesh light of that kind is closed, so that half of it faces away.
    "emitter_pairs",
    // Scene: some mesh light has an emissive texture.
    "emissive_textures",
    // Method: points that face away from a light are told apart.
    "dark_points",
    // Method: photons classify the points.
    "visibility_map",
    // Method: photons are told apart by light.
    "light_tags",
    // Method: photons are counted without regard to normals.
    "paper_counting",
    // Method: rays from the cells of a grid say what points see.
    "cells",
    // Method: cells that agree with their neighbours decide.
    "voxel_tags",
    // Method: lights are tested in the order of what they could contribute.
    "ward",
    // Method: points ask a few of many lights, which a pass chooses.
    "light_sampling",
    // Method: lights are chosen alike, not by power.
    "uniform_light_sampling",
    // Method: photons tell which lights reach a zone, and are chosen there.
    "zones",
    // Method: decided points are audited.
    "audit",
    // Method: most points need no light point, as every light has a closed form and photons decide.
    "few_sampled",
    // Method: rays end where photons have brought flux.
    "global_map",
    // Method: the global map is shown directly.
    "photon_map",
    // Method: shadow photons take away the energy of light that other surfaces got.
    "negative_photons",
    // Scene and method: the camera's rays go on through clear glass and over mirrors.
    "chains",
    // Method: a map of its own brings what light focusing surfaces send on to those that are seen.
    "caustics",
    // Method: records bring the diffuse part of indirect light.
    "irradiance_cache",
    // Method: paths from the points bring light of more bounces; direct light is another pass's.
    "indirect",
    // Method: visibility is that of the photons, or a guess, without shadow rays.
    "visibility_estimate",
    // Output: channels that are asked for.
    "aov_albedo",
    "aov_normal",
    "aov_position",
    "aov_shadow",
];

/// Numbers that host and kernels share: kernels import them from `package::lib::constants`, a module that is made
/// of this list.
pub const CONSTANTS: &[(&str, u32)] = &[
    ("REACH_CELLS", crate::passes::grid::REACH_CELLS),
    ("INVALID_POINT", crate::passes::INVALID_POINT),
    ("SURFACE_FLAT", crate::gpu_scene::surfaces::FLAT),
    ("MATERIAL_RECORDS", crate::gpu_scene::surfaces::MATERIAL_RECORDS),
    ("MATERIAL_DOUBLE_SIDED", crate::gpu_scene::surfaces::DOUBLE_SIDED),
    ("MATERIAL_UNLIT", crate::gpu_scene::surfaces::UNLIT),
    ("MATERIAL_MASK", crate::gpu_scene::surfaces::MASK),
    ("MATERIAL_BLEND", crate::gpu_scene::surfaces::BLEND),
    ("SHEEN_COLUMNS", crate::gpu_scene::sheen::COLUMNS),
    ("SHEEN_ROWS", crate::gpu_scene::sheen::ROWS),
    ("SLOT_RECORDS", crate::gpu_scene::textures::SLOT_RECORDS),
    ("SLOT_NEAREST", crate::gpu_scene::textures::NEAREST),
    ("SLOT_SRGB", crate::gpu_scene::textures::SRGB),
    ("SLOT_UV1", crate::gpu_scene::textures::UV1),
    ("LAYER_TEXELS_LOG2", 2 * super::buffer::TABLE_WIDTH.trailing_zeros()),
    ("TABLE_WIDTH_LOG2", super::buffer::TABLE_WIDTH.trailing_zeros()),
    // What a hashed seed is for, so that no two choices share their random numbers. Consecutive numbers are added to
    // some of these: they are far apart.
    ("DIMENSION_CAMERA", 0x1000_0000),
    ("DIMENSION_ALPHA", 0x2000_0000),
    ("DIMENSION_LIGHT", 0x3000_0000),
    ("DIMENSION_AUDIT", 0x4000_0000),
    ("DIMENSION_SHADOW_ALPHA", 0x5000_0000),
    ("DIMENSION_PHOTON", 0x7000_0000),
    ("TRIANGLE_DOUBLE_SIDED", crate::gpu_scene::TRIANGLE_DOUBLE_SIDED),
    ("MAX_SHADOW_PHOTONS", crate::settings::Settings::MAX_SHADOW_PHOTONS),
    ("DIMENSION_PATH", 0x9000_0000),
    ("DIMENSION_FLUX", 0xa000_0000),
    ("DIMENSION_GATHER", 0xb000_0000),
    ("DIMENSION_CHAIN", 0xc000_0000),
    ("DIMENSION_CELL", 0xd000_0000),
    ("DIMENSION_LIGHT_SAMPLING", 0xe000_0000),
    ("MAX_LIGHTS", crate::passes::grid::MAX_LIGHTS),
    ("ZONE_LIGHTS", crate::passes::zones::ZONE_LIGHTS),
    ("MAX_GROUPS", super::frame::MAX_GROUPS),
    ("LEAST_RADIUS_PIXELS", crate::passes::gather::LEAST_RADIUS_PIXELS),
    ("PATH_GROUP", crate::passes::path::GROUP),
    ("PROCEDURAL", crate::procedural::PROCEDURAL),
    ("PROCEDURAL_RECORDS", crate::procedural::TEXELS),
    ("PROCEDURAL_TURNS", crate::procedural::ITERATIONS),
    ("PROCEDURAL_RAY_TURNS", crate::procedural::RAY_ITERATIONS),
    ("COUNTER_SHADOW_RAYS", Counter::ShadowRays as u32),
    ("COUNTER_AUDIT_RAYS", Counter::AuditRays as u32),
    ("COUNTER_BOUNCE_RAYS", Counter::BounceRays as u32),
    ("COUNTER_GATHER_RAYS", Counter::GatherRays as u32),
    ("COUNTER_AUDITED", Counter::Audited as u32),
    ("COUNTER_AUDITS_WRONG", Counter::AuditsWrong as u32),
    ("COUNTER_AUDITS_WRONG_NEAR", Counter::AuditsWrongNear as u32),
    ("COUNTER_NEAR", Counter::Near as u32),
    ("COUNTER_NEAR_AUDITED", Counter::NearAudited as u32),
    ("COUNTER_PENUMBRA_SEEN", Counter::PenumbraSeen as u32),
    ("COUNTER_NOT_FINITE", Counter::NotFinite as u32),
    ("COUNTER_OVERRUN", Counter::Overrun as u32),
    ("COUNTER_NEAR_OVERFLOW", Counter::NearOverflow as u32),
    ("COUNTER_HEAVY_PATHS", Counter::HeavyPaths as u32),
    ("COUNTER_NOT_FINITE_IRRADIANCE", Counter::NotFiniteIrradiance as u32),
    ("COUNTER_NOT_FINITE_GATHER", Counter::NotFiniteGather as u32),
    ("COUNTER_NOT_FINITE_PRIMARY", Counter::NotFinitePrimary as u32),
    ("COUNTER_NOT_FINITE_SHADE", Counter::NotFiniteShade as u32),
    ("COUNTER_NOT_FINITE_PATH", Counter::NotFinitePath as u32),
    // The counts by class: the class is added to the first one.
    ("COUNTER_DARK", Counter::Dark as u32),
    ("LIGHT_MESH", crate::gpu_scene::lights::MESH),
    ("LIGHT_POINT", crate::gpu_scene::lights::POINT),
    ("LIGHT_SPOT", crate::gpu_scene::lights::SPOT),
    ("LIGHT_DIRECTIONAL", crate::gpu_scene::lights::DIRECTIONAL),
    ("LIGHT_ENVIRONMENT", crate::gpu_scene::lights::ENVIRONMENT),
    ("LIGHT_KIND_MASK", crate::gpu_scene::lights::KIND_MASK),
    ("LIGHT_TWO_SIDED", crate::gpu_scene::lights::TWO_SIDED),
    ("LIGHT_CLOSED_FORM", crate::gpu_scene::lights::CLOSED_FORM),
    ("LIGHT_COVERAGE", crate::gpu_scene::lights::COVERAGE),
    ("LIGHT_NO_AXIS", crate::gpu_scene::lights::NO_AXIS),
    ("LIGHT_VIEWED", crate::gpu_scene::lights::VIEWED),
    ("VIEW_SIDE", crate::gpu_scene::lights::VIEW_SIDE),
    ("NEAR_LIGHT_SQUARED", (crate::gpu_scene::lights::NEAR_LIGHT * crate::gpu_scene::lights::NEAR_LIGHT) as u32),
    ("FEW_EMITTERS", crate::gpu_scene::lights::FEW_EMITTERS),
    ("FEW_NEAR_EMITTERS", crate::gpu_scene::lights::FEW_NEAR_EMITTERS),
    ("LIGHT_HEADER", crate::gpu_scene::lights::HEADER),
    ("LIGHT_RECORDS", crate::gpu_scene::lights::RECORDS),
    ("EMITTER_RECORDS", crate::gpu_scene::lights::EMITTER_RECORDS),
    ("ENVIRONMENT_HEADER", crate::gpu_scene::environment::HEADER),
];

/// The features that a kernel is composed with: a subset of [`FEATURES`], and the functions of procedural objects.
#[derive(Clone, Debug, Default, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Features {
    names: BTreeSet<&'static str>,
    functions: Functions,
}

impl Features {
    /// All of [`FEATURES`].
    pub fn all() -> Self {
        Features { names: FEATURES.iter().copied().collect(), functions: Functions::default() }
    }

    /// With `name` in or out.
    ///
    /// # Panics
    /// If `name` is not one of [`FEATURES`]: a defect of the caller.
    pub fn with(mut self, name: &'static str, on: bool) -> Self {
        assert!(FEATURES.contains(&name), "'{name}' is no feature of the kernels");
        if on {
            self.names.insert(name);
        } else {
            self.names.remove(name);
        }
        self
    }

    /// With the functions that the feature `procedurals` is for.
    pub fn with_functions(self, functions: Functions) -> Self {
        Features { functions, ..self }
    }

    /// Whether `name` is in.
    pub fn has(&self, name: &str) -> bool {
        self.names.contains(name)
    }

    /// The names, sorted.
    pub fn names(&self) -> impl Iterator<Item = &'static str> + '_ {
        self.names.iter().copied()
    }
}

impl Composed {
    /// Those of `constants` that are `override`s of this kernel.
    pub fn overrides<'c>(&self, constants: &[(&'c str, f64)]) -> Vec<(&'c str, f64)> {
        let has = |name: &str| self.module.overrides.iter().any(|(_, o)| o.name.as_deref() == Some(name));
        constants.iter().copied().filter(|(name, _)| has(name)).collect()
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

/// A diagnostic on one line, without the terminal's colours.
fn one_line(text: &str) -> String {
    let mut plain = String::new();
    let mut in_escape = false;
    for c in text.chars() {
        match c {
            '\u{1b}' => in_escape = true,
            'm' if in_escape => in_escape = false,
            _ if in_escape => {}
            _ => plain.push(c),
        }
    }
    plain.split_whitespace().collect::<Vec<_>>().join(" ")
}

/// Composes a kernel from its source; it imports the shipped modules as `package::lib::<module>`.
///
/// # Errors
/// As [`compose`].
pub fn compose_source(kernel: &str, source: &str, features: &Features) -> Result<Composed> {
    let mut resolver = wesl::VirtualResolver::new();
    let path = |path: &str| format!("package::{}", path.replace('/', "::")).parse::<wesl::ModulePath>();
    let broken = |e: &dyn std::fmt::Display| Error::kernel(kernel, one_line(&e.to_string()));
    for (name, text) in SHADERS.iter().filter(|(name, _)| name.starts_with("lib/")) {
        resolver.add_module(path(name).map_err(|e| broken(&e))?, Cow::Borrowed(text));
    }
    let constants: String = CONSTANTS.iter().map(|(name, value)| format!("const {name}: u32 = {value}u;\n")).collect();
    resolver.add_module(path("lib/constants").map_err(|e| broken(&e))?, Cow::Owned(constants));
    let functions = Cow::Borrowed(&*features.functions.wesl);
    resolver.add_module(path("lib/procedural_functions").map_err(|e| broken(&e))?, functions);
    let root = path(kernel).map_err(|e| broken(&e))?;
    resolver.add_module(root.clone(), Cow::Borrowed(source));
    // naga validates what comes out.
    let mut options = wesl::CompileOptions { validate: false, ..Default::default() };
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
