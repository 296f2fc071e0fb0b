//! Tendon creep: a tendon under tension keeps stretching, and the bend decreases slowly.
//!
//! Each cable of a pair by itself: `s± = loss±·z±`, `tau·z±' = max(±x, 0) − z±` are the extra
//! lengths of the cable that +x pulls and of the one that −x pulls; `pair.rs` has the effect on the
//! command: `taut` 0 for cables that only pull and hang loose when released, 1 for a pair that is
//! held taut or takes compression, where `y = x − s⁺ + s⁻`. After a step, the full response is
//! immediate, and a share of it is lost with time; creep of the body (`creep.rs`) continues in the
//! direction of the step. Advanced exactly for pulls linear between samples, as in `lag.rs`. Memory
//! starts in equilibrium, z± = max(±x, 0). Units 1 and s. Limit: one relaxation time, and full
//! recovery.

use super::conditions::{Conditions, Context};
use super::declaration::*;
use super::low_pass::{low_pass, low_passed};
use super::pair::{lengthened, taut};

pub static EFFECT: Effect = Effect {
    declaration: Declaration {
        name: "tendon_creep",
        family: "slow drift",
        stage: Stage::Transmission,
        kind: Kind::Effect,
        formula: "y = taut · (x − a + b) + (1 − taut) · (x − min(max(x, −b), a)),  a = loss⁺ · z⁺, \
            b = loss⁻ · z⁻,  tau · dz±/dt = max(±x, 0) − z±",
        doc: "The tendon creeps: under a lasting pull polymer fibres and knots give way, and \
              recover when they are let go. Each cable of a pair by itself, while it pulls.",
        signature: "Drift while a command is held, back towards home; after a long pull home and \
              the other side are overshot as far as the pair is taut, then come back.",
        reference: "Linear viscoelastic creep: Findley, Lai and Onaran, Creep and Relaxation of \
              Nonlinear Viscoelastic Materials, 1976.",
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
                0.5,
                "share of a pull that is lost when all has settled",
            )
            .per_cable(),
            Parameter::new(
                "tau",
                "s",
                60.0,
                60.0,
                5.0,
                500.0,
                "relaxation time of the tendon",
            ),
            taut("share of what a cable has lost that shows while the other pulls"),
        ],
    },
    law: Law::Channel(&TendonCreep),
};

struct TendonCreep;

impl ChannelEffect for TendonCreep {
    /// The past of each cable, and the command before.
    fn state_size(&self, channels: usize) -> usize {
        3 * channels
    }

    fn settle(&self, params: &[f64], x: &mut [f64], state: &mut [f64]) {
        let (loss, numbers) = params.split_at(2 * x.len());
        let cables = loss.chunks_exact(2);
        let channels = x.iter_mut().zip(state.chunks_exact_mut(3)).zip(cables);
        for ((x, state), loss) in channels {
            state.copy_from_slice(&[x.max(0.0), (-*x).max(0.0), *x]);
            *x = shortened(loss, numbers[1], *x, state);
        }
    }

    fn step(&self, params: &[f64], x: &mut [f64], state: &mut [f64], context: &Context) {
        let tau = params[2 * x.len()];
        advance(params, low_pass(tau, context.dt), x, state);
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
        low_passed(
            [params[2 * channels]],
            samples,
            channels,
            conditions,
            |[weights], x| {
                advance(params, weights, x, state);
            },
        );
    }
}

/// Advance one sample of every channel.
#[inline]
fn advance(params: &[f64], [a, b, c]: [f64; 3], x: &mut [f64], state: &mut [f64]) {
    let (loss, numbers) = params.split_at(2 * x.len());
    let cables = loss.chunks_exact(2);
    let channels = x.iter_mut().zip(state.chunks_exact_mut(3)).zip(cables);
    for ((x, state), loss) in channels {
        let (before, u) = (state[2], *x);
        let follow = |z: f64, before: f64, u: f64| a * z + (b * before.max(0.0) + c * u.max(0.0));
        state[0] = follow(state[0], before, u);
        state[1] = follow(state[1], -before, -u);
        state[2] = u;
        *x = shortened(loss, numbers[1], u, state);
    }
}

/// The part of a command that reaches the body through cables with these losses.
#[inline]
fn shortened(loss: &[f64], taut: f64, x: f64, state: &[f64]) -> f64 {
    lengthened(x, [loss[0] * state[0], loss[1] * state[1]], taut)
}
