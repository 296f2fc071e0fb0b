//! The Chamfer distance between a template and a cloud: the mean distance of the points of one to
//! the other.
//!
//! `there + back`, there = Σ_i w_i d(a_i, B) / Σ w_i, back = Σ_j v_j d(b_j, A) / Σ v_j: the
//! unsquared sum of both mean distances (mm). w excludes template points hidden from all cameras,
//! which have no partner; without one of the sums, the distance is one-sided. Its gradient by the
//! template's points is at constant pairs: if the nearest neighbour changes, the distance has a
//! kink, and if a pair touches, its share of the gradient is zero.

use super::nearest::{Nearest, both_ways};
use crate::algebra::Vec3;
use crate::error::{Result, invalid};

/// The result.
#[derive(Debug, Clone)]
pub struct Chamfer {
    pub there: f64,
    pub back: f64,
    /// From each template point to the cloud, and from each cloud point to the template.
    pub to_cloud: Nearest,
    pub to_template: Nearest,
}

impl Chamfer {
    /// Compare `template` (N, 3) and `cloud` (M, 3); empty weights count all alike.
    pub fn new(
        template: &[Vec3],
        cloud: &[Vec3],
        seen: &[f64],
        trusted: &[f64],
    ) -> Result<Chamfer> {
        let (to_cloud, to_template) = both_ways(template, cloud)?;
        Ok(Chamfer {
            there: mean("template", &to_cloud.distance, seen)?,
            back: mean("cloud", &to_template.distance, trusted)?,
            to_cloud,
            to_template,
        })
    }

    /// Slopes (N, 3) of `there·first + back·second` by the template's points.
    pub fn gradient(
        &self,
        template: &[Vec3],
        cloud: &[Vec3],
        seen: &[f64],
        trusted: &[f64],
        (first, second): (f64, f64),
    ) -> Vec<Vec3> {
        let mut out = vec![Vec3::ZERO; template.len()];
        let mut pull = |i: usize, j: usize, distance: f64, share: f64| {
            if distance > 0.0 {
                out[i] += share / distance * (template[i] - cloud[j]);
            }
        };
        let shares = |weights: &[f64], count: usize, times: f64| match weights {
            [] => vec![times / count as f64; count],
            some => {
                let sum: f64 = some.iter().sum();
                some.iter().map(|w| times * w / sum).collect()
            }
        };
        let (first, second) = (
            shares(seen, template.len(), first),
            shares(trusted, cloud.len(), second),
        );
        for (i, (j, distance)) in self.to_cloud.pairs().enumerate() {
            pull(i, j, distance, first[i]);
        }
        for (j, (i, distance)) in self.to_template.pairs().enumerate() {
            pull(i, j, distance, second[j]);
        }
        out
    }
}

fn mean(what: &str, distance: &[f64], weights: &[f64]) -> Result<f64> {
    if weights.is_empty() {
        return Ok(distance.iter().sum::<f64>() / distance.len() as f64);
    }
    let sum: f64 = weights.iter().sum();
    if weights.len() != distance.len()
        || sum.is_nan()
        || sum <= 0.0
        || weights.iter().any(|w| w.is_nan() || *w < 0.0)
    {
        return Err(invalid(format!(
            "weights of the {what}: {} numbers with sum {sum:.3e} for {} points; give each point \
            one of 0 or more, some above 0",
            weights.len(),
            distance.len()
        )));
    }
    Ok(distance
        .iter()
        .zip(weights)
        .map(|(d, w)| d * w)
        .sum::<f64>()
        / sum)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Random points within 80 mm, no two of them at nearly the same distance from a third.
    fn set(count: usize, seed: u64) -> Vec<Vec3> {
        let mut state = seed;
        let mut next = || {
            state = state
                .wrapping_mul(6364136223846793005)
                .wrapping_add(1442695040888963407);
            80.0 * (state >> 11) as f64 / (1u64 << 53) as f64
        };
        (0..count)
            .map(|_| Vec3::new(next(), next(), next()))
            .collect()
    }

    #[test]
    fn two_points_apart_count_from_both_sides_unsquared() {
        let found = Chamfer::new(&[Vec3::ZERO], &[Vec3::new(3.0, 4.0, 0.0)], &[], &[]).unwrap();
        assert_eq!((found.there, found.back), (5.0, 5.0));
    }

    #[test]
    fn the_gradient_is_that_of_finite_differences_with_weights_and_without() {
        let (template, cloud) = (set(17, 1), set(90, 2));
        let weights: Vec<f64> = (0..17).map(|i| (i % 3) as f64).collect();
        for seen in [&[][..], &weights] {
            let of = |points: &[Vec3]| {
                let found = Chamfer::new(points, &cloud, seen, &[]).unwrap();
                2.0 * found.there + 0.5 * found.back
            };
            let found = Chamfer::new(&template, &cloud, seen, &[]).unwrap();
            let slopes = found.gradient(&template, &cloud, seen, &[], (2.0, 0.5));
            for i in 0..template.len() {
                for c in 0..3 {
                    let moved = |by: f64| {
                        let mut points = template.clone();
                        points[i][c] += by;
                        of(&points)
                    };
                    let slope = (moved(1e-5) - moved(-1e-5)) / 2e-5;
                    assert!((slope - slopes[i][c]).abs() < 1e-6, "{i} {c}: {slope}");
                }
            }
        }
    }

    #[test]
    fn weights_that_count_nothing_are_refused() {
        let points = set(3, 1);
        for weights in [
            vec![0.0; 3],
            vec![1.0; 2],
            vec![1.0, -1.0, 1.0],
            vec![f64::NAN; 3],
        ] {
            assert!(Chamfer::new(&points, &points, &weights, &[]).is_err());
        }
    }
}
