//! What loads the body in one call: the distinct loads of all sets and frames, and bodies of their own for those that recur.
//!
//! A run declares few directions of gravity and few weights, and most shape effects add the same at every frame: hundreds of
//! frames share their coefficients. Under loads that recur the body answers as one with two loads, all dead ones and all
//! changes of design (`answer.rs`), at a third of the price and with the same answer.

use super::job::Job;
use super::{NEGLIGIBLE, Predictor, Scratch};
use crate::answer::Answer;
use crate::error::Result;
use crate::fields::Fields;
use crate::loads::{CONTACT, Coefficients, FIELDS, GRAVITY, LOADS, TIP_FORCE, weight};
use std::collections::HashMap;
use std::sync::{Arc, Mutex};

/// Frames that must share their loads for a body of their own to pay, and the most such bodies that are kept.
const MANY: usize = 32;
const KEPT: usize = 64;

/// Coefficients, bit by bit.
type Key = [u64; CONTACT + 8];

fn key(loads: &Coefficients) -> Key {
    loads.map(f64::to_bits)
}

/// The body under certain loads: the dead ones are its first load, changes of design its second.
pub struct Pose {
    fields: Fields,
    answer: Answer,
    amount: [f64; 2],
    gives: f64,
}

impl Pose {
    /// Add to `out` what its loads do at a command.
    pub fn add(&self, u: &[f64], scratch: &mut Scratch, out: &mut [f64]) {
        let place = &mut scratch.place[..self.answer.size()];
        let weights = &mut scratch.weights[..self.fields.count()];
        self.answer.at(u, &[true], place);
        self.answer
            .weigh(&self.amount, self.gives, place, weights, &mut scratch.work);
        self.fields.add(u, weights, &mut scratch.field, out);
    }
}

/// Bodies that were made.
pub type Poses = Mutex<HashMap<Key, Arc<Pose>>>;

/// Distinct loads of a call.
pub struct Acting {
    /// Which of the distinct ones acts, (B, K).
    of: Vec<u32>,
    distinct: Vec<Coefficients>,
    poses: Vec<Option<Arc<Pose>>>,
    frames: usize,
}

impl Acting {
    /// Which loads act on a set at a frame.
    pub fn of(&self, b: usize, k: usize) -> usize {
        self.of[b * self.frames + k] as usize
    }

    /// The loads, and the body that is theirs.
    pub fn get(&self, which: usize) -> (&Coefficients, Option<&Pose>) {
        (&self.distinct[which], self.poses[which].as_deref())
    }
}

impl Predictor {
    /// What acts on all sets at all frames.
    pub(super) fn loads(&self, job: &Job, sets: usize) -> Result<Acting> {
        let (mut of, mut count) = (Vec::with_capacity(sets * job.frames), vec![]);
        let mut distinct: Vec<Coefficients> = vec![];
        let mut known: HashMap<Key, usize> = HashMap::new();
        let mut last = None;
        for b in 0..sets {
            for k in 0..job.frames {
                let loads = self.coefficients(job, b, k)?;
                let which = match last {
                    Some(which) if distinct[which] == loads => which,
                    _ => *known.entry(key(&loads)).or_insert(distinct.len()),
                };
                if which == distinct.len() {
                    distinct.push(loads);
                    count.push(0);
                }
                count[which] += 1;
                last = Some(which);
                of.push(which as u32);
            }
        }
        let pose = |(loads, count): (&Coefficients, usize)| {
            let recur = count >= MANY && loads.iter().any(|c| *c != 0.0) && loads[CONTACT] == 0.0;
            if recur { self.pose(loads) } else { Ok(None) }
        };
        let poses = distinct.iter().zip(count).map(pose);
        Ok(Acting {
            poses: poses.collect::<Result<_>>()?,
            of,
            distinct,
            frames: job.frames,
        })
    }

    fn pose(&self, loads: &Coefficients) -> Result<Option<Arc<Pose>>> {
        let kept = || {
            self.poses
                .lock()
                .unwrap_or_else(|broken| broken.into_inner())
        };
        if let Some(pose) = kept().get(&key(loads)) {
            return Ok(Some(pose.clone()));
        }
        let (mut dead, mut design) = ([0.0; FIELDS.len()], [0.0; FIELDS.len()]);
        dead[..LOADS].copy_from_slice(&loads[..LOADS]);
        design[LOADS..].copy_from_slice(&loads[LOADS..FIELDS.len()]);
        let both = [&dead[..], &design[..]];
        let Some(fields) = self.body.fields.under(&both) else {
            return Ok(None);
        };
        let there = |loads: &[f64]| f64::from(loads.iter().any(|c| *c != 0.0));
        let pose = Arc::new(Pose {
            fields,
            answer: self.answer.under(&both)?,
            amount: both.map(there),
            gives: loads[crate::loads::TENDON],
        });
        let mut kept = kept();
        if kept.len() >= KEPT {
            kept.clear();
        }
        kept.insert(key(loads), pose.clone());
        Ok(Some(pose))
    }

    /// Coefficients of the fields for a set at a frame, what the run declares among them; a field that is wanted but absent is
    /// an error.
    fn coefficients(&self, job: &Job, b: usize, k: usize) -> Result<Coefficients> {
        let (width, context) = (job.chain.width(), job.context(b, k));
        let set = &job.params[b * width..(b + 1) * width];
        let u = job.at(job.group[b], k);
        let mut sum = job.chain.coefficients(set, u, context);
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
                return Err(self.absent(job.chain, f, *value));
            }
        }
        Ok(sum)
    }
}
