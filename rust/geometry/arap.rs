//! As-rigid-as-possible deformation of a triangle surface, by local and global steps in turn.
//!
//!   E(p, R) = Σ_i Σ_j w_ij |(p_i − p_j) − R_i (r_i − r_j)|² + Σ_k c_k |p_k − q_k|²
//!
//! over the edges at each vertex (spokes; Sorkine & Alexa 2007). The local step finds for each
//! vertex the rotation nearest to Σ_j w_ij (p_i − p_j)(r_i − r_j)ᵀ, followed from the previous
//! step. The global step solves (2L + C) p = b, with the same matrix for all coordinates and all
//! rounds while the weights c are constant: it is factored once. Neither step increases the energy.
//! Units: mm.

use super::laplacian::Edges;
use super::rotation::{LANES, NO_TURN, Quaternion, follow, rotation};
use crate::algebra::sparse::{Factor, Pattern};
use crate::algebra::{Mat3, Vec3, outer};
use crate::error::{Result, invalid};
use std::sync::Arc;

/// Rounds of following a rotation: it hardly turns between global steps.
const ROUNDS: usize = 6;

/// A surface at rest, with the pattern of its system.
#[derive(Clone)]
pub struct Arap {
    rest: Vec<Vec3>,
    edges: Arc<Edges>,
    pattern: Arc<Pattern<1>>,
}

/// The positions of the vertices, and their rotations.
#[derive(Debug, Clone)]
pub struct Pose {
    pub places: Vec<Vec3>,
    pub turns: Vec<Quaternion>,
}

/// A surface with vertices constrained by certain strengths.
pub struct Held<'a> {
    arap: &'a Arap,
    strength: Vec<f64>,
    factor: Factor,
    right: Vec<f64>,
}

impl Arap {
    /// Of `triangles` (T, 3) between vertices at `rest` (N, 3).
    pub fn new(rest: Vec<Vec3>, triangles: &[[usize; 3]]) -> Result<Arap> {
        let edges = Edges::new(&rest, triangles)?;
        if let Some(alone) = (0..edges.len()).find(|i| edges.of(*i).next().is_none()) {
            return Err(invalid(format!(
                "vertex {alone} is in no triangle, so nothing says where it goes; leave it out"
            )));
        }
        let pairs = (0..edges.len()).flat_map(|i| edges.of(i).map(move |(j, _)| (i, j)));
        let pattern = Pattern::new(edges.len(), pairs.filter(|(i, j)| i > j))?;
        Ok(Arap {
            rest,
            edges: Arc::new(edges),
            pattern: Arc::new(pattern),
        })
    }

    /// The same surface with other rest positions (N, 3); its edges keep their weights.
    pub fn resting_at(&self, rest: Vec<Vec3>) -> Arap {
        Arap {
            rest,
            ..self.clone()
        }
    }

    /// The edges.
    pub fn edges(&self) -> &Edges {
        &self.edges
    }

    /// The vertices (N, 3) at rest.
    pub fn rest(&self) -> &[Vec3] {
        &self.rest
    }

    /// The surface at rest.
    pub fn pose(&self) -> Pose {
        Pose {
            places: self.rest.clone(),
            turns: vec![NO_TURN; self.rest.len()],
        }
    }

    /// Constrain the vertices with `strength` (N,), 0 for free ones.
    pub fn held(&self, strength: Vec<f64>) -> Result<Held<'_>> {
        let n = self.rest.len();
        if strength.len() != n || strength.iter().any(|c| !(*c >= 0.0 && c.is_finite())) {
            return Err(invalid(format!(
                "strength: {} numbers for {n} vertices; give each one of 0 or more",
                strength.len()
            )));
        }
        let mut values = vec![0.0; self.pattern.len()];
        for i in 0..n {
            let mut own = strength[i];
            for (j, w) in self.edges.of(i) {
                own += 2.0 * w;
                if let (true, Some(slot)) = (i > j, self.pattern.slot(i, j)) {
                    self.pattern.add(&mut values, j, slot, &[[-2.0 * w]]);
                }
            }
            self.pattern.add(&mut values, i, 0, &[[own]]);
        }
        let mut factor = Factor::new(&self.pattern, 3)?;
        if !factor.refactor(&self.pattern, &values) {
            return Err(invalid(
                "nothing holds a part of the surface, so it could be anywhere; hold one vertex of \
                each part or more",
            ));
        }
        Ok(Held {
            arap: self,
            strength,
            factor,
            right: vec![0.0; 3 * n],
        })
    }

    /// Fit the rotation of each vertex to the motion of its neighbours.
    pub fn local(&self, pose: &mut Pose) {
        let Pose { places, turns } = pose;
        for (first, some) in turns.chunks_mut(LANES).enumerate() {
            let mut a = [[[0.0; LANES]; 3]; 3];
            let mut lanes = [NO_TURN; LANES];
            lanes[..some.len()].copy_from_slice(some);
            for k in 0..some.len() {
                let i = LANES * first + k;
                let mut own = Mat3::ZERO;
                for (j, w) in self.edges.of(i) {
                    let (now, then) = (places[i] - places[j], self.rest[i] - self.rest[j]);
                    own += outer(now, w * then);
                }
                for c in 0..3 {
                    (0..3).for_each(|r| a[c][r][k] = own.col(c)[r]);
                }
            }
            follow(&a, &mut lanes, ROUNDS);
            some.copy_from_slice(&lanes[..some.len()]);
        }
    }

    /// The target sum of the edges at each vertex: Σ_j w_ij (R_i + R_j)(r_i − r_j).
    pub fn wanted(&self, turns: &[Quaternion], mut to: impl FnMut(usize, Vec3)) {
        let turns: Vec<_> = turns.iter().map(|q| rotation(*q)).collect();
        for i in 0..self.rest.len() {
            let mut sum = Vec3::ZERO;
            for (j, w) in self.edges.of(i) {
                sum += (turns[i] + turns[j]) * (w * (self.rest[i] - self.rest[j]));
            }
            to(i, sum);
        }
    }

    /// Energy of the edges alone, mm².
    pub fn energy(&self, pose: &Pose) -> f64 {
        let mut sum = 0.0;
        for i in 0..self.rest.len() {
            let turn = rotation(pose.turns[i]);
            for (j, w) in self.edges.of(i) {
                let then = turn * (self.rest[i] - self.rest[j]);
                let off = pose.places[i] - pose.places[j] - then;
                sum += w * off.length_squared();
            }
        }
        sum
    }
}

impl Held<'_> {
    /// One local and one global step towards `goals` (N, 3); those without strength are ignored.
    pub fn step(&mut self, pose: &mut Pose, goals: &[Vec3]) {
        let (arap, n) = (self.arap, self.arap.rest.len());
        arap.local(pose);
        let (right, strength) = (&mut self.right, &self.strength);
        arap.wanted(&pose.turns, |i, sum| {
            let sum = sum + strength[i] * goals[i];
            (0..3).for_each(|c| right[c * n + i] = sum[c]);
        });
        self.factor.solve(&arap.pattern, right);
        for (i, place) in pose.places.iter_mut().enumerate() {
            *place = Vec3::new(right[i], right[n + i], right[2 * n + i]);
        }
    }

    /// The full energy, mm².
    pub fn energy(&self, pose: &Pose, goals: &[Vec3]) -> f64 {
        let held = pose.places.iter().zip(goals).zip(&self.strength);
        let held = held
            .filter(|(_, c)| **c > 0.0)
            .map(|((p, q), c)| c * p.distance_squared(*q));
        self.arap.energy(pose) + held.sum::<f64>()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A tube of rings, closed around, open at both ends.
    fn tube(rings: usize, around: usize) -> (Vec<Vec3>, Vec<[usize; 3]>) {
        let mut rest = vec![];
        for r in 0..rings {
            for k in 0..around {
                let angle = std::f64::consts::TAU * k as f64 / around as f64;
                rest.push(Vec3::new(
                    8.0 * angle.cos(),
                    8.0 * angle.sin(),
                    5.0 * r as f64,
                ));
            }
        }
        let mut triangles = vec![];
        for r in 0..rings - 1 {
            for k in 0..around {
                let (a, b) = (r * around + k, r * around + (k + 1) % around);
                triangles.push([a, b, a + around]);
                triangles.push([b, b + around, a + around]);
            }
        }
        (rest, triangles)
    }

    fn rigid(p: Vec3) -> Vec3 {
        let (s, c) = 0.8f64.sin_cos();
        let turned = Vec3::new(p[0], c * p[1] - s * p[2], s * p[1] + c * p[2]);
        turned + Vec3::new(3.0, -7.0, 1.0)
    }

    #[test]
    fn a_rigid_motion_is_recovered_from_handles() {
        let (rest, triangles) = tube(12, 10);
        let arap = Arap::new(rest.clone(), &triangles).unwrap();
        let goals: Vec<Vec3> = rest.iter().map(|p| rigid(*p)).collect();
        let strength = (0..rest.len()).map(|i| if i % 5 == 0 { 1e3 } else { 0.0 });
        let mut held = arap.held(strength.collect()).unwrap();
        let mut pose = arap.pose();
        (0..600).for_each(|_| held.step(&mut pose, &goals));
        let mut pairs = pose.places.iter().zip(&goals);
        assert!(pairs.all(|(p, q)| p.abs_diff_eq(*q, 1e-9)));
        assert!(arap.energy(&pose) < 1e-16);
    }

    #[test]
    fn no_step_raises_the_energy_and_strong_hands_have_their_way() {
        let (rest, triangles) = tube(12, 10);
        let arap = Arap::new(rest.clone(), &triangles).unwrap();
        let bent = |p: &Vec3| Vec3::new(p[0] + 0.004 * p[2] * p[2], p[1], p[2] * 0.9);
        let goals: Vec<Vec3> = rest.iter().map(bent).collect();
        for strength in [1e-6, 0.1, 1e7] {
            let mut held = arap.held(vec![strength; rest.len()]).unwrap();
            let mut pose = arap.pose();
            let mut before = held.energy(&pose, &goals);
            for _ in 0..60 {
                held.step(&mut pose, &goals);
                let after = held.energy(&pose, &goals);
                assert!(after <= before + 1e-9 * before.abs(), "{before} to {after}");
                before = after;
            }
            let far = pose.places.iter().zip(&goals).map(|(p, q)| p - q);
            let far = far.fold(0.0, |m: f64, v| m.max(v.abs().max_element()));
            match strength {
                s if s > 1e6 => assert!(far < 1e-5),
                s if s < 1e-5 => assert!(arap.energy(&pose) < 1e-3),
                _ => assert!(far > 1e-3),
            }
        }
    }

    #[test]
    fn a_global_step_is_the_dense_solution_of_the_definition() {
        let (rest, triangles) = tube(5, 10);
        let n = rest.len();
        let arap = Arap::new(rest.clone(), &triangles).unwrap();
        let mut pose = arap.pose();
        for (i, p) in pose.places.iter_mut().enumerate() {
            p[0] += 0.3 * (i as f64).sin();
            p[2] += 0.2 * (1.7 * i as f64).cos();
        }
        let goals = pose.places.clone();
        let strength: Vec<f64> = (0..n).map(|i| 0.1 + 0.01 * i as f64).collect();
        let mut held = arap.held(strength.clone()).unwrap();
        held.step(&mut pose, &goals);
        // The gradient of the energy by the positions vanishes there, by finite differences.
        for i in (0..n).step_by(7) {
            for c in 0..3 {
                let at = |step: f64| {
                    let mut moved = pose.clone();
                    moved.places[i][c] += step;
                    held.energy(&moved, &goals)
                };
                let slope = (at(1e-4) - at(-1e-4)) / 2e-4;
                assert!(slope.abs() < 1e-6, "vertex {i}: {slope}");
            }
        }
    }

    #[test]
    fn what_nothing_holds_is_refused() {
        let (rest, triangles) = tube(4, 8);
        let arap = Arap::new(rest.clone(), &triangles).unwrap();
        assert!(arap.held(vec![0.0; rest.len()]).is_err());
        assert!(arap.held(vec![1.0; 3]).is_err());
        let lonely = [rest, vec![Vec3::ZERO]].concat();
        assert!(Arap::new(lonely, &triangles).is_err());
    }
}
