//! One-sided stiffness: the body is stiffer towards one side of its section.
//!
//! `ln E = ln E₀ + (x·X + y·Y)/R`, X and Y the position in the section and R the largest distance
//! of the body from its axis. The coefficients of the fields stiff_x and stiff_y are x and y.
//! Limit: second order (`second.rs`); fields alone are 6 % off at ±20 % (rust/fem/sweep_tests.rs).

use super::conditions::Context;
use super::declaration::*;

pub static EFFECT: Effect = Effect {
    declaration: Declaration {
        name: "one_sided_stiffness",
        family: "body stiffness",
        stage: Stage::Shape,
        kind: Kind::Effect,
        formula: "ln E = ln E₀ + (x · X + y · Y)/R  on stiff_x, stiff_y",
        doc: "One side of the body is stiffer: filler that settled on its side, a seam of the \
            mould, a strip of tape.",
        signature: "Static and even in the command: with every pull the body gets shorter on the \
            soft side and leans that way.",
        reference: "Field of the simulator: one assembly of the residual with the changed design \
            and one back-substitution; tensions by complementarity.",
        experiment: ("both signs of every channel, at least three levels", 1.0),
        alike: &[],
        needs: &[],
        parameters: &[
            Parameter::new(
                "x",
                "1",
                0.0,
                0.2,
                -1.6,
                1.6,
                "logarithm of the modulus at the +x side over that at the axis",
            ),
            Parameter::new(
                "y",
                "1",
                0.0,
                0.2,
                -1.6,
                1.6,
                "logarithm of the modulus at the +y side over that at the axis",
            ),
        ],
    },
    law: Law::Shape(&OneSidedStiffness),
};

struct OneSidedStiffness;

impl ShapeEffect for OneSidedStiffness {
    fn fields(&self, _channels: usize) -> Vec<usize> {
        vec![ACROSS, ACROSS + 1]
    }

    fn add(&self, params: &[f64], _u: &[f64], _context: &Context, out: &mut Coefficients) {
        out[ACROSS] += params[0];
        out[ACROSS + 1] += params[1];
    }
}
