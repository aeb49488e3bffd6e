//! Timestamps of passes.

use std::collections::BTreeMap;

/// Passes between two read-backs of the timestamps: half of WebGPU's 4,096 queries to a set.
const PASSES: u32 = 2048;

/// The seconds of the passes by label, as far as they were read back.
pub(crate) struct Timer {
    queries: Option<wgpu::QuerySet>,
    period_s: f64,
    pending: Vec<String>,
    seconds: BTreeMap<String, f64>,
}

/// Timestamps on their way to the host, two for each label.
pub(crate) struct Timestamps {
    pub(crate) staging: wgpu::Buffer,
    labels: Vec<String>,
}

impl Timer {
    /// A timer that times nothing where the device has no timestamps (`present`).
    pub(crate) fn new(device: &wgpu::Device, queue: &wgpu::Queue, present: bool) -> Self {
        let queries = present.then(|| {
            device.create_query_set(&wgpu::QuerySetDescriptor {
                label: Some("kernel-kit/timestamps"),
                ty: wgpu::QueryType::Timestamp,
                count: PASSES * 2,
            })
        });
        let period_s = f64::from(queue.get_timestamp_period()) * 1e-9;
        Timer { queries, period_s, pending: Vec::new(), seconds: BTreeMap::new() }
    }

    /// The query set and first index for a pass; `None` if the device has no timestamps or the set is full. In a frame
    /// of more passes than [`PASSES`], the rest is not timed.
    pub(crate) fn next(&mut self, label: &str) -> Option<(wgpu::QuerySet, u32)> {
        let queries = self.queries.as_ref()?;
        let index = self.pending.len() as u32;
        if index >= PASSES {
            return None;
        }
        self.pending.push(label.to_owned());
        Some((queries.clone(), index * 2))
    }

    /// Whether the timestamps must be read before many more passes.
    pub(crate) fn nearly_full(&self) -> bool {
        self.pending.len() as u32 > PASSES / 2
    }

    /// The copy of all pending timestamps, and the commands that fill it; `None` if none is pending.
    pub(crate) fn resolve(&mut self, device: &wgpu::Device) -> Option<(wgpu::CommandBuffer, Timestamps)> {
        let queries = self.queries.as_ref().filter(|_| !self.pending.is_empty())?;
        let count = self.pending.len() as u32 * 2;
        let bytes = u64::from(count) * 8;
        let buffer = |usage| {
            device.create_buffer(&wgpu::BufferDescriptor {
                label: Some("kernel-kit/timestamps"),
                size: bytes,
                usage,
                mapped_at_creation: false,
            })
        };
        let resolved = buffer(wgpu::BufferUsages::QUERY_RESOLVE | wgpu::BufferUsages::COPY_SRC);
        let staging = buffer(wgpu::BufferUsages::MAP_READ | wgpu::BufferUsages::COPY_DST);
        let mut encoder = device.create_command_encoder(&Default::default());
        encoder.resolve_query_set(queries, 0..count, &resolved, 0);
        encoder.copy_buffer_to_buffer(&resolved, 0, &staging, 0, bytes);
        Some((encoder.finish(), Timestamps { staging, labels: std::mem::take(&mut self.pending) }))
    }

    /// Adds what was read back, as bytes.
    pub(crate) fn add(&mut self, timestamps: Timestamps, bytes: &[u8]) {
        let ticks: Vec<u64> = bytemuck::pod_collect_to_vec(bytes);
        for (label, pair) in timestamps.labels.into_iter().zip(ticks.chunks_exact(2)) {
            *self.seconds.entry(label).or_default() += pair[1].saturating_sub(pair[0]) as f64 * self.period_s;
        }
    }

    /// Seconds so far by label of pass.
    pub(crate) fn seconds(&self) -> &BTreeMap<String, f64> {
        &self.seconds
    }
}
