//! Backlash: free play in the transmission; after a reversal nothing moves until the play is used
//! up.
//!
//! The play operator `y = clamp(y, u − gap/2, u + gap/2)`, `gap` the full free play of each
//! channel, mm. Memory starts centred, `y = u`. Exact for commands that are monotonic between
//! samples. gap ≤ 0 is no play. Source: M. A. Krasnosel'skii, A. V. Pokrovskii, Systems with
//! Hysteresis (1989).

use super::conditions::Context;
use super::declaration::*;

/// Half ranges of the commands: a wider gap would never transmit motion.
const MOST_PLAY: f64 = 1.95;

pub static EFFECT: Effect = Effect {
    declaration: Declaration {
        name: "backlash",
        family: "reversal hysteresis",
        stage: Stage::Transmission,
        kind: Kind::Effect,
        formula: "y = clamp(y, x − gap/2, x + gap/2)",
        doc: "Free play of gears, clutches and knots: the tendon follows its drive only outside a \
              dead zone that the motion drags along. Constant dry friction behind an elastic \
              tendon draws the same loop.",
        signature: "A loop of constant width between loading and unloading; no motion at all just \
            after a reversal.",
        reference: "Play operator: Krasnosel'skii and Pokrovskii, Systems with Hysteresis, \
            Springer 1989.",
        experiment: ("small loops at two offsets", 1.5),
        alike: &[],
        needs: &[],
        parameters: &[Parameter::new(
            "gap",
            "mm",
            0.0,
            0.4,
            0.04,
            4.0,
            "full free play (half-width = gap/2)",
        )
        .shared()
        .reaching(Reach::HalfRanges(2.0))
        .with_map(WithMap::HalfRanges(MOST_PLAY))],
    },
    law: Law::Channel(&Backlash),
};

struct Backlash;

impl ChannelEffect for Backlash {
    fn state_size(&self, channels: usize) -> usize {
        channels
    }

    fn settle(&self, _params: &[f64], x: &mut [f64], state: &mut [f64]) {
        state.copy_from_slice(x);
    }

    #[inline]
    fn step(&self, params: &[f64], x: &mut [f64], state: &mut [f64], _context: &Context) {
        for ((x, y), gap) in x.iter_mut().zip(state).zip(params) {
            let half = 0.5 * gap.max(0.0);
            *y = y.max(*x - half).min(*x + half);
            *x = *y;
        }
    }
}
