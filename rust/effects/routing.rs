//! Routing: the guides of all tendons sit turned about the axis, so that every pull points elsewhere.
//!
//! The pull of all channels together turns by `phase` about the axis of the body. Two channels are pairs along x and y:
//! `x = R(phase)·u`. Three are tendons at 120° in this order: `x_i = m + (u_i − m)·cos(phase) + (u_{i−1} −
//! u_{i+1})·sin(phase)/√3` with the mean `m`. Any other number of channels says nothing about where its tendons run,
//! and is left as it is: not testable. To first order the antisymmetric part of `coupling`. Limit: a turn of guides as
//! a whole; one tendon alone is `coupling`.

use super::conditions::Context;
use super::declaration::*;

pub static EFFECT: Effect = Effect {
    declaration: Declaration {
        name: "routing",
        family: "actuation map",
        stage: Stage::Transmission,
        kind: Kind::Effect,
        formula: "x = R(phase) · u  for two pairs along x and y, or three tendons at 120°",
        doc: "The guides, or the finger in its clamp, are turned about the axis against the pulls that the model \
              knows.",
        signature: "Static: every bend points to one side of where it should, by one angle, whatever its size.",
        reference: "Pull of a tendon by its place in the section: Camarillo and others, IEEE Trans. Robotics 24 (2008) 1262.",
        experiment: ("each channel alone, both signs, then diagonals", 1.5),
        alike: &[("coupling", "never")],
        needs: &[],
        parameters: &[Parameter::new(
            "phase",
            "deg",
            0.0,
            6.0,
            -30.0,
            30.0,
            "turn of all pulls about the axis, from x to y",
        )],
    },
    law: Law::Channel(&Routing),
};

struct Routing;

impl ChannelEffect for Routing {
    fn settle(&self, params: &[f64], x: &mut [f64], _state: &mut [f64]) {
        let (sin, cos) = params[0].to_radians().sin_cos();
        match x {
            [x, y] => (*x, *y) = (cos * *x - sin * *y, sin * *x + cos * *y),
            [a, b, c] => {
                let (mean, side) = ((*a + *b + *c) / 3.0, sin / 3.0_f64.sqrt());
                let turned = |own: f64, before: f64, after: f64| {
                    own - (1.0 - cos) * (own - mean) + side * (before - after)
                };
                (*a, *b, *c) = (turned(*a, *c, *b), turned(*b, *a, *c), turned(*c, *b, *a));
            }
            _ => {}
        }
    }

    fn step(&self, params: &[f64], x: &mut [f64], state: &mut [f64], _context: &Context) {
        self.settle(params, x, state);
    }
}
