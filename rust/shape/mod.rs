//! The interface of every family of shapes: commands in, numbers out, slopes on request.
//!
//! A shape maps C command numbers (mm) to M output numbers (mm, or per-unit displacements for a
//! field). The table, the rod and all other families implement this trait, so users of a shape do
//! not depend on its family (`fields.rs` asks for tables, to sum them faster).

pub(crate) mod cubic;
pub(crate) mod grid;
pub mod modes;
pub mod projected;
pub mod scattered;
pub mod table;

use crate::error::{Result, invalid};
use crate::shape::modes::accumulate;
use crate::shape::table::Table;
use std::sync::Arc;

/// Reusable workspace of a shape: a loop allocates only at its first tick.
#[derive(Debug, Default)]
pub struct Work {
    pub doubles: Vec<f64>,
    /// The terms of a sum.
    more: Vec<f64>,
}

/// A map from commands to shape numbers.
pub trait Shape: Send + Sync {
    /// Number of command channels C.
    fn channels(&self) -> usize;

    /// Number of outputs M.
    fn size(&self) -> usize;

    /// The M outputs at the command `u` (C,), written to `out` (M,).
    fn eval(&self, u: &[f64], out: &mut [f64]);

    /// The outputs (n, M) at `rows` (n, C) of commands; some shapes take several at a time.
    fn eval_rows(&self, rows: &[f64], out: &mut [f64]) {
        let (channels, size) = (self.channels(), self.size().max(1));
        for (i, out) in out.chunks_exact_mut(size).enumerate() {
            self.eval(&rows[i * channels..(i + 1) * channels], out);
        }
    }

    /// The table that this shape is, if it is one.
    fn table(&self) -> Option<&Table> {
        None
    }

    /// Names of the shape's own numbers that an effect may change.
    fn numbers(&self) -> Vec<&'static str> {
        vec![]
    }

    /// The same shape with one of `numbers` multiplied by a factor; none if it has no such number.
    fn with_number(&self, _name: &str, _factor: f64) -> Option<Arc<dyn Shape>> {
        None
    }

    /// Both at once: the outputs (M,) and the slopes (M, C). Families used in a control loop do not
    /// allocate here once `work` has grown; elastic rods do.
    fn with_slopes(&self, u: &[f64], values: &mut [f64], slopes: &mut [f64], _work: &mut Work) {
        self.eval(u, values);
        self.jacobian(u, slopes);
    }

    /// The slopes d out[m] / d u[c] at `u`, written to `out[m * C + c]`, shape (M, C).
    ///
    /// By default central differences with a step of 1e-5 mm per mm of command: round-off about
    /// 1e-10 of the value.
    fn jacobian(&self, u: &[f64], out: &mut [f64]) {
        let (channels, size) = (self.channels(), self.size());
        let mut at = u.to_vec();
        let (mut plus, mut minus) = (vec![0.0; size], vec![0.0; size]);
        for c in 0..channels {
            let step = 1e-5 * u[c].abs().max(1.0);
            at[c] = u[c] + step;
            self.eval(&at, &mut plus);
            at[c] = u[c] - step;
            self.eval(&at, &mut minus);
            at[c] = u[c];
            for m in 0..size {
                out[m * channels + c] = (plus[m] - minus[m]) / (2.0 * step);
            }
        }
    }
}

/// A prior and its learned residual: out = prior(u) + residual(u).
pub struct Sum {
    prior: Arc<dyn Shape>,
    residual: Arc<dyn Shape>,
}

impl Sum {
    /// Add two shapes of the same commands and outputs.
    pub fn new(prior: Arc<dyn Shape>, residual: Arc<dyn Shape>) -> Result<Sum> {
        if prior.channels() != residual.channels() || prior.size() != residual.size() {
            return Err(invalid(format!(
                "the residual maps {} commands to {} numbers, the prior {} to {}; they must agree",
                residual.channels(),
                residual.size(),
                prior.channels(),
                prior.size()
            )));
        }
        Ok(Sum { prior, residual })
    }
}

impl Shape for Sum {
    fn channels(&self) -> usize {
        self.prior.channels()
    }

    fn size(&self) -> usize {
        self.prior.size()
    }

    fn numbers(&self) -> Vec<&'static str> {
        self.prior.numbers()
    }

    fn with_number(&self, name: &str, factor: f64) -> Option<Arc<dyn Shape>> {
        let prior = self.prior.with_number(name, factor)?;
        let residual = self.residual.clone();
        Some(Arc::new(Sum { prior, residual }))
    }

    fn eval(&self, u: &[f64], out: &mut [f64]) {
        let mut more = vec![0.0; out.len()];
        self.prior.eval(u, out);
        self.residual.eval(u, &mut more);
        out.iter_mut()
            .zip(more)
            .for_each(|(sum, value)| *sum += value);
    }

    fn jacobian(&self, u: &[f64], out: &mut [f64]) {
        let mut more = vec![0.0; out.len()];
        self.prior.jacobian(u, out);
        self.residual.jacobian(u, &mut more);
        out.iter_mut()
            .zip(more)
            .for_each(|(sum, value)| *sum += value);
    }

    fn with_slopes(&self, u: &[f64], values: &mut [f64], slopes: &mut [f64], work: &mut Work) {
        self.prior.with_slopes(u, values, slopes, work);
        let mut more = std::mem::take(&mut work.more);
        more.resize(values.len() + slopes.len(), 0.0);
        let (value, slope) = more.split_at_mut(values.len());
        self.residual.with_slopes(u, value, slope, work);
        accumulate(values, value, 1.0);
        accumulate(slopes, slope, 1.0);
        work.more = more;
    }
}

#[cfg(test)]
mod tests {
    use super::{Shape, Sum};
    use crate::shape::table::Table;
    use std::sync::Arc;

    struct Parabola;

    impl Shape for Parabola {
        fn channels(&self) -> usize {
            2
        }
        fn size(&self) -> usize {
            1
        }
        fn eval(&self, u: &[f64], out: &mut [f64]) {
            out[0] = u[0] * u[0] * u[1] - 3.0 * u[1];
        }
    }

    #[test]
    fn default_slopes_match_the_derivative() {
        let mut slopes = [0.0; 2];
        Parabola.jacobian(&[7.0, -2.0], &mut slopes);
        // Central differences of a quadratic: round-off of the values (1e2) over the step (1e-4).
        assert!((slopes[0] + 28.0).abs() < 1e-8 && (slopes[1] - 46.0).abs() < 1e-8);
    }
    #[test]
    fn a_sum_adds_values_and_slopes_and_refuses_another_shape() {
        let sum = Sum::new(Arc::new(Parabola), Arc::new(Parabola)).unwrap();
        let (mut one, mut two, mut slope, mut slopes) = ([0.0], [0.0], [0.0; 2], [0.0; 2]);
        let u = [3.0, -2.0];
        Parabola.eval(&u, &mut one);
        sum.eval(&u, &mut two);
        Parabola.jacobian(&u, &mut slope);
        sum.jacobian(&u, &mut slopes);
        assert!(two[0] == 2.0 * one[0] && slopes == [2.0 * slope[0], 2.0 * slope[1]]);
        let table = Table::new(
            vec![vec![-1.0, 0.0, 1.0]],
            vec![0.0; 3],
            vec![0.0],
            vec![1.0],
        )
        .unwrap();
        assert!(Sum::new(Arc::new(Parabola), Arc::new(table)).is_err());
    }
}
