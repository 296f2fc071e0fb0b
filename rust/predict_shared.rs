//! What parameter sets with the same commands share: shapes, fields and cables at all frames, evaluated once.

use super::Predictor;
use super::job::Job;
use crate::error::Result;
use crate::loads::{CONTACT, FIELDS, PUSH, TIP_FORCE};
use crate::modes::accumulate;
use crate::shape::Shape;

/// A field (K, 3V) at all frames, and which it is.
pub type Apart = (usize, Vec<f64>);

/// What the members of a group share: the prior (K, 3V); the fields, if it pays to have each by itself; and what
/// `place_at` says (K, n), if anything loads it.
pub struct Shapes {
    pub prior: Vec<f64>,
    pub fields: Option<Vec<Apart>>,
    pub places: Vec<f64>,
    frames: usize,
}

impl Shapes {
    pub fn place(&self, k: usize) -> &[f64] {
        let size = self.places.len() / self.frames;
        &self.places[k * size..(k + 1) * size]
    }
}

/// Add the weighted fields at a frame.
pub fn add(fields: &[Apart], k: usize, weights: &[f64], frame: &mut [f64]) {
    let row = k * frame.len()..(k + 1) * frame.len();
    for (f, values) in fields {
        accumulate(frame, &values[row.clone()], weights[*f]);
    }
}

impl Predictor {
    /// For each group with several members, its shapes at all frames, evaluated once.
    pub(super) fn shared_shapes(&self, job: &Job) -> Result<Vec<Option<Shapes>>> {
        let (count, width) = (FIELDS.len(), self.body.fields.count());
        let mut wanted = vec![vec![false; width]; job.members.len()];
        for (b, group) in job.group.iter().enumerate() {
            if job.members[*group] == 1 {
                continue;
            }
            let wanted = &mut wanted[*group];
            for k in 0..job.frames {
                let loads = self.coefficients(job, b, k)?;
                let pairs = wanted.iter_mut().zip(&loads[..count]);
                pairs.for_each(|(wanted, load)| *wanted |= *load != 0.0);
                let loaded = loads.iter().any(|load| *load != 0.0);
                wanted[count..].iter_mut().for_each(|w| *w |= loaded);
                if loads[CONTACT] != 0.0 {
                    wanted[TIP_FORCE..TIP_FORCE + 3].fill(true);
                    wanted[PUSH..count].fill(true);
                }
            }
        }
        let shapes = |group: usize| Shapes {
            prior: job.each(group, self.body.prior.size(), |u, out| {
                job.bodies[group].prior.eval(u, out)
            }),
            fields: job.bodies[group]
                .fields
                .apart(&wanted[group], job.members[group])
                .map(|fields| {
                    let each = |(f, field): (usize, &dyn Shape)| {
                        (
                            f,
                            job.each(group, field.size(), |u, out| field.eval(u, out)),
                        )
                    };
                    fields.into_iter().map(each).collect()
                }),
            places: if wanted[group].contains(&true) {
                let there = std::array::from_fn(|f| wanted[group][f]);
                job.each(group, self.place_size(), |u, out| {
                    self.place_at(u, &there, out)
                })
            } else {
                vec![]
            },
            frames: job.frames,
        };
        let groups = job.members.iter().enumerate();
        Ok(groups
            .map(|(group, members)| (*members > 1).then(|| shapes(group)))
            .collect())
    }
}
