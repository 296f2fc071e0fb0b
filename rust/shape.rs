//! What every family of shapes promises: commands in, numbers out, slopes on request.
//!
//! A shape maps C command numbers (mm) to M output numbers (mm, or per-unit displacements for a field). The table, the
//! rod and whatever comes later implement this trait; what consumes a shape need not know which one it is (`fields.rs`
//! asks for tables, to sum them faster).

use crate::table::Table;
use std::sync::Arc;

/// A map from commands to shape numbers.
pub trait Shape: Send + Sync {
    /// Number of command channels C.
    fn channels(&self) -> usize;

    /// Number of outputs M.
    fn size(&self) -> usize;

    /// The M outputs at the command `u` (C,), written to `out` (M,).
    fn eval(&self, u: &[f64], out: &mut [f64]);

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

    /// The slopes d out[m] / d u[c] at `u`, written to `out[m * C + c]`, shape (M, C).
    ///
    /// By default central differences with a step of 1e-5 mm per mm of command: round-off about 1e-10 of the value.
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

#[cfg(test)]
mod tests {
    use super::Shape;

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
}
