//! Symmetric positive definite systems of B×B node blocks: one symbolic analysis of the pattern,
//! many numeric factors.
//!
//! B is 3 if forces couple the coordinates of a node, and 1 if each coordinate has the same system.

use crate::error::{Result, invalid};
use faer::Par;
use faer::Side;
use faer::dyn_stack::{MemBuffer, MemStack, StackReq};
use faer::linalg::cholesky::llt::factor::LltRegularization;
use faer::mat::MatMut;
use faer::sparse::linalg::cholesky::{
    CholeskySymbolicParams, LltRef, SymbolicCholesky, SymmetricOrdering,
    factorize_symbolic_cholesky,
};
use faer::sparse::{SparseColMatRef, SymbolicSparseColMat};
use std::collections::BTreeSet;
use std::ops::Index;

/// Lower triangle of a symmetric matrix of B×B blocks, in compressed columns.
pub struct Pattern<const B: usize = 3> {
    symbolic: SymbolicSparseColMat<usize>,
    /// For each block column, its block rows (the first is the diagonal), ascending.
    rows: Vec<Vec<usize>>,
    cholesky: SymbolicCholesky<usize>,
}

impl<const B: usize> Pattern<B> {
    /// From the coupled block pairs (row ≥ column); the diagonal is always there.
    pub fn new(blocks: usize, pairs: impl Iterator<Item = (usize, usize)>) -> Result<Pattern<B>> {
        let mut columns = vec![BTreeSet::new(); blocks];
        for (row, column) in pairs {
            columns[column].insert(row);
        }
        let mut rows = Vec::with_capacity(blocks);
        let (mut starts, mut indices) = (vec![0], Vec::new());
        for (j, mut column) in columns.into_iter().enumerate() {
            column.insert(j);
            let column: Vec<usize> = column.into_iter().collect();
            for c in 0..B {
                indices.extend((c..B).map(|r| B * j + r));
                indices.extend(
                    column[1..]
                        .iter()
                        .flat_map(|&i| (0..B).map(move |r| B * i + r)),
                );
                starts.push(indices.len());
            }
            rows.push(column);
        }
        let n = B * blocks;
        let symbolic = SymbolicSparseColMat::new_checked(n, n, starts, None, indices);
        let cholesky = factorize_symbolic_cholesky(
            symbolic.as_ref(),
            Side::Lower,
            SymmetricOrdering::Amd,
            CholeskySymbolicParams::default(),
        )
        .map_err(|e| {
            invalid(format!(
                "the system of {n} unknowns cannot be analysed ({e}); use a coarser mesh"
            ))
        })?;
        Ok(Pattern {
            symbolic,
            rows,
            cholesky,
        })
    }

    /// Number of stored values.
    pub fn len(&self) -> usize {
        self.symbolic.row_idx().len()
    }

    /// True for a system without unknowns.
    pub fn is_empty(&self) -> bool {
        self.rows.is_empty()
    }

    /// Number of unknowns.
    pub fn unknowns(&self) -> usize {
        B * self.rows.len()
    }

    /// Storage index of block (row, column) within each of its three columns.
    pub fn slot(&self, row: usize, column: usize) -> Option<usize> {
        self.rows[column].binary_search(&row).ok()
    }

    /// Add a block to the values; of a diagonal block, only the lower triangle is used.
    pub fn add<Row: Index<usize, Output = f64>>(
        &self,
        values: &mut [f64],
        column: usize,
        slot: usize,
        block: &[Row; B],
    ) {
        let starts = self.symbolic.col_ptr();
        for c in 0..B {
            let start = starts[B * column + c];
            if slot == 0 {
                for r in c..B {
                    values[start + r - c] += block[r][c];
                }
            } else {
                let place = start + B * slot - c;
                for r in 0..B {
                    values[place + r] += block[r][c];
                }
            }
        }
    }

    /// Mean of the diagonal.
    pub fn mean_diagonal(&self, values: &[f64]) -> f64 {
        let starts = self.symbolic.col_ptr();
        (0..self.unknowns()).map(|j| values[starts[j]]).sum::<f64>() / self.unknowns().max(1) as f64
    }

    /// Add a number to the diagonal.
    pub fn shift(&self, values: &mut [f64], by: f64) {
        let starts = self.symbolic.col_ptr();
        for j in 0..self.unknowns() {
            values[starts[j]] += by;
        }
    }

    /// y = A x
    pub fn multiply(&self, values: &[f64], x: &[f64], y: &mut [f64]) {
        y.fill(0.0);
        let (starts, rows) = (self.symbolic.col_ptr(), self.symbolic.row_idx());
        for j in 0..self.unknowns() {
            y[j] += values[starts[j]] * x[j];
            for k in starts[j] + 1..starts[j + 1] {
                y[rows[k]] += values[k] * x[j];
                y[j] += values[k] * x[rows[k]];
            }
        }
    }
}

/// Reusable storage of one numeric factor.
pub struct Factor {
    values: Vec<f64>,
    memory: MemBuffer,
}

impl Factor {
    /// Storage for factors of this pattern, solving up to `columns` right-hand sides at once.
    pub fn new<const B: usize>(pattern: &Pattern<B>, columns: usize) -> Result<Factor> {
        let numeric = pattern
            .cholesky
            .factorize_numeric_llt_scratch::<f64>(Par::Seq, Default::default());
        let solve = pattern
            .cholesky
            .solve_in_place_scratch::<f64>(columns, Par::Seq);
        let memory = MemBuffer::try_new(StackReq::any_of(&[numeric, solve]))
            .map_err(|_| invalid("not enough memory for the factor; use a coarser mesh"))?;
        Ok(Factor {
            values: vec![0.0; pattern.cholesky.len_val()],
            memory,
        })
    }

    /// Factor the matrix; false when it is not positive definite.
    pub fn refactor<const B: usize>(&mut self, pattern: &Pattern<B>, matrix: &[f64]) -> bool {
        let matrix = SparseColMatRef::new(pattern.symbolic.as_ref(), matrix);
        pattern
            .cholesky
            .factorize_numeric_llt(
                &mut self.values,
                matrix,
                Side::Lower,
                LltRegularization::default(),
                Par::Seq,
                MemStack::new(&mut self.memory),
                Default::default(),
            )
            .is_ok()
    }

    /// Solve in place for the columns stored one after the other in `b`.
    pub fn solve<const B: usize>(&mut self, pattern: &Pattern<B>, b: &mut [f64]) {
        let n = pattern.unknowns();
        let columns = b.len() / n.max(1);
        let stack = MemStack::new(&mut self.memory);
        LltRef::new(&pattern.cholesky, &self.values).solve_in_place_with_conj(
            faer::Conj::No,
            MatMut::from_column_major_slice_mut(b, n, columns),
            Par::Seq,
            stack,
        );
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn factor_solves_what_multiply_makes_and_refuses_an_indefinite_matrix() {
        let pairs = [(1, 0), (2, 1), (4, 2), (4, 0), (3, 3)];
        let pattern = Pattern::new(5, pairs.into_iter()).unwrap();
        let mut values = vec![0.0; pattern.len()];
        for (i, &(row, column)) in pairs.iter().enumerate() {
            let slot = pattern.slot(row, column).unwrap();
            let t = 0.3 + 0.1 * i as f64;
            pattern.add(
                &mut values,
                column,
                slot,
                &[[t, 0.2, -0.1], [0.2, -t, 0.4], [-0.1, 0.4, t]],
            );
        }
        pattern.shift(&mut values, 4.0);
        let x: Vec<f64> = (0..15).map(|i| (i as f64).sin()).collect();
        let mut b = vec![0.0; 15];
        pattern.multiply(&values, &x, &mut b);
        let mut factor = Factor::new(&pattern, 1).unwrap();
        assert!(factor.refactor(&pattern, &values));
        factor.solve(&pattern, &mut b);
        assert!(x.iter().zip(&b).all(|(p, q)| (p - q).abs() < 1e-12));
        pattern.shift(&mut values, -8.0);
        assert!(!factor.refactor(&pattern, &values));
        assert!(pattern.slot(3, 0).is_none());
    }
}
