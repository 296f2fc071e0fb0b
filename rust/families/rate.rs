//! Rate: the error depends on the present velocity of the command (viscous, quadratic and cubic
//! terms).

use super::declaration::*;
use super::operators::{each, velocity};
use super::series::Series;

pub static FAMILY: Family = Family {
    name: "rate",
    kind: Kind::Memory,
    doc: "The shape at a command depends on the present speed and its sign, as in a viscous \
        damper.",
    experiment: ("the same triangles at three speeds", 2.0),
    mimics: &["memory", "delay", "creep"],
    columns: Some(columns),
    signals: Some(signals),
    ..NOTHING
};

/// Averaging window of the velocity, s: about the response time of a servo.
const WINDOW: f64 = 0.1;
/// Velocity below which a channel counts as still, half ranges per second.
const STILL: f64 = 1e-9;
/// Scale of the columns at the highest velocity, as a share of the half range: a plausible size of
/// the effect.
const PLAUSIBLE: f64 = 0.3;

/// v, v|v|, v³ and v|x|, with v the velocity divided by its maximum; mm.
fn columns(series: &Series, channel: usize, emit: Emit) {
    let (x, most) = (&series.x[channel], PLAUSIBLE * series.half[channel]);
    let v = relative(series, channel);
    let mut out = vec![0.0; series.samples()];
    let powers: [fn(f64) -> f64; 3] = [|v| v, |v| v * v.abs(), |v| v * v * v];
    for power in powers {
        each(&v, &mut out, |v| most * power(v));
        emit(&out);
    }
    product(&v, x, &mut out, |v, x| most * v * x.abs());
    emit(&out);
}

/// v, v|v|, v³, vx, vx², v².
fn signals(series: &Series, channel: usize, _wide: bool, emit: Emit) {
    let (x, v) = (&series.x[channel], relative(series, channel));
    let mut out = vec![0.0; series.samples()];
    let terms: [fn(f64, f64) -> f64; 6] = [
        |v, _| v,
        |v, _| v * v.abs(),
        |v, _| v * v * v,
        |v, x| v * x,
        |v, x| v * x * x,
        |v, _| v * v,
    ];
    for term in terms {
        product(&v, x, &mut out, term);
        emit(&out);
    }
}

fn product(v: &[f64], x: &[f64], out: &mut [f64], of: impl Fn(f64, f64) -> f64) {
    for ((out, v), x) in out.iter_mut().zip(v).zip(x) {
        *out = of(*v, *x);
    }
}

/// Velocity of a channel, divided by its maximum over the run.
fn relative(series: &Series, channel: usize) -> Vec<f64> {
    let mut v = velocity(&series.x[channel], &series.t, WINDOW);
    let most = v.iter().fold(STILL, |most, v| v.abs().max(most));
    v.iter_mut().for_each(|v| *v /= most);
    v
}
