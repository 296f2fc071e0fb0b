//! Offset: every command is shifted by a constant, as after a wrong home or a pre-tensioned tendon.
//!
//! `x = u + shift`, mm, per channel. No memory, no limits.

use super::conditions::Context;
use super::declaration::*;

pub static EFFECT: Effect = Effect {
    declaration: Declaration {
        name: "offset",
        family: "actuation map",
        stage: Stage::Command,
        kind: Kind::Effect,
        formula: "x = u + shift",
        doc: "A constant shift of each command: a wrong home position, a pre-tensioned or re-tied \
            tendon.",
        signature: "Static, and there at home too: the finger is bent where the model says \
            straight.",
        reference: "Home offset of a tendon drive; the constant term b of the command calibration \
            in the paper.",
        experiment: ("home and both signs of every channel", 1.0),
        alike: &[],
        needs: &[],
        parameters: &[Parameter::new(
            "shift",
            "mm",
            0.0,
            0.5,
            -4.0,
            4.0,
            "shortening added to the command of the channel",
        )
        .per_channel()],
    },
    law: Law::Channel(&Offset),
};

struct Offset;

impl ChannelEffect for Offset {
    fn settle(&self, params: &[f64], x: &mut [f64], _state: &mut [f64]) {
        x.iter_mut().zip(params).for_each(|(x, shift)| *x += shift);
    }

    fn step(&self, params: &[f64], x: &mut [f64], state: &mut [f64], _context: &Context) {
        self.settle(params, x, state);
    }
}
