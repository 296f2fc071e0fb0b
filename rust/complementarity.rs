//! The linear complementarity problem: z ≥ 0, w = M z − q ≥ 0, z·w = 0, for a positive definite M.
//!
//! What pulls only, or pushes only: cables and contacts. Solved by the primal-dual active set method (Hintermüller, Ito &
//! Kunisch 2002), by projected Gauss–Seidel should that cycle.

use crate::dense;

/// Rounds of Gauss–Seidel, and the change (N) at which they end.
const ROUNDS: usize = 400;
const SETTLED: f64 = 1e-9;

/// Solve for z (n,) with `matrix` (n, n) row by row and `right` q (n,), starting from those that are taken to be positive.
pub fn solve(matrix: &[f64], right: &[f64], start: Vec<bool>) -> Vec<f64> {
    active_set(matrix, right, start).unwrap_or_else(|| gauss_seidel(matrix, right))
}

fn row(matrix: &[f64], i: usize, n: usize) -> &[f64] {
    &matrix[i * n..(i + 1) * n]
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// Solve for those taken as positive until they are and the others have w ≥ 0.
fn active_set(matrix: &[f64], right: &[f64], mut positive: Vec<bool>) -> Option<Vec<f64>> {
    let n = right.len();
    let (mut set, mut rows, mut z) = (Vec::with_capacity(n), vec![], vec![0.0; n]);
    for _ in 0..2 * n + 8 {
        set.clear();
        set.extend((0..n).filter(|i| positive[*i]));
        rows.clear();
        for &i in &set {
            let own = row(matrix, i, n);
            rows.extend(set.iter().map(|&j| own[j]).chain([right[i]]));
        }
        if !dense::eliminate(&mut rows, set.len()) {
            return None;
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
                right[i] > dot(row(matrix, i, n), &z)
            };
            settled &= next == positive[i];
            positive[i] = next;
        }
        if settled {
            return z.iter().all(|v| v.is_finite()).then_some(z);
        }
    }
    None
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
        for k in 0..60 {
            let right: Vec<f64> = (0..3)
                .map(|i| 3.0 * ((7 * k + 3 * i) as f64).sin())
                .collect();
            let start = (0..3).map(|i| (k >> i) % 2 == 1).collect();
            let z = active_set(&matrix, &right, start).unwrap();
            let other = gauss_seidel(&matrix, &right);
            for i in 0..3 {
                let w = dot(row(&matrix, i, 3), &z) - right[i];
                assert!(z[i] >= 0.0 && w > -1e-12 && (z[i] * w).abs() < 1e-12);
                assert!((z[i] - other[i]).abs() < 1e-7);
            }
        }
        assert!(solve(&[], &[], vec![]).is_empty());
    }
}
