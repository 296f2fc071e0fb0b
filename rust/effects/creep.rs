//! Creep: under a held command the body keeps bending slowly (two Prony terms).
//!
//! `y = x + strength·(z₁ + z₂)/2`, `tau·spread·z₁' = x − z₁`, `(tau/spread)·z₂' = x − z₂`: the
//! response to a step is one plus strength times the mean of two relaxations, whose times lie
//! `spread` above and below `tau`; one relaxation at spread 1. Advanced exactly for commands linear
//! between samples, as in `lag.rs`. Memory starts in equilibrium, `z = x`. Units 1 and s. Limit:
//! two equal terms. They also approximate three: fitted to five bodies of up to three terms over
//! two decades, also of unequal strength, they leave 3 to 9 % of the slow part, while one term
//! leaves 14 to 32 %. So there is no third. Pinned by tests/model/test_effects.py.

use super::conditions::{Conditions, Context};
use super::declaration::*;
use super::low_pass::{low_pass, low_passed};

pub static EFFECT: Effect = Effect {
    declaration: Declaration {
        name: "creep",
        family: "slow drift",
        stage: Stage::Material,
        kind: Kind::Effect,
        formula: "y = x + strength · (z₁ + z₂)/2,  tau · spread · dz₁/dt = x − z₁,  tau / spread · \
            dz₂/dt = x − z₂",
        doc: "Viscoelastic creep of the body: after the quick response, a slow one in the same \
            direction, and a slow way back.",
        signature: "Drift while a command is held, in the direction of the last move; the same \
                    command looks different after a long dwell at another place.",
        reference: "Prony series of linear viscoelasticity: Christensen, Theory of \
            Viscoelasticity, 1982.",
        experiment: ("staircase with dwells of 6 to 10 s", 2.0),
        alike: &[],
        needs: &[],
        parameters: &[
            Parameter::new(
                "strength",
                "1",
                0.0,
                0.1,
                0.01,
                0.5,
                "slow response over quick response, when all has settled",
            )
            .shared(),
            Parameter::new(
                "tau",
                "s",
                10.0,
                10.0,
                1.0,
                100.0,
                "relaxation time, the geometric mean of both",
            ),
            Parameter::new(
                "spread",
                "1",
                1.0,
                2.0,
                1.0,
                10.0,
                "how far the two relaxation times lie above and below tau, as a factor",
            ),
        ],
    },
    law: Law::Channel(&Creep),
};

struct Creep;

impl ChannelEffect for Creep {
    fn state_size(&self, channels: usize) -> usize {
        3 * channels
    }

    fn settle(&self, params: &[f64], x: &mut [f64], state: &mut [f64]) {
        for held in state.chunks_exact_mut(x.len().max(1)) {
            held.copy_from_slice(x);
        }
        let channels = x.iter_mut().zip(params);
        channels.for_each(|(x, strength)| *x += strength * *x);
    }

    fn step(&self, params: &[f64], x: &mut [f64], state: &mut [f64], context: &Context) {
        let (strength, times) = params.split_at(x.len());
        let slow = low_pass(times[0] * times[1], context.dt);
        let quick = low_pass(times[0] / times[1], context.dt);
        advance(strength, slow, quick, x, state);
    }

    /// Like single steps; the weights of many samples are computed together.
    fn rollout(
        &self,
        params: &[f64],
        samples: &mut [f64],
        channels: usize,
        state: &mut [f64],
        conditions: &Conditions,
    ) {
        let (strength, times) = params.split_at(channels);
        let taus = [times[0] * times[1], times[0] / times[1]];
        low_passed(taus, samples, channels, conditions, |[slow, quick], x| {
            advance(strength, slow, quick, x, state);
        });
    }
}

/// Advance one sample of every channel.
#[inline]
fn advance(
    strength: &[f64],
    [a, b, c]: [f64; 3],
    [d, e, f]: [f64; 3],
    x: &mut [f64],
    state: &mut [f64],
) {
    let (slow, rest) = state.split_at_mut(x.len());
    let (quick, before) = rest.split_at_mut(x.len());
    let channels = x.iter_mut().zip(slow).zip(quick).zip(before);
    for ((((x, slow), quick), before), strength) in channels.zip(strength) {
        let u = *x;
        *slow = a * *slow + (b * *before + c * u);
        *quick = d * *quick + (e * *before + f * u);
        *before = u;
        *x = u + 0.5 * strength * (*slow + *quick);
    }
}
