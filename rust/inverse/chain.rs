//! What must be commanded now so that a certain command acts: the chain of effects, inverted one
//! sample at a time.
//!
//! Play and slack have no slope, so nothing is divided by one: each command is moved away from the
//! last one until what would act (one sample of the chain, remembering nothing) has passed what is
//! requested, and that bracket is closed by halving and by secants. Of all commands that do, the
//! nearest to the last one is taken, so that inside a play nothing moves. Commands that act on each
//! other are taken in turns until they agree. A delay and a lag cannot be inverted, what they ask
//! for lies in the past: they are left out here and previewed along a known path. After `new`
//! nothing is allocated. Limits: what acts must not fall while its command rises (or the other way
//! round); a user's own effect is refused. Pinned by chain_tests.rs and
//! tests/model/test_kinematics.py.

use crate::effects::{Chain, Context};
use crate::error::{Result, invalid};

/// mm within which the effective command equals the target: a hundredth of a tick.
const CLOSE: f64 = 2e-5;
/// Rounds through all commands, and halvings of one bracket.
const ROUNDS: usize = 12;
const HALVINGS: usize = 60;
/// Effects of this family are previewed, not inverted.
const PREVIEWED: &str = "delay";

/// A chain without its delays, what it remembers, and what it is asked.
#[derive(Debug, Clone)]
pub struct Inverse {
    chain: Chain,
    params: Vec<f64>,
    low: Vec<f64>,
    high: Vec<f64>,
    /// Which command moves each number that acts, and whether both rise together.
    by: Vec<(usize, bool)>,
    context: Context,
    state: Vec<f64>,
    trial: Vec<f64>,
    acts: Vec<f64>,
    /// The last command, mm.
    last: Vec<f64>,
    settled: bool,
    /// mm by which what acts may be off before its command moves.
    band: f64,
}

impl Inverse {
    /// Of a `chain` with `params` (P,), whose commands stay within `low` and `high` (C,) mm.
    /// `context` says what the world is like; its times do not matter.
    pub fn new(
        chain: &Chain,
        params: &[f64],
        low: Vec<f64>,
        high: Vec<f64>,
        context: Context,
    ) -> Result<Inverse> {
        chain.stepwise()?;
        chain.check(params)?;
        let channels = chain.channels();
        let turned = |c: usize| !(low[c].is_finite() && high[c].is_finite() && low[c] <= high[c]);
        if low.len() != channels || high.len() != channels || (0..channels).any(turned) {
            return Err(invalid(format!(
                "bounds {low:?} and {high:?} for {channels} commands; give finite numbers for \
                each, low first"
            )));
        }
        let (chain, params) = chain.without(params, PREVIEWED)?;
        let mut made = Inverse {
            state: vec![0.0; chain.state_size()],
            trial: vec![0.0; chain.state_size()],
            acts: vec![0.0; channels],
            last: vec![0.0; channels],
            by: (0..channels).map(|c| (c, true)).collect(),
            context: Context {
                t: 0.0,
                dt: 0.0,
                ..context
            },
            settled: false,
            band: CLOSE,
            chain,
            params,
            low,
            high,
        };
        made.match_commands()?;
        Ok(made)
    }

    /// The same with commands that stay while what acts is off by no more than `band` mm. A caller
    /// that rounds commands needs a band as wide: else half a tick too far asks for the full
    /// play back.
    pub fn with_band(self, band: f64) -> Inverse {
        Inverse {
            band: band.max(CLOSE),
            ..self
        }
    }

    pub fn channels(&self) -> usize {
        self.low.len()
    }

    /// Whether `wanted` (C,) lies beyond what the bounds could bring about by more than half their
    /// width: no aim, and not one that should be answered by the nearest command.
    pub fn absurd(&self, wanted: &[f64]) -> bool {
        wanted.iter().zip(&self.by).any(|(mm, (c, rises))| {
            let (low, high) = if *rises {
                (self.low[*c], self.high[*c])
            } else {
                (-self.high[*c], -self.low[*c])
            };
            (mm - mm.clamp(low, high)).abs() > 0.5 * (high - low)
        })
    }

    /// Find which command moves which number, from large moves at rest: the largest first.
    fn match_commands(&mut self) -> Result<()> {
        let channels = self.channels();
        let rest: Vec<f64> = (0..channels)
            .map(|c| 0.0f64.clamp(self.low[c], self.high[c]))
            .collect();
        let mut moves = vec![];
        for c in 0..channels {
            let (mut up, mut down) = (rest.clone(), rest.clone());
            (up[c], down[c]) = (self.high[c], self.low[c]);
            for x in [&mut up, &mut down] {
                let mut settled = self.chain.init(&self.params, &rest)?;
                self.chain
                    .step(&self.params, x, &mut settled, &self.context);
            }
            moves.extend((0..channels).map(|a| (up[a] - down[a], a, c)));
        }
        moves.sort_by(|x, y| y.0.abs().total_cmp(&x.0.abs()));
        let mut taken = vec![(false, false); channels];
        for (by, a, c) in moves {
            if !taken[a].0 && !taken[c].1 {
                (taken[a].0, taken[c].1) = (true, true);
                self.by[a] = (c, by >= 0.0);
            }
        }
        Ok(())
    }

    /// Begin in equilibrium with `u` (C,) held forever; what acts then.
    pub fn settle(&mut self, u: &[f64]) -> &[f64] {
        self.last.copy_from_slice(u);
        self.rest();
        &self.acts
    }

    fn rest(&mut self) {
        self.acts.copy_from_slice(&self.last);
        self.chain
            .settle(&self.params, &mut self.acts, &mut self.state);
        (self.context.t, self.settled) = (0.0, true);
    }

    /// `u` (C,) mm has been commanded for the last `dt` seconds; what it makes act.
    pub fn passed(&mut self, u: &[f64], dt: f64) -> &[f64] {
        if !self.settled {
            return self.settle(u);
        }
        self.context.t += dt;
        self.context.dt = dt;
        self.acts.copy_from_slice(u);
        self.chain
            .step(&self.params, &mut self.acts, &mut self.state, &self.context);
        self.last.copy_from_slice(u);
        &self.acts
    }

    /// The effective command in channel `a` if `u` were commanded `dt` seconds after the last one.
    fn peek(&mut self, u: &[f64], dt: f64, a: usize) -> f64 {
        self.trial.copy_from_slice(&self.state);
        self.acts.copy_from_slice(u);
        let context = Context {
            t: self.context.t + dt,
            dt,
            ..self.context
        };
        self.chain
            .step(&self.params, &mut self.acts, &mut self.trial, &context);
        self.acts[a]
    }

    /// Write the command (C,) that makes `wanted` (C,) mm act `dt` seconds after the last one, the
    /// nearest to it; returns by how much (mm) the worst channel misses, within the bounds.
    pub fn command(&mut self, wanted: &[f64], dt: f64, command: &mut [f64]) -> f64 {
        if !self.settled {
            // Nothing was commanded yet: all has been at rest forever.
            self.last.fill(0.0);
            self.rest();
        }
        command.copy_from_slice(&self.last);
        for (u, (low, high)) in command.iter_mut().zip(self.low.iter().zip(&self.high)) {
            *u = u.clamp(*low, *high);
        }
        for _ in 0..ROUNDS {
            let mut moved = 0.0f64;
            for a in 0..wanted.len() {
                let c = self.by[a].0;
                let before = command[c];
                self.close(wanted[a], dt, a, command);
                moved = moved.max((command[c] - before).abs());
            }
            if moved <= CLOSE {
                break;
            }
        }
        (0..wanted.len()).fold(0.0, |worst: f64, a| {
            worst.max((self.peek(command, dt, a) - wanted[a]).abs())
        })
    }

    /// Move the command of number `a` that acts to the nearest place where it is `wanted`.
    fn close(&mut self, wanted: f64, dt: f64, a: usize, command: &mut [f64]) {
        let (c, rises) = self.by[a];
        let (low, high) = (self.low[c], self.high[c]);
        let mut near = command[c];
        let mut short = wanted - self.peek(command, dt, a);
        if short.abs() <= self.band {
            return;
        }
        // From here on `short` is positive and falls on the way to `end`.
        let sign = short.signum();
        let up = (sign > 0.0) == rises;
        let end = if up { high } else { low };
        let (mut far, mut step) = (near, short.abs());
        let mut beyond = short * sign;
        short *= sign;
        while beyond > 0.0 && far != end {
            (near, short) = (far, beyond);
            far = if up {
                (far + step).min(end)
            } else {
                (far - step).max(end)
            };
            step *= 2.0;
            command[c] = far;
            beyond = sign * (wanted - self.peek(command, dt, a));
        }
        if beyond > 0.0 {
            return; // at its bound
        }
        // The nearest place is the target: the first at which nothing is short any more.
        for k in 0..HALVINGS {
            let width = (far - near).abs();
            if width <= 1e-9 || (short <= CLOSE && beyond >= -CLOSE && width <= CLOSE) {
                break;
            }
            let secant = short / (short - beyond);
            let share = if k % 2 == 0 && beyond < 0.0 {
                secant
            } else {
                0.5
            };
            let middle = near + share.clamp(0.01, 0.99) * (far - near);
            command[c] = middle;
            let left = sign * (wanted - self.peek(command, dt, a));
            if left > CLOSE * 0.5 {
                (near, short) = (middle, left);
            } else {
                (far, beyond) = (middle, left);
            }
        }
        command[c] = far;
    }
}

#[cfg(test)]
#[path = "chain_tests.rs"]
mod tests;
