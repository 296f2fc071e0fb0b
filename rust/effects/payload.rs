//! Payload: something hangs at the tip that the run does not declare.
//!
//! A mass of `mass` grams on top of the declared load: the force `mass·1e-3·9.80665 N` along the run's gravity, as
//! coefficients of tip_force_x|y|z (displacement per 1 N). Limit: fields are linear; 1 % error at 5 g, 3–6 % at 20 g, 8–24 %
//! at 50 g on the built-in finger.

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
        signature: "A sag towards the ground that grows towards the tip, the same for every speed and history.",
        reference: "Linear response of the equilibrium to a tip force, from the tangent of the simulator.",
        needs: &[],
        parameters: &[Parameter {
            name: "mass",
            unit: "g",
            null: 0.0,
            start: 10.0,
            low: 0.0,
            high: 150.0,
            per_channel: false,
            doc: "mass at the tip on top of the declared load",
        }],
    },
    law: Law::Shape(&Payload),
};

struct Payload;

/// The force (N) of a mass (g) at rest along gravity.
pub(crate) fn weight(mass: f64, gravity: [f64; 3]) -> [f64; 3] {
    gravity.map(|g| mass * 1e-3 * STANDARD_GRAVITY * g)
}

impl ShapeEffect for Payload {
    fn fields(&self) -> &'static [usize] {
        &[TIP_FORCE, TIP_FORCE + 1, TIP_FORCE + 2]
    }

    fn add(&self, params: &[f64], context: &Context, out: &mut Coefficients) {
        for (i, force) in weight(params[0], context.gravity).into_iter().enumerate() {
            out[TIP_FORCE + i] += force;
        }
    }
}
