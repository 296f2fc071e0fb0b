//! Inverse kinematics: the effective command for a tip position, and the command for an effective
//! command.
//!
//! `solve.rs` finds the first by bounded Levenberg–Marquardt on the tip's own slopes,
//! `published.rs` by the method of the paper. `chain.rs` finds the second by bracketing one sample
//! of the chain of effects, every period of the control loop.

pub mod chain;
pub mod published;
pub mod solve;

use crate::shape::{Shape, Work};
use std::sync::Arc;

/// Outputs of a tip: x, y, z mm.
pub const PLACE: usize = 3;

/// The squared distance (mm²) between a tip and its target, along the used axes.
pub struct Distance {
    shape: Arc<dyn Shape>,
    axes: [bool; PLACE],
    place: [f64; PLACE],
    slopes: Vec<f64>,
    /// The last evaluated command; NaN if none.
    known: Vec<f64>,
    work: Work,
    /// Number of evaluations of the tip.
    pub asked: usize,
}

impl Distance {
    fn new(shape: Arc<dyn Shape>, axes: [bool; PLACE]) -> Distance {
        Distance {
            slopes: vec![0.0; PLACE * shape.channels()],
            known: vec![f64::NAN; shape.channels()],
            shape,
            axes,
            place: [0.0; PLACE],
            work: Work::default(),
            asked: 0,
        }
    }

    fn apart(&self, target: &[f64; PLACE]) -> [f64; PLACE] {
        std::array::from_fn(|i| {
            if self.axes[i] {
                self.place[i] - target[i]
            } else {
                0.0
            }
        })
    }

    /// At the command `u`.
    pub fn at(&mut self, u: &[f64], target: &[f64; PLACE]) -> f64 {
        self.asked += 1;
        self.known.fill(f64::NAN);
        self.shape.eval(u, &mut self.place);
        self.apart(target).iter().map(|d| d * d).sum()
    }

    /// The same, with half its slopes `gradient` (C,) = Jᵀr and `normal` (C, C) = JᵀJ.
    pub fn with_slopes(
        &mut self,
        u: &[f64],
        target: &[f64; PLACE],
        gradient: &mut [f64],
        normal: &mut [f64],
    ) -> f64 {
        if self.known != u {
            self.asked += 1;
            self.known.copy_from_slice(u);
            self.shape
                .with_slopes(u, &mut self.place, &mut self.slopes, &mut self.work);
        }
        let (apart, channels) = (self.apart(target), u.len());
        gradient.fill(0.0);
        normal.fill(0.0);
        for i in (0..PLACE).filter(|i| self.axes[*i]) {
            let row = &self.slopes[i * channels..(i + 1) * channels];
            for (a, slope) in row.iter().enumerate() {
                gradient[a] += slope * apart[i];
                for (b, other) in row.iter().enumerate() {
                    normal[a * channels + b] += slope * other;
                }
            }
        }
        apart.iter().map(|d| d * d).sum()
    }
}
