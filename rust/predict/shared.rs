//! Data shared by parameter sets with the same commands: shapes at all frames, evaluated once.

use super::Predictor;
use super::job::Job;
use super::loads::{Acting, Load};
use crate::error::Result;
use rayon::prelude::*;

/// Shared data of a group at all frames: the prior (K, 3V), alone and under the loads of the first
/// member.
pub struct Shapes {
    prior: Vec<f64>,
    loaded: Vec<f64>,
    first: usize,
}

impl Shapes {
    /// Write the shared part of a member's shape at a frame to `out` (3V,); true if it is the
    /// complete shape, with loads.
    pub fn copy(
        &self,
        predictor: &Predictor,
        job: &Job,
        (b, k): (usize, usize),
        acting: &Acting,
        out: &mut [f64],
    ) -> Result<bool> {
        let row = k * out.len()..(k + 1) * out.len();
        let both = (acting.of(b, k), acting.of(self.first, k));
        let alike = match both {
            (Load::Other, Load::Other) => {
                let first = predictor.coefficients(job, self.first, k)?;
                predictor.coefficients(job, b, k)? == first
            }
            (own, first) => own == first,
        };
        let known = if alike { &self.loaded } else { &self.prior };
        out.copy_from_slice(&known[row]);
        Ok(alike)
    }
}

impl Predictor {
    /// For each group with several members, its shapes at all frames, evaluated once.
    pub(super) fn shared_shapes(&self, job: &Job, acting: &Acting) -> Result<Vec<Option<Shapes>>> {
        let size = self.body.prior.size();
        let shapes = |group: usize| {
            let Some(first) = job.group.iter().position(|g| *g == group) else {
                return Ok(None);
            };
            let mut prior = vec![0.0; job.frames * size];
            let mut loaded = prior.clone();
            let rows = prior.par_chunks_exact_mut(size);
            let rows = rows.zip(loaded.par_chunks_exact_mut(size)).enumerate();
            rows.try_for_each_init(
                || self.scratch(),
                |scratch, (k, (alone, out))| {
                    self.bend(job, (group, k), scratch, alone);
                    out.copy_from_slice(alone);
                    self.load(job, (first, k), acting, scratch, out)
                },
            )?;
            Ok(Some(Shapes {
                prior,
                loaded,
                first,
            }))
        };
        let groups = job.members.iter().enumerate();
        groups
            .map(|(group, members)| {
                if *members > 1 {
                    shapes(group)
                } else {
                    Ok(None)
                }
            })
            .collect()
    }
}
