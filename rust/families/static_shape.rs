//! Static shape: any error of shape that is a function of the present commands; the most general
//! static family.

use super::declaration::*;
use super::series::Seen;

pub static FAMILY: Family = Family {
    name: "static shape",
    kind: Kind::Static,
    doc: "The shape error depends only on the present commands, but no command of this model \
        produces that shape.",
    mimics: &["static map", "coupling", "body", "frame"],
    members: &["contact"],
    modes: MODES,
    modulation: monomials,
    ..NOTHING
};

/// Leading spatial modes of the whitener.
const MODES: usize = 8;
const DEGREE: usize = 3;
/// Most channels for which products of commands are used: beyond, a run cannot identify so many
/// columns.
const PRODUCTS: usize = 3;

/// Monomials of the commands up to degree 3; only powers of each channel above [`PRODUCTS`]
/// channels.
fn monomials(seen: &Seen, emit: Emit) {
    constant(seen, emit);
    let ones = vec![1.0; seen.share.len()];
    if seen.x.len() <= PRODUCTS {
        products(&seen.x, &ones, DEGREE, emit);
    } else {
        for channel in seen.x.chunks(1) {
            products(channel, &ones, DEGREE, emit);
        }
    }
}

/// Emit all products of `before` with up to `degree` of the channels.
fn products(channels: &[Vec<f64>], before: &[f64], degree: usize, emit: Emit) {
    for (c, x) in channels.iter().enumerate() {
        let product: Vec<f64> = before.iter().zip(x).map(|(a, b)| a * b).collect();
        emit(&product);
        if degree > 1 {
            products(&channels[c..], &product, degree - 1, emit);
        }
    }
}
