//! Polynomials of several variables: the monomials in graded order, their values and slopes, and weighted sums of them.

use super::finite;
use crate::error::{Result, invalid};

/// Largest number of monomials that a rod accepts: 9 channels to the cubic are 219.
const MOST_MONOMIALS: usize = 5000;

/// Every monomial of degree 1..=degree in `variables` numbers, in graded lexicographic order, without the constant.
#[derive(Debug, Clone)]
pub struct Monomials {
    variables: usize,
    /// Each monomial is an earlier one (or 1) times a variable: (parent, variable).
    steps: Vec<(Option<usize>, usize)>,
}

impl Monomials {
    /// List the monomials; refuses degree 0, no variables and more than 5000 terms.
    pub fn new(variables: usize, degree: usize) -> Result<Self> {
        if variables == 0 || degree == 0 || degree > 4 {
            return Err(invalid(format!(
                "a polynomial needs at least one variable and a degree of 1 to 4, got {variables} variables and degree {degree}"
            )));
        }
        let too_many = || {
            invalid(format!(
                "a polynomial of degree {degree} in {variables} variables has more than {MOST_MONOMIALS} terms; choose a lower degree"
            ))
        };
        if variables > MOST_MONOMIALS {
            return Err(too_many());
        }
        let mut steps: Vec<(Option<usize>, usize)> = (0..variables).map(|j| (None, j)).collect();
        let mut previous = 0..steps.len();
        for _ in 1..degree {
            let start = steps.len();
            for parent in previous {
                for j in steps[parent].1..variables {
                    steps.push((Some(parent), j));
                }
                if steps.len() > MOST_MONOMIALS {
                    return Err(too_many());
                }
            }
            previous = start..steps.len();
        }
        Ok(Self { variables, steps })
    }

    /// Number of monomials.
    pub fn len(&self) -> usize {
        self.steps.len()
    }

    /// Never true: there is at least one variable.
    pub fn is_empty(&self) -> bool {
        self.steps.is_empty()
    }

    /// The degree of each monomial.
    pub fn degrees(&self) -> Vec<usize> {
        let mut degrees: Vec<usize> = Vec::with_capacity(self.len());
        for &(parent, _) in &self.steps {
            degrees.push(1 + parent.map_or(0, |p| degrees[p]));
        }
        degrees
    }

    /// Values of all monomials at `x` (variables,).
    pub fn values(&self, x: &[f64], out: &mut [f64]) {
        for (f, &(parent, j)) in self.steps.iter().enumerate() {
            out[f] = parent.map_or(1.0, |p| out[p]) * x[j];
        }
    }

    /// Slopes of all monomials at `x`: `out[f * variables + j]`, given their `values`.
    fn slopes(&self, x: &[f64], values: &[f64], out: &mut [f64]) {
        let n = self.variables;
        for (f, &(parent, j)) in self.steps.iter().enumerate() {
            for k in 0..n {
                out[f * n + k] = parent.map_or(0.0, |p| out[p * n + k]) * x[j];
            }
            out[f * n + j] += parent.map_or(1.0, |p| values[p]);
        }
    }
}

/// A polynomial map with an intercept: weights (1 + F, outputs), row 0 the intercept.
#[derive(Debug, Clone)]
pub(super) struct Polynomial {
    monomials: Monomials,
    weights: Vec<f64>,
    pub(super) outputs: usize,
}

impl Polynomial {
    pub(super) fn new(
        monomials: Monomials,
        weights: Vec<f64>,
        outputs: usize,
        what: &str,
    ) -> Result<Self> {
        let rows = monomials.len() + 1;
        if weights.len() != rows * outputs {
            return Err(invalid(format!(
                "{what} has {} weights, expected {rows} rows (intercept and {} monomials) of {outputs}",
                weights.len(),
                rows - 1
            )));
        }
        finite(&weights, what)?;
        Ok(Self {
            monomials,
            weights,
            outputs,
        })
    }

    /// Values at `x`; with `slopes` also d out / d x as `slopes[o * variables + j]`.
    pub(super) fn eval(&self, x: &[f64], out: &mut [f64], slopes: Option<&mut [f64]>) {
        let m = self.outputs;
        let mut phi = vec![0.0; self.monomials.len()];
        self.monomials.values(x, &mut phi);
        out.copy_from_slice(&self.weights[..m]);
        for (value, row) in phi.iter().zip(self.weights[m..].chunks_exact(m)) {
            for (o, w) in out.iter_mut().zip(row) {
                *o += value * w;
            }
        }
        if let Some(slopes) = slopes {
            let n = x.len();
            let mut rise = vec![0.0; phi.len() * n];
            self.monomials.slopes(x, &phi, &mut rise);
            slopes.fill(0.0);
            for (rise, row) in rise.chunks_exact(n).zip(self.weights[m..].chunks_exact(m)) {
                for (o, w) in row.iter().enumerate() {
                    for j in 0..n {
                        slopes[o * n + j] += w * rise[j];
                    }
                }
            }
        }
    }
}
