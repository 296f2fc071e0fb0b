//! How the markers of an elastic rod move with each of its numbers: what a fit needs, exact, one equilibrium a command.
//!
//! At the minimum H·dφ = −∂(gradient), so one factorisation serves all numbers. With δ, w and g of `elastic.rs`:
//!   stiffness κ_s: −φ_s · pretension: w·g · slack: Σ_{δ ≤ 0} δ·g · angle, radius (which turn g by g'): w·(δ·g' − (g'·φ)·g).
//! Lengths, rest bendings, base and tilt only move the arcs (`arc.rs`).

use super::elastic::{ElasticRod, Equilibrium, along};
use crate::shape::Shape;
use crate::vector::Vec3;

impl ElasticRod {
    /// Markers (3M,) at `u` and their slopes (3M, P) by every number, written to `out` and `slopes`.
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
            out[3 * m..3 * m + 3].copy_from_slice(&chain.point(k, f));
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
            put(first.base, [1.0, 0.0, 0.0]);
            put(first.base + 1, [0.0, 1.0, 0.0]);
            put(first.base + 2, [0.0, 0.0, 1.0]);
        }
    }

    /// dφ (2S,) per unit of slack, each angle, radius, pretension and stiffness, in the order of the numbers.
    fn turns(&self, equilibrium: &Equilibrium) -> Vec<Vec<f64>> {
        let first = self.layout.first;
        let mut turns = vec![vec![0.0; 2 * self.layout.segments]; first.length];
        for (j, tendon) in self.layout.tendons.iter().enumerate() {
            let (stretch, row) = (equilibrium.stretch[j], self.row(j));
            let weight = self.weight(stretch);
            let radius = self.numbers[first.radius + j];
            let (sin, cos) = self.numbers[first.angle + j].sin_cos();
            let (mut x, mut y) = (0.0, 0.0); // Σ φ of the segments that it passes
            for bend in equilibrium.bent[..2 * (tendon.end + 1)].chunks_exact(2) {
                x += bend[0];
                y += bend[1];
            }
            for (at, turned) in [
                (first.angle + j, [-radius * sin, radius * cos]),
                (first.radius + j, [cos, sin]),
            ] {
                let less = turned[0] * x + turned[1] * y;
                for i in 0..2 * (tendon.end + 1) {
                    turns[at][i] = weight * (stretch * turned[i % 2] - less * row[i]);
                }
            }
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
}
