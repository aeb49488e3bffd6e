//! Pipelines on a device, and what they take from the host.

use std::collections::{BTreeMap, HashMap};
use std::num::NonZeroU64;
use std::sync::atomic::AtomicBool;
use std::sync::{Arc, Mutex};

use wgpu::naga;

use crate::binding::Binding;
use crate::compose::Composed;
use crate::error::{Error, Result};
use crate::uniforms;

/// The source of pipelines: a composed kernel and its constants.
pub(crate) struct Source {
    module: naga::Module,
    constants: Vec<(String, f64)>,
}

impl Source {
    pub(crate) fn new(composed: &Composed, constants: &[(&str, f64)]) -> Arc<Source> {
        let constants = constants.iter().map(|(name, value)| ((*name).to_owned(), *value)).collect();
        Arc::new(Source { module: composed.module.clone(), constants })
    }

    pub(crate) fn shader(&self, device: &wgpu::Device) -> wgpu::ShaderModule {
        device.create_shader_module(wgpu::ShaderModuleDescriptor {
            label: None,
            source: wgpu::ShaderSource::Naga(std::borrow::Cow::Owned(self.module.clone())),
        })
    }
}

/// The pipeline of one of the kit's own kernels, which has one entry point and needs no composition.
pub(crate) fn own_pipeline(device: &wgpu::Device, label: &str, wgsl: &'static str) -> wgpu::ComputePipeline {
    let module = device.create_shader_module(wgpu::ShaderModuleDescriptor {
        label: Some(label),
        source: wgpu::ShaderSource::Wgsl(wgsl.into()),
    });
    device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
        label: Some(label),
        layout: None,
        module: &module,
        entry_point: None,
        compilation_options: Default::default(),
        cache: None,
    })
}

/// A variable that is bound.
#[derive(Clone)]
pub(crate) struct Variable {
    pub(crate) layout: wgpu::BindGroupLayoutEntry,
    /// Size in bytes without the elements of a run-time sized array.
    pub(crate) min_bytes: u64,
    pub(crate) name: String,
}

/// The host's inputs of an entry point.
#[derive(Clone)]
pub(crate) struct Interface {
    kernel: String,
    entry: String,
    /// The variables by group.
    pub(crate) groups: Vec<Vec<Variable>>,
    /// Bytes of its parameters.
    pub(crate) immediate_bytes: u32,
    /// It takes its parameters from the kit's uniforms, not as immediates.
    pub(crate) uniform_parameters: bool,
    /// It takes the first workgroup of a slice.
    pub(crate) sliced: bool,
    pub(crate) workgroup_size: u32,
}

/// A pipeline with the layouts of its groups.
#[derive(Clone)]
pub(crate) struct Built {
    layouts: Vec<wgpu::BindGroupLayout>,
    pub(crate) pipeline: wgpu::ComputePipeline,
}

/// An entry point on a device.
#[derive(Clone)]
pub(crate) struct Entry {
    pub(crate) interface: Interface,
    pub(crate) built: Built,
    /// It is left to its first dispatch, or to a later call of `compile_ahead`, to have it translated.
    pub(crate) is_late: Arc<AtomicBool>,
}

/// The entry points of a kernel by name.
pub(crate) type Entries = BTreeMap<String, Entry>;

/// Kernels that are kept, by key.
pub(crate) type Kept = HashMap<String, Arc<Mutex<KeptKernel>>>;

/// Name and entry points of a kernel; `None` while the thread that holds the lock makes it.
pub(crate) type KeptKernel = Option<(String, Entries)>;

/// Entry points that have not been dispatched.
#[derive(Default)]
pub(crate) struct Waiting {
    /// Those that the next call of `compile_ahead` translates, unless they are late.
    pub(crate) next: Vec<Undispatched>,
    /// Those that calls so far have left out.
    pub(crate) late: Vec<Undispatched>,
}

/// An entry point that has not been dispatched.
pub(crate) struct Undispatched {
    pub(crate) source: Arc<Source>,
    pub(crate) entry: Entry,
}

impl Entry {
    /// Bind groups of what `resource` has for each variable.
    ///
    /// # Errors
    /// [`Error::Kernel`] naming the variable that it has nothing for.
    pub(crate) fn groups<'r>(
        &self,
        device: &wgpu::Device,
        resource: impl Fn(&str) -> Option<Binding<'r>>,
    ) -> Result<Vec<wgpu::BindGroup>> {
        let label = self.interface.label();
        let missing = |name: &str| Error::kernel(&label, format!("nothing is bound to the variable '{name}'"));
        let group = |(layout, variables): (&wgpu::BindGroupLayout, &Vec<Variable>)| {
            let entry = |variable: &Variable| {
                let resource = match resource(&variable.name).ok_or_else(|| missing(&variable.name))? {
                    Binding::Buffer(buffer) => wgpu::BindingResource::Buffer(wgpu::BufferBinding {
                        buffer: &buffer.raw,
                        offset: buffer.first_byte,
                        size: NonZeroU64::new(buffer.bytes),
                    }),
                    Binding::Raw(buffer) => buffer.as_entire_binding(),
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

impl Interface {
    pub(crate) fn new(composed: &Composed, index: usize) -> Result<Interface> {
        let module = &composed.module;
        let uses = composed.info.get_entry_point(index);
        let mut groups: Vec<Vec<Variable>> = Vec::new();
        let (mut immediate_bytes, mut uniform_parameters, mut sliced) = (0, false, false);
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
            if binding.group == uniforms::GROUP {
                if binding.binding == uniforms::PARAMETER_BINDING {
                    (immediate_bytes, uniform_parameters) = (bytes, true);
                } else {
                    sliced = true;
                }
                continue;
            }
            let ty = binding_type(module, variable).ok_or_else(|| {
                Error::kernel(&composed.kernel, format!("binding '{name}' is of a kind that the kit does not bind"))
            })?;
            let layout = wgpu::BindGroupLayoutEntry {
                binding: binding.binding,
                visibility: wgpu::ShaderStages::COMPUTE,
                ty,
                count: None,
            };
            let group = binding.group as usize;
            groups.resize_with(groups.len().max(group + 1), Vec::new);
            groups[group].push(Variable { layout, min_bytes: u64::from(bytes), name });
        }
        let entry = &module.entry_points[index];
        let workgroup_size = entry.workgroup_size.iter().product();
        let (kernel, entry) = (composed.kernel.clone(), entry.name.clone());
        Ok(Interface { kernel, entry, groups, immediate_bytes, uniform_parameters, sliced, workgroup_size })
    }

    /// `<kernel>/<entry>`.
    pub(crate) fn label(&self) -> String {
        format!("{}/{}", self.kernel, self.entry)
    }

    /// Whether it takes the kit's group of uniforms.
    pub(crate) fn takes_uniforms(&self) -> bool {
        self.uniform_parameters || self.sliced
    }

    /// Number of expressions of the entry point, where those of a function count as often as it is called. Drivers
    /// inline functions, and their time is about proportional to the size of the result.
    pub(crate) fn inlined_size(&self, source: &Source) -> usize {
        let entry = source.module.entry_points.iter().find(|entry| entry.name == self.entry);
        entry.map_or(0, |entry| size_with_calls(&entry.function, &function_sizes(&source.module)))
    }

    pub(crate) fn build(&self, device: &wgpu::Device, source: &Source, shader: &wgpu::ShaderModule) -> Built {
        let label = self.label();
        let layout = |variables: &Vec<Variable>| {
            let entries: Vec<_> = variables.iter().map(|variable| variable.layout).collect();
            device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor { label: Some(&label), entries: &entries })
        };
        let layouts: Vec<_> = self.groups.iter().map(layout).collect();
        let uniforms = self.takes_uniforms().then(|| uniforms::layout(device));
        let mut groups: Vec<_> = layouts.iter().map(Some).collect();
        if let Some(uniforms) = &uniforms {
            groups.resize(uniforms::GROUP as usize, None);
            groups.push(Some(uniforms));
        }
        let layout = device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
            label: Some(&label),
            bind_group_layouts: &groups,
            immediate_size: if self.uniform_parameters { 0 } else { self.immediate_bytes },
        });
        let constants: Vec<_> = source.constants.iter().map(|(name, value)| (name.as_str(), *value)).collect();
        let pipeline = device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
            label: Some(&label),
            layout: Some(&layout),
            module: shader,
            entry_point: Some(&self.entry),
            compilation_options: wgpu::PipelineCompilationOptions {
                constants: &constants,
                // Kernels write their shared memory before they read it, so clearing it first would be wasted work.
                zero_initialize_workgroup_memory: false,
            },
            cache: None,
        });
        Built { layouts, pipeline }
    }
}

/// The sizes of a module's functions, with all that they call.
fn function_sizes(module: &naga::Module) -> Vec<usize> {
    // Functions come after those that they call.
    let mut sizes = Vec::with_capacity(module.functions.len());
    for (_, function) in module.functions.iter() {
        sizes.push(size_with_calls(function, &sizes));
    }
    sizes
}

/// Expressions of a function, and the `sizes` of those that it calls.
fn size_with_calls(function: &naga::Function, sizes: &[usize]) -> usize {
    function.expressions.len() + called(&function.body, sizes)
}

/// The sizes of the functions that a block calls.
fn called(block: &naga::Block, sizes: &[usize]) -> usize {
    let of = |statement: &naga::Statement| match statement {
        naga::Statement::Call { function, .. } => sizes.get(function.index()).copied().unwrap_or(0),
        naga::Statement::Block(block) => called(block, sizes),
        naga::Statement::If { accept, reject, .. } => called(accept, sizes) + called(reject, sizes),
        naga::Statement::Loop { body, continuing, .. } => called(body, sizes) + called(continuing, sizes),
        naga::Statement::Switch { cases, .. } => cases.iter().map(|case| called(&case.body, sizes)).sum(),
        _ => 0,
    };
    block.iter().map(of).sum()
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

#[cfg(test)]
mod tests {
    use super::*;

    /// A function counts for each of its calls, in whatever block, and so does what it calls.
    #[test]
    fn calls_count_as_often_as_they_are_made() {
        let text = "
            fn leaf(x: f32) -> f32 { return x + 1.0; }
            fn twice(x: f32) -> f32 { return leaf(leaf(x)); }
            fn everywhere(x: f32) -> f32 {
                var y = leaf(x);
                if x > 0.0 { y += leaf(y); } else { y += leaf(x); }
                for (var i = 0; i < 3; i++) { y += twice(y); }
                switch i32(x) { case 1: { y += leaf(y); } default: { y += leaf(x); } }
                return y;
            }";
        let module = naga::front::wgsl::parse_str(text).unwrap();
        let own: Vec<usize> = module.functions.iter().map(|(_, function)| function.expressions.len()).collect();
        let leaf = own[0];
        assert_eq!(function_sizes(&module), [leaf, own[1] + 2 * leaf, own[2] + 5 * leaf + own[1] + 2 * leaf]);
    }
}
