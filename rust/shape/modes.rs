//! A few modes over many numbers, `mean + Σ_m a_m·mode_m`, shared by tables and scattered families.
//!
//! The family computes the weights a_m from a command (`table.rs`, `scattered.rs`); here they are
//! expanded to the M numbers, and linear maps (vertices → features) are applied.

use crate::error::{Result, invalid};
use crate::memory::with_few;
use std::sync::Arc;

/// Modes up to this number are blended on the stack.
pub const STACK_MODES: usize = 64;
/// Numbers summed at a time.
const BLOCK: usize = 16;

/// A mean (M,) and modes (m, M), row-major.
#[derive(Debug, Clone, PartialEq)]
pub struct Modes {
    mean: Arc<[f64]>,
    rows: Arc<[f64]>,
    count: usize,
    /// Whether mode m is the number m itself, so no expansion is needed.
    plain: bool,
}

impl Modes {
    /// Take `mean` (M,) and `rows` (m, M).
    pub fn new(mean: Vec<f64>, rows: Vec<f64>) -> Result<Modes> {
        let size = mean.len();
        if size == 0 || !rows.len().is_multiple_of(size) {
            return Err(invalid(format!(
                "modes must be (m, M) with M = {size} as in mean, got {} numbers",
                rows.len()
            )));
        }
        let count = rows.len() / size;
        let unit = |i: usize| f64::from(i / size == i % size);
        let plain = count == size && rows.iter().enumerate().all(|(i, v)| *v == unit(i));
        Ok(Modes {
            mean: mean.into(),
            rows: rows.into(),
            count,
            plain,
        })
    }

    /// Without a mean, and mode m is the number m itself.
    pub fn plain(size: usize) -> Result<Modes> {
        let unit = |i: usize| f64::from(i / size == i % size);
        Modes::new(vec![0.0; size], (0..size * size).map(unit).collect())
    }

    /// Whether mode m is the number m itself.
    pub fn is_plain(&self) -> bool {
        self.plain
    }

    /// Whether the weights are the numbers: plain, without a mean.
    pub fn is_bare(&self) -> bool {
        self.plain && self.mean.iter().all(|m| *m == 0.0)
    }

    /// Whether another set has the same numbers.
    pub fn are(&self, other: &Modes) -> bool {
        Arc::ptr_eq(&self.rows, &other.rows) && Arc::ptr_eq(&self.mean, &other.mean)
            || self.plain == other.plain
                && self.mean == other.mean
                && (self.plain || self.rows == other.rows)
    }

    /// The mean (M,).
    pub fn mean(&self) -> &[f64] {
        &self.mean
    }

    /// The modes (m, M).
    pub fn rows(&self) -> &[f64] {
        &self.rows
    }

    /// Number of modes m.
    pub fn count(&self) -> usize {
        self.count
    }

    /// Number of outputs M.
    pub fn size(&self) -> usize {
        self.mean.len()
    }

    /// The same modes seen through a linear map: `numbers·weights + offset`, `weights` (M, M2),
    /// `offset` (M2,).
    pub fn project(&self, weights: &[f64], offset: &[f64]) -> Result<Modes> {
        let (size, to) = (self.size(), offset.len());
        if to == 0 || weights.len() != size * to {
            return Err(invalid(format!(
                "a projection of this shape needs weights ({size}, {to}) and offset ({to},), got \
                {} numbers",
                weights.len()
            )));
        }
        // A feature depends on few vertices, and a vertex on few features.
        let weighed: Vec<Vec<(usize, f64)>> = weights
            .chunks_exact(to)
            .map(|row| {
                row.iter()
                    .copied()
                    .enumerate()
                    .filter(|(_, w)| *w != 0.0)
                    .collect()
            })
            .collect();
        let through = |row: &[f64]| {
            let mut image = vec![0.0; to];
            for (value, weighed) in row.iter().zip(&weighed) {
                weighed
                    .iter()
                    .for_each(|(j, weight)| image[*j] += value * weight);
            }
            image
        };
        let mean = through(&self.mean)
            .iter()
            .zip(offset)
            .map(|(a, b)| a + b)
            .collect();
        Modes::new(
            mean,
            self.rows.chunks_exact(size).flat_map(through).collect(),
        )
    }

    /// Add `Σ weight_m·mode_m` to `out` (M,), as many numbers at a time as stay in registers.
    #[inline(always)]
    pub fn expand(&self, weights: &[f64], out: &mut [f64]) {
        let size = out.len();
        let whole = size - size % BLOCK;
        for first in (0..whole).step_by(BLOCK) {
            let mut sum = [0.0; BLOCK];
            sum.copy_from_slice(&out[first..first + BLOCK]);
            for (m, weight) in weights.iter().enumerate() {
                let start = m * size + first;
                accumulate(&mut sum, &self.rows[start..start + BLOCK], *weight);
            }
            out[first..first + BLOCK].copy_from_slice(&sum);
        }
        for (m, weight) in weights.iter().enumerate() {
            let row = m * size + whole..(m + 1) * size;
            accumulate(&mut out[whole..], &self.rows[row], *weight);
        }
    }

    /// Write the numbers to `out` (M,); `weigh` adds the m weights.
    #[inline(always)]
    pub fn eval(&self, out: &mut [f64], weigh: impl FnOnce(&mut [f64])) {
        out.copy_from_slice(&self.mean);
        self.add(out, weigh);
    }

    /// Write the slopes (M, `channels`) to `out`; `weigh` adds those of the m weights by each
    /// channel.
    pub fn jacobian(&self, channels: usize, out: &mut [f64], weigh: impl Fn(usize, &mut [f64])) {
        with_few(self.size(), |column| {
            for c in 0..channels {
                column.fill(0.0);
                self.add(column, |weights| weigh(c, weights));
                for (row, slope) in out.chunks_exact_mut(channels).zip(column.iter()) {
                    row[c] = *slope;
                }
            }
        });
    }

    /// A few weights are on the stack.
    #[inline(always)]
    fn add(&self, out: &mut [f64], weigh: impl FnOnce(&mut [f64])) {
        if self.plain {
            return weigh(out);
        }
        let (mut few, mut many);
        let weights = if self.count <= STACK_MODES {
            few = [0.0; STACK_MODES];
            &mut few[..self.count]
        } else {
            many = vec![0.0; self.count];
            &mut many[..]
        };
        weigh(weights);
        self.expand(weights, out);
    }
}

/// Use the widest vectors of this processor; each number is the same as without. Closures on the
/// way must be `#[inline(always)]`, else they are compiled for narrow ones.
#[inline(always)]
pub(crate) fn wide<R>(work: impl FnOnce() -> R) -> R {
    pulp::Arch::new().dispatch(work)
}

/// `sum += factor·row`; a plain loop, so `wide` can vectorise it.
#[inline(always)]
pub(crate) fn accumulate(sum: &mut [f64], row: &[f64], factor: f64) {
    let count = sum.len().min(row.len());
    let (sum, row) = (&mut sum[..count], &row[..count]);
    for i in 0..count {
        sum[i] += factor * row[i];
    }
}
