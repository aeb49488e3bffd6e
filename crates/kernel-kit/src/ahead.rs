//! Compiling ahead of the first dispatch.
//!
//! A software device translates a kernel to machine code when the kernel is first dispatched, one after the other on
//! the queue's thread. This takes seconds, unless the driver's cache on disk has the kernels. So kernels are dispatched
//! over no workgroups before anything is timed. If the cache has none of them, further devices that are opened for this
//! purpose fill it from the other cores.

use std::collections::BTreeMap;
use std::sync::atomic::Ordering::Relaxed;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use crate::adapter;
use crate::binding::{Binding, Bindings};
use crate::buffer::{MIN_BYTES, TABLE_WIDTH, table_rows};
use crate::device::{Compilation, Gpu, lock};
use crate::error::Result;
use crate::kernel::BoundKernel;
use crate::pipeline::{Entry, Interface, Undispatched, Variable};
use crate::uniforms::{First, GROUP, Uniforms};

/// A dispatch over nothing that takes longer had to translate its kernel. Taking the kernel from the cache takes 1 to 4
/// ms; translating takes 20 ms for the smallest kernels (lavapipe of Mesa 22.3).
const TRANSLATED: Duration = Duration::from_millis(15);

/// After this many kernels that were not in the cache, all others are expected not to be. A single one may only have
/// been late on a busy machine.
const SURE: usize = 2;

impl Gpu {
    /// Has the driver translate the kernels made since the last call, so that no pass has to. Does nothing but on
    /// software devices: others translate pipelines as they are made. `known` has the sampled textures, for whose
    /// format and size kernels are translated. Entry points that [`Host::late`](crate::Host::late) names are left to
    /// the next call that finds other kernels.
    ///
    /// # Errors
    /// As [`Gpu::check`].
    pub fn compile_ahead(&self, known: &(dyn Bindings + Sync)) -> Result<()> {
        let mut waiting = self.take_undispatched();
        if waiting.is_empty() {
            return Ok(());
        }
        // Small kernels show soonest whether the cache has them.
        waiting.sort_by_cached_key(|kernel| kernel.entry.interface.inlined_size(&kernel.source));
        // Otherwise the time of pending uploads would count as that of the first kernel.
        self.wait("uploads")?;
        let submit = |commands| self.submit([commands]);
        let (device, queue) = (&self.device, &self.queue);
        let mut stage = Stage { device, queue, submit: &submit, known, textures: Vec::new() };
        let mut translated = 0;
        let all = waiting.len();
        let watch = self.watch().unwrap_or_else(|| Arc::new(|_| ()));
        for (kernel, done) in waiting.iter().zip(1..) {
            let start = Instant::now();
            self.translate(&mut stage, kernel)?;
            translated += usize::from(start.elapsed() > TRANSLATED);
            if translated > 0 {
                watch(Compilation { done, all });
            }
            if translated == SURE {
                let watch_rest = |more| watch(Compilation { done: done + more, all });
                return self.translate_on_all_cores(&mut stage, &waiting[done..], &watch_rest);
            }
        }
        Ok(())
    }

    /// The kernels to translate now.
    fn take_undispatched(&self) -> Vec<Undispatched> {
        let mut waiting = self.undispatched();
        let is_late = |kernel: &Undispatched| kernel.entry.is_late.load(Relaxed);
        let (late, mut now): (Vec<_>, Vec<_>) = std::mem::take(&mut waiting.next).into_iter().partition(is_late);
        if now.is_empty() {
            waiting.late.extend(late);
            return now;
        }
        let earlier = std::mem::replace(&mut waiting.late, late);
        // Nobody else has the entry points of a kernel that was dropped.
        let is_needed = |kernel: &Undispatched| is_late(kernel) && Arc::strong_count(&kernel.entry.is_late) > 1;
        now.extend(earlier.into_iter().filter(is_needed));
        now
    }

    /// Has the driver translate a kernel that was left out, before it is dispatched for the first time: a pass that
    /// waited for it would seem to take long. An error shows at the next check.
    pub(crate) fn translate_if_late(&self, kernel: &BoundKernel) {
        if !kernel.is_late.swap(false, Relaxed) {
            return;
        }
        let mut uniforms = Uniforms::default();
        let built = (&kernel.interface, &kernel.pipeline, &kernel.groups[..]);
        let commands = dispatch_nothing(&self.device, built, &mut uniforms);
        uniforms.write(&self.queue);
        self.submit([commands]);
        let _ = self.wait(&kernel.label);
    }

    /// Has this device translate a kernel.
    fn translate(&self, stage: &mut Stage, kernel: &Undispatched) -> Result<()> {
        kernel.entry.is_late.store(false, Relaxed);
        stage.dispatch(&kernel.entry)?;
        self.wait(&kernel.entry.interface.label())
    }

    /// Translates kernels, which are sorted by size, on all cores: this device starts with the smallest, further
    /// devices with the largest, because a large kernel that starts last would keep one core busy while the others
    /// wait. This device then finds the kernels of the other devices in the driver's cache. Kernels that fail on
    /// another device fail here again, which reports the error. `watch` is called with the number of finished kernels.
    fn translate_on_all_cores(
        &self,
        stage: &mut Stage,
        kernels: &[Undispatched],
        watch: &(dyn Fn(usize) + Sync),
    ) -> Result<()> {
        let (left, done) = (Mutex::new(0..kernels.len()), Mutex::new(0));
        let count = || {
            // One after the other, so that numbers only grow.
            let mut done = lock(&done);
            *done += 1;
            watch(*done);
        };
        let known = stage.known;
        let work = || {
            let Ok((device, queue)) = adapter::request(&self.adapter, self.requested) else { return };
            device.on_uncaptured_error(Arc::new(|_| ()));
            let submit = |commands| {
                queue.submit([commands]);
            };
            let mut stage = Stage { device: &device, queue: &queue, submit: &submit, known, textures: Vec::new() };
            let largest = || lock(&left).next_back();
            while let Some(Undispatched { source, entry }) = largest().map(|index| &kernels[index]) {
                let built = entry.interface.build(&device, source, &source.shader(&device));
                let _ = stage.dispatch(&Entry { built, ..entry.clone() });
                let _ = device.poll(wgpu::PollType::wait_indefinitely());
                count();
            }
        };
        let workers = std::thread::available_parallelism().map_or(1, usize::from) - 1;
        let mut own = 0;
        std::thread::scope(|scope| {
            for _ in 0..workers.min(kernels.len()) {
                scope.spawn(work);
            }
            let smallest = || lock(&left).next();
            while let Some(index) = smallest() {
                self.translate(stage, &kernels[index]).inspect_err(|_| *lock(&left) = 0..0)?;
                count();
                own = index + 1;
            }
            Ok(())
        })?;
        kernels[own..].iter().try_for_each(|kernel| self.translate(stage, kernel))
    }
}

/// A device, and what stands in there for the textures that kernels read.
struct Stage<'a> {
    device: &'a wgpu::Device,
    queue: &'a wgpu::Queue,
    submit: &'a dyn Fn(wgpu::CommandBuffer),
    known: &'a (dyn Bindings + Sync),
    textures: Vec<(wgpu::Texture, wgpu::TextureView)>,
}

impl Stage<'_> {
    /// Dispatches an entry point over no workgroups, with something bound to its variables.
    fn dispatch(&mut self, entry: &Entry) -> Result<()> {
        let Entry { interface, built, .. } = entry;
        let variables = interface.groups.iter().flatten();
        let resources: BTreeMap<&str, Resource> =
            variables.map(|variable| (variable.name.as_str(), self.resource(variable))).collect();
        let groups = entry.groups(self.device, |name| resources.get(name).map(Resource::binding))?;
        let mut uniforms = Uniforms::default();
        let commands = dispatch_nothing(self.device, (interface, &built.pipeline, &groups), &mut uniforms);
        uniforms.write(self.queue);
        (self.submit)(commands);
        Ok(())
    }

    fn resource(&mut self, variable: &Variable) -> Resource {
        // See `alike`: the layers of a table have a power of two of rows.
        let table = |dimension: wgpu::TextureViewDimension| {
            let height = if dimension == wgpu::TextureViewDimension::D2Array { 1 } else { table_rows(0) };
            wgpu::Extent3d { width: TABLE_WIDTH, height, depth_or_array_layers: 1 }
        };
        let (format, size, kind, dimension) = match variable.layout.ty {
            wgpu::BindingType::StorageTexture { format, view_dimension, .. } => {
                (format, table(view_dimension), wgpu::TextureUsages::STORAGE_BINDING, view_dimension)
            }
            wgpu::BindingType::Texture { view_dimension, sample_type, .. } => {
                let (format, size) = match self.known.get(&variable.name) {
                    Some(Binding::Texture(view)) => (view.texture().format(), alike(view.texture())),
                    // A table that is read as a sampled texture.
                    _ if sample_type == wgpu::TextureSampleType::Uint => {
                        (wgpu::TextureFormat::Rgba32Uint, table(view_dimension))
                    }
                    _ => (wgpu::TextureFormat::Rgba32Float, table(view_dimension)),
                };
                (format, size, wgpu::TextureUsages::TEXTURE_BINDING, view_dimension)
            }
            _ => {
                return Resource::Buffer(self.device.create_buffer(&wgpu::BufferDescriptor {
                    label: None,
                    size: variable.min_bytes.max(MIN_BYTES).next_multiple_of(16),
                    usage: wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::UNIFORM,
                    mapped_at_creation: false,
                }));
            }
        };
        // wgpu clears a texture that is no copy target by drawing. Once anything has been drawn, llvmpipe takes the
        // timestamps of passes at the next drawing, so all passes would seem to take no time.
        let usage = kind | wgpu::TextureUsages::COPY_DST;
        let same = |(texture, _): &&(wgpu::Texture, _)| {
            (texture.format(), texture.size(), texture.usage()) == (format, size, usage)
        };
        if let Some((_, view)) = self.textures.iter().find(same) {
            return Resource::Texture(view.clone());
        }
        let texture = self.device.create_texture(&wgpu::TextureDescriptor {
            label: None,
            size,
            mip_level_count: 1,
            sample_count: 1,
            dimension: wgpu::TextureDimension::D2,
            format,
            usage,
            view_formats: &[],
        });
        let view =
            texture.create_view(&wgpu::TextureViewDescriptor { dimension: Some(dimension), ..Default::default() });
        self.textures.push((texture, view.clone()));
        Resource::Texture(view)
    }
}

/// Commands that dispatch a pipeline of this interface over no workgroups.
fn dispatch_nothing(
    device: &wgpu::Device,
    (interface, pipeline, groups): (&Interface, &wgpu::ComputePipeline, &[wgpu::BindGroup]),
    uniforms: &mut Uniforms,
) -> wgpu::CommandBuffer {
    let mut encoder = device.create_command_encoder(&Default::default());
    let mut pass = encoder.begin_compute_pass(&Default::default());
    pass.set_pipeline(pipeline);
    for (index, group) in (0..).zip(groups) {
        pass.set_bind_group(index, group, &[]);
    }
    if interface.takes_uniforms() {
        pass.set_bind_group(GROUP, &uniforms.bind(device, First::Group(0), &[]), &[]);
    }
    if interface.immediate_bytes > 0 && !interface.uniform_parameters {
        pass.set_immediates(0, &vec![0; interface.immediate_bytes as usize]);
    }
    pass.dispatch_workgroups(0, 0, 0);
    drop(pass);
    encoder.finish()
}

/// Something of the kind that a variable is bound to.
enum Resource {
    Buffer(wgpu::Buffer),
    Texture(wgpu::TextureView),
}

impl Resource {
    fn binding(&self) -> Binding<'_> {
        match self {
            Resource::Buffer(buffer) => Binding::Raw(buffer),
            Resource::Texture(view) => Binding::Texture(view),
        }
    }
}

/// The size of a small texture for which llvmpipe translates kernels as for `texture`: all that counts is whether its
/// sides are powers of two.
fn alike(texture: &wgpu::Texture) -> wgpu::Extent3d {
    let side = |length: u32| if length.is_power_of_two() { 1 } else { 3 };
    wgpu::Extent3d { width: side(texture.width()), height: side(texture.height()), depth_or_array_layers: 1 }
}
