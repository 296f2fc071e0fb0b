//! Operators on one record: play, low pass, time shift, mean velocity, running maximum, cubic
//! B-splines.
//!
//! All are O(T) and start in equilibrium with the first sample. They are exact for commands that
//! are linear between samples, at any sample spacing. tests/model/test_families.py checks each
//! against an independent NumPy version.

use crate::effects::low_pass;

/// Apply the play operator `y = clamp(y, x − w, x + w)` of half width w, starting centred at y = x.
pub(super) fn play(x: &[f64], half_width: f64, out: &mut [f64]) {
    let mut y = x[0];
    for (x, out) in x.iter().zip(out) {
        y = y.max(x - half_width).min(x + half_width);
        *out = y;
    }
}

/// Dahl's element `dz = dx − |dx| z / reach`, starting at z = 0: a spring that slips the more the
/// longer it is.
///
/// Source: P. R. Dahl, A solid friction model, Aerospace Corporation TOR-158 (1968).
pub(super) fn dahl(x: &[f64], reach: f64, out: &mut [f64]) {
    let (mut z, mut before) = (0.0, x[0]);
    for (x, out) in x.iter().zip(out) {
        let moved = x - before;
        let limit = reach.copysign(moved);
        z = limit + (z - limit) * (-moved.abs() / reach).exp();
        before = *x;
        *out = z;
    }
}

/// Apply the low pass `tau·y' = x − y`, starting at y = x.
pub(super) fn pole(x: &[f64], dt: &[f64], tau: f64, out: &mut [f64]) {
    let (mut y, mut before) = (x[0], x[0]);
    let (mut last, mut weights) = (0.0, [1.0, 0.0, 0.0]);
    for ((x, dt), out) in x.iter().zip(dt).zip(out) {
        // Most records are sampled evenly: recompute the weights only when the period changes.
        if *dt != last {
            (last, weights) = (*dt, low_pass(tau, *dt));
        }
        y = weights[0] * y + (weights[1] * before + weights[2] * x);
        before = *x;
        *out = y;
    }
}

/// Shift in time: `x(t − late)`, linear between samples and held beyond both ends. `late` may be
/// negative.
pub(super) fn shifted(x: &[f64], t: &[f64], late: f64, out: &mut [f64]) {
    let last = t.len() - 1;
    let mut k = 0;
    for (now, out) in t.iter().zip(out) {
        let wanted = now - late;
        while k < last && t[k + 1] <= wanted {
            k += 1;
        }
        *out = if k == last || wanted <= t[0] {
            x[k]
        } else {
            x[k] + (wanted - t[k]) / (t[k + 1] - t[k]) * (x[k + 1] - x[k])
        };
    }
}

/// Mean velocity over a window of `window` s centred at each sample; the command rests beyond both
/// ends.
pub(super) fn velocity(x: &[f64], t: &[f64], window: f64) -> Vec<f64> {
    let (mut before, mut after) = (vec![0.0; x.len()], vec![0.0; x.len()]);
    shifted(x, t, 0.5 * window, &mut before);
    shifted(x, t, -0.5 * window, &mut after);
    for (after, before) in after.iter_mut().zip(before) {
        *after = (*after - before) / window;
    }
    after
}

/// Largest |x| of all channels.
pub(super) fn largest(x: &[Vec<f64>]) -> Vec<f64> {
    let mut most = vec![0.0; x.first().map_or(0, Vec::len)];
    for x in x {
        with(&mut most, x, |most, x| most.max(x.abs()));
    }
    most
}

/// Running maximum of x >= 0 that decays with time constant tau: `y = max(x, y e^(−dt/tau))`.
pub(super) fn leaking_most(x: &[f64], dt: &[f64], tau: f64, out: &mut [f64]) {
    let mut y = x[0];
    let (mut last, mut keeps) = (0.0, 1.0);
    for ((x, dt), out) in x.iter().zip(dt).zip(out) {
        if *dt != last {
            (last, keeps) = (*dt, (-dt / tau).exp());
        }
        y = x.max(keeps * y);
        *out = y;
    }
}

/// Running maximum of |x|.
pub(super) fn largest_so_far(x: &[f64]) -> Vec<f64> {
    let mut most: f64 = 0.0;
    let so_far = x.iter().map(|x| {
        most = most.max(x.abs());
        most
    });
    so_far.collect()
}

/// Cubic B-splines on equal intervals from `low` to `high`. They sum to 1, and are constant beyond
/// both ends.
pub(super) struct Spline {
    pub(super) low: f64,
    pub(super) high: f64,
    pub(super) intervals: usize,
}

/// Offset from the upper end, as a share of the range: the last interval is half open.
const INSIDE: f64 = 1e-9;

impl Spline {
    /// Number of splines.
    pub(super) fn count(&self) -> usize {
        self.intervals + 3
    }

    /// Evaluate spline `j` at `x`.
    pub(super) fn fill(&self, j: usize, x: &[f64], out: &mut [f64]) {
        let whole = self.high - self.low;
        let per = self.intervals as f64 / whole;
        let highest = self.high - INSIDE * whole;
        for (x, out) in x.iter().zip(out) {
            let place = (x.clamp(self.low, highest) - self.low) * per;
            *out = cubic(place + 3.0 - j as f64);
        }
    }
}

/// Cubic B-spline with knots 0, 1, 2, 3, 4.
fn cubic(s: f64) -> f64 {
    let side = |s: f64| s * s * s / 6.0;
    let inner = |s: f64| (1.0 + 3.0 * s * (1.0 + s * (1.0 - s))) / 6.0;
    match s {
        s if !(0.0..4.0).contains(&s) => 0.0,
        s if s < 1.0 => side(s),
        s if s < 2.0 => inner(s - 1.0),
        s if s < 3.0 => inner(3.0 - s),
        s => side(4.0 - s),
    }
}

/// Write `of(x)` for each sample to `out`.
pub(super) fn each(x: &[f64], out: &mut [f64], of: impl Fn(f64) -> f64) {
    for (x, out) in x.iter().zip(out) {
        *out = of(*x);
    }
}

/// Combine `column` with another record in place: `column[k] = by(column[k], other[k])`.
pub(super) fn with(column: &mut [f64], other: &[f64], by: impl Fn(f64, f64) -> f64) {
    for (column, other) in column.iter_mut().zip(other) {
        *column = by(*column, *other);
    }
}

/// N numbers from `first` to `last` in geometric progression.
pub(super) fn geometric<const N: usize>(first: f64, last: f64) -> [f64; N] {
    let ratio = (last / first).ln() / (N - 1) as f64;
    std::array::from_fn(|i| first * (ratio * i as f64).exp())
}
