//! Marker displacements of the rod under one unit of weight or of tip force.
//!
//! A load turns every cross-section by its bending moment. With c = 1/(E·I) (N⁻¹·mm⁻²) the markers
//! move, to first order, by δp_i = c ∫_0^{s_i} [M(s)]_⊥ × (p_i − c(s)) ds (mm), M(s) = (p_tip −
//! c(s)) × F for a tip force F, M(s) = ∫_s^L (c(r) − c(s)) × (W/L) dr for a uniform weight W, ⊥ =
//! without the part along the chord (twist is stiff). The centreline c(s) consists of the chords,
//! on which the integrand is at most cubic, so Simpson's rule is exact. Holding motors keep every
//! tendon's length, hence each chord's mean bending: they carry the share `lock` of the mean of
//! [M]_⊥ over the chord. The shape does not determine the robot's stiffness: c is a nominal number,
//! and amounts of load are only meaningful as displacement.

use super::Rod;
use crate::algebra::Vec3;
use crate::error::{Result, invalid};
use crate::response::loads::{FIELDS, GRAVITY, LOADS, TIP_FORCE};
use crate::shape::Shape;

/// The kind of load.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Load {
    /// A uniform weight of 1 N along the rod.
    Weight,
    /// A force of 1 N at the last marker.
    TipForce,
}

impl Load {
    /// The load and the axis of the field called `name`.
    pub(super) fn of(name: &str) -> Result<(Self, usize)> {
        match FIELDS[..LOADS].iter().position(|known| *known == name) {
            Some(field) if field < TIP_FORCE => Ok((Load::Weight, field - GRAVITY)),
            Some(field) => Ok((Load::TipForce, field - TIP_FORCE)),
            None => Err(invalid(format!(
                "a rod has no field {name:?}; it has {}",
                FIELDS[..LOADS].join(", ")
            ))),
        }
    }
}

/// Marker displacements (mm) of a rod under one unit load along one axis of the base frame.
#[derive(Debug, Clone)]
pub struct RodField {
    rod: Rod,
    load: Load,
    axis: usize,
    compliance: f64,
    lock: f64,
}

impl RodField {
    /// `name` is `gravity_x|y|z` (the complete weight along the axis) or `tip_force_x|y|z`;
    /// `compliance` c in N⁻¹·mm⁻²: mm per N of tip force; for gravity the product c·W is mm per 1 g
    /// when W (N) is the robot's weight. `lock` is the share of each chord's mean bending moment
    /// that its tendons carry: 0 free, 1 of fixed length.
    pub fn new(rod: Rod, name: &str, compliance: f64, lock: f64) -> Result<Self> {
        let (load, axis) = Load::of(name)?;
        if !(compliance.is_finite() && compliance > 0.0) {
            return Err(invalid(format!(
                "a rod's compliance is {compliance} per N mm²; it must be positive"
            )));
        }
        if !(0.0..=1.0).contains(&lock) {
            return Err(invalid(format!(
                "a rod's lock is {lock}; it is 0 (free tendons) to 1 (tendons that hold)"
            )));
        }
        Ok(Self {
            rod,
            load,
            axis,
            compliance,
            lock,
        })
    }

    /// Bending moment per unit load at fraction `s` of chord `k`.
    fn moment(&self, chords: &Chords, k: usize, s: f64) -> Vec3 {
        let force = Vec3::AXES[self.axis];
        let at = chords.at(k, s);
        match self.load {
            Load::TipForce => (chords.points[chords.points.len() - 1] - at).cross(force),
            Load::Weight => {
                // First moment of the weight beyond: the rest of this chord about its middle, then
                // full chords.
                let rest = chords.lengths[k] * (1.0 - s);
                let mut arm = rest * (chords.at(k, 0.5 * (1.0 + s)) - at);
                for j in k + 1..chords.lengths.len() {
                    arm += chords.lengths[j] * (chords.at(j, 0.5) - at);
                }
                (1.0 / chords.total * arm).cross(force)
            }
        }
    }
}

/// The chords at one command.
struct Chords {
    points: Vec<Vec3>,
    lengths: Vec<f64>,
    total: f64,
}

impl Chords {
    fn new(points: Vec<Vec3>) -> Self {
        let lengths: Vec<f64> = points.windows(2).map(|p| p[1].distance(p[0])).collect();
        let total = lengths.iter().sum();
        Self {
            points,
            lengths,
            total,
        }
    }

    fn at(&self, k: usize, s: f64) -> Vec3 {
        self.points[k] + s * (self.points[k + 1] - self.points[k])
    }
}

impl Shape for RodField {
    fn channels(&self) -> usize {
        self.rod.channels()
    }

    fn size(&self) -> usize {
        self.rod.size()
    }

    fn eval(&self, u: &[f64], out: &mut [f64]) {
        let chords = Chords::new(self.rod.points(u));
        out.fill(0.0);
        for k in 0..chords.lengths.len() {
            let length = chords.lengths[k];
            if length == 0.0 {
                continue;
            }
            let tangent = 1.0 / length * (chords.points[k + 1] - chords.points[k]);
            let nodes = [(0.0, 1.0 / 6.0), (0.5, 4.0 / 6.0), (1.0, 1.0 / 6.0)];
            let bendings = nodes.map(|(s, _)| {
                let moment = self.moment(&chords, k, s);
                moment - moment.dot(tangent) * tangent
            });
            let pairs = nodes.iter().zip(&bendings);
            let mean: Vec3 = pairs.map(|(node, bending)| node.1 * bending).sum();
            for ((s, weight), bending) in nodes.into_iter().zip(bendings) {
                let bending = bending - self.lock * mean;
                let turn = self.compliance * weight * length * bending;
                let at = chords.at(k, s);
                for i in k..chords.lengths.len() {
                    let shift = turn.cross(chords.points[i + 1] - at);
                    for axis in 0..3 {
                        out[3 * i + axis] += shift[axis];
                    }
                }
            }
        }
    }
}
