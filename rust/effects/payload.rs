//! Payload: an undeclared mass hangs at the tip.
//!
//! A mass of `mass` grams on top of the declared load: the force `mass·1e-3·9.80665 N` along the
//! run's gravity, as coefficients of tip_force_x|y|z (displacement per 1 N). The body responds
//! linearly at constant tension, and tendons become slack or taut (`cables.rs`). Limit: the
//! response is that at the unloaded equilibrium. Vertices of the built-in finger, RMS over eleven
//! commands: 25 g hanging 0.10 mm off of 0.9 mm moved, 25 g leaning by 35° 0.28 of 3.3, 60 g
//! leaning 1.11 of 5.6; pinned by docs/make_effects.py and tests/model/test_bundle.py.

use super::conditions::Context;
use super::declaration::*;

pub static EFFECT: Effect = Effect {
    declaration: Declaration {
        name: "payload",
        family: "dead load",
        stage: Stage::Shape,
        kind: Kind::Effect,
        formula: "c = mass/1000 · 9.80665 · g  on tip_force_x, tip_force_y, tip_force_z",
        doc: "An undeclared mass at the tip: a marker, a gripped object, a camera cable.",
        signature: "A sag towards the ground that grows towards the tip, the same for every speed \
            and history.",
        reference: "Linear response at constant tendon tension, from the simulator's tangent; \
            tensions by complementarity.",
        experiment: ("the same moves with a known 10 g", 3.0),
        alike: &[("gravity", "orientation")],
        needs: &[],
        parameters: &[Parameter::new(
            "mass",
            "g",
            0.0,
            10.0,
            0.0,
            150.0,
            "mass at the tip on top of the declared load",
        )
        .reaching(Reach::Lengths(1.0))],
    },
    law: Law::Shape(&Payload),
};

struct Payload;

impl ShapeEffect for Payload {
    fn fields(&self, _channels: usize) -> Vec<usize> {
        vec![TIP_FORCE, TIP_FORCE + 1, TIP_FORCE + 2]
    }

    fn add(&self, params: &[f64], _u: &[f64], context: &Context, out: &mut Coefficients) {
        for (i, force) in weight(params[0], context.gravity).into_iter().enumerate() {
            out[TIP_FORCE + i] += force;
        }
    }
}
