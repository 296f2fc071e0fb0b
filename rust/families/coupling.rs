//! Coupling: the effective command of a channel depends on the commands of the other channels.

use super::declaration::*;
use super::series::Series;

pub static FAMILY: Family = Family {
    name: "coupling",
    kind: Kind::Static,
    doc: "One channel also moves the others: the error is static and appears off the commanded \
        axis.",
    experiment: ("each channel alone, then the channels together", 2.0),
    mimics: &["static map", "body", "static shape"],
    members: &["coupling", "routing"],
    columns: Some(columns),
    ..NOTHING
};

/// Most channels for which powers and products are used: beyond, a run cannot identify so many
/// columns.
const PRODUCTS: usize = 3;

/// y, y², y(5y² − 3)/2, xy, x²y, xy², |y| and x|y| for every other channel y, mm; only y above
/// [`PRODUCTS`] channels.
fn columns(series: &Series, channel: usize, emit: Emit) {
    let (x, half) = (&series.x[channel], series.half[channel]);
    let terms: &[fn(f64, f64) -> f64] = &[
        |_, y| y,
        |_, y| y * y,
        |_, y| 0.5 * y * (5.0 * y * y - 3.0), // not y³, which is nearly y
        |x, y| x * y,
        |x, y| x * x * y,
        |x, y| x * y * y,
        |_, y| y.abs(),
        |x, y| x * y.abs(),
    ];
    let count = if series.channels() <= PRODUCTS {
        terms.len()
    } else {
        1
    };
    let mut out = vec![0.0; series.samples()];
    let others = series.x.iter().enumerate();
    for (_, y) in others.filter(|(other, _)| *other != channel) {
        for term in &terms[..count] {
            for ((out, x), y) in out.iter_mut().zip(x).zip(y) {
                *out = half * term(*x, *y);
            }
            emit(&out);
        }
    }
}
