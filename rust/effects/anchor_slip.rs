//! Anchor slip: at some instant a knot or a clamp slips; from then on one cable of the pair is
//! longer.
//!
//! `s(t) = slip·r(t)`, `r` a ramp from 0 to 1 that is half done `at` seconds after the first sample
//! and lasts `width·at`. The cable that pulls against s is longer by |s|; `pair.rs` has the effect
//! on the command: `taut` 0 for cables that only pull and hang loose at home, 1 for a pair that is
//! held taut or takes compression, where the full channel is shifted. A fit to a step has no slope
//! over its time, and an effect does not know the length of a record. So the ramp starts as wide as
//! a share of its time, at any time scale, and the fit narrows it as it converges. mm, slip per
//! channel. Limit: one slip; several slips are averaged.

use super::conditions::Context;
use super::declaration::*;
use super::elapsed::{self, elapsed};
use super::pair::{lengthened, taut};

pub static EFFECT: Effect = Effect {
    declaration: Declaration {
        name: "anchor_slip",
        family: "slow drift",
        stage: Stage::Transmission,
        kind: Kind::Effect,
        formula: "x = u + s  where the longer cable pulls, u + taut · s  where the other does, s = \
            slip · min(max((t − t₀ − at) / (width · at) + ½, 0), 1)",
        doc: "A knot, a clamp or a crimp gives way under load once: that tendon is longer ever \
            after.",
        signature: "All is well up to one instant; after it one side is shifted by a constant; \
            home and the other side as far as the pair is taut.",
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
                -6.0,
                6.0,
                "shortening that the slip adds to the channel; its sign says which cable",
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
            taut("share of the slip that shows while the other cable pulls"),
        ],
    },
    law: Law::Channel(&AnchorSlip),
};

struct AnchorSlip;

/// Shortest slip, s: a zero width is then a step, not a division by zero.
const INSTANT: f64 = 1e-9;

impl ChannelEffect for AnchorSlip {
    fn state_size(&self, _channels: usize) -> usize {
        elapsed::SIZE
    }

    fn settle(&self, _params: &[f64], _x: &mut [f64], state: &mut [f64]) {
        state.fill(0.0);
    }

    fn step(&self, params: &[f64], x: &mut [f64], state: &mut [f64], context: &Context) {
        let (slip, numbers) = params.split_at(x.len());
        let late = elapsed(state, context) - numbers[0];
        let done = (late / (numbers[0] * numbers[1]).max(INSTANT) + 0.5).clamp(0.0, 1.0);
        for (x, slip) in x.iter_mut().zip(slip) {
            let s = slip * done;
            *x = lengthened(*x, [(-s).max(0.0), s.max(0.0)], numbers[2]);
        }
    }
}
