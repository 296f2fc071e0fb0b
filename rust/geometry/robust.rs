//! Robust weights of points by their distance, and the usual distance of a cloud's points. mm.

/// Tukey's biweight: (1 − (d/c)²)² up to c, nothing beyond (Beaton & Tukey 1974,
/// doi:10.1080/00401706.1974.10489171).
pub fn tukey(distance: f64, cut: f64) -> f64 {
    let part = distance / cut;
    if part < 1.0 {
        (1.0 - part * part).powi(2)
    } else {
        0.0
    }
}

/// The cost of Tukey's weight, 1 from `cut` on: 1 − (1 − (d/c)²)³.
pub fn tukey_cost(distance: f64, cut: f64) -> f64 {
    let part = (distance / cut).min(1.0);
    1.0 - (1.0 - part * part).powi(3)
}

/// The standard deviation of normal numbers with this median absolute value.
pub const OF_MEDIAN: f64 = 1.4826;

/// The median of some numbers, in place; 0 for none.
pub fn median(numbers: &mut [f64]) -> f64 {
    if numbers.is_empty() {
        return 0.0;
    }
    let middle = numbers.len() / 2;
    *numbers.select_nth_unstable_by(middle, f64::total_cmp).1
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_weight_is_the_slope_of_the_cost() {
        for d in [0.0, 0.3, 1.1, 1.9, 2.5] {
            let slope = (tukey_cost(d + 1e-6, 2.0) - tukey_cost((d - 1e-6f64).max(0.0), 2.0))
                / if d > 0.0 { 2e-6 } else { 1e-6 };
            assert!((slope - 6.0 * d / 4.0 * tukey(d, 2.0)).abs() < 1e-5);
        }
        assert_eq!(tukey(3.0, 2.0), 0.0);
        assert_eq!(median(&mut [3.0, 1.0, 2.0]), 2.0);
        assert_eq!(median(&mut []), 0.0);
    }
}
