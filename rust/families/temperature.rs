//! Temperature: what the robot does follows the temperature that the run declares.

use super::declaration::*;
use super::series::Series;

pub static FAMILY: Family = Family {
    name: "temperature",
    kind: Kind::Condition,
    doc: "The same command gives another shape when it is warmer: a softer body, a longer tendon.",
    needs: &["temperature"],
    mimics: &["time", "step"],
    members: &["thermal_softening", "gain"],
    columns: Some(columns),
    ..NOTHING
};

/// °C that a run must span: less is the noise of a sensor.
const LEAST: f64 = 0.5;
/// Of the half range: the gain that a wrong reference temperature plausibly makes.
const REFERENCE: f64 = 0.3;

/// z, zx, z²x, zx|x|, z² and x itself (the reference temperature is not known), z the temperature about its mean over its
/// range, mm.
fn columns(series: &Series, channel: usize, emit: Emit) {
    let Some(temperature) = &series.temperature else {
        return;
    };
    let (low, high) = temperature
        .iter()
        .fold((f64::MAX, f64::MIN), |(low, high), t| {
            (low.min(*t), high.max(*t))
        });
    if high - low <= LEAST {
        return;
    }
    let mean = temperature.iter().sum::<f64>() / temperature.len() as f64;
    let (x, half) = (&series.x[channel], series.half[channel]);
    let terms: [fn(f64, f64) -> f64; 6] = [
        |z, _| z,
        |z, x| z * x,
        |z, x| z * z * x,
        |z, x| z * x * x.abs(),
        |z, _| z * z,
        |_, x| REFERENCE * x,
    ];
    let mut out = vec![0.0; series.samples()];
    for term in terms {
        for ((out, t), x) in out.iter_mut().zip(temperature).zip(x) {
            *out = half * term((t - mean) / (high - low), *x);
        }
        emit(&out);
    }
}
