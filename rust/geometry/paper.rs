//! Registration as published (SOFTMAP, eq. 1), for comparison:
//!
//!   min Σ_(i,j) w_ij |(v_i − v_j) − R_i (v_i⁰ − v_j⁰)|² + λ Σ_i |v_i − Π(v_i)|²
//!
//! with Π(v) the point of the cloud nearest to v. Every vertex is pulled to its nearest point, also
//! hidden ones: a cloud of one side pulls the other through the body, even from the exact truth. λ,
//! the rounds and the cotangent weights are not in the paper. mm.
//!
//! Difference: with given handle vertices, the second sum runs over these alone, and the first
//! moves the others along. The paper sums over all vertices and extracts its handles afterwards;
//! with all vertices as handles, both are equal.

use super::arap::Arap;
use super::nearest::both_ways;
use crate::algebra::Vec3;
use crate::error::Result;

/// Converged if no vertex moves by more in a round, mm.
const SETTLED: f64 = 1e-3;

/// Fit a surface to a `cloud` from rest, with λ (N,) for each vertex, 0 for vertices that are not
/// handles, in at most `rounds`; return the vertices (N, 3) and the number of rounds.
pub fn register_as_published(
    arap: &Arap,
    cloud: &[Vec3],
    strength: Vec<f64>,
    rounds: usize,
) -> Result<(Vec<Vec3>, usize)> {
    let mut held = arap.held(strength)?;
    let mut pose = arap.pose();
    for round in 1..=rounds {
        let (nearest, _) = both_ways(&pose.places, cloud)?;
        let goals: Vec<Vec3> = nearest.index.iter().map(|j| cloud[*j as usize]).collect();
        let before = pose.places.clone();
        held.step(&mut pose, &goals);
        let moved = pose.places.iter().zip(&before).map(|(p, q)| p.distance(*q));
        if moved.fold(0.0, f64::max) < SETTLED {
            return Ok((pose.places, round));
        }
    }
    Ok((pose.places, rounds))
}
