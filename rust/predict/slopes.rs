//! Effective commands, and the slopes of the frames over them, for linearised screening.
//!
//! `acting` is the chain alone, read at the frame times. `slopes` are central differences of
//! complete frames (prior, fields, cables, sensing) over the effective command. The caller sets
//! their steps: where tendons become slack under a load, the true slope jumps within a few
//! hundredths of a millimetre, and does not predict a change of half a millimetre.

use super::Predictor;
use super::job::Job;
use crate::effects::{Chain, Conditions};
use crate::error::{Result, invalid};

impl Predictor {
    /// Effective commands (B, K, C) at the frame times for parameters (B, P) on the commands `u`
    /// (T, C).
    pub fn acting(
        &self,
        chain: &Chain,
        params: &[f64],
        u: &[f64],
        conditions: &Conditions,
        t_seen: &[f64],
    ) -> Result<Vec<f64>> {
        let sets = chain.sets(params)?;
        self.agrees(chain, conditions, t_seen)?;
        let job = Job::new(&self.body, chain, params, sets, u, conditions, t_seen)?;
        let groups = job.group.iter();
        let frames = groups.flat_map(|g| (0..t_seen.len()).map(move |k| (*g, k)));
        Ok(frames.flat_map(|(g, k)| job.at(g, k)).copied().collect())
    }

    /// Slopes (C, K, V, 3) of the frames over the effective command, `step` (C,) to both sides, for
    /// one parameter set (P,).
    pub fn slopes(
        &self,
        chain: &Chain,
        params: &[f64],
        step: &[f64],
        u: &[f64],
        conditions: &Conditions,
        t_seen: &[f64],
    ) -> Result<Vec<f64>> {
        if chain.sets(params)? != 1 {
            return Err(invalid(
                "slopes are taken about one parameter set; give params (1, P)",
            ));
        }
        if step.len() != chain.channels() || step.iter().any(|h| !(h.is_finite() && *h > 0.0)) {
            return Err(invalid(format!(
                "steps {step:?} for {} channels; give each channel one above 0",
                chain.channels()
            )));
        }
        self.agrees(chain, conditions, t_seen)?;
        let (channels, frames) = (chain.channels(), t_seen.len());
        let job = Job::new(&self.body, chain, params, 1, u, conditions, t_seen)?;
        let (sides, width) = (2 * channels, channels + chain.remembered());
        let mut acting = Vec::with_capacity(sides * job.acting.len());
        for side in 0..sides {
            let moved = side / 2;
            let by = if side % 2 == 0 {
                step[moved]
            } else {
                -step[moved]
            };
            let each = job.acting.iter().enumerate();
            acting.extend(each.map(|(i, u)| u + if i % width == moved { by } else { 0.0 }));
        }
        let all = params.repeat(sides);
        let about = Job {
            chain,
            params: &all,
            frames,
            contexts: job.contexts,
            cameras: job.cameras,
            clock: vec![0; sides],
            group: (0..sides).collect(),
            members: vec![1; sides],
            bodies: vec![job.bodies[0].clone(); sides],
            acting,
        };
        let shapes = self.frames(&about, sides, frames)?;
        let size = frames * self.body.prior.size();
        let pairs = shapes.chunks_exact((2 * size).max(1));
        let slopes = pairs.zip(step).flat_map(|(pair, h)| {
            let (up, down) = pair.split_at(size);
            up.iter().zip(down).map(move |(a, b)| (a - b) / (2.0 * h))
        });
        Ok(slopes.collect())
    }
}
