//! Temperature: the error follows the temperature declared in the run.

use super::declaration::*;
use super::operators::{each, pole};
use super::series::Series;

pub static FAMILY: Family = Family {
    name: "temperature",
    kind: Kind::Condition,
    doc: "The same command gives another shape at another temperature: softer material or longer \
        tendons.",
    needs: &["temperature"],
    experiment: (
        "the same moves while it warms up and while it cools down, temperature recorded",
        15.0,
    ),
    mimics: &["time", "step"],
    members: &["thermal_softening", "gain"],
    columns: Some(columns),
    ..NOTHING
};

/// Smallest temperature range, °C: less is sensor noise.
const LEAST: f64 = 0.5;
/// Scale of the columns 1 and x, as a share of the half range: the unknown reference temperature
/// makes an offset and a gain.
const REFERENCE: f64 = 0.3;

/// Time constants of a body that follows the temperature late, s; of creep whose strength follows
/// the temperature, s.
const LATE: [f64; 2] = [30.0, 100.0];
const CREEP: [f64; 2] = [5.0, 30.0];

/// z, zx, z²x, zx|x|, zx², z², 1, x, pole(z), pole(z)x and z(pole(x) − x), with z = (temperature −
/// mean)/range; mm. The reference temperature is unknown, hence 1 and x.
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
    let terms: [fn(f64, f64) -> f64; 8] = [
        |z, _| z,
        |z, x| z * x,
        |z, x| z * z * x,
        |z, x| z * x * x.abs(),
        |z, x| z * x * x,
        |z, _| z * z,
        |_, _| REFERENCE,
        |_, x| REFERENCE * x,
    ];
    let mut out = vec![0.0; series.samples()];
    for term in terms {
        for ((out, t), x) in out.iter_mut().zip(temperature).zip(x) {
            *out = half * term((t - mean) / (high - low), *x);
        }
        emit(&out);
    }
    let z: Vec<f64> = temperature
        .iter()
        .map(|t| (t - mean) / (high - low))
        .collect();
    let mut passed = vec![0.0; z.len()];
    for tau in LATE {
        pole(&z, &series.dt, tau, &mut passed);
        each(&passed, &mut out, |late| half * late);
        emit(&out);
        for ((out, late), x) in out.iter_mut().zip(&passed).zip(x) {
            *out = half * late * x;
        }
        emit(&out);
    }
    for tau in CREEP {
        pole(x, &series.dt, tau, &mut passed);
        for (((out, crept), x), z) in out.iter_mut().zip(&passed).zip(x).zip(&z) {
            *out = half * z * (crept - x);
        }
        emit(&out);
    }
}
