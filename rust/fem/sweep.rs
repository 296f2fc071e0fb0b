//! Many equilibria: sweeps over a tensor grid, paths, and results at the equilibria of given
//! commands.
//!
//! Each solve starts from a neighbour. A sweep goes from home along the first axis, then from each
//! of those states along the next axis, in both directions, in parallel. A path is cut into chunks
//! of fixed length, so the result does not depend on the number of cores. Responses to loads:
//! `compliance.rs`, `bend.rs`.

use super::Vec3;
use super::embed::Points;
use super::newton::{Solver, State};
use super::progress::Progress;
use super::solid::{Load, Solid};
use crate::error::{Error, Result, invalid};
use crate::memory::room;
use rayon::prelude::*;
use std::sync::atomic::{AtomicBool, Ordering};

/// Commands of a path that one thread solves in sequence.
const CHUNK: usize = 64;

/// Limit of command (mm), gravity (g) and tip load (N): no finger has an equilibrium beyond.
const LARGEST: f64 = 1e6;

/// Largest distance of nodes of one mesh outside another of the same solid, mm.
const FACETS: f64 = 2.5;

/// The result of one command: positions of the points, and the pull of each cable (N; negative:
/// slack).
#[derive(Debug, Clone, Default)]
pub struct Configuration {
    pub places: Vec<Vec3>,
    pub pull: Vec<f64>,
}

/// A solid with the reported points and the map from commands to cables.
pub struct Simulation {
    pub solid: Solid,
    pub points: Points,
    /// Commanded shortening or tension of cable t per unit of command c: `drive[t][c]`.
    pub drive: Vec<Vec<f64>>,
}

impl Simulation {
    /// Rejects a drive without one number per cable and command.
    pub fn new(solid: Solid, points: Points, drive: Vec<Vec<f64>>) -> Result<Simulation> {
        let channels = drive.first().map_or(0, Vec::len);
        let even = drive
            .iter()
            .all(|row| row.len() == channels && row.iter().all(|v| v.is_finite()));
        if drive.len() != solid.cables.len() || !even {
            return Err(invalid(format!(
                "drive: {} rows for {} tendons; give each tendon one finite number for each \
                command",
                drive.len(),
                solid.cables.len()
            )));
        }
        Ok(Simulation {
            solid,
            points,
            drive,
        })
    }

    /// Number of commands.
    pub fn channels(&self) -> usize {
        self.drive.first().map_or(0, Vec::len)
    }

    /// The load of a command.
    pub fn load(&self, command: &[f64], gravity: Vec3, tip: Vec3) -> Result<Load> {
        let loads = [gravity.to_array(), tip.to_array()];
        let mut numbers = command.iter().chain(loads.as_flattened());
        if command.len() != self.channels() || !numbers.all(|v| v.abs() <= LARGEST) {
            return Err(invalid(format!(
                "command {command:?}, gravity {gravity}, load {tip}: expected {} commands in \
                mm or N, and loads in g and N, each within ±{LARGEST:e}",
                self.channels()
            )));
        }
        let cables = self
            .drive
            .iter()
            .map(|row| row.iter().zip(command).map(|(a, u)| a * u).sum())
            .collect();
        Ok(Load {
            cables,
            gravity,
            tip,
        })
    }

    /// Every command of the grid `axes`, last axis fastest.
    pub fn sweep(
        &self,
        axes: &[Vec<f64>],
        gravity: Vec3,
        tip: Vec3,
        progress: &Progress,
    ) -> Result<Vec<Configuration>> {
        self.check_axes(axes)?;
        let lengths: Vec<usize> = axes.iter().map(Vec::len).collect();
        self.room("a sweep", &lengths, 1)?;
        let command: Vec<f64> = axes.iter().map(|a| a[nearest_home(a)]).collect();
        let mut solver = Solver::watching(&self.solid, &progress.stop)?;
        let start = self.load(&command, gravity, tip)?;
        let mut home = solver.home(gravity, tip)?;
        solver.advance(&mut home, &start)?;
        if axes.is_empty() {
            progress.count()?;
            return Ok(vec![self.configuration(&solver, &home)]);
        }
        drop(solver);
        // States along the finished axes, with their commands, in C order.
        let mut spine = vec![(command, home)];
        for (c, axis) in axes.iter().enumerate().take(axes.len() - 1) {
            let grown = spine
                .par_iter()
                .map(|(u, state)| {
                    self.line(u, state, c, axis, &progress.stop, |_, state| {
                        Ok(state.clone())
                    })
                })
                .collect::<Result<Vec<_>>>()?;
            spine = grown
                .into_iter()
                .flat_map(|(commands, states)| commands.into_iter().zip(states))
                .collect();
        }
        let last = axes.len() - 1;
        let rows = spine
            .par_iter()
            .map(|(u, state)| {
                let keep = |solver: &Solver, state: &State| {
                    progress.count()?;
                    Ok(self.configuration(solver, state))
                };
                let (_, shapes) = self.line(u, state, last, &axes[last], &progress.stop, keep)?;
                Ok(shapes)
            })
            .collect::<Result<Vec<_>>>()?;
        Ok(rows.into_iter().flatten().collect())
    }

    fn check_axes(&self, axes: &[Vec<f64>]) -> Result<()> {
        if axes.len() != self.channels()
            || axes
                .iter()
                .any(|a| a.is_empty() || a.windows(2).any(|w| w[1] <= w[0]))
        {
            return Err(invalid(format!(
                "sweep axes: expected {} ascending axes, got lengths {:?}",
                self.channels(),
                axes.iter().map(Vec::len).collect::<Vec<_>>()
            )));
        }
        Ok(())
    }

    /// States along one axis, in both directions from `state`.
    fn line<T: Clone>(
        &self,
        command: &[f64],
        state: &State,
        axis: usize,
        values: &[f64],
        stop: &AtomicBool,
        keep: impl Fn(&Solver, &State) -> Result<T>,
    ) -> Result<(Vec<Vec<f64>>, Vec<T>)> {
        let start = nearest_home(values);
        let commands: Vec<Vec<f64>> = values
            .iter()
            .map(|&v| {
                let mut u = command.to_vec();
                u[axis] = v;
                u
            })
            .collect();
        let mut kept: Vec<Option<T>> = vec![None; values.len()];
        let mut solver = Solver::watching(&self.solid, stop)?;
        let up: Vec<usize> = (start..values.len()).collect();
        let down: Vec<usize> = (0..start).rev().collect();
        for way in [up, down] {
            let mut here = state.clone();
            solver.forget();
            for i in way {
                solver.advance(
                    &mut here,
                    &self.load(&commands[i], state.load.gravity, state.load.tip)?,
                )?;
                kept[i] = Some(keep(&solver, &here)?);
            }
        }
        Ok((commands, kept.into_iter().flatten().collect()))
    }

    /// Equilibria along a list of commands, each with its gravity, under one tip load.
    pub fn path(
        &self,
        commands: &[Vec<f64>],
        gravity: &[Vec3],
        tip: Vec3,
        progress: &Progress,
    ) -> Result<Vec<Configuration>> {
        self.room("a path", &[commands.len()], 1)?;
        self.follow(commands, gravity, tip, progress, |solver, state| {
            Ok(self.configuration(solver, state))
        })
    }

    /// The same with guesses from another mesh of this solid: Newton's method starts at its node
    /// positions.
    pub fn path_from(
        &self,
        other: &Simulation,
        commands: &[Vec<f64>],
        gravity: Vec3,
        tip: Vec3,
        progress: &Progress,
    ) -> Result<Vec<Configuration>> {
        let mesh = &self.solid.mesh;
        let carried = Points::embedded(&other.solid.mesh, &mesh.nodes, FACETS)?;
        let gravities = vec![gravity; commands.len()];
        let rough = other.follow(commands, &gravities, tip, progress, |_, state| {
            Ok(state.clone())
        })?;
        let mut solver = Solver::watching(&self.solid, &progress.stop)?;
        rough
            .into_iter()
            .map(|state| {
                let mut guess = carried.place(&state.x);
                for (n, place) in guess.iter_mut().enumerate() {
                    if mesh.clamped[n] {
                        *place = mesh.nodes[n];
                    }
                }
                let settled = solver.settle(guess, &state.load)?;
                Ok(self.configuration(&solver, &settled))
            })
            .collect()
    }

    /// The results of `keep` at the equilibrium of each command, solved in an order of short steps.
    pub(super) fn toured<T: Send>(
        &self,
        commands: &[Vec<f64>],
        gravity: Vec3,
        tip: Vec3,
        progress: &Progress,
        keep: impl Fn(&mut Solver, &State) -> Result<T> + Sync,
    ) -> Result<Vec<T>> {
        let order = short_tour(commands, &progress.stop)?;
        let sorted: Vec<Vec<f64>> = order.iter().map(|&i| commands[i].clone()).collect();
        let gravities = vec![gravity; sorted.len()];
        let found = self.follow(&sorted, &gravities, tip, progress, keep)?;
        let mut placed: Vec<(usize, T)> = order.into_iter().zip(found).collect();
        placed.sort_by_key(|(i, _)| *i);
        Ok(placed.into_iter().map(|(_, found)| found).collect())
    }

    fn follow<T: Send>(
        &self,
        commands: &[Vec<f64>],
        gravity: &[Vec3],
        tip: Vec3,
        progress: &Progress,
        keep: impl Fn(&mut Solver, &State) -> Result<T> + Sync,
    ) -> Result<Vec<T>> {
        if gravity.len() != commands.len() {
            return Err(invalid(format!(
                "gravity: {} rows for {} commands; give one a command",
                gravity.len(),
                commands.len()
            )));
        }
        for (u, &g) in commands.iter().zip(gravity) {
            self.load(u, g, tip)?; // a bad one is rejected before the others are solved
        }
        let chunks = commands
            .par_chunks(CHUNK)
            .zip(gravity.par_chunks(CHUNK))
            .map(|(commands, gravity)| {
                let mut solver = Solver::watching(&self.solid, &progress.stop)?;
                let mut state = solver.home(gravity[0], tip)?;
                let mut kept = Vec::with_capacity(commands.len());
                for (u, &g) in commands.iter().zip(gravity) {
                    let load = self.load(u, g, tip)?;
                    solver.advance(&mut state, &load)?;
                    kept.push(keep(&mut solver, &state)?);
                    progress.count()?;
                }
                Ok(kept)
            })
            .collect::<Result<Vec<_>>>()?;
        Ok(chunks.into_iter().flatten().collect())
    }

    /// Reject a result with several vectors per point that is too large for memory.
    pub fn room(&self, what: &str, commands: &[usize], vectors: usize) -> Result<()> {
        let a_command = [3 * vectors, self.points.weights.len()];
        room(
            &format!("{what} (commands, coordinates, points)"),
            &[commands, &a_command].concat(),
        )
        .map(|_| ())
    }

    fn configuration(&self, solver: &Solver, state: &State) -> Configuration {
        Configuration {
            places: self.points.place(&state.x),
            pull: solver.pulls(state),
        }
    }
}

fn nearest_home(axis: &[f64]) -> usize {
    (0..axis.len())
        .min_by(|&a, &b| axis[a].abs().total_cmp(&axis[b].abs()))
        .unwrap_or(0)
}

/// An order in which each command is the nearest remaining one: short steps between warm starts.
fn short_tour(commands: &[Vec<f64>], stop: &AtomicBool) -> Result<Vec<usize>> {
    let far = |a: &[f64], b: &[f64]| {
        a.iter()
            .zip(b)
            .fold(0.0, |m: f64, (p, q)| m.max((p - q).abs()))
    };
    let mut left: Vec<usize> = (0..commands.len()).collect();
    let mut here = vec![0.0; commands.first().map_or(0, Vec::len)];
    let mut order = Vec::with_capacity(left.len());
    while !left.is_empty() {
        if stop.load(Ordering::Relaxed) {
            return Err(Error::Interrupted);
        }
        let distance = |i: usize| far(&commands[left[i]], &here);
        let next = (0..left.len())
            .min_by(|&a, &b| distance(a).total_cmp(&distance(b)))
            .unwrap_or(0);
        let taken = left.remove(next);
        here = commands[taken].clone();
        order.push(taken);
    }
    Ok(order)
}

#[cfg(test)]
#[path = "sweep_tests.rs"]
mod tests;
