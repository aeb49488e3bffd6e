//! Kernels: pipelines whose bindings are found by WGSL variable name.

use std::collections::BTreeMap;
use std::sync::Arc;

use wgpu::naga;

use crate::{Error, Result};

use super::buffer::{Buffer, Table};
use super::compose::Composed;
use super::{Gpu, layout};

/// What is bound to a WGSL variable.
#[derive(Clone, Copy)]
pub enum Binding<'a> {
    /// A buffer.
    Buffer(&'a wgpu::Buffer),
    /// A texture.
    Texture(&'a wgpu::TextureView),
}

impl<'a> From<&'a Buffer> for Binding<'a> {
    fn from(buffer: &'a Buffer) -> Self {
        Binding::Buffer(&buffer.raw)
    }
}

impl<'a> From<&'a Table> for Binding<'a> {
    fn from(table: &'a Table) -> Self {
        match table {
            Table::Texture(view) => Binding::Texture(view),
            Table::Buffer(buffer) => buffer.into(),
        }
    }
}

impl<'a> From<&'a wgpu::TextureView> for Binding<'a> {
    fn from(view: &'a wgpu::TextureView) -> Self {
        Binding::Texture(view)
    }
}

/// Resources by the names of the WGSL variables they are for.
pub trait Bindings {
    /// What is bound to the variable `name`, if this set has it.
    fn get(&self, name: &str) -> Option<Binding<'_>>;
}

/// A set of resources put together at run time: tests, and the scene's tables that many kernels read.
#[derive(Default)]
pub struct Resources<'a>(BTreeMap<&'static str, Binding<'a>>);

impl<'a> Resources<'a> {
    /// An empty set.
    pub fn new() -> Self {
        Self::default()
    }

    /// With `resource` bound to the variable `name`.
    pub fn with(mut self, name: &'static str, resource: impl Into<Binding<'a>>) -> Self {
        self.0.insert(name, resource.into());
        self
    }
}

impl Bindings for Resources<'_> {
    fn get(&self, name: &str) -> Option<Binding<'_>> {
        self.0.get(name).copied()
    }
}

impl<const N: usize> Bindings for [&dyn Bindings; N] {
    fn get(&self, name: &str) -> Option<Binding<'_>> {
        self.iter().find_map(|set| set.get(name))
    }
}

/// Declares the bindings of a pass: a struct whose fields are the WGSL variable names.
#[macro_export]
macro_rules! bindings {
    ($(#[$meta:meta])* $vis:vis struct $name:ident { $($(#[$field_meta:meta])* $field:ident),* $(,)? }) => {
        $(#[$meta])*
        $vis struct $name<'a> { $($(#[$field_meta])* pub $field: &'a $crate::gpu::Buffer),* }

        impl $name<'_> {
            /// The names of the variables.
            pub const NAMES: &'static [&'static str] = &[$(stringify!($field)),*];
        }

        impl $crate::gpu::Bindings for $name<'_> {
            fn get(&self, name: &str) -> Option<$crate::gpu::Binding<'_>> {
                $(if name == stringify!($field) { return Some(self.$field.into()); })*
                None
            }
        }
    };
}

/// A kernel on a device: its entry points, ready to bind.
pub struct Kernel {
    /// Stem of the kernel's file.
    pub name: String,
    entries: BTreeMap<String, Entry>,
}

/// An entry point on a device.
#[derive(Clone)]
pub(super) struct Entry {
    pub(super) interface: Interface,
    pub(super) built: Built,
}

impl Entry {
    /// Bind groups of what `resource` has for each variable.
    ///
    /// # Errors
    /// [`Error::Kernel`] naming the variable that it has nothing for.
    pub(super) fn groups<'r>(
        &self,
        device: &wgpu::Device,
        resource: impl Fn(&str) -> Option<Binding<'r>>,
    ) -> Result<Vec<wgpu::BindGroup>> {
        let label = self.interface.label();
        let missing = |name: &str| Error::kernel(&label, format!("nothing is bound to the variable '{name}'"));
        let group = |(layout, variables): (&wgpu::BindGroupLayout, &Vec<Variable>)| {
            let entry = |variable: &Variable| {
                let resource = match resource(&variable.name).ok_or_else(|| missing(&variable.name))? {
                    Binding::Buffer(buffer) => buffer.as_entire_binding(),
                    Binding::Texture(view) => wgpu::BindingResource::TextureView(view),
                };
                Ok(wgpu::BindGroupEntry { binding: variable.layout.binding, resource })
            };
            let entries = variables.iter().map(entry).collect::<Result<Vec<_>>>()?;
            let label = Some(label.as_str());
            Ok(device.create_bind_group(&wgpu::BindGroupDescriptor { label, layout, entries: &entries }))
        };
        self.built.layouts.iter().zip(&self.interface.groups).map(group).collect()
    }
}

/// An entry point with its resources bound.
#[derive(Clone)]
pub struct BoundKernel {
    /// `<kernel>/<entry>`.
    pub label: String,
    pub(super) pipeline: wgpu::ComputePipeline,
    pub(super) groups: Vec<wgpu::BindGroup>,
    pub(super) workgroup_size: u32,
    pub(super) immediate_bytes: u32,
}

impl Kernel {
    /// Compiles every entry point of a composed kernel. `constants` sets the kernel's `override`s; each must be
    /// one of them. `own` are the names of the pass's own bindings ([`bindings!`]): all of them must be there.
    ///
    /// # Errors
    /// [`Error::Kernel`] for a struct that differs from its host twin, an `override` or binding that is not in the
    /// kernel, or a pipeline that the device refuses.
    pub fn new(gpu: &Gpu, composed: &Composed, constants: &[(&str, f64)], own: &[&str]) -> Result<Kernel> {
        let kernel = composed.kernel.as_str();
        let module = &composed.module;
        layout::check(composed)?;
        for (name, _) in constants {
            if !module.overrides.iter().any(|(_, o)| o.name.as_deref() == Some(name)) {
                return Err(Error::kernel(kernel, format!("has no override '{name}'")));
            }
        }
        for name in own {
            if !module.global_variables.iter().any(|(_, v)| v.name.as_deref() == Some(name)) {
                return Err(Error::kernel(kernel, format!("has no binding '{name}'")));
            }
        }
        let source = Source::new(composed, constants);
        let shader = source.shader(&gpu.device);
        let mut entries = BTreeMap::new();
        for (index, entry) in module.entry_points.iter().enumerate() {
            let interface = Interface::new(composed, index)?;
            let built = interface.build(&gpu.device, &source, &shader);
            let made = Entry { interface, built };
            gpu.compile_later(&source, &made);
            entries.insert(entry.name.clone(), made);
        }
        gpu.check(kernel)?;
        Ok(Kernel { name: kernel.to_owned(), entries })
    }

    /// Binds the resources of the entry point `entry`, each variable from the first of `sets` that has it.
    ///
    /// # Errors
    /// [`Error::Kernel`] naming the variable that none of `sets` has.
    pub fn bind(&self, gpu: &Gpu, entry: &str, sets: &[&dyn Bindings]) -> Result<BoundKernel> {
        let point = self.entries.get(entry).ok_or_else(|| Error::kernel(&self.name, format!("no entry '{entry}'")))?;
        let Entry { interface, built } = point;
        let groups = point.groups(&gpu.device, |name| sets.iter().find_map(|set| set.get(name)))?;
        gpu.check(&interface.label())?;
        Ok(BoundKernel {
            label: interface.label(),
            pipeline: built.pipeline.clone(),
            groups,
            workgroup_size: interface.workgroup_size,
            immediate_bytes: interface.immediate_bytes,
        })
    }

    /// Invocations in a workgroup of `entry`, as the kernel declares it.
    pub fn workgroup_size(&self, entry: &str) -> Option<u32> {
        self.entries.get(entry).map(|e| e.interface.workgroup_size)
    }
}

/// What pipelines are made of: a composed kernel and its constants.
pub(super) struct Source {
    module: naga::Module,
    constants: Vec<(String, f64)>,
}

impl Source {
    fn new(composed: &Composed, constants: &[(&str, f64)]) -> Arc<Source> {
        let constants = constants.iter().map(|(name, value)| ((*name).to_owned(), *value)).collect();
        Arc::new(Source { module: composed.module.clone(), constants })
    }

    pub(super) fn shader(&self, device: &wgpu::Device) -> wgpu::ShaderModule {
        device.create_shader_module(wgpu::ShaderModuleDescriptor {
            label: None,
            source: wgpu::ShaderSource::Naga(std::borrow::Cow::Owned(self.module.clone())),
        })
    }
}

/// A variable that is bound.
#[derive(Clone)]
pub(super) struct Variable {
    pub(super) layout: wgpu::BindGroupLayoutEntry,
    /// Bytes that it has at least.
    pub(super) least_bytes: u64,
    pub(super) name: String,
}

/// What an entry point asks of the host.
#[derive(Clone)]
pub(super) struct Interface {
    pub(super) kernel: String,
    entry: String,
    /// The variables by group.
    pub(super) groups: Vec<Vec<Variable>>,
    pub(super) immediate_bytes: u32,
    workgroup_size: u32,
}

/// A pipeline with the layouts of its groups.
#[derive(Clone)]
pub(super) struct Built {
    pub(super) layouts: Vec<wgpu::BindGroupLayout>,
    pub(super) pipeline: wgpu::ComputePipeline,
}

impl Interface {
    fn new(composed: &Composed, index: usize) -> Result<Interface> {
        let module = &composed.module;
        let uses = composed.info.get_entry_point(index);
        let mut groups: Vec<Vec<Variable>> = Vec::new();
        let mut immediate_bytes = 0;
        for (handle, variable) in module.global_variables.iter() {
            if uses[handle].is_empty() {
                continue;
            }
            let name = variable.name.clone().unwrap_or_default();
            let bytes = module.types[variable.ty].inner.size(module.to_ctx());
            if variable.space == naga::AddressSpace::Immediate {
                immediate_bytes = bytes;
            }
            let Some(binding) = &variable.binding else { continue };
            let ty = binding_type(module, variable).ok_or_else(|| {
                Error::kernel(&composed.kernel, format!("binding '{name}' is of a kind that kernels do not use"))
            })?;
            let layout = wgpu::BindGroupLayoutEntry {
                binding: binding.binding,
                visibility: wgpu::ShaderStages::COMPUTE,
                ty,
                count: None,
            };
            let group = binding.group as usize;
            groups.resize_with(groups.len().max(group + 1), Vec::new);
            groups[group].push(Variable { layout, least_bytes: u64::from(bytes), name });
        }
        let entry = &module.entry_points[index];
        let workgroup_size = entry.workgroup_size.iter().product();
        let (kernel, entry) = (composed.kernel.clone(), entry.name.clone());
        Ok(Interface { kernel, entry, groups, immediate_bytes, workgroup_size })
    }

    pub(super) fn label(&self) -> String {
        format!("{}/{}", self.kernel, self.entry)
    }

    pub(super) fn build(&self, device: &wgpu::Device, source: &Source, shader: &wgpu::ShaderModule) -> Built {
        let label = self.label();
        let layout = |variables: &Vec<Variable>| {
            let entries: Vec<_> = variables.iter().map(|variable| variable.layout).collect();
            device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor { label: Some(&label), entries: &entries })
        };
        let layouts: Vec<_> = self.groups.iter().map(layout).collect();
        let layout = device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
            label: Some(&label),
            bind_group_layouts: &layouts.iter().map(Some).collect::<Vec<_>>(),
            immediate_size: self.immediate_bytes,
        });
        let constants: Vec<_> = source.constants.iter().map(|(name, value)| (name.as_str(), *value)).collect();
        let pipeline = device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
            label: Some(&label),
            layout: Some(&layout),
            module: shader,
            entry_point: Some(&self.entry),
            compilation_options: wgpu::PipelineCompilationOptions {
                constants: &constants,
                // Kernels write their shared memory before they read it; clearing it first is work for nothing.
                zero_initialize_workgroup_memory: false,
            },
            cache: None,
        });
        Built { layouts, pipeline }
    }
}

fn binding_type(module: &naga::Module, variable: &naga::GlobalVariable) -> Option<wgpu::BindingType> {
    let buffer = |ty| wgpu::BindingType::Buffer { ty, has_dynamic_offset: false, min_binding_size: None };
    match (variable.space, &module.types[variable.ty].inner) {
        (naga::AddressSpace::Storage { access }, _) => {
            let read_only = !access.contains(naga::StorageAccess::STORE);
            Some(buffer(wgpu::BufferBindingType::Storage { read_only }))
        }
        (naga::AddressSpace::Uniform, _) => Some(buffer(wgpu::BufferBindingType::Uniform)),
        (naga::AddressSpace::Handle, naga::TypeInner::Image { dim, arrayed, class }) => {
            let view_dimension = match (dim, arrayed) {
                (naga::ImageDimension::D2, false) => wgpu::TextureViewDimension::D2,
                (naga::ImageDimension::D2, true) => wgpu::TextureViewDimension::D2Array,
                _ => return None,
            };
            if let naga::ImageClass::Storage { format, access } = class {
                let format = match format {
                    naga::StorageFormat::Rgba32Float => wgpu::TextureFormat::Rgba32Float,
                    naga::StorageFormat::Rgba32Uint => wgpu::TextureFormat::Rgba32Uint,
                    _ => return None,
                };
                let read_only = *access == naga::StorageAccess::LOAD;
                let access = wgpu::StorageTextureAccess::ReadOnly;
                return read_only.then_some(wgpu::BindingType::StorageTexture { access, format, view_dimension });
            }
            let sample_type = match class {
                // Kernels filter by hand: tables are rgba32float, which no device need filter.
                naga::ImageClass::Sampled { kind: naga::ScalarKind::Float, .. } => {
                    wgpu::TextureSampleType::Float { filterable: false }
                }
                naga::ImageClass::Sampled { kind: naga::ScalarKind::Uint, .. } => wgpu::TextureSampleType::Uint,
                _ => return None,
            };
            Some(wgpu::BindingType::Texture { sample_type, view_dimension, multisampled: false })
        }
        _ => None,
    }
}
