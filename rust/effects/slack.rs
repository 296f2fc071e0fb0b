//! Slack: tendons push less than in the model, down to cables that only pull.
//!
//! The stiffness of a tendon in compression over that in tension is a number of the elastic rod
//! (`rust/rod/elastic.rs`); this effect multiplies the rod's own by `ratio`, and the rod finds its
//! equilibrium with that, loads included. It has no effect on a rod whose tendons only pull, or on
//! a finger of finite elements, whose cables never push.

use super::declaration::*;

pub static EFFECT: Effect = Effect {
    declaration: Declaration {
        name: "slack",
        family: "slack",
        stage: Stage::Transmission,
        kind: Kind::Effect,
        formula: "w(δ < 0) = ratio · w(δ > 0)  for the stretch δ of every tendon of an elastic rod",
        doc: "Tendons fall slack where the model lets them push: cables that were taken for rods.",
        signature: "Static: wherever a tendon is paid out faster than the body takes it up, the \
                    body bends further than the model.",
        reference: "Tendons that only pull: Camarillo et al., IEEE Trans. Robotics 24 (2008) 1262.",
        experiment: (
            "each tendon alone paid out far, the others held, then all pairs",
            2.0,
        ),
        alike: &[],
        needs: &[],
        parameters: &[Parameter::new(
            "ratio",
            "1",
            1.0,
            0.3,
            0.0,
            1.0,
            "stiffness of a tendon in compression over that in tension, as a share of the model's \
            own",
        )],
    },
    law: Law::Prior(&Slack),
};

struct Slack;

impl PriorEffect for Slack {
    fn number(&self) -> &'static str {
        "slack"
    }

    fn factor(&self, params: &[f64]) -> f64 {
        params[0].clamp(0.0, 1.0)
    }
}
