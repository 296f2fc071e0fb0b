//! How a load moves the markers of an elastic rod: in its own modes, against its own bending and its taut tendons.
//!
//! A force F (N) at a point x of the rod adds (∂x/∂θ)ᵀ·F to the balance of moments, so to first order
//!   δp = (1/k) · (∂p/∂θ) · H⁻¹ · (∂x/∂θ)ᵀ · F     (mm),
//! H (mm²) the Hessian of `elastic.rs` in units of the tendon stiffness k. A tip force acts at the last marker; a weight of
//! 1 N is spread evenly along the segments (three Gauss points each). k (N/mm) is not known from shapes: 1/k is one nominal
//! number, and amounts of load are only meaningful as displacement. Limit: tendons that pull are those of the unloaded pose.

use super::elastic::{ElasticRod, along};
use super::field::Load;
use crate::error::{Result, invalid};
use crate::shape::Shape;
use crate::vector::Vec3;
use std::sync::Arc;

/// Gauss points on 0…1 and their weights.
const GAUSS: [(f64, f64); 3] = [
    (0.112_701_665_379_258_3, 5.0 / 18.0),
    (0.5, 8.0 / 18.0),
    (0.887_298_334_620_741_7, 5.0 / 18.0),
];

/// Marker displacements (mm) of an elastic rod under one unit load along one axis of the base frame.
#[derive(Debug, Clone)]
pub struct ElasticField {
    rod: ElasticRod,
    load: Load,
    axis: usize,
    flexibility: f64,
}

impl ElasticField {
    /// `name` is `gravity_x|y|z` or `tip_force_x|y|z`; `flexibility` is 1/k in mm/N.
    pub fn new(rod: ElasticRod, name: &str, flexibility: f64) -> Result<Self> {
        let (load, axis) = Load::of(name)?;
        if !(flexibility.is_finite() && flexibility > 0.0) {
            return Err(invalid(format!(
                "a rod's flexibility is {flexibility} mm per N; it must be positive"
            )));
        }
        Ok(Self {
            rod,
            load,
            axis,
            flexibility,
        })
    }

    /// Where the load acts: segment, share of it, newtons.
    fn points(&self) -> Vec<(usize, f64, f64)> {
        let (lengths, markers) = (self.rod.lengths(), &self.rod.layout.markers);
        match self.load {
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
        let mut turn = vec![0.0; bends.len()];
        for (k, f, newtons) in self.points() {
            chain.slopes(k, f, &mut slopes);
            for (turn, slope) in turn.iter_mut().zip(&slopes.bends) {
                *turn += newtons * slope[self.axis];
            }
        }
        equilibrium.hessian.solve(&mut turn);
        for (out, &(k, f)) in out.chunks_exact_mut(3).zip(&self.rod.layout.markers) {
            chain.slopes(k, f, &mut slopes);
            let shift: Vec3 = along(&slopes.bends, &turn);
            for axis in 0..3 {
                out[axis] = self.flexibility * shift[axis];
            }
        }
    }
}
