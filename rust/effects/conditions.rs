//! The conditions of a record: time, gravity, load and temperature of every sample.

use crate::error::{Result, invalid};

/// The surroundings at one sample.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Context {
    /// Time, s, and time since the sample before, s (0 at the very first).
    pub t: f64,
    pub dt: f64,
    /// Unit vector of gravity in the base frame.
    pub gravity: [f64; 3],
    /// Declared tip load, g.
    pub load: f64,
    /// °C; NaN where the run has none.
    pub temperature: f64,
    /// Time of a frame since the first seen frame, s; 0 for a command.
    pub seen_for: f64,
}

/// The pose [R | t] of a camera, base frame → camera, which looks along its z.
pub type Camera = [[f64; 4]; 3];

/// The contexts of a record of T samples; undeclared conditions are constant.
#[derive(Debug, Clone)]
pub struct Conditions {
    t: Vec<f64>,
    dt: Vec<f64>,
    gravity: Vec<[f64; 3]>,
    load: Vec<f64>,
    temperature: Vec<f64>,
    cameras: Vec<Camera>,
}

impl Conditions {
    /// Contexts from columns of T numbers each; one number stands for a constant. `t` must not
    /// fall.
    pub fn new(
        t: Vec<f64>,
        gravity: Vec<[f64; 3]>,
        load: Vec<f64>,
        temperature: Vec<f64>,
    ) -> Result<Conditions> {
        if let Some(k) = (1..t.len()).find(|&k| t[k] < t[k - 1]) {
            return Err(invalid(format!(
                "t falls from {} to {} s at sample {k}; times must not run backwards, so sort the \
                record",
                t[k - 1],
                t[k]
            )));
        }
        let lengths = [
            ("gravity", gravity.len()),
            ("load", load.len()),
            ("temperature", temperature.len()),
        ];
        for (name, length) in lengths {
            if length != 1 && length != t.len() {
                return Err(invalid(format!(
                    "{name} has {length} samples, t has {}; give one for each or one for all",
                    t.len()
                )));
            }
        }
        let mut dt: Vec<f64> = t.windows(2).map(|w| w[1] - w[0]).collect();
        dt.insert(0, 0.0);
        Ok(Conditions {
            t,
            dt,
            gravity,
            load,
            temperature,
            cameras: vec![],
        })
    }

    /// The same conditions, with the poses of the cameras.
    pub fn seen_by(self, cameras: Vec<Camera>) -> Conditions {
        Conditions { cameras, ..self }
    }

    /// Poses of the cameras, empty if unknown.
    pub fn cameras(&self) -> &[Camera] {
        &self.cameras
    }

    /// Number of samples T.
    pub fn len(&self) -> usize {
        self.t.len()
    }

    pub fn is_empty(&self) -> bool {
        self.t.is_empty()
    }

    /// Times, s.
    pub fn t(&self) -> &[f64] {
        &self.t
    }

    /// Times since the sample before, s.
    pub fn dt(&self) -> &[f64] {
        &self.dt
    }

    /// Continue a record that ended at `before`: the first sample comes that much later.
    pub fn after(&mut self, before: f64) -> Result<()> {
        let Some(first) = self.t.first() else {
            return Ok(());
        };
        if *first < before {
            return Err(invalid(format!(
                "the record begins at {first} s, but the state was left at {before} s; times must \
                not run backwards"
            )));
        }
        self.dt[0] = first - before;
        Ok(())
    }

    /// The context of sample `k`. It cannot fail, so an effect pays only for the part that it
    /// reads.
    #[inline]
    pub fn at(&self, k: usize) -> Context {
        fn column<T: Copy>(values: &[T], k: usize, absent: T) -> T {
            *values.get(k).or(values.first()).unwrap_or(&absent)
        }
        Context {
            t: column(&self.t, k, 0.0),
            dt: column(&self.dt, k, 0.0),
            gravity: column(&self.gravity, k, [0.0, 0.0, 1.0]),
            load: column(&self.load, k, 0.0),
            temperature: column(&self.temperature, k, f64::NAN),
            seen_for: 0.0,
        }
    }

    /// The context at any time, linear between samples and constant beyond the ends.
    pub fn between(&self, t: f64) -> Context {
        if self.t.is_empty() {
            return Context { t, ..self.at(0) };
        }
        let (k, share) = bracket(&self.t, t);
        let (a, b) = (self.at(k), self.at((k + 1).min(self.len() - 1)));
        let mix = |from: f64, to: f64| {
            if share == 0.0 {
                from
            } else {
                from + share * (to - from)
            }
        };
        Context {
            t,
            dt: b.dt,
            gravity: [0, 1, 2].map(|i| mix(a.gravity[i], b.gravity[i])),
            load: mix(a.load, b.load),
            temperature: mix(a.temperature, b.temperature),
            seen_for: 0.0,
        }
    }
}

/// Position of `t` in increasing `times`: the previous sample and the fraction to the next.
/// Constant beyond both ends.
pub fn bracket(times: &[f64], t: f64) -> (usize, f64) {
    let last = times.len() - 1;
    if t <= times[0] {
        return (0, 0.0);
    }
    let k = times.partition_point(|sample| *sample <= t) - 1;
    if k >= last {
        return (last, 0.0);
    }
    (k, (t - times[k]) / (times[k + 1] - times[k]))
}
