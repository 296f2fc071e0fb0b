//! The response of cables to loads that the prior does not include: some become slack, some taut.
//!
//! At a command, the prior has the pull p of each cable in N (stiffness × stretch: the tension T if
//! positive, the slack if negative). Under dead loads c (g, N) the stretches change with the loads
//! and with the tensions,
//!
//! `p'ᵢ = (pᵢ/kᵢ + Lᵢ·c + Σⱼ Cᵢⱼ (T'ⱼ − Tⱼ)) / (1/kᵢ + s)`, `T'ᵢ = max(0, p'ᵢ)`
//!
//! with L and C the stretch per unit load (or change of design) and per unit tension at constant
//! other tensions, and s the compliance of a cable beyond the model's 1/k. It is a linear
//! complementarity problem with the matrix 1/k + s − C, positive definite because a pulled cable
//! becomes shorter (`complementarity.rs`). The body then moves by its fields at constant tension
//! for c and for T' − T. Without this, fields are wrong by half their size near home, where tendons
//! change between slack and taut. p has a kink where a cable becomes slack: from there its slope is
//! k, twenty times as steep. So the stretch without any tension, pᵢ/kᵢ − Σⱼ Cᵢⱼ Tⱼ, which has no
//! kink, is interpolated between commands; p follows from it by the same problem, without loads. On
//! the bank's rod, the tension error is then at most 1e-3 N, and 2 N otherwise. Limit: L, C and the
//! fields are those of the unloaded equilibrium; second-order terms are in `second.rs`.

use crate::algebra::complementarity::Problem;
use crate::error::{Result, invalid};
use crate::response::loads::FIELDS;
use crate::shape::Shape;
use crate::shape::grid::Nodes;
use crate::shape::table::Table;
use std::sync::Arc;

/// The cables of a prior.
#[derive(Clone)]
pub struct Cables {
    stiffness: Vec<f64>,
    /// Stretch without any tension, mm.
    free: Arc<Table>,
    stretch: Arc<Table>,
    fields: Vec<Arc<Table>>,
    /// Number of loads that stretch them.
    loads: usize,
    /// The commands that pull each cable, and their shares: 2c is +u of command c, 2c + 1 is −u.
    driven: Arc<Vec<Vec<(usize, f64)>>>,
}

impl Cables {
    /// `stiffness` (n,) N/mm; `pull` gives n numbers in N, `stretch` (n, loads + n) row by row in
    /// mm per unit; `fields` are the displacements per 1 N in each cable.
    pub fn new(
        stiffness: Vec<f64>,
        pull: Arc<Table>,
        stretch: Arc<Table>,
        fields: Vec<Arc<Table>>,
    ) -> Result<Cables> {
        let (n, loads) = (stiffness.len(), FIELDS.len());
        if n == 0 || stiffness.iter().any(|k| !(k.is_finite() && *k > 0.0)) {
            return Err(invalid(format!(
                "cable stiffnesses {stiffness:?} N/mm: give each cable one number above 0"
            )));
        }
        if pull.size() != n || stretch.size() != n * (loads + n) || fields.len() != n {
            return Err(invalid(format!(
                "{n} cables want {n} pulls, {} stretches and {n} fields, got {}, {} and {}",
                n * (loads + n),
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
        let mut place = vec![0.0; stretch.size()];
        let free = pull.mapped(n, |u, pull, free| {
            stretch.eval(u, &mut place);
            for (i, row) in place.chunks_exact(loads + n).enumerate() {
                let tensions = row[loads..].iter().zip(pull).map(|(c, p)| c * p.max(0.0));
                free[i] = pull[i] / stiffness[i] - tensions.sum::<f64>();
            }
        })?;
        Ok(Cables {
            stiffness,
            driven: Arc::new(driven(&free)),
            free: Arc::new(free),
            // bodies under loads are often made from it
            stretch: Arc::new(stretch.plain()?),
            fields,
            loads,
        })
    }

    /// The same cables with few loads, each a combination (loads,) of the original ones.
    pub fn under(&self, amounts: &[&[f64]]) -> Result<Cables> {
        let (n, width, few) = (self.count(), self.loads + self.count(), amounts.len());
        let there = |amount: &&[f64]| -> Vec<(usize, f64)> {
            let all = amount.iter().copied().enumerate();
            all.filter(|(_, c)| *c != 0.0).collect()
        };
        let there: Vec<_> = amounts.iter().map(there).collect();
        let stretch = self.stretch.mapped(n * (few + n), |_, rows, out| {
            for (row, out) in rows.chunks_exact(width).zip(out.chunks_exact_mut(few + n)) {
                let (by_loads, by_tension) = row.split_at(self.loads);
                for (out, amount) in out.iter_mut().zip(&there) {
                    *out = amount.iter().map(|(f, c)| by_loads[*f] * c).sum();
                }
                out[few..].copy_from_slice(by_tension);
            }
        })?;
        Ok(Cables {
            stretch: Arc::new(stretch),
            loads: few,
            ..self.clone()
        })
    }

    /// The same cables with their fields seen through a linear map: `weights` (M, M2), `offset`
    /// (M2,).
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

    /// Displacements per 1 N in each cable, at constant other tensions.
    pub fn fields(&self) -> impl Iterator<Item = Arc<dyn Shape>> {
        self.fields.iter().map(|f| f.clone() as Arc<dyn Shape>)
    }

    /// Number of values that `at` writes.
    pub fn size(&self) -> usize {
        self.free.size() + self.stretch.size()
    }

    /// Pulls and stretches at a command, concatenated.
    pub fn at(&self, u: &[f64], nodes: &mut Nodes, out: &mut [f64], problem: &mut Problem) {
        let n = self.count();
        let (free, stretch) = out.split_at_mut(n);
        self.free.eval_at(nodes.of(self.free.grid(), u), free);
        self.stretch
            .eval_at(nodes.of(self.stretch.grid(), u), stretch);
        problem.clear();
        problem.right.extend_from_slice(free);
        problem.positive.extend(free.iter().map(|q| *q > 0.0));
        for i in 0..n {
            problem.matrix.extend(self.gives(out, i, 0.0));
        }
        let tension = problem.solve();
        for i in 0..n {
            let by_tension = &self.row(out, i)[self.loads..];
            out[i] = self.stiffness[i] * (out[i] + dot(by_tension, tension));
        }
    }

    /// Change of each tension (n,) N under the loads, at a place that `at` wrote. `gives` (2 C,)
    /// mm/N is the additional compliance of the cables that +u and −u of each command pull;
    /// `beyond` (n,) mm is a further stretch (empty: none). The previous values of `change` define
    /// the initial active set.
    pub fn answer(
        &self,
        place: &[f64],
        loads: &[f64],
        gives: &[f64],
        beyond: &[f64],
        change: &mut [f64],
        problem: &mut Problem,
    ) {
        self.pose(place, loads, gives, beyond, problem);
        let before = self.before(place);
        let sums = before.clone().zip(change.iter()).map(|(t, c)| t + c > 0.0);
        problem.positive.extend(sums);
        let after = problem.solve();
        for ((out, a), b) in change.iter_mut().zip(after).zip(before) {
            *out = a - b;
        }
    }

    /// Tensions (n,) N without loads, at a place that `at` wrote.
    pub fn before<'a>(&self, place: &'a [f64]) -> impl Iterator<Item = f64> + Clone + 'a {
        place[..self.count()].iter().map(|pull| pull.max(0.0))
    }

    /// Set up the problem for the tensions: 1/k + s − C (n, n), and the stretch (n,) mm without any
    /// tension.
    pub fn pose(
        &self,
        place: &[f64],
        loads: &[f64],
        gives: &[f64],
        beyond: &[f64],
        problem: &mut Problem,
    ) {
        problem.clear();
        for i in 0..self.count() {
            let (by_loads, by_tension) = self.row(place, i).split_at(self.loads);
            let more = self.driven[i]
                .iter()
                .map(|(by, share)| share * gives.get(*by).unwrap_or(&0.0));
            problem.matrix.extend(self.gives(place, i, more.sum()));
            // The contribution of the tensions of the unloaded place is −C T.
            let tensions = by_tension.iter().zip(self.before(place));
            problem.right.push(
                place[i] / self.stiffness[i] + beyond.get(i).unwrap_or(&0.0) + dot(by_loads, loads)
                    - tensions.map(|(c, t)| c * t).sum::<f64>(),
            );
        }
    }

    /// Stretch of a cable per unit of a field, at a place that `at` wrote.
    pub fn stretch(&self, place: &[f64], cable: usize, field: usize) -> f64 {
        self.row(place, cable)[field]
    }

    /// A row of 1/k + s − C, mm/N.
    fn gives<'a>(&self, place: &'a [f64], i: usize, more: f64) -> impl Iterator<Item = f64> + 'a {
        let gives = 1.0 / self.stiffness[i] + more;
        let row = self.row(place, i)[self.loads..].iter().enumerate();
        row.map(move |(j, c)| f64::from(i == j) * gives - c)
    }

    /// Stretch of a cable: L (loads), then C (n,).
    fn row<'a>(&self, place: &'a [f64], i: usize) -> &'a [f64] {
        let (n, width) = (self.count(), self.loads + self.count());
        &place[n + i * width..n + (i + 1) * width]
    }
}

/// The commands that pull each cable, by the slopes of its `free` stretch, which is nearly linear;
/// shares are their squares. A cable without a command uses the mean of all.
fn driven(free: &Table) -> Vec<Vec<(usize, f64)>> {
    let (n, channels) = (free.size(), free.channels());
    let ends: Vec<(f64, f64)> = free.axes().map(|a| (a[0], a[a.len() - 1])).collect();
    let middle: Vec<f64> = ends.iter().map(|(low, high)| 0.5 * (low + high)).collect();
    let slopes: Vec<Vec<f64>> = (0..channels)
        .map(|c| {
            let at = |u: f64| {
                let (mut place, mut out) = (middle.clone(), vec![0.0; n]);
                place[c] = u;
                free.eval(&place, &mut out);
                out
            };
            let (low, high) = ends[c];
            let pairs = at(low).into_iter().zip(at(high));
            pairs.map(|(a, b)| (b - a) / (high - low)).collect()
        })
        .collect();
    let shares = |i: usize| {
        let total: f64 = slopes.iter().map(|by| by[i] * by[i]).sum();
        if total <= 0.0 {
            let all = 2 * channels.max(1);
            return (0..all).map(|side| (side, 1.0 / all as f64)).collect();
        }
        let by = slopes.iter().enumerate();
        by.map(|(c, by)| (2 * c + usize::from(by[i] < 0.0), by[i] * by[i] / total))
            .collect()
    };
    (0..n).map(shares).collect()
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

    /// Two antagonists on one bending joint: a lateral load θ per N stretches one and relieves the
    /// other.
    fn pair(pull: [f64; 2]) -> Cables {
        let load = |side: f64| {
            let mut row = [0.0; FIELDS.len()];
            row[0] = side;
            row
        };
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

    fn answer(cables: &Cables, load: f64, gives: f64) -> [f64; 2] {
        let mut place = vec![0.0; cables.size()];
        let (mut nodes, mut problem) = (Nodes::default(), Problem::default());
        cables.at(&[], &mut nodes, &mut place, &mut problem);
        let (mut loads, mut change) = ([0.0; FIELDS.len()], [0.0; 2]);
        loads[0] = load;
        let all = [gives; 2];
        cables.answer(&place, &loads, &all, &[], &mut change, &mut problem);
        let (one, mut again) = (cables.under(&[&loads, &loads]).unwrap(), [0.0; 2]);
        let mut place = vec![0.0; one.size()];
        nodes.clear();
        one.at(&[], &mut nodes, &mut place, &mut problem);
        one.answer(&place, &[0.25, 0.75], &all, &[], &mut again, &mut problem);
        assert!(
            (0..2).all(|i| (change[i] - again[i]).abs() < 1e-12),
            "as one load"
        );
        change
    }

    #[test]
    fn tensions_satisfy_complementarity_whichever_cables_pull() {
        for pull in [[0.05, 0.05], [1.0, -3.0], [-2.0, -0.4], [3.0, 0.2]] {
            let cables = pair(pull);
            for (load, gives) in [-4.0, -0.3, 0.0, 0.02, 1.0, 6.0]
                .into_iter()
                .zip([0.0, 0.4].into_iter().cycle())
            {
                let change = answer(&cables, load, gives);
                let tension: Vec<f64> = (0..2).map(|i| pull[i].max(0.0) + change[i]).collect();
                for i in 0..2 {
                    let side = if i == 0 { 0.5 } else { -0.5 };
                    let moved = side * load
                        + if i == 0 {
                            -change[0] + 0.9 * change[1]
                        } else {
                            0.9 * change[0] - change[1]
                        };
                    let wanted = ((pull[i] / 20.0 + moved) / (1.0 / 20.0 + gives)).max(0.0);
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
    fn a_cable_falls_slack_between_two_nodes_where_it_does() {
        // One cable, commanded by u mm, with 1 mm/N extra compliance: p = u/(1/20 + 1), 20 u if
        // slack.
        let told = |u: f64| if u > 0.0 { u / 1.05 } else { 20.0 * u };
        let axis = vec![-3.0, -1.0, 2.0, 3.0, 5.0];
        let pull: Vec<f64> = axis.iter().map(|u| told(*u)).collect();
        let family = |values: Vec<f64>| {
            let size = values.len() / axis.len();
            let unit = (0..size * size).map(|i| f64::from(i / size == i % size));
            let table = Table::new(vec![axis.clone()], values, vec![0.0; size], unit.collect());
            Arc::new(table.unwrap())
        };
        let mut row = vec![0.0; FIELDS.len() + 1];
        row[FIELDS.len()] = -1.0;
        let still = family(vec![0.0; 2 * axis.len()]);
        let stretch = family(row.repeat(axis.len()));
        let pulls = family(pull);
        let cables = Cables::new(vec![20.0], pulls.clone(), stretch, vec![still]).unwrap();
        let (mut place, mut problem) = (vec![0.0; cables.size()], Problem::default());
        for u in [-2.2, -0.4, 0.0, 0.3, 1.1, 2.0, 4.2] {
            cables.at(&[u], &mut Nodes::default(), &mut place, &mut problem);
            assert!((place[0] - told(u)).abs() < 1e-12, "{u}: {}", place[0]);
        }
        let mut cubic = [0.0];
        pulls.eval(&[0.3], &mut cubic);
        assert!(
            (cubic[0] - told(0.3)).abs() > 2.0,
            "a table alone rounds the kink: {}",
            cubic[0]
        );
    }

    #[test]
    fn no_load_changes_nothing_and_slack_cables_do_not_answer() {
        assert_eq!(answer(&pair([1.5, -3.0]), 0.0, 0.0), [0.0, 0.0]);
        assert_eq!(answer(&pair([-30.0, -30.0]), 1.0, 0.5), [0.0, 0.0]);
    }

    #[test]
    fn sizes_that_do_not_fit_are_refused() {
        let (one, two) = (constant(vec![0.0]), constant(vec![0.0; 2]));
        assert!(Cables::new(vec![20.0], one.clone(), two.clone(), vec![one.clone()]).is_err());
        assert!(Cables::new(vec![-1.0], one.clone(), constant(vec![0.0; 7]), vec![one]).is_err());
    }
}
