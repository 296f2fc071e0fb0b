//! Twist: body and tendons are twisted along their length at rest.
//!
//! A uniform twist of `angle` degrees at the tip, tendons included: the coefficient of the field
//! twist (displacement per 1°). Points roll about the middle line, and the body bends out of the
//! plane of its tendons towards the tip. Limit: linear; 5 % off at 6°, where chord and arc differ
//! (rust/fem/sweep_tests.rs).

use super::conditions::Context;
use super::declaration::*;

pub static EFFECT: Effect = Effect {
    declaration: Declaration {
        name: "twist",
        family: "rest shape",
        stage: Stage::Shape,
        kind: Kind::Effect,
        formula: "roll at s = angle · s  on twist",
        doc: "The body was cast or clamped with a twist: its channels run as a steep screw.",
        signature: "Points roll about the body's axis, more towards the tip, at home too; bent, \
            the tip leaves the plane of the pulled tendon.",
        reference: "Field of the simulator: one assembly of the residual with the changed design \
            and one back-substitution; tensions by complementarity.",
        experiment: ("points on the skin all along the body, full range", 1.0),
        alike: &[],
        needs: &[],
        parameters: &[Parameter::new(
            "angle",
            "deg",
            0.0,
            4.0,
            -20.0,
            20.0,
            "roll of the tip about the axis at rest",
        )],
    },
    law: Law::Shape(&Twist),
};

struct Twist;

impl ShapeEffect for Twist {
    fn fields(&self, _channels: usize) -> Vec<usize> {
        vec![TWIST]
    }

    fn add(&self, params: &[f64], _u: &[f64], _context: &Context, out: &mut Coefficients) {
        out[TWIST] += params[0];
    }
}
