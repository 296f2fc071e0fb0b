//! Whole records through a chain, for many parameter sets at once: what acts at every sample, or at the seen times only.

use super::{Chain, HEAD};
use crate::effects::conditions::Conditions;
use crate::effects::declaration::Law;
use crate::error::{Result, invalid};
use crate::room::zeros;
use rayon::prelude::*;

impl Chain {
    /// Advance a whole record (T, C) in place, effect by effect; where it begins, from equilibrium with `held` (C,).
    fn advance(
        &self,
        params: &[f64],
        record: &mut [f64],
        state: &mut [f64],
        conditions: &Conditions,
        mut held: Option<Vec<f64>>,
    ) -> Result<()> {
        for link in &self.links {
            let params = &params[link.params.clone()];
            match link.effect.law {
                Law::Channel(law) => {
                    let memory = &mut state[link.state.clone()];
                    if let Some(x) = &mut held {
                        law.settle(params, x, memory);
                    }
                    if !record.is_empty() {
                        law.rollout(params, record, self.channels, memory, conditions);
                    }
                }
                Law::Record(law) if !record.is_empty() => {
                    law.rollout(params, record, self.channels, conditions)?;
                    if let Some(x) = &mut held {
                        x.copy_from_slice(&record[..self.channels]);
                    }
                }
                _ => {}
            }
        }
        if let Some(end) = conditions.t().last().filter(|_| !record.is_empty()) {
            state[..HEAD].copy_from_slice(&[1.0, *end]);
        }
        Ok(())
    }

    /// What acts, (B, T, C), for parameters (B, P) on the commands `u` (T, C); sets run in parallel.
    ///
    /// `states` (B, S) are read and left where the record ends; empty, they begin in equilibrium with `u[0]` and are
    /// filled. All states of a batch must have been left at one time.
    pub fn rollout(
        &self,
        params: &[f64],
        u: &[f64],
        conditions: &mut Conditions,
        states: &mut Vec<f64>,
    ) -> Result<Vec<f64>> {
        let sets = self.sets(params)?;
        self.fits(u, conditions)?;
        let mut out = zeros(
            "a record (parameter sets, samples, channels)",
            &[sets, u.len()],
        )?;
        let held = if !states.is_empty() {
            self.stepwise()?;
            None
        } else if u.is_empty() {
            Some(vec![0.0; self.channels])
        } else {
            Some(u[..self.channels].to_vec())
        };
        if held.is_some() {
            *states = zeros("a state of every parameter set", &[sets, self.memory])?;
        }
        if states.len() != sets * self.memory {
            return Err(invalid(format!(
                "state must be ({sets}, {}), got {} numbers",
                self.memory,
                states.len()
            )));
        }
        let mut left = states
            .chunks_exact(self.memory)
            .map(|state| self.left_at(state));
        if let Some(first) = left.next() {
            if left.any(|other| other != first) {
                return Err(invalid(
                    "the states of a batch were left at different times; advance them together",
                ));
            }
            first.map_or(Ok(()), |before| conditions.after(before))?;
        }
        let conditions = &*conditions;
        let one = |b: usize, record: &mut [f64], state: &mut [f64]| {
            record.copy_from_slice(u);
            let params = &params[b * self.width..(b + 1) * self.width];
            self.advance(params, record, state, conditions, held.clone())
        };
        let states = states.par_chunks_exact_mut(self.memory).enumerate();
        if u.is_empty() {
            states.try_for_each(|(b, state)| one(b, &mut [], state))?;
        } else {
            let records = out.par_chunks_exact_mut(u.len());
            let pairs = records.zip(states);
            pairs.try_for_each(|(record, (b, state))| one(b, record, state))?;
        }
        Ok(out)
    }

    /// What acts, (B, K, C), from equilibrium with `u[0]`: for each set at its own K `places`, each a sample and the share
    /// of the way to the next one. One record a thread is kept.
    pub fn acting(
        &self,
        params: &[f64],
        u: &[f64],
        conditions: &Conditions,
        places: &[&[(usize, f64)]],
    ) -> Result<Vec<f64>> {
        self.fits(u, conditions)?;
        let frames = places.first().map_or(0, |places| places.len());
        let mut out = zeros(
            "what acts (parameter sets, frames, channels)",
            &[places.len(), frames, self.channels],
        )?;
        let width = frames * self.channels;
        if width == 0 {
            return Ok(out);
        }
        out.par_chunks_exact_mut(width)
            .zip(places)
            .enumerate()
            .try_for_each_init(
                || (u.to_vec(), vec![0.0; self.memory]),
                |(record, state), (b, (acting, places))| {
                    record.copy_from_slice(u);
                    state.fill(0.0);
                    let params = &params[b * self.width..(b + 1) * self.width];
                    let held = Some(u[..self.channels].to_vec());
                    self.advance(params, record, state, conditions, held)?;
                    let rows = acting.chunks_exact_mut(self.channels);
                    for (row, (k, share)) in rows.zip(*places) {
                        let here = &record[k * self.channels..(k + 1) * self.channels];
                        row.copy_from_slice(here);
                        if *share != 0.0 {
                            let next = &record[(k + 1) * self.channels..(k + 2) * self.channels];
                            let pairs = row.iter_mut().zip(next);
                            pairs.for_each(|(a, b)| *a += share * (b - *a));
                        }
                    }
                    Ok(())
                },
            )?;
        Ok(out)
    }

    /// Refuse commands that are not (T, C).
    fn fits(&self, u: &[f64], conditions: &Conditions) -> Result<()> {
        let samples = conditions.len();
        if u.len() != samples * self.channels {
            return Err(invalid(format!(
                "u must be ({samples}, {}), got {} numbers",
                self.channels,
                u.len()
            )));
        }
        Ok(())
    }
}
