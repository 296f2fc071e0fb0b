//! Column bank of one family: columns sampled at capture times, or applied to the command at full
//! rate.

use super::declaration::{Emit, Family};
use super::series::Series;
use super::{REGISTRY, find};
use crate::error::{Result, invalid};

/// Channel of each column (n,), and their samples (n, K) row by row.
pub type Sampled = (Vec<usize>, Vec<f64>);

/// Column bank of a family for C channels.
#[derive(Debug, Clone, Copy)]
pub struct Bank {
    family: &'static Family,
    channels: usize,
}

impl Bank {
    /// Create the bank of a family; a body without channels has columns of its fields alone.
    pub fn new(name: &str, channels: usize) -> Result<Bank> {
        let family = find(name).ok_or_else(|| {
            let names: Vec<&str> = REGISTRY.iter().map(|family| family.name).collect();
            invalid(format!(
                "unknown family {name:?}; available: {}",
                names.join(", ")
            ))
        })?;
        Ok(Bank { family, channels })
    }

    /// The declaration of the family.
    pub fn family(&self) -> &'static Family {
        self.family
    }

    /// Number of channels C.
    pub fn channels(&self) -> usize {
        self.channels
    }

    /// Sample the columns at the times `at` (K,), linear between samples. Returns the channel (n,)
    /// and the samples (n, K) mm. There are none if the series lacks, or does not vary, what the
    /// family needs.
    pub fn columns(&self, series: &Series, at: &[f64]) -> Result<Sampled> {
        self.check(series)?;
        let Some(columns) = self.family.columns else {
            return Ok((vec![], vec![]));
        };
        Ok(sampled(series, at, columns))
    }

    /// Compute the effective command (T, C) mm with column weights `theta` (n,).
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
                "theta has {} weights, but family {:?} has {count} columns on this series",
                theta.len(),
                self.family.name
            )));
        }
        let samples = 0..series.samples();
        Ok(samples
            .flat_map(|k| acting.iter().map(move |channel| channel[k]))
            .collect())
    }

    /// Compute the rows (m, K) that multiply each field at the times `at` (K,). There are none for
    /// a family without fields.
    pub fn modulation(&self, series: &Series, at: &[f64]) -> Result<Vec<f64>> {
        self.check(series)?;
        let mut rows = vec![];
        if self.family.has_fields() {
            (self.family.modulation)(&series.seen(at), &mut |row| rows.extend_from_slice(row));
        }
        Ok(rows)
    }

    /// Sample the signals in half ranges at the times `at` (K,). Returns the channel (n,) and the
    /// samples (n, K). `wide` selects the spacing for models whose static map is learned together
    /// with the memory.
    pub fn signals(&self, series: &Series, at: &[f64], wide: bool) -> Result<Sampled> {
        self.check(series)?;
        let Some(signals) = self.family.signals else {
            let with: Vec<&str> = REGISTRY
                .iter()
                .filter(|family| family.signals.is_some())
                .map(|family| family.name)
                .collect();
            return Err(invalid(format!(
                "family {:?} has no signals; families with signals: {}",
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
            "the series has {} channels, but the bank has {}",
            series.channels(),
            self.channels
        )))
    }
}

/// Sample the columns that `give` emits for each channel.
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
