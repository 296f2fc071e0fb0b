//! Creep: under a held command the body goes on bending slowly (one Prony term).
//!
//! `y = x + strength·z`, `tau·z' = x − z`: the response to a step is `1 + strength·(1 − e^(−t/tau))`. Advanced exactly for
//! commands linear between samples, as in `lag.rs`. Memory starts in equilibrium, `z = x`. Units 1 and s.
//! Limit: one relaxation time; bodies with a broad spectrum are matched over about a decade of dwell times.

use super::conditions::Context;
use super::declaration::*;
use super::lag::low_pass;

pub static EFFECT: Effect = Effect {
    declaration: Declaration {
        name: "creep",
        family: "slow drift",
        stage: Stage::Material,
        kind: Kind::Effect,
        formula: "y = x + strength · z,  tau · dz/dt = x − z",
        doc: "Viscoelastic creep of the body: after the quick response, a slow one in the same direction, and a slow way back.",
        signature: "Drift while a command is held, in the direction of the last move; the same command looks different after a \
                    long dwell elsewhere.",
        reference: "Prony series of linear viscoelasticity: Christensen, Theory of Viscoelasticity, 1982.",
        experiment: ("staircase with dwells of 6 to 10 s", 2.0),
        alike: &[],
        needs: &[],
        parameters: &[
            Parameter {
                name: "strength",
                unit: "1",
                null: 0.0,
                start: 0.1,
                low: 0.01,
                high: 0.5,
                per_channel: false,
                doc: "slow response over quick response, when all has settled",
            },
            Parameter {
                name: "tau",
                unit: "s",
                null: 10.0,
                start: 10.0,
                low: 1.0,
                high: 100.0,
                per_channel: false,
                doc: "relaxation time",
            },
        ],
    },
    law: Law::Channel(&Creep),
};

struct Creep;

impl ChannelEffect for Creep {
    fn state_size(&self, channels: usize) -> usize {
        2 * channels
    }

    fn settle(&self, params: &[f64], x: &mut [f64], state: &mut [f64]) {
        let (slow, before) = state.split_at_mut(x.len());
        slow.copy_from_slice(x);
        before.copy_from_slice(x);
        x.iter_mut().for_each(|x| *x += params[0] * *x);
    }

    #[inline]
    fn step(&self, params: &[f64], x: &mut [f64], state: &mut [f64], context: &Context) {
        let (slow, before) = state.split_at_mut(x.len());
        let [a, b, c] = low_pass(params[1], context.dt);
        for ((x, slow), before) in x.iter_mut().zip(slow).zip(before) {
            let u = *x;
            *slow = a * *slow + b * *before + c * u;
            *before = u;
            *x = u + params[0] * *slow;
        }
    }
}
