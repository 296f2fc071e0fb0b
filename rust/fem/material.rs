//! The material of a body: modulus, Poisson's ratio, density, and regions of another modulus.
//!
//! μ = E/2(1+ν), κ = E/3(1−2ν) in MPa. A region is a box in the rest configuration, or the half of
//! it that faces an angle about z (one side of the section stiffer), or the part of these in some
//! cells of the mesh. Where regions overlap, the last one applies. The modulus is evaluated at
//! Gauss points, so a border between regions need not follow the mesh. Limit: a border inside a
//! cell is smeared over it.

use super::Vec3;
use crate::error::{Result, invalid};
use crate::response::loads::{HATS, hat};
use std::sync::Arc;

/// Shear and bulk modulus, MPa.
#[derive(Debug, Clone, Copy)]
pub struct Material {
    pub mu: f64,
    pub kappa: f64,
}

impl Material {
    /// From Young's modulus (MPa) and Poisson's ratio.
    pub fn new(young: f64, poisson: f64) -> Result<Material> {
        if !(young.is_finite() && young > 0.0) {
            return Err(invalid(format!(
                "Young's modulus {young} MPa: must be above 0; soft silicones have 0.05 to 1"
            )));
        }
        if !(poisson > 0.0 && poisson < 0.4999) {
            return Err(invalid(format!(
                "Poisson's ratio {poisson}: allowed is 0 to 0.4999; silicones take 0.45 to 0.49"
            )));
        }
        Ok(Material {
            mu: young / (2.0 * (1.0 + poisson)),
            kappa: young / (3.0 * (1.0 - 2.0 * poisson)),
        })
    }
}

/// A region of another modulus: a box in mm, optionally the half of the section that faces `side`
/// (radians about z), optionally within the mesh cells marked in `cells`.
#[derive(Debug, Clone, PartialEq)]
pub struct Region {
    pub low: Vec3,
    pub high: Vec3,
    pub side: Option<f64>,
    pub cells: Option<Arc<[bool]>>,
    pub young: f64,
}

impl Region {
    fn holds(&self, p: Vec3, cell: usize) -> bool {
        let boxed = self.low.cmple(p).all() && p.cmple(self.high).all();
        let marked = |cells: &Arc<[bool]>| cells.get(cell).is_some_and(|marked| *marked);
        boxed
            && self.cells.as_ref().is_none_or(marked)
            && self
                .side
                .is_none_or(|a| p[0] * a.cos() + p[1] * a.sin() > 0.0)
    }
}

/// A smooth change of the logarithm of the modulus relative to base and regions: `hats` along a
/// body of `height` mm, `across` from its axis to `reach` mm along x and y.
#[derive(Debug, Clone, Copy)]
pub struct Modulation {
    pub hats: [f64; HATS],
    pub across: [f64; 2],
    pub height: f64,
    pub reach: f64,
}

impl Modulation {
    fn logarithm(&self, p: Vec3) -> f64 {
        let along: f64 = (0..HATS)
            .map(|k| self.hats[k] * hat(k, p[2] / self.height))
            .sum();
        along + (self.across[0] * p[0] + self.across[1] * p[1]) / self.reach
    }
}

/// A body's material (MPa, kg/m³).
#[derive(Debug, Clone)]
pub struct Body {
    pub density: f64,
    base: Material,
    regions: Vec<(Region, Material)>,
    modulation: Option<Modulation>,
    slopes: Vec<Modulation>,
}

impl Body {
    /// Rejects impossible material values.
    pub fn new(young: f64, poisson: f64, density: f64, regions: Vec<Region>) -> Result<Body> {
        if !(density.is_finite() && density >= 0.0) {
            return Err(invalid(format!(
                "density {density} kg/m³: must be 0 or more; silicones have about 1070"
            )));
        }
        let regions = regions
            .into_iter()
            .map(|r| Ok((r.clone(), Material::new(r.young, poisson)?)))
            .collect::<Result<_>>()?;
        Ok(Body {
            density,
            base: Material::new(young, poisson)?,
            regions,
            modulation: None,
            slopes: vec![],
        })
    }

    /// One material everywhere.
    pub fn uniform(young: f64, poisson: f64, density: f64) -> Result<Body> {
        Body::new(young, poisson, density, Vec::new())
    }

    /// The same body with its modulus changed smoothly.
    pub fn modulated(self, modulation: Modulation) -> Body {
        Body {
            modulation: Some(modulation),
            ..self
        }
    }

    /// The derivative of its modulus by the amount p of `by`: ∂E/∂p.
    pub fn slope(mut self, by: Modulation) -> Body {
        self.slopes.push(by);
        self
    }

    /// The material at a position of the rest configuration, in a cell of the mesh.
    pub fn at(&self, p: Vec3, cell: usize) -> Material {
        let last = self.regions.iter().rev().find(|(r, _)| r.holds(p, cell));
        let Material { mu, kappa } = last.map_or(self.base, |(_, material)| *material);
        let modulated = self.modulation.map_or(1.0, |m| m.logarithm(p).exp());
        let slopes = self.slopes.iter().map(|m| m.logarithm(p));
        let factor = modulated * slopes.product::<f64>();
        Material {
            mu: factor * mu,
            kappa: factor * kappa,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_last_region_that_holds_a_place_decides() {
        let far = f64::INFINITY;
        let region = |low: f64, high: f64, side: Option<f64>, young: f64| Region {
            low: Vec3::new(-far, -far, low),
            high: Vec3::new(far, far, high),
            side,
            cells: None,
            young,
        };
        let regions = vec![
            region(10.0, 30.0, None, 0.6),
            region(20.0, 40.0, Some(0.0), 1.2),
        ];
        let body = Body::new(0.3, 0.45, 1000.0, regions).unwrap();
        let young = |p: Vec3| body.at(p, 0).mu * 2.0 * 1.45;
        for (p, e) in [
            (Vec3::new(1.0, 0.0, 5.0), 0.3),
            (Vec3::new(1.0, 0.0, 15.0), 0.6),
            (Vec3::new(1.0, 0.0, 25.0), 1.2),
            (Vec3::new(-1.0, 0.0, 25.0), 0.6),
            (Vec3::new(-1.0, 0.0, 35.0), 0.3),
        ] {
            assert!((young(p) - e).abs() < 1e-12, "{p:?}");
        }
        let marked = Region {
            cells: Some([false, true].into()),
            ..region(10.0, 30.0, None, 2.4)
        };
        let body = Body::new(0.3, 0.45, 1000.0, vec![marked]).unwrap();
        let young = |z: f64, cell: usize| body.at(Vec3::new(1.0, 0.0, z), cell).mu * 2.0 * 1.45;
        for (z, cell, e) in [
            (15.0, 0, 0.3),
            (15.0, 1, 2.4),
            (5.0, 1, 0.3),
            (15.0, 9, 0.3),
        ] {
            assert!((young(z, cell) - e).abs() < 1e-12, "{z} in {cell}");
        }
        assert!(Body::uniform(0.3, 0.5, 1000.0).is_err() && Body::uniform(0.3, 0.4, -1.0).is_err());
        assert!(Body::new(0.3, 0.4, 1.0, vec![region(0.0, 1.0, None, f64::NAN)]).is_err());
    }
}
