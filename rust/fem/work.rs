//! The workspace of one thread for a solid: residual and tangent at a state, the factored tangent,
//! and solves with it.
//!
//! The tangent is K₀ + Σ kc b bᵀ over the taut elastic cables, b = ∂L/∂x: K₀ (elements and the
//! cables' geometric stiffness) is sparse; the stiff dense rank-one terms stay out of the pattern
//! and enter solves through the Woodbury identity (Hager 1989): (K₀ + B D Bᵀ)⁻¹ r = y − Z (D⁻¹ +
//! BᵀZ)⁻¹ Bᵀ y with y = K₀⁻¹ r, Z = K₀⁻¹ B. Units as in `solid.rs`: mm, N, N/mm.

use super::Vec3;
use super::cable::Drive;
use super::element::Block;
use super::natural::MOST_NODES;
use super::solid::{HELD, Load, Solid};
use crate::algebra::dense;
use crate::algebra::sparse::Factor;
use crate::error::Result;

/// Reusable storage of one thread: residual, tangent and factor at the last assembled state.
pub struct Work<'a> {
    pub solid: &'a Solid,
    /// Gradient of the total energy, N.
    pub residual: Vec<f64>,
    /// Elastic cables that pull at the assembled state, and their b = ∂L/∂x.
    pub taut: Vec<(usize, Vec<f64>)>,
    /// The shift of the diagonal that makes the factored tangent positive definite, N/mm.
    pub shift: f64,
    values: Vec<f64>,
    factor: Factor,
    solved: Vec<f64>,
    small: Vec<Vec<f64>>,
}

impl<'a> Work<'a> {
    pub fn new(solid: &'a Solid) -> Result<Work<'a>> {
        let n = solid.unknowns();
        Ok(Work {
            solid,
            residual: vec![0.0; n],
            taut: Vec::new(),
            shift: 0.0,
            values: vec![0.0; solid.pattern.len()],
            factor: Factor::new(&solid.pattern, solid.cables.len().max(1))?,
            solved: Vec::new(),
            small: Vec::new(),
        })
    }

    /// Energy, residual and K₀ at a state; infinite energy (and undefined results) if a cell is
    /// inverted.
    pub fn assemble(&mut self, x: &[Vec3], load: &Load) -> f64 {
        let solid = self.solid;
        self.residual.fill(0.0);
        self.values.fill(0.0);
        self.taut.clear();
        let mut energy = -solid.dead_work(x, load);
        let width = solid.mesh.kind.nodes();
        let pairs = width * (width + 1) / 2;
        let mut force = [Vec3::ZERO; MOST_NODES];
        let mut k = [[Vec3::ZERO; 3]; MOST_NODES * (MOST_NODES + 1) / 2];
        for (element, slots) in solid.elements.iter().zip(solid.slots.chunks_exact(pairs)) {
            energy += element.tangent(x, &mut force[..width], &mut k[..pairs]);
            if !energy.is_finite() {
                return f64::INFINITY;
            }
            self.add_element(element.nodes(), slots, &force, &k);
        }
        self.add_dead(x.len(), load);
        for (c, cable) in solid.cables.iter().enumerate() {
            let command = load.cables[c];
            let tension = cable.tension(x, command);
            energy += cable.energy(x, command);
            if tension > 0.0 {
                self.add_cable(c, x, tension);
            }
        }
        energy
    }

    /// Residual alone at a state; whether the same cables pull as at the assembled one, so that its
    /// factor is still valid.
    pub fn balance(&mut self, x: &[Vec3], load: &Load) -> bool {
        let solid = self.solid;
        self.residual.fill(0.0);
        let mut force = [Vec3::ZERO; MOST_NODES];
        for element in &solid.elements {
            let force = &mut force[..element.nodes().len()];
            force.fill(Vec3::ZERO);
            element.force(x, force);
            for (node, force) in element.nodes().iter().zip(force) {
                solid.scatter(*node, *force, &mut self.residual);
            }
        }
        self.add_dead(x.len(), load);
        let mut pulling = vec![];
        for (c, cable) in solid.cables.iter().enumerate() {
            let tension = cable.tension(x, load.cables[c]);
            if tension > 0.0 {
                let slope = self.slope(c, x).into_iter();
                let pairs = self.residual.iter_mut().zip(slope);
                pairs.for_each(|(r, s)| *r += tension * s);
                pulling.extend((cable.drive == Drive::Shortening).then_some(c));
            }
        }
        pulling.iter().eq(self.taut.iter().map(|(c, _)| c))
    }

    /// Subtract the dead forces on the first `nodes` from the residual.
    fn add_dead(&mut self, nodes: usize, load: &Load) {
        for n in 0..nodes {
            let force = self.solid.dead_force(n, load);
            self.solid.scatter(n, -force, &mut self.residual);
        }
    }

    fn add_element(&mut self, nodes: &[usize], slots: &[u32], force: &[Vec3], k: &[Block]) {
        let solid = self.solid;
        let mut pair = 0;
        for a in 0..nodes.len() {
            solid.scatter(nodes[a], force[a], &mut self.residual);
            let fa = solid.free[nodes[a]];
            for b in 0..=a {
                let fb = solid.free[nodes[b]];
                let (slot, m) = (slots[pair] as usize, &k[pair]);
                pair += 1;
                if fa == HELD || fb == HELD {
                    continue;
                }
                if fa >= fb {
                    solid.pattern.add(&mut self.values, fb, slot, m);
                } else {
                    let turned: [[f64; 3]; 3] =
                        std::array::from_fn(|i| std::array::from_fn(|j| m[j][i]));
                    solid.pattern.add(&mut self.values, fa, slot, &turned);
                }
            }
        }
    }

    fn add_cable(&mut self, c: usize, x: &[Vec3], tension: f64) {
        let solid = self.solid;
        let cable = &solid.cables[c];
        let slope = self.slope(c, x);
        for (r, s) in self.residual.iter_mut().zip(&slope) {
            *r += tension * s;
        }
        if cable.drive == Drive::Shortening {
            self.taut.push((c, slope));
        }
        cable.geometric(x, tension, |a, b, block| {
            let (fa, fb) = (solid.free[a], solid.free[b]);
            if fa != HELD
                && fb != HELD
                && let Some(slot) = solid.pattern.slot(fa, fb)
            {
                solid.pattern.add(&mut self.values, fb, slot, &block);
            }
        });
    }

    /// Factor the assembled tangent, with a shift of its diagonal if it is indefinite; false on
    /// failure.
    pub fn refactor(&mut self) -> bool {
        let pattern = &self.solid.pattern;
        let mean = pattern.mean_diagonal(&self.values);
        self.shift = 0.0;
        let mut ok = self.factor.refactor(pattern, &self.values);
        let mut next = 1e-4 * mean;
        while !ok && next < mean {
            let mut shifted = self.values.clone();
            pattern.shift(&mut shifted, next);
            self.shift = next;
            ok = self.factor.refactor(pattern, &shifted);
            next *= 4.0;
        }
        if !ok {
            return false;
        }
        self.solved = self
            .taut
            .iter()
            .flat_map(|(_, b)| b.iter().copied())
            .collect();
        if !self.taut.is_empty() {
            self.factor.solve(pattern, &mut self.solved);
        }
        let n = self.solid.unknowns();
        self.small = self
            .taut
            .iter()
            .enumerate()
            .map(|(i, (c, b))| {
                let mut row: Vec<f64> = self
                    .solved
                    .chunks_exact(n.max(1))
                    .map(|z| inner(b, z))
                    .collect();
                row[i] += 1.0 / self.solid.cables[*c].stiffness;
                row
            })
            .collect();
        true
    }

    /// Solve with the factored tangent (with its shift, if any) and the taut cables.
    pub fn solve(&mut self, mut rhs: Vec<f64>) -> Vec<f64> {
        self.factor.solve(&self.solid.pattern, &mut rhs);
        let right: Vec<f64> = self.taut.iter().map(|(_, b)| inner(b, &rhs)).collect();
        if let Some(s) = dense::solve(self.small.clone(), right) {
            for (z, s) in self.solved.chunks_exact(rhs.len().max(1)).zip(s) {
                rhs.iter_mut().zip(z).for_each(|(r, z)| *r -= s * z);
            }
        }
        rhs
    }

    /// Solve with K₀ alone: the tension of every cable is constant. If K₀ is indefinite, a body
    /// supported by its cables is unstable at constant tension; the shift then bounds the response.
    pub fn solve_slack(&mut self, mut rhs: Vec<f64>) -> Vec<f64> {
        self.factor.solve(&self.solid.pattern, &mut rhs);
        rhs
    }

    /// ∂L/∂x of a cable, taut or not.
    pub fn slope(&self, cable: usize, x: &[Vec3]) -> Vec<f64> {
        let mut slope = vec![0.0; self.solid.unknowns()];
        self.solid.cables[cable].slope(x, |n, v| self.solid.scatter(n, v, &mut slope));
        slope
    }

    /// The assembled tangent, cables included, times a vector.
    pub fn multiply(&self, x: &[f64]) -> Vec<f64> {
        let mut y = vec![0.0; x.len()];
        self.solid.pattern.multiply(&self.values, x, &mut y);
        for (c, b) in &self.taut {
            let s = self.solid.cables[*c].stiffness * inner(b, x);
            y.iter_mut().zip(b).for_each(|(y, b)| *y += s * b);
        }
        y
    }
}

pub(super) fn inner(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(p, q)| p * q).sum()
}
