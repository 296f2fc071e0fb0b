//! Marker displacements of an elastic rod by a load or a change of its body, in its own modes,
//! against its bending and its taut tendons.
//!
//! A force F (N) at a point x of the rod adds (∂x/∂θ)ᵀ·F to the balance of moments, so to first
//! order δp = (1/k) · (∂p/∂θ) · H⁻¹ · (∂x/∂θ)ᵀ · F (mm), H (mm²) the Hessian of `elastic.rs` in
//! units of the tendon stiffness k. A tip force acts at the last marker; a weight of 1 N is uniform
//! along the segments (three Gauss points each). Shapes do not determine k (N/mm): 1/k is a nominal
//! number, and amounts of load are only meaningful as displacement. A modulus larger by the factor
//! 1 + a(s) adds −ā·κ·φ to that balance, ā the mean of a over a segment, without a known stiffness.
//! A uniform curvature at rest adds to θ⁰, without an effect on tendons; it is 1 mm at the end of a
//! straight rod. For tendons turned about the axis, see the slopes of `elastic_slopes.rs` over
//! their angles. Limits: the pulling tendons are those of the unloaded pose; arcs have no sides and
//! no twist.

use super::elastic::{ElasticRod, along};
use super::field::Load;
use crate::error::{Result, invalid};
use crate::response::loads::{ACROSS, CURVE, FIELDS, PUSH, ROUTING, STIFF, TWIST, covered, width};
use crate::shape::Shape;
use std::sync::Arc;

/// Gauss points on 0…1 and their weights.
const GAUSS: [(f64, f64); 3] = [
    (0.112_701_665_379_258_3, 5.0 / 18.0),
    (0.5, 8.0 / 18.0),
    (0.887_298_334_620_741_7, 5.0 / 18.0),
];

/// The cause of a displacement, per unit.
#[derive(Debug, Clone, Copy)]
enum Cause {
    /// A load along one axis of the base frame.
    Load(Load, usize),
    /// The logarithm of the modulus in one of the sections of `loads.rs`.
    Stretch(usize),
    /// A uniform curvature at rest towards x or y.
    Curve(usize),
    /// The tendons of a command turned about the axis by 1°.
    Routing(usize),
}

impl Cause {
    fn of(name: &str) -> Result<Cause> {
        match FIELDS.iter().position(|known| *known == name) {
            Some(field) if (STIFF..ACROSS).contains(&field) => Ok(Cause::Stretch(field - STIFF)),
            Some(field) if (CURVE..TWIST).contains(&field) => Ok(Cause::Curve(field - CURVE)),
            Some(field) if (ROUTING..PUSH).contains(&field) => Ok(Cause::Routing(field - ROUTING)),
            _ => Load::of(name).map(|(load, axis)| Cause::Load(load, axis)),
        }
    }
}

/// Marker displacements (mm) of an elastic rod under one unit of a load or of a change of its body.
#[derive(Debug, Clone)]
pub struct ElasticField {
    rod: ElasticRod,
    cause: Cause,
    flexibility: f64,
}

impl ElasticField {
    /// `name` is `gravity_x|y|z`, `tip_force_x|y|z`, `stiff_0…6`, `curve_x|y` or `routing_c`;
    /// `flexibility` is 1/k in mm/N.
    pub fn new(rod: ElasticRod, name: &str, flexibility: f64) -> Result<Self> {
        let cause = Cause::of(name)?;
        if matches!(cause, Cause::Routing(command) if command >= rod.layout.channels) {
            return Err(invalid(format!(
                "the field {name} turns the tendons of a command that the rod has not: it has {}",
                rod.layout.channels
            )));
        }
        if !(flexibility.is_finite() && flexibility > 0.0) {
            return Err(invalid(format!(
                "a rod's flexibility is {flexibility} mm per N; it must be positive"
            )));
        }
        Ok(Self {
            rod,
            cause,
            flexibility,
        })
    }

    /// Where a load acts: segment, share of it, newtons.
    fn points(&self, load: Load) -> Vec<(usize, f64, f64)> {
        let (lengths, markers) = (self.rod.lengths(), &self.rod.layout.markers);
        match load {
            Load::TipForce => {
                let (k, f) = markers[markers.len() - 1];
                vec![(k, f, 1.0)]
            }
            Load::Weight => {
                let total: f64 = lengths.iter().sum();
                let each = lengths.iter().enumerate();
                each.flat_map(|(k, length)| {
                    GAUSS.map(|(f, weight)| (k, f, weight * length / total))
                })
                .collect()
            }
        }
    }
}

impl Shape for ElasticField {
    fn with_number(&self, name: &str, factor: f64) -> Option<Arc<dyn Shape>> {
        let rod = self.rod.slacker(name, factor)?;
        Some(Arc::new(ElasticField {
            rod,
            ..self.clone()
        }))
    }

    fn channels(&self) -> usize {
        self.rod.channels()
    }

    fn size(&self) -> usize {
        self.rod.size()
    }

    fn eval(&self, u: &[f64], out: &mut [f64]) {
        let equilibrium = self.rod.equilibrium(u);
        let bends = self.rod.bends(&equilibrium);
        let chain = self.rod.chain(&bends);
        let mut slopes = chain.room();
        let mut turn = vec![0.0; bends.len()]; // additional bending of the segments
        let total: f64 = self.rod.lengths().iter().sum();
        match self.cause {
            Cause::Load(load, axis) => {
                for (k, f, newtons) in self.points(load) {
                    chain.slopes(k, f, &mut slopes);
                    for (turn, slope) in turn.iter_mut().zip(&slopes.bends) {
                        *turn += self.flexibility * newtons * slope[axis];
                    }
                }
                equilibrium.hessian.solve(&mut turn);
            }
            Cause::Stretch(hat) => {
                let mut start = 0.0;
                for (s, length) in self.rod.lengths().iter().enumerate() {
                    let whole = covered(hat, start / total, (start + length) / total);
                    let mean = whole * width(hat) * total / length;
                    for i in 2 * s..2 * s + 2 {
                        turn[i] = -mean * self.rod.stiffness(i) * equilibrium.bent[i];
                    }
                    start += length;
                }
                equilibrium.hessian.solve(&mut turn);
            }
            Cause::Routing(command) => {
                let degree = 1f64.to_radians();
                turn = self.rod.turning(&equilibrium, command);
                turn.iter_mut().for_each(|t| *t *= degree);
                equilibrium.hessian.solve(&mut turn);
            }
            Cause::Curve(axis) => {
                for (s, length) in self.rod.lengths().iter().enumerate() {
                    turn[2 * s + axis] = 2.0 * length / (total * total);
                }
            }
        }
        for (out, &(k, f)) in out.chunks_exact_mut(3).zip(&self.rod.layout.markers) {
            chain.slopes(k, f, &mut slopes);
            along(&slopes.bends, &turn).write_to_slice(out);
        }
    }
}
