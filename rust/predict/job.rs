//! The job of one predictor call: parameter sets in groups with shared shapes, and their effective
//! commands.

use crate::effects::{Camera, Chain, Conditions, Context, bracket};
use crate::error::{Result, invalid};
use crate::response::fields::Fields;
use crate::shape::Shape;
use std::collections::HashMap;
use std::sync::Arc;

/// The body: a prior and its fields.
#[derive(Clone)]
pub struct Body {
    pub prior: Arc<dyn Shape>,
    /// Fields of the dead loads, of the cables, and of the second order.
    pub fields: Arc<Fields>,
}

/// The job of one call.
pub struct Job<'a> {
    pub chain: &'a Chain,
    pub params: &'a [f64],
    /// Number of frames K.
    pub frames: usize,
    /// The conditions (K,) at the frames, for each clock: the shift of the time stamps.
    pub contexts: Vec<Vec<Context>>,
    pub cameras: Vec<Camera>,
    /// Clock of each group.
    pub clock: Vec<usize>,
    /// Group of each set (sets with equal parameters of effective commands, clock and numbers of
    /// the prior), number of sets in it, and its bending.
    pub group: Vec<usize>,
    pub members: Vec<usize>,
    pub bodies: Vec<Body>,
    /// u_eff and the memory of the shape effects, (groups, K, C + M) at the seen times.
    pub acting: Vec<f64>,
}

impl<'a> Job<'a> {
    /// Group the sets, apply the chain, and read it at the frame times.
    pub fn new(
        body: &Body,
        chain: &'a Chain,
        params: &'a [f64],
        sets: usize,
        u: &[f64],
        conditions: &Conditions,
        t_seen: &[f64],
    ) -> Result<Job<'a>> {
        let (width, channels) = (chain.width(), chain.channels());
        let mut numbers: HashMap<Vec<u64>, usize> = HashMap::new();
        let (mut group, mut members, mut chosen) = (vec![], vec![], vec![]);
        let (mut clock, mut shifts, mut bodies) = (vec![], vec![], vec![]);
        for b in 0..sets {
            let set = &params[b * width..(b + 1) * width];
            let (late, factors) = (chain.late(set), chain.factors(set));
            let key = set[..chain.acting_width()]
                .iter()
                .chain([&late])
                .chain(factors.iter().map(|(_, factor)| factor))
                .map(|value| value.to_bits())
                .collect();
            let number = *numbers.entry(key).or_insert(members.len());
            if number == members.len() {
                members.push(0);
                chosen.extend_from_slice(set);
                bodies.push(body.changed(&factors)?);
                let known = shifts.iter().position(|shift| *shift == late);
                clock.push(known.unwrap_or(shifts.len()));
                if known.is_none() {
                    shifts.push(late);
                }
            }
            members[number] += 1;
            group.push(number);
        }
        let read = |late: &f64| {
            let places = t_seen.iter().map(|t| bracket(conditions.t(), t - late));
            places.collect()
        };
        let read: Vec<Vec<_>> = if channels > 0 {
            shifts.iter().map(read).collect()
        } else {
            vec![vec![]; shifts.len()]
        };
        let places: Vec<_> = clock.iter().map(|c| read[*c].as_slice()).collect();
        let acting = chain.acting(&chosen, u, conditions, &places)?;
        let first = t_seen.first().copied().unwrap_or(0.0);
        let context = |late: &f64, t: &f64| Context {
            seen_for: t - first,
            ..conditions.between(t - late)
        };
        let contexts = shifts
            .iter()
            .map(|late| t_seen.iter().map(|t| context(late, t)).collect())
            .collect();
        Ok(Job {
            chain,
            params,
            frames: t_seen.len(),
            contexts,
            cameras: conditions.cameras().to_vec(),
            clock,
            group,
            members,
            bodies,
            acting,
        })
    }
}

impl Body {
    /// The same with some of the prior's own numbers multiplied, in its fields as well.
    pub(super) fn changed(&self, factors: &[(&'static str, f64)]) -> Result<Body> {
        let mut body = self.clone();
        for (name, factor) in factors.iter().filter(|(_, factor)| *factor != 1.0) {
            let prior = body.prior.with_number(name, *factor).ok_or_else(|| {
                let known = self.prior.numbers().join(", ");
                invalid(format!(
                    "an effect changes the number '{name}' of the prior by {factor:.3}; this prior \
                     has {}; leave that effect out",
                    if known.is_empty() {
                        "none to change"
                    } else {
                        &known
                    }
                ))
            })?;
            let fields = Arc::new(body.fields.with_number(name, *factor));
            body = Body { prior, fields };
        }
        Ok(body)
    }
}

impl Job<'_> {
    /// u_eff (C,) of a group at a seen frame.
    pub fn at(&self, group: usize, k: usize) -> &[f64] {
        &self.row(group, k)[..self.chain.channels()]
    }

    /// The memory of the shape effects (M,) of a group at a seen frame.
    pub fn remembered(&self, group: usize, k: usize) -> &[f64] {
        &self.row(group, k)[self.chain.channels()..]
    }

    fn row(&self, group: usize, k: usize) -> &[f64] {
        let width = self.chain.channels() + self.chain.remembered();
        let start = (group * self.frames + k) * width;
        &self.acting[start..start + width]
    }

    /// The world (K,) at the frames of a parameter set.
    pub fn world(&self, b: usize) -> &[Context] {
        &self.contexts[self.clock[self.group[b]]]
    }

    pub fn context(&self, b: usize, k: usize) -> &Context {
        &self.world(b)[k]
    }
}
