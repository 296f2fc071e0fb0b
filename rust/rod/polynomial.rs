//! Polynomials of several variables: the monomials in graded order, their values and slopes, and weighted sums of them.

use super::finite;
use crate::error::{Result, invalid};
use crate::modes::accumulate;
use crate::room::with_few;

/// Largest number of monomials that a rod accepts: 9 channels to the cubic are 219.
const MOST_MONOMIALS: usize = 5000;

/// Highest degree: an S-shaped answer of one command needs the fifth.
const MOST_DEGREE: usize = 5;

/// Outputs that are summed at a time.
const BLOCK: usize = 8;

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
        if variables == 0 || degree == 0 || degree > MOST_DEGREE {
            return Err(invalid(format!(
                "a polynomial needs at least one variable and a degree of 1 to {MOST_DEGREE}, got {variables} variables and degree {degree}"
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
    /// The weights (1 + F) of each block of outputs, zeros behind the last.
    blocks: Vec<Vec<[f64; BLOCK]>>,
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
        let block = |first: usize| {
            let row = |row: &[f64]| std::array::from_fn(|o| *row.get(first + o).unwrap_or(&0.0));
            weights.chunks_exact(outputs.max(1)).map(row).collect()
        };
        Ok(Self {
            monomials,
            blocks: (0..outputs).step_by(BLOCK).map(block).collect(),
            outputs,
        })
    }

    /// Values at `x`.
    pub(super) fn eval(&self, x: &[f64], out: &mut [f64]) {
        with_few(self.monomials.len(), |phi| self.sum(x, phi, out));
    }

    /// Write the monomials to `phi`, and the values to `out`, as many at a time as stay in registers.
    #[inline(always)]
    fn sum(&self, x: &[f64], phi: &mut [f64], out: &mut [f64]) {
        self.monomials.values(x, phi);
        for (out, rows) in out.chunks_mut(BLOCK).zip(&self.blocks) {
            let mut sum = rows[0];
            for (value, row) in phi.iter().zip(&rows[1..]) {
                accumulate(&mut sum, row, *value);
            }
            out.copy_from_slice(&sum[..out.len()]);
        }
    }

    /// Numbers that `slopes` works in.
    pub(super) fn work(&self) -> usize {
        self.monomials.len() * (1 + self.monomials.variables)
    }

    /// Values at `x` as `eval`, and d out / d x as `slopes[o * variables + j]`; `work` is overwritten.
    pub(super) fn slopes(&self, x: &[f64], out: &mut [f64], slopes: &mut [f64], work: &mut [f64]) {
        let n = x.len();
        let (phi, rise) = work[..self.work()].split_at_mut(self.monomials.len());
        self.sum(x, phi, out);
        self.monomials.slopes(x, phi, rise);
        slopes.fill(0.0);
        for (slopes, rows) in slopes.chunks_mut(BLOCK * n).zip(&self.blocks) {
            for (rise, row) in rise.chunks_exact(n).zip(&rows[1..]) {
                for (slope, w) in slopes.chunks_exact_mut(n).zip(row) {
                    accumulate(slope, rise, *w);
                }
            }
        }
    }
}
