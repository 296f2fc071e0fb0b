//! A chain of effects in stage order: simulate a record, advance one sample, peek, and do many parameter sets at once.
//!
//! The chain is feed-forward, so a record is evaluated effect by effect, each over all its samples. A state slice holds
//! whether it has seen a time, that time, then the memory of every effect in order; it is all there is to remember.

use super::conditions::{Conditions, Context};
use super::declaration::*;
use super::{REGISTRY, find};
use crate::error::{Result, invalid};
use crate::room::{room, zeros};
use rayon::prelude::*;
use std::ops::Range;

/// An effect and where its numbers lie in the parameter and state slices.
#[derive(Debug, Clone)]
struct Link {
    effect: &'static Effect,
    params: Range<usize>,
    state: Range<usize>,
}

/// Effects composed in stage order for a number of channels.
#[derive(Debug, Clone)]
pub struct Chain {
    links: Vec<Link>,
    channels: usize,
    width: usize,
    memory: usize,
}

/// No tendon robot has more; beyond, a count is a mistake that would ask for all the memory there is.
const MAX_CHANNELS: usize = 256;

/// The head of a state: 1 once a sample has been seen, and its time.
const HEAD: usize = 2;

impl Chain {
    /// Compose the effects called `names`, in whatever order they are given.
    pub fn new(names: &[String], channels: usize) -> Result<Chain> {
        if channels > MAX_CHANNELS {
            return Err(invalid(format!(
                "a chain for {channels} channels; 0 to {MAX_CHANNELS} are allowed, so check the robot's command"
            )));
        }
        for (i, name) in names.iter().enumerate() {
            if find(name).is_none() {
                let known: Vec<_> = REGISTRY
                    .iter()
                    .map(|effect| effect.declaration.name)
                    .collect();
                return Err(invalid(format!(
                    "no effect '{name}'; there are {}",
                    known.join(", ")
                )));
            }
            if names[..i].contains(name) {
                return Err(invalid(format!(
                    "the effect '{name}' stands twice in the chain; once is allowed"
                )));
            }
        }
        let (mut width, mut memory) = (0, HEAD);
        let chosen = REGISTRY
            .iter()
            .filter(|effect| names.iter().any(|name| name == effect.declaration.name));
        let links = chosen
            .map(|effect| {
                let params = width..width + effect.declaration.width(channels);
                let size = match effect.law {
                    Law::Channel(law) => law.state_size(channels),
                    _ => 0,
                };
                let state = memory..memory + size;
                (width, memory) = (params.end, state.end);
                Link {
                    effect,
                    params,
                    state,
                }
            })
            .collect();
        Ok(Chain {
            links,
            channels,
            width,
            memory,
        })
    }

    /// Number of channels C.
    pub fn channels(&self) -> usize {
        self.channels
    }

    /// Number of parameters P.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Numbers in a state, S.
    pub fn state_size(&self) -> usize {
        self.memory
    }

    /// Names of the effects, in stage order.
    pub fn names(&self) -> Vec<&'static str> {
        self.links
            .iter()
            .map(|link| link.effect.declaration.name)
            .collect()
    }

    /// Every parameter in order: its label (`backlash.gap`, `gain.factor[1]`) and its declaration.
    pub fn parameters(&self) -> Vec<(String, &'static Parameter)> {
        let mut all = Vec::with_capacity(self.width);
        for link in &self.links {
            for parameter in link.effect.declaration.parameters {
                let label = format!("{}.{}", link.effect.declaration.name, parameter.name);
                if parameter.per_channel {
                    all.extend((0..self.channels).map(|c| (format!("{label}[{c}]"), parameter)));
                } else {
                    all.push((label, parameter));
                }
            }
        }
        all
    }

    /// Refuse parameters (P,) that some effect cannot honour.
    pub fn check(&self, params: &[f64]) -> Result<()> {
        if params.len() != self.width {
            return Err(invalid(format!(
                "{} parameters wanted, got {}",
                self.width,
                params.len()
            )));
        }
        if let Some(bad) = params.iter().position(|value| !value.is_finite()) {
            let label = &self.parameters()[bad].0;
            return Err(invalid(format!(
                "{label} is {}; parameters must be finite numbers",
                params[bad]
            )));
        }
        self.channel_links()
            .try_for_each(|(link, law)| law.check(&params[link.params.clone()]))
    }

    /// The first parameters that belong to channel effects (they come first in stage order).
    pub fn channel_width(&self) -> usize {
        self.channel_links()
            .map(|(link, _)| link.params.end)
            .max()
            .unwrap_or(0)
    }

    fn channel_links(&self) -> impl Iterator<Item = (&Link, &'static dyn ChannelEffect)> {
        self.links.iter().filter_map(|link| match link.effect.law {
            Law::Channel(law) => Some((link, law)),
            _ => None,
        })
    }

    /// The state in equilibrium with `u` (C,) held forever.
    pub fn init(&self, params: &[f64], u: &[f64]) -> Vec<f64> {
        let (mut state, mut x) = (vec![0.0; self.memory], u.to_vec());
        for (link, law) in self.channel_links() {
            law.settle(
                &params[link.params.clone()],
                &mut x,
                &mut state[link.state.clone()],
            );
        }
        state
    }

    /// Advance one sample: `x` (C,) is changed to what acts, `state` remembers.
    pub fn step(&self, params: &[f64], x: &mut [f64], state: &mut [f64], context: &Context) {
        for (link, law) in self.channel_links() {
            law.step(
                &params[link.params.clone()],
                x,
                &mut state[link.state.clone()],
                context,
            );
        }
        state[..HEAD].copy_from_slice(&[1.0, context.t]);
    }

    /// The time a state was left at, if it has seen one.
    pub fn left_at(&self, state: &[f64]) -> Option<f64> {
        (state[0] > 0.0).then_some(state[1])
    }

    /// Advance a whole record (T, C) in place, effect by effect.
    pub fn advance(
        &self,
        params: &[f64],
        record: &mut [f64],
        state: &mut [f64],
        conditions: &Conditions,
    ) {
        if self.channels > 0 {
            for (link, law) in self.channel_links() {
                let memory = &mut state[link.state.clone()];
                law.rollout(
                    &params[link.params.clone()],
                    record,
                    self.channels,
                    memory,
                    conditions,
                );
            }
        }
        if let Some(end) = conditions.t().last() {
            state[..HEAD].copy_from_slice(&[1.0, *end]);
        }
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
        let samples = conditions.len();
        let sets = self.sets(params)?;
        if u.len() != samples * self.channels {
            return Err(invalid(format!(
                "u must be ({samples}, {}), got {} numbers",
                self.channels,
                u.len()
            )));
        }
        let mut out = zeros(
            "a record (parameter sets, samples, channels)",
            &[sets, u.len()],
        )?;
        if states.is_empty() {
            room("a state of every parameter set", &[sets, self.memory])?;
            let held: &[f64] = if samples > 0 {
                &u[..self.channels]
            } else {
                &vec![0.0; self.channels]
            };
            *states = (0..sets)
                .flat_map(|b| self.init(&params[b * self.width..(b + 1) * self.width], held))
                .collect();
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
        if !u.is_empty() {
            let conditions = &*conditions;
            out.par_chunks_exact_mut(u.len())
                .zip(states.par_chunks_exact_mut(self.memory))
                .enumerate()
                .for_each(|(b, (record, state))| {
                    record.copy_from_slice(u);
                    self.advance(
                        &params[b * self.width..(b + 1) * self.width],
                        record,
                        state,
                        conditions,
                    );
                });
        }
        Ok(out)
    }

    /// Check parameters (B, P) and return B.
    pub fn sets(&self, params: &[f64]) -> Result<usize> {
        if self.width == 0 {
            return Ok(1);
        }
        if params.len() % self.width != 0 {
            return Err(invalid(format!(
                "params must be (B, {}), got {} numbers",
                self.width,
                params.len()
            )));
        }
        params
            .chunks_exact(self.width)
            .try_for_each(|set| self.check(set))?;
        Ok(params.len() / self.width)
    }

    /// Coefficients of [`FIELDS`] that the shape effects add at one context.
    pub fn coefficients(&self, params: &[f64], context: &Context) -> Coefficients {
        let mut out = [0.0; FIELDS.len()];
        for link in &self.links {
            if let Law::Shape(law) = link.effect.law {
                law.add(&params[link.params.clone()], context, &mut out);
            }
        }
        out
    }

    /// Each field that a shape effect of the chain uses, with the effect's name.
    pub fn fields(&self) -> Vec<(usize, &'static str)> {
        let mut used = vec![];
        for link in &self.links {
            if let Law::Shape(law) = link.effect.law {
                used.extend(
                    law.fields()
                        .iter()
                        .map(|field| (*field, link.effect.declaration.name)),
                );
            }
        }
        used
    }

    /// Apply the sensing effects to `points` (V, 3) in place.
    pub fn sense(&self, params: &[f64], positions: &[bool], points: &mut [f64], context: &Context) {
        for link in &self.links {
            if let Law::Sensing(law) = link.effect.law {
                law.apply(&params[link.params.clone()], positions, points, context);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn chain(channels: usize) -> Chain {
        let names: Vec<String> = REGISTRY
            .iter()
            .map(|effect| effect.declaration.name.to_string())
            .collect();
        Chain::new(&names, channels).unwrap()
    }

    fn params(chain: &Chain, pick: impl Fn(&Parameter) -> f64) -> Vec<f64> {
        chain.parameters().iter().map(|(_, p)| pick(p)).collect()
    }

    fn world(t: Vec<f64>) -> Conditions {
        Conditions::new(t, vec![[0.0, 0.0, 1.0]], vec![0.0], vec![f64::NAN]).unwrap()
    }

    proptest! {
        #[test]
        fn splitting_a_record_changes_nothing(
            u in proptest::collection::vec(-15.0..15.0f64, 80), gaps in proptest::collection::vec(0.0..0.3f64, 40), at in 0..40usize,
        ) {
            let chain = chain(2);
            let t: Vec<f64> = gaps.iter().scan(0.0, |sum, gap| { *sum += gap; Some(*sum) }).collect();
            let p = params(&chain, |p| 0.5 * (p.null + p.high));
            let whole = chain.rollout(&p, &u, &mut world(t.clone()), &mut vec![]).unwrap();
            let mut state = chain.init(&p, &u[..2]);
            let mut parts = chain.rollout(&p, &u[..2 * at], &mut world(t[..at].to_vec()), &mut state).unwrap();
            parts.extend(chain.rollout(&p, &u[2 * at..], &mut world(t[at..].to_vec()), &mut state).unwrap());
            prop_assert_eq!(whole, parts);
        }

        #[test]
        fn whatever_comes_in_stays_bounded(
            u in proptest::collection::vec(-30.0..30.0f64, 120), gaps in proptest::collection::vec(0.0..50.0f64, 60), share in 0.0..1.0f64,
        ) {
            let chain = chain(2);
            let t: Vec<f64> = gaps.iter().scan(0.0, |sum, gap| { *sum += gap; Some(*sum) }).collect();
            let p = params(&chain, |p| p.low + share * (p.high - p.low));
            let out = chain.rollout(&p, &u, &mut world(t), &mut vec![]).unwrap();
            // Largest gain 1.3, offset 4 mm, then play 2 mm, held back 0.7·6.25 mm, creep 1.5.
            prop_assert!(out.iter().all(|x| x.abs() <= (30.0 * 1.3 + 4.0 + 2.0 + 4.5) * 1.5));
        }
    }

    #[test]
    fn a_batch_is_its_members() {
        let chain = chain(2);
        let t: Vec<f64> = (0..50).map(|k| 0.03 * k as f64).collect();
        let u: Vec<f64> = (0..100).map(|k| 9.0 * (0.13 * k as f64).sin()).collect();
        let sets = [
            params(&chain, |p| p.null),
            params(&chain, |p| p.start),
            params(&chain, |p| p.high),
        ];
        let batch = chain
            .rollout(&sets.concat(), &u, &mut world(t.clone()), &mut vec![])
            .unwrap();
        for (set, out) in sets.iter().zip(batch.chunks_exact(100)) {
            assert_eq!(
                chain
                    .rollout(set, &u, &mut world(t.clone()), &mut vec![])
                    .unwrap(),
                out
            );
        }
        assert_eq!(batch[..100], u, "null is the identity");
    }

    #[test]
    fn names_sort_themselves_and_mistakes_are_told() {
        let names = |list: &[&str]| list.iter().map(|name| name.to_string()).collect::<Vec<_>>();
        let chain = Chain::new(&names(&["mount", "backlash", "gain"]), 2).unwrap();
        assert_eq!(chain.names(), ["gain", "backlash", "mount"]);
        assert_eq!(chain.parameters()[1].0, "gain.factor[1]");
        let unknown = Chain::new(&names(&["gian"]), 2).unwrap_err().to_string();
        assert!(unknown.contains("'gian'") && unknown.contains("payload"));
        assert!(Chain::new(&names(&["lag", "lag"]), 2).is_err());
        assert!(chain.check(&[f64::NAN; 9]).is_err());
        let backwards = Conditions::new(vec![1.0, 0.5], vec![[0.0; 3]], vec![0.0], vec![0.0]);
        assert!(backwards.unwrap_err().to_string().contains("backwards"));
    }
}
