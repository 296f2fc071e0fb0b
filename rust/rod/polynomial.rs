//! Maps of several variables: weighted sums of monomials in graded order, or of tensor products of
//! B-splines, with slopes.

use super::finite;
use crate::error::{Result, invalid};
use crate::memory::with_few;
use crate::shape::modes::accumulate;

/// Largest number of monomials that a rod accepts: 9 channels to the cubic are 219.
const MOST_MONOMIALS: usize = 5000;

/// Highest degree: an S-shaped response to one command needs the fifth.
const MOST_DEGREE: usize = 5;

/// Outputs that are summed at a time.
const BLOCK: usize = 8;

/// Every monomial of degree 1..=degree in `variables` numbers, in graded lexicographic order,
/// without the constant.
#[derive(Debug, Clone)]
pub struct Monomials {
    variables: usize,
    /// Each monomial is an earlier one (or 1) times a variable: (parent, variable).
    steps: Vec<(Option<usize>, usize)>,
}

impl Monomials {
    /// List the monomials; rejects degree 0, no variables and more than 5000 terms.
    pub fn new(variables: usize, degree: usize) -> Result<Self> {
        if variables == 0 || degree == 0 || degree > MOST_DEGREE {
            return Err(invalid(format!(
                "a polynomial needs at least one variable and a degree of 1 to {MOST_DEGREE}, got \
                {variables} variables and degree {degree}"
            )));
        }
        let too_many = || {
            invalid(format!(
                "a polynomial of degree {degree} in {variables} variables has more than \
                {MOST_MONOMIALS} terms; choose a lower degree"
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

/// Tensor products of uniform cubic B-splines, `intervals` of them in −1 … 1 on each axis, the last
/// axis fastest. Beyond the ends of an axis they continue linearly. They sum to 1.
#[derive(Debug, Clone)]
pub struct Splines {
    variables: usize,
    intervals: usize,
}

/// Non-zero splines of an axis at a position.
const LOCAL: usize = 4;

/// Most variables of splines: 4 to the power of 7 exceeds 5000 terms.
const MOST_VARIABLES: usize = 6;

/// First non-zero spline of an axis at a position, and the values and slopes of it and the next
/// three.
type Place = (usize, [f64; LOCAL], [f64; LOCAL]);

impl Splines {
    /// Rejects no variables, no intervals and more than 5000 terms.
    pub fn new(variables: usize, intervals: usize) -> Result<Self> {
        let found = Self {
            variables,
            intervals,
        };
        let power = u32::try_from(variables).ok();
        let count = power.and_then(|power| found.each().checked_pow(power));
        if variables == 0 || intervals == 0 || count.is_none_or(|count| count > MOST_MONOMIALS) {
            return Err(invalid(format!(
                "splines of {variables} variables with {intervals} intervals each; give at least \
                 one of each and at most {MOST_MONOMIALS} terms, (intervals + 3) to the power of \
                 the variables"
            )));
        }
        Ok(found)
    }

    /// Number of splines of an axis.
    fn each(&self) -> usize {
        self.intervals.saturating_add(LOCAL - 1)
    }

    fn len(&self) -> usize {
        self.each().pow(self.variables as u32)
    }

    fn place(&self, x: f64) -> Place {
        let rate = 0.5 * self.intervals as f64;
        let inside = x.clamp(-1.0, 1.0);
        let first = ((rate * (inside + 1.0)) as usize).min(self.intervals - 1);
        let t = rate * (inside + 1.0) - first as f64;
        let (s, t2) = (1.0 - t, t * t);
        let mut values = [
            s * s * s / 6.0,
            (3.0 * t2 * t - 6.0 * t2 + 4.0) / 6.0,
            (3.0 * (t + t2 - t2 * t) + 1.0) / 6.0,
            t2 * t / 6.0,
        ];
        let slopes = [
            -0.5 * s * s,
            1.5 * t2 - 2.0 * t,
            0.5 + t - 1.5 * t2,
            0.5 * t2,
        ]
        .map(|slope| slope * rate);
        if x != inside {
            let beyond = values.iter_mut().zip(slopes);
            beyond.for_each(|(value, slope)| *value += slope * (x - inside));
        }
        (first, values, slopes)
    }

    /// Values of all splines at `x`, or with `along` the slopes over that variable, each `stride`
    /// numbers after the one before.
    fn fill(&self, x: &[f64], along: Option<usize>, out: &mut [f64], stride: usize) {
        out.iter_mut().step_by(stride).for_each(|out| *out = 0.0);
        let mut places = [(0, [0.0; LOCAL], [0.0; LOCAL]); MOST_VARIABLES];
        let places = &mut places[..x.len()];
        let each = places.iter_mut().zip(x);
        each.for_each(|(place, x)| *place = self.place(*x));
        for local in 0..LOCAL.pow(self.variables as u32) {
            let (mut at, mut value, mut rest) = (0, 1.0, local);
            for (j, (first, values, slopes)) in places.iter().enumerate() {
                let k = rest % LOCAL;
                rest /= LOCAL;
                at = at * self.each() + first + k;
                value *= if along == Some(j) {
                    slopes[k]
                } else {
                    values[k]
                };
            }
            out[at * stride] = value;
        }
    }
}

/// The terms of a map.
#[derive(Debug, Clone)]
pub enum Terms {
    Monomials(Monomials),
    Splines(Splines),
}

impl Terms {
    /// Number of terms F.
    pub fn count(&self) -> usize {
        match self {
            Terms::Monomials(terms) => terms.len(),
            Terms::Splines(terms) => terms.len(),
        }
    }

    fn variables(&self) -> usize {
        match self {
            Terms::Monomials(terms) => terms.variables,
            Terms::Splines(terms) => terms.variables,
        }
    }

    /// Values of all terms at `x` (variables,).
    pub fn values(&self, x: &[f64], out: &mut [f64]) {
        match self {
            Terms::Monomials(terms) => terms.values(x, out),
            Terms::Splines(terms) => terms.fill(x, None, out, 1),
        }
    }

    /// Slopes of all terms at `x`: `out[f * variables + j]`, given their `values`.
    fn slopes(&self, x: &[f64], values: &[f64], out: &mut [f64]) {
        match self {
            Terms::Monomials(terms) => terms.slopes(x, values, out),
            Terms::Splines(terms) => {
                for j in 0..terms.variables {
                    terms.fill(x, Some(j), &mut out[j..], terms.variables);
                }
            }
        }
    }
}

/// A map with an intercept: weights (1 + F, outputs), row 0 the intercept.
#[derive(Debug, Clone)]
pub(super) struct Polynomial {
    terms: Terms,
    /// The weights (1 + F) of each block of outputs, zeros behind the last.
    blocks: Vec<Vec<[f64; BLOCK]>>,
    pub(super) outputs: usize,
}

impl Polynomial {
    pub(super) fn new(terms: Terms, weights: Vec<f64>, outputs: usize, what: &str) -> Result<Self> {
        let rows = terms.count() + 1;
        if weights.len() != rows * outputs {
            return Err(invalid(format!(
                "{what} has {} weights, expected {rows} rows (intercept and {} terms) of {outputs}",
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
            terms,
            blocks: (0..outputs).step_by(BLOCK).map(block).collect(),
            outputs,
        })
    }

    /// Values at `x`.
    pub(super) fn eval(&self, x: &[f64], out: &mut [f64]) {
        with_few(self.terms.count(), |phi| self.sum(x, phi, out));
    }

    /// Write the terms to `phi`, and the values to `out`, as many at a time as fit in registers.
    #[inline(always)]
    fn sum(&self, x: &[f64], phi: &mut [f64], out: &mut [f64]) {
        self.terms.values(x, phi);
        for (out, rows) in out.chunks_mut(BLOCK).zip(&self.blocks) {
            let mut sum = rows[0];
            for (value, row) in phi.iter().zip(&rows[1..]) {
                if *value != 0.0 {
                    accumulate(&mut sum, row, *value);
                }
            }
            out.copy_from_slice(&sum[..out.len()]);
        }
    }

    /// Size of the workspace of `slopes`.
    pub(super) fn work(&self) -> usize {
        self.terms.count() * (1 + self.terms.variables())
    }

    /// Values at `x` as `eval`, and d out / d x as `slopes[o * variables + j]`; `work` is
    /// overwritten.
    pub(super) fn slopes(&self, x: &[f64], out: &mut [f64], slopes: &mut [f64], work: &mut [f64]) {
        let n = x.len();
        let (phi, rise) = work[..self.work()].split_at_mut(self.terms.count());
        self.sum(x, phi, out);
        self.terms.slopes(x, phi, rise);
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
