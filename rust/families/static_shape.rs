//! Static shape: any shape that depends on the commands alone; what no other static family draws.

use super::declaration::*;
use super::series::Seen;

pub static FAMILY: Family = Family {
    name: "static shape",
    kind: Kind::Static,
    doc: "The shape is wrong in a way that depends on the commands alone, and that no command of this model could make.",
    mimics: &["static map", "coupling", "body", "frame"],
    members: &["contact"],
    modes: MODES,
    modulation: monomials,
    ..NOTHING
};

/// Spatial modes, the strongest first.
const MODES: usize = 8;
const DEGREE: usize = 3;
/// Up to so many channels products of the commands count; beyond, their number grows faster than what a run can tell.
const PRODUCTS: usize = 3;

/// The monomials of the commands up to cubic; above [`PRODUCTS`] channels the powers of each alone.
fn monomials(seen: &Seen, emit: Emit) {
    alone(seen, emit);
    let ones = vec![1.0; seen.share.len()];
    if seen.x.len() <= PRODUCTS {
        products(&seen.x, &ones, DEGREE, emit);
    } else {
        for channel in seen.x.chunks(1) {
            products(channel, &ones, DEGREE, emit);
        }
    }
}

/// Every product of up to `degree` of the channels with what is `before` them.
fn products(channels: &[Vec<f64>], before: &[f64], degree: usize, emit: Emit) {
    for (c, x) in channels.iter().enumerate() {
        let product: Vec<f64> = before.iter().zip(x).map(|(a, b)| a * b).collect();
        emit(&product);
        if degree > 1 {
            products(&channels[c..], &product, degree - 1, emit);
        }
    }
}
