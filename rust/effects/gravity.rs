//! Gravity: the body is heavier or lighter than the model, or hangs at another angle.
//!
//! The effective gravity is `(1 + density)·R·g`, `g` the unit vector that the run declares and `R`
//! a turn by `tilt_x` about the base's x axis, then by `tilt_y` about y. The coefficients of the
//! fields gravity_x|y|z (displacement per 1 g) are its difference to `g`; what the run declares is
//! applied as known physics in `predict.rs`. The body responds linearly at constant tension, and
//! tendons become slack or taut (`cables.rs`). Limit: the response is that at the unloaded
//! equilibrium. On the built-in finger, horizontal instead of hanging, vertices are 0.14 mm off
//! where gravity moves them by 2.6 mm (RMS, eleven commands); pinned by tests/model/test_bundle.py.

use super::conditions::Context;
use super::declaration::*;

pub static EFFECT: Effect = Effect {
    declaration: Declaration {
        name: "gravity",
        family: "dead load",
        stage: Stage::Shape,
        kind: Kind::Effect,
        formula: "c = (1 + density) · R_y(tilt_y) · R_x(tilt_x) · g − g  on gravity_x, gravity_y, \
            gravity_z",
        doc: "Own weight other than declared: another density, or a mount that leans against the \
            vertical.",
        signature: "A sag that is the same for every speed and history, and changes with the \
            orientation of the base.",
        reference: "Linear response at constant tendon tension, from the simulator's tangent; \
            tensions by complementarity.",
        experiment: (
            "the same moves in another orientation, declared in the run",
            3.0,
        ),
        alike: &[("payload", "orientation")],
        needs: &[],
        parameters: &[
            Parameter::new(
                "density",
                "1",
                0.0,
                0.2,
                -0.8,
                2.0,
                "relative deviation of the weight from the declared one",
            ),
            Parameter::new(
                "tilt_x",
                "deg",
                0.0,
                5.0,
                -60.0,
                60.0,
                "turn of gravity about the base's x axis",
            ),
            Parameter::new(
                "tilt_y",
                "deg",
                0.0,
                5.0,
                -60.0,
                60.0,
                "turn of gravity about the base's y axis, after tilt_x",
            ),
        ],
    },
    law: Law::Shape(&Gravity),
};

struct Gravity;

impl ShapeEffect for Gravity {
    fn fields(&self, _channels: usize) -> Vec<usize> {
        vec![GRAVITY, GRAVITY + 1, GRAVITY + 2]
    }

    fn add(&self, params: &[f64], _u: &[f64], context: &Context, out: &mut Coefficients) {
        let [gx, gy, gz] = context.gravity;
        let (sx, cx) = params[1].to_radians().sin_cos();
        let (sy, cy) = params[2].to_radians().sin_cos();
        let (y, z) = (cx * gy - sx * gz, sx * gy + cx * gz);
        let tilted = [cy * gx + sy * z, y, cy * z - sy * gx];
        for i in 0..3 {
            out[GRAVITY + i] += (1.0 + params[0]) * tilted[i] - context.gravity[i];
        }
    }
}
