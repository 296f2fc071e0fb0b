//! Stiff section: one part of the body is stiffer or softer than the rest.
//!
//! `ln E = ln E₀ + amount` where s lies within width/2 of centre (shares of the height). The
//! coefficient of each field stiff_k is amount times the part of its stretch that the section
//! covers (`loads.rs`), so a border between sections is smeared over 1/6 of the height. Limit:
//! second order in the logarithm (`second.rs`); linear, it is 4 % off at ±25 % and some 15 % at ±50
//! %.

use super::conditions::Context;
use super::declaration::*;

pub static EFFECT: Effect = Effect {
    declaration: Declaration {
        name: "stiff_section",
        family: "body stiffness",
        stage: Stage::Shape,
        kind: Kind::Effect,
        formula: "ln E(s) = ln E₀ + amount  where |s − centre| < width/2, on stiff_0 … stiff_6",
        doc: "A part of the body has another modulus: a glued repair, a sleeve, a bubble, a tear.",
        signature: "Static, odd in the command: the body bends less (or more) at one place, and \
            the rest makes up for it.",
        reference: "Field of the simulator: one assembly of the residual with the changed design \
            and one back-substitution; tensions by complementarity.",
        experiment: ("full range, both signs, points all along the body", 1.0),
        alike: &[],
        needs: &[],
        parameters: &[
            Parameter::new(
                "amount",
                "1",
                0.0,
                0.3,
                -2.4,
                2.4,
                "logarithm of the modulus there over that of the rest",
            ),
            Parameter::new(
                "centre",
                "1",
                0.5,
                0.4,
                0.0,
                1.0,
                "middle of the section, as a share of the height",
            ),
            Parameter::new(
                "width",
                "1",
                0.25,
                0.25,
                0.1,
                0.6,
                "its length, as a share of the height",
            ),
        ],
    },
    law: Law::Shape(&StiffSection),
};

struct StiffSection;

impl ShapeEffect for StiffSection {
    fn fields(&self, _channels: usize) -> Vec<usize> {
        (STIFF..STIFF + HATS).collect()
    }

    fn add(&self, params: &[f64], _u: &[f64], _context: &Context, out: &mut Coefficients) {
        let (low, high) = (params[1] - 0.5 * params[2], params[1] + 0.5 * params[2]);
        for (hat, out) in out[STIFF..STIFF + HATS].iter_mut().enumerate() {
            *out += params[0] * covered(hat, low, high);
        }
    }
}
