//! Small dense linear systems: a handful of cables, never a mesh.

/// Solve A x = b by elimination with pivoting; None when A is singular.
pub(crate) fn solve(mut a: Vec<Vec<f64>>, mut b: Vec<f64>) -> Option<Vec<f64>> {
    let n = b.len();
    for c in 0..n {
        let pivot = (c..n).max_by(|&i, &j| a[i][c].abs().total_cmp(&a[j][c].abs()))?;
        if a[pivot][c] == 0.0 || !a[pivot][c].is_finite() {
            return None;
        }
        a.swap(c, pivot);
        b.swap(c, pivot);
        for r in c + 1..n {
            let f = a[r][c] / a[c][c];
            for k in c..n {
                a[r][k] -= f * a[c][k];
            }
            b[r] -= f * b[c];
        }
    }
    for c in (0..n).rev() {
        let known: f64 = (c + 1..n).map(|k| a[c][k] * b[k]).sum();
        b[c] = (b[c] - known) / a[c][c];
    }
    Some(b)
}

#[cfg(test)]
mod tests {
    use super::solve;

    #[test]
    fn small_dense_systems_are_solved() {
        let a = vec![vec![0.0, 2.0], vec![2.0, 1.0]];
        assert_eq!(solve(a, vec![4.0, 4.0]), Some(vec![1.0, 2.0]));
        assert_eq!(solve(vec![vec![0.0]], vec![1.0]), None);
    }
}
