//! From commands to measured points: chain → shape and fields → sensing, for many parameter sets at
//! once. Every fit calls this.
//!
//! A frame at time t is `sense(prior(u_eff) + Σ c_k·field_k(u_eff) + Σ ΔT_i·cable_i(u_eff))`.
//! `u_eff(t)` is the output of the chain at the command times, interpolated linearly at the frame
//! times minus the delay of their stamps. `c(t)` holds the known physics, gravity declared by the
//! run minus the gravity the prior was solved with (g) and the weight of the declared load (N),
//! plus the loads and changes of design of the shape effects; a prior of unknown stiffness omits
//! the known physics, and the effects represent it. ΔT(t) is the response of the cable tensions to
//! those loads (`cables.rs`); a prior without cables, a rod, has none.
//!
//! Parameter sets that agree in all channel effects share their shapes: in a Jacobian, steps in
//! shape and sensing parameters cost almost nothing. Second-order terms of loads and modulus come
//! from `second.rs`, if the prior has them. Limits: the response to other changes of design is
//! linear.

use crate::effects::{Chain, Conditions};
use crate::error::{Result, invalid};
use crate::memory::zeros;
use crate::response::answer::{self, Answer};
use crate::response::cables::Cables;
use crate::response::contact::Contact;
use crate::response::fields::Fields;
use crate::response::loads::{CONTACT, CURVE, Coefficients, FIELDS, TENDON, name};
use crate::response::second_order::Second;
use crate::shape::Shape;
use crate::shape::grid::Nodes;
use job::{Body, Job};
use loads::{Acting, Kept, Load};
use rayon::prelude::*;
use std::sync::Arc;

/// Smaller coefficients (g, N) need no field: 1e-6 g moves no finger by a micrometre.
const NEGLIGIBLE: f64 = 1e-6;

/// A prior, its fields and the kind of its outputs.
pub struct Predictor {
    body: Body,
    answer: Answer,
    contact: Option<Arc<Contact>>,
    positions: Vec<bool>,
    /// Whether the outputs are vectors; else they are linear forms, which sensing effects cannot
    /// change.
    vectors: bool,
    reference: [f64; 3],
    /// Whether declared loads are applied.
    declared: bool,
    kept: Kept,
}

impl Predictor {
    /// Compose a prior (3V outputs) with its fields, by name; `positions` (V,) is false for
    /// directions, which only turn.
    pub fn new(
        prior: Arc<dyn Shape>,
        fields: Vec<(String, Arc<dyn Shape>)>,
        cables: Option<Cables>,
        second: Option<Second>,
        positions: Vec<bool>,
        reference: [f64; 3],
    ) -> Result<Predictor> {
        if prior.size() != 3 * positions.len() {
            return Err(invalid(format!(
                "the prior has {} outputs, positions has {} entries; expected three \
                outputs for each",
                prior.size(),
                positions.len()
            )));
        }
        let mut known: Vec<Option<Arc<dyn Shape>>> = vec![None; FIELDS.len()];
        for (name, field) in fields {
            let Some(index) = FIELDS.iter().position(|known| *known == name) else {
                return Err(invalid(format!(
                    "no field is called '{name}'; there are {}",
                    FIELDS.join(", ")
                )));
            };
            if field.size() != prior.size() || field.channels() != prior.channels() {
                return Err(invalid(format!(
                    "the field {name} maps {} commands to {} numbers, the prior {} to {}; they \
                    must agree",
                    field.channels(),
                    field.size(),
                    prior.channels(),
                    prior.size()
                )));
            }
            known[index] = Some(field);
        }
        for field in cables.iter().flat_map(Cables::fields) {
            known.push(Some(field.clone()));
            if field.size() != prior.size() || field.channels() != prior.channels() {
                return Err(invalid(format!(
                    "a cable's field maps {} commands to {} numbers, the prior {} to {}; they must \
                    agree",
                    field.channels(),
                    field.size(),
                    prior.channels(),
                    prior.size()
                )));
            }
        }
        if let Some(second) = &second {
            let tendons = cables.as_ref().map_or(0, Cables::count);
            let found = (second.channels(), second.outputs(), second.tendons());
            if found != (prior.channels(), prior.size(), tendons) {
                return Err(invalid(format!(
                    "the second level of loads has {} commands, {} outputs and {} tendons, the \
                     prior {}, {} and {tendons}; they must agree",
                    found.0,
                    found.1,
                    found.2,
                    prior.channels(),
                    prior.size()
                )));
            }
            known.extend(second.fields()?.into_iter().map(Some));
        }
        Ok(Predictor {
            body: Body {
                prior,
                fields: Arc::new(Fields::new(known)),
            },
            answer: Answer::new(cables, second),
            contact: None,
            positions,
            vectors: true,
            reference,
            declared: true,
            kept: Kept::default(),
        })
    }

    /// The same with stations for contact with an obstacle.
    pub fn with_contact(self, contact: Contact) -> Predictor {
        Predictor {
            contact: Some(Arc::new(contact)),
            ..self
        }
    }

    /// The same without declared loads: for a prior with fields of unknown scale. Gravity still
    /// gives the effects the direction of a weight.
    pub fn without_declared_loads(self) -> Predictor {
        Predictor {
            declared: false,
            ..self
        }
    }

    /// The same with linear forms of the outputs in their place: `weights` (3V, M). M must be a
    /// multiple of 3; forms of zeros fill up. Only tables support it, as plain ones; None if the
    /// prior or a field is of another kind.
    pub fn through(&self, weights: &[f64], forms: usize) -> Result<Option<Predictor>> {
        let zero = vec![0.0; forms];
        let plain = |shape: &Arc<dyn Shape>| -> Result<Option<Arc<dyn Shape>>> {
            let Some(table) = shape.table() else {
                return Ok(None);
            };
            let seen = table.project(weights, &zero)?;
            Ok(Some(if seen.channels() > 0 {
                Arc::new(seen.plain()?)
            } else {
                Arc::new(seen)
            }))
        };
        let Some(prior) = plain(&self.body.prior)? else {
            return Ok(None);
        };
        let mut fields = vec![];
        for member in self.body.fields.members() {
            let seen = member.as_ref().map(plain).transpose()?;
            if matches!(seen, Some(None)) {
                return Ok(None);
            }
            fields.push(seen.flatten());
        }
        Ok(Some(Predictor {
            body: Body {
                prior,
                fields: Arc::new(Fields::new(fields)),
            },
            answer: self.answer.clone(),
            contact: self.contact.clone(),
            positions: vec![true; forms / 3],
            vectors: false,
            reference: self.reference,
            declared: self.declared,
            kept: Kept::default(),
        }))
    }

    /// Number of vectors V in a frame.
    pub fn vectors(&self) -> usize {
        self.positions.len()
    }

    /// Frames (B, K, V, 3) for parameters (B, P) on the commands `u` (T, C), seen at `t_seen` (K,).
    pub fn predict(
        &self,
        chain: &Chain,
        params: &[f64],
        u: &[f64],
        conditions: &Conditions,
        t_seen: &[f64],
    ) -> Result<Vec<f64>> {
        self.agrees(chain, conditions, t_seen)?;
        let sets = chain.sets(params)?;
        let job = Job::new(&self.body, chain, params, sets, u, conditions, t_seen)?;
        self.frames(&job, sets, t_seen.len())
    }

    /// Reject a chain or a record that this prior does not support.
    fn agrees(&self, chain: &Chain, conditions: &Conditions, t_seen: &[f64]) -> Result<()> {
        if chain.channels() != self.body.prior.channels() {
            return Err(invalid(format!(
                "the chain has {} channels, the prior {}; make the chain for this model",
                chain.channels(),
                self.body.prior.channels()
            )));
        }
        if !self.vectors && chain.senses() {
            return Err(invalid(
                "the chain changes what is seen, which linear forms of it do not know; predict \
                with it, and form then",
            ));
        }
        if conditions.is_empty() && chain.channels() > 0 && !t_seen.is_empty() {
            return Err(invalid(
                "nothing was commanded (T = 0), so nothing can be predicted; give at least one \
                sample",
            ));
        }
        Ok(())
    }

    /// Frames (B, K, V, 3) of a prepared job.
    fn frames(&self, job: &Job, sets: usize, frames: usize) -> Result<Vec<f64>> {
        let size = self.body.prior.size();
        let mut out = zeros(
            "a prediction (parameter sets, frames, outputs)",
            &[sets, frames, size],
        )?;
        if size == 0 {
            return Ok(out);
        }
        let acting = self.loads(job, sets)?;
        let shared = self.shared_shapes(job, &acting)?;
        let width = job.chain.width();
        out.par_chunks_exact_mut(size)
            .enumerate()
            .try_for_each_init(
                || self.scratch(),
                |scratch, (i, frame)| {
                    let (b, k) = (i / frames, i % frames);
                    let group = job.group[b];
                    let whole = match &shared[group] {
                        Some(shapes) => {
                            scratch.nodes.clear();
                            shapes.copy(self, job, (b, k), &acting, frame)?
                        }
                        None => {
                            self.bend(job, (group, k), scratch, frame);
                            false
                        }
                    };
                    if !whole {
                        self.load(job, (b, k), &acting, scratch, frame)?;
                    }
                    job.chain.sense(
                        &job.params[b * width..(b + 1) * width],
                        &self.positions,
                        frame,
                        job.context(b, k),
                        &job.cameras,
                    );
                    Ok(())
                },
            )?;
        Ok(out)
    }

    /// Write the prior of a group at a frame to `out`; keep the stencils of its command for reuse.
    fn bend(&self, job: &Job, (group, k): (usize, usize), scratch: &mut Scratch, out: &mut [f64]) {
        let (u, prior) = (job.at(group, k), &job.bodies[group].prior);
        scratch.nodes.clear();
        match prior.table() {
            Some(table) => table.eval_at(scratch.nodes.of(table.grid(), u), out),
            None => prior.eval(u, out),
        }
    }

    /// Add the response to the loads of a set at a frame to `out`.
    fn load(
        &self,
        job: &Job,
        (b, k): (usize, usize),
        acting: &Acting,
        scratch: &mut Scratch,
        out: &mut [f64],
    ) -> Result<()> {
        let group = job.group[b];
        let (u, fields) = (job.at(group, k), &job.bodies[group].fields);
        match acting.of(b, k) {
            Load::Nothing => {}
            Load::Recurs(number) => acting.body(number).add(u, scratch, out),
            Load::Other => {
                let loads = self.coefficients(job, b, k)?;
                self.under(fields, &loads, u, scratch, out);
            }
        }
        Ok(())
    }

    /// Add the response to loads at the effective command `u` to `out`.
    fn under(
        &self,
        fields: &Fields,
        loads: &Coefficients,
        u: &[f64],
        scratch: &mut Scratch,
        out: &mut [f64],
    ) {
        let Scratch {
            nodes,
            place,
            weights,
            field,
            work,
        } = scratch;
        let there: [bool; CURVE] = std::array::from_fn(|f| loads[f] != 0.0);
        self.answer.at(u, nodes, &there, place, work);
        self.answer.weigh(
            &loads[..TENDON],
            &loads[TENDON..CONTACT],
            place,
            weights,
            work,
        );
        if let (Some(contact), true) = (&self.contact, loads[CONTACT] != 0.0) {
            let cables = self.answer.cables_at(place);
            let cables = cables.map(|(cables, at)| (cables, at, &work.beyond[..]));
            contact.stop(u, loads, cables, weights);
        }
        fields.add(u, nodes, weights, field, out);
    }

    /// Whether this body supports a coefficient: its field exists, or it belongs to cables.
    fn has(&self, coefficient: usize) -> bool {
        match coefficient {
            field if field < TENDON => self.body.fields.get(field).is_some(),
            cable if cable < CONTACT => self.answer.cables.is_some(),
            _ => self.contact.is_some(),
        }
    }

    fn absent(&self, chain: &Chain, field: usize, value: f64) -> crate::Error {
        let users: Vec<_> = chain
            .fields()
            .iter()
            .filter(|(f, _)| *f == field)
            .map(|(_, name)| *name)
            .collect();
        let wants = match users.as_slice() {
            [] => "what the run declares (gravity or load)".to_string(),
            names => format!("the effect {} or what the run declares", names.join(", ")),
        };
        invalid(format!(
            "{wants} asks for {value:.3e} of the field {}, which this model does not have; build \
             the model with its fields, or leave that effect out",
            name(field)
        ))
    }

    fn scratch(&self) -> Scratch {
        Scratch {
            nodes: Nodes::default(),
            place: vec![0.0; self.answer.size()],
            work: answer::Scratch::default(),
            weights: vec![0.0; self.body.fields.count()],
            field: vec![0.0; self.body.prior.size()],
        }
    }
}

/// Workspace of one frame.
struct Scratch {
    /// The stencils of its command.
    nodes: Nodes,
    place: Vec<f64>,
    work: answer::Scratch,
    weights: Vec<f64>,
    field: Vec<f64>,
}

mod job;
mod loads;
mod shared;
mod slopes;
mod steady;

pub use steady::still;

#[cfg(test)]
mod tests;
