//! First-order low passes under commands that are linear between samples, for lag, creep and tendon
//! creep.
//!
//! Over dt, with h = dt/τ and p = (1 − e^(−h))/h:  x ← (1 − ph) x + (p − 1 + ph) u_before + (1 − p)
//!   u. Exact to round-off.

use super::conditions::Conditions;
use crate::shape::modes::wide;

/// Weights (x, u_before, u) that advance a first-order low pass by `dt` under a linear command.
#[inline]
pub(crate) fn low_pass(tau: f64, dt: f64) -> [f64; 3] {
    if dt <= 0.0 {
        return [1.0, 0.0, 0.0];
    }
    if tau <= 0.0 {
        return [0.0, 0.0, 1.0];
    }
    let h = dt / tau;
    let p = if h < SHORT {
        mean_of_fall(h)
    } else {
        -(-h).exp_m1() / h
    };
    let fall = p * h;
    [1.0 - fall, p - 1.0 + fall, 1.0 - p]
}

/// Up to this h, the series below is exact to round-off (h⁹/10! < 3e-16) and several times cheaper
/// than the exponential.
const SHORT: f64 = 0.1;

/// `(1 − e^(−h))/h` by its series.
#[inline(always)]
fn mean_of_fall(h: f64) -> f64 {
    const INVERSE: [f64; 8] = [
        1.0 / 2.0,
        1.0 / 3.0,
        1.0 / 4.0,
        1.0 / 5.0,
        1.0 / 6.0,
        1.0 / 7.0,
        1.0 / 8.0,
        1.0 / 9.0,
    ];
    INVERSE
        .iter()
        .rev()
        .fold(1.0, |sum, inverse| 1.0 - h * inverse * sum)
}

/// Samples whose weights are computed together.
const TOGETHER: usize = 128;

/// `low_pass` at up to [`TOGETHER`] samples, written to `out`; the same values, several at a time.
fn low_passes(tau: f64, dts: &[f64], out: &mut [[f64; 3]; TOGETHER]) {
    if tau <= 0.0 || dts.iter().any(|dt| *dt <= 0.0 || *dt / tau >= SHORT) {
        let pairs = out.iter_mut().zip(dts);
        pairs.for_each(|(weights, dt)| *weights = low_pass(tau, *dt));
        return;
    }
    wide(
        #[inline(always)]
        || {
            for (weights, dt) in out.iter_mut().zip(dts) {
                let h = dt / tau;
                let p = mean_of_fall(h);
                let fall = p * h;
                *weights = [1.0 - fall, p - 1.0 + fall, 1.0 - p];
            }
        },
    );
}

/// Advance a record sample by sample: `advance` gets the weights of N low passes of `taus`,
/// computed for many samples at a time.
pub(super) fn low_passed<const N: usize>(
    taus: [f64; N],
    samples: &mut [f64],
    channels: usize,
    conditions: &Conditions,
    mut advance: impl FnMut([[f64; 3]; N], &mut [f64]),
) {
    let mut weights = [[[0.0; 3]; TOGETHER]; N];
    let parts = samples.chunks_mut(TOGETHER * channels);
    for (part, dts) in parts.zip(conditions.dt().chunks(TOGETHER)) {
        for (weights, tau) in weights.iter_mut().zip(taus) {
            low_passes(tau, dts, weights);
        }
        for (k, x) in part.chunks_exact_mut(channels).enumerate() {
            advance(std::array::from_fn(|i| weights[i][k]), x);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::{SHORT, TOGETHER, low_pass, low_passes, mean_of_fall};

    #[test]
    fn weights_of_many_samples_are_those_of_each() {
        let dts: Vec<f64> = (0..70).map(|k| 1e-4 + 1e-3 * f64::from(k % 13)).collect();
        for tau in [0.0, 0.05, 3.0] {
            let mut found = [[0.0; 3]; TOGETHER];
            low_passes(tau, &dts, &mut found);
            let alike = |(weights, dt): (&[f64; 3], &f64)| *weights == low_pass(tau, *dt);
            assert!(found.iter().zip(&dts).all(alike), "tau {tau}");
        }
    }

    #[test]
    fn the_series_meets_the_exponential() {
        for h in [1e-12, 1e-3, 0.03, SHORT] {
            assert!((mean_of_fall(h) + (-h).exp_m1() / h).abs() < 4e-16, "h {h}");
        }
    }

    #[test]
    fn weights_keep_constants_and_halving_the_step_changes_nothing() {
        for tau in [1e-9, 0.01, 0.3, 1e6] {
            let whole = low_pass(tau, 0.04);
            assert!((whole.iter().sum::<f64>() - 1.0).abs() < 1e-14);
            let half = low_pass(tau, 0.02);
            // From x = 0 along the ramp 0 → 1: once in one step, once through its middle.
            let middle = half[2] * 0.5;
            let end = half[0] * middle + half[1] * 0.5 + half[2];
            assert!((end - whole[2]).abs() < 1e-12);
        }
    }
}
