//! The linear complementarity problem: z ≥ 0, w = M z − q ≥ 0, z·w = 0, for a positive definite M.
//!
//! One-sided forces: cables pull, contacts push. Solved by the primal-dual active set method
//! (Hintermüller, Ito & Kunisch 2002), or by projected Gauss–Seidel if that cycles.

use crate::algebra::dense;

/// Most rounds of Gauss–Seidel, and the change (N) that ends them.
const ROUNDS: usize = 400;
const SETTLED: f64 = 1e-9;

/// A problem and its solution, in reusable storage.
#[derive(Debug, Clone, Default)]
pub struct Problem {
    /// M (n, n) row by row, and q (n,).
    pub matrix: Vec<f64>,
    pub right: Vec<f64>,
    /// The initial active set (z > 0).
    pub positive: Vec<bool>,
    answer: Vec<f64>,
    set: Vec<usize>,
    rows: Vec<f64>,
}

impl Problem {
    /// Clear everything except the storage.
    pub fn clear(&mut self) {
        self.matrix.clear();
        self.right.clear();
        self.positive.clear();
    }

    /// Solve for z (n,).
    pub fn solve(&mut self) -> &[f64] {
        if !self.active_set() {
            self.answer = gauss_seidel(&self.matrix, &self.right);
        }
        &self.answer
    }

    /// Solve for the active set until its z are positive and all others have w ≥ 0.
    fn active_set(&mut self) -> bool {
        let Problem {
            matrix,
            right,
            positive,
            answer: z,
            set,
            rows,
        } = self;
        let n = right.len();
        z.clear();
        z.resize(n, 0.0);
        for _ in 0..2 * n + 8 {
            set.clear();
            set.extend((0..n).filter(|i| positive[*i]));
            rows.clear();
            for &i in set.iter() {
                let own = row(matrix, i, n);
                rows.extend(set.iter().map(|&j| own[j]).chain([right[i]]));
            }
            if !dense::eliminate(rows, set.len()) {
                return false;
            }
            z.fill(0.0);
            let found = rows.chunks_exact(set.len() + 1);
            set.iter()
                .zip(found)
                .for_each(|(&i, row)| z[i] = row[set.len()]);
            let mut settled = true;
            for i in 0..n {
                let next = if positive[i] {
                    z[i] > 0.0
                } else {
                    right[i] > dot(row(matrix, i, n), z)
                };
                settled &= next == positive[i];
                positive[i] = next;
            }
            if settled {
                return z.iter().all(|v| v.is_finite());
            }
        }
        false
    }
}

fn row(matrix: &[f64], i: usize, n: usize) -> &[f64] {
    &matrix[i * n..(i + 1) * n]
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

fn gauss_seidel(matrix: &[f64], right: &[f64]) -> Vec<f64> {
    let n = right.len();
    let mut z = vec![0.0; n];
    for _ in 0..ROUNDS {
        let mut largest: f64 = 0.0;
        for i in 0..n {
            let row = row(matrix, i, n);
            let next = (z[i] + (right[i] - dot(row, &z)) / row[i].max(1e-12)).max(0.0);
            largest = largest.max((next - z[i]).abs());
            z[i] = next;
        }
        if largest < SETTLED {
            break;
        }
    }
    z
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_ways_find_what_is_complementary() {
        let matrix = [2.0, -0.5, 0.3, -0.5, 1.5, 0.4, 0.3, 0.4, 1.0];
        let mut problem = Problem::default();
        for k in 0..60 {
            let right: Vec<f64> = (0..3)
                .map(|i| 3.0 * ((7 * k + 3 * i) as f64).sin())
                .collect();
            problem.clear();
            problem.matrix.extend(matrix);
            problem.right.extend(&right);
            problem.positive.extend((0..3).map(|i| (k >> i) % 2 == 1));
            assert!(problem.active_set());
            let z = problem.answer.clone();
            let other = gauss_seidel(&matrix, &right);
            for i in 0..3 {
                let w = dot(row(&matrix, i, 3), &z) - right[i];
                assert!(z[i] >= 0.0 && w > -1e-12 && (z[i] * w).abs() < 1e-12);
                assert!((z[i] - other[i]).abs() < 1e-7);
            }
        }
        problem.clear();
        assert!(problem.solve().is_empty());
    }
}
