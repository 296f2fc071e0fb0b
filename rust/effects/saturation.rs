//! Saturation: the drive stops at limits that the model lacks.
//!
//! `x = min(max(u, −below), above)`, mm, without memory, for each channel; a limit of 0 or less is
//! none. The search starts inside the usual stroke, because a limit beyond all commands has no
//! slope. The limit of a one-sided drive is at up to two half ranges.

use super::conditions::Context;
use super::declaration::*;

pub static EFFECT: Effect = Effect {
    declaration: Declaration {
        name: "saturation",
        family: "actuation map",
        stage: Stage::Command,
        kind: Kind::Effect,
        formula: "x = min(max(u, −below), above)",
        doc: "The drive stops at a limit of its travel, of its window of ticks or of its torque: \
              what is commanded beyond does not happen.",
        signature: "Nothing up to a certain command; beyond it the finger stays where it is, on \
              one side or on both, however slow the move.",
        reference: "Saturating actuators: Tarbouriech and others, Stability and Stabilization of \
              Linear Systems with Saturating Actuators, Springer 2011.",
        experiment: (
            "triangles of growing size up to the largest command, both signs",
            1.0,
        ),
        alike: &[],
        needs: &[],
        parameters: &[
            Parameter::new(
                "above",
                "mm",
                0.0,
                8.0,
                1.0,
                25.0,
                "largest shortening that acts; 0 for none",
            )
            .shared()
            .reaching(Reach::HalfRanges(2.0)),
            Parameter::new(
                "below",
                "mm",
                0.0,
                8.0,
                1.0,
                25.0,
                "largest shortening of the other sign that acts; 0 for none",
            )
            .shared()
            .reaching(Reach::HalfRanges(2.0)),
        ],
    },
    law: Law::Channel(&Saturation),
};

struct Saturation;

impl ChannelEffect for Saturation {
    fn settle(&self, params: &[f64], x: &mut [f64], _state: &mut [f64]) {
        let limit = |value: f64| if value > 0.0 { value } else { f64::INFINITY };
        let (above, below) = params.split_at(x.len());
        for ((x, above), below) in x.iter_mut().zip(above).zip(below) {
            *x = x.min(limit(*above)).max(-limit(*below));
        }
    }

    fn step(&self, params: &[f64], x: &mut [f64], state: &mut [f64], _context: &Context) {
        self.settle(params, x, state);
    }
}
