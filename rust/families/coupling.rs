//! Coupling: what a channel does depends on the commands of the others.

use super::declaration::*;
use super::series::Series;

pub static FAMILY: Family = Family {
    name: "coupling",
    kind: Kind::Static,
    doc: "One channel moves what belongs to another: the error is static and appears off the axis that is commanded.",
    mimics: &["static map", "body", "static shape"],
    members: &["coupling", "routing"],
    columns: Some(columns),
    ..NOTHING
};

/// Up to so many channels powers and products count; beyond, their number grows faster than what a run can tell.
const PRODUCTS: usize = 3;

/// Of every other channel y: y, y², y³, xy, x²y, xy², mm; above [`PRODUCTS`] channels y alone.
fn columns(series: &Series, channel: usize, emit: Emit) {
    let (x, half) = (&series.x[channel], series.half[channel]);
    let terms: &[fn(f64, f64) -> f64] = &[
        |_, y| y,
        |_, y| y * y,
        |_, y| y * y * y,
        |x, y| x * y,
        |x, y| x * x * y,
        |x, y| x * y * y,
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
