//! Time: offset or gain changes slowly during the run, independent of the commands.

use super::declaration::*;
use super::operators::Spline;
use super::series::Series;

pub static FAMILY: Family = Family {
    name: "time",
    kind: Kind::Time,
    doc: "The same command gives another shape later in the run: a slow drift of offset or gain.",
    experiment: (
        "the same moves twice, with a rest of 5 minutes at home in between",
        9.0,
    ),
    mimics: &[
        "creep",
        "softening",
        "temperature",
        "step",
        "load",
        "frame drift",
    ],
    members: &["zero_drift", "tendon_creep"],
    columns: Some(columns),
    signals: Some(signals),
    ..NOTHING
};

/// Intervals over the run: faster changes do not count as slow drift.
const INTERVALS: usize = 5;
/// The same for signals.
const SIGNAL_INTERVALS: usize = 4;
/// Scale of the columns, as a share of the half range: a plausible size of the effect. Shared with
/// steps and orientations.
pub(super) const PLAUSIBLE: f64 = 0.3;

/// Cubic B-splines of time, alone and times x, mm.
fn columns(series: &Series, channel: usize, emit: Emit) {
    let most = PLAUSIBLE * series.half[channel];
    splines(series, channel, INTERVALS, most, emit);
}

fn signals(series: &Series, channel: usize, _wide: bool, emit: Emit) {
    splines(series, channel, SIGNAL_INTERVALS, 1.0, emit);
}

fn splines(series: &Series, channel: usize, intervals: usize, most: f64, emit: Emit) {
    let spline = Spline {
        low: 0.0,
        high: 1.0,
        intervals,
    };
    let ones = vec![1.0; series.samples()];
    let mut out = ones.clone();
    for factor in [&ones, &series.x[channel]] {
        for j in 0..spline.count() {
            spline.fill(j, &series.share, &mut out);
            let pairs = out.iter_mut().zip(factor);
            pairs.for_each(|(out, factor)| *out *= most * factor);
            emit(&out);
        }
    }
}
