//! Stiffness: the complete body is softer or stiffer than the model's.
//!
//! `ln E(s) = ln E₀ + amount`, the same for every stretch of the body: the coefficient of each
//! field stiff_k is `amount`. With tendons of given shortening and no other load, a uniform modulus
//! hardly changes the shape (0.13 mm at −30 %). A weight, a lean and stretching cables show it. The
//! search is from half the modulus to twice it; in this range, a run without weight or lean cannot
//! show it. Limit: second order (`second.rs`), as for one section. A body without modulus fields
//! does not have this effect.

use super::conditions::Context;
use super::declaration::*;

pub static EFFECT: Effect = Effect {
    declaration: Declaration {
        name: "stiffness",
        family: "body stiffness",
        stage: Stage::Shape,
        kind: Kind::Effect,
        formula: "ln E(s) = ln E₀ + amount  on stiff_0 … stiff_6",
        doc: "The complete body is softer or stiffer than the model: another batch of silicone, a \
            cure at another temperature, age.",
        signature: "A sag that differs from the model's where the body leans or carries a load. \
                    Without a load there is almost no difference: tendons of given length bend a \
                    soft body as far as a stiff one.",
        reference: "Field of the simulator: one assembly of the residual with the changed design \
            and one back-substitution; tensions by complementarity.",
        experiment: ("the same moves with and without a known load, leaning", 3.0),
        // A soft body under an unknown weight looks like a stiff one under a larger weight; one
        // with stiffer cables bends more.
        alike: &[
            ("gravity", "load"),
            ("payload", "load"),
            ("gain", "load"),
            ("tendon_stretch", "load"),
        ],
        needs: &[],
        parameters: &[Parameter::new(
            "amount",
            "1",
            0.0,
            -0.2,
            -0.7,
            0.7,
            "logarithm of the modulus over the model's",
        )],
    },
    law: Law::Shape(&Stiffness),
};

struct Stiffness;

impl ShapeEffect for Stiffness {
    fn fields(&self, _channels: usize) -> Vec<usize> {
        (STIFF..STIFF + HATS).collect()
    }

    fn add(&self, params: &[f64], _u: &[f64], _context: &Context, out: &mut Coefficients) {
        for out in &mut out[STIFF..STIFF + HATS] {
            *out += params[0];
        }
    }
}
