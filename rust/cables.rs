//! How cables answer a load that the prior was not solved with: some fall slack, some become taut.
//!
//! At a command the prior knows the pull p of each cable in N (stiffness × stretch: its tension T where positive, how slack
//! it is where negative). Under dead loads c (g, N) the stretches change with the loads and with the tensions,
//!
//! `p'ᵢ = pᵢ + kᵢ (Lᵢ·c + Σⱼ Cᵢⱼ (T'ⱼ − Tⱼ))`, `T'ᵢ = max(0, p'ᵢ)`
//!
//! with L and C the stretch per unit load and per unit tension while all other tensions stay. It is a linear
//! complementarity problem with the matrix 1/k − C, positive definite because a pulled cable gets shorter; solved by the
//! primal-dual active set method (Hintermüller, Ito & Kunisch 2002), by projected Gauss–Seidel should that cycle. The body
//! then moves by its fields at constant tension for c and for T' − T. Without this, fields are wrong by half their size near
//! home, where tendons change between slack and taut. Limit: L, C and the fields are those of the unloaded equilibrium.

use crate::dense;
use crate::error::{Result, invalid};
use crate::loads::FIELDS;
use crate::shape::Shape;
use crate::table::Table;
use std::sync::Arc;

const LOADS: usize = FIELDS.len();
/// Rounds of Gauss–Seidel, and the change of tension (N) at which they end.
const ROUNDS: usize = 400;
const SETTLED: f64 = 1e-9;

/// The cables of a prior.
#[derive(Clone)]
pub struct Cables {
    stiffness: Vec<f64>,
    pull: Arc<Table>,
    stretch: Arc<Table>,
    fields: Vec<Arc<Table>>,
}

/// What `answer` works with at one command: pulls (n,) and rows (n, loads + n) of L and C.
pub struct Place<'a> {
    pub pull: &'a [f64],
    pub stretch: &'a [f64],
}

impl Cables {
    /// `stiffness` (n,) N/mm; `pull` gives n numbers in N, `stretch` (n, loads + n) row by row in mm per unit; `fields` are
    /// the displacements per 1 N in each cable.
    pub fn new(
        stiffness: Vec<f64>,
        pull: Arc<Table>,
        stretch: Arc<Table>,
        fields: Vec<Arc<Table>>,
    ) -> Result<Cables> {
        let n = stiffness.len();
        if n == 0 || stiffness.iter().any(|k| !(k.is_finite() && *k > 0.0)) {
            return Err(invalid(format!(
                "cable stiffnesses {stiffness:?} N/mm: give each cable one number above 0"
            )));
        }
        if pull.size() != n || stretch.size() != n * (LOADS + n) || fields.len() != n {
            return Err(invalid(format!(
                "{n} cables want {n} pulls, {} stretches and {n} fields, got {}, {} and {}",
                n * (LOADS + n),
                pull.size(),
                stretch.size(),
                fields.len()
            )));
        }
        let channels = pull.channels();
        if stretch.channels() != channels || fields.iter().any(|f| f.channels() != channels) {
            return Err(invalid(
                "pulls, stretches and fields of cables must take the same commands",
            ));
        }
        Ok(Cables {
            stiffness,
            pull,
            stretch,
            fields,
        })
    }

    /// The same cables with their fields seen through a linear map: `weights` (M, M2), `offset` (M2,).
    pub fn project(&self, weights: &[f64], offset: &[f64]) -> Result<Cables> {
        let fields = self.fields.iter();
        Ok(Cables {
            fields: fields
                .map(|f| f.project(weights, offset).map(Arc::new))
                .collect::<Result<_>>()?,
            ..self.clone()
        })
    }

    /// Number of cables n.
    pub fn count(&self) -> usize {
        self.stiffness.len()
    }

    /// Displacements per 1 N in each cable, all other tensions as they are.
    pub fn fields(&self) -> impl Iterator<Item = Arc<dyn Shape>> {
        self.fields.iter().map(|f| f.clone() as Arc<dyn Shape>)
    }

    /// Numbers that `place` writes.
    pub fn size(&self) -> usize {
        self.pull.size() + self.stretch.size()
    }

    /// Pulls and stretches at a command, one after the other.
    pub fn at(&self, u: &[f64], out: &mut [f64]) {
        let (pull, stretch) = out.split_at_mut(self.pull.size());
        self.pull.eval(u, pull);
        self.stretch.eval(u, stretch);
    }

    /// Change of each tension (n,) N under the loads, at a place that `at` wrote.
    pub fn answer(&self, place: &[f64], loads: &[f64; LOADS], change: &mut [f64]) {
        let (pull, rows) = place.split_at(self.count());
        let place = Place {
            pull,
            stretch: rows,
        };
        let before: Vec<f64> = pull.iter().map(|p| p.max(0.0)).collect();
        // Stretch without any tension: what tension then takes away is −C T.
        let free: Vec<f64> = (0..self.count())
            .map(|i| {
                let row = place.row(i);
                pull[i] / self.stiffness[i] + dot(&row[..LOADS], loads)
                    - dot(&row[LOADS..], &before)
            })
            .collect();
        let after = self
            .active_set(&place, &free, &before)
            .unwrap_or_else(|| self.gauss_seidel(&place, &free, &before));
        for ((out, a), b) in change.iter_mut().zip(&after).zip(&before) {
            *out = a - b;
        }
    }

    /// Solve for the tensions of the cables taken as taut until those that pull and those that are stretched agree.
    fn active_set(&self, place: &Place, free: &[f64], before: &[f64]) -> Option<Vec<f64>> {
        let n = self.count();
        let mut taut: Vec<bool> = before.iter().map(|t| *t > 0.0).collect();
        for _ in 0..2 * n + 8 {
            let set: Vec<usize> = (0..n).filter(|i| taut[*i]).collect();
            let matrix = set
                .iter()
                .map(|&i| {
                    let row = &place.row(i)[LOADS..];
                    set.iter()
                        .map(|&j| f64::from(i == j) / self.stiffness[i] - row[j])
                        .collect()
                })
                .collect();
            let right = set.iter().map(|&i| free[i]).collect();
            let tension = dense::solve(matrix, right)?;
            let mut all = vec![0.0; n];
            set.iter().zip(&tension).for_each(|(&i, &t)| all[i] = t);
            let next: Vec<bool> = (0..n)
                .map(|i| {
                    if taut[i] {
                        all[i] > 0.0
                    } else {
                        free[i] + dot(&place.row(i)[LOADS..], &all) > 0.0
                    }
                })
                .collect();
            if next == taut {
                return all.iter().all(|t| t.is_finite()).then_some(all);
            }
            taut = next;
        }
        None
    }

    fn gauss_seidel(&self, place: &Place, free: &[f64], before: &[f64]) -> Vec<f64> {
        let mut tension = before.to_vec();
        for _ in 0..ROUNDS {
            let mut largest: f64 = 0.0;
            for i in 0..self.count() {
                let row = &place.row(i)[LOADS..];
                let own = 1.0 / self.stiffness[i] - row[i];
                let stretch = free[i] + dot(row, &tension) - tension[i] / self.stiffness[i];
                let next = (tension[i] + stretch / own.max(1e-12)).max(0.0);
                largest = largest.max((next - tension[i]).abs());
                tension[i] = next;
            }
            if largest < SETTLED {
                break;
            }
        }
        tension
    }
}

impl Place<'_> {
    fn row(&self, i: usize) -> &[f64] {
        let width = LOADS + self.pull.len();
        &self.stretch[i * width..(i + 1) * width]
    }
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn constant(values: Vec<f64>) -> Arc<Table> {
        Arc::new(Table::new(vec![], vec![], values, vec![]).unwrap())
    }

    /// Two antagonists on one bending joint: a lateral load θ per N stretches one and relieves the other.
    fn pair(pull: [f64; 2]) -> Cables {
        let load = |side: f64| [side, 0.0, 0.0, 0.0, 0.0, 0.0];
        let rows = [
            [&load(0.5)[..], &[-1.0, 0.9]].concat(),
            [&load(-0.5)[..], &[0.9, -1.0]].concat(),
        ];
        let still = constant(vec![0.0; 3]);
        Cables::new(
            vec![20.0; 2],
            constant(pull.to_vec()),
            constant(rows.concat()),
            vec![still.clone(), still],
        )
        .unwrap()
    }

    fn answer(cables: &Cables, load: f64) -> [f64; 2] {
        let mut place = vec![0.0; cables.size()];
        cables.at(&[], &mut place);
        let mut change = [0.0; 2];
        cables.answer(&place, &[load, 0.0, 0.0, 0.0, 0.0, 0.0], &mut change);
        change
    }

    #[test]
    fn tensions_satisfy_complementarity_whichever_cables_pull() {
        for pull in [[0.05, 0.05], [1.0, -3.0], [-2.0, -0.4], [3.0, 0.2]] {
            let cables = pair(pull);
            for load in [-4.0, -0.3, 0.0, 0.02, 1.0, 6.0] {
                let change = answer(&cables, load);
                let tension: Vec<f64> = (0..2).map(|i| pull[i].max(0.0) + change[i]).collect();
                for i in 0..2 {
                    let side = if i == 0 { 0.5 } else { -0.5 };
                    let moved = side * load
                        + if i == 0 {
                            -change[0] + 0.9 * change[1]
                        } else {
                            0.9 * change[0] - change[1]
                        };
                    let wanted = (pull[i] + 20.0 * moved).max(0.0);
                    // Round-off of numbers of the size of k × stretch.
                    assert!(
                        (tension[i] - wanted).abs() < 1e-9,
                        "{pull:?} {load} {tension:?} {wanted}"
                    );
                }
            }
        }
    }

    #[test]
    fn no_load_changes_nothing_and_slack_cables_do_not_answer() {
        assert_eq!(answer(&pair([1.5, -3.0]), 0.0), [0.0, 0.0]);
        assert_eq!(answer(&pair([-30.0, -30.0]), 1.0), [0.0, 0.0]);
    }

    #[test]
    fn gauss_seidel_finds_the_same_tensions() {
        let cables = pair([0.05, 0.05]);
        let mut place = vec![0.0; cables.size()];
        cables.at(&[], &mut place);
        let (pull, rows) = place.split_at(2);
        let place = Place {
            pull,
            stretch: rows,
        };
        let (free, before) = ([0.4, -0.2], [0.05, 0.05]);
        let one = cables.active_set(&place, &free, &before).unwrap();
        let other = cables.gauss_seidel(&place, &free, &before);
        assert!(
            one.iter().zip(&other).all(|(a, b)| (a - b).abs() < 1e-6),
            "{one:?} {other:?}"
        );
    }

    #[test]
    fn sizes_that_do_not_fit_are_refused() {
        let (one, two) = (constant(vec![0.0]), constant(vec![0.0; 2]));
        assert!(Cables::new(vec![20.0], one.clone(), two.clone(), vec![one.clone()]).is_err());
        assert!(Cables::new(vec![-1.0], one.clone(), constant(vec![0.0; 7]), vec![one]).is_err());
    }
}
