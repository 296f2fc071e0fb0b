//! Coupling: the command of one channel moves the others too.
//!
//! `x_i = u_i + Σ_j factor_ij·u_j`, `j ≠ i`, without memory. Up to four channels, every ordered
//! pair has a factor. With more, only neighbours do (`Each::Pair`), because tendons run past their
//! neighbours; so the number of factors is linear in the channels. Limit: on a robot whose
//! neighbours have distant numbers, the other couplings are not modelled.

use super::conditions::Context;
use super::declaration::*;

pub static EFFECT: Effect = Effect {
    declaration: Declaration {
        name: "coupling",
        family: "actuation map",
        stage: Stage::Transmission,
        kind: Kind::Effect,
        formula: "x_i = u_i + Σ factor_ij · u_j,  j ≠ i",
        doc: "Each channel moves its neighbours: tendons that share a guide or cross, a routing \
              that is not square, pairs on one pulley.",
        signature: "Static motion off the axis that is commanded, in proportion to the command; \
            nothing at home.",
        reference: "Off-diagonal terms of the matrix A of the command calibration in the paper.",
        experiment: ("each channel alone, both signs, then diagonals", 1.5),
        alike: &[("routing", "never")],
        needs: &[],
        parameters: &[Parameter::new(
            "factor",
            "1",
            0.0,
            0.05,
            -0.5,
            0.5,
            "shortening of the first channel of the pair per shortening commanded of the second",
        )
        .per_pair()],
    },
    law: Law::Channel(&Coupling),
};

struct Coupling;

impl ChannelEffect for Coupling {
    /// Storage for the command before mixing, so a step allocates nothing.
    fn state_size(&self, channels: usize) -> usize {
        channels
    }

    fn settle(&self, params: &[f64], x: &mut [f64], state: &mut [f64]) {
        state.copy_from_slice(x);
        for ((i, j), factor) in pairs(x.len()).zip(params) {
            x[i] += factor * state[j];
        }
    }

    fn step(&self, params: &[f64], x: &mut [f64], state: &mut [f64], _context: &Context) {
        self.settle(params, x, state);
    }
}
