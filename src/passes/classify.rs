//! Pass `classify`: the class of every point for every light, and the queues of those that need shadow rays.

use crate::gpu::{Bindings, BoundKernel, Buffer, Features, Frame, Gpu, Kernel, compose};
use crate::{Error, Result, bindings, shared_struct};

use super::grid::{GridShape, JudgeAsked, MAX_NEAREST, PhotonGrid};
use super::{Tile, TileBuffers};

/// What the photons say of a point and a light.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum Class {
    /// The whole light is behind the surface's plane, or emits away from it.
    Dark = 0,
    /// The nearest k photons are illumination photons.
    Lit = 1,
    /// The nearest k photons are shadow photons.
    Shadowed = 2,
    /// There are both among the nearest k.
    Boundary = 3,
    /// Fewer than k photons within the largest search radius, or too many to look at.
    Unknown = 4,
}

/// A class word, taken apart.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Classified {
    /// The class.
    pub class: Class,
    /// Illumination photons among the nearest k.
    pub n_i: u32,
    /// Shadow photons among the nearest k.
    pub n_s: u32,
    /// n_i over the hits that all k stand for, in steps of 1/2047.
    pub visibility: f32,
}

impl Classified {
    /// Takes a class word apart.
    pub fn new(word: u32) -> Classified {
        let class = match word & 7 {
            0 => Class::Dark,
            1 => Class::Lit,
            2 => Class::Shadowed,
            3 => Class::Boundary,
            _ => Class::Unknown,
        };
        Classified { class, n_i: (word >> 3) & 511, n_s: (word >> 12) & 511, visibility: (word >> 21) as f32 / 2047.0 }
    }
}

/// Lights that are worked on together, and what is decided about them.
#[derive(Clone, Copy, Debug)]
pub struct Chunk {
    /// First light of the chunk.
    pub first_light: u32,
    /// Lights of the chunk.
    pub lights: u32,
    /// Pixels by which boundaries are widened, 0 or 1.
    pub dilate: u32,
    /// Probability with which a lit or shadowed point is audited.
    pub audit_probability: f32,
}

shared_struct! {
    /// Parameters of the classification's kernels.
    pub struct ClassifyParameters {
        grid: GridShape,
        tile: Tile,
        slot_count: u32,
        first_light: u32,
        dilate_radius: u32,
        audit_probability: f32,
        queue: u32,
        queue_group: u32,
        padding: [u32; 2],
    }
}

bindings! {
    /// What the kernels read and write.
    struct ClassifyBindings {
        points, classes, query_queue, queue_lengths, queue_arguments, dilated_classes, boundary_queue, audit_queue,
        counters,
    }
}

/// A queue of a tile's sample.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum Queue {
    /// Slots that no verdict settles; the pass itself consumes it.
    Query = 0,
    /// Boundary and unknown points.
    Boundary = 1,
    /// Lit and shadowed points that are audited.
    Audit = 2,
    /// Points, not slots, that light points are for; pass `shade` fills it and consumes it.
    Sampled = 3,
}

impl Queue {
    /// Byte offset of the queue's indirect arguments in [`ClassifyBuffers::queue_arguments`].
    pub fn arguments_offset(self) -> u64 {
        self as u64 * 16
    }
}

/// The buffers of the pass, for up to so many slots: (light of the chunk, point) pairs, light by light.
pub struct ClassifyBuffers {
    /// Class words as the photons have them.
    pub classes: Buffer,
    /// Class words after dilation.
    pub dilated_classes: Buffer,
    /// Slots of boundary and unknown points.
    pub boundary_queue: Buffer,
    /// Slots that are audited.
    pub audit_queue: Buffer,
    /// Lengths of the queues by [`Queue`], of this sample.
    pub queue_lengths: Buffer,
    /// Indirect arguments by [`Queue::arguments_offset`].
    pub queue_arguments: Buffer,
    query_queue: Buffer,
}

impl ClassifyBuffers {
    /// Buffers for `slots` slots.
    ///
    /// # Errors
    /// As [`Gpu::buffer`].
    pub fn new(gpu: &Gpu, slots: u32) -> Result<ClassifyBuffers> {
        let words = |label: &str| gpu.buffer::<u32>(label, slots as usize);
        Ok(ClassifyBuffers {
            classes: words("penumbra/classify/classes")?,
            dilated_classes: words("penumbra/classify/dilated_classes")?,
            boundary_queue: words("penumbra/classify/boundary_queue")?,
            audit_queue: words("penumbra/classify/audit_queue")?,
            queue_lengths: gpu.buffer::<u32>("penumbra/classify/queue_lengths", 4)?,
            queue_arguments: gpu.buffer::<u32>("penumbra/classify/queue_arguments", 16)?,
            query_queue: words("penumbra/classify/query_queue")?,
        })
    }
}

/// The pass; see `shaders/classify.wgsl`.
pub struct Classify {
    kernel: Kernel,
    /// There is a visibility map to ask.
    map: bool,
}

/// The pass with its resources bound.
pub struct BoundClassify {
    shape: GridShape,
    classify: BoundKernel,
    /// What decides the points that no verdict settles, where there is a map.
    undecided: Option<Undecided>,
    dilate: BoundKernel,
    compact: BoundKernel,
    compact_undilated: BoundKernel,
    arrange: BoundKernel,
    query_group: u32,
}

struct Undecided {
    ask: BoundKernel,
    judge_asked: JudgeAsked,
    query: BoundKernel,
}

impl Classify {
    /// Makes the pass. With `exact_counts` n_i and n_s of boundary points are those of the nearest k; without, they
    /// may be those of photons about the point: enough for a control variate, and cheaper. Classes are exact in
    /// both.
    ///
    /// # Errors
    /// As [`Kernel::new`]; [`Error::Setting`] for a `nearest` out of range.
    pub fn new(gpu: &Gpu, features: &Features, nearest: u32, exact_counts: bool) -> Result<Classify> {
        if !(1..=MAX_NEAREST).contains(&nearest) {
            return Err(Error::setting(
                "visibility_map.nearest",
                format!("is {nearest}; it must be from 1 to {MAX_NEAREST}"),
            ));
        }
        let composed = compose::compose("classify", features)?;
        let constants = [("nearest", f64::from(nearest)), ("exact_counts", f64::from(u8::from(exact_counts)))];
        let kernel = Kernel::new(gpu, &composed, &composed.overrides(&constants), ClassifyBindings::NAMES)?;
        Ok(Classify { kernel, map: features.has("visibility_map") })
    }

    /// Binds the pass to a tile's points, the map (where there is one) and the lights' tables.
    ///
    /// # Errors
    /// As [`Kernel::bind`].
    pub fn bind(
        &self,
        gpu: &Gpu,
        tile: &TileBuffers,
        grid: Option<&PhotonGrid>,
        buffers: &ClassifyBuffers,
        scene: &dyn Bindings,
    ) -> Result<BoundClassify> {
        let own = |dilated_classes| ClassifyBindings {
            points: &tile.points,
            classes: &buffers.classes,
            query_queue: &buffers.query_queue,
            queue_lengths: &buffers.queue_lengths,
            queue_arguments: &buffers.queue_arguments,
            dilated_classes,
            boundary_queue: &buffers.boundary_queue,
            audit_queue: &buffers.audit_queue,
            counters: &tile.counters,
        };
        let bind = |entry, dilated| match grid {
            Some(grid) => self.kernel.bind(gpu, entry, &[&own(dilated), grid, scene]),
            None => self.kernel.bind(gpu, entry, &[&own(dilated), scene]),
        };
        let dilated = &buffers.dilated_classes;
        Ok(BoundClassify {
            shape: grid.map_or(GridShape::default(), |grid| grid.shape),
            classify: bind("classify", dilated)?,
            undecided: match grid {
                Some(grid) if self.map => Some(Undecided {
                    ask: bind("ask", dilated)?,
                    judge_asked: grid.judge_asked(),
                    query: bind("query", dilated)?,
                }),
                _ => None,
            },
            dilate: bind("dilate", dilated)?,
            compact: bind("compact", dilated)?,
            compact_undilated: bind("compact", &buffers.classes)?,
            arrange: bind("arrange_queue", dilated)?,
            query_group: self.kernel.workgroup_size("query").unwrap_or(1),
        })
    }
}

impl BoundClassify {
    /// Records the classification of a tile's points for a chunk of lights, dilation, and the queues with their
    /// indirect arguments for workgroups of `queue_group` invocations.
    pub fn record(
        &self,
        frame: &mut Frame<'_>,
        buffers: &ClassifyBuffers,
        tile: &Tile,
        chunk: &Chunk,
        queue_group: u32,
    ) {
        let slots = tile.point_count * chunk.lights;
        let arguments = &buffers.queue_arguments;
        let query = self.parameters(tile, chunk, Queue::Query, self.query_group);
        frame.clear(&buffers.queue_lengths);
        frame.run(&self.classify, slots, &query);
        if let Some(Undecided { ask, judge_asked, query: search }) = &self.undecided {
            frame.run(&self.arrange, 1, &query);
            frame.run_indirect(ask, arguments, Queue::Query.arguments_offset(), &query);
            judge_asked.record(frame);
            frame.run_indirect(search, arguments, Queue::Query.arguments_offset(), &query);
        }
        self.record_queues(frame, buffers, tile, chunk, queue_group);
    }

    /// The part of [`BoundClassify::record`] that follows the classes, whoever wrote them: dilation, counts and queues. The
    /// lengths of the queues must be 0.
    pub fn record_queues(
        &self,
        frame: &mut Frame<'_>,
        buffers: &ClassifyBuffers,
        tile: &Tile,
        chunk: &Chunk,
        queue_group: u32,
    ) {
        let slots = tile.point_count * chunk.lights;
        let query = self.parameters(tile, chunk, Queue::Query, self.query_group);
        if chunk.dilate > 0 {
            frame.copy(&buffers.classes, &buffers.dilated_classes, 0, u64::from(slots) * 4);
            frame.run(&self.dilate, slots, &query);
            frame.run(&self.compact, slots, &query);
        } else {
            frame.run(&self.compact_undilated, slots, &query);
        }
        self.record_arguments(frame, tile, chunk, Queue::Boundary, queue_group);
        self.record_arguments(frame, tile, chunk, Queue::Audit, queue_group);
    }

    /// Makes the length of a queue into indirect arguments for workgroups of `queue_group` invocations.
    pub fn record_arguments(&self, frame: &mut Frame<'_>, tile: &Tile, chunk: &Chunk, queue: Queue, queue_group: u32) {
        frame.run(&self.arrange, 1, &self.parameters(tile, chunk, queue, queue_group));
    }

    fn parameters(&self, tile: &Tile, chunk: &Chunk, queue: Queue, queue_group: u32) -> ClassifyParameters {
        ClassifyParameters {
            grid: self.shape,
            tile: *tile,
            slot_count: tile.point_count * chunk.lights,
            first_light: chunk.first_light,
            dilate_radius: chunk.dilate,
            audit_probability: chunk.audit_probability,
            queue: queue as u32,
            queue_group,
            padding: [0; 2],
        }
    }
}

impl ClassifyBuffers {
    /// Bytes of all of them.
    pub fn bytes(&self) -> u64 {
        let words = [&self.classes, &self.dilated_classes, &self.boundary_queue, &self.audit_queue, &self.query_queue];
        words.into_iter().map(|b| b.bytes).sum()
    }

    /// Room for a queue of all points once the classes are known: nothing reads the queries then.
    pub fn sampled_points(&self) -> &Buffer {
        &self.query_queue
    }

    /// The class words that [`BoundClassify::record`] leaves with that dilation.
    pub fn final_classes(&self, dilate: u32) -> &Buffer {
        if dilate > 0 { &self.dilated_classes } else { &self.classes }
    }
}
