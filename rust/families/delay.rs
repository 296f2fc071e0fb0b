//! Delay: the robot follows its command late, by a dead time or by a first-order lag of up to one
//! second.

use super::declaration::*;
use super::operators::{pole, shifted, with};
use super::series::Series;

pub static FAMILY: Family = Family {
    name: "delay",
    kind: Kind::Memory,
    doc: "The robot follows its command late: the error grows with speed and vanishes at rest.",
    experiment: ("the same triangles at two speeds, slow and fast", 2.0),
    mimics: &["memory", "rate", "creep"],
    members: &["latency", "lag", "rate_limit", "clock_shift"],
    columns: Some(columns),
    signals: Some(signals),
    ..NOTHING
};

/// s. Negative shifts cover frames with late time stamps.
const SHIFTS: [f64; 9] = [-0.2, -0.1, 0.05, 0.1, 0.15, 0.2, 0.3, 0.4, 0.6];
const POLES: [f64; 4] = [0.08, 0.2, 0.5, 1.0];
/// The same for signals.
const SIGNAL_SHIFTS: [f64; 5] = [0.05, 0.1, 0.2, 0.35, 0.6];
const SIGNAL_POLES: [f64; 5] = [0.08, 0.2, 0.5, 1.0, 2.0];

/// Delayed command minus command, mm.
fn columns(series: &Series, channel: usize, emit: Emit) {
    let v = &series.v[channel];
    late(series, v, &SHIFTS, &POLES, &mut |late| {
        let mut out = late.to_vec();
        with(&mut out, v, |late, v| late - v);
        emit(&out);
    });
}

fn signals(series: &Series, channel: usize, _wide: bool, emit: Emit) {
    let x = &series.x[channel];
    late(series, x, &SIGNAL_SHIFTS, &SIGNAL_POLES, emit);
}

fn late(series: &Series, x: &[f64], shifts: &[f64], poles: &[f64], emit: Emit) {
    let mut out = vec![0.0; series.samples()];
    for late in shifts {
        shifted(x, &series.t, *late, &mut out);
        emit(&out);
    }
    for tau in poles {
        pole(x, &series.dt, *tau, &mut out);
        emit(&out);
    }
}
