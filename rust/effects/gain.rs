//! Gain: every command is scaled, as by a wrong spool radius or a tendon that stretches in
//! proportion.
//!
//! `x = factor·u`, per channel. No memory; the null factor is 1.

use super::conditions::Context;
use super::declaration::*;

pub static EFFECT: Effect = Effect {
    declaration: Declaration {
        name: "gain",
        family: "actuation map",
        stage: Stage::Command,
        kind: Kind::Effect,
        formula: "x = factor · u",
        doc: "Each command is scaled: the spool radius differs from the nominal one, or the tendon \
              stretches linearly. A finger of another modulus is hardly seen under servo \
              displacement and would hide here.",
        signature: "Static, odd in the command: nothing at home, growing with the bend, the same \
            in loading and unloading.",
        reference: "Linear map from servo angle to tendon shortening; the matrix A of the command \
            calibration in the paper.",
        experiment: ("full range, both signs, at least three levels", 1.0),
        alike: &[],
        needs: &[],
        parameters: &[Parameter::new(
            "factor",
            "1",
            1.0,
            1.05,
            0.5,
            1.6,
            "shortening that acts, over shortening commanded, of the channel",
        )
        .per_channel()],
    },
    law: Law::Channel(&Gain),
};

struct Gain;

impl ChannelEffect for Gain {
    fn settle(&self, params: &[f64], x: &mut [f64], _state: &mut [f64]) {
        x.iter_mut()
            .zip(params)
            .for_each(|(x, factor)| *x *= factor);
    }

    fn step(&self, params: &[f64], x: &mut [f64], state: &mut [f64], _context: &Context) {
        self.settle(params, x, state);
    }
}
