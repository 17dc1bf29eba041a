//! Quantiles of what was measured.

/// Of sorted values, between neighbours.
pub fn quantile(sorted: &[f64], share: f64) -> f64 {
    let place = share * (sorted.len() - 1) as f64;
    let (low, high) = (sorted[place.floor() as usize], sorted[place.ceil() as usize]);
    // Two infinities have no difference.
    if low == high { low } else { low + (high - low) * place.fract() }
}
