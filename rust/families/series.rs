//! Input of the families: the effective command of each channel at full rate, with the declared
//! conditions.
//!
//! The scaled command is x = (v − middle)/half, about ±1 over the run. Units: mm, s, °C.

use crate::effects::bracket;
use crate::error::{Result, invalid};

/// Added to the duration of a record, s: keeps the elapsed share below 1, and defined for a record
/// of zero duration.
const LONGER: f64 = 1e-9;

/// Effective commands of C channels at T times.
#[derive(Debug, Clone)]
pub struct Series {
    pub(super) t: Vec<f64>,
    /// Time since the previous sample, s; 0 at the first.
    pub(super) dt: Vec<f64>,
    /// Effective command by channel, in mm (`v`) and in half ranges (`x`).
    pub(super) v: Vec<Vec<f64>>,
    pub(super) x: Vec<Vec<f64>>,
    pub(super) half: Vec<f64>,
    /// Elapsed share of the duration, in [0, 1).
    pub(super) share: Vec<f64>,
    pub(super) temperature: Option<Vec<f64>>,
    pub(super) orientation: Option<Vec<i64>>,
    /// Codes of the orientations of this run, and of others that are fitted together with it;
    /// rising.
    pub(super) orientations: Vec<i64>,
    /// Whether the static map of the model was learned freely from measurements. Its error looks
    /// like small effects of single cables and of other channels.
    pub(super) free_map: bool,
}

impl Series {
    /// Create a series from `v` (T, C) mm at `t` (T,) s, with `middle` and `half` range (C,) mm of
    /// each channel. Optional conditions: `temperature` (T,) °C, and integer codes of the
    /// `orientation` (T,), one of `orientations`.
    pub fn new(
        v: &[f64],
        t: Vec<f64>,
        middle: &[f64],
        half: Vec<f64>,
        temperature: Option<Vec<f64>>,
        orientation: Option<Vec<i64>>,
        orientations: Option<Vec<i64>>,
    ) -> Result<Series> {
        let (samples, channels) = (t.len(), half.len());
        if samples < 2 || v.len() != samples * channels {
            return Err(invalid(format!(
                "v has {} numbers for t of {samples} samples and {channels} channels; give (T, C) \
                with T ≥ 2",
                v.len()
            )));
        }
        for (name, length, wanted) in [
            ("middle", middle.len(), channels),
            (
                "temperature",
                temperature.as_ref().map_or(samples, Vec::len),
                samples,
            ),
            (
                "orientation",
                orientation.as_ref().map_or(samples, Vec::len),
                samples,
            ),
        ] {
            if length != wanted {
                return Err(invalid(format!(
                    "{name} has {length} numbers, expected {wanted}"
                )));
            }
        }
        if let Some(k) = (1..samples).find(|&k| t[k] < t[k - 1]) {
            return Err(invalid(format!(
                "t falls from {} to {} s at sample {k}; times must not run backwards, so sort the \
                record",
                t[k - 1],
                t[k]
            )));
        }
        if let Some(c) = (0..channels).find(|&c| half[c].is_nan() || half[c] <= 0.0) {
            return Err(invalid(format!(
                "half is {} mm for channel {c}; half the range of a channel must be positive",
                half[c]
            )));
        }
        let mut orientations = orientations
            .or_else(|| orientation.clone())
            .unwrap_or_default();
        orientations.sort_unstable();
        orientations.dedup();
        let channel =
            |c: usize| -> Vec<f64> { v.iter().skip(c).step_by(channels).copied().collect() };
        let v: Vec<Vec<f64>> = (0..channels).map(channel).collect();
        let scaled = |c: usize| v[c].iter().map(|v| (v - middle[c]) / half[c]).collect();
        let x = (0..channels).map(scaled).collect();
        let mut dt: Vec<f64> = t.windows(2).map(|w| w[1] - w[0]).collect();
        dt.insert(0, 0.0);
        let whole = t[samples - 1] - t[0] + LONGER;
        let share = t.iter().map(|t_k| (t_k - t[0]) / whole).collect();
        Ok(Series {
            t,
            dt,
            v,
            x,
            half,
            share,
            temperature,
            orientation,
            orientations,
            free_map: false,
        })
    }

    /// Declare whether the static map of the model was learned freely from measurements.
    pub fn with_free_map(self, free_map: bool) -> Series {
        Series { free_map, ..self }
    }

    /// Number of samples T.
    pub fn samples(&self) -> usize {
        self.t.len()
    }

    /// Number of channels C.
    pub fn channels(&self) -> usize {
        self.half.len()
    }

    /// Prepare interpolation at the times `at` (K,).
    pub(super) fn sampler(&self, at: &[f64]) -> Sampler {
        Sampler(at.iter().map(|t| bracket(&self.t, *t)).collect())
    }

    /// Sample the commands at the times `at` (K,).
    pub(super) fn seen(&self, at: &[f64]) -> Seen {
        let sampler = self.sampler(at);
        let sample = |column: &Vec<f64>| {
            let mut out = Vec::with_capacity(at.len());
            sampler.sample(column, &mut out);
            out
        };
        Seen {
            x: self.x.iter().map(sample).collect(),
            share: sample(&self.share),
        }
    }
}

/// Commands at K capture times.
#[derive(Debug, Clone)]
pub struct Seen {
    /// Scaled command by channel.
    pub x: Vec<Vec<f64>>,
    /// Elapsed share of the duration.
    pub share: Vec<f64>,
}

/// Linear interpolation at fixed times: for each, the previous sample and the fraction of the way
/// to the next.
pub(super) struct Sampler(Vec<(usize, f64)>);

impl Sampler {
    /// Append a column (T,), interpolated linearly and held beyond both ends, to `out`.
    pub(super) fn sample(&self, column: &[f64], out: &mut Vec<f64>) {
        out.extend(self.0.iter().map(|&(k, share)| {
            if share == 0.0 {
                column[k]
            } else {
                column[k] + share * (column[k + 1] - column[k])
            }
        }));
    }
}
