//! Any shape seen through a linear map: out = Wᵀ shape(u) + offset, W (M, M2).
//!
//! Tables and networks have a `project` of their own, which folds the map into their numbers. This
//! is for every other family, such as the rods: inverse kinematics evaluates only the tip.

use crate::error::{Result, invalid};
use crate::shape::{Shape, Work};
use std::sync::Arc;

/// A shape and its linear map.
pub struct Projected {
    shape: Arc<dyn Shape>,
    weights: Arc<Vec<f64>>,
    offset: Arc<Vec<f64>>,
}

impl Projected {
    /// Map `shape` (M outputs) by `weights` (M, M2), row by row, plus `offset` (M2,).
    pub fn new(shape: Arc<dyn Shape>, weights: Vec<f64>, offset: Vec<f64>) -> Result<Projected> {
        if weights.len() != shape.size() * offset.len() {
            return Err(invalid(format!(
                "weights of {} numbers do not map {} outputs to {}",
                weights.len(),
                shape.size(),
                offset.len()
            )));
        }
        Ok(Projected {
            shape,
            weights: Arc::new(weights),
            offset: Arc::new(offset),
        })
    }

    /// Wᵀ of `rows` (M, width) added to `out` (M2, width).
    fn map(&self, rows: &[f64], width: usize, out: &mut [f64]) {
        let count = self.offset.len();
        for (row, weights) in rows
            .chunks_exact(width)
            .zip(self.weights.chunks_exact(count.max(1)))
        {
            for (weight, out) in weights.iter().zip(out.chunks_exact_mut(width)) {
                if *weight != 0.0 {
                    row.iter()
                        .zip(out)
                        .for_each(|(value, sum)| *sum += weight * value);
                }
            }
        }
    }
}

impl Shape for Projected {
    fn channels(&self) -> usize {
        self.shape.channels()
    }

    fn size(&self) -> usize {
        self.offset.len()
    }

    fn numbers(&self) -> Vec<&'static str> {
        self.shape.numbers()
    }

    fn with_number(&self, name: &str, factor: f64) -> Option<Arc<dyn Shape>> {
        let shape = self.shape.with_number(name, factor)?;
        let (weights, offset) = (self.weights.clone(), self.offset.clone());
        Some(Arc::new(Projected {
            shape,
            weights,
            offset,
        }))
    }

    fn eval(&self, u: &[f64], out: &mut [f64]) {
        let mut all = vec![0.0; self.shape.size()];
        self.shape.eval(u, &mut all);
        out.copy_from_slice(&self.offset);
        self.map(&all, 1, out);
    }

    fn jacobian(&self, u: &[f64], out: &mut [f64]) {
        let channels = self.channels();
        let mut all = vec![0.0; self.shape.size() * channels];
        self.shape.jacobian(u, &mut all);
        out.fill(0.0);
        self.map(&all, channels.max(1), out);
    }

    fn with_slopes(&self, u: &[f64], values: &mut [f64], slopes: &mut [f64], work: &mut Work) {
        let (size, channels) = (self.shape.size(), self.channels());
        let (mut all, mut rise) = (vec![0.0; size], vec![0.0; size * channels]);
        self.shape.with_slopes(u, &mut all, &mut rise, work);
        values.copy_from_slice(&self.offset);
        self.map(&all, 1, values);
        slopes.fill(0.0);
        self.map(&rise, channels.max(1), slopes);
    }
}

#[cfg(test)]
mod tests {
    use super::Projected;
    use crate::shape::{Shape, Work};
    use std::sync::Arc;

    /// Three outputs of two commands, none of them linear.
    struct Curved;

    impl Shape for Curved {
        fn channels(&self) -> usize {
            2
        }
        fn size(&self) -> usize {
            3
        }
        fn eval(&self, u: &[f64], out: &mut [f64]) {
            out.copy_from_slice(&[u[0] * u[1], u[0].sin(), u[1] * u[1]]);
        }
    }

    #[test]
    fn values_and_slopes_are_those_of_the_map() {
        let weights = vec![1.0, 0.5, 0.0, -2.0, 3.0, 0.25]; // (3, 2)
        let seen = Projected::new(Arc::new(Curved), weights.clone(), vec![10.0, -1.0]).unwrap();
        let (u, mut all, mut out) = ([0.7, -1.3], [0.0; 3], [0.0; 2]);
        Curved.eval(&u, &mut all);
        seen.eval(&u, &mut out);
        let (mut slope, mut slopes) = ([0.0; 6], [0.0; 4]);
        Curved.jacobian(&u, &mut slope);
        seen.jacobian(&u, &mut slopes);
        let (mut values, mut both) = ([0.0; 2], [0.0; 4]);
        seen.with_slopes(&u, &mut values, &mut both, &mut Work::default());
        for k in 0..2 {
            let wanted: f64 = (0..3).map(|m| weights[2 * m + k] * all[m]).sum();
            assert!((out[k] - [10.0, -1.0][k] - wanted).abs() < 1e-12 && values[k] == out[k]);
            for c in 0..2 {
                let wanted: f64 = (0..3).map(|m| weights[2 * m + k] * slope[2 * m + c]).sum();
                assert!((slopes[2 * k + c] - wanted).abs() < 1e-9);
                assert!((both[2 * k + c] - wanted).abs() < 1e-9);
            }
        }
        assert!(Projected::new(Arc::new(Curved), vec![1.0; 5], vec![0.0; 2]).is_err());
    }
}
