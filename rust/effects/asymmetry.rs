//! Asymmetry: a pull of one sign bends more than the same pull of the other.
//!
//! `y = x·(1 + excess·sign(x))`, per channel, without memory; continuous, with a kink at zero. To
//! first order, it is the part of a static map that is even in the command, which gain and offset
//! cannot represent.

use super::conditions::Context;
use super::declaration::*;

pub static EFFECT: Effect = Effect {
    declaration: Declaration {
        name: "asymmetry",
        family: "actuation map",
        stage: Stage::Material,
        kind: Kind::Effect,
        formula: "y = x · (1 + excess · sign(x))",
        doc: "The body or its pair of tendons is not the same on both sides: a wall of another \
              thickness, guides at unequal distances.",
        signature: "Static and even in the command: too much bend on one side, too little on the \
            other, nothing at home.",
        reference: "Even part of a static map, by its piecewise linear form.",
        experiment: ("both signs of every channel, at least three levels", 1.0),
        alike: &[],
        needs: &[],
        parameters: &[Parameter::new(
            "excess",
            "1",
            0.0,
            0.08,
            -0.4,
            0.4,
            "relative surplus of positive commands, and lack of negative ones",
        )
        .per_channel()],
    },
    law: Law::Channel(&Asymmetry),
};

struct Asymmetry;

impl ChannelEffect for Asymmetry {
    fn settle(&self, params: &[f64], x: &mut [f64], _state: &mut [f64]) {
        x.iter_mut()
            .zip(params)
            .for_each(|(x, excess)| *x += excess * x.abs());
    }

    fn step(&self, params: &[f64], x: &mut [f64], state: &mut [f64], _context: &Context) {
        self.settle(params, x, state);
    }
}
