//! Rate limit: the drive follows its command no faster than a certain speed.
//!
//! `dx/dt = clamp(du/dt while x = u, ±speed)`, else `±speed` towards u. Advanced exactly for
//! commands linear between samples, also if x reaches u within a sample and falls behind again.
//! mm/s, one number for all channels; speed ≤ 0 is no limit. Memory starts in equilibrium, x = u.

use super::conditions::Context;
use super::declaration::*;

pub static EFFECT: Effect = Effect {
    declaration: Declaration {
        name: "rate_limit",
        family: "delay",
        stage: Stage::Command,
        kind: Kind::Effect,
        formula: "|dx/dt| ≤ speed,  x → u",
        doc: "A largest speed of the drive: the profile velocity of a servo, a weak motor, a limit \
            in its firmware.",
        signature: "Nothing in slow moves; in fast ones the finger falls behind along a straight \
              ramp and catches up after the command stands.",
        reference: "Rate limiter: Tarbouriech and others, Stability and Stabilization of Linear \
              Systems with Saturating Actuators, Springer 2011.",
        experiment: (
            "triangles of full range at two speeds, seen while they move",
            1.0,
        ),
        alike: &[],
        needs: &[],
        parameters: &[Parameter::new(
            "speed",
            "mm/s",
            0.0,
            6.0,
            0.5,
            80.0,
            "largest speed of a command; 0 for none",
        )
        .shared()],
    },
    law: Law::Channel(&RateLimit),
};

struct RateLimit;

/// Position of a follower of speed `v` after `dt`, from `x`, for a command linear from `a` to `b`.
#[inline]
fn follow(v: f64, dt: f64, x: f64, a: f64, b: f64) -> f64 {
    let (gap, rise) = (a - x, b - a);
    if gap * rise < 0.0 && rise.abs() > v * dt {
        // They approach each other, meet after `share` of the sample, and the command continues
        // faster.
        let share = gap.abs() / (v * dt + rise.abs());
        if share < 1.0 {
            let met = x + gap.signum() * v * dt * share;
            return met + rise.signum() * v * dt * (1.0 - share);
        }
    }
    b.max(x - v * dt).min(x + v * dt)
}

impl ChannelEffect for RateLimit {
    fn state_size(&self, channels: usize) -> usize {
        2 * channels
    }

    fn settle(&self, _params: &[f64], x: &mut [f64], state: &mut [f64]) {
        let (there, before) = state.split_at_mut(x.len());
        there.copy_from_slice(x);
        before.copy_from_slice(x);
    }

    #[inline]
    fn step(&self, params: &[f64], x: &mut [f64], state: &mut [f64], context: &Context) {
        let (there, before) = state.split_at_mut(x.len());
        let channels = x.iter_mut().zip(there).zip(before).zip(params);
        for (((x, there), before), speed) in channels {
            let u = *x;
            *there = if *speed > 0.0 {
                follow(*speed, context.dt, *there, *before, u)
            } else {
                u
            };
            *before = u;
            *x = *there;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::follow;

    #[test]
    fn one_long_sample_is_many_short_ones() {
        for (x, a, b) in [
            (0.0, 2.0, -9.0),
            (0.0, 2.0, -1.0),
            (3.0, -4.0, 20.0),
            (0.0, 0.0, 9.0),
            (1.0, 5.0, 5.0),
            (0.0, 3.0, 1.0),
        ] {
            let (v, n) = (4.0, 4000);
            let mut fine = x;
            for k in 0..n {
                let at = |k: usize| a + (b - a) * k as f64 / n as f64;
                fine = follow(v, 1.0 / n as f64, fine, at(k), at(k + 1));
            }
            // The error of a short sample is at most its motion.
            assert!(
                (follow(v, 1.0, x, a, b) - fine).abs() < 1e-12,
                "{x} {a} {b}: {fine}"
            );
        }
    }
}
