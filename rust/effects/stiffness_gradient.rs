//! Stiffness gradient: the modulus changes uniformly along the body.
//!
//! `ln E(s) = ln E₀ + gradient·(s − ½)`, s the share of the height: the coefficient of each field
//! stiff_k (displacement per unit of the logarithm of the modulus in one of seven stretches) is
//! gradient·(s_k − ½). Under tendons of given shortening, a uniform modulus is hardly visible, but
//! its change along the body is. Limit: second order (`second.rs`); a field alone misses the
//! simulator by 4 % at ±25 % in one stretch (rust/fem/sweep_tests.rs).

use super::conditions::Context;
use super::declaration::*;

pub static EFFECT: Effect = Effect {
    declaration: Declaration {
        name: "stiffness_gradient",
        family: "body stiffness",
        stage: Stage::Shape,
        kind: Kind::Effect,
        formula: "ln E(s) = ln E₀ + gradient · (s − 1/2)  on stiff_0 … stiff_6",
        doc: "The modulus changes evenly along the body: settled filler, a cure that was not even, \
            a wall that thins.",
        signature: "Static, odd in the command: another shape along the body at the same angle of \
            the tip, as an S between model and robot.",
        reference: "Field of the simulator: one assembly of the residual with the changed design \
            and one back-substitution; tensions by complementarity.",
        experiment: ("full range, both signs, points all along the body", 1.0),
        alike: &[],
        needs: &[],
        parameters: &[Parameter::new(
            "gradient",
            "1",
            0.0,
            0.4,
            -2.4,
            2.4,
            "logarithm of the modulus at the tip over that at the base",
        )],
    },
    law: Law::Shape(&StiffnessGradient),
};

struct StiffnessGradient;

impl ShapeEffect for StiffnessGradient {
    fn fields(&self, _channels: usize) -> Vec<usize> {
        (STIFF..STIFF + HATS).collect()
    }

    fn add(&self, params: &[f64], _u: &[f64], _context: &Context, out: &mut Coefficients) {
        for (hat, out) in out[STIFF..STIFF + HATS].iter_mut().enumerate() {
            *out += params[0] * (middle(hat) - 0.5);
        }
    }
}
