//! Load: dead loads, own weight included, which change direction with the orientation of the base.

use super::declaration::*;
use super::series::Series;
use super::time::PLAUSIBLE;

pub static FAMILY: Family = Family {
    name: "load",
    kind: Kind::Static,
    doc: "Own weight or a payload bends the robot: the error changes with the orientation of the \
        base.",
    needs: &["gravity"],
    experiment: (
        "the same moves in two orientations, declared in the run",
        3.0,
    ),
    mimics: &["time", "step"],
    members: &["gravity", "payload"],
    columns: Some(columns),
    fields: &["gravity", "payload"],
    modulation: by_command,
    ..NOTHING
};

/// Most orientations with an indicator each: beyond, the base moves continuously.
const MOST: usize = 6;

/// Indicator of each orientation except the first, alone and times x and x², mm.
fn columns(series: &Series, channel: usize, emit: Emit) {
    let Some(orientation) = &series.orientation else {
        return;
    };
    if !(2..=MOST).contains(&series.orientations.len()) {
        return;
    }
    let most = PLAUSIBLE * series.half[channel];
    let mut out = vec![0.0; series.samples()];
    let terms: [fn(f64) -> f64; 3] = [|_| 1.0, |x| x, |x| x * x];
    for term in terms {
        for code in &series.orientations[1..] {
            let samples = out.iter_mut().zip(orientation).zip(&series.x[channel]);
            for ((out, now), x) in samples {
                *out = if now == code { most * term(*x) } else { 0.0 };
            }
            emit(&out);
        }
    }
}
