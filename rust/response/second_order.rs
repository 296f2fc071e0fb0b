//! Second-order terms: the response to large loads and large changes of the modulus beyond fields
//! and cable stretches.
//!
//! Positions x and cable lengths L are smooth functions of λ: the dead loads c (g, N), the changes
//! p of the logarithm of the modulus (`stiff_0 … stiff_6`, `stiff_x|y`), and the changes ΔT of the
//! tensions (N). With their second derivatives x_kl, L_kl (`fem/bend.rs`), the terms beyond the
//! fields are δx = ½ f Σ λ_k λ_l x_kl, δL = ½ f Σ λ_k λ_l L_kl, f = 1/(1 − ½ Σ g_k λ_k), g_k the
//! relative growth of the responses to loads per unit of λ_k. Weight hanging on a body stiffens it,
//! and the terms of its series decrease about like powers, so f represents all terms after the
//! second (Padé). λ uses for ΔT the response of the cables to c and p with the fields alone, which
//! is correct to second order; δL is then added to their stretch (`cables.rs`). x_kl is represented
//! by a few modes, each a field. Pairs among loads and tensions are in one table, those with a
//! modulus in another, which costs nothing for an unchanged modulus; a body may lack it, and then
//! responds linearly to its modulus. On the built-in finger, the error for 60 g is 8 % of the
//! motion, and 10 to 20 % and more without these terms; for a section half as stiff it is 9 to 18
//! %, and 25 to 60 % and more without (tests/model/test_second_level.py). Limits: curvature at
//! rest, twist, routing and pushes stay linear.

use crate::error::{Result, invalid};
use crate::response::loads::{LOADS, MODULI};
use crate::shape::Shape;
use crate::shape::grid::{Grid, Nodes};
use crate::shape::modes::{Modes, accumulate};
use crate::shape::table::Table;
use std::sync::Arc;

#[path = "second_order_part.rs"]
mod part;
use part::Part;

/// Most responding tendons.
pub const MOST_TENDONS: usize = 64;
/// Least and greatest ½ Σ g_k λ_k: beyond, the second order is not valid.
const GROWTH: (f64, f64) = (-0.9, 0.3);

/// Second derivatives of a prior by loads, moduli and tensions, over a grid of commands.
#[derive(Clone)]
pub struct Second {
    grid: Grid,
    /// Pairs of loads and tensions, then those with a modulus.
    parts: [Part; 2],
    tendons: usize,
    modes: Modes,
    /// Number of loads and of moduli that are causes.
    loads: usize,
    moduli: usize,
}

impl Second {
    /// `numbers` (nodes, P·(m + n) + LOADS + n) over the grid of `axes`, for n responding `tendons`
    /// (0: none), `moduli` (nodes, Q·(m + n) + MODULI) of the pairs with a modulus, or nothing, and
    /// `modes` (m, M).
    pub fn new(
        axes: Vec<Vec<f64>>,
        numbers: Vec<f64>,
        moduli: Vec<f64>,
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
        let all = numbers.iter().chain(&moduli).chain(&modes);
        if all.into_iter().any(|value| !value.is_finite()) {
            return Err(invalid(
                "the second level of loads holds a number that is not finite; build the model \
                again",
            ));
        }
        let count = if moduli.is_empty() { 0 } else { MODULI };
        let mut second = Second {
            grid,
            parts: Part::both(LOADS, count, tendons),
            tendons,
            modes: Modes::new(vec![0.0; size], modes)?,
            loads: LOADS,
            moduli: count,
        };
        let (block, nodes) = (second.block(), second.grid.nodes());
        for (part, numbers) in second.parts.iter_mut().zip([numbers, moduli]) {
            let wanted = part.size(block);
            if Some(numbers.len()) != wanted.checked_mul(nodes) {
                return Err(invalid(format!(
                    "the second level of loads of {nodes} nodes, {tendons} tendons and {} modes \
                    needs {wanted} numbers a node, got {} in all",
                    block - tendons,
                    numbers.len()
                )));
            }
            part.numbers = numbers;
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

    /// Number of its loads and moduli.
    pub fn known(&self) -> usize {
        self.loads + self.moduli
    }

    /// The same under a single load, the combination `amount` (loads + moduli,) of its own, and
    /// likewise a single change of the modulus, if any.
    pub fn under(&self, amount: &[f64]) -> Second {
        let moduli = usize::from(amount[self.loads..].iter().any(|p| *p != 0.0));
        let plan = Part::both(1, moduli, self.tendons);
        let mut parts = plan.clone();
        let (block, few) = (self.block(), 1 + moduli);
        // The combined cause of each cause, and its amount.
        let becomes = |k: usize| match k.checked_sub(self.known()) {
            Some(tendon) => (few + tendon, 1.0),
            None => (usize::from(k >= self.loads), amount[k]),
        };
        let sizes = parts.each_ref().map(|part| part.size(block));
        for (part, size) in parts.iter_mut().zip(sizes) {
            part.numbers = vec![0.0; self.grid.nodes() * size];
        }
        for part in &self.parts {
            let many = part.size(block).max(1);
            let mut add = |to: (usize, usize), from: usize, width: usize, times: f64| {
                let (which, start) = to;
                let rows = parts[which].numbers.chunks_exact_mut(sizes[which].max(1));
                for (row, out) in part.numbers.chunks_exact(many).zip(rows) {
                    accumulate(
                        &mut out[start..start + width],
                        &row[from..from + width],
                        times,
                    );
                }
            };
            let place = |sought: (usize, usize)| {
                let turned = (sought.1, sought.0);
                let found =
                    |part: &Part| part.pairs.iter().position(|p| *p == sought || *p == turned);
                plan.iter()
                    .map(found)
                    .enumerate()
                    .find_map(|(w, p)| Some((w, p? * block)))
            };
            for (p, (k, l)) in part.pairs.iter().enumerate() {
                let ((a, x), (b, y)) = (becomes(*k), becomes(*l));
                // For two causes combined into one, both orders count.
                let orders = if a == b && k != l { 2.0 } else { 1.0 };
                if let (Some(to), true) = (place((a, b)), x * y != 0.0) {
                    add(to, p * block, block, orders * x * y);
                }
            }
            for (i, k) in part.own.iter().enumerate() {
                let (a, x) = becomes(*k);
                let found = |part: &Part| {
                    Some(part.pairs.len() * block + part.own.iter().position(|o| *o == a)?)
                };
                let to = plan
                    .iter()
                    .map(found)
                    .enumerate()
                    .find_map(|(w, p)| Some((w, p?)));
                if let (Some(to), true) = (to, x != 0.0) {
                    add(to, part.pairs.len() * block + i, 1, x);
                }
            }
        }
        Second {
            parts,
            loads: 1,
            moduli,
            ..self.clone()
        }
    }

    /// Number of commands.
    pub fn channels(&self) -> usize {
        self.grid.channels()
    }

    /// Number of outputs M.
    pub fn outputs(&self) -> usize {
        self.modes.size()
    }

    /// Number of responding tendons n.
    pub fn tendons(&self) -> usize {
        self.tendons
    }

    /// Number of modes m.
    pub fn count(&self) -> usize {
        self.modes.count()
    }

    /// The modes, as constant fields.
    pub fn fields(&self) -> Result<Vec<Arc<dyn Shape>>> {
        let size = self.outputs();
        let constant = |mode: &[f64]| {
            let table = Table::new(vec![], vec![1.0], vec![0.0; size], mode.to_vec())?;
            Ok(Arc::new(table) as Arc<dyn Shape>)
        };
        self.modes.rows().chunks_exact(size).map(constant).collect()
    }

    fn block(&self) -> usize {
        self.modes.count() + self.tendons
    }

    /// Number of values that `at` writes.
    pub fn size(&self) -> usize {
        self.parts.iter().map(|part| part.size(self.block())).sum()
    }

    /// The values at a command, only for pairs with loads and moduli in `there`; without a modulus,
    /// the second part of `out` is unchanged.
    pub fn at(&self, u: &[f64], nodes: &mut Nodes, there: &[bool], out: &mut [f64]) {
        let carry = nodes.of(&self.grid, u);
        let acts = |cause: usize| cause >= self.known() || there[cause];
        let [plain, with] = &self.parts;
        let (first, second) = out.split_at_mut(plain.size(self.block()));
        plain.at(self.block(), carry, acts, first);
        if there[self.loads..self.known()].contains(&true) {
            with.at(self.block(), carry, acts, second);
        }
    }

    /// Add the second-order terms of λ (loads, moduli, then tension changes) for the values of
    /// `at`: the weights (m,) of the modes, and the stretch (mm) of each cable (n,).
    pub fn beyond(&self, here: &[f64], amount: &[f64], weights: &mut [f64], stretch: &mut [f64]) {
        let [plain, with] = &self.parts;
        let (first, second) = here.split_at(plain.size(self.block()));
        let acts = amount[self.loads..self.known()].iter().any(|p| *p != 0.0);
        let parts = [(plain, first), (with, second)];
        let parts = &parts[..if acts { 2 } else { 1 }];
        let factor = factor(parts.iter().flat_map(|(part, here)| {
            let growth = &here[here.len() - part.own.len()..];
            growth.iter().zip(&part.own).map(|(g, k)| g * amount[*k])
        }));
        for (part, here) in parts {
            let rows = here.chunks_exact(self.block().max(1));
            for ((k, l), row) in part.pairs.iter().zip(rows) {
                let share = factor * amount[*k] * amount[*l] * if k == l { 0.5 } else { 1.0 };
                if share != 0.0 {
                    let (moved, longer) = row.split_at(self.modes.count());
                    accumulate(weights, moved, share);
                    accumulate(stretch, longer, share);
                }
            }
        }
    }
}

/// f, from all g_k λ_k.
fn factor(grown: impl Iterator<Item = f64>) -> f64 {
    let sum: f64 = grown.sum();
    1.0 / (1.0 - (0.5 * sum).clamp(GROWTH.0, GROWTH.1))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Number of causes with one tendon.
    const ALL: usize = LOADS + MODULI + 1;

    /// One tendon, one mode; x_kl = 1 + k + l, L_kl = −k·l, along one axis twice that at its far
    /// end.
    fn second(growth: f64, moduli: bool) -> Second {
        let count = if moduli { MODULI } else { 0 };
        let [plain, with] = Part::both(LOADS, count, 1);
        let node = |part: &Part, scale: f64| {
            let pairs = part.pairs.iter();
            let both =
                pairs.flat_map(move |(k, l)| [scale * (1 + k + l) as f64, -scale * (k * l) as f64]);
            both.chain(vec![growth; part.own.len()]).collect::<Vec<_>>()
        };
        let nodes = |part: &Part| [node(part, 1.0), node(part, 2.0)].concat();
        let axes = vec![vec![0.0, 1.0]];
        let further = if moduli { nodes(&with) } else { vec![] };
        Second::new(axes, nodes(&plain), further, 1, vec![1.0, -2.0], 2).unwrap()
    }

    #[test]
    fn amounts_add_their_quadratic_form_times_what_follows_it() {
        let (mut loaded, mut softer) = ([0.0; ALL], [0.0; ALL]);
        (loaded[1], loaded[4], loaded[ALL - 1]) = (0.5, 0.2, -0.3);
        (softer[LOADS + 2], softer[LOADS + 3], softer[ALL - 1]) = (0.4, -0.1, 0.1);
        let mut both = softer;
        (both[1], both[4]) = (0.3, -0.3);
        // Growth 0.8 and amounts that sum to 0.4: f = 1/(1 − 0.16). At 0.5 all second derivatives
        // are 1.5 times as large.
        for (amount, growth, f) in [
            (loaded, 0.0, 1.0),
            (loaded, 0.8, 1.0 / 0.84),
            (softer, 0.0, 1.0),
            (softer, 0.8, 1.0 / 0.84),
            (both, 0.8, 1.0 / 0.84),
        ] {
            let form = |of: fn(usize, usize) -> f64| -> f64 {
                let all = (0..ALL).flat_map(|k| (0..ALL).map(move |l| (k, l)));
                all.map(|(k, l)| 0.5 * amount[k] * amount[l] * of(k, l))
                    .sum()
            };
            let there: [bool; LOADS + MODULI] = std::array::from_fn(|k| amount[k] != 0.0);
            let second = second(growth, true);
            let (mut here, mut weights) = (vec![7.0; second.size()], [0.0]);
            second.at(&[0.5], &mut Nodes::default(), &there, &mut here);
            let mut stretch = [0.0];
            second.beyond(&here, &amount, &mut weights, &mut stretch);
            let moved = 1.5 * f * form(|k, l| (1 + k + l) as f64);
            let longer = 1.5 * f * form(|k, l| -((k * l) as f64));
            assert!((weights[0] - moved).abs() < 1e-12 && (stretch[0] - longer).abs() < 1e-12);
            assert!(moved.abs() > 0.01 && longer.abs() > 0.01);
            let one = second.under(&amount[..LOADS + MODULI]);
            let (mut here, mut again, mut stretched) = (vec![0.0; one.size()], [0.0], [0.0]);
            one.at(
                &[0.5],
                &mut Nodes::default(),
                &[true; 2][..one.known()],
                &mut here,
            );
            let few = [&[1.0; 2][..one.known()], &[amount[ALL - 1]]].concat();
            one.beyond(&here, &few, &mut again, &mut stretched);
            assert!((again[0] - moved).abs() < 1e-12 && (stretched[0] - longer).abs() < 1e-12);
        }
    }

    #[test]
    fn modes_are_fields_seen_through_a_map_and_sizes_that_do_not_fit_are_refused() {
        let seen = second(0.0, false)
            .project(&[1.0, 0.0, 1.0, 0.5, 0.0, 1.0], 3)
            .unwrap();
        let mut out = [0.0; 3];
        seen.fields().unwrap()[0].eval(&[0.3], &mut out);
        assert_eq!(out, [0.0, 0.0, -1.0]);
        assert_eq!(
            (seen.known(), second(0.0, true).known()),
            (LOADS, LOADS + MODULI)
        );
        let new = |numbers: usize, moduli: usize, tendons: usize| {
            let axes = vec![vec![0.0, 1.0]];
            Second::new(
                axes,
                vec![0.0; numbers],
                vec![0.0; moduli],
                tendons,
                vec![1.0, -2.0],
                2,
            )
        };
        // Seven causes and nine moduli, of which 28 and 63 + 45 pairs of two numbers each.
        assert!(new(2 * 63, 0, 1).is_ok() && new(2 * 63, 2 * 225, 1).is_ok());
        assert!(
            new(2 * 63 - 1, 0, 1).is_err()
                && new(2 * 63, 2 * 225 - 1, 1).is_err()
                && new(2 * 63, 0, 2).is_err()
                && new(2, 0, usize::MAX).is_err()
        );
        let one = |numbers: f64, moduli: f64| {
            let moduli = vec![moduli; 99 + 9];
            Second::new(vec![], vec![numbers; 27], moduli, 0, vec![1.0], 1)
        };
        assert!(
            one(0.0, 0.0).is_ok() && one(f64::NAN, 0.0).is_err() && one(0.0, f64::NAN).is_err()
        );
    }
}
