//! Latency: the drive follows an earlier command.
//!
//! `x(t) = u(t − delay)`, linear between samples, so the delay need not be a multiple of the period
//! and can be fitted. Memory is a ring of past samples with their times. Before the first sample
//! the first command is held forever. Limit: delays up to [`MAX_DELAY`]; samples closer than half
//! of [`SPACING`] are thinned so that the ring always spans it (none at rates up to 900 Hz).
//! Source: pure dead time of any sampled drive. Pinned by the tests below.

use super::conditions::Context;
use super::declaration::*;
use crate::error::{Result, invalid};

/// Longest delay that the ring holds, s.
const MAX_DELAY: f64 = 0.55;
/// A power of two, so that finding a slot is cheap.
const SLOTS: usize = 512;
/// Any two neighbouring intervals in the ring last at least this together, s.
const SPACING: f64 = 2.0 * MAX_DELAY / (SLOTS - 2) as f64;

pub static EFFECT: Effect = Effect {
    declaration: Declaration {
        name: "latency",
        family: "delay",
        stage: Stage::Command,
        kind: Kind::Effect,
        formula: "x(t) = u(t − delay)",
        doc: "A pure delay between command and motion: bus, servo firmware, filtering. It shifts \
              the motion without rounding it.",
        signature: "Error in proportion to speed, with the sign of the motion; none at rest; \
            corners keep their shape.",
        reference: "Dead time of a sampled drive (any text on process control).",
        experiment: ("fast triangle of full range, seen while it moves", 0.5),
        alike: &[],
        needs: &[],
        parameters: &[Parameter::new(
            "delay",
            "s",
            0.0,
            0.08,
            0.005,
            0.5,
            "age of the command that acts",
        )
        .shared()],
    },
    law: Law::Channel(&Latency),
};

struct Latency;

// State: number of stored samples, the read position of each channel (C), the first command (C),
// then per slot its time and command. Positions count samples, like the store.
const KEPT: usize = 0;
const CURSOR: usize = 1;

/// The ring inside a state slice.
struct Ring<'a> {
    state: &'a mut [f64],
    channels: usize,
}

impl Ring<'_> {
    fn first(&self) -> usize {
        CURSOR + self.channels
    }

    fn slot(&self, index: usize) -> usize {
        CURSOR + 2 * self.channels + (index % SLOTS) * (1 + self.channels)
    }

    fn time(&self, index: usize) -> f64 {
        self.state[self.slot(index)]
    }

    fn push(&mut self, t: f64, x: &[f64]) {
        let mut kept = self.state[KEPT] as usize;
        let crowded = kept >= 2 && t - self.time(kept - 2) < SPACING;
        if crowded || (kept >= 1 && t <= self.time(kept - 1)) {
            kept -= 1; // replaces the newest
        }
        let slot = self.slot(kept);
        self.state[slot] = t;
        self.state[slot + 1..slot + 1 + x.len()].copy_from_slice(x);
        self.state[KEPT] = (kept + 1) as f64;
    }

    /// The command of channel `c` at time `t`.
    fn read(&mut self, t: f64, c: usize) -> f64 {
        let kept = self.state[KEPT] as usize;
        let (oldest, newest) = (kept.saturating_sub(SLOTS), kept - 1);
        if t < self.time(oldest) {
            let held = if oldest == 0 {
                self.first()
            } else {
                self.slot(oldest) + 1
            };
            return self.state[held + c];
        }
        let mut cursor = (self.state[CURSOR + c] as usize).clamp(oldest, newest);
        while cursor < newest && self.time(cursor + 1) <= t {
            cursor += 1;
        }
        while cursor > oldest && self.time(cursor) > t {
            cursor -= 1;
        }
        self.state[CURSOR + c] = cursor as f64;
        let here = self.slot(cursor);
        if cursor == newest {
            return self.state[here + 1 + c];
        }
        let next = self.slot(cursor + 1);
        let share = (t - self.state[here]) / (self.state[next] - self.state[here]);
        let (from, to) = (self.state[here + 1 + c], self.state[next + 1 + c]);
        from + share * (to - from)
    }
}

impl ChannelEffect for Latency {
    fn state_size(&self, channels: usize) -> usize {
        CURSOR + 2 * channels + SLOTS * (1 + channels)
    }

    fn settle(&self, _params: &[f64], x: &mut [f64], state: &mut [f64]) {
        state.fill(0.0);
        let first = CURSOR + x.len();
        state[first..first + x.len()].copy_from_slice(x);
    }

    fn step(&self, params: &[f64], x: &mut [f64], state: &mut [f64], context: &Context) {
        let mut ring = Ring {
            state,
            channels: x.len(),
        };
        ring.push(context.t, x);
        for (c, (x, delay)) in x.iter_mut().zip(params).enumerate() {
            if *delay > 0.0 {
                *x = ring.read(context.t - delay, c);
            }
        }
    }

    fn check(&self, params: &[f64]) -> Result<()> {
        match params.iter().find(|delay| **delay > MAX_DELAY) {
            Some(delay) => Err(invalid(format!(
                "latency.delay is {delay} s; the ring of past commands holds at most {MAX_DELAY} \
                s, so choose a shorter delay"
            ))),
            None => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn context(t: f64) -> Context {
        Context {
            t,
            dt: 0.0,
            gravity: [0.0, 0.0, 1.0],
            load: 0.0,
            temperature: f64::NAN,
            seen_for: 0.0,
        }
    }

    #[test]
    fn a_ramp_comes_out_late_at_any_rate() {
        for rate in [3.0, 30.0, 1000.0, 20_000.0] {
            let mut state = vec![0.0; Latency.state_size(1)];
            Latency.settle(&[0.37], &mut [0.0], &mut state);
            let (mut x, mut t) = ([0.0], 0.0);
            while t < 1.5 {
                x[0] = 2.0 * t;
                Latency.step(&[0.37], &mut x, &mut state, &context(t));
                // A ramp is linear, so interpolation is exact after thinning.
                assert!(
                    (x[0] - 2.0 * (t - 0.37).max(0.0)).abs() < 1e-9,
                    "rate {rate}, t {t}: {}",
                    x[0]
                );
                t += 1.0 / rate;
            }
        }
    }

    #[test]
    fn the_delay_may_change_from_sample_to_sample() {
        let mut state = vec![0.0; Latency.state_size(1)];
        Latency.settle(&[0.1], &mut [0.0], &mut state);
        for k in 0..200 {
            let t = 0.01 * k as f64;
            let delay = 0.25 + 0.2 * (k as f64).sin();
            let mut x = [t];
            Latency.step(&[delay], &mut x, &mut state, &context(t));
            assert!((x[0] - (t - delay).max(0.0)).abs() < 1e-12);
        }
    }
}
