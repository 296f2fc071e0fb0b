//! Creep: under a held command the robot goes on moving, over seconds to minutes.

use super::declaration::*;
use super::operators::{pole, with};
use super::series::Series;

pub static FAMILY: Family = Family {
    name: "creep",
    kind: Kind::Memory,
    doc: "While a command is held the shape drifts, and after it the drift comes back slowly.",
    mimics: &["memory", "delay", "rate", "softening", "time"],
    members: &["creep", "tendon_creep"],
    columns: Some(columns),
    signals: Some(signals),
    ..NOTHING
};

/// s: any Prony series between is near a sum of these.
const POLES: [f64; 6] = [2.0, 5.0, 12.0, 30.0, 80.0, 200.0];
/// Of them, those that a run of minutes tells from a change of the static map that is learned with them.
const SIGNALS: usize = 5;

/// What has not followed yet, mm.
fn columns(series: &Series, channel: usize, emit: Emit) {
    let v = &series.v[channel];
    let mut out = vec![0.0; series.samples()];
    for tau in POLES {
        pole(v, &series.dt, tau, &mut out);
        with(&mut out, v, |slow, v| slow - v);
        emit(&out);
    }
}

fn signals(series: &Series, channel: usize, _wide: bool, emit: Emit) {
    let mut out = vec![0.0; series.samples()];
    for tau in &POLES[..SIGNALS] {
        pole(&series.x[channel], &series.dt, *tau, &mut out);
        emit(&out);
    }
}
