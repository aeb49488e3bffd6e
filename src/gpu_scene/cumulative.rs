//! Cumulative probabilities, as kernels search them.

/// Minimum probability of everything that has a weight: 16 ULP of cumulative probabilities in f32, so that rounding
/// leaves more than 0 of it.
const MIN_PROBABILITY: f64 = 1.0 / (1 << 20) as f64;

/// Cumulative probabilities by weight, the last being 1; uniform if all weights are 0.
pub(super) fn cumulative(weights: &[f64]) -> Vec<f32> {
    let min = weights.iter().sum::<f64>() * MIN_PROBABILITY;
    let raised = |weight: &f64| match *weight {
        _ if min <= 0.0 => 1.0,
        weight if weight > 0.0 => weight.max(min),
        _ => 0.0,
    };
    let sums = || {
        weights.iter().map(raised).scan(0.0, |sum, weight| {
            *sum += weight;
            Some(*sum)
        })
    };
    let total = sums().last().unwrap_or(1.0);
    sums().map(|sum| (sum / total) as f32).collect()
}

/// Four to a texel, padded with 1.
pub(super) fn texels_of(cumulative: &[f32]) -> impl Iterator<Item = [f32; 4]> {
    cumulative.chunks(4).map(|four| std::array::from_fn(|i| four.get(i).copied().unwrap_or(1.0)))
}
