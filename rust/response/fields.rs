//! The fields of a prior: displacements per load and cable tension, and their weighted sum at a
//! command.
//!
//! Fields of one sweep share their grid and their modes. Their mode weights are blended together,
//! Σ_f w_f·a_fm(u), and the modes expanded once: a sum of seven fields then costs as much as one or
//! two. Other fields (a rod's, those of large loads) are added one by one.

use crate::shape::Shape;
use crate::shape::grid::Nodes;
use crate::shape::modes::{Modes, STACK_MODES, wide};
use crate::shape::table::{Table, TableSum};
use std::sync::Arc;

/// Fields in a fixed order; some may be absent.
pub struct Fields {
    members: Vec<Option<Arc<dyn Shape>>>,
    /// Tables that share grid and modes with the first one, side by side, with their indices;
    /// constant ones, as modes; then all others.
    together: Option<TableSum>,
    alike: Vec<usize>,
    constant: Option<Modes>,
    still: Vec<usize>,
    others: Vec<usize>,
}

impl Fields {
    /// From fields in order.
    pub fn new(members: Vec<Option<Arc<dyn Shape>>>) -> Fields {
        let there = |f: &usize| members[*f].is_some();
        let there: Vec<usize> = (0..members.len()).filter(there).collect();
        let table = |f: usize| members[f].as_ref().and_then(|field| field.table());
        let (mut still, mut rows) = (vec![], vec![]);
        for (f, table) in there.iter().filter_map(|f| Some((*f, table(*f)?))) {
            if table.channels() == 0 {
                let mut row = vec![0.0; table.size()];
                table.eval(&[], &mut row);
                rows.extend(row);
                still.push(f);
            }
        }
        let size = still
            .first()
            .and_then(|f| members[*f].as_ref())
            .map(|field| field.size());
        let constant = size.and_then(|size| Modes::new(vec![0.0; size], rows).ok());
        let moving = || there.iter().filter(|f| !still.contains(*f));
        let first = moving().next().and_then(|f| table(*f));
        let alike: Vec<(usize, &Table)> = moving()
            .filter_map(|f| Some((*f, table(*f)?)))
            .filter(|(_, table)| first.is_some_and(|first| first.shares(table)))
            .collect();
        let together = TableSum::new(&alike.iter().map(|(_, t)| *t).collect::<Vec<_>>());
        let alike: Vec<usize> = alike.iter().map(|(f, _)| *f).collect();
        let apart = |f: &usize| !still.contains(f) && (together.is_none() || !alike.contains(f));
        let others = there.iter().copied().filter(apart).collect();
        Fields {
            alike,
            constant,
            still,
            others,
            together,
            members,
        }
    }

    /// The same fields with one number of the body multiplied; a field without this number does not
    /// change.
    pub fn with_number(&self, name: &str, factor: f64) -> Fields {
        let changed = |field: &Arc<dyn Shape>| {
            let other = field.with_number(name, factor);
            other.unwrap_or_else(|| field.clone())
        };
        let members = self.members.iter();
        Fields::new(members.map(|field| field.as_ref().map(changed)).collect())
    }

    /// Few fields, each a weighted sum of the first ones, then the others; None if one of them is
    /// outside the shared grid.
    pub fn under(&self, loads: &[&[f64]]) -> Option<Fields> {
        let sum = |loads: &&[f64]| {
            let outside = |f: usize| loads[f] != 0.0 && !self.alike.contains(&f);
            if (0..loads.len()).any(outside) {
                return None;
            }
            let weight = |f: &usize| loads.get(*f).copied().unwrap_or(0.0);
            let weights: Vec<f64> = self.alike.iter().map(weight).collect();
            Some(Arc::new(self.together.as_ref()?.sum(&weights)) as Arc<dyn Shape>)
        };
        let mut members: Vec<_> = loads
            .iter()
            .map(|one| sum(one).map(Some))
            .collect::<Option<_>>()?;
        let many = loads.first().map_or(0, |one| one.len());
        members.extend(self.members[many..].iter().cloned());
        Some(Fields::new(members))
    }

    /// Number of fields, including absent ones.
    pub fn count(&self) -> usize {
        self.members.len()
    }

    /// All of them in order.
    pub fn members(&self) -> &[Option<Arc<dyn Shape>>] {
        &self.members
    }

    /// One field, if it exists.
    pub fn get(&self, field: usize) -> Option<&dyn Shape> {
        self.members[field].as_deref()
    }

    /// Add Σ w_f·field_f(u) to `frame` (M,); `scratch` (M,) is overwritten.
    pub fn add(
        &self,
        u: &[f64],
        nodes: &mut Nodes,
        weights: &[f64],
        scratch: &mut [f64],
        frame: &mut [f64],
    ) {
        if weights.iter().all(|w| *w == 0.0) {
            return;
        }
        if let Some(sum) = &self.together {
            let own = self.alike.iter().map(|f| weights[*f]);
            sum.add(nodes.of(sum.grid(), u), own, frame);
        }
        self.add_still(weights, frame);
        for f in &self.others {
            if let (Some(field), true) = (&self.members[*f], weights[*f] != 0.0) {
                field.eval(u, scratch);
                frame
                    .iter_mut()
                    .zip(scratch.iter())
                    .for_each(|(sum, value)| *sum += weights[*f] * value);
            }
        }
    }

    /// Add Σ w_f·field_f to `frame` (M,), over the constant fields.
    fn add_still(&self, weights: &[f64], frame: &mut [f64]) {
        if let Some(modes) = &self.constant {
            let (mut few, mut many) = ([0.0; STACK_MODES], vec![]);
            let own = if self.still.len() <= STACK_MODES {
                &mut few[..self.still.len()]
            } else {
                many.resize(self.still.len(), 0.0);
                &mut many[..]
            };
            let pairs = own.iter_mut().zip(&self.still);
            pairs.for_each(|(own, f)| *own = weights[*f]);
            if own.iter().all(|weight| *weight == 0.0) {
                return;
            }
            wide(
                #[inline(always)]
                || modes.expand(own, frame),
            );
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn table(coefficients: [f64; 6], mode: f64) -> Arc<dyn Shape> {
        let modes = vec![mode, 0.0, 1.0, 0.0, 2.0, 0.0];
        let axes = vec![vec![-1.0, 0.0, 2.0]];
        Arc::new(Table::new(axes, coefficients.to_vec(), vec![0.0; 3], modes).unwrap())
    }

    fn sum(fields: &Fields, weights: &[f64]) -> Vec<f64> {
        let (mut scratch, mut frame) = (vec![0.0; 3], vec![5.0; 3]);
        let nodes = &mut Nodes::default();
        fields.add(&[0.7], nodes, weights, &mut scratch, &mut frame);
        frame
    }

    #[test]
    fn fields_of_one_sweep_are_summed_together_as_one_by_one_and_absent_ones_are_left_out() {
        let one = table([1.0, 2.0, -1.0, 0.5, 3.0, 1.0], 1.0);
        let two = table([0.0, 1.0, 4.0, 2.0, -1.0, 1.5], 1.0);
        let other = table([0.0, 1.0, 4.0, 2.0, -1.0, 1.5], 1.5);
        let together = Fields::new(vec![Some(one.clone()), Some(two.clone())]);
        let mut apart = Fields::new(vec![Some(one.clone()), None, Some(two)]);
        assert!(together.together.is_some() && apart.together.is_some());
        assert_eq!(Fields::new(vec![Some(one), Some(other)]).others, [1]);
        let steady = |v: f64| -> Arc<dyn Shape> {
            Arc::new(Table::new(vec![], vec![v], vec![0.0; 3], vec![1.0, 0.5, -2.0]).unwrap())
        };
        let alone = Fields::new(vec![Some(steady(1.0)), Some(steady(3.0))]);
        assert_eq!(sum(&alone, &[2.0, 1.0]), [10.0, 7.5, -5.0]);
        for summed in [true, false] {
            if !summed {
                (apart.together, apart.others) = (None, apart.alike.clone());
            }
            for weights in [[0.0, 0.0], [2.0, 0.0], [0.3, -1.5]] {
                let (a, b) = (
                    sum(&together, &weights),
                    sum(&apart, &[weights[0], 7.0, weights[1]]),
                );
                // Round-off of a sum in another order.
                assert!(
                    a.iter().zip(&b).all(|(a, b)| (a - b).abs() < 1e-13),
                    "{a:?} {b:?}"
                );
            }
        }
    }
}
