//! Complete records through a chain, for many parameter sets at once: effective commands at every
//! sample, or at the frame times only.

use super::{Chain, HEAD, Link};
use crate::effects::conditions::Conditions;
use crate::effects::declaration::Law;
use crate::error::{Result, invalid};
use crate::memory::zeros;
use rayon::prelude::*;

/// One parameter set with its record read at K positions.
struct Reader<'a> {
    params: &'a [f64],
    acting: &'a mut [f64],
    places: &'a [(usize, f64)],
}

impl Reader<'_> {
    /// Read records (T, n) of n numbers each, concatenated.
    fn read(self, records: &[(&[f64], usize)]) {
        let width = records.iter().map(|(_, n)| n).sum();
        let rows = self.acting.chunks_exact_mut(width);
        for (row, (k, share)) in rows.zip(self.places) {
            let mut at = 0;
            for (record, n) in records {
                let row = &mut row[at..at + n];
                at += n;
                row.copy_from_slice(&record[k * n..(k + 1) * n]);
                if *share != 0.0 {
                    let next = &record[(k + 1) * n..(k + 2) * n];
                    let pairs = row.iter_mut().zip(next);
                    pairs.for_each(|(a, b)| *a += share * (b - *a));
                }
            }
        }
    }
}

impl Chain {
    /// Advance a complete record (T, C) in place, effect by effect, from equilibrium with `held`
    /// (C,).
    fn advance(
        &self,
        params: &[f64],
        record: &mut [f64],
        state: &mut [f64],
        conditions: &Conditions,
        mut held: Option<Vec<f64>>,
    ) -> Result<()> {
        for link in &self.links {
            let memory = &mut state[link.state.clone()];
            self.pass(
                link,
                params,
                record,
                memory,
                conditions,
                held.as_deref_mut(),
            )?;
        }
        if let Some(end) = conditions.t().last().filter(|_| !record.is_empty()) {
            state[..HEAD].copy_from_slice(&[1.0, *end]);
        }
        Ok(())
    }

    /// Apply one effect to a record (T, C) and its initial value.
    fn pass(
        &self,
        link: &Link,
        params: &[f64],
        record: &mut [f64],
        memory: &mut [f64],
        conditions: &Conditions,
        held: Option<&mut [f64]>,
    ) -> Result<()> {
        let params = &params[link.params.clone()];
        match link.effect.law {
            Law::Channel(law) => {
                if let Some(x) = held {
                    law.settle(params, x, memory);
                }
                if !record.is_empty() {
                    law.rollout(params, record, self.channels, memory, conditions);
                }
            }
            Law::Record(law) if !record.is_empty() => {
                law.rollout(params, record, self.channels, conditions)?;
                if let Some(x) = held {
                    x.copy_from_slice(&record[..self.channels]);
                }
            }
            _ => {}
        }
        Ok(())
    }

    /// Effective commands (B, T, C) for parameters (B, P) on the commands `u` (T, C); sets run in
    /// parallel.
    ///
    /// `states` (B, S) are read, and updated to the end of the record. If empty, they start in
    /// equilibrium with `u[0]` and are filled. All states of a batch must have the same time.
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

    /// Effective commands and the memory of the shape effects, (B, K, C + M), from equilibrium with
    /// `u[0]`: for each set at its own K `places`, each a sample and the fraction to the next one.
    /// Sets with equal parameters of the first effects share their computation.
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
            &[places.len(), frames, self.channels + self.remembered],
        )?;
        let width = frames * (self.channels + self.remembered);
        if width == 0 {
            return Ok(out);
        }
        let sets = out.chunks_exact_mut(width).zip(places).enumerate();
        let sets = sets.map(|(b, (acting, places))| Reader {
            params: &params[b * self.width..(b + 1) * self.width],
            acting,
            places,
        });
        let held = u[..self.channels].to_vec();
        self.branch(&self.links, sets.collect(), u, held, &[], conditions)?;
        Ok(out)
    }

    /// Apply the effects `left` to a record and its initial value, for each of `sets`; `remembered`
    /// is the memory of the shape effects before them, (T, M) each.
    fn branch(
        &self,
        left: &[Link],
        sets: Vec<Reader>,
        record: &[f64],
        held: Vec<f64>,
        remembered: &[(&[f64], usize)],
        conditions: &Conditions,
    ) -> Result<()> {
        let Some((link, left)) = left.split_first() else {
            let records = [&[(record, self.channels)], remembered].concat();
            sets.into_par_iter().for_each(|set| set.read(&records));
            return Ok(());
        };
        let acts = matches!(
            link.effect.law,
            Law::Channel(_) | Law::Record(_) | Law::Remembering(_)
        );
        if !acts {
            return self.branch(left, sets, record, held, remembered, conditions);
        }
        let numbers = |set: &Reader| {
            let own = &set.params[link.params.clone()];
            own.iter().map(|x| x.to_bits()).collect::<Vec<_>>()
        };
        let mut alike: Vec<(Vec<u64>, Vec<Reader>)> = vec![];
        for set in sets {
            let own = numbers(&set);
            match alike.iter_mut().find(|(known, _)| *known == own) {
                Some((_, some)) => some.push(set),
                None => alike.push((own, vec![set])),
            }
        }
        alike.into_par_iter().try_for_each(|(_, sets)| {
            let params = sets[0].params;
            if let Law::Remembering(law) = link.effect.law {
                let count = link.remembered.len();
                let mut kept = vec![0.0; conditions.len() * count];
                law.remember(
                    &params[link.params.clone()],
                    record,
                    self.channels,
                    &mut kept,
                );
                let remembered = [remembered, &[(&kept[..], count)]].concat();
                return self.branch(left, sets, record, held.clone(), &remembered, conditions);
            }
            let (mut record, mut held) = (record.to_vec(), held.clone());
            let mut memory = vec![0.0; link.state.len()];
            let held_at = Some(&mut held[..]);
            self.pass(link, params, &mut record, &mut memory, conditions, held_at)?;
            self.branch(left, sets, &record, held, remembered, conditions)
        })
    }

    /// The memory of the shape effects (T, M) for a record (T, C) of effective commands.
    pub fn remember(&self, params: &[f64], record: &[f64], samples: usize) -> Vec<f64> {
        let mut out = vec![0.0; samples * self.remembered];
        for link in &self.links {
            let Law::Remembering(law) = link.effect.law else {
                continue;
            };
            let count = link.remembered.len();
            let mut kept = vec![0.0; samples * count];
            if count > 0 && samples > 0 {
                law.remember(
                    &params[link.params.clone()],
                    record,
                    self.channels,
                    &mut kept,
                );
            }
            let rows = out.chunks_exact_mut(self.remembered.max(1));
            for (row, kept) in rows.zip(kept.chunks_exact(count.max(1))) {
                row[link.remembered.clone()].copy_from_slice(kept);
            }
        }
        out
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
