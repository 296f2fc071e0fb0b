//! Static map: a memoryless error in the map from command to effective command, each channel on its
//! own.

use super::declaration::*;
use super::operators::Spline;
use super::series::Series;

pub static FAMILY: Family = Family {
    name: "static map",
    kind: Kind::Static,
    doc: "Each channel has a wrong but repeatable scale: gain, offset, dead zone or a non-linear \
        map of the command.",
    experiment: (
        "each channel to its full range in fine steps, from both sides",
        2.0,
    ),
    mimics: &["coupling", "body", "static shape"],
    members: &[
        "gain",
        "offset",
        "asymmetry",
        "dead_zone",
        "saturation",
        "tendon_stretch",
        "eccentric_pulley",
        "slack",
    ],
    columns: Some(columns),
    signals: Some(signals),
    ..NOTHING
};

const INTERVALS: usize = 9;
/// In half ranges, slightly more than the commanded range.
const REACH: f64 = 1.02;
/// The same for signals: a validation run may have a slightly larger range.
const SIGNAL_REACH: f64 = 1.05;

/// Cubic B-splines of x, mm.
fn columns(series: &Series, channel: usize, emit: Emit) {
    let half = series.half[channel];
    splines(series, channel, REACH, &mut |spline| {
        emit(&spline.iter().map(|b| half * b).collect::<Vec<f64>>());
    });
}

fn signals(series: &Series, channel: usize, _wide: bool, emit: Emit) {
    splines(series, channel, SIGNAL_REACH, emit);
}

fn splines(series: &Series, channel: usize, reach: f64, emit: Emit) {
    let spline = Spline {
        low: -reach,
        high: reach,
        intervals: INTERVALS,
    };
    let mut out = vec![0.0; series.samples()];
    for j in 0..spline.count() {
        spline.fill(j, &series.x[channel], &mut out);
        emit(&out);
    }
}
