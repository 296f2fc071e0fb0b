//! Step: something changed at one instant of the run and stayed so (an anchor that slipped, a tooth that was skipped).

use super::declaration::*;
use super::series::Series;
use super::time::PLAUSIBLE;

pub static FAMILY: Family = Family {
    name: "step",
    kind: Kind::Time,
    doc: "Before and after one instant the same command gives another shape.",
    mimics: &["temperature", "time", "load"],
    members: &["anchor_slip"],
    columns: Some(columns),
    ..NOTHING
};

const INSTANTS: usize = 16;
/// Shares of the run that the first and last instant leave on either side: both must be seen.
const EDGE: f64 = 0.06;

/// After each instant 1, and x, mm.
fn columns(series: &Series, channel: usize, emit: Emit) {
    let most = PLAUSIBLE * series.half[channel];
    let ones = vec![1.0; series.samples()];
    let mut out = ones.clone();
    for factor in [&ones, &series.x[channel]] {
        for i in 0..INSTANTS {
            let instant = EDGE + (1.0 - 2.0 * EDGE) * i as f64 / (INSTANTS - 1) as f64;
            for ((out, share), factor) in out.iter_mut().zip(&series.share).zip(factor) {
                *out = if *share > instant { most * factor } else { 0.0 };
            }
            emit(&out);
        }
    }
}
