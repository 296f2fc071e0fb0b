//! Anchor slip: at some instant a knot or a clamp gives way, and from then on all is shifted.
//!
//! `x = u + slip·s(t)`, `s` a ramp from 0 to 1 that is half done `at` seconds after the first sample and lasts
//! `width·at`. An instant has no slope to follow, and how long a record is is not known to an effect; so the ramp
//! begins as wide as a share of its time, at any scale of time, and the fit narrows it as it closes in. mm, slip per
//! channel. Limit: one slip; several are several ramps that one of them averages.

use super::conditions::Context;
use super::declaration::*;

pub static EFFECT: Effect = Effect {
    declaration: Declaration {
        name: "anchor_slip",
        family: "slow drift",
        stage: Stage::Transmission,
        kind: Kind::Effect,
        formula: "x = u + slip · min(max((t − t₀ − at) / (width · at) + ½, 0), 1)",
        doc: "A knot, a clamp or a crimp gives way under load once: the tendon is longer ever after.",
        signature: "All is well up to one instant; after it everything is shifted by a constant, at home too.",
        reference: "Ramp of a share of its own time, our choice; a step in the limit.",
        experiment: ("home at the start, in between and at the end", 0.5),
        alike: &[],
        needs: &[],
        parameters: &[
            Parameter::new(
                "slip",
                "mm",
                0.0,
                0.5,
                -4.0,
                4.0,
                "shortening added to the channel after the slip",
            )
            .per_channel(),
            Parameter::new(
                "at",
                "s",
                30.0,
                30.0,
                1.0,
                3600.0,
                "time of the slip after the first sample, in a fit within the run",
            )
            .instant(),
            Parameter::new(
                "width",
                "1",
                0.5,
                0.5,
                0.01,
                1.0,
                "how long the slip lasts, as a share of its time",
            ),
        ],
    },
    law: Law::Channel(&AnchorSlip),
};

struct AnchorSlip;

/// Shortest slip, s, so that a width of nothing is a step and no division by zero.
const INSTANT: f64 = 1e-9;

impl ChannelEffect for AnchorSlip {
    /// Whether a sample was seen, and the time of the first.
    fn state_size(&self, _channels: usize) -> usize {
        2
    }

    fn settle(&self, _params: &[f64], _x: &mut [f64], state: &mut [f64]) {
        state.fill(0.0);
    }

    fn step(&self, params: &[f64], x: &mut [f64], state: &mut [f64], context: &Context) {
        if state[0] == 0.0 {
            state.copy_from_slice(&[1.0, context.t]);
        }
        let (slip, times) = params.split_at(x.len());
        let late = context.t - state[1] - times[0];
        let done = (late / (times[0] * times[1]).max(INSTANT) + 0.5).clamp(0.0, 1.0);
        x.iter_mut()
            .zip(slip)
            .for_each(|(x, slip)| *x += slip * done);
    }
}
