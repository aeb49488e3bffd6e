//! Keyframes: the values of an animated property at some times, and between them (glTF 3.11 and appendix C).

use std::collections::HashSet;
use std::f64::consts::FRAC_1_SQRT_2;

use glam::{DQuat, DVec4};

use super::accessor::{Accessor, Component};
use super::json::Json;
use super::limits::MAX_CORNERS;
use super::node::UNIT_TOLERANCE;
use crate::Result;

/// Elements that are read at a time to be checked.
const BLOCK: usize = 1 << 12;

/// The values in a key of a property.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Values {
    /// An accessor's element of that many numbers, each interpolated by itself.
    Vector(usize),
    /// That many elements of one number: the weights of morph targets.
    Scalars(usize),
    /// A unit quaternion, interpolated along the shorter arc.
    Rotation,
    /// On or off, which no interpolation changes: a byte, 0 for off.
    Switch,
}

impl Values {
    /// Elements of the output accessor for a key, without tangents.
    fn elements(self) -> usize {
        match self {
            Values::Vector(_) | Values::Rotation | Values::Switch => 1,
            Values::Scalars(count) => count,
        }
    }

    /// Numbers of such an element.
    fn width(self) -> usize {
        match self {
            Values::Vector(width) => width,
            Values::Scalars(_) | Values::Switch => 1,
            Values::Rotation => 4,
        }
    }
}

/// How values follow between two keys.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Interpolation {
    Step,
    Linear,
    CubicSpline,
}

/// A sampler of an animation, checked but for what depends on the property that it animates.
#[derive(Clone, Copy)]
pub(super) struct Sampler<'r, 'a> {
    input: &'r Accessor<'a>,
    output: &'r Accessor<'a>,
    /// Index of `output`.
    output_index: usize,
    interpolation: Interpolation,
}

/// Reads and checks samplers.
pub(super) struct Reader<'r, 'a> {
    accessors: &'r [Accessor<'a>],
    /// Indices of accessors whose values have been checked: as times, as finite numbers, and as unit quaternions. Of a
    /// sampler with tangents (`true`) only each third element is a quaternion. Samplers may share accessors.
    times: HashSet<usize>,
    finite: HashSet<usize>,
    unit: HashSet<(usize, bool)>,
    /// Number of elements checked so far. Accessors may share their bytes, so the size of the file does not bound it.
    checked: usize,
}

impl<'r, 'a> Reader<'r, 'a> {
    /// A reader of samplers that refer to these accessors.
    pub fn new(accessors: &'r [Accessor<'a>]) -> Self {
        let (times, finite, unit) = Default::default();
        Reader { accessors, times, finite, unit, checked: 0 }
    }

    /// Reads a sampler.
    pub fn sampler(&mut self, json: &Json<'a>) -> Result<Sampler<'r, 'a>> {
        let interpolation = match json.get("interpolation")? {
            None => Interpolation::Linear,
            Some(name) => match name.string()? {
                "LINEAR" => Interpolation::Linear,
                "STEP" => Interpolation::Step,
                "CUBICSPLINE" => Interpolation::CubicSpline,
                other => return Err(name.error(format!("unknown interpolation \"{other}\""))),
            },
        };
        let [input_json, output_json] = [json.require("input")?, json.require("output")?];
        let input_index = input_json.index(self.accessors.len(), "accessor")?;
        let output_index = output_json.index(self.accessors.len(), "accessor")?;
        let [input, output] = [input_index, output_index].map(|index| &self.accessors[index]);
        if (input.width, input.component, input.normalised) != (1, Component::F32, false) {
            return Err(input_json.error("times must be float scalars"));
        }
        self.check_times(&input_json, input_index)?;
        if self.finite.insert(output_index) {
            self.count(&output_json, output)?;
            for first in (0..output.count).step_by(BLOCK) {
                let numbers = output.components(first, BLOCK.min(output.count - first))?;
                if let Some(i) = numbers.iter().position(|x| !x.is_finite()) {
                    return Err(output_json.error(format!("element {} is not finite", first + i / output.width)));
                }
            }
        }
        Ok(Sampler { input, output, output_index, interpolation })
    }

    fn check_times(&mut self, json: &Json<'a>, index: usize) -> Result<()> {
        let input = &self.accessors[index];
        // A file without data, all of whose times are zero, is legal: its writer supplies them later.
        if !self.times.insert(index) || input.is_zero_filled() {
            return Ok(());
        }
        self.count(json, input)?;
        let mut last = -f32::MIN_POSITIVE;
        for (i, [time]) in input.floats::<1>(0.0, None)?.into_iter().enumerate() {
            if time.partial_cmp(&last) != Some(std::cmp::Ordering::Greater) || !time.is_finite() {
                let problem = format!("time {i} is {time}: times must increase, from 0 or later");
                return Err(json.error(problem));
            }
            last = time;
        }
        Ok(())
    }

    fn count(&mut self, json: &Json<'a>, accessor: &Accessor) -> Result<()> {
        self.checked = self.checked.saturating_add(accessor.count);
        if self.checked > MAX_CORNERS {
            return Err(json.error(format!("the animations have more than {MAX_CORNERS} keys and values")));
        }
        Ok(())
    }

    /// Checks that a sampler has the values of a property. `json` is the channel's reference to the sampler.
    /// `extended`: the channel is by KHR_animation_pointer, for which integers that are not normalised are numbers too.
    pub fn check(&mut self, json: &Json<'a>, sampler: &Sampler<'r, 'a>, values: Values, extended: bool) -> Result<()> {
        let Sampler { input, output, .. } = sampler;
        if values == Values::Switch {
            if (output.component, output.normalised) != (Component::U8, false) {
                return Err(json.error("its output must be unsigned bytes, which are 0 for false"));
            }
            if sampler.interpolation != Interpolation::Step {
                return Err(json.error("its interpolation must be STEP: there is nothing between true and false"));
            }
        } else if !extended && output.component != Component::F32 && !output.normalised {
            return Err(json.error("its output must be floats or normalised integers"));
        }
        if output.width != values.width() {
            let problem = format!("its output has {} numbers in an element, not {}", output.width, values.width());
            return Err(json.error(problem));
        }
        let expected = (input.count * sampler.parts()).checked_mul(values.elements());
        if expected != Some(output.count) {
            let expected = expected.unwrap_or(usize::MAX);
            let problem = format!("its output has {} elements, not {expected}, for its times", output.count);
            return Err(json.error(problem));
        }
        let spline = sampler.interpolation == Interpolation::CubicSpline;
        if values != Values::Rotation || output.is_zero_filled() || !self.unit.insert((sampler.output_index, spline)) {
            return Ok(());
        }
        self.count(json, output)?;
        for key in 0..input.count {
            let length = rotation(&sampler.part(key, sampler.middle(), values)?).length();
            if (length - 1.0).abs() > UNIT_TOLERANCE {
                return Err(json.error(format!("the rotation at key {key} has length {length}, not 1")));
            }
        }
        Ok(())
    }
}

impl Sampler<'_, '_> {
    /// Parts of a key: the value, with splines also the tangents before and after it.
    fn parts(&self) -> usize {
        if self.interpolation == Interpolation::CubicSpline { 3 } else { 1 }
    }

    /// Which part the value is.
    fn middle(&self) -> usize {
        self.parts() / 2
    }

    fn part(&self, key: usize, part: usize, values: Values) -> Result<Vec<f64>> {
        let elements = values.elements();
        self.output.components((key * self.parts() + part) * elements, elements)
    }

    fn time(&self, key: usize) -> Result<f64> {
        Ok(self.input.components(key, 1)?[0])
    }

    /// The time of the last key.
    pub fn end(&self) -> Result<f64> {
        self.time(self.input.count - 1)
    }

    /// The values at a time. Before the first key they are those of the first key, after the last key those of the
    /// last.
    pub fn at(&self, seconds: f64, values: Values) -> Result<Vec<f64>> {
        let (mut low, mut high) = (0, self.input.count);
        // The file has rounded the times of keys to f32. A frame at the exact time of a key must not come before the
        // key.
        let rounded = seconds.max(f64::from(seconds as f32));
        while low < high {
            let middle = low + (high - low) / 2;
            if self.time(middle)? <= rounded { low = middle + 1 } else { high = middle }
        }
        let value = |key: usize| self.part(key, self.middle(), values);
        let key = low.saturating_sub(1);
        let mut result = if low == 0 || low == self.input.count || self.interpolation == Interpolation::Step {
            value(key)?
        } else {
            let (start, end) = (self.time(key)?, self.time(key + 1)?);
            let (span, t) = (end - start, ((seconds - start) / (end - start)).max(0.0));
            let (from, to) = (value(key)?, value(key + 1)?);
            match self.interpolation {
                Interpolation::CubicSpline => {
                    let (leaving, arriving) = (self.part(key, 2, values)?, self.part(key + 1, 0, values)?);
                    let number = |i: usize| spline([from[i], leaving[i] * span, to[i], arriving[i] * span], t);
                    (0..from.len()).map(number).collect()
                }
                _ if values == Values::Rotation => slerp(rotation(&from), rotation(&to), t).to_array().to_vec(),
                _ => from.iter().zip(&to).map(|(from, to)| from + t * (to - from)).collect(),
            }
        };
        if values == Values::Rotation {
            // Splines leave the unit sphere, and keys lie slightly off it by rounding. The mean of opposite keys has no
            // direction: the rotation of the earlier key stays.
            let unit = DVec4::from_slice(&result).try_normalize().unwrap_or(rotation(&value(key)?).normalize().into());
            result = unit.to_array().to_vec();
        }
        Ok(result)
    }
}

fn rotation(numbers: &[f64]) -> DQuat {
    DQuat::from_slice(numbers)
}

/// Hermite spline through values with tangents, which are scaled by the time between the keys (glTF appendix C.5).
fn spline([from, leaving, to, arriving]: [f64; 4], t: f64) -> f64 {
    let (t2, t3) = (t * t, t * t * t);
    (2.0 * t3 - 3.0 * t2 + 1.0) * from
        + (t3 - 2.0 * t2 + t) * leaving
        + (3.0 * t2 - 2.0 * t3) * to
        + (t3 - t2) * arriving
}

/// Spherical interpolation along the shorter arc (glTF appendix C.4).
fn slerp(from: DQuat, to: DQuat, t: f64) -> DQuat {
    let (from, to) = (from.normalize(), to.normalize());
    let to = if from.dot(to) < 0.0 { -to } else { to };
    // Half the angle. It is accurate for small angles, for which the dot product has only half of the digits.
    let half = (0.5 * (to - from).length()).min(FRAC_1_SQRT_2).asin();
    let weight = |share: f64| if half == 0.0 { share } else { (2.0 * share * half).sin() / (2.0 * half).sin() };
    from * weight(1.0 - t) + to * weight(t)
}

#[cfg(test)]
mod tests {
    use std::f64::consts::{FRAC_PI_2, PI};

    use glam::{DQuat, DVec3};

    use super::{slerp, spline};

    /// Rounding of a few operations in f64 on numbers near 1.
    const ROUNDING: f64 = 1e-14;

    #[test]
    fn slerp_has_constant_speed_along_the_shorter_arc() {
        let axis = DVec3::new(1.0, 2.0, -2.0) / 3.0;
        for angle in [1e-12, 1e-6, 0.01, 1.0, FRAC_PI_2, PI - 1e-6] {
            for t in [0.0, 0.25, 0.5, 0.9, 1.0] {
                let [from, to, expected] = [0.3, 0.3 + angle, 0.3 + t * angle].map(|a| DQuat::from_axis_angle(axis, a));
                for to in [to, -to] {
                    let found = slerp(from, to, t);
                    assert!((found - expected).length() < ROUNDING, "{angle} {t}: {found} for {expected}");
                }
            }
        }
        // Linear interpolation, the planted fault, is exact only at the ends and in the middle.
        let [from, to, expected] = [0.0, 1.0, 0.25].map(|a| DQuat::from_axis_angle(axis, a));
        assert!((from.lerp(to, 0.25) - expected).length() > 1e-3);
    }

    #[test]
    fn a_spline_follows_a_cubic() {
        // p = 1 - 2 x + 3 x^2 - x^3 from 1 to 3 is met by its own values and derivatives.
        let p = |x: f64| 1.0 - 2.0 * x + 3.0 * x * x - x * x * x;
        let derivative = |x: f64| -2.0 + 6.0 * x - 3.0 * x * x;
        for t in [0.0, 0.125, 0.5, 1.0] {
            let (from, to, span) = (1.0, 3.0, 2.0);
            let found = spline([p(from), span * derivative(from), p(to), span * derivative(to)], t);
            assert!((found - p(from + span * t)).abs() < ROUNDING, "{t}: {found}");
        }
    }
}
