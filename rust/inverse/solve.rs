//! The reachable tip positions within bounds, and their effective commands.
//!
//! Levenberg–Marquardt on the exact slopes of the tip (Marquardt 1963; damping after Nielsen 1999,
//! IMM-REP-1999-05), with an active set for the bounds: a command at a bound that is pushed beyond
//! it stays there. A path continues from its last waypoint. A single point, and a waypoint that is
//! not reached, start at several distant ones of the nearest precomputed positions, so a fold of
//! the workspace is not a trap. For an unreachable target, the result is the nearest point found,
//! with its distance. A finger bent far by one pair of tendons has slack in the others, where
//! slopes are zero: hence the many starts. Limit: where tendons become slack, the tip of an
//! interpolated sweep folds back by micrometres within a few tenths of a mm of command; targets in
//! such a fold are missed by micrometres. Pinned by solve_tests.rs and
//! tests/model/test_kinematics.py.

use super::{Distance, PLACE};
use crate::algebra::dense::eliminate;
use crate::error::{Result, invalid};
use crate::shape::Shape;
use std::sync::Arc;

/// Distance of a reached target, mm: a servo tick moves a tip by more than a hundred times as much.
pub const REACHED: f64 = 1e-4;
/// Distance and step that end a search, mm; the distance is known to about 1e-5 in single
/// precision.
const NEAR: f64 = 1e-5;
const CLOSE: f64 = 1e-6;
/// Initial damping of a search, as a share of the largest slope: from a start, from the previous
/// waypoint.
const ANEW: f64 = 1e-3;
const WARM: f64 = 1e-6;
const ROUNDS: usize = 60;
/// Rounds from each start of a restarted search: a reachable target needs three or four.
const BRIEF: usize = 12;
/// Starts of a restarted search, and their least distance, as a share of the ranges.
const STARTS: usize = 8;
const APART: f64 = 0.1;
/// Precomputed positions: a grid for few commands, else space-filling points.
const GRID: [usize; 4] = [1, 33, 17, 9];
const FILLING: usize = 1024;

/// A tip within bounds of the effective commands.
pub struct Reach {
    shape: Arc<dyn Shape>,
    low: Vec<f64>,
    high: Vec<f64>,
    axes: [bool; PLACE],
    samples: Vec<f64>,
    places: Vec<f64>,
}

/// The solution for one target.
#[derive(Debug, Clone, PartialEq)]
pub struct Found {
    /// Effective command (C,) mm.
    pub u: Vec<f64>,
    /// The tip position there.
    pub place: [f64; PLACE],
    /// Distance to the target along the used axes, mm.
    pub distance: f64,
    /// Number of evaluations of the tip.
    pub asked: usize,
}

impl Reach {
    /// A tip `shape` (three outputs) whose commands stay within `low` and `high` (C,); only the
    /// `axes` of a target are used.
    pub fn new(
        shape: Arc<dyn Shape>,
        low: Vec<f64>,
        high: Vec<f64>,
        axes: [bool; PLACE],
    ) -> Result<Reach> {
        let channels = shape.channels();
        if shape.size() != PLACE {
            return Err(invalid(format!(
                "a tip has {PLACE} outputs, this shape has {}",
                shape.size()
            )));
        }
        if channels == 0 || low.len() != channels || high.len() != channels {
            return Err(invalid(format!(
                "bounds of {} and {} numbers for {channels} commands; give one each, and at least \
                one command",
                low.len(),
                high.len()
            )));
        }
        let turned =
            |c: &usize| !(low[*c].is_finite() && high[*c].is_finite() && low[*c] <= high[*c]);
        if let Some(c) = (0..channels).find(turned) {
            return Err(invalid(format!(
                "bounds of command {c} are {} and {} mm; expected finite numbers, low first",
                low[c], high[c]
            )));
        }
        if !axes.contains(&true) {
            return Err(invalid("no axis counts; name at least one of x, y, z"));
        }
        let samples = sampled(&low, &high);
        let mut places = vec![0.0; samples.len() / channels * PLACE];
        shape.eval_rows(&samples, &mut places);
        Ok(Reach {
            shape,
            low,
            high,
            axes,
            samples,
            places,
        })
    }

    pub fn channels(&self) -> usize {
        self.low.len()
    }

    /// Precomputed commands (S, C) and their tip positions (S, 3).
    pub fn looked_at(&self) -> (&[f64], &[f64]) {
        (&self.samples, &self.places)
    }

    pub(super) fn tip(&self) -> Distance {
        Distance::new(self.shape.clone(), self.axes)
    }

    pub(super) fn bounds(&self) -> (&[f64], &[f64]) {
        (&self.low, &self.high)
    }

    /// The effective command with the tip nearest to `target`, a single point, or one that follows
    /// `from`.
    pub fn solve(&self, target: &[f64; PLACE], from: Option<&[f64]>) -> Found {
        self.search(&mut Search::new(self), target, from)
    }

    fn search(&self, search: &mut Search, target: &[f64; PLACE], from: Option<&[f64]>) -> Found {
        let before = search.tip.asked;
        let mut best: Option<Found> = from.map(|u| search.from(u, target, WARM, ROUNDS));
        let reached = |best: &Option<Found>| best.as_ref().is_some_and(|b| b.distance <= REACHED);
        let starts = if reached(&best) {
            vec![]
        } else {
            self.starts(target)
        };
        for start in starts {
            let found = search.from(&start, target, ANEW, BRIEF);
            // A waypoint leaves its branch only for a clearly nearer solution.
            if best
                .as_ref()
                .is_none_or(|best| found.distance < best.distance - REACHED)
            {
                best = Some(found);
            }
            if reached(&best) {
                break;
            }
        }
        let mut best = best.unwrap_or_else(|| unreachable!("there is always a start"));
        if best.distance > REACHED {
            best = search.from(&best.u, target, ANEW, ROUNDS);
        }
        best.asked = search.tip.asked - before;
        best
    }

    /// The same for targets (T, 3) in sequence, each from the previous solution.
    pub fn path(&self, targets: &[f64], from: Option<&[f64]>) -> Vec<Found> {
        let mut found: Vec<Found> = Vec::with_capacity(targets.len() / PLACE);
        let mut search = Search::new(self);
        for target in targets.chunks_exact(PLACE) {
            let target = &[target[0], target[1], target[2]];
            let before = found.last().map(|last| last.u.clone());
            found.push(self.search(&mut search, target, before.as_deref().or(from)));
        }
        found
    }

    /// The nearest precomputed positions that are distant from each other.
    fn starts(&self, target: &[f64; PLACE]) -> Vec<Vec<f64>> {
        let away = |place: &[f64]| -> f64 {
            let axes = (0..PLACE).filter(|i| self.axes[*i]);
            axes.map(|i| (place[i] - target[i]).powi(2)).sum()
        };
        let mut order: Vec<(f64, usize)> =
            self.places.chunks_exact(PLACE).map(away).zip(0..).collect();
        order.sort_by(|a, b| a.0.total_cmp(&b.0));
        let channels = self.channels();
        let at = |i: usize| &self.samples[i * channels..(i + 1) * channels];
        let mut starts: Vec<Vec<f64>> = vec![];
        for (_, i) in order {
            let far = |other: &Vec<f64>| {
                (0..channels)
                    .any(|c| (at(i)[c] - other[c]).abs() > APART * (self.high[c] - self.low[c]))
            };
            if starts.iter().all(far) {
                starts.push(at(i).to_vec());
                if starts.len() == STARTS {
                    break;
                }
            }
        }
        starts
    }
}

/// A grid for up to three commands, beyond that points of Halton's sequence (1960).
fn sampled(low: &[f64], high: &[f64]) -> Vec<f64> {
    let channels = low.len();
    let at = |c: usize, share: f64| low[c] + share * (high[c] - low[c]);
    if let Some(each) = GRID.get(channels) {
        let count = each.pow(channels as u32);
        let node = |i: usize, c: usize| i / each.pow(c as u32) % each;
        let share = |i: usize, c: usize| node(i, c) as f64 / (each - 1) as f64;
        return (0..count * channels)
            .map(|k| at(k % channels, share(k / channels, k % channels)))
            .collect();
    }
    let bases: Vec<usize> = (2..)
        .filter(|n| (2..*n).all(|d| n % d != 0))
        .take(channels)
        .collect();
    let halton = |mut i: usize, base: usize| {
        let (mut share, mut part) = (0.0, 1.0 / base as f64);
        while i > 0 {
            share += part * (i % base) as f64;
            (i, part) = (i / base, part / base as f64);
        }
        share
    };
    let mut points: Vec<f64> = (0..channels).map(|c| at(c, 0.5)).collect();
    for i in 1..FILLING {
        points.extend((0..channels).map(|c| at(c, halton(i, bases[c]))));
    }
    points
}

/// A search and its storage.
struct Search<'a> {
    reach: &'a Reach,
    tip: Distance,
    gradient: Vec<f64>,
    normal: Vec<f64>,
    /// Both at a trial.
    next: (Vec<f64>, Vec<f64>),
    system: Vec<f64>,
    trial: Vec<f64>,
    free: Vec<usize>,
}

impl Search<'_> {
    fn new(reach: &Reach) -> Search<'_> {
        let channels = reach.channels();
        Search {
            reach,
            tip: reach.tip(),
            gradient: vec![0.0; channels],
            normal: vec![0.0; channels * channels],
            next: (vec![0.0; channels], vec![0.0; channels * channels]),
            system: vec![0.0; channels * (channels + 1)],
            trial: vec![0.0; channels],
            free: vec![],
        }
    }

    fn from(&mut self, start: &[f64], target: &[f64; PLACE], share: f64, rounds: usize) -> Found {
        let channels = self.reach.channels();
        let bounds = self.reach.low.iter().zip(&self.reach.high);
        let mut u: Vec<f64> = start
            .iter()
            .zip(bounds)
            .map(|(u, (l, h))| {
                if u.is_finite() {
                    u.clamp(*l, *h)
                } else {
                    0.5 * (l + h)
                }
            })
            .collect();
        let (mut gradient, mut normal) = (
            std::mem::take(&mut self.gradient),
            std::mem::take(&mut self.normal),
        );
        let mut next = std::mem::take(&mut self.next);
        let mut now = self.tip.with_slopes(&u, target, &mut gradient, &mut normal);
        let mut place = self.tip.place;
        let largest = |normal: &[f64]| {
            (0..channels)
                .map(|c| normal[c * channels + c])
                .fold(0.0, f64::max)
        };
        let (mut damping, mut growth) = (share * largest(&normal).max(1e-12), 2.0);
        for _ in 0..rounds {
            if now.sqrt() <= NEAR || !self.step(&u, &gradient, &normal, damping) {
                break;
            }
            let moved = |c: usize| self.trial[c] - u[c];
            let longest = (0..channels).map(|c| moved(c).abs()).fold(0.0, f64::max);
            if longest <= CLOSE {
                break;
            }
            // The fall of the linearised distance.
            let promised: f64 = (0..channels)
                .map(|a| {
                    let bent: f64 = (0..channels)
                        .map(|b| normal[a * channels + b] * moved(b))
                        .sum();
                    -moved(a) * (2.0 * gradient[a] + bent)
                })
                .sum();
            // With slopes: most trials are accepted, and one pass over a network's weights gives
            // both.
            let there = self
                .tip
                .with_slopes(&self.trial, target, &mut next.0, &mut next.1);
            if there < now {
                let gain = if promised > 0.0 {
                    (now - there) / promised
                } else {
                    1.0
                };
                damping *= (1.0 - (2.0 * gain - 1.0).powi(3)).clamp(1.0 / 3.0, 2.0);
                growth = 2.0;
                u.copy_from_slice(&self.trial);
                (now, (gradient, normal), next) = (there, next, (gradient, normal));
                place = self.tip.place;
            } else {
                // Reached, without further gain: the rest is round-off of a model in single
                // precision.
                if now.sqrt() <= REACHED {
                    break;
                }
                damping *= growth;
                growth *= 2.0;
                if damping > 1e12 * largest(&normal).max(1e-12) {
                    break;
                }
            }
        }
        (self.gradient, self.normal, self.next) = (gradient, normal, next);
        Found {
            u,
            place,
            distance: now.sqrt(),
            asked: 0,
        }
    }

    /// Write the next trial; false if there is no step.
    fn step(&mut self, u: &[f64], gradient: &[f64], normal: &[f64], damping: f64) -> bool {
        let (low, high) = (&self.reach.low, &self.reach.high);
        let channels = u.len();
        self.free.clear();
        self.free.extend((0..channels).filter(|c| {
            let held = (u[*c] <= low[*c] && gradient[*c] > 0.0)
                || (u[*c] >= high[*c] && gradient[*c] < 0.0);
            !held
        }));
        self.trial.copy_from_slice(u);
        // Commands with a step beyond a bound stop there; the others are solved again without them.
        while !self.free.is_empty() {
            let n = self.free.len();
            let rows = &mut self.system[..n * (n + 1)];
            for (r, a) in self.free.iter().enumerate() {
                let row = &mut rows[r * (n + 1)..(r + 1) * (n + 1)];
                for (k, b) in self.free.iter().enumerate() {
                    row[k] = normal[a * channels + b];
                }
                row[r] += damping;
                // The contribution of the stopped commands.
                let held = (0..channels).filter(|b| !self.free.contains(b));
                let known: f64 = held
                    .map(|b| normal[a * channels + b] * (self.trial[b] - u[b]))
                    .sum();
                row[n] = -gradient[*a] - known;
            }
            if !eliminate(rows, n) {
                return false;
            }
            let mut stopped = None;
            for (r, c) in self.free.iter().enumerate() {
                let to = u[*c] + rows[r * (n + 1) + n];
                self.trial[*c] = to.clamp(low[*c], high[*c]);
                if stopped.is_none() && (to < low[*c] || to > high[*c]) {
                    stopped = Some(r);
                }
            }
            match stopped {
                None => return true,
                Some(r) => {
                    self.free.remove(r);
                }
            }
        }
        self.trial != u
    }
}

#[cfg(test)]
#[path = "solve_tests.rs"]
mod tests;
