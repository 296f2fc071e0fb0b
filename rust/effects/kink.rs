//! Kink: a section of the body becomes soft once it is bent far enough.
//!
//! From a bend on, the modulus within 1/8 of the height of `centre` falls: `ln E = ln E₀ −
//! softening·⟨1 − bend/|u|⟩₊`, |u| the size of the effective command (mm), to which local bending
//! is proportional. bend = 0 is a soft hinge. Fields and limits as for `stiff_section`; a fold that
//! stays closed on reversal is not modelled.

use super::conditions::Context;
use super::declaration::*;

pub static EFFECT: Effect = Effect {
    declaration: Declaration {
        name: "kink",
        family: "body stiffness",
        stage: Stage::Shape,
        kind: Kind::Effect,
        formula: "ln E(s) = ln E₀ − softening · max(0, 1 − bend/|u|)  where |s − centre| < 1/8, on \
            stiff_0 … stiff_6",
        doc: "A place that buckles: a thin wall over a channel, a crack that opens, the end of an \
            insert.",
        signature: "Local, and only beyond a bend: the body folds at one place while the rest lags \
            behind.",
        reference: "Field of the simulator: one assembly of the residual with the changed design \
            and one back-substitution; tensions by complementarity.",
        experiment: ("triangles of growing size, points all along the body", 2.0),
        alike: &[("stiff_section", "never")],
        needs: &[],
        parameters: &[
            Parameter::new(
                "softening",
                "1",
                0.0,
                0.5,
                0.02,
                2.5,
                "logarithm by which the modulus falls when bent far beyond",
            ),
            Parameter::new(
                "centre",
                "1",
                0.5,
                0.4,
                0.0,
                1.0,
                "where, as a share of the height",
            ),
            Parameter::new(
                "bend",
                "mm",
                0.0,
                4.0,
                0.0,
                15.0,
                "size of the command from which on it gives way",
            ),
        ],
    },
    law: Law::Shape(&Kink),
};

/// Half the length of the soft section, as a share of the height.
const REACH: f64 = 0.125;

struct Kink;

impl ShapeEffect for Kink {
    fn fields(&self, _channels: usize) -> Vec<usize> {
        (STIFF..STIFF + HATS).collect()
    }

    fn add(&self, params: &[f64], u: &[f64], _context: &Context, out: &mut Coefficients) {
        let size = u.iter().map(|u| u * u).sum::<f64>().sqrt();
        if size > params[2].max(0.0) {
            let softer = params[0] * (1.0 - params[2].max(0.0) / size);
            for (hat, out) in out[STIFF..STIFF + HATS].iter_mut().enumerate() {
                *out -= softer * covered(hat, params[1] - REACH, params[1] + REACH);
            }
        }
    }
}
