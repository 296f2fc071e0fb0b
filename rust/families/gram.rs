//! Gram matrices of whitened columns over a set of frames, without forming the whitened columns.
//!
//! A column is X_j = base_j ∘ w_j: a base (K, M) over K frames and M modes, times one weight per
//! frame (K,). The model error has the kernel Q diag(λ) Qᵀ over frames and the variance s_m in mode
//! m. The whitened column is X + Q (diag(1/√(1 + λ s)) − 1) Qᵀ X
//! (softmap_edge/noise/noise_model.py). With QᵀQ = 1, the whitened Gram is
//!
//!     G_ab = Σ_k w_ak w_bk P_ab(k) − Σ_rm D_rm Y_a,rm Y_b,rm,   P_ab(k) = Σ_m base_a,km base_b,km,
//!     Y = Qᵀ X,   D = λs/(1 + λs).
//!
//! Many columns share few bases, so the first term costs a few products of weights. Pairs (r, m)
//! with D < 1e-4 are skipped, which overstates the energy along them by at most 1e-4. Columns come
//! in blocks; a Gram matrix is that of two blocks. Checked by tests/noise/test_level.py.

use crate::error::{Result, invalid};
use crate::shape::modes::wide;
use faer::linalg::matmul::matmul;
use faer::{Accum, Mat, MatRef, Par};
use std::ops::Range;
use std::sync::Arc;

/// Value of D below which a pair of kernel vector and mode is skipped.
const NEGLIGIBLE: f64 = 1e-4;
/// Largest deviation of QᵀQ from the identity: round-off of a singular value decomposition.
const ORTHONORMAL: f64 = 1e-8;
/// Columns formed at a time, so that they stay in the cache.
const TOGETHER: usize = 128;

/// A set of frames and the kernel over their commands.
pub(super) struct Frames {
    pub(super) index: Vec<usize>,
    /// Q (frames, r), column by column, sorted by falling strength.
    basis: Vec<f64>,
    /// λ (r,).
    strength: Vec<f64>,
}

impl Frames {
    /// Create a set of frames out of `total`, with kernel basis (frames, r) row by row and strength
    /// (r,). `name` appears in error messages.
    pub(super) fn new(
        name: &str,
        index: Vec<usize>,
        basis: &[f64],
        strength: &[f64],
        total: usize,
    ) -> Result<Frames> {
        let (count, rank) = (index.len(), strength.len());
        if let Some(frame) = index.iter().find(|frame| **frame >= total) {
            return Err(invalid(format!(
                "{name} contains frame {frame}, but there are only {total} frames"
            )));
        }
        if basis.len() != count * rank {
            return Err(invalid(format!(
                "kernel basis of {name} has {} numbers, expected ({count}, {rank})",
                basis.len()
            )));
        }
        if let Some(bad) = strength.iter().find(|s| s.is_nan() || **s < 0.0) {
            return Err(invalid(format!(
                "kernel of {name} has strength {bad}; strengths must not be negative"
            )));
        }
        let mut order: Vec<usize> = (0..rank).collect();
        order.sort_by(|a, b| strength[*b].total_cmp(&strength[*a]));
        let vector = |r: usize| basis.iter().skip(r).step_by(rank).copied();
        let frames = Frames {
            index,
            basis: order.iter().flat_map(|r| vector(*r)).collect(),
            strength: order.iter().map(|r| strength[*r]).collect(),
        };
        frames.check_orthonormal(name)?;
        Ok(frames)
    }

    fn check_orthonormal(&self, name: &str) -> Result<()> {
        let rank = self.strength.len();
        let q = self.vectors(rank);
        let mut inner: Mat<f64> = Mat::zeros(rank, rank);
        matmul(
            inner.as_mut(),
            Accum::Replace,
            q.transpose(),
            q,
            1.0,
            Par::Seq,
        );
        for j in 0..rank {
            for i in 0..=j {
                let off = (inner[(i, j)] - f64::from(i == j)).abs();
                if off.is_nan() || off > ORTHONORMAL {
                    return Err(invalid(format!(
                        "kernel of {name}: basis vectors {i} and {j} are not orthonormal \
                        (deviation {off:.2e})"
                    )));
                }
            }
        }
        Ok(())
    }

    /// The strongest `rank` vectors (frames, rank).
    fn vectors(&self, rank: usize) -> MatRef<'_, f64> {
        let count = self.index.len();
        MatRef::from_column_major_slice(&self.basis[..count * rank], count, rank)
    }

    /// D of the vectors that matter for a mode with model-error variance `form`; these are the
    /// strongest ones.
    fn explained(&self, form: f64) -> impl Iterator<Item = f64> + '_ {
        let share = move |strength: &f64| strength * form / (1.0 + strength * form);
        let shares = self.strength.iter().map(share);
        shares.take_while(|share| *share >= NEGLIGIBLE)
    }
}

/// Columns X_j = bases[base[j]] ∘ weight[j], sorted by base. A base is (M, K), a weight (K,).
pub(super) struct Columns<'a> {
    pub(super) bases: &'a [Arc<Vec<f64>>],
    pub(super) base: &'a [usize],
    pub(super) weight: &'a [Vec<f64>],
    /// Number of frames K.
    pub(super) total: usize,
}

/// Columns at some of the frames: bases (B, M, frames) and weights (n, frames).
struct Gathered<'a> {
    base: &'a [usize],
    bases: Vec<f64>,
    weight: Vec<f64>,
    /// M · frames.
    size: usize,
    count: usize,
}

impl Columns<'_> {
    fn at(&self, index: &[usize]) -> Gathered<'_> {
        let take = |row: &[f64], out: &mut Vec<f64>| out.extend(index.iter().map(|k| row[*k]));
        let mut weight = Vec::with_capacity(self.weight.len() * index.len());
        self.weight.iter().for_each(|row| take(row, &mut weight));
        let mut bases = vec![];
        for base in self.bases {
            base.chunks_exact(self.total)
                .for_each(|row| take(row, &mut bases));
        }
        Gathered {
            base: self.base,
            size: bases.len() / self.bases.len().max(1),
            bases,
            weight,
            count: index.len(),
        }
    }

    /// √D Y (R, n) over a set of frames, for the model-error variance `form` (M,) of each mode: the
    /// part of the columns that model error can explain.
    pub(super) fn along(&self, frames: &Frames, form: &[f64]) -> Mat<f64> {
        let n = self.base.len();
        let here = self.at(&frames.index);
        let ranks: Vec<usize> = form.iter().map(|s| frames.explained(*s).count()).collect();
        let mut along: Mat<f64> = Mat::zeros(ranks.iter().sum(), n);
        let mut formed = vec![0.0; TOGETHER.min(n) * here.count];
        let mut top = 0;
        for (m, rank) in ranks.into_iter().enumerate().filter(|(_, rank)| *rank > 0) {
            for first in (0..n).step_by(TOGETHER) {
                let width = TOGETHER.min(n - first);
                let columns = formed[..width * here.count].chunks_exact_mut(here.count);
                for (j, column) in (first..).zip(columns) {
                    multiply(here.mode(self.base[j], m), here.weight(j), column);
                }
                matmul(
                    along.as_mut().submatrix_mut(top, first, rank, width),
                    Accum::Replace,
                    frames.vectors(rank).transpose(),
                    MatRef::from_column_major_slice(
                        &formed[..width * here.count],
                        here.count,
                        width,
                    ),
                    1.0,
                    Par::Seq,
                );
            }
            let roots: Vec<f64> = frames.explained(form[m]).map(f64::sqrt).collect();
            for j in 0..n {
                let column = &mut along.col_as_slice_mut(j)[top..top + rank];
                column
                    .iter_mut()
                    .zip(&roots)
                    .for_each(|(y, root)| *y *= root);
            }
            top += rank;
        }
        along
    }

    /// The Gram (n, n') with other columns over some of the frames, without whitening.
    pub(super) fn plain(&self, others: &Columns, index: &[usize]) -> Mat<f64> {
        let mut out: Mat<f64> = Mat::zeros(self.base.len(), others.base.len());
        if index.is_empty() {
            return out;
        }
        let (a, b) = (self.at(index), others.at(index));
        let mut products = vec![0.0; a.count];
        let mut scaled = vec![];
        for rows in runs(a.base) {
            for columns in runs(b.base) {
                products_of(a.base(rows.start), b.base(columns.start), &mut products);
                scaled.resize(rows.len() * a.count, 0.0);
                for (j, scaled) in rows.clone().zip(scaled.chunks_exact_mut(a.count)) {
                    multiply(a.weight(j), &products, scaled);
                }
                let right = &b.weight[columns.start * b.count..columns.end * b.count];
                matmul(
                    out.as_mut().submatrix_mut(
                        rows.start,
                        columns.start,
                        rows.len(),
                        columns.len(),
                    ),
                    Accum::Replace,
                    MatRef::from_row_major_slice(&scaled, rows.len(), a.count),
                    MatRef::from_column_major_slice(right, b.count, columns.len()),
                    1.0,
                    Par::Seq,
                );
            }
        }
        out
    }
}

impl Gathered<'_> {
    /// The base (M, frames) of a column.
    fn base(&self, column: usize) -> &[f64] {
        &self.bases[self.base[column] * self.size..][..self.size]
    }

    /// Mode m of a base, (frames,).
    fn mode(&self, base: usize, m: usize) -> &[f64] {
        &self.bases[base * self.size + m * self.count..][..self.count]
    }

    fn weight(&self, column: usize) -> &[f64] {
        &self.weight[column * self.count..][..self.count]
    }
}

/// Ranges of columns in a row that have the same base.
fn runs(base: &[usize]) -> impl Iterator<Item = Range<usize>> {
    base.chunk_by(|a, b| a == b).scan(0, |first, run| {
        let range = *first..*first + run.len();
        *first = range.end;
        Some(range)
    })
}

/// The whitened Gram: the plain one less the part along model error.
pub(super) fn whitened(mut plain: Mat<f64>, a: &Mat<f64>, b: &Mat<f64>) -> Mat<f64> {
    matmul(
        plain.as_mut(),
        Accum::Add,
        a.transpose(),
        b.as_ref(),
        -1.0,
        Par::Seq,
    );
    plain
}

/// Sum over modes of the product of two bases (M, frames), at each frame.
fn products_of(a: &[f64], b: &[f64], out: &mut [f64]) {
    let count = out.len().max(1);
    out.fill(0.0);
    wide(
        #[inline(always)]
        || {
            for (a, b) in a.chunks_exact(count).zip(b.chunks_exact(count)) {
                for ((out, a), b) in out.iter_mut().zip(a).zip(b) {
                    *out += a * b;
                }
            }
        },
    );
}

fn multiply(a: &[f64], b: &[f64], out: &mut [f64]) {
    wide(
        #[inline(always)]
        || {
            for ((out, a), b) in out.iter_mut().zip(a).zip(b) {
                *out = a * b;
            }
        },
    );
}
