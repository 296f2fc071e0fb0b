//! A shape family tabulated on a tensor grid of commands: a few modes, cubic interpolation between
//! the nodes.
//!
//! `shape(u) = mean + Σ_m a_m(u)·mode_m`, where `a_m` is interpolated from its values at the grid
//! nodes by the cubic pieces of `cubic.rs`, axis by axis. Units: mm of command in, the tabulated
//! quantity out. C1; outside the grid the family continues linearly from the border in each axis.
//! Limits: at most three channels; kinks of the tabulated family are rounded over one cell. Pinned
//! by the tests below.

use crate::error::{Result, invalid};
use crate::memory::zeros;
use crate::shape::Shape;
use crate::shape::grid::{Carry, Grid};
use crate::shape::modes::{Modes, STACK_MODES, accumulate, wide};
use std::sync::Arc;

pub use crate::shape::grid::MAX_CHANNELS;

/// Modes on a tensor grid of commands.
#[derive(Debug, Clone)]
pub struct Table {
    grid: Grid,
    coefficients: Arc<[f64]>,
    modes: Modes,
}

impl Table {
    /// Build a table from `axes` (ascending, ≥ 2 nodes each), `coefficients` (n_1·…·n_C, m) with
    /// the last axis fastest, `mean` (M,) and `modes` (m, M), all row-major. No axes make a
    /// constant family (C = 0).
    pub fn new(
        axes: Vec<Vec<f64>>,
        coefficients: Vec<f64>,
        mean: Vec<f64>,
        modes: Vec<f64>,
    ) -> Result<Table> {
        let grid = Grid::new(axes)?;
        let everything = coefficients.iter().chain(&mean).chain(&modes);
        if everything.into_iter().any(|value| !value.is_finite()) {
            return Err(invalid(
                "a table holds a number that is not finite; rebuild it from a clean sweep",
            ));
        }
        let modes = Modes::new(mean, modes)?;
        let (nodes, count) = (grid.nodes(), modes.count());
        if Some(coefficients.len()) != nodes.checked_mul(count) {
            return Err(invalid(format!(
                "coefficients must be ({nodes} grid nodes, {count} modes), got {} numbers",
                coefficients.len()
            )));
        }
        Ok(Table {
            grid,
            coefficients: coefficients.into(),
            modes,
        })
    }

    /// The grid nodes of each channel, mm.
    pub fn axes(&self) -> impl Iterator<Item = &[f64]> {
        self.grid.axes()
    }

    /// Mode weights (n_1·…·n_C, m) at the nodes.
    pub fn coefficients(&self) -> &[f64] {
        &self.coefficients
    }

    /// The mean (M,).
    pub fn mean(&self) -> &[f64] {
        self.modes.mean()
    }

    /// The modes (m, M).
    pub fn modes(&self) -> &[f64] {
        self.modes.rows()
    }

    /// Whether another table has this grid and these modes, and neither has a mean.
    pub fn shares(&self, other: &Table) -> bool {
        let alike = self.grid == other.grid && self.modes.are(&other.modes);
        alike && self.mean().iter().all(|m| *m == 0.0)
    }

    /// The grid.
    pub fn grid(&self) -> &Grid {
        &self.grid
    }

    /// The outputs (M,) for a stencil of the command.
    pub fn eval_at(&self, carry: &Carry, out: &mut [f64]) {
        wide(
            #[inline(always)]
            || {
                self.modes.eval(
                    out,
                    #[inline(always)]
                    |weights| carry.blend(&self.coefficients, 1.0, weights),
                )
            },
        );
    }

    /// Number of modes m.
    pub fn count(&self) -> usize {
        self.modes.count()
    }

    /// The same family seen through a linear map: `shape(u)·weights + offset`, `weights` (M, M2),
    /// `offset` (M2,).
    pub fn project(&self, weights: &[f64], offset: &[f64]) -> Result<Table> {
        Ok(Table {
            modes: self.modes.project(weights, offset)?,
            ..self.clone()
        })
    }

    /// The same family with its outputs in place of modes: cheaper if they are fewer.
    pub fn plain(&self) -> Result<Table> {
        let (size, count) = (self.size(), self.count());
        let mut values = zeros("a table (nodes, outputs)", &[self.grid.nodes(), size])?;
        wide(
            #[inline(always)]
            || {
                for (node, out) in values.chunks_exact_mut(size).enumerate() {
                    let row = &self.coefficients[node * count..(node + 1) * count];
                    out.copy_from_slice(self.modes.mean());
                    self.modes.expand(row, out);
                }
            },
        );
        Ok(Table {
            grid: self.grid.clone(),
            coefficients: values.into(),
            modes: Modes::plain(size)?,
        })
    }

    /// A table of `map` (`size` numbers) of each node's command and shape; exact between nodes for
    /// a linear map.
    pub fn mapped(
        &self,
        size: usize,
        mut map: impl FnMut(&[f64], &[f64], &mut [f64]),
    ) -> Result<Table> {
        let (mut shape, mut values) = (vec![0.0; self.size()], vec![0.0; self.grid.nodes() * size]);
        for (node, out) in values.chunks_exact_mut(size.max(1)).enumerate() {
            let row = &self.coefficients[node * self.count()..(node + 1) * self.count()];
            let u = self.grid.node(node);
            if self.modes.is_bare() {
                map(&u, row, out);
            } else {
                self.modes
                    .eval(&mut shape, |weights| accumulate(weights, row, 1.0));
                map(&u, &shape, out);
            }
        }
        Ok(Table {
            grid: self.grid.clone(),
            coefficients: values.into(),
            modes: Modes::plain(size)?,
        })
    }
}

/// Tables without means on one grid with one set of modes; their weighted sum expands the modes
/// once.
#[derive(Debug, Clone)]
pub struct TableSum {
    tables: Vec<Table>,
}

impl TableSum {
    /// Put `tables` side by side; None if their grids or modes differ, or if they have a mean.
    pub fn new(tables: &[&Table]) -> Option<TableSum> {
        let first = *tables.first()?;
        let alike = tables.iter().all(|t| first.shares(t));
        let count = first.count();
        (alike && count > 0 && count <= STACK_MODES).then(|| TableSum {
            tables: tables.iter().copied().cloned().collect(),
        })
    }

    /// Σ_t w_t·table_t as one table.
    pub fn sum(&self, weights: &[f64]) -> Table {
        let first = &self.tables[0];
        let mut sum = vec![0.0; first.coefficients.len()];
        for (table, weight) in self.tables.iter().zip(weights) {
            if *weight != 0.0 {
                accumulate(&mut sum, &table.coefficients, *weight);
            }
        }
        Table {
            coefficients: sum.into(),
            ..first.clone()
        }
    }

    /// The grid of all.
    pub fn grid(&self) -> &Grid {
        &self.tables[0].grid
    }

    /// Add Σ_t w_t·table_t to `out` (M,) for a stencil of the command, w in the order of the
    /// tables.
    pub fn add(&self, carry: &Carry, weights: impl Iterator<Item = f64>, out: &mut [f64]) {
        let shared = &self.tables[0];
        let mut sum = [0.0; STACK_MODES];
        let (sum, plain) = (&mut sum[..shared.count()], shared.modes.is_plain());
        wide(
            #[inline(always)]
            || {
                // Plain loops: the closures of iterators would be compiled for narrow vectors.
                for (table, weight) in self.tables.iter().zip(weights) {
                    if weight != 0.0 {
                        let sum = if plain { &mut *out } else { &mut *sum };
                        carry.blend(&table.coefficients, weight, sum);
                    }
                }
                if !plain {
                    shared.modes.expand(sum, out);
                }
            },
        );
    }
}

impl Shape for Table {
    fn table(&self) -> Option<&Table> {
        Some(self)
    }

    fn channels(&self) -> usize {
        self.grid.channels()
    }

    fn size(&self) -> usize {
        self.modes.size()
    }

    fn eval(&self, u: &[f64], out: &mut [f64]) {
        let stencils = self.grid.stencils(u, None);
        self.eval_at(&Carry::new(&self.grid, &stencils), out);
    }

    fn jacobian(&self, u: &[f64], out: &mut [f64]) {
        self.modes.jacobian(self.channels(), out, |c, weights| {
            let carry = Carry::new(&self.grid, &self.grid.stencils(u, Some(c)));
            carry.blend(&self.coefficients, 1.0, weights);
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn tabulate(axes: &[Vec<f64>], f: impl Fn(&[f64]) -> f64) -> Table {
        let mut nodes = vec![vec![]];
        for axis in axes {
            nodes = nodes
                .into_iter()
                .flat_map(|node: Vec<f64>| {
                    axis.iter().map(move |x| [node.clone(), vec![*x]].concat())
                })
                .collect();
        }
        let values = nodes.iter().map(|node| f(node)).collect();
        Table::new(axes.to_vec(), values, vec![0.0], vec![1.0]).unwrap()
    }

    fn value(table: &Table, u: &[f64]) -> f64 {
        let mut out = [0.0];
        table.eval(u, &mut out);
        out[0]
    }

    proptest! {
        #[test]
        fn quadratics_are_exact_on_uneven_axes(x in -4.0..5.0f64, y in -1.0..2.0f64, z in 0.0..3.0f64) {
            let axes = [vec![-4.0, -2.5, 0.0, 0.7, 5.0], vec![-1.0, 0.5, 2.0], vec![0.0, 1.0, 3.0]];
            let f = |u: &[f64]| (1.0 + u[0] * u[0]) * (2.0 - u[1] * u[1] + u[1]) + u[0] * u[2] * (u[2] - 1.0);
            let table = tabulate(&axes, f);
            prop_assert!((value(&table, &[x, y, z]) - f(&[x, y, z])).abs() < 1e-10);
        }

        #[test]
        fn slopes_match_differences_inside_and_outside(x in -9.0..9.0f64, y in -9.0..9.0f64) {
            let axes = [vec![-6.0, -2.0, 0.0, 3.0, 6.0], vec![-5.0, 0.0, 5.0]];
            let table = tabulate(&axes, |u| (0.3 * u[0]).sin() * (0.2 * u[1]).cos());
            let mut slopes = [0.0; 2];
            table.jacobian(&[x, y], &mut slopes);
            let h = 1e-5;
            for (c, step) in [[h, 0.0], [0.0, h]].iter().enumerate() {
                let difference = (value(&table, &[x + step[0], y + step[1]])
                    - value(&table, &[x - step[0], y - step[1]])) / (2.0 * h);
                // A difference across a node sees the jump of the second derivative: h times about
                // 0.1.
                prop_assert!((difference - slopes[c]).abs() < 1e-5);
            }
        }
    }

    #[test]
    fn outside_the_grid_the_border_continues_linearly() {
        let table = tabulate(&[vec![-3.0, -1.0, 0.0, 2.0]], |u| u[0] * u[0]);
        assert!((value(&table, &[5.0]) - (4.0 + 4.0 * 3.0)).abs() < 1e-12);
        assert!((value(&table, &[-4.0]) - (9.0 + 6.0)).abs() < 1e-12);
    }

    #[test]
    fn error_falls_with_the_third_power_of_the_spacing() {
        let worst = |n: usize| {
            let axis: Vec<f64> = (0..=n).map(|i| 4.0 * i as f64 / n as f64).collect();
            let table = tabulate(&[axis], |u| u[0].sin());
            (0..997)
                .map(|i| i as f64 * 4.0 / 996.0)
                .fold(0.0, |w: f64, x| {
                    w.max((value(&table, &[x]) - x.sin()).abs())
                })
        };
        let order = (worst(20) / worst(40)).log2();
        assert!((2.7..4.3).contains(&order), "order {order}");
    }

    #[test]
    fn a_projected_table_is_the_projection_of_the_table() {
        let axes = vec![vec![0.0, 1.0, 2.0]];
        let table = Table::new(
            axes,
            vec![1.0, 2.0, 0.0, 1.0, 4.0, -1.0],
            vec![1.0, 2.0],
            vec![1.0, 0.0, 0.5, 2.0],
        )
        .unwrap();
        let weights = [1.0, 2.0, 3.0, -1.0, 0.0, 1.0];
        let seen = table.project(&weights, &[10.0, 20.0, 30.0]).unwrap();
        let (mut full, mut small) = ([0.0; 2], [0.0; 3]);
        table.eval(&[1.3], &mut full);
        seen.eval(&[1.3], &mut small);
        for j in 0..3 {
            let wanted = full[0] * weights[j] + full[1] * weights[3 + j] + 10.0 * (j + 1) as f64;
            assert!((small[j] - wanted).abs() < 1e-12);
        }
    }

    #[test]
    fn a_constant_family_and_bad_tables() {
        let constant = Table::new(vec![], vec![2.0], vec![1.0], vec![3.0]).unwrap();
        assert_eq!(value(&constant, &[]), 7.0);
        assert!(Table::new(vec![vec![0.0, 0.0]], vec![1.0; 2], vec![0.0], vec![1.0]).is_err());
        assert!(Table::new(vec![vec![0.0, 1.0]], vec![1.0; 3], vec![0.0], vec![1.0]).is_err());
        assert!(
            Table::new(
                vec![vec![0.0, 1.0]],
                vec![f64::NAN; 2],
                vec![0.0],
                vec![1.0]
            )
            .is_err()
        );
        assert!(Table::new(vec![vec![0.0, 1.0]; 4], vec![1.0; 16], vec![0.0], vec![1.0]).is_err());
    }
}
