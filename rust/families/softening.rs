//! Softening: below the largest command so far the robot bends further than on the first way out (Mullins).
//!
//! With M the largest |u| so far: u (1 − exp(−(M − |u|)/d)) and u (M − |u|). All vanish on first loading. Source: the form of
//! Ogden and Roxburgh's damage, as in rust/effects/mullins.rs, of each channel by itself.

use super::declaration::*;
use super::operators::largest_so_far;
use super::series::Series;

pub static FAMILY: Family = Family {
    name: "softening",
    kind: Kind::Memory,
    doc: "After a large command all smaller ones bend the robot further than before it.",
    mimics: &["creep", "time"],
    members: &["mullins"],
    columns: Some(columns),
    signals: Some(signals),
    ..NOTHING
};

/// d, in half ranges.
const REACHES: [f64; 2] = [0.15, 0.5];

/// mm.
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
