//! The rod priors, for robots without a simulator, and their response to loads: `elastic` if the
//! tendons are known, else the chain of chords defined here, whose bending angles are a polynomial
//! of the commands.
//!
//! Marker p_k (k = 1..K, base to tip) is the end of chord d_k = p_k − p_{k−1} below the base point
//! p_0. In the base frame (z along the rest axis) chord k has the angle vector v_k = β ·
//! d_xy/|d_xy|, β = atan2(|d_xy|, d_z) (rad), so that d_k = |d_k| · (v_k·sin β/β,
//!     cos β).
//! Commands are normalised, q = (u − centre)/scale; all 2K angles are one polynomial of q (degree
//! 1..5, monomials in graded order, intercept first), and every chord length (mm) is a quadratic of
//! the 2K angles. In a `pulled` rod the polynomial is one of the pulls of two cables a command,
//! max(q, 0) and max(−q, 0), all C of the first before those of the second: a slack cable has no
//! effect, which causes a kink at the centre. In a `splined` rod, B-splines replace the monomials.
//! Evaluation is closed form and smooth through the straight pose (β = 0). Limits: β beyond π folds
//! back; outside the fitted commands a cubic grows fast, without clamping. Fitting is in
//! `softmap_edge/rod/`. `polynomial` has the polynomials, `field` the response to loads.

mod arc;
mod elastic;
mod elastic_field;
mod elastic_slopes;
mod field;
mod layout;
mod polynomial;

pub use elastic::ElasticRod;
pub use elastic_field::ElasticField;
pub use field::{Load, RodField};
pub use layout::{Layout, Tendon};
pub use polynomial::{Monomials, Splines, Terms};

use crate::algebra::Vec3;
use crate::error::{Result, invalid};
use crate::memory::with_few;
use crate::shape::{Shape, Work};
use polynomial::Polynomial;

fn finite(numbers: &[f64], what: &str) -> Result<()> {
    match numbers.iter().position(|x| !x.is_finite()) {
        Some(at) => Err(invalid(format!(
            "{what} holds {} at position {at}; every number must be finite",
            numbers[at]
        ))),
        None => Ok(()),
    }
}

/// The form of the map from commands to angles.
#[derive(Debug, Clone, Copy)]
pub enum Form {
    /// A polynomial of the commands.
    Powers { degree: usize },
    /// A polynomial of the pulls of two cables a command.
    Pulls { degree: usize },
    /// Tensor products of cubic B-splines of the commands.
    Splines { intervals: usize },
}

/// The regressed chord-angle rod: C commands to K markers.
#[derive(Debug, Clone)]
pub struct Rod {
    base: Vec3,
    centre: Vec<f64>,
    scale: Vec<f64>,
    pulled: bool,
    angles: Polynomial,
    lengths: Polynomial,
}

impl Rod {
    /// Build from base point (mm), command centre and scale (C,), the form of the map, angle
    /// weights (1 + F, 2K) in rad and length weights (1 + 2K + K(2K+1), K) in mm, both row-major
    /// with the intercept first.
    pub fn new(
        base: [f64; 3],
        centre: Vec<f64>,
        scale: Vec<f64>,
        form: Form,
        angles: Vec<f64>,
        lengths: Vec<f64>,
    ) -> Result<Self> {
        if centre.len() != scale.len() {
            return Err(invalid(format!(
                "a rod's centre has {} channels and its scale {}; give one number of each per \
                channel",
                centre.len(),
                scale.len()
            )));
        }
        finite(&base, "a rod's base point")?;
        finite(&centre, "a rod's command centre")?;
        finite(&scale, "a rod's command scale")?;
        if let Some(at) = scale.iter().position(|&s| s <= 0.0) {
            return Err(invalid(format!(
                "a rod's command scale [{at}] is {}; it must be positive",
                scale[at]
            )));
        }
        let pulled = matches!(form, Form::Pulls { .. });
        let terms = match form {
            Form::Powers { degree } => Terms::Monomials(Monomials::new(scale.len(), degree)?),
            Form::Pulls { degree } => Terms::Monomials(Monomials::new(2 * scale.len(), degree)?),
            Form::Splines { intervals } => Terms::Splines(Splines::new(scale.len(), intervals)?),
        };
        let rows = terms.count() + 1;
        if angles.is_empty() || !angles.len().is_multiple_of(2 * rows) {
            return Err(invalid(format!(
                "a rod's angle weights hold {} numbers, expected {rows} rows ({form:?}, {} \
                channels) of two per chord",
                angles.len(),
                scale.len()
            )));
        }
        let chords = angles.len() / (2 * rows);
        let quadratic = Terms::Monomials(Monomials::new(2 * chords, 2)?);
        Ok(Self {
            base: base.into(),
            centre,
            scale,
            pulled,
            angles: Polynomial::new(terms, angles, 2 * chords, "a rod's angle weights")?,
            lengths: Polynomial::new(quadratic, lengths, chords, "a rod's length weights")?,
        })
    }

    /// Number of chords, which is the number of markers K.
    pub fn chords(&self) -> usize {
        self.lengths.outputs
    }

    /// Number of variables of the polynomial: commands, or their pulls.
    fn variables(&self) -> usize {
        self.scale.len() * if self.pulled { 2 } else { 1 }
    }

    /// Write the variables of the polynomial at `u` to `out`.
    fn normalised(&self, u: &[f64], out: &mut [f64]) {
        let places = self.centre.iter().zip(&self.scale);
        for ((out, u), (c, s)) in out.iter_mut().zip(u).zip(places) {
            *out = (u - c) / s;
        }
        if self.pulled {
            let (first, second) = out.split_at_mut(self.scale.len());
            for (first, second) in first.iter_mut().zip(second) {
                (*first, *second) = (first.max(0.0), (-*first).max(0.0));
            }
        }
    }

    /// Slopes of an angle over the normalised command `j`, from those over the variables `q`;
    /// between both sides at a kink.
    fn over(&self, slopes: &[f64], q: &[f64], j: usize) -> f64 {
        if !self.pulled {
            return slopes[j];
        }
        let other = self.scale.len() + j;
        match (q[j] > 0.0, q[other] > 0.0) {
            (true, _) => slopes[j],
            (_, true) => -slopes[other],
            _ => 0.5 * (slopes[j] - slopes[other]),
        }
    }

    /// Pass the markers at `u` to `take`, base to tip.
    fn markers(&self, u: &[f64], mut take: impl FnMut(usize, Vec3)) {
        let (variables, chords) = (self.variables(), self.chords());
        with_few(variables + 3 * chords, |work| {
            let (q, work) = work.split_at_mut(variables);
            let (v, lengths) = work.split_at_mut(2 * chords);
            self.normalised(u, q);
            self.angles.eval(q, v);
            self.lengths.eval(v, lengths);
            let mut p = self.base;
            for k in 0..chords {
                let (x, y) = (v[2 * k], v[2 * k + 1]);
                let bend = Bend::new(x, y);
                p += lengths[k] * Vec3::new(bend.sinc * x, bend.sinc * y, bend.cos);
                take(k, p);
            }
        });
    }

    /// Base point and markers at `u`: K + 1 points.
    fn points(&self, u: &[f64]) -> Vec<Vec3> {
        let mut points = Vec::with_capacity(1 + self.chords());
        points.push(self.base);
        self.markers(u, |_, p| points.push(p));
        points
    }
}

/// sin β/β, cos β and (β·cos β − sin β)/β³ with their limits 1, 1 and −1/3 at β = 0.
struct Bend {
    sinc: f64,
    cos: f64,
    /// d sinc / d x = x · rise.
    rise: f64,
}

impl Bend {
    fn new(x: f64, y: f64) -> Self {
        let square = x * x + y * y;
        let beta = square.sqrt();
        // Below 0.02 rad the series is exact to 1e-16 and the quotients lose digits.
        if beta < 0.02 {
            let sinc = 1.0 - square / 6.0 * (1.0 - square / 20.0 * (1.0 - square / 42.0));
            return Self {
                sinc,
                cos: beta.cos(),
                rise: -1.0 / 3.0 + square / 30.0 * (1.0 - square / 28.0),
            };
        }
        let (sin, cos) = beta.sin_cos();
        Self {
            sinc: sin / beta,
            cos,
            rise: (beta * cos - sin) / (square * beta),
        }
    }
}

impl Shape for Rod {
    fn channels(&self) -> usize {
        self.scale.len()
    }

    fn size(&self) -> usize {
        3 * self.chords()
    }

    fn eval(&self, u: &[f64], out: &mut [f64]) {
        self.markers(u, |k, p| p.write_to_slice(&mut out[3 * k..]));
    }

    fn jacobian(&self, u: &[f64], out: &mut [f64]) {
        self.slopes(u, out, &mut vec![]);
    }

    fn with_slopes(&self, u: &[f64], values: &mut [f64], slopes: &mut [f64], work: &mut Work) {
        self.eval(u, values);
        self.slopes(u, slopes, &mut work.doubles);
    }
}

impl Rod {
    fn slopes(&self, u: &[f64], out: &mut [f64], work: &mut Vec<f64>) {
        let (c, chords, variables) = (self.channels(), self.chords(), self.variables());
        let n = 2 * chords;
        let inside = self.angles.work().max(self.lengths.work());
        work.resize(
            variables + n + n * variables + n + chords + chords * n + inside,
            0.0,
        );
        let (q, rest) = work.split_at_mut(variables);
        let (v, rest) = rest.split_at_mut(n);
        let (dv, rest) = rest.split_at_mut(n * variables);
        let (rise, rest) = rest.split_at_mut(n);
        let (lengths, rest) = rest.split_at_mut(chords);
        let (dl, inside) = rest.split_at_mut(chords * n);
        self.normalised(u, q);
        self.angles.slopes(q, v, dv, inside);
        self.lengths.slopes(v, lengths, dl, inside);
        for j in 0..c {
            let mut slope = Vec3::ZERO;
            for (rise, dv) in rise.iter_mut().zip(dv.chunks_exact(variables)) {
                *rise = self.over(dv, q, j) / self.scale[j];
            }
            for k in 0..chords {
                let (x, y) = (v[2 * k], v[2 * k + 1]);
                let (dx, dy) = (rise[2 * k], rise[2 * k + 1]);
                let stretch: f64 = (0..n).map(|i| dl[k * n + i] * rise[i]).sum();
                let bend = Bend::new(x, y);
                let along = x * dx + y * dy;
                let turn = Vec3::new(
                    bend.sinc * dx + bend.rise * along * x,
                    bend.sinc * dy + bend.rise * along * y,
                    -bend.sinc * along,
                );
                let chord = Vec3::new(bend.sinc * x, bend.sinc * y, bend.cos);
                slope += lengths[k] * turn + stretch * chord;
                for axis in 0..3 {
                    out[(3 * k + axis) * c + j] = slope[axis];
                }
            }
        }
    }
}

#[cfg(test)]
mod elastic_tests;
#[cfg(test)]
mod tests;
