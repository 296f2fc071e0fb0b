//! Frame drift: the sensor moves relative to the robot's base during the run, slowly or at one
//! instant.

use super::declaration::*;
use super::operators::{Spline, each};
use super::series::Seen;

pub static FAMILY: Family = Family {
    name: "frame drift",
    kind: Kind::Time,
    doc: "The clamped base appears to move during the run, slowly or at once: a camera or a mount \
        drifts or is hit.",
    experiment: (
        "home revisited every minute, with points near the base",
        4.0,
    ),
    mimics: &["time", "step"],
    members: &["camera_drift"],
    fields: &["mount"],
    modulation: moves,
    ..NOTHING
};

const INTERVALS: usize = 3;
const INSTANTS: usize = 8;

/// Cubic B-splines of time, and steps at some instants.
fn moves(seen: &Seen, emit: Emit) {
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
    for i in 1..=INSTANTS {
        let instant = i as f64 / (INSTANTS + 1) as f64;
        each(&seen.share, &mut out, |share| f64::from(share > instant));
        emit(&out);
    }
}
