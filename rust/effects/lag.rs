//! Lag: the drive follows its command like a first-order low pass.
//!
//! `tau·x' = u − x`, advanced exactly for commands that are linear between samples (as everywhere
//! in the chain): with `h = dt/tau`, `a = e^(−h)`, `p = (1 − a)/h`: `x⁺ = a·x + (p − a)·u_before +
//! (1 − p)·u`. The simple recursion `x += (1 − a)(u − x)` is half a period early; this one is exact
//! at any period. Units s. tau ≤ 0 is no lag.

use super::conditions::{Conditions, Context};
use super::declaration::*;
use super::low_pass::{low_pass, low_passed};

pub static EFFECT: Effect = Effect {
    declaration: Declaration {
        name: "lag",
        family: "delay",
        stage: Stage::Command,
        kind: Kind::Effect,
        formula: "tau · dx/dt = u − x",
        doc: "A first-order lag of the drive: position control with low gain, a compliant tendon \
            against damping.",
        signature: "Error in proportion to speed like latency, but corners and steps come out \
            rounded.",
        reference: "First-order hold equivalent of a first-order low pass (Franklin, Powell, \
                    Workman, Digital Control of Dynamic Systems).",
        experiment: (
            "fast and slow triangle of full range, seen while it moves",
            1.0,
        ),
        alike: &[],
        needs: &[],
        parameters: &[Parameter::new("tau", "s", 0.0, 0.12, 0.02, 3.0, "time constant").shared()],
    },
    law: Law::Channel(&Lag),
};

struct Lag;

impl ChannelEffect for Lag {
    fn state_size(&self, channels: usize) -> usize {
        2 * channels
    }

    fn settle(&self, _params: &[f64], x: &mut [f64], state: &mut [f64]) {
        let (low, before) = state.split_at_mut(x.len());
        low.copy_from_slice(x);
        before.copy_from_slice(x);
    }

    fn step(&self, params: &[f64], x: &mut [f64], state: &mut [f64], context: &Context) {
        let (low, before) = state.split_at_mut(x.len());
        let channels = x.iter_mut().zip(low).zip(before).zip(params);
        for (((x, low), before), tau) in channels {
            advance(*tau, low_pass(*tau, context.dt), x, low, before);
        }
    }

    /// Like single steps; the weights of many samples are computed together, once for all channels
    /// with one time constant.
    fn rollout(
        &self,
        params: &[f64],
        samples: &mut [f64],
        channels: usize,
        state: &mut [f64],
        conditions: &Conditions,
    ) {
        let (low, before) = state.split_at_mut(channels);
        for (first, tau) in params.iter().enumerate() {
            if params[..first].contains(tau) {
                continue;
            }
            low_passed([*tau], samples, channels, conditions, |[weights], x| {
                for c in first..channels {
                    if params[c] == *tau {
                        advance(*tau, weights, &mut x[c], &mut low[c], &mut before[c]);
                    }
                }
            });
        }
    }
}

/// Advance one sample of one channel.
#[inline]
fn advance(tau: f64, [a, b, c]: [f64; 3], x: &mut f64, low: &mut f64, before: &mut f64) {
    let u = *x;
    *low = a * *low + (b * *before + c * u);
    *before = u;
    *x = if tau > 0.0 { *low } else { u };
}
