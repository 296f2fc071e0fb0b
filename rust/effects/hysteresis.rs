//! Hysteresis: after a reversal, the response is reduced at first and then catches up
//! (Prandtl–Ishlinskii).
//!
//! `y = x − Σ w_i·stop_i(x)`, i = 1…4, with the stop operators `s_i ← clamp(s_i + Δx, ±r_i)`,
//! thresholds `r_i = reach·(i/4)^shape` and equal weights `w_i = strength/4`. After a reversal a
//! part 1 − strength of the motion comes at once; all of it once the widest stop is saturated. A
//! shape above 1 crowds the thresholds at small motions, for loops that open at once and close
//! late. Memory starts relaxed (`s_i = 0`). Exact for commands monotonic between samples. Source:
//! P. Krejčí, K. Kuhnen, doi:10.1049/ip-cta:20010375. Limit: rate-independent, four thresholds.
//! Fitted to loops of other laws, it leaves of their motion: Bouc–Wen 4 to 15 % (shape held at 1: 5
//! to 17 %), Dahl 6 % (7 %), thresholds of exponential density 7 % (11 %), of density 1/r 7 % (12
//! %); eight thresholds are no better. Pinned by tests/model/test_effects.py.

use super::conditions::{Conditions, Context};
use super::declaration::*;

/// A `strength` at which the part that is held back is the complete response of a map.
const ALL_HELD_BACK: f64 = 30.0;

pub static EFFECT: Effect = Effect {
    declaration: Declaration {
        name: "hysteresis",
        family: "reversal hysteresis",
        stage: Stage::Material,
        kind: Kind::Effect,
        formula: "y = x − strength/4 · Σ s_i,  s_i = clamp(s_i + Δx, ±reach · (i/4)^shape),  i = \
            1…4",
        doc: "Internal friction of the body: a few stop operators of growing threshold hold back \
            part of the motion.",
        signature: "A loop between loading and unloading whose width grows with the swing and \
                    saturates; motion sets in at once after a reversal, but too small.",
        reference: "Prandtl–Ishlinskii operator: Krejčí and Kuhnen, IEE Proc. Control Theory Appl. \
            148 (2001) 185.",
        experiment: ("triangles of growing size, up and back", 2.0),
        alike: &[],
        needs: &[],
        parameters: &[
            Parameter::new(
                "strength",
                "1",
                0.0,
                0.15,
                0.02,
                0.7,
                "share of the motion held back just after a reversal",
            )
            .shared()
            .with_map(WithMap::UpTo(ALL_HELD_BACK)),
            Parameter::new(
                "reach",
                "mm",
                3.0,
                3.0,
                0.3,
                10.0,
                "motion after which nothing more is held back",
            )
            .reaching(Reach::HalfRanges(2.0)),
            Parameter::new(
                "shape",
                "1",
                1.0,
                1.0,
                0.7,
                4.0,
                "how the thresholds crowd: evenly at 1, at small motions above",
            ),
        ],
    },
    law: Law::Channel(&Hysteresis),
};

struct Hysteresis;

const STOPS: usize = 4;

/// Thresholds of the stops, mm, from `reach` and `shape`.
fn thresholds(numbers: &[f64]) -> [f64; STOPS] {
    let share = |i: usize| (i + 1) as f64 / STOPS as f64;
    std::array::from_fn(|i| numbers[0].max(0.0) * share(i).powf(numbers[1].max(0.0)))
}

/// Advance one sample of every channel.
#[inline]
fn advance(strength: &[f64], limits: &[f64; STOPS], x: &mut [f64], state: &mut [f64]) {
    let channels = x.iter_mut().zip(state.chunks_exact_mut(1 + STOPS));
    for ((x, memory), strength) in channels.zip(strength) {
        let weight = strength / STOPS as f64;
        let (before, stops) = memory.split_at_mut(1);
        let change = *x - before[0];
        before[0] = *x;
        let mut held = 0.0;
        for (stop, limit) in stops.iter_mut().zip(limits) {
            *stop = (*stop + change).max(-limit).min(*limit);
            held += *stop;
        }
        *x -= weight * held;
    }
}

impl ChannelEffect for Hysteresis {
    fn state_size(&self, channels: usize) -> usize {
        channels * (1 + STOPS)
    }

    fn settle(&self, _params: &[f64], x: &mut [f64], state: &mut [f64]) {
        state.fill(0.0);
        for (x, memory) in x.iter().zip(state.chunks_exact_mut(1 + STOPS)) {
            memory[0] = *x;
        }
    }

    fn step(&self, params: &[f64], x: &mut [f64], state: &mut [f64], _context: &Context) {
        let (strength, numbers) = params.split_at(x.len());
        advance(strength, &thresholds(numbers), x, state);
    }

    /// Like single steps; powers are computed once instead of at every sample.
    fn rollout(
        &self,
        params: &[f64],
        samples: &mut [f64],
        channels: usize,
        state: &mut [f64],
        _conditions: &Conditions,
    ) {
        let (strength, numbers) = params.split_at(channels);
        let limits = thresholds(numbers);
        for x in samples.chunks_exact_mut(channels) {
            advance(strength, &limits, x, state);
        }
    }
}
