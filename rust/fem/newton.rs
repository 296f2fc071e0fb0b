//! Equilibria by Newton's method on the total energy, from a known equilibrium to the next load in
//! small steps.
//!
//! A step starts from the tangent predictor dx = K⁻¹ (df − Σ kc b dd), then Newton with Armijo
//! backtracking on the total energy (Nocedal & Wright, ch. 3); the last, short steps reuse the
//! factor (chord method: Kelley, Solving Nonlinear Equations with Newton's Method, 2003). An
//! indefinite tangent is shifted on its diagonal, so every step is a descent step; a failed step is
//! halved. Limit: it follows one branch; a snap-through ends on some branch of lower energy.

use super::Vec3;
use super::cable::Drive;
use super::solid::{Load, Solid, Work};
use super::work::inner;
use crate::error::{Error, Result, invalid};
use std::sync::atomic::{AtomicBool, Ordering};

/// Largest change of a shortening in one step, mm (median 2 to 3 iterations).
const STEP_MM: f64 = 1.5;
/// Largest change of a tension in one step, N.
const STEP_N: f64 = 1.0;
/// Largest change of gravity in one step, g, and of the tip load, N.
const STEP_GRAVITY: f64 = 0.5;
const STEP_TIP: f64 = 0.1;
/// Most steps on the path to a load: farther loads are beyond any finger and fail earlier.
const MOST_STEPS: f64 = 256.0;
/// Smallest halved step, as a part of its usual length.
const SMALLEST_PART: f64 = 1.0 / 64.0;
/// Converged if no unknown is out of balance by more, N: bends a finger by less than 1e-4 mm.
const BALANCED: f64 = 1e-7;
/// Converged if a full step moves no node by more, mm: the next one would move its square.
const SETTLED: f64 = 2e-4;
const ITERATIONS: usize = 40;
/// The factor is reused from steps that move no node by more, mm.
const NEAR: f64 = 0.5;
/// It is reused while each step is at most this part of the previous one, and at most so many
/// times.
const SHRINKS: f64 = 0.2;
const CHORDS: usize = 5;
/// Converged if such a step moves no node by more, mm.
const AT_REST: f64 = 2e-5;
/// Largest motion of a node in a Newton step, mm.
const LONGEST: f64 = 10.0;

/// An equilibrium.
#[derive(Debug, Clone)]
pub struct State {
    pub x: Vec<Vec3>,
    pub load: Load,
}

/// Finds equilibria on one thread and keeps the factor for the next step.
pub struct Solver<'a> {
    pub work: Work<'a>,
    /// Whether the factor in `work` belongs to the last state reached, or to a nearby one.
    fresh: bool,
    /// Set by another thread to stop before the next iteration.
    stop: Option<&'a AtomicBool>,
}

impl<'a> Solver<'a> {
    pub fn new(solid: &'a Solid) -> Result<Solver<'a>> {
        Ok(Solver {
            work: Work::new(solid)?,
            fresh: false,
            stop: None,
        })
    }

    /// The same, but ends with `Interrupted` soon after `stop` is set.
    pub fn watching(solid: &'a Solid, stop: &'a AtomicBool) -> Result<Solver<'a>> {
        Ok(Solver {
            stop: Some(stop),
            ..Solver::new(solid)?
        })
    }

    fn stopped(&self) -> bool {
        self.stop.is_some_and(|stop| stop.load(Ordering::Relaxed))
    }

    /// Equilibrium without shortening under gravity and a tip load.
    pub fn home(&mut self, gravity: Vec3, tip: Vec3) -> Result<State> {
        let solid = self.work.solid;
        let still = Load {
            cables: vec![0.0; solid.cables.len()],
            ..Load::default()
        };
        let mut state = State {
            x: solid.mesh.nodes.clone(),
            load: still.clone(),
        };
        self.fresh = false;
        self.advance(
            &mut state,
            &Load {
                gravity,
                tip,
                ..still
            },
        )?;
        Ok(state)
    }

    /// The next `advance` starts from another state than the end of the last one.
    pub fn forget(&mut self) {
        self.fresh = false;
    }

    /// Move an equilibrium to another load; on failure, the state is the last equilibrium on the
    /// path.
    pub fn advance(&mut self, state: &mut State, goal: &Load) -> Result<()> {
        let start = state.load.clone();
        let usual = 1.0
            / steps(self.work.solid, &start, goal)
                .clamp(1.0, MOST_STEPS)
                .ceil();
        let mut part = usual;
        let mut done = 0.0;
        while done < 1.0 {
            let next = if done + part > 1.0 - 1e-9 {
                1.0
            } else {
                done + part
            };
            let load = between(&start, goal, next);
            match self.step(state, &load) {
                Ok(()) => {
                    done = next;
                    part = (1.5 * part).min(usual);
                }
                Err(_) if self.stopped() => return Err(Error::Interrupted),
                Err(residual) => {
                    self.fresh = false;
                    part *= 0.5;
                    if part < SMALLEST_PART * usual {
                        return Err(no_equilibrium(&load, residual));
                    }
                }
            }
        }
        state.load = goal.clone();
        Ok(())
    }

    /// Pull of each cable, N: its tension, or below zero how slack it is.
    pub fn pulls(&self, state: &State) -> Vec<f64> {
        let cables = &self.work.solid.cables;
        cables
            .iter()
            .zip(&state.load.cables)
            .map(|(c, &d)| c.pull(&state.x, d))
            .collect()
    }

    /// Assemble and factor at an equilibrium, so `work` has its compliance.
    pub fn linearise(&mut self, state: &State) -> Result<()> {
        self.work.assemble(&state.x, &state.load);
        self.fresh = self.work.refactor();
        if self.fresh {
            Ok(())
        } else {
            Err(no_equilibrium(&state.load, f64::NAN))
        }
    }

    /// Newton's method at a load from guessed positions, as from another mesh of the same solid.
    pub fn settle(&mut self, guess: Vec<Vec3>, load: &Load) -> Result<State> {
        let mut state = State {
            x: guess.clone(),
            load: load.clone(),
        };
        match self.newton(&mut state, guess, load) {
            Ok(()) => Ok(state),
            Err(_) if self.stopped() => Err(Error::Interrupted),
            Err(residual) => Err(no_equilibrium(load, residual)),
        }
    }

    fn step(&mut self, state: &mut State, load: &Load) -> std::result::Result<(), f64> {
        let x = self.predict(state, load).unwrap_or_else(|| state.x.clone());
        self.newton(state, x, load)
    }

    fn newton(
        &mut self,
        state: &mut State,
        mut x: Vec<Vec3>,
        load: &Load,
    ) -> std::result::Result<(), f64> {
        let mut residual = f64::NAN;
        for _ in 0..ITERATIONS {
            if self.stopped() {
                return Err(residual);
            }
            let energy = self.work.assemble(&x, load);
            if !energy.is_finite() {
                return Err(f64::INFINITY);
            }
            residual = self
                .work
                .residual
                .iter()
                .fold(0.0, |m: f64, r| m.max(r.abs()));
            if !self.work.refactor() {
                return Err(residual);
            }
            if residual < BALANCED {
                return self.arrive(state, x, load);
            }
            let (moved, longest, full) = self.descend(&x, load, energy).ok_or(residual)?;
            x = moved;
            if full && self.work.shift == 0.0 {
                if longest < SETTLED {
                    return self.arrive(state, x, load);
                }
                if let Some(there) = self.chord(&x, load, longest) {
                    return self.arrive(state, there, load);
                }
            }
        }
        Err(residual)
    }

    /// Continue from `x` with the current factor after a step of `longest` mm: a new one would
    /// hardly differ. None if it does not converge quickly.
    fn chord(&mut self, x: &[Vec3], load: &Load, mut longest: f64) -> Option<Vec<Vec3>> {
        let mut x = x.to_vec();
        for _ in 0..CHORDS {
            if longest > NEAR || !self.work.balance(&x, load) {
                return None;
            }
            let before = longest;
            let step;
            (step, longest, _) = self.downhill()?;
            if longest > SHRINKS * before {
                return None;
            }
            x = self.work.solid.displace(&x, &step, 1.0);
            if longest < AT_REST {
                return Some(x);
            }
        }
        None
    }

    fn arrive(
        &mut self,
        state: &mut State,
        x: Vec<Vec3>,
        load: &Load,
    ) -> std::result::Result<(), f64> {
        *state = State {
            x,
            load: load.clone(),
        };
        self.fresh = true;
        Ok(())
    }

    /// The step with the current factor, its longest motion, and the slope of the energy along it;
    /// None if that is positive.
    fn downhill(&mut self) -> Option<(Vec<f64>, f64, f64)> {
        let residual = &self.work.residual;
        let step = self.work.solve(residual.iter().map(|r| -r).collect());
        let longest = step.iter().fold(0.0, |m: f64, s| m.max(s.abs()));
        let slope = inner(&self.work.residual, &step);
        // The maximum of NaNs is 0; their sum is NaN.
        (longest.is_finite() && slope <= 0.0).then_some((step, longest, slope))
    }

    /// One Newton step with backtracking: new positions, longest motion, whether the full step was
    /// taken.
    fn descend(&mut self, x: &[Vec3], load: &Load, energy: f64) -> Option<(Vec<Vec3>, f64, bool)> {
        let solid = self.work.solid;
        let (step, longest, slope) = self.downhill()?;
        let whole = (LONGEST / longest).min(1.0);
        let mut alpha = whole;
        // Round-off of energies of 100 N·mm, summed over a thousand cells.
        let noise = 1e-12 * (1.0 + energy.abs());
        while alpha > 1e-6 {
            let moved = solid.displace(x, &step, alpha);
            let there = solid.energy(&moved, load);
            if there <= energy + 1e-4 * alpha * slope + noise {
                return Some((moved, alpha * longest, alpha == 1.0));
            }
            alpha *= 0.5;
        }
        None
    }

    /// Tangent predictor, kept only if it has less energy under the new load than the old
    /// positions.
    fn predict(&mut self, state: &State, load: &Load) -> Option<Vec<Vec3>> {
        if *load == state.load {
            return None;
        }
        if !self.fresh {
            self.linearise(state).ok()?;
        }
        let solid = self.work.solid;
        let mut rhs = solid.dead_vector(&Load {
            cables: Vec::new(),
            gravity: load.gravity - state.load.gravity,
            tip: load.tip - state.load.tip,
        });
        let mut pull = |c: usize, b: &[f64]| {
            let (cable, [from, to]) = (&solid.cables[c], [&state.load, load].map(|l| l.cables[c]));
            let more = match cable.drive {
                Drive::Shortening => cable.stiffness * (to - from),
                Drive::Tension => to.max(0.0) - from.max(0.0),
            };
            rhs.iter_mut().zip(b).for_each(|(r, b)| *r -= more * b);
        };
        self.work.taut.iter().for_each(|(c, b)| pull(*c, b));
        for (c, cable) in solid.cables.iter().enumerate() {
            if cable.drive == Drive::Tension {
                pull(c, &self.work.slope(c, &state.x));
            }
        }
        let step = self.work.solve(rhs);
        let moved = solid.displace(&state.x, &step, 1.0);
        (solid.energy(&moved, load) < solid.energy(&state.x, load)).then_some(moved)
    }
}

/// One Newton step of the elements alone, without cables or loads, at node places (n,): the
/// displacement (n,) mm.
pub fn newton_step(solid: &Solid, x: &[Vec3]) -> Result<Vec<Vec3>> {
    if x.len() != solid.mesh.nodes.len() {
        return Err(invalid(format!(
            "x: {} nodes given, the mesh has {}; give every node its place",
            x.len(),
            solid.mesh.nodes.len()
        )));
    }
    // With this much length paid out, every cable is slack.
    let slack = Load {
        cables: vec![-1e9; solid.cables.len()],
        ..Load::default()
    };
    let mut work = Work::new(solid)?;
    if !work.assemble(x, &slack).is_finite() || !work.refactor() {
        return Err(Error::NoEquilibrium(
            "no Newton step: a cell is inside out; bend less".into(),
        ));
    }
    let step = work.solve(work.residual.iter().map(|r| -r).collect());
    Ok(solid.displace(&vec![Vec3::ZERO; x.len()], &step, 1.0))
}

/// Number of steps to a load, before rounding up.
fn steps(solid: &Solid, from: &Load, to: &Load) -> f64 {
    let largest = |a: Vec3, b: Vec3, unit: f64| (a - b).abs().max_element() / unit;
    let commands = from.cables.iter().zip(&to.cables).zip(&solid.cables);
    commands
        .fold(0.0, |m: f64, ((p, q), cable)| {
            let unit = match cable.drive {
                Drive::Shortening => STEP_MM,
                Drive::Tension => STEP_N,
            };
            m.max((p - q).abs() / unit)
        })
        .max(largest(from.gravity, to.gravity, STEP_GRAVITY))
        .max(largest(from.tip, to.tip, STEP_TIP))
}

fn between(a: &Load, b: &Load, t: f64) -> Load {
    let mix = |p: &[f64], q: &[f64]| {
        p.iter()
            .zip(q)
            .map(|(p, q)| p + t * (q - p))
            .collect::<Vec<f64>>()
    };
    Load {
        cables: mix(&a.cables, &b.cables),
        gravity: a.gravity + t * (b.gravity - a.gravity),
        tip: a.tip + t * (b.tip - a.tip),
    }
}

fn no_equilibrium(load: &Load, residual: f64) -> Error {
    Error::NoEquilibrium(format!(
        "no equilibrium at tendon commands {:.3?} (mm, or N by tension), gravity {:.2} g, tip \
        load {:.3} N: largest force out of balance {residual:.2e} N (allowed {BALANCED:.0e}); try \
        smaller commands or loads, a stiffer material, or a finer mesh",
        load.cables, load.gravity, load.tip
    ))
}

#[cfg(test)]
#[path = "newton_tests.rs"]
pub(super) mod tests;

#[cfg(test)]
#[path = "beam_tests.rs"]
mod beam_tests;
