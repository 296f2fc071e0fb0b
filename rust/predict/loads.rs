//! The loads of the body in one call, and separate bodies for recurring loads.
//!
//! A run declares few directions of gravity and few weights, and most shape effects are constant
//! over the frames: hundreds of frames of a set share their coefficients. Under recurring loads the
//! body responds like one with few loads, all dead ones and all changes of design (`answer.rs`), at
//! a third of the cost and with the same result up to round-off. Recurrence is decided per set, so
//! a set's result does not depend on the other sets.

use super::job::Job;
use super::{NEGLIGIBLE, Predictor, Scratch};
use crate::effects::{Chain, Context};
use crate::error::Result;
use crate::response::answer::Answer;
use crate::response::fields::Fields;
use crate::response::loads::{CONTACT, Coefficients, FIELDS, GRAVITY, TENDON, TIP_FORCE, weight};
use std::collections::HashMap;
use std::sync::{Arc, Mutex};

/// Least frames with shared loads for a separate body, and most such bodies.
const MANY: usize = 32;
const KEPT: usize = 64;

/// Coefficients, bit by bit.
type Key = [u64; CONTACT + 8];

fn key(loads: &Coefficients) -> Key {
    loads.map(f64::to_bits)
}

/// The body under certain loads, combined to a few: each is present or not.
pub struct Loaded {
    fields: Fields,
    answer: Answer,
    amount: Vec<f64>,
    there: Vec<bool>,
    gives: Vec<f64>,
}

impl Loaded {
    /// Add the response to its loads at a command to `out`.
    pub fn add(&self, u: &[f64], scratch: &mut Scratch, out: &mut [f64]) {
        let place = &mut scratch.place[..self.answer.size()];
        let weights = &mut scratch.weights[..self.fields.count()];
        let nodes = &mut scratch.nodes;
        self.answer
            .at(u, nodes, &self.there, place, &mut scratch.work);
        self.answer
            .weigh(&self.amount, &self.gives, place, weights, &mut scratch.work);
        self.fields.add(u, nodes, weights, &mut scratch.field, out);
    }
}

/// Bodies that were made.
pub type Kept = Mutex<HashMap<Key, Arc<Loaded>>>;

/// The loads of a set at a frame: none, loads that recur by the number of their body, or others.
#[derive(Clone, Copy, PartialEq)]
pub enum Load {
    Nothing,
    Recurs(u32),
    Other,
}

/// The loads of a call.
pub struct Acting {
    /// (B, K)
    of: Vec<Load>,
    bodies: Vec<Arc<Loaded>>,
    frames: usize,
}

impl Acting {
    /// The loads of a set at a frame.
    pub fn of(&self, b: usize, k: usize) -> Load {
        self.of[b * self.frames + k]
    }

    /// The body under loads that recur.
    pub fn body(&self, number: u32) -> &Loaded {
        &self.bodies[number as usize]
    }
}

impl Predictor {
    /// The loads of all sets at all frames.
    pub(super) fn loads(&self, job: &Job, sets: usize) -> Result<Acting> {
        let (mut of, mut bodies) = (Vec::with_capacity(sets * job.frames), vec![]);
        let mut numbers: HashMap<Key, Load> = HashMap::new();
        for b in 0..sets {
            let own = Arc::ptr_eq(&job.bodies[job.group[b]].fields, &self.body.fields);
            let mut distinct: Vec<(Coefficients, usize)> = vec![];
            let mut known: HashMap<Key, usize> = HashMap::new();
            let mut rows: Vec<usize> = Vec::with_capacity(job.frames);
            for k in 0..job.frames {
                let loads = self.coefficients(job, b, k)?;
                let which = match rows.last() {
                    Some(&which) if distinct[which].0 == loads => which,
                    _ => *known.entry(key(&loads)).or_insert(distinct.len()),
                };
                if which == distinct.len() {
                    distinct.push((loads, 0));
                }
                distinct[which].1 += 1;
                rows.push(which);
            }
            let mut found = Vec::with_capacity(distinct.len());
            for (loads, count) in &distinct {
                found.push(if loads.iter().all(|c| *c == 0.0) {
                    Load::Nothing
                } else if *count < MANY || loads[CONTACT] != 0.0 || !own {
                    Load::Other
                } else if let Some(load) = numbers.get(&key(loads)) {
                    *load
                } else {
                    let load = self.loaded(loads)?.map_or(Load::Other, |body| {
                        bodies.push(body);
                        Load::Recurs(bodies.len() as u32 - 1)
                    });
                    numbers.insert(key(loads), load);
                    load
                });
            }
            of.extend(rows.into_iter().map(|which| found[which]));
        }
        Ok(Acting {
            of,
            bodies,
            frames: job.frames,
        })
    }

    fn loaded(&self, loads: &Coefficients) -> Result<Option<Arc<Loaded>>> {
        let kept = || {
            self.kept
                .lock()
                .unwrap_or_else(|broken| broken.into_inner())
        };
        if let Some(body) = kept().get(&key(loads)) {
            return Ok(Some(body.clone()));
        }
        let few = self.answer.few(&loads[..FIELDS.len()]);
        let few: Vec<&[f64]> = few.iter().map(Vec::as_slice).collect();
        let Some(fields) = self.body.fields.under(&few) else {
            return Ok(None);
        };
        let there: Vec<bool> = few
            .iter()
            .map(|one| one.iter().any(|c| *c != 0.0))
            .collect();
        let body = Arc::new(Loaded {
            fields,
            answer: self.answer.under(&few, loads)?,
            amount: there.iter().map(|there| f64::from(*there)).collect(),
            there,
            gives: loads[TENDON..CONTACT].to_vec(),
        });
        let mut kept = kept();
        if kept.len() >= KEPT {
            kept.clear();
        }
        kept.insert(key(loads), body.clone());
        Ok(Some(body))
    }

    /// Coefficients of the fields for a set at a frame.
    pub(super) fn coefficients(&self, job: &Job, b: usize, k: usize) -> Result<Coefficients> {
        let width = job.chain.width();
        let set = &job.params[b * width..(b + 1) * width];
        let group = job.group[b];
        let (u, remembered) = (job.at(group, k), job.remembered(group, k));
        self.loads_at(job.chain, set, u, remembered, job.context(b, k))
    }

    /// Coefficients of the fields at the effective command `u` with the memory `remembered`,
    /// including those that the context declares; a required field that is absent is an error.
    pub(super) fn loads_at(
        &self,
        chain: &Chain,
        params: &[f64],
        u: &[f64],
        remembered: &[f64],
        context: &Context,
    ) -> Result<Coefficients> {
        let mut sum = chain.coefficients(params, u, remembered, context);
        if self.declared {
            let force = weight(context.load, context.gravity);
            for i in 0..3 {
                sum[GRAVITY + i] += context.gravity[i] - self.reference[i];
                sum[TIP_FORCE + i] += force[i];
            }
        }
        for (f, value) in sum.iter_mut().enumerate() {
            if value.abs() <= NEGLIGIBLE {
                *value = 0.0;
            } else if !self.has(f) {
                return Err(self.absent(chain, f, *value));
            }
        }
        Ok(sum)
    }
}
