//! A chain of effects in stage order: its parameters, single samples, loads and sensing;
//! `chain_record.rs` has records.
//!
//! The chain is feed-forward, so a record is evaluated effect by effect, each over all its samples.
//! A state slice holds a flag for a known time, that time, then the memory of every effect in
//! order.

use super::conditions::Context;
use super::declaration::*;
use super::{find, registry};
use crate::error::{Result, invalid};
use std::ops::Range;

/// An effect and its ranges in the parameter and state slices.
#[derive(Debug, Clone)]
struct Link {
    effect: &'static Effect,
    params: Range<usize>,
    state: Range<usize>,
    /// Range of a shape effect in the memory of all shape effects of the chain.
    remembered: Range<usize>,
}

/// Effects composed in stage order for a number of channels.
#[derive(Debug, Clone)]
pub struct Chain {
    links: Vec<Link>,
    channels: usize,
    width: usize,
    memory: usize,
    remembered: usize,
}

/// Most channels of a tendon robot; a larger count is a mistake that would exhaust the memory.
const MAX_CHANNELS: usize = 256;

/// The head of a state: 1 once a sample has been seen, and its time.
const HEAD: usize = 2;

impl Chain {
    /// Compose the effects called `names`, given in any order.
    pub fn new(names: &[String], channels: usize) -> Result<Chain> {
        if channels > MAX_CHANNELS {
            return Err(invalid(format!(
                "a chain for {channels} channels; 0 to {MAX_CHANNELS} are allowed, so check the \
                robot's command"
            )));
        }
        for (i, name) in names.iter().enumerate() {
            if find(name).is_none() {
                let known: Vec<_> = registry()
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
        let (mut width, mut memory, mut shapes) = (0, HEAD, 0);
        let chosen = registry()
            .into_iter()
            .filter(|effect| names.iter().any(|name| name == effect.declaration.name));
        let links = chosen
            .map(|effect| {
                let params = width..width + effect.declaration.width(channels);
                let size = match effect.law {
                    Law::Channel(law) => law.state_size(channels),
                    _ => 0,
                };
                let state = memory..memory + size;
                let kept = match effect.law {
                    Law::Remembering(law) => law.memory(channels),
                    _ => 0,
                };
                let remembered = shapes..shapes + kept;
                (width, memory, shapes) = (params.end, state.end, remembered.end);
                Link {
                    effect,
                    params,
                    state,
                    remembered,
                }
            })
            .collect();
        Ok(Chain {
            links,
            channels,
            width,
            memory,
            remembered: shapes,
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
                let indices = parameter.indices(self.channels);
                all.extend(
                    indices
                        .iter()
                        .map(|index| (label.clone() + index, parameter)),
                );
            }
        }
        all
    }

    /// The label (P,) of the group of each parameter: `backlash.gap` for `backlash.gap[0]`.
    pub fn group_labels(&self) -> Vec<String> {
        let bare = |label: &str| label.split('[').next().unwrap_or_default().to_string();
        let all = self.parameters().into_iter();
        all.map(|(label, p)| if p.tied() { bare(&label) } else { label })
            .collect()
    }

    /// The group (P,) of each parameter: the numbers of one shared parameter are one group, any
    /// other is its own group.
    pub fn tie(&self) -> Vec<usize> {
        let (mut groups, mut next) = (Vec::with_capacity(self.width), 0);
        for parameter in self
            .links
            .iter()
            .flat_map(|link| link.effect.declaration.parameters)
        {
            let (count, shared) = (parameter.count(self.channels), parameter.tied());
            groups.extend((0..count).map(|i| if shared { next } else { next + i }));
            next = groups.last().map_or(next, |last| last + 1);
        }
        groups
    }

    /// Parameters (B, P) of sets with one number for each shared parameter, (B, G): one for each
    /// group of [`Chain::tie`].
    pub fn spread(&self, params: &[f64], groups: usize) -> Vec<f64> {
        let tie = self.tie();
        let sets = params.chunks_exact(groups.max(1));
        sets.flat_map(|set| tie.iter().map(|group| set[*group]))
            .collect()
    }

    /// Reject parameters (P,) that are invalid for an effect.
    pub fn check(&self, params: &[f64]) -> Result<()> {
        if params.len() != self.width {
            return Err(invalid(format!(
                "{} parameters expected, got {}",
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

    /// Size M of the memory of the shape effects.
    pub fn remembered(&self) -> usize {
        self.remembered
    }

    /// The first parameters, which determine the effective commands and the memory: those of
    /// channel effects, which come first in stage order, and of shape effects with a memory.
    pub fn acting_width(&self) -> usize {
        let acts = |link: &&Link| {
            link.effect.law.role() == "channel" || matches!(link.effect.law, Law::Remembering(_))
        };
        let links = self.links.iter().filter(acts);
        links.map(|link| link.params.end).max().unwrap_or(0)
    }

    fn channel_links(&self) -> impl Iterator<Item = (&Link, &'static dyn ChannelEffect)> {
        self.links.iter().filter_map(|link| match link.effect.law {
            Law::Channel(law) => Some((link, law)),
            _ => None,
        })
    }

    /// Reject single samples if a user-defined effect maps only complete records. A control loop
    /// checks this first.
    pub fn stepwise(&self) -> Result<()> {
        let whole = |link: &&Link| matches!(link.effect.law, Law::Record(_));
        let name = |link: &Link| link.effect.declaration.name;
        self.links
            .iter()
            .find(whole)
            .map(name)
            .map_or(Ok(()), |name| {
                Err(invalid(format!(
                    "'{name}' is a Python effect: it maps full records and has no state to start, \
                 step or continue, so not in the control loop; write it in Rust, see \
                 docs/do/own_effect.md"
                )))
            })
    }

    /// The state in equilibrium with `u` (C,) held forever.
    pub fn init(&self, params: &[f64], u: &[f64]) -> Result<Vec<f64>> {
        self.stepwise()?;
        let (mut state, mut x) = (vec![0.0; self.memory], u.to_vec());
        self.settle(params, &mut x, &mut state);
        Ok(state)
    }

    /// The same in the caller's storage: `x` (C,) held forever becomes the effective command, and
    /// `state` the equilibrium.
    pub fn settle(&self, params: &[f64], x: &mut [f64], state: &mut [f64]) {
        state.fill(0.0);
        for (link, law) in self.channel_links() {
            let memory = &mut state[link.state.clone()];
            law.settle(&params[link.params.clone()], x, memory);
        }
    }

    /// The channel effects that are not of one family, and their part of `params` (P,).
    pub fn without(&self, params: &[f64], family: &str) -> Result<(Chain, Vec<f64>)> {
        let stays = |link: &&Link| {
            link.effect.law.role() == "channel" && link.effect.declaration.family != family
        };
        let links: Vec<&Link> = self.links.iter().filter(stays).collect();
        let name = |link: &&Link| link.effect.declaration.name.to_string();
        let chain = Chain::new(&links.iter().map(name).collect::<Vec<_>>(), self.channels)?;
        let own = |link: &&Link| params[link.params.clone()].to_vec();
        Ok((chain, links.iter().flat_map(own).collect()))
    }

    /// Advance one sample: `x` (C,) becomes the effective command; `state` is updated.
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

    /// The time of a state, if known.
    pub fn left_at(&self, state: &[f64]) -> Option<f64> {
        (state[0] > 0.0).then_some(state[1])
    }

    /// Check parameters (B, P) and return B.
    pub fn sets(&self, params: &[f64]) -> Result<usize> {
        if self.width == 0 {
            return Ok(1);
        }
        if !params.len().is_multiple_of(self.width) {
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

    /// Coefficients that the shape effects add at the effective command `u` (C,) with the memory
    /// `remembered` (M,), in one context.
    pub fn coefficients(
        &self,
        params: &[f64],
        u: &[f64],
        remembered: &[f64],
        context: &Context,
    ) -> Coefficients {
        let mut out = [0.0; CONTACT + 8];
        for link in &self.links {
            let params = &params[link.params.clone()];
            match link.effect.law {
                Law::Shape(law) => law.add(params, u, context, &mut out),
                Law::Remembering(law) => {
                    let own = &remembered[link.remembered.clone()];
                    law.add(params, u, own, context, &mut out);
                }
                _ => {}
            }
        }
        out
    }

    /// Each coefficient (a field, [`TENDON`] or [`CONTACT`]) that a shape effect of the chain uses,
    /// with the effect's name.
    pub fn fields(&self) -> Vec<(usize, &'static str)> {
        let mut used = vec![];
        for link in &self.links {
            let fields = match link.effect.law {
                Law::Shape(law) => law.fields(self.channels),
                Law::Remembering(law) => law.fields(self.channels),
                _ => vec![],
            };
            let name = link.effect.declaration.name;
            used.extend(fields.into_iter().map(|field| (field, name)));
        }
        used
    }

    /// Each number of the prior that an effect of the chain changes, with its factor.
    pub fn factors(&self, params: &[f64]) -> Vec<(&'static str, f64)> {
        let factor = |link: &Link| match link.effect.law {
            Law::Prior(law) => Some((law.number(), law.factor(&params[link.params.clone()]))),
            _ => None,
        };
        self.links.iter().filter_map(factor).collect()
    }

    /// Names of the numbers of the prior that the chain changes.
    pub fn numbers(&self) -> Vec<&'static str> {
        let number = |link: &Link| match link.effect.law {
            Law::Prior(law) => Some(law.number()),
            _ => None,
        };
        self.links.iter().filter_map(number).collect()
    }

    /// Whether a sensing effect is in the chain.
    pub fn senses(&self) -> bool {
        let mut links = self.links.iter();
        links.any(|link| matches!(link.effect.law, Law::Sensing(_)))
    }

    /// Delay of the time stamps of frames, s.
    pub fn late(&self, params: &[f64]) -> f64 {
        let late = |link: &Link| match link.effect.law {
            Law::Sensing(law) => law.late(&params[link.params.clone()]),
            _ => 0.0,
        };
        self.links.iter().map(late).sum()
    }

    /// Apply the sensing effects to `points` (V, 3) in place.
    pub fn sense(
        &self,
        params: &[f64],
        positions: &[bool],
        points: &mut [f64],
        context: &Context,
        cameras: &[Camera],
    ) {
        for link in &self.links {
            if let Law::Sensing(law) = link.effect.law {
                law.apply(
                    &params[link.params.clone()],
                    positions,
                    points,
                    context,
                    cameras,
                );
            }
        }
    }
}

#[path = "chain_record.rs"]
mod record;

#[cfg(test)]
#[path = "chain_tests.rs"]
mod tests;
