//! Routing: the tendons of a command run at another angle about the axis than the model's.
//!
//! The coefficients of the fields routing_c (displacement per 1°) are the phases of the tendons
//! that command c moves. Unlike a rotation of the commands, it is not an affine map of them: the
//! routing determines which tendons become slack. Limit: linear; 5 % off at 5°
//! (rust/fem/sweep_tests.rs).

use super::conditions::Context;
use super::declaration::*;

pub static EFFECT: Effect = Effect {
    declaration: Declaration {
        name: "routing",
        family: "actuation map",
        stage: Stage::Shape,
        kind: Kind::Effect,
        formula: "tendons of command c turned by phase_c about the axis  on routing_c",
        doc: "A pair of tendons is threaded aside of where the model has it, or the body is \
            clamped turned while marks on it are not.",
        signature: "Static: each command bends the body in a plane turned by a constant angle; \
            nothing at home.",
        reference: "Field of the simulator: one assembly of the residual with the changed design \
            and one back-substitution; tensions by complementarity.",
        experiment: ("each command alone, then diagonals", 1.5),
        alike: &[],
        needs: &[],
        parameters: &[Parameter::new(
            "phase",
            "deg",
            0.0,
            4.0,
            -20.0,
            20.0,
            "angle of the tendons of the channel about the axis, beyond the model",
        )
        .per_channel()],
    },
    law: Law::Shape(&Routing),
};

struct Routing;

impl ShapeEffect for Routing {
    fn fields(&self, channels: usize) -> Vec<usize> {
        (ROUTING..ROUTING + channels).collect()
    }

    fn add(&self, params: &[f64], _u: &[f64], _context: &Context, out: &mut Coefficients) {
        // A model has fields for its named commands; `fields` requests more if there are more
        // commands.
        for (out, phase) in out[ROUTING..ROUTING + PHASES].iter_mut().zip(params) {
            *out += phase;
        }
    }
}
