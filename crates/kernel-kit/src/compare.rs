//! Comparing the output of a kernel with the result of an oracle on the CPU.
//!
//! Each function compares lane by lane. If lanes differ, it reports how many, and for the worst one its values and its
//! inputs: `inputs` is called with that lane's index alone. The result is an error to `unwrap` in a test;
//! [`must_catch`] inverts it, for a planted fault that must be found.

use std::fmt::Debug;

/// Where a kernel and its oracle differ.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum Mismatch {
    /// There are not as many lanes as the oracle has.
    #[error("{got} lanes, the oracle has {expected}")]
    Lanes {
        /// Lanes of the kernel.
        got: usize,
        /// Lanes of the oracle.
        expected: usize,
    },
    /// Some lanes differ by more than they may.
    #[error(
        "{differing} of {lanes} lanes differ; the worst is lane {lane}: got {got}, \
         expected {expected} ({difference}); inputs: {inputs}"
    )]
    Values {
        /// How many lanes differ.
        differing: usize,
        /// How many there are.
        lanes: usize,
        /// The one that differs most; the first of those that differ alike.
        lane: usize,
        /// The kernel's value.
        got: String,
        /// The oracle's value.
        expected: String,
        /// The difference, in the unit of the comparison.
        difference: String,
        /// The inputs of that lane.
        inputs: String,
    },
}

/// Integers are the same.
///
/// # Errors
/// [`Mismatch`], the worst lane being the one with the largest difference.
pub fn exact<T: Copy + Debug + Into<i128>>(
    got: &[T],
    expected: &[T],
    inputs: impl Fn(usize) -> String,
) -> Result<(), Mismatch> {
    let excess = |_, got: T, expected: T| {
        let difference = got.into().abs_diff(expected.into());
        (difference > 0).then(|| (difference as f64, format!("off by {difference}")))
    };
    lanes(got, expected, excess, inputs)
}

/// Floats are the same within `max_ulps` steps from one float to the next. The two zeros are the same. NaN equals only
/// NaN, and an infinity equals only itself.
///
/// # Errors
/// [`Mismatch`], the worst lane being the one that is most steps off.
pub fn within_ulps(
    got: &[f32],
    expected: &[f32],
    max_ulps: u32,
    inputs: impl Fn(usize) -> String,
) -> Result<(), Mismatch> {
    let excess = |_, got: f32, expected: f32| match ulps(got, expected) {
        Some(steps) => (steps > max_ulps).then(|| (f64::from(steps), format!("{steps} ulp, {max_ulps} are allowed"))),
        None => Some((f64::INFINITY, format!("one is not finite; {max_ulps} ulp are allowed"))),
    };
    lanes(got, expected, excess, inputs)
}

/// Floats are the same within `relative` of the oracle's absolute value, or within `floor`, whichever is more. A sum is
/// held better by [`within`], with the sum of its terms' absolute values.
///
/// # Errors
/// As [`within`].
pub fn within_relative(
    got: &[f32],
    expected: &[f64],
    relative: f64,
    floor: f64,
    inputs: impl Fn(usize) -> String,
) -> Result<(), Mismatch> {
    within(got, expected, |lane| (relative * expected[lane].abs()).max(floor), inputs)
}

/// Floats are the same within the bound of each lane. NaN equals only NaN, and an infinity equals only itself.
///
/// # Errors
/// [`Mismatch`], the worst lane being the one that is most times its bound off.
pub fn within(
    got: &[f32],
    expected: &[f64],
    bound: impl Fn(usize) -> f64,
    inputs: impl Fn(usize) -> String,
) -> Result<(), Mismatch> {
    let got: Vec<f64> = got.iter().map(|value| f64::from(*value)).collect();
    let excess = |lane: usize, got: f64, expected: f64| {
        let (difference, bound) = ((got - expected).abs(), bound(lane));
        let finite = got.is_finite() && expected.is_finite();
        let same = got == expected || got.is_nan() && expected.is_nan();
        let close = finite && difference <= bound;
        (!same && !close).then(|| {
            let excess = if finite { difference / bound.max(f64::MIN_POSITIVE) } else { f64::INFINITY };
            (excess, format!("off by {difference:e}, {bound:e} is allowed"))
        })
    };
    lanes(&got, expected, excess, inputs)
}

/// Steps from one float to the other; `None` if only one of them is NaN or infinite, or if the infinities differ.
pub fn ulps(a: f32, b: f32) -> Option<u32> {
    if a == b || a.is_nan() && b.is_nan() {
        return Some(0);
    }
    // Floats of a sign are in the order of their bits.
    let ordered = |value: f32| {
        let magnitude = i64::from(value.to_bits() & 0x7fff_ffff);
        if value.is_sign_negative() { -magnitude } else { magnitude }
    };
    (a.is_finite() && b.is_finite()).then(|| ordered(a).abs_diff(ordered(b)) as u32)
}

/// For a fault that was planted in a kernel: the comparison must have failed. Returns its mismatch.
///
/// # Panics
/// If it has not: the test would not find that fault.
#[track_caller]
pub fn must_catch(fault: &str, outcome: Result<(), Mismatch>) -> Mismatch {
    match outcome {
        Err(mismatch) => mismatch,
        Ok(()) => panic!("the planted fault is not caught: {fault}"),
    }
}

/// Compares lane by lane. `excess` returns how large a difference is, and a text for it; `None` if there is no
/// difference.
fn lanes<T: Copy + Debug>(
    got: &[T],
    expected: &[T],
    excess: impl Fn(usize, T, T) -> Option<(f64, String)>,
    inputs: impl Fn(usize) -> String,
) -> Result<(), Mismatch> {
    if got.len() != expected.len() {
        return Err(Mismatch::Lanes { got: got.len(), expected: expected.len() });
    }
    let mut differing = 0;
    let mut worst: Option<(f64, usize, String)> = None;
    for lane in 0..got.len() {
        let Some((bad, difference)) = excess(lane, got[lane], expected[lane]) else { continue };
        differing += 1;
        if worst.as_ref().is_none_or(|(so_far, ..)| bad > *so_far) {
            worst = Some((bad, lane, difference));
        }
    }
    let Some((_, lane, difference)) = worst else { return Ok(()) };
    Err(Mismatch::Values {
        differing,
        lanes: got.len(),
        lane,
        got: format!("{:?}", got[lane]),
        expected: format!("{:?}", expected[lane]),
        difference,
        inputs: inputs(lane),
    })
}
