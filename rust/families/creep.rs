//! Creep: the robot keeps moving under a constant command, over seconds to minutes.

use super::declaration::*;
use super::operators::{largest, leaking_most, pole, with};
use super::series::Series;

pub static FAMILY: Family = Family {
    name: "creep",
    kind: Kind::Memory,
    doc: "The shape drifts while a command is held, and recovers slowly afterwards.",
    experiment: (
        "a staircase with rests of 7 s on each step, then the same steps without rests",
        3.0,
    ),
    mimics: &["memory", "delay", "rate", "softening", "time"],
    members: &["creep", "tendon_creep"],
    columns: Some(columns),
    signals: Some(signals),
    ..NOTHING
};

/// Time constants, s: close enough together to represent any Prony series in their range.
const POLES: [f64; 6] = [2.0, 5.0, 12.0, 30.0, 80.0, 200.0];
/// Number of time constants used as signals: a run of minutes cannot distinguish the slowest from
/// the static map.
const SIGNALS: usize = 5;

/// Time constants of the stretch of single cables, s.
const CABLES: [f64; 3] = [10.0, 30.0, 90.0];

/// Time constants in which the largest stroke is forgotten, s.
const STROKES: [f64; 3] = [4.0, 12.0, 36.0];

/// Low-passed command minus command, mm. If the map is not free: also the remainder of the largest
/// stroke of all channels beyond the present one, as in a recovering material; and the lost motion
/// of each cable of a pair while it pulls.
fn columns(series: &Series, channel: usize, emit: Emit) {
    let v = &series.v[channel];
    let mut out = vec![0.0; series.samples()];
    for tau in POLES {
        pole(v, &series.dt, tau, &mut out);
        with(&mut out, v, |slow, v| slow - v);
        emit(&out);
    }
    if series.free_map {
        return;
    }
    let half = series.half[channel];
    let stroke = largest(&series.x);
    for tau in STROKES {
        leaking_most(&stroke, &series.dt, tau, &mut out);
        with(&mut out, &stroke, |most, now| half * (most - now));
        emit(&out);
    }
    for side in [1.0, -1.0] {
        let pulled: Vec<f64> = v.iter().map(|v| (side * v).max(0.0)).collect();
        for tau in CABLES {
            pole(&pulled, &series.dt, tau, &mut out);
            with(&mut out, &pulled, |slow, pull| {
                side * f64::from(pull > 0.0) * (slow - pull)
            });
            emit(&out);
        }
    }
}

fn signals(series: &Series, channel: usize, _wide: bool, emit: Emit) {
    let mut out = vec![0.0; series.samples()];
    for tau in &POLES[..SIGNALS] {
        pole(&series.x[channel], &series.dt, *tau, &mut out);
        emit(&out);
    }
}
