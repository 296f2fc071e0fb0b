//! Mullins softening: up to the largest previous bend, the body is softer than beyond it.
//!
//! `y = x·(1 + softening·(1 − exp(−(X − |x|)/reach)))`, |x| the length of the vector of the
//! channels of a section and X the largest so far, which is memory. mm. A bend in one direction
//! softens all directions: the damage is in the body, not in a tendon. It starts in equilibrium: X
//! = |x| of the first command, an untouched body. Exact for commands on straight lines between
//! samples; reach ≤ 0 is reached at once. Source: the form of Ogden and Roxburgh's damage, written
//! for a bend instead of an energy. Limits: two channels bend a section, or three if their number
//! is odd and divisible by three, else all; no recovery.

use super::conditions::Context;
use super::declaration::*;

pub static EFFECT: Effect = Effect {
    declaration: Declaration {
        name: "mullins",
        family: "slow drift",
        stage: Stage::Material,
        kind: Kind::Effect,
        formula: "y = x · (1 + softening · (1 − exp(−(max|x| − |x|)/reach))), |x| over the \
            channels of a section",
        doc: "Filled rubber breaks in: after its first large stretch it is softer for all smaller \
            ones, in every direction.",
        signature: "The same command bends further after a larger one than before it; nothing on \
            the very first way out.",
        reference: "Ogden and Roxburgh, Proc. R. Soc. A 455 (1999) 2861.",
        experiment: ("triangles of growing size, then of falling size", 2.0),
        alike: &[],
        needs: &[],
        parameters: &[
            Parameter::new(
                "softening",
                "1",
                0.0,
                0.1,
                0.01,
                0.5,
                "most that is gained far below the largest bend so far",
            ),
            Parameter::new(
                "reach",
                "mm",
                4.0,
                4.0,
                0.5,
                20.0,
                "distance below the largest bend at which 63 % of it is gained",
            ),
        ],
    },
    law: Law::Channel(&Mullins),
};

struct Mullins;

impl ChannelEffect for Mullins {
    fn state_size(&self, channels: usize) -> usize {
        channels.div_ceil(section(channels))
    }

    fn settle(&self, _params: &[f64], x: &mut [f64], state: &mut [f64]) {
        let sections = state.iter_mut().zip(x.chunks(section(x.len())));
        sections.for_each(|(most, x)| *most = size(x));
    }

    #[inline]
    fn step(&self, params: &[f64], x: &mut [f64], state: &mut [f64], _context: &Context) {
        let together = section(x.len());
        for (most, x) in state.iter_mut().zip(x.chunks_mut(together)) {
            let now = size(x);
            *most = most.max(now);
            let below = (*most - now) / params[1].max(f64::MIN_POSITIVE);
            let softer = 1.0 - params[0] * (-below).exp_m1();
            x.iter_mut().for_each(|x| *x *= softer);
        }
    }
}

/// The number of channels that bend one section: pairs of tendons, three tendons, or all.
fn section(channels: usize) -> usize {
    let even = [2, 3].into_iter().find(|n| channels.is_multiple_of(*n));
    even.unwrap_or(channels)
}

fn size(x: &[f64]) -> f64 {
    x.iter().map(|x| x * x).sum::<f64>().sqrt()
}
