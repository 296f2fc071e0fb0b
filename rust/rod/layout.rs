//! The fixed layout of an elastic-tendon rod: segments, commands, tendons, markers, and the order
//! of its numbers.

use crate::error::{Result, invalid};

const MOST_SEGMENTS: usize = 32;
const MOST_TENDONS: usize = 64;
const MOST_MARKERS: usize = 1000;

/// The end segment of a tendon (from 0), the command that shortens it (from 0), and mm per unit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Tendon {
    pub end: usize,
    pub channel: usize,
    pub pull: f64,
}

/// Segments, commands, tendons and markers of a rod.
#[derive(Debug, Clone)]
pub struct Layout {
    pub(super) segments: usize,
    pub(super) channels: usize,
    pub(super) tendons: Vec<Tendon>,
    /// Segment (from 0) and share of it, for each marker.
    pub(super) markers: Vec<(usize, f64)>,
    pub(super) first: First,
}

/// Index of the first number of each kind, in the order of `Layout::labels`. Slack is number 0.
#[derive(Debug, Clone, Copy)]
pub(super) struct First {
    pub angle: usize,
    pub radius: usize,
    pub pretension: usize,
    pub stiffness: usize,
    pub length: usize,
    pub rest: usize,
    pub base: usize,
    pub tilt: usize,
    pub end: usize,
}

impl Layout {
    /// `at` counts segments from the base: 3 is the end of the third, 2.5 the middle of it.
    pub fn new(segments: usize, channels: usize, tendons: Vec<Tendon>, at: &[f64]) -> Result<Self> {
        let n = tendons.len();
        if !(1..=MOST_SEGMENTS).contains(&segments) || n > MOST_TENDONS {
            return Err(invalid(format!(
                "a rod of {segments} segments and {n} tendons; 1 to {MOST_SEGMENTS} segments and \
                up to {MOST_TENDONS} tendons are allowed"
            )));
        }
        for (j, tendon) in tendons.iter().enumerate() {
            if tendon.end >= segments || tendon.channel >= channels {
                return Err(invalid(format!(
                    "tendon {} ends in segment {} and is drawn in by command {}; the rod has \
                    {segments} segments and {channels} commands",
                    j + 1,
                    tendon.end.saturating_add(1),
                    tendon.channel.saturating_add(1)
                )));
            }
            if !tendon.pull.is_finite() || tendon.pull == 0.0 {
                return Err(invalid(format!(
                    "tendon {} is drawn in by {} mm per unit of command; give a number other than \
                    0",
                    j + 1,
                    tendon.pull
                )));
            }
        }
        if !(1..=MOST_MARKERS).contains(&at.len()) {
            return Err(invalid(format!(
                "a rod with {} markers; 1 to {MOST_MARKERS} are allowed",
                at.len()
            )));
        }
        if let Some(bad) = at.iter().find(|&&x| !(x > 0.0 && x <= segments as f64)) {
            return Err(invalid(format!(
                "a marker at {bad} segments from the base of a rod that has {segments}; give more \
                than 0 and at most {segments}"
            )));
        }
        let within = |x: &f64| {
            let k = (x.ceil() as usize).clamp(1, segments) - 1;
            (k, x - k as f64)
        };
        Ok(Self {
            segments,
            channels,
            markers: at.iter().map(within).collect(),
            first: First {
                angle: 1,
                radius: 1 + n,
                pretension: 1 + 2 * n,
                stiffness: 1 + 3 * n,
                length: 1 + 3 * n + segments,
                rest: 1 + 3 * n + 2 * segments,
                base: 1 + 3 * n + 4 * segments,
                tilt: 4 + 3 * n + 4 * segments,
                end: 6 + 3 * n + 4 * segments,
            },
            tendons,
        })
    }

    /// The names of a rod's numbers, in order.
    pub fn labels(&self) -> Vec<String> {
        let (n, s) = (self.tendons.len(), self.segments);
        let kinds = [
            ("angle", n),
            ("radius", n),
            ("pretension", n),
            ("stiffness", s),
            ("length", s),
            ("rest", 2 * s),
            ("base", 3),
            ("tilt", 2),
        ];
        let each = kinds
            .iter()
            .flat_map(|(name, count)| (0..*count).map(move |i| format!("{name}[{i}]")));
        std::iter::once("slack".to_string()).chain(each).collect()
    }

    /// Number of segments S.
    pub fn segments(&self) -> usize {
        self.segments
    }

    /// Number of tendons.
    pub fn tendons(&self) -> usize {
        self.tendons.len()
    }

    /// Number of parameters of a rod.
    pub fn width(&self) -> usize {
        self.first.end
    }

    /// Reject a wrong number of parameters, or implausible values.
    pub(super) fn check(&self, numbers: &[f64]) -> Result<()> {
        if numbers.len() != self.width() {
            return Err(invalid(format!(
                "a rod of {} segments and {} tendons has {} numbers, got {}",
                self.segments,
                self.tendons.len(),
                self.width(),
                numbers.len()
            )));
        }
        for (label, value) in self.labels().iter().zip(numbers) {
            let (low, high) = match label.split('[').next() {
                Some("slack") => (0.0, 1.0),
                Some("stiffness") => (1e-6, 1e9),
                Some("radius" | "length") => (1e-3, 1e6),
                Some("base" | "pretension") => (-1e6, 1e6),
                _ => (-100.0, 100.0),
            };
            if !(low..=high).contains(value) {
                return Err(invalid(format!(
                    "a rod's {label} is {value}; allowed are {low} to {high}"
                )));
            }
        }
        Ok(())
    }
}
