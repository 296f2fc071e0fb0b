//! Softening: the robot bends further below the largest command so far than on first loading
//! (Mullins effect).
//!
//! With M the running maximum of |u|: u (1 − exp(−(M − |u|)/d)) and u (M − |u|). All columns vanish
//! on first loading. Source: Ogden and Roxburgh's damage, as in rust/effects/mullins.rs, applied to
//! each channel separately.

use super::declaration::*;
use super::operators::largest_so_far;
use super::series::Series;

pub static FAMILY: Family = Family {
    name: "softening",
    kind: Kind::Memory,
    doc: "After a large bend, smaller commands bend the robot further than before.",
    experiment: (
        "small moves, then the full range, then the same small moves",
        3.0,
    ),
    mimics: &["creep", "time"],
    members: &["mullins"],
    columns: Some(columns),
    signals: Some(signals),
    ..NOTHING
};

/// Distances d, in half ranges.
const REACHES: [f64; 2] = [0.15, 0.5];

/// Columns in mm.
fn columns(series: &Series, channel: usize, emit: Emit) {
    softer(&series.v[channel], series.half[channel], emit);
}

fn signals(series: &Series, channel: usize, _wide: bool, emit: Emit) {
    softer(&series.x[channel], 1.0, emit);
}

fn softer(u: &[f64], half: f64, emit: Emit) {
    let most = largest_so_far(u);
    let mut out = vec![0.0; u.len()];
    let mut column = |of: &dyn Fn(f64) -> f64| {
        for ((out, u), most) in out.iter_mut().zip(u).zip(&most) {
            *out = u * of((most - u.abs()) / half);
        }
        emit(&out);
    };
    for reach in REACHES {
        column(&|below| -(-below / reach).exp_m1());
    }
    column(&|below| below);
}
