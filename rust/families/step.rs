//! Step: a permanent change at one instant of the run, such as a slipped anchor or a skipped tooth.

use super::declaration::*;
use super::series::Series;
use super::time::PLAUSIBLE;

pub static FAMILY: Family = Family {
    name: "step",
    kind: Kind::Time,
    doc: "The same command gives another shape before and after one instant.",
    experiment: (
        "the same moves several times, with home visited in between",
        4.0,
    ),
    mimics: &["temperature", "time", "load", "frame drift"],
    members: &["anchor_slip"],
    columns: Some(columns),
    ..NOTHING
};

const INSTANTS: usize = 16;
/// Share of the run before the first and after the last instant: both sides of a step must be
/// visible.
const EDGE: f64 = 0.06;

/// A step at each instant, alone, times x and, if the map is not free, times x²: one cable of a
/// pair may change. In mm.
fn columns(series: &Series, channel: usize, emit: Emit) {
    let most = PLAUSIBLE * series.half[channel];
    let x = &series.x[channel];
    let factors = [
        vec![1.0; series.samples()],
        x.clone(),
        x.iter().map(|x| x * x).collect(),
    ];
    let mut out = vec![0.0; series.samples()];
    for factor in &factors[..if series.free_map { 2 } else { 3 }] {
        for i in 0..INSTANTS {
            let instant = EDGE + (1.0 - 2.0 * EDGE) * i as f64 / (INSTANTS - 1) as f64;
            for ((out, share), factor) in out.iter_mut().zip(&series.share).zip(factor) {
                *out = if *share > instant { most * factor } else { 0.0 };
            }
            emit(&out);
        }
    }
}
