//! The fields of a prior: how far each load and each cable's tension moves the body, and their weighted sum at a command.
//!
//! Fields of one sweep share their grid and their modes. Their mode weights are blended together, Σ_f w_f·a_fm(u), and the
//! modes expanded once: a sum of seven fields then costs as much as one or two. Other fields (a rod's) are added one by one.

use crate::shape::Shape;
use crate::table::{Table, TableSum};
use std::sync::Arc;

/// Fields in a fixed order; some may be absent.
pub struct Fields {
    members: Vec<Option<Arc<dyn Shape>>>,
    /// Those that are there side by side, if all of them are tables that share grid and modes; and which they are.
    together: Option<TableSum>,
    there: Vec<usize>,
}

impl Fields {
    /// Take fields in order.
    pub fn new(members: Vec<Option<Arc<dyn Shape>>>) -> Fields {
        let there: Vec<usize> = (0..members.len())
            .filter(|f| members[*f].is_some())
            .collect();
        let together = Fields::together(&members);
        Fields {
            members,
            together,
            there,
        }
    }

    /// The same fields of a body of which one number is multiplied; a field that has no such number stays as it is.
    pub fn with_number(&self, name: &str, factor: f64) -> Fields {
        let changed = |field: &Arc<dyn Shape>| {
            let other = field.with_number(name, factor);
            other.unwrap_or_else(|| field.clone())
        };
        let members = self.members.iter();
        Fields::new(members.map(|field| field.as_ref().map(changed)).collect())
    }

    /// Number of fields, absent ones included.
    pub fn count(&self) -> usize {
        self.members.len()
    }

    /// One field, if it is there.
    pub fn get(&self, field: usize) -> Option<&dyn Shape> {
        self.members[field].as_deref()
    }

    /// Add Σ w_f·field_f(u) to `frame` (M,); `scratch` (M,) is overwritten.
    pub fn add(&self, u: &[f64], weights: &[f64], scratch: &mut [f64], frame: &mut [f64]) {
        if weights.iter().all(|w| *w == 0.0) {
            return;
        }
        if let Some(sum) = &self.together {
            let own: Vec<f64> = self.there.iter().map(|f| weights[*f]).collect();
            return sum.add(u, &own, frame);
        }
        for (field, weight) in self.members.iter().zip(weights) {
            if let (Some(field), true) = (field, *weight != 0.0) {
                field.eval(u, scratch);
                frame
                    .iter_mut()
                    .zip(scratch.iter())
                    .for_each(|(sum, value)| *sum += weight * value);
            }
        }
    }

    fn together(members: &[Option<Arc<dyn Shape>>]) -> Option<TableSum> {
        let tables: Option<Vec<&Table>> = members
            .iter()
            .flatten()
            .map(|field| field.table())
            .collect();
        TableSum::new(&tables?)
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
        fields.add(&[0.7], weights, &mut scratch, &mut frame);
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
        assert!(Fields::new(vec![Some(one), Some(other)]).together.is_none());
        for summed in [true, false] {
            apart.together = apart.together.filter(|_| summed);
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
