//! Kernels: compiled entry points, ready to bind.

use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use wgpu::naga;

use crate::binding::{Bindings, Declared};
use crate::compose::Composed;
use crate::device::{Gpu, lock};
use crate::error::{Error, Result};
use crate::layout::{OpaqueStruct, SharedStruct, check_layouts};
use crate::pipeline::{Entries, Entry, Interface, Source, Undispatched};

/// The host's declarations for a kernel; [`Kernel::new`] compares them with the kernel's own.
///
/// `Host::default()` is for a kernel without overrides and structs, whose bindings are checked when it is bound.
#[derive(Clone, Copy, Default)]
pub struct Host<'a> {
    /// Values of the kernel's `override`s. Each must be one of the kernel's; [`Composed::overrides`] picks those from a
    /// longer list.
    pub constants: &'a [(&'a str, f64)],
    /// The structs that host and kernels share. The list may be longer than the kernel needs; all that it keeps in
    /// storage, uniform or immediate memory must be there.
    pub shared: &'a [&'a SharedStruct],
    /// The structs that only kernels read and write, with the sizes for which the host makes room.
    pub opaque: &'a [OpaqueStruct<'a>],
    /// Sets of bindings that are for this kernel: it must have a variable for each required name.
    pub own: &'a [Declared],
    /// Sets of bindings that many kernels use, each what it needs of them. With `Some` a variable that is in none of
    /// `own` and of these is an error; with `None` that is found when the kernel is bound.
    pub common: Option<&'a [Declared]>,
    /// Entry points that the first frames do not run: [`Gpu::compile_ahead`] leaves them out, until it is called for
    /// other kernels. If they are dispatched before, they are translated then.
    pub late: &'a [&'a str],
}

/// A kernel on a device: its entry points, ready to bind.
pub struct Kernel {
    /// The name that it was composed under.
    pub name: String,
    entries: Entries,
}

/// An entry point with its resources bound.
#[derive(Clone)]
pub struct BoundKernel {
    /// `<kernel>/<entry>`: names the pass in errors and times.
    pub label: String,
    pub(crate) pipeline: wgpu::ComputePipeline,
    pub(crate) groups: Vec<wgpu::BindGroup>,
    pub(crate) interface: Interface,
    /// See [`Entry`].
    pub(crate) is_late: Arc<AtomicBool>,
}

impl Kernel {
    /// Compiles every entry point of a composed kernel, after comparing it with what the host has for it.
    ///
    /// # Errors
    /// [`Error::Kernel`] for a struct that differs from its host twin, an `override` or a required binding that is not
    /// in the kernel, a variable that nothing is declared for, or a pipeline that the device refuses.
    pub fn new(gpu: &Gpu, composed: &Composed, host: &Host<'_>) -> Result<Kernel> {
        check_layouts(composed, host.shared, host.opaque)?;
        check_names(composed, host)?;
        let composed = &*gpu.adaptation.adapt(composed)?;
        let source = Source::new(composed, host.constants);
        let shader = source.shader(&gpu.device);
        let mut entries = Entries::new();
        for (index, entry) in composed.module.entry_points.iter().enumerate() {
            let interface = Interface::new(composed, index)?;
            let built = interface.build(&gpu.device, &source, &shader);
            let waits = gpu.is_software() && host.late.contains(&entry.name.as_str());
            let made = Entry { interface, built, is_late: Arc::new(AtomicBool::new(waits)) };
            // Drivers of other devices translate pipelines as they are made.
            if gpu.is_software() {
                gpu.undispatched().next.push(Undispatched { source: source.clone(), entry: made.clone() });
            }
            entries.insert(entry.name.clone(), made);
        }
        gpu.check(&composed.kernel)?;
        Ok(Kernel { name: composed.kernel.clone(), entries })
    }

    /// The kernel that `make` makes. If the device keeps kernels ([`Gpu::keep_kernels`]), it is made for the first use
    /// of `key` only, which must be different for all kernels of the device: by source, features and constants. Other
    /// threads that use the key wait until it is made.
    ///
    /// # Errors
    /// Those of `make`.
    pub fn kept<E>(
        gpu: &Gpu,
        key: &str,
        make: impl FnOnce() -> std::result::Result<Kernel, E>,
    ) -> std::result::Result<Kernel, E> {
        let Some(kept) = gpu.kept().as_mut().map(|kept| kept.entry(key.to_owned()).or_default().clone()) else {
            return make();
        };
        let mut kept = lock(&kept);
        if let Some((name, entries)) = kept.clone() {
            return Ok(Kernel { name, entries });
        }
        let kernel = make()?;
        *kept = Some((kernel.name.clone(), kernel.entries.clone()));
        Ok(kernel)
    }

    /// Binds the resources of the entry point `entry`, each variable from the first of `sets` that has it.
    ///
    /// # Errors
    /// [`Error::Kernel`] naming the entry point that there is not, or the variable that none of `sets` has.
    pub fn bind(&self, gpu: &Gpu, entry: &str, sets: &[&dyn Bindings]) -> Result<BoundKernel> {
        let point = self.entries.get(entry).ok_or_else(|| Error::kernel(&self.name, format!("no entry '{entry}'")))?;
        let Entry { interface, built, is_late } = point;
        let groups = point.groups(&gpu.device, |name| sets.iter().find_map(|set| set.get(name)))?;
        gpu.check(&interface.label())?;
        Ok(BoundKernel {
            label: interface.label(),
            pipeline: built.pipeline.clone(),
            groups,
            interface: interface.clone(),
            is_late: is_late.clone(),
        })
    }

    /// Invocations in a workgroup of `entry`, as the kernel declares it.
    pub fn workgroup_size(&self, entry: &str) -> Option<u32> {
        self.entries.get(entry).map(|e| e.interface.workgroup_size)
    }
}

/// Compares the names of overrides and bindings with those of the kernel.
fn check_names(composed: &Composed, host: &Host<'_>) -> Result<()> {
    let wrong = |problem: String| Err(Error::kernel(&composed.kernel, problem));
    if let Some((name, _)) = host.constants.iter().find(|(name, _)| !composed.has_override(name)) {
        return wrong(format!("has no override '{name}'"));
    }
    let mut required = host.own.iter().flat_map(|set| set.required);
    if let Some(name) = required.find(|name| !composed.has_variable(name)) {
        return wrong(format!("has no binding '{name}'"));
    }
    let Some(common) = host.common else { return Ok(()) };
    let declared = |name: &str| host.own.iter().chain(common).any(|set| set.has(name));
    let bound = |(_, variable): (_, &'_ naga::GlobalVariable)| {
        variable.binding.as_ref().map(|_| variable.name.clone().unwrap_or_default())
    };
    match composed.module.global_variables.iter().filter_map(bound).find(|name| !declared(name)) {
        Some(name) => wrong(format!("no set of bindings declares the variable '{name}'")),
        None => Ok(()),
    }
}
