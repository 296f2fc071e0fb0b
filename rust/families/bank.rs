//! The columns of one family on a series: sampled at the seen times, or added up at full rate.

use super::declaration::{Emit, Family};
use super::series::Series;
use super::{REGISTRY, find};
use crate::error::{Result, invalid};

/// Columns by channel: on which channel each of n acts, and n rows of K samples one after the other.
pub type Sampled = (Vec<usize>, Vec<f64>);

/// A family for robots of C channels.
#[derive(Debug, Clone, Copy)]
pub struct Bank {
    family: &'static Family,
    channels: usize,
}

impl Bank {
    /// The bank of the family of that name.
    pub fn new(name: &str, channels: usize) -> Result<Bank> {
        let family = find(name).ok_or_else(|| {
            let names: Vec<&str> = REGISTRY.iter().map(|family| family.name).collect();
            invalid(format!(
                "there is no family {name:?}; there are {}",
                names.join(", ")
            ))
        })?;
        if channels == 0 {
            return Err(invalid("a bank needs one channel or more"));
        }
        Ok(Bank { family, channels })
    }

    /// What the family declares.
    pub fn family(&self) -> &'static Family {
        self.family
    }

    /// Number of channels C.
    pub fn channels(&self) -> usize {
        self.channels
    }

    /// The columns (n, K) mm at the times `at` (K,), linear between samples, and the channel of each. None where the series
    /// does not vary in what the family needs.
    pub fn columns(&self, series: &Series, at: &[f64]) -> Result<Sampled> {
        self.check(series)?;
        let Some(columns) = self.family.columns else {
            return Ok((vec![], vec![]));
        };
        Ok(sampled(series, at, columns))
    }

    /// What acts (T, C) mm with the weights `theta` (n,) of the columns.
    pub fn applied(&self, series: &Series, theta: &[f64]) -> Result<Vec<f64>> {
        self.check(series)?;
        let mut acting = series.v.clone();
        let mut count = 0;
        if let Some(columns) = self.family.columns {
            for (channel, acting) in acting.iter_mut().enumerate() {
                columns(series, channel, &mut |column| {
                    if let Some(weight) = theta.get(count) {
                        let pairs = acting.iter_mut().zip(column);
                        pairs.for_each(|(acting, column)| *acting += weight * column);
                    }
                    count += 1;
                });
            }
        }
        if count != theta.len() {
            return Err(invalid(format!(
                "theta has {} weights, the family {:?} has {count} columns on this series",
                theta.len(),
                self.family.name
            )));
        }
        let samples = 0..series.samples();
        Ok(samples
            .flat_map(|k| acting.iter().map(move |channel| channel[k]))
            .collect())
    }

    /// The rows (m, K) that multiply each field at the times `at` (K,); none for a family without fields.
    pub fn modulation(&self, series: &Series, at: &[f64]) -> Result<Vec<f64>> {
        self.check(series)?;
        let mut rows = vec![];
        if self.family.has_fields() {
            (self.family.modulation)(&series.seen(at), &mut |row| rows.extend_from_slice(row));
        }
        Ok(rows)
    }

    /// The signals (n, K) in half ranges at the times `at` (K,), and the channel of each; `wide` where the static map is
    /// learned with them.
    pub fn signals(&self, series: &Series, at: &[f64], wide: bool) -> Result<Sampled> {
        self.check(series)?;
        let Some(signals) = self.family.signals else {
            let with: Vec<&str> = REGISTRY
                .iter()
                .filter(|family| family.signals.is_some())
                .map(|family| family.name)
                .collect();
            return Err(invalid(format!(
                "the family {:?} has no signals; those that have are {}",
                self.family.name,
                with.join(", ")
            )));
        };
        Ok(sampled(series, at, |series, channel, emit| {
            signals(series, channel, wide, emit);
        }))
    }

    fn check(&self, series: &Series) -> Result<()> {
        if series.channels() == self.channels {
            return Ok(());
        }
        Err(invalid(format!(
            "the series has {} channels, the bank {}",
            series.channels(),
            self.channels
        )))
    }
}

/// Sample what each channel gives at the times `at`.
fn sampled(series: &Series, at: &[f64], give: impl Fn(&Series, usize, Emit)) -> Sampled {
    let sampler = series.sampler(at);
    let (mut which, mut weight) = (vec![], vec![]);
    for channel in 0..series.channels() {
        give(series, channel, &mut |column| {
            which.push(channel);
            sampler.sample(column, &mut weight);
        });
    }
    (which, weight)
}
