//! The linear fields of an equilibrium: displacements and cable stretches per unit of load, change
//! of design and tension.
//!
//! A field is the displacement per unit, by back-substitution at the equilibrium's tangent, with
//! all other tensions constant.

use super::Vec3;
use super::change::Changes;
use super::newton::{Solver, State};
use super::progress::Progress;
use super::solid::Load;
use super::sweep::Simulation;
use super::work::inner;
use crate::error::Result;
use crate::response::loads::{FIELDS, LOADS, PUSH, TIP_FORCE};

/// The response of an equilibrium to small loads, changes of design and tensions, with all other
/// tensions constant.
#[derive(Debug, Clone, Default)]
pub struct Compliance {
    /// Displacements of the points per unit of each of `FIELDS`, then per 1 N in each cable; empty
    /// if there is no such field.
    pub fields: Vec<Vec<Vec3>>,
    /// Stretch of each cable under the same, mm: rows (cables, fields).
    pub stretch: Vec<f64>,
}

impl Simulation {
    /// The compliance at the equilibrium of each command; optionally also to changes of `design`
    /// and to pushes.
    pub fn fields(
        &self,
        commands: &[Vec<f64>],
        gravity: Vec3,
        tip: Vec3,
        design: bool,
        progress: &Progress,
    ) -> Result<Vec<Compliance>> {
        let fields = if design { FIELDS.len() } else { LOADS } + self.solid.cables.len();
        self.room("the fields", &[commands.len()], fields)?;
        let changes = design.then(|| Changes::new(&self.solid, &self.drive));
        self.toured(commands, gravity, tip, progress, |solver, state| {
            self.compliance(solver, state, changes.as_ref())
        })
    }

    /// Nodal forces of the dead loads, each for one unit.
    pub(super) fn dead(&self) -> impl Iterator<Item = Vec<f64>> + '_ {
        (0..LOADS).map(|f| {
            let mut unit = Load::default();
            let part = if f < TIP_FORCE {
                &mut unit.gravity
            } else {
                &mut unit.tip
            };
            part[f % 3] = 1.0;
            self.solid.dead_vector(&unit)
        })
    }

    fn compliance(
        &self,
        solver: &mut Solver,
        state: &State,
        changes: Option<&Changes>,
    ) -> Result<Compliance> {
        solver.linearise(state)?;
        let tension: Vec<f64> = solver.pulls(state).iter().map(|p| p.max(0.0)).collect();
        let work = &mut solver.work;
        let cables: Vec<Vec<f64>> = (0..tension.len())
            .map(|c| work.slope(c, &state.x))
            .collect();
        let still = vec![0.0; cables.len()];
        let loads = self.dead().enumerate();
        let loads = loads.map(|(f, force)| (f, force, still.clone()));
        let pushes = (PUSH..FIELDS.len()).filter(|_| changes.is_some()).map(|f| {
            let force = self.solid.push_vector((f - PUSH) / 3, (f - PUSH) % 3);
            (f, force, still.clone())
        });
        let pulls = cables.iter().enumerate().map(|(c, b)| {
            let force = b.iter().map(|b| -b).collect();
            (FIELDS.len() + c, force, still.clone())
        });
        let designs = changes
            .into_iter()
            .flat_map(|c| c.at(&self.solid, &state.x, &tension));
        let at = self.points.place(&state.x);
        let count = FIELDS.len() + cables.len();
        let mut answer = Compliance {
            fields: vec![Vec::new(); count],
            stretch: vec![0.0; cables.len() * count],
        };
        for (field, force, own) in loads.chain(designs).chain(pushes).chain(pulls) {
            let step = work.solve_slack(force);
            let moved = self
                .points
                .place(&self.solid.displace(&state.x, &step, 1.0));
            answer.fields[field] = moved.iter().zip(&at).map(|(p, q)| p - q).collect();
            for (c, b) in cables.iter().enumerate() {
                answer.stretch[c * count + field] = own[c] + inner(b, &step);
            }
        }
        Ok(answer)
    }
}
