//! The command for a target effective command: the chain of effects, inverted one sample at a time.
//!
//! Play and slack have no slope, so no slope is used as a divisor. Each command is moved away from
//! the last one until the effective command (one sample of the chain, without updating its memory)
//! has passed the target. Bisection and secants then close this bracket. Of all solutions, the one
//! nearest to the last command is used, so nothing moves inside a play. Coupled commands are solved
//! in turns until they agree. A delay and a lag cannot be inverted, because they depend on earlier
//! commands: they are omitted here and previewed along a known path. After `new`, nothing is
//! allocated. Limits: the effective command must be monotone in its command; a user-defined effect
//! is rejected. Pinned by chain_tests.rs and tests/model/test_kinematics.py.

use crate::effects::{Chain, Context};
use crate::error::{Result, invalid};

/// Tolerance of the effective command, mm: a hundredth of a tick.
const CLOSE: f64 = 2e-5;
/// Most rounds through all commands, and halvings of one bracket.
const ROUNDS: usize = 12;
const HALVINGS: usize = 60;
/// Effects of this family are previewed, not inverted.
const PREVIEWED: &str = "delay";

/// A chain without its delays, its memory, and its target.
#[derive(Debug, Clone)]
pub struct Inverse {
    chain: Chain,
    params: Vec<f64>,
    low: Vec<f64>,
    high: Vec<f64>,
    /// The command of each effective command, and whether both increase together.
    by: Vec<(usize, bool)>,
    context: Context,
    state: Vec<f64>,
    trial: Vec<f64>,
    acts: Vec<f64>,
    /// The last command, mm.
    last: Vec<f64>,
    settled: bool,
    /// Error of the effective command before its command moves, mm.
    band: f64,
}

impl Inverse {
    /// Of a `chain` with `params` (P,), whose commands stay within `low` and `high` (C,) mm.
    /// `context` has the conditions; its times are ignored.
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

    /// The same with constant commands while the error of the effective command is at most `band`
    /// mm. A caller that rounds commands needs a band of this width: otherwise an excess of half a
    /// tick crosses the full play back.
    pub fn with_band(self, band: f64) -> Inverse {
        Inverse {
            band: band.max(CLOSE),
            ..self
        }
    }

    pub fn channels(&self) -> usize {
        self.low.len()
    }

    /// Whether `wanted` (C,) exceeds the reachable effective commands by more than half the width
    /// of the bounds: an invalid target, which must not map to the nearest command.
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

    /// Assign commands to effective commands by large moves at rest, the largest first.
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

    /// Start in equilibrium with `u` (C,) held forever; return the effective command.
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

    /// Advance by `dt` seconds with the command `u` (C,) mm; return the effective command.
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

    /// The effective command of channel `a` for a command `u`, `dt` seconds after the last one.
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

    /// Write the command (C,) nearest to the last one with the effective command `wanted` (C,) mm,
    /// `dt` seconds later; return the error (mm) of the worst channel, within the bounds.
    pub fn command(&mut self, wanted: &[f64], dt: f64, command: &mut [f64]) -> f64 {
        if !self.settled {
            // No command yet: everything is at rest.
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

    /// Move the command of effective command `a` to the nearest value that gives `wanted`.
    fn close(&mut self, wanted: f64, dt: f64, a: usize, command: &mut [f64]) {
        let (c, rises) = self.by[a];
        let (low, high) = (self.low[c], self.high[c]);
        let mut near = command[c];
        let mut short = wanted - self.peek(command, dt, a);
        if short.abs() <= self.band {
            return;
        }
        // From here on, `short` is positive and decreases towards `end`.
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
        // The nearest value is the first at which nothing is missing.
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
