//! Delay: the robot follows the command late, by a dead time or rounded by a lag of up to a second.

use super::declaration::*;
use super::operators::{pole, shifted, with};
use super::series::Series;

pub static FAMILY: Family = Family {
    name: "delay",
    kind: Kind::Memory,
    doc: "The robot follows its command late, so the error grows with speed and vanishes at rest.",
    mimics: &["memory", "rate", "creep"],
    members: &["latency", "lag", "rate_limit", "clock_shift"],
    columns: Some(columns),
    signals: Some(signals),
    ..NOTHING
};

/// s; negative where the clocks differ and the frames are stamped late.
const SHIFTS: [f64; 9] = [-0.2, -0.1, 0.05, 0.1, 0.15, 0.2, 0.3, 0.4, 0.6];
const POLES: [f64; 4] = [0.08, 0.2, 0.5, 1.0];
/// The same where the static map is learned too: an earlier command is then no question of clocks.
const SIGNAL_SHIFTS: [f64; 5] = [0.05, 0.1, 0.2, 0.35, 0.6];
const SIGNAL_POLES: [f64; 5] = [0.08, 0.2, 0.5, 1.0, 2.0];

/// Late commands minus the command, mm.
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
