//! Frame drift: the sensor moves slowly relative to the robot's base during the run.

use super::declaration::*;
use super::operators::Spline;
use super::series::Seen;

pub static FAMILY: Family = Family {
    name: "frame drift",
    kind: Kind::Time,
    doc: "The clamped base appears to move slowly during the run: camera or mount drift.",
    experiment: (
        "home revisited every minute, with points near the base",
        4.0,
    ),
    mimics: &["time"],
    members: &["camera_drift"],
    fields: &["mount"],
    modulation: splines,
    ..NOTHING
};

const INTERVALS: usize = 3;

/// Cubic B-splines of time.
fn splines(seen: &Seen, emit: Emit) {
    let spline = Spline {
        low: 0.0,
        high: 1.0,
        intervals: INTERVALS,
    };
    let mut out = vec![0.0; seen.share.len()];
    for j in 0..spline.count() {
        spline.fill(j, &seen.share, &mut out);
        emit(&out);
    }
}
