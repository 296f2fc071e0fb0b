//! Gram matrices of whitened columns over a set of frames, without forming the whitened columns.
//!
//! A column is X_j = base_j ∘ w_j: a base (K, M) over K frames and M modes, times one weight per frame (K,). The model error
//! has the kernel Q diag(λ) Qᵀ over frames and the variance s_m in mode m. The whitened column is
//! X + Q (diag(1/√(1 + λ s)) − 1) Qᵀ X (softmap_edge/diagnosis/noise.py). With QᵀQ = 1, the whitened Gram is
//!
//!     G_ab = Σ_k w_ak w_bk P_ab(k) − Σ_rm D_rm Y_a,rm Y_b,rm,   P_ab(k) = Σ_m base_a,km base_b,km,
//!     Y = Qᵀ X,   D = λs/(1 + λs).
//!
//! Many columns share few bases, so the first term costs a few products of weights. Pairs (r, m) with D < 1e-4 are skipped,
//! which overstates the energy along them by at most 1e-4. Checked by tests/test_level.py.

use crate::error::{Result, invalid};
use crate::modes::wide;
use faer::linalg::matmul::matmul;
use faer::linalg::matmul::triangular::{self, BlockStructure};
use faer::{Accum, Mat, MatRef, Par};

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
    /// Create a set of frames out of `total`, with kernel basis (frames, r) row by row and strength (r,). `name` appears in
    /// error messages.
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
                        "kernel of {name}: basis vectors {i} and {j} are not orthonormal (deviation {off:.2e})"
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

    /// D of the vectors that matter for a mode with model-error variance `form`; these are the strongest ones.
    fn explained(&self, form: f64) -> impl Iterator<Item = f64> + '_ {
        let share = move |strength: &f64| strength * form / (1.0 + strength * form);
        let shares = self.strength.iter().map(share);
        shares.take_while(|share| *share >= NEGLIGIBLE)
    }
}

/// Columns X_j = bases[base[j]] ∘ weight[j], sorted by base. A base is (M, K), a weight (K,).
pub(super) struct Columns<'a> {
    pub(super) bases: &'a [&'a [f64]],
    pub(super) base: Vec<usize>,
    pub(super) weight: Vec<&'a [f64]>,
    /// Model-error variance s of each mode (M,).
    pub(super) form: &'a [f64],
    /// Number of frames K.
    pub(super) total: usize,
}

impl Columns<'_> {
    /// The whitened Gram of the columns over a set of frames, and the plain one.
    pub(super) fn grams(&self, frames: &Frames) -> (Packed, Mat<f64>) {
        let plain = self.plain(&frames.index);
        (self.whitened(frames, plain.clone()), plain)
    }

    /// The whitened Gram of the columns over a set of frames from the plain one.
    pub(super) fn whitened(&self, frames: &Frames, mut plain: Mat<f64>) -> Packed {
        let n = self.base.len();
        // Allocated before the temporaries, so that freeing them leaves no hole in the heap.
        let mut packed = Packed(vec![0.0; n * (n + 1) / 2]);
        let (bases, weight) = self.gathered(&frames.index);
        self.subtract_model_error(frames, &bases, &weight, &mut plain);
        packed.fill(&plain);
        packed
    }

    /// Bases (B, M, frames) and weights (n, frames) at some of the frames.
    fn gathered(&self, index: &[usize]) -> (Vec<f64>, Vec<f64>) {
        let take = |row: &[f64], out: &mut Vec<f64>| out.extend(index.iter().map(|k| row[*k]));
        let mut weight = Vec::with_capacity(self.base.len() * index.len());
        self.weight.iter().for_each(|row| take(row, &mut weight));
        let mut bases = Vec::with_capacity(self.bases.len() * self.form.len() * index.len());
        for base in self.bases {
            let rows = base.chunks_exact(self.total);
            rows.for_each(|row| take(row, &mut bases));
        }
        (bases, weight)
    }

    /// The Gram without whitening over some of the frames, in the lower triangle, base by base.
    pub(super) fn plain(&self, index: &[usize]) -> Mat<f64> {
        let (count, n) = (index.len(), self.base.len());
        let mut out: Mat<f64> = Mat::zeros(n, n);
        if count == 0 {
            return out;
        }
        let (bases, weight) = self.gathered(index);
        let size = self.form.len() * count;
        let mut scaled = vec![0.0; TOGETHER.min(n) * count];
        let mut products = vec![0.0; count];
        let mut first = 0;
        while first < n {
            let base = self.base[first];
            let mine = &bases[base * size..][..size];
            let width = self.base[first..].partition_point(|b| *b == base);
            let mut known = usize::MAX;
            for below in (first..n).step_by(TOGETHER) {
                let height = TOGETHER.min(n - below);
                for j in below..below + height {
                    if self.base[j] != known {
                        known = self.base[j];
                        products_of(mine, &bases[known * size..][..size], &mut products);
                    }
                    let row = &weight[j * count..][..count];
                    let scaled = &mut scaled[(j - below) * count..][..count];
                    multiply(row, &products, scaled);
                }
                let rows = &scaled[..height * count];
                let columns = &weight[first * count..][..width * count];
                matmul(
                    out.as_mut().submatrix_mut(below, first, height, width),
                    Accum::Replace,
                    MatRef::from_row_major_slice(rows, height, count),
                    MatRef::from_column_major_slice(columns, count, width),
                    1.0,
                    Par::Seq,
                );
            }
            first += width;
        }
        out
    }

    /// Subtract the part that model error can explain from the lower triangle of `out`.
    fn subtract_model_error(
        &self,
        frames: &Frames,
        bases: &[f64],
        weight: &[f64],
        out: &mut Mat<f64>,
    ) {
        let (count, n, modes) = (frames.index.len(), self.base.len(), self.form.len());
        let ranks: Vec<usize> = self
            .form
            .iter()
            .map(|s| frames.explained(*s).count())
            .collect();
        let mut along: Mat<f64> = Mat::zeros(ranks.iter().sum(), n); // √D Y
        let mut formed = vec![0.0; TOGETHER.min(n) * count];
        let mut top = 0;
        for (m, rank) in ranks.into_iter().enumerate().filter(|(_, rank)| *rank > 0) {
            for first in (0..n).step_by(TOGETHER) {
                let width = TOGETHER.min(n - first);
                for (j, column) in (first..).zip(formed[..width * count].chunks_exact_mut(count)) {
                    let base = &bases[(self.base[j] * modes + m) * count..][..count];
                    multiply(base, &weight[j * count..][..count], column);
                }
                matmul(
                    along.as_mut().submatrix_mut(top, first, rank, width),
                    Accum::Replace,
                    frames.vectors(rank).transpose(),
                    MatRef::from_column_major_slice(&formed[..width * count], count, width),
                    1.0,
                    Par::Seq,
                );
            }
            let roots: Vec<f64> = frames.explained(self.form[m]).map(f64::sqrt).collect();
            for j in 0..n {
                let column = &mut along.col_as_slice_mut(j)[top..top + rank];
                column
                    .iter_mut()
                    .zip(&roots)
                    .for_each(|(y, root)| *y *= root);
            }
            top += rank;
        }
        triangular::matmul(
            out.as_mut(),
            BlockStructure::TriangularLower,
            Accum::Add,
            along.transpose(),
            BlockStructure::Rectangular,
            along.as_ref(),
            BlockStructure::Rectangular,
            -1.0,
            Par::Seq,
        );
    }
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

/// Lower triangle of a symmetric matrix, row by row.
pub(super) struct Packed(Vec<f64>);

impl Packed {
    /// Copy the lower triangle of `full`.
    fn fill(&mut self, full: &Mat<f64>) {
        for j in 0..full.nrows() {
            for (i, value) in full.col_as_slice(j).iter().enumerate().skip(j) {
                self.0[i * (i + 1) / 2 + j] = *value;
            }
        }
    }

    /// Entry of two columns, in either order.
    pub(super) fn at(&self, a: usize, b: usize) -> f64 {
        let (row, column) = (a.max(b), a.min(b));
        self.0[row * (row + 1) / 2 + column]
    }
}
