//! Dead zone: around zero, a command causes no motion, because slack is taken up first.
//!
//! `x = u − min(max(u, −slack⁻), slack⁺)`, mm, without memory, for each channel; slack ≤ 0 is none.
//! Each cable of a pair has its own slack: slack⁺ is that of the cable that +u pulls. It acts on
//! the command. A tendon that becomes slack under a load is a law of the prior (`slack` of a rod),
//! not a dead zone.

use super::conditions::Context;
use super::declaration::*;

pub static EFFECT: Effect = Effect {
    declaration: Declaration {
        name: "dead_zone",
        family: "slack",
        stage: Stage::Transmission,
        kind: Kind::Effect,
        formula: "x = u − min(max(u, −slack⁻), slack⁺)  for the cables that +u and −u pull",
        doc: "A tendon with too much length: near zero it only straightens, and the finger stays \
              straight until the slack is taken up.",
        signature: "No motion around home, the same in loading and unloading; beyond, all commands \
            act as if smaller by a constant.",
        reference: "Dead zone: Tao and Kokotović, Adaptive Control of Systems with Actuator and \
              Sensor Nonlinearities, Wiley 1996.",
        experiment: ("through zero both ways, slowly, one channel at a time", 1.0),
        alike: &[],
        needs: &[],
        parameters: &[Parameter::new(
            "slack",
            "mm",
            0.0,
            0.5,
            0.05,
            4.0,
            "command to the cable's side of zero that moves nothing",
        )
        .per_cable()
        .reaching(Reach::HalfRanges(1.0))],
    },
    law: Law::Channel(&DeadZone),
};

struct DeadZone;

impl ChannelEffect for DeadZone {
    fn settle(&self, params: &[f64], x: &mut [f64], _state: &mut [f64]) {
        for (x, slack) in x.iter_mut().zip(params.chunks_exact(2)) {
            *x -= x.max(-slack[1].max(0.0)).min(slack[0].max(0.0));
        }
    }

    fn step(&self, params: &[f64], x: &mut [f64], state: &mut [f64], _context: &Context) {
        self.settle(params, x, state);
    }
}
