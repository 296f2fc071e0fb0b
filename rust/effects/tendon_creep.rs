//! Tendon creep: a tendon under tension goes on stretching, and the bend is slowly lost.
//!
//! `y = x − loss·z`, `tau·z' = x − z`: after a step all of it comes at once and a share of it is lost with time, where
//! creep of the body (`creep.rs`) goes on in the direction of the step. Advanced exactly for commands linear between
//! samples, as in `lag.rs`. Memory starts in equilibrium, z = x. Units 1 and s. Limit: one relaxation time, and all
//! that is lost comes back.

use super::conditions::{Conditions, Context};
use super::declaration::*;
use super::low_pass::{low_pass, low_passed};

pub static EFFECT: Effect = Effect {
    declaration: Declaration {
        name: "tendon_creep",
        family: "slow drift",
        stage: Stage::Transmission,
        kind: Kind::Effect,
        formula: "y = x − loss · z,  tau · dz/dt = x − z",
        doc: "The tendon creeps: under a lasting pull polymer fibres and knots give way, and recover when they are let \
              go.",
        signature: "Drift while a command is held, back towards home; after a long pull home itself is overshot, then comes \
              back.",
        reference: "Linear viscoelastic creep: Findley, Lai and Onaran, Creep and Relaxation of Nonlinear Viscoelastic \
              Materials, 1976.",
        experiment: ("a dwell of 30 s or more at a large command, then home", 2.0),
        alike: &[],
        needs: &[],
        parameters: &[
            Parameter::new(
                "loss",
                "1",
                0.0,
                0.05,
                0.01,
                0.3,
                "share of the shortening that is lost when all has settled",
            ),
            Parameter::new(
                "tau",
                "s",
                60.0,
                60.0,
                5.0,
                500.0,
                "relaxation time of the tendon",
            ),
        ],
    },
    law: Law::Channel(&TendonCreep),
};

struct TendonCreep;

impl ChannelEffect for TendonCreep {
    fn state_size(&self, channels: usize) -> usize {
        2 * channels
    }

    fn settle(&self, params: &[f64], x: &mut [f64], state: &mut [f64]) {
        let (slow, before) = state.split_at_mut(x.len());
        slow.copy_from_slice(x);
        before.copy_from_slice(x);
        x.iter_mut().for_each(|x| *x -= params[0] * *x);
    }

    fn step(&self, params: &[f64], x: &mut [f64], state: &mut [f64], context: &Context) {
        advance(params[0], low_pass(params[1], context.dt), x, state);
    }

    /// As by steps; the weights of many samples are found together.
    fn rollout(
        &self,
        params: &[f64],
        samples: &mut [f64],
        channels: usize,
        state: &mut [f64],
        conditions: &Conditions,
    ) {
        low_passed(
            [params[1]],
            samples,
            channels,
            conditions,
            |[weights], x| {
                advance(params[0], weights, x, state);
            },
        );
    }
}

/// Advance one sample of every channel.
#[inline]
fn advance(strength: f64, [a, b, c]: [f64; 3], x: &mut [f64], state: &mut [f64]) {
    let (slow, before) = state.split_at_mut(x.len());
    for ((x, slow), before) in x.iter_mut().zip(slow).zip(before) {
        *slow = a * *slow + (b * *before + c * *x);
        *before = *x;
        *x -= strength * *slow;
    }
}
