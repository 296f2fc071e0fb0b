//! Zero drift: the zero of a channel moves steadily during the run, as for a tendon that creeps
//! through its knot.
//!
//! `x = u + rate·min(m, 15)`, mm, `rate` in mm/min per channel, `m` the minutes since the first
//! sample. No memory of the commands. A log of a few minutes cannot predict beyond a quarter of an
//! hour, so a controller that compensates the drift stops there. Limit: steady; a drift that ends
//! is a `tendon_creep`, and a sudden one an `anchor_slip`.

use super::conditions::Context;
use super::declaration::*;
use super::elapsed::{self, elapsed};

pub static EFFECT: Effect = Effect {
    declaration: Declaration {
        name: "zero_drift",
        family: "slow drift",
        stage: Stage::Transmission,
        kind: Kind::Effect,
        formula: "x = u + rate · min(m, 15),  m minutes since the first sample",
        doc: "The zero of a channel moves steadily: a tendon slides through its knot, a servo \
            loses steps, a cable settles.",
        signature: "An offset of the channel that grows with time from nothing, whatever is \
            commanded; the base stays in place.",
        reference: "Linear drift, the first term of a drift in time.",
        experiment: ("home at the start, in between and at the end", 0.5),
        alike: &[],
        needs: &[],
        parameters: &[Parameter::new(
            "rate",
            "mm/min",
            0.0,
            0.2,
            -4.0,
            4.0,
            "shortening that is added to the command each minute",
        )
        .per_channel()],
    },
    law: Law::Channel(&ZeroDrift),
};

struct ZeroDrift;

/// Minutes after which the drift stops.
const LONGEST: f64 = 15.0;

impl ChannelEffect for ZeroDrift {
    fn state_size(&self, _channels: usize) -> usize {
        elapsed::SIZE
    }

    fn settle(&self, _params: &[f64], _x: &mut [f64], state: &mut [f64]) {
        state.fill(0.0);
    }

    fn step(&self, params: &[f64], x: &mut [f64], state: &mut [f64], context: &Context) {
        let minutes = (elapsed(state, context) / 60.0).min(LONGEST);
        x.iter_mut()
            .zip(params)
            .for_each(|(x, rate)| *x += rate * minutes);
    }
}
