//! Pre-curve: the body is curved at rest.
//!
//! Body and tendons lie on a uniform arc with its tip (x, y) mm aside: the coefficients of the
//! fields curve_x and curve_y (displacement per 1 mm). Limit: linear; 2 % off at 2 mm
//! (rust/fem/sweep_tests.rs).

use super::conditions::Context;
use super::declaration::*;

pub static EFFECT: Effect = Effect {
    declaration: Declaration {
        name: "pre_curve",
        family: "rest shape",
        stage: Stage::Shape,
        kind: Kind::Effect,
        formula: "rest curvature of a tip (x, y) aside  on curve_x, curve_y",
        doc: "The body is curved without any command: set of the silicone after storage, a warped \
            mould.",
        signature: "Static, bent at home; the same on top of every command, where an offset of the \
            tendons fades or jumps where one goes slack.",
        reference: "Field of the simulator: one assembly of the residual with the changed design \
            and one back-substitution; tensions by complementarity.",
        experiment: (
            "home and both signs of every channel, the full body in view",
            1.0,
        ),
        alike: &[("offset", "never")],
        needs: &[],
        parameters: &[
            Parameter::new(
                "x",
                "mm",
                0.0,
                1.5,
                -10.0,
                10.0,
                "deflection of the tip at rest towards x",
            ),
            Parameter::new(
                "y",
                "mm",
                0.0,
                1.5,
                -10.0,
                10.0,
                "deflection of the tip at rest towards y",
            ),
        ],
    },
    law: Law::Shape(&PreCurve),
};

struct PreCurve;

impl ShapeEffect for PreCurve {
    fn fields(&self, _channels: usize) -> Vec<usize> {
        vec![CURVE, CURVE + 1]
    }

    fn add(&self, params: &[f64], _u: &[f64], _context: &Context, out: &mut Coefficients) {
        out[CURVE] += params[0];
        out[CURVE + 1] += params[1];
    }
}
