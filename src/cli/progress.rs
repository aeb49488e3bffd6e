//! The progress of a render: a bar on a terminal, otherwise a line now and then.

use std::fmt;
use std::io::{self, IsTerminal};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use kernel_kit::{Compilation, Gpu};
use penumbra::{Progress, Settings};

use super::say;

/// When a render ends.
pub struct Goal {
    /// Samples per pixel.
    pub spp: u32,
    /// End of its time.
    pub deadline: Option<Instant>,
}

impl Goal {
    /// Time left after `samples` in all, at the speed of the last `made` of them, which took so long; `None` if only
    /// the noise ends the render.
    fn time_left(&self, samples: u32, made: u32, so_far: Duration, now: Instant) -> Option<Duration> {
        if self.deadline.is_none() && self.spp == Settings::UNLIMITED_SPP {
            return None;
        }
        let samples_left = f64::from(self.spp.saturating_sub(samples)) / f64::from(made.max(1));
        // A century: longer times would overflow a Duration.
        let by_samples = Duration::from_secs_f64((so_far.as_secs_f64() * samples_left).min(3.2e9));
        let left = |deadline: Instant| by_samples.min(deadline.saturating_duration_since(now));
        Some(self.deadline.map_or(by_samples, left))
    }
}

/// Shows progress until it is dropped.
pub struct Display {
    target: Target,
    goal: Goal,
    started: Instant,
    /// Samples per pixel at the start: those of an earlier process or of a device that was lost.
    earlier: u32,
    /// End of the last batch, and the number of rays until then.
    last: (Instant, u64),
}

enum Target {
    Bar(ProgressBar),
    /// The next line is due this long after the beginning, and each further one after twice the time of the one before.
    Lines(Duration),
    Nothing,
}

/// Steps of the bar: more than a terminal has columns.
const STEPS: u64 = 1000;

impl Target {
    fn new(quiet: bool) -> Target {
        if quiet {
            Target::Nothing
        } else if io::stderr().is_terminal() {
            let bar = ProgressBar::with_draw_target(Some(STEPS), ProgressDrawTarget::stderr());
            if let Ok(style) = ProgressStyle::with_template("{bar:30} {msg}") {
                bar.set_style(style);
            }
            Target::Bar(bar)
        } else {
            Target::Lines(Duration::from_secs(1))
        }
    }

    /// Shows what was done, a share of all, `elapsed` after the beginning.
    fn show(&mut self, elapsed: Duration, share: f64, message: impl Fn() -> String) {
        match self {
            Target::Bar(bar) => {
                bar.set_position((share * STEPS as f64) as u64);
                bar.set_message(message());
            }
            Target::Lines(due) if elapsed >= *due => {
                *due = 2 * elapsed;
                say(message());
            }
            Target::Lines(_) | Target::Nothing => {}
        }
    }
}

impl Drop for Target {
    fn drop(&mut self) {
        if let Target::Bar(bar) = self {
            bar.finish_and_clear();
        }
    }
}

/// From now on shows how many kernels the driver has compiled, unless it has all of them from earlier. The returned
/// flag is set once it compiles one.
pub fn show_compilation(gpu: &Gpu, quiet: bool) -> Arc<AtomicBool> {
    let driver_compiles = Arc::new(AtomicBool::new(false));
    let compiles = driver_compiles.clone();
    let shown: Mutex<Option<(Instant, Target)>> = Mutex::default();
    gpu.watch_compilation(move |compilation| {
        compiles.store(true, Ordering::Relaxed);
        let mut shown = shown.lock().unwrap_or_else(|e| e.into_inner());
        let (started, target) = shown.get_or_insert_with(|| (Instant::now(), Target::new(quiet)));
        let Compilation { done, all } = compilation;
        target.show(started.elapsed(), done as f64 / all as f64, || compilation.to_string());
        if done == all {
            *shown = None;
        }
    });
    driver_compiles
}

impl Display {
    /// `progress` is what there is at the start.
    pub fn new(goal: Goal, progress: &Progress, quiet: bool) -> Self {
        let target = Target::new(quiet);
        let started = Instant::now();
        Display { target, goal, started, earlier: progress.samples, last: (started, progress.rays) }
    }

    /// The time left and the millions of rays a second, after a batch that ends now.
    fn end_batch(&mut self, progress: &Progress, now: Instant) -> (Option<Duration>, f64) {
        let made = progress.samples.saturating_sub(self.earlier);
        let left = self.goal.time_left(progress.samples, made, now - self.started, now);
        let speed = mega(progress.rays.saturating_sub(self.last.1), (now - self.last.0).as_secs_f64());
        self.last = (now, progress.rays);
        (left, speed)
    }

    /// Shows the progress after a batch.
    pub fn update(&mut self, progress: &Progress) {
        let now = Instant::now();
        let (left, speed) = self.end_batch(progress, now);
        let elapsed = now - self.started;
        let message = || {
            format!(
                "{} spp, {}{speed:.1} Mrays/s",
                progress.samples,
                left.map_or(String::new(), |left| format!(
                    "{} left, ",
                    duration(left.as_secs_f64(), |s| format!("{s:.1}"))
                ))
            )
        };
        let total = elapsed + left.unwrap_or(Duration::MAX / 2);
        let done = elapsed.as_secs_f64() / total.as_secs_f64().max(f64::MIN_POSITIVE);
        self.target.show(elapsed, done, message);
    }
}

/// Millions per second.
pub fn mega(count: u64, seconds: f64) -> f64 {
    if seconds > 0.0 { count as f64 / seconds / 1e6 } else { 0.0 }
}

/// A duration for users. `short` writes the seconds of one that is less than a minute.
pub fn duration<T: fmt::Display>(seconds: f64, short: impl Fn(f64) -> T) -> String {
    let whole = seconds.round() as u64;
    match (whole / 3600, whole / 60 % 60, whole % 60) {
        (0, 0, _) => format!("{} s", short(seconds)),
        (0, minutes, seconds) => format!("{minutes} min {seconds} s"),
        (hours, minutes, _) => format!("{hours} h {minutes} min"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 40 of 100 samples and a million rays are from before an interruption; since then a sample takes a second and
    /// half a million rays.
    #[test]
    fn speed_is_that_since_the_start() {
        let progress = |samples: u32, rays: u64| Progress { samples, rays, boundary_share: 0.0 };
        let mut display = Display::new(Goal { spp: 100, deadline: None }, &progress(40, 1_000_000), true);
        let started = display.started;
        let mut after = |seconds: u32| {
            let state = progress(40 + seconds, 1_000_000 + 500_000 * u64::from(seconds));
            display.end_batch(&state, started + Duration::from_secs(seconds.into()))
        };
        assert_eq!(after(10), (Some(Duration::from_secs(50)), 0.5));
        assert_eq!(after(30), (Some(Duration::from_secs(30)), 0.5));
    }
}
