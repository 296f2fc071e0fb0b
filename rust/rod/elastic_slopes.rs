//! Exact slopes of an elastic rod's markers over each of its numbers, for fits; one equilibrium per
//! command.
//!
//! At the minimum H·dφ = −∂(gradient), so one factorisation serves all numbers. With δ, w and g of
//! `elastic.rs`: stiffness κ_s: −φ_s · pretension: w·g · slack: Σ_{δ ≤ 0} δ·g · angle, radius
//! (which turn g by g'): w·(δ·g' − (g'·φ)·g). Lengths, rest bendings, base and tilt only move the
//! arcs (`arc.rs`).

use super::elastic::{ElasticRod, Equilibrium, along};
use crate::algebra::Vec3;
use crate::shape::Shape;

impl ElasticRod {
    /// Markers (3M,) at `u` and their slopes (3M, P) by every number, written to `out` and
    /// `slopes`.
    pub fn number_slopes(&self, u: &[f64], out: &mut [f64], slopes: &mut [f64]) {
        let (first, width) = (self.layout.first, self.layout.width());
        debug_assert_eq!(
            (out.len(), slopes.len()),
            (self.size(), self.size() * width)
        );
        let equilibrium = self.equilibrium(u);
        let bends = self.bends(&equilibrium);
        let chain = self.chain(&bends);
        let turns = self.turns(&equilibrium);
        let mut moves = chain.room();
        for (m, &(k, f)) in self.layout.markers.iter().enumerate() {
            chain.point(k, f).write_to_slice(&mut out[3 * m..]);
            chain.slopes(k, f, &mut moves);
            let mut put = |at: usize, slope: Vec3| {
                for axis in 0..3 {
                    slopes[(3 * m + axis) * width + at] = slope[axis];
                }
            };
            for (at, turn) in turns.iter().enumerate() {
                put(at, along(&moves.bends, turn));
            }
            let direct = [
                (first.length, &moves.lengths[..]),
                (first.rest, &moves.bends[..]),
                (first.tilt, &moves.tilt[..]),
            ];
            for (at, kind) in direct {
                for (i, slope) in kind.iter().enumerate() {
                    put(at + i, *slope);
                }
            }
            for (i, axis) in Vec3::AXES.into_iter().enumerate() {
                put(first.base + i, axis);
            }
        }
    }

    /// dφ (2S,) per unit of slack, each angle, radius, pretension and stiffness, in the order of
    /// the numbers.
    fn turns(&self, equilibrium: &Equilibrium) -> Vec<Vec<f64>> {
        let first = self.layout.first;
        let mut turns = vec![vec![0.0; 2 * self.layout.segments]; first.length];
        for j in 0..self.layout.tendons.len() {
            let (stretch, row) = (equilibrium.stretch[j], self.row(j));
            let weight = self.weight(stretch);
            let radius = self.numbers[first.radius + j];
            let (sin, cos) = self.numbers[first.angle + j].sin_cos();
            turns[first.angle + j] = self.moved(equilibrium, j, [-radius * sin, radius * cos]);
            turns[first.radius + j] = self.moved(equilibrium, j, [cos, sin]);
            for (i, reach) in row.iter().enumerate() {
                turns[first.pretension + j][i] = weight * reach;
                turns[0][i] += stretch.min(0.0) * reach;
            }
        }
        for (i, bend) in equilibrium.bent.iter().enumerate() {
            turns[first.stiffness + i / 2][i] = -bend;
        }
        for turn in &mut turns {
            equilibrium.hessian.solve(turn);
        }
        turns
    }
    /// −∂(gradient) (2S,) per mm of shift of tendon `j` along `aside`.
    fn moved(&self, equilibrium: &Equilibrium, j: usize, aside: [f64; 2]) -> Vec<f64> {
        let (stretch, row) = (equilibrium.stretch[j], self.row(j));
        let passed = 2 * (self.layout.tendons[j].end + 1);
        let less: f64 = (0..passed)
            .map(|i| aside[i % 2] * equilibrium.bent[i])
            .sum();
        let weight = self.weight(stretch);
        let force = |i: usize| weight * (stretch * aside[i % 2] - less * row[i]);
        (0..row.len())
            .map(|i| if i < passed { force(i) } else { 0.0 })
            .collect()
    }

    /// −∂(gradient) (2S,) per rad of rotation of a command's tendons about the axis.
    pub(super) fn turning(&self, equilibrium: &Equilibrium, channel: usize) -> Vec<f64> {
        let first = self.layout.first;
        let mut force = vec![0.0; 2 * self.layout.segments];
        let mine = self.layout.tendons.iter().enumerate();
        for (j, _) in mine.filter(|(_, tendon)| tendon.channel == channel) {
            let (sin, cos) = self.numbers[first.angle + j].sin_cos();
            let radius = self.numbers[first.radius + j];
            let one = self.moved(equilibrium, j, [-radius * sin, radius * cos]);
            force.iter_mut().zip(one).for_each(|(sum, f)| *sum += f);
        }
        force
    }
}
