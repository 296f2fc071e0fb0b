//! Tendon stretch: the cables stretch more than the model's, in proportion to their tension.
//!
//! Every cable is `compliance` mm longer for each N of its tension, beyond the 1/k of the model for
//! cable and drive. It is a softer spring in the complementarity of `cables.rs`, which finds the
//! new tensions together with loads and other effects. A payload changes the tensions and so the
//! lost motion, unlike a gain. Limit: linear response of the body to changes of tension: 1 % off at
//! 0.02 mm/N (rust/fem/sweep_tests.rs).

use super::conditions::Context;
use super::declaration::*;

pub static EFFECT: Effect = Effect {
    declaration: Declaration {
        name: "tendon_stretch",
        family: "actuation map",
        stage: Stage::Shape,
        kind: Kind::Effect,
        formula: "stretch = compliance · T  of each cable, T solved with the body",
        doc: "Cables, knots or the drive's belt give under tension.",
        signature: "Static, as a gain that is lost more where the tension is higher: with the \
            bend, and with a payload on the pulled side.",
        reference: "Hooke's law of a cable; Hintermüller, Ito and Kunisch 2002 for the \
            complementarity.",
        experiment: ("the same moves with and without a known load", 3.0),
        alike: &[("gain", "load")],
        needs: &[],
        parameters: &[Parameter::new(
            "compliance",
            "mm/N",
            0.0,
            0.05,
            0.003,
            0.6,
            "by how much a cable gets longer for each N, beyond the model",
        )
        .per_cable()],
    },
    law: Law::Shape(&TendonStretch),
};

struct TendonStretch;

impl ShapeEffect for TendonStretch {
    fn fields(&self, channels: usize) -> Vec<usize> {
        (TENDON..CONTACT).take(2 * channels).collect()
    }

    fn add(&self, params: &[f64], _u: &[f64], _context: &Context, out: &mut Coefficients) {
        for (out, compliance) in out[TENDON..CONTACT].iter_mut().zip(params) {
            *out += compliance;
        }
    }
}
