//! An antagonist pair with lengthened cables: the effect of anchor slip and tendon creep on a
//! command.
//!
//! Cables only pull. With a and b ≥ 0 the extra lengths of the cable that +x pulls and of the one
//! that −x pulls: hanging loose, x > a: x − a; x < −b: x + b; between, neither pulls: 0, a dead
//! zone; held taut, or where cables take compression: x − a + b, the full channel is shifted, and
//! `taut` is the share of the latter. Continuous and monotone in x for `taut` from 0 to 1. mm.

use super::declaration::Parameter;

/// The parameter for the tautness of a pair, with its `doc`.
pub(super) const fn taut(doc: &'static str) -> Parameter {
    Parameter::new("taut", "1", 0.5, 0.5, 0.0, 1.0, doc)
}

/// The part of a command `x` that reaches the body.
#[inline]
pub(super) fn lengthened(x: f64, [a, b]: [f64; 2], taut: f64) -> f64 {
    x - (taut * (a - b) + (1.0 - taut) * x.max(-b).min(a))
}
