//! Pass `classify`: classifies every candidate (a point and a light), and queues the candidates that need shadow rays
//! or audits.

use kernel_kit::{Bindings, BoundKernel, Buffer, Frame, Gpu, Kernel, PART_ALIGNMENT, bindings, shared_struct};

use super::grid::{ClassifyRequestedCells, PhotonGrid};
use super::{Tile, TileBuffers, kernel};
use crate::Result;
use crate::kernels::{CLASSIFY_CANDIDATES, GridShape, Queue};
use crate::specialisation::features::{Feature, Features};

/// Probabilities with which lit and shadowed candidates are audited. Values above 1 count as 1. See
/// `shaders/lib/class_word.wgsl`.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct AuditProbabilities {
    /// Away from boundaries.
    pub away: f32,
    /// Near boundaries: in parts of divided cells that have few photons. Parts that have many are audited a quarter as
    /// often.
    pub near: f32,
}

/// How many times as often points near boundaries are audited, because classes there are wrong far more often. Audits
/// keep wrong classes from becoming fireflies: 16 raises the default of 1/64 to 1/4, so a wrong visibility has a weight
/// of 4.
const NEAR_AUDITS: f32 = 16.0;

impl AuditProbabilities {
    /// The probabilities if points away from boundaries are audited with probability `away`, 0 to 1.
    pub fn of(away: f32) -> AuditProbabilities {
        AuditProbabilities { away, near: NEAR_AUDITS * away }
    }
}

/// Lights that the passes of direct light process together.
#[derive(Clone, Copy, Debug)]
pub struct Chunk {
    /// First light of the chunk, or first sampled light index.
    pub first_light: u32,
    /// Lights of the chunk.
    pub lights: u32,
    /// Pixels by which boundaries are dilated, 0 or 1.
    pub dilate: u32,
    /// How often lit and shadowed candidates are audited.
    pub audits: AuditProbabilities,
}

shared_struct! {
    /// Immediates of the pass; see `shaders/classify.wgsl`.
    pub struct ClassifyParameters {
        grid: GridShape,
        tile: Tile,
        candidate_count: u32,
        first_light: u32,
        audit_away: f32,
        audit_near: f32,
        queue: u32,
        queue_group: u32,
        padding: [u32; 2],
    }
}

bindings! {
    /// Buffers of the kernels, apart from the visibility map.
    struct ClassifyBindings {
        pub classes: &Buffer,
        pub queues: &Buffer,
        pub queue_lengths: &Buffer,
        pub queue_arguments: &Buffer,
        pub counters: &Buffer,
    }
}

impl<'a> ClassifyBindings<'a> {
    fn of(buffers: &'a ClassifyBuffers, tile: &'a TileBuffers) -> Self {
        ClassifyBindings {
            classes: &buffers.classes,
            queues: &buffers.queues,
            queue_lengths: &buffers.queue_lengths,
            queue_arguments: &buffers.queue_arguments,
            counters: &tile.counters,
        }
    }
}

/// The buffers of the pass. Candidates are (light of the chunk, point) pairs, light by light.
pub struct ClassifyBuffers {
    /// Class words.
    pub classes: Buffer,
    /// Boundary and unknown candidates, a part of `queues`.
    pub boundary_queue: Buffer,
    /// Candidates to audit, a part of `queues`.
    pub audit_queue: Buffer,
    /// Lengths of this sample's queues, by [`Queue`].
    pub queue_lengths: Buffer,
    /// Indirect arguments, by [`Queue::arguments_offset`].
    pub queue_arguments: Buffer,
    query_queue: Buffer,
    /// The queues of [`Queue::CANDIDATES`], one after the other.
    queues: Buffer,
}

impl ClassifyBuffers {
    /// Buffers for `candidates` candidates.
    ///
    /// # Errors
    /// As [`Gpu::buffer`].
    pub fn new(gpu: &Gpu, candidates: u32) -> Result<ClassifyBuffers> {
        let room = (u64::from(candidates).max(1) * 4).next_multiple_of(PART_ALIGNMENT);
        let words = room as usize / 4 * Queue::CANDIDATES.len();
        let queues = gpu.buffer::<u32>("penumbra/classify/queues", words)?;
        let queue = |queue: Queue, label: &str| queues.part(label, queue as u64 * room, room);
        let argument_words = Queue::COUNT * Queue::ARGUMENT_WORDS as usize;
        Ok(ClassifyBuffers {
            classes: gpu.buffer::<u32>("penumbra/classify/classes", candidates as usize)?,
            boundary_queue: queue(Queue::Boundary, "penumbra/classify/boundary_queue"),
            audit_queue: queue(Queue::Audit, "penumbra/classify/audit_queue"),
            queue_lengths: gpu.buffer::<u32>("penumbra/classify/queue_lengths", Queue::COUNT)?,
            queue_arguments: gpu.buffer::<u32>("penumbra/classify/queue_arguments", argument_words)?,
            query_queue: queue(Queue::Query, "penumbra/classify/query_queue"),
            queues,
        })
    }
}

/// The pass; see `shaders/classify.wgsl`.
pub struct Classify {
    kernel: Kernel,
    /// Whether there is a visibility map.
    map: bool,
    /// Whether another pass writes classes.
    classes_of_others: bool,
}

/// The pass, bound.
pub struct BoundClassify {
    shape: GridShape,
    classify: BoundKernel,
    /// Requests of the points whose cell has no class yet; `None` without a visibility map.
    requests: Option<CellRequests>,
    /// `None` without a visibility map, whose classes alone have boundaries to widen.
    dilate: Option<BoundKernel>,
    /// `None` unless another pass writes classes.
    compact: Option<BoundKernel>,
    arrange: BoundKernel,
    /// Invocations of a workgroup of each kernel.
    group: u32,
}

struct CellRequests {
    look_up: BoundKernel,
    request_cells: BoundKernel,
    classify_requested_cells: ClassifyRequestedCells,
    query: BoundKernel,
}

impl Classify {
    /// Compiles the kernels; `nearest` is k. With [`Feature::ExactCounts`] n_i and n_s of boundary candidates are those
    /// of the nearest k, else those of photons about the cell: enough for a control variate, and cheaper.
    ///
    /// # Errors
    /// As [`Kernel::new`]; [`crate::Error::Setting`] for a `nearest` out of range.
    pub fn new(gpu: &Gpu, features: &Features, nearest: u32) -> Result<Classify> {
        super::grid::check_nearest(nearest)?;
        let constants = [("nearest", f64::from(nearest))];
        let kernel = kernel(gpu, "classify", features, &constants, &[ClassifyBindings::DECLARED])?;
        let others = [Feature::Cells, Feature::LightBuffer, Feature::Ward];
        let classes_of_others = others.iter().any(|other| features.has(*other));
        Ok(Classify { kernel, map: features.has(Feature::VisibilityMap), classes_of_others })
    }

    /// Binds the pass to a tile's points, the visibility map (where there is one) and the scene.
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
        let own = ClassifyBindings::of(buffers, tile);
        let bind = |entry| match grid {
            Some(grid) => self.kernel.bind(gpu, entry, &[&own, tile, grid, scene]),
            None => self.kernel.bind(gpu, entry, &[&own, tile, scene]),
        };
        Ok(BoundClassify {
            shape: grid.map_or(GridShape::default(), |grid| grid.shape),
            classify: bind("classify")?,
            requests: match grid {
                Some(grid) if self.map => Some(CellRequests {
                    look_up: bind("look_up")?,
                    request_cells: bind("request_cells")?,
                    classify_requested_cells: grid.classify_requested_cells(),
                    query: bind("query")?,
                }),
                _ => None,
            },
            dilate: self.map.then(|| bind("dilate")).transpose()?,
            compact: self.classes_of_others.then(|| bind("compact")).transpose()?,
            arrange: bind("arrange_queue")?,
            group: self.kernel.workgroup_size("classify").unwrap_or(1),
        })
    }
}

/// The kernel that shows which cell decides each point, for callers that display the cells.
pub struct ShowCells(Kernel);

/// The kernel, bound.
pub struct BoundShowCells {
    kernel: BoundKernel,
    shape: GridShape,
}

impl ShowCells {
    /// Compiles the kernel for a render with these features; `nearest` is k.
    ///
    /// # Errors
    /// As [`Classify::new`].
    pub fn new(gpu: &Gpu, features: &Features, nearest: u32) -> Result<ShowCells> {
        Ok(ShowCells(Classify::new(gpu, &features.clone().with(Feature::ShownCells, true), nearest)?.kernel))
    }

    /// Binds it as [`Classify::bind`] does.
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
    ) -> Result<BoundShowCells> {
        let own = ClassifyBindings::of(buffers, tile);
        let kernel = match grid {
            Some(grid) => self.0.bind(gpu, "show_cells", &[&own, tile, grid, scene])?,
            None => self.0.bind(gpu, "show_cells", &[&own, tile, scene])?,
        };
        Ok(BoundShowCells { kernel, shape: grid.map_or(GridShape::default(), |grid| grid.shape) })
    }
}

impl BoundShowCells {
    /// Writes a [`crate::kernels::ShownCell`] for each point of the tile in place of the class words of a light.
    pub fn record(&self, frame: &mut Frame<'_>, tile: &Tile, light: u32) {
        let parameters = ClassifyParameters {
            grid: self.shape,
            tile: *tile,
            candidate_count: tile.point_count,
            first_light: light,
            audit_away: 0.0,
            audit_near: 0.0,
            queue: Queue::Query as u32,
            queue_group: 1,
            padding: [0; 2],
        };
        frame.run(&self.kernel, tile.point_count, &parameters);
    }
}

impl BoundClassify {
    /// Empties the queues, gives each point the class of its fine cell where the cell has one, and queues it by its
    /// class. Queues the other points for [`BoundClassify::look_up`].
    pub fn classify(&self, frame: &mut Frame<'_>, buffers: &ClassifyBuffers, tile: &Tile, chunk: &Chunk) {
        frame.clear(&buffers.queue_lengths);
        self.run_over_candidates(frame, &self.classify, tile, chunk);
    }

    /// Gives the queued points the classes of the map's cells, and requests a class for each cell that has queued
    /// points but no class yet.
    pub fn look_up(&self, frame: &mut Frame<'_>, buffers: &ClassifyBuffers, tile: &Tile, chunk: &Chunk) {
        let Some(CellRequests { look_up, request_cells, .. }) = &self.requests else { return };
        self.record_arguments(frame, tile, chunk, Queue::Query, self.group);
        let parameters = self.parameters(tile, chunk, Queue::Query, self.group);
        for kernel in [look_up, request_cells] {
            frame.run_indirect(kernel, &buffers.queue_arguments, Queue::Query.arguments_offset(), &parameters);
        }
    }

    /// Classifies the requested cells.
    pub fn classify_requested_cells(&self, frame: &mut Frame<'_>) {
        if let Some(CellRequests { classify_requested_cells, .. }) = &self.requests {
            classify_requested_cells.record(frame);
        }
    }

    /// Classifies the points that [`BoundClassify::look_up`] left undecided: by the requested cells, or with
    /// [`Feature::ExactCounts`] by a search for their nearest photons. Then queues all points that it looked up, by
    /// their classes.
    pub fn query(&self, frame: &mut Frame<'_>, buffers: &ClassifyBuffers, tile: &Tile, chunk: &Chunk) {
        let Some(CellRequests { query, .. }) = &self.requests else { return };
        let parameters = self.parameters(tile, chunk, Queue::Query, self.group);
        frame.run_indirect(query, &buffers.queue_arguments, Queue::Query.arguments_offset(), &parameters);
    }

    /// Widens boundaries by [`Chunk::dilate`] pixels: adds the candidates around them to their queue.
    pub fn dilate(&self, frame: &mut Frame<'_>, buffers: &ClassifyBuffers, tile: &Tile, chunk: &Chunk) {
        if let Some(dilate) = self.dilate.as_ref().filter(|_| chunk.dilate > 0) {
            self.record_arguments(frame, tile, chunk, Queue::Boundary, self.group);
            let parameters = self.parameters(tile, chunk, Queue::Boundary, self.group);
            let offset = Queue::Boundary.arguments_offset();
            frame.run_indirect(dilate, &buffers.queue_arguments, offset, &parameters);
        }
    }

    /// Counts the classes that another pass wrote, and queues the candidates that need shadow rays. The queues must be
    /// empty. Does nothing if no other pass writes classes.
    pub fn compact(&self, frame: &mut Frame<'_>, tile: &Tile, chunk: &Chunk) {
        if let Some(compact) = &self.compact {
            self.run_over_candidates(frame, compact, tile, chunk);
        }
    }

    fn run_over_candidates(&self, frame: &mut Frame<'_>, kernel: &BoundKernel, tile: &Tile, chunk: &Chunk) {
        let parameters = self.parameters(tile, chunk, Queue::Query, self.group);
        frame.run(kernel, parameters.candidate_count.div_ceil(CLASSIFY_CANDIDATES), &parameters);
    }

    /// Converts the length of a queue to indirect arguments for workgroups of `queue_group` invocations.
    pub fn record_arguments(&self, frame: &mut Frame<'_>, tile: &Tile, chunk: &Chunk, queue: Queue, queue_group: u32) {
        frame.run(&self.arrange, 1, &self.parameters(tile, chunk, queue, queue_group));
    }

    fn parameters(&self, tile: &Tile, chunk: &Chunk, queue: Queue, queue_group: u32) -> ClassifyParameters {
        ClassifyParameters {
            grid: self.shape,
            tile: *tile,
            candidate_count: tile.point_count * chunk.lights,
            first_light: chunk.first_light,
            audit_away: chunk.audits.away,
            audit_near: chunk.audits.near,
            queue: queue as u32,
            queue_group,
            padding: [0; 2],
        }
    }
}

impl ClassifyBuffers {
    /// Bytes of all of them.
    pub fn bytes(&self) -> u64 {
        self.classes.bytes + self.queues.bytes
    }

    /// The query queue, used again for [`Queue::Sampled`], a queue of points: once the classes are known, nothing reads
    /// the queries.
    pub fn sampled_points(&self) -> &Buffer {
        &self.query_queue
    }
}
