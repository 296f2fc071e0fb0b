//! The second level of loads: what a large one does beyond its field, and beyond the stretch of the cables that goes with it.
//!
//! Places x and cable lengths L are functions without kinks of λ, the dead loads c (g, N) and the changes ΔT of the tensions
//! (N). With their second derivatives x_kl, L_kl (`fem/bend.rs`), beyond the fields come
//!   δx = ½ f Σ λ_k λ_l x_kl,   δL = ½ f Σ λ_k λ_l L_kl,   f = 1/(1 − ½ Σ g_k λ_k),
//! g_k the share by which the answers grow for a unit of λ_k: weight that hangs on a body stiffens it, and the terms of its
//! series fall about as powers do, so that f stands for all that follow the second (Padé). λ takes for ΔT what the cables
//! answer to c with the fields alone, which is right to second order; δL then joins their stretch (`cables.rs`), whatever
//! else they answer. What x_kl makes of a body are a few modes, each a field of its own.
//! On the built-in finger 60 g are right to 7 % of what they move, 12 to 26 % without (tests/test_second_level.py).
//! Limits: changes of design, and pushes, stay linear beside it.

use crate::error::{Result, invalid};
use crate::grid::{Grid, Nodes};
use crate::loads::LOADS;
use crate::modes::{Modes, accumulate, wide};
use crate::shape::Shape;
use crate::table::Table;
use std::ops::Range;
use std::sync::Arc;

/// The most tendons that can answer.
pub const MOST_TENDONS: usize = 64;
/// Least and greatest of ½ Σ g_k λ_k: beyond, loads are not in the reach of a second order.
const GROWTH: (f64, f64) = (-0.9, 0.3);

/// Second derivatives of a prior by loads and tensions, over a grid of commands.
#[derive(Clone)]
pub struct Second {
    grid: Grid,
    /// For each node: of every pair its mode weights (m,), then its stretch (n,) mm; then g_k of every cause.
    numbers: Vec<f64>,
    tendons: usize,
    modes: Modes,
    /// Number of loads that are causes.
    loads: usize,
}

/// The pairs k ≤ l of `causes`, row by row.
fn pairs(causes: usize) -> impl Iterator<Item = (usize, usize)> {
    (0..causes).flat_map(move |k| (k..causes).map(move |l| (k, l)))
}

impl Second {
    /// `numbers` (nodes, P·(m + n) + LOADS + n) over the grid of `axes`, for `tendons` n that answer (0: none does), and
    /// `modes` (m, M).
    pub fn new(
        axes: Vec<Vec<f64>>,
        numbers: Vec<f64>,
        tendons: usize,
        modes: Vec<f64>,
        size: usize,
    ) -> Result<Second> {
        let grid = Grid::new(axes)?;
        if tendons > MOST_TENDONS {
            return Err(invalid(format!(
                "the second level of loads of {tendons} tendons; up to {MOST_TENDONS} are allowed"
            )));
        }
        if numbers.iter().chain(&modes).any(|value| !value.is_finite()) {
            return Err(invalid(
                "the second level of loads holds a number that is not finite; build the model again",
            ));
        }
        let second = Second {
            grid,
            numbers,
            tendons,
            modes: Modes::new(vec![0.0; size], modes)?,
            loads: LOADS,
        };
        let wanted = second.size().checked_mul(second.grid.nodes());
        if Some(second.numbers.len()) != wanted {
            return Err(invalid(format!(
                "the second level of loads of {} nodes, {tendons} tendons and {} modes needs {} numbers a node, got {} in all",
                second.grid.nodes(),
                second.modes.count(),
                second.size(),
                second.numbers.len()
            )));
        }
        Ok(second)
    }

    /// The same seen through a linear map: `weights` (M, M2).
    pub fn project(&self, weights: &[f64], size: usize) -> Result<Second> {
        Ok(Second {
            modes: self.modes.project(weights, &vec![0.0; size])?,
            ..self.clone()
        })
    }

    /// The same under a single load, which is `amount` (loads,) of its own.
    pub fn under(&self, amount: &[f64]) -> Second {
        let (block, size) = (self.block(), self.size());
        let mut one = Second {
            loads: 1,
            numbers: vec![],
            ..self.clone()
        };
        let (width, causes) = (one.size(), one.causes());
        // The cause that a cause of many becomes, and how much of it there is.
        let becomes = |k: usize| match k.checked_sub(self.loads) {
            Some(tendon) => (1 + tendon, 1.0),
            None => (0, amount[k]),
        };
        let place = |k: usize, l: usize| k * causes - k * (k + 1) / 2 + l;
        one.numbers = vec![0.0; self.grid.nodes() * width];
        let rows = self.numbers.chunks_exact(size);
        for (row, out) in rows.zip(one.numbers.chunks_exact_mut(width)) {
            for ((k, l), pair) in pairs(self.causes()).zip(row.chunks_exact(block.max(1))) {
                let ((a, x), (b, y)) = (becomes(k), becomes(l));
                // Of two loads that become one, both orders count.
                let orders = if a == b && k != l { 2.0 } else { 1.0 };
                if x * y != 0.0 {
                    let start = place(a, b) * block;
                    accumulate(&mut out[start..start + block], pair, orders * x * y);
                }
            }
            let growth = row[size - self.causes()..].iter().enumerate();
            for (k, g) in growth {
                let (a, x) = becomes(k);
                out[width - causes + a] += g * x;
            }
        }
        one
    }

    /// Number of commands.
    pub fn channels(&self) -> usize {
        self.grid.channels()
    }

    /// Number of outputs M.
    pub fn outputs(&self) -> usize {
        self.modes.size()
    }

    /// Number of tendons n that answer.
    pub fn tendons(&self) -> usize {
        self.tendons
    }

    /// Number of modes m.
    pub fn count(&self) -> usize {
        self.modes.count()
    }

    /// The modes, as fields that are alike at all commands.
    pub fn fields(&self) -> Result<Vec<Arc<dyn Shape>>> {
        let size = self.outputs();
        let constant = |mode: &[f64]| {
            let table = Table::new(vec![], vec![1.0], vec![0.0; size], mode.to_vec())?;
            Ok(Arc::new(table) as Arc<dyn Shape>)
        };
        self.modes.rows().chunks_exact(size).map(constant).collect()
    }

    fn causes(&self) -> usize {
        self.loads + self.tendons
    }

    fn block(&self) -> usize {
        self.modes.count() + self.tendons
    }

    /// Numbers that `at` writes.
    pub fn size(&self) -> usize {
        let causes = self.causes();
        causes * (causes + 1) / 2 * self.block() + causes
    }

    /// The numbers at a command, of those pairs only whose loads are `there`.
    pub fn at(&self, u: &[f64], nodes: &mut Nodes, there: &[bool], out: &mut [f64]) {
        let (block, size, causes) = (self.block(), self.size(), self.causes());
        let carry = nodes.of(&self.grid, u);
        let acts = |cause: usize| cause >= self.loads || there[cause];
        if (0..causes).all(acts) {
            out.fill(0.0);
            return wide(
                #[inline(always)]
                || carry.blend(&self.numbers, 1.0, out),
            );
        }
        out.fill(0.0);
        let mut wanted: Vec<Range<usize>> = vec![];
        for (p, (k, l)) in pairs(causes).enumerate() {
            match wanted.last_mut() {
                _ if !(acts(k) && acts(l)) => {}
                Some(range) if range.end == p * block => range.end += block,
                _ => wanted.push(p * block..(p + 1) * block),
            }
        }
        wide(
            #[inline(always)]
            || {
                for (node, share) in carry.nodes() {
                    let row = &self.numbers[node * size..(node + 1) * size];
                    for range in &wanted {
                        accumulate(&mut out[range.clone()], &row[range.clone()], *share);
                    }
                    accumulate(&mut out[size - causes..], &row[size - causes..], *share);
                }
            },
        );
    }

    /// What λ (loads, then changes of tension) does beyond its fields, at what `at` wrote: the weights (m,) of the modes, and
    /// how far (mm) each cable (n,) is stretched; both are added.
    pub fn beyond(&self, here: &[f64], amount: &[f64], weights: &mut [f64], stretch: &mut [f64]) {
        let causes = self.causes();
        let factor = factor(&here[here.len() - causes..], amount);
        for ((k, l), row) in pairs(causes).zip(here.chunks_exact(self.block().max(1))) {
            let share = factor * amount[k] * amount[l] * if k == l { 0.5 } else { 1.0 };
            if share != 0.0 {
                let (moved, longer) = row.split_at(self.modes.count());
                accumulate(weights, moved, share);
                accumulate(stretch, longer, share);
            }
        }
    }
}

/// f
fn factor(growth: &[f64], amount: &[f64]) -> f64 {
    let sum: f64 = growth.iter().zip(amount).map(|(g, a)| g * a).sum();
    1.0 / (1.0 - (0.5 * sum).clamp(GROWTH.0, GROWTH.1))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// One tendon, one mode; x_kl = 1 + k + l, L_kl = −k·l, along one axis twice that at its far end.
    fn second(growth: f64) -> Second {
        let causes = LOADS + 1;
        let node = |scale: f64| {
            let both = pairs(causes)
                .flat_map(move |(k, l)| [scale * (1 + k + l) as f64, -scale * (k * l) as f64]);
            both.chain(vec![growth; causes]).collect::<Vec<_>>()
        };
        let numbers = [node(1.0), node(2.0)].concat();
        Second::new(vec![vec![0.0, 1.0]], numbers, 1, vec![1.0, -2.0], 2).unwrap()
    }

    #[test]
    fn amounts_add_their_quadratic_form_times_what_follows_it() {
        let amount = [0.0, 0.5, 0.0, 0.0, 0.2, 0.0, -0.3];
        let there: [bool; LOADS] = std::array::from_fn(|k| amount[k] != 0.0);
        let form = |of: fn(usize, usize) -> f64| -> f64 {
            let all = (0..7).flat_map(|k| (0..7).map(move |l| (k, l)));
            all.map(|(k, l)| 0.5 * amount[k] * amount[l] * of(k, l))
                .sum()
        };
        // Growth 0.8 and amounts that sum to 0.4: f = 1/(1 − 0.16). At 0.5 all second derivatives are 1.5 times as large.
        for (growth, f) in [(0.0, 1.0), (0.8, 1.0 / 0.84)] {
            let second = second(growth);
            let (mut here, mut weights) = (vec![0.0; second.size()], [0.0]);
            second.at(&[0.5], &mut Nodes::default(), &there, &mut here);
            let mut stretch = [0.0];
            second.beyond(&here, &amount, &mut weights, &mut stretch);
            let moved = 1.5 * f * form(|k, l| (1 + k + l) as f64);
            let longer = 1.5 * f * form(|k, l| -((k * l) as f64));
            assert!((weights[0] - moved).abs() < 1e-12 && (stretch[0] - longer).abs() < 1e-12);
            assert!(moved.abs() > 0.01 && longer.abs() > 0.01);
            let one = second.under(&amount[..LOADS]);
            let (mut here, mut again, mut stretched) = (vec![0.0; one.size()], [0.0], [0.0]);
            one.at(&[0.5], &mut Nodes::default(), &[true], &mut here);
            one.beyond(&here, &[1.0, amount[LOADS]], &mut again, &mut stretched);
            assert!((again[0] - moved).abs() < 1e-12 && (stretched[0] - longer).abs() < 1e-12);
        }
    }

    #[test]
    fn modes_are_fields_seen_through_a_map_and_sizes_that_do_not_fit_are_refused() {
        let seen = second(0.0)
            .project(&[1.0, 0.0, 1.0, 0.5, 0.0, 1.0], 3)
            .unwrap();
        let mut out = [0.0; 3];
        seen.fields().unwrap()[0].eval(&[0.3], &mut out);
        assert_eq!(out, [0.0, 0.0, -1.0]);
        let new = |numbers: usize, tendons: usize| {
            let axes = vec![vec![0.0, 1.0]];
            Second::new(axes, vec![0.0; numbers], tendons, vec![1.0, -2.0], 2)
        };
        assert!(new(2 * 63, 1).is_ok());
        assert!(
            new(2 * 63 - 1, 1).is_err() && new(2 * 63, 2).is_err() && new(2, usize::MAX).is_err()
        );
        assert!(Second::new(vec![], vec![f64::NAN; 27], 0, vec![1.0], 1).is_err());
    }
}
