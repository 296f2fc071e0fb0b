//! Small dense linear systems: a few cables or segments, never a mesh.

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

/// Solve A x = b by elimination with pivoting, in place of `rows` (n, n + 1) [A | b]: x is written
/// to their last column. False when A is singular.
pub(crate) fn eliminate(rows: &mut [f64], n: usize) -> bool {
    let width = n + 1;
    for c in 0..n {
        let size = |r: usize| rows[r * width + c].abs();
        let pivot = (c + 1..n).fold(c, |best, r| if size(r) > size(best) { r } else { best });
        let value = rows[pivot * width + c];
        if value == 0.0 || !value.is_finite() {
            return false;
        }
        if pivot != c {
            (c..width).for_each(|k| rows.swap(c * width + k, pivot * width + k));
        }
        for r in (0..n).filter(|r| *r != c) {
            let f = rows[r * width + c] / value;
            for k in c..width {
                rows[r * width + k] -= f * rows[c * width + k];
            }
        }
    }
    for c in 0..n {
        rows[c * width + n] /= rows[c * width + c];
    }
    true
}

/// The Cholesky factor of a positive definite system, for any number of right-hand sides.
#[derive(Debug, Clone)]
pub(crate) struct Factor {
    lower: Vec<f64>,
    n: usize,
}

impl Factor {
    /// Factorise the lower triangle of `a` (n, n), row-major. A pivot lost to round-off is set to
    /// 1e-14 of its diagonal.
    pub(crate) fn new(mut a: Vec<f64>, n: usize) -> Self {
        for i in 0..n {
            for k in 0..=i {
                let known: f64 = (0..k).map(|m| a[i * n + m] * a[k * n + m]).sum();
                let rest = a[i * n + k] - known;
                a[i * n + k] = if i == k {
                    rest.max(1e-14 * a[i * n + i]).sqrt()
                } else {
                    rest / a[k * n + k]
                };
            }
        }
        Self { lower: a, n }
    }

    /// Replace `b` (n,) by the solution.
    pub(crate) fn solve(&self, b: &mut [f64]) {
        let (a, n) = (&self.lower, self.n);
        for i in 0..n {
            let known: f64 = (0..i).map(|k| a[i * n + k] * b[k]).sum();
            b[i] = (b[i] - known) / a[i * n + i];
        }
        for i in (0..n).rev() {
            let known: f64 = (i + 1..n).map(|k| a[k * n + i] * b[k]).sum();
            b[i] = (b[i] - known) / a[i * n + i];
        }
    }
}

#[cfg(test)]
mod tests {
    use super::{Factor, solve};

    #[test]
    fn positive_definite_systems_are_solved() {
        let mut b = [8.0, 10.0];
        Factor::new(vec![4.0, 0.0, 2.0, 3.0], 2).solve(&mut b); // only the lower triangle is read
        assert!((b[0] - 0.5).abs() < 1e-15 && (b[1] - 3.0).abs() < 1e-15);
    }

    #[test]
    fn small_dense_systems_are_solved() {
        let a = vec![vec![0.0, 2.0], vec![2.0, 1.0]];
        assert_eq!(solve(a, vec![4.0, 4.0]), Some(vec![1.0, 2.0]));
        assert_eq!(solve(vec![vec![0.0]], vec![1.0]), None);
    }
}
