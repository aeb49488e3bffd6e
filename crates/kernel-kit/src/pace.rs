//! How long passes take, and how many workgroups of them a desktop's watchdog allows at once: drivers reset a device
//! that is busy with one submission for two seconds (Windows' TdrDelay; i915 and amdgpu allow more).

use std::collections::BTreeMap;
use std::time::Instant;

/// Target for the seconds of a slice. This is an eighth of what watchdogs allow: all that is known of a pass is the
/// time of the one before of the same name, and it may take several times longer.
const SLICE_SECONDS: f64 = 0.25;
/// Workgroups of a slice of a pass that has not run yet: 16,384 paths of 64 invocations a workgroup, which take
/// milliseconds on a GPU.
const FIRST_GROUPS: u32 = 256;
/// An indirect dispatch is expected to be this many times as long as the last one, because queues grow.
const GROWTH: f64 = 2.0;
/// Slices of an indirect dispatch that has not run yet.
const FIRST_SLICES: u32 = 16;
/// Maximum number of slices of an indirect dispatch, whose size the host does not know: one workgroup of 64 makes them.
pub(crate) const MAX_SLICES: u32 = 64;

/// The times of passes by label, as upper bounds. What is submitted is timed until the host waits for it, and each of
/// its passes counts as if it had taken the whole time. So passes are sliced a little more than necessary, but no
/// timestamps are needed.
pub(crate) struct Pace {
    /// Factor by which the device is taken to be slower than it seems, for tests.
    slowness: f64,
    /// Seconds of what was recorded since the last submission.
    recorded: f64,
    /// When what is under way was first submitted.
    begin: Option<Instant>,
    under_way: BTreeMap<String, Work>,
    known: BTreeMap<String, Times>,
    slices: u64,
}

/// Work that was dispatched under a label.
#[derive(Clone, Copy, Default)]
struct Work {
    /// Workgroups, as far as the host knows.
    groups: u64,
    dispatches: u64,
}

/// Seconds.
#[derive(Clone, Copy, Default)]
struct Times {
    of_group: f64,
    of_dispatch: f64,
}

impl Default for Pace {
    fn default() -> Self {
        let (under_way, known) = Default::default();
        Pace { slowness: 1.0, recorded: 0.0, begin: None, under_way, known, slices: 0 }
    }
}

impl Pace {
    /// Workgroups of a slice of a pass with `groups` workgroups.
    pub(crate) fn groups_of_slice(&mut self, label: &str, groups: u32) -> u32 {
        let unknown = SLICE_SECONDS / f64::from(FIRST_GROUPS);
        let of_group = self.known.get(label).map_or(unknown, |times| times.of_group);
        let most = ((SLICE_SECONDS / of_group) as u32).max(1);
        self.recorded += of_group * f64::from(groups);
        self.count(label, groups.into(), u64::from(groups.div_ceil(most)));
        most
    }

    /// Slices of an indirect dispatch.
    pub(crate) fn slices(&mut self, label: &str) -> u32 {
        let unknown = SLICE_SECONDS * f64::from(FIRST_SLICES) / GROWTH;
        let of_dispatch = self.known.get(label).map_or(unknown, |times| times.of_dispatch);
        let slices = ((GROWTH * of_dispatch / SLICE_SECONDS).ceil() as u32).clamp(1, MAX_SLICES);
        self.recorded += of_dispatch;
        self.count(label, 0, slices.into());
        slices
    }

    /// Whether what was recorded since the last submission is enough for one.
    pub(crate) fn is_due(&self) -> bool {
        self.recorded >= SLICE_SECONDS
    }

    fn count(&mut self, label: &str, groups: u64, slices: u64) {
        let work = self.under_way.entry(label.to_owned()).or_default();
        work.groups += groups;
        work.dispatches += 1;
        self.slices += if slices > 1 { slices } else { 0 };
    }

    /// Something is submitted.
    pub(crate) fn begin(&mut self) {
        self.recorded = 0.0;
        self.begin.get_or_insert_with(Instant::now);
    }

    /// Everything submitted is done.
    pub(crate) fn end(&mut self) {
        let Some(begin) = self.begin.take() else { return };
        let seconds = begin.elapsed().as_secs_f64() * self.slowness;
        for (label, work) in std::mem::take(&mut self.under_way) {
            let times = self.known.entry(label).or_default();
            // A pass that was slow once may be again, for a while.
            let bound = |times: f64, count: u64| f64::max(seconds / count.max(1) as f64, times / 2.0);
            *times = Times {
                of_group: bound(times.of_group, work.groups),
                of_dispatch: bound(times.of_dispatch, work.dispatches),
            };
        }
    }

    /// From now on the device seems `factor` times as slow as it is.
    pub(crate) fn pretend_slower(&mut self, factor: f64) {
        self.slowness = factor;
    }

    /// Slices so far of dispatches that had more than one.
    pub(crate) fn sliced(&self) -> u64 {
        self.slices
    }
}
