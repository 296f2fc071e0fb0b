//! The solid: bricks, cables and dead loads on one mesh; its total energy, residual and tangent.
//!
//! Total energy = Σ bricks + Σ cables − Σ f·(x − X) with dead nodal forces f: own weight (consistent, ρ g) and a tip load
//! spread over the last tenth of the height. The tangent is K₀ + Σ kc b bᵀ over the taut cables, b = ∂L/∂x: K₀ (bricks and the
//! cables' geometric stiffness) is sparse; the stiff dense rank-one terms stay out of the pattern and enter solves through
//! the Woodbury identity (Hager 1989): (K₀ + B D Bᵀ)⁻¹ r = y − Z (D⁻¹ + BᵀZ)⁻¹ Bᵀ y with y = K₀⁻¹ r, Z = K₀⁻¹ B.

use super::brick::{Brick, Material, Stiffness};
use super::cable::{Averaging, Cable, Route};
use super::mesh::{self, Mesh, Resolution};
use super::sparse::{Factor, Pattern, solve_small};
use super::{Vec3, axpy, dot, sub};
use crate::error::{Result, invalid};

/// Standard gravity, mm/s², times kg → N/(mm/s²): 1 kg weighs 9.80665 N.
const STANDARD_GRAVITY: f64 = 9.80665;
/// Part of the height over which a tip load is spread.
const TIP_PART: f64 = 0.1;
/// Number of a clamped node among the free ones.
const HELD: usize = usize::MAX;

/// What a finger is made of (mm, MPa, kg/m³, N/mm).
#[derive(Debug, Clone)]
pub struct Design {
    pub profile: Vec<[f64; 2]>,
    pub resolution: Resolution,
    pub young: f64,
    pub poisson: f64,
    pub density: f64,
    pub cable_stiffness: f64,
    pub averaging: Averaging,
    pub routes: Vec<Route>,
}

/// What acts on a solid: shortening of each cable (mm), gravity (g), force on the tip (N).
#[derive(Debug, Clone, PartialEq)]
pub struct Load {
    pub shortening: Vec<f64>,
    pub gravity: Vec3,
    pub tip: Vec3,
}

/// Bricks, cables and the pattern of their equations.
pub struct Solid {
    pub mesh: Mesh,
    pub cables: Vec<Cable>,
    pub material: Material,
    bricks: Vec<Brick>,
    /// Free number of each node, or HELD.
    free: Vec<usize>,
    /// Weight of each node under 1 g, N.
    weight: Vec<f64>,
    /// Share of a tip load of each node; sums to 1.
    tip: Vec<f64>,
    pattern: Pattern,
    /// Place in the pattern of each pair (a, b ≤ a) of each brick.
    slots: Vec<[u32; 36]>,
}

impl Solid {
    /// The finger of a design; refused with the reason when it cannot be built.
    pub fn finger(design: &Design) -> Result<Solid> {
        let breaks: Vec<f64> = design
            .routes
            .iter()
            .flat_map(|r| r.path.first().into_iter().chain(r.path.last()))
            .map(|p| p[0])
            .collect();
        let mesh = mesh::finger(&design.profile, &breaks, design.resolution)?;
        let cables = design
            .routes
            .iter()
            .map(|route| {
                let core = design.resolution.core;
                Cable::new(
                    &mesh,
                    &design.profile,
                    core,
                    route,
                    design.averaging,
                    design.cable_stiffness,
                )
            })
            .collect::<Result<Vec<_>>>()?;
        Solid::new(
            mesh,
            cables,
            Material::new(design.young, design.poisson)?,
            design.density,
        )
    }

    /// Any mesh with cables bound to it; density in kg/m³.
    pub fn new(mesh: Mesh, cables: Vec<Cable>, material: Material, density: f64) -> Result<Solid> {
        if !(density.is_finite() && density >= 0.0) {
            return Err(invalid(format!(
                "density {density} kg/m³: must be 0 or more; silicones have about 1070"
            )));
        }
        let bricks = mesh
            .bricks
            .iter()
            .map(|b| Brick::new(&b.map(|n| mesh.nodes[n])))
            .collect::<Result<Vec<_>>>()?;
        let mut volume = vec![0.0; mesh.nodes.len()];
        for (brick, nodes) in bricks.iter().zip(&mesh.bricks) {
            for (a, &n) in nodes.iter().enumerate() {
                volume[n] += brick.share[a];
            }
        }
        let weight = volume
            .iter()
            .map(|v| v * density * 1e-9 * STANDARD_GRAVITY)
            .collect();
        let tip = tip_shares(&mesh, &volume);
        let (mut free, mut blocks) = (vec![HELD; mesh.nodes.len()], 0);
        for n in (0..mesh.nodes.len()).filter(|&n| !mesh.clamped[n]) {
            free[n] = blocks;
            blocks += 1;
        }
        let inside = mesh.bricks.iter().flat_map(|b| {
            let pairs = |a: usize| (0..=a).map(move |c| (b[a].max(b[c]), b[a].min(b[c])));
            (0..8).flat_map(pairs).collect::<Vec<_>>()
        });
        let pairs = inside
            .chain(cables.iter().flat_map(Cable::couplings))
            .map(|(a, b)| (free[a], free[b]))
            .filter(|&(a, b)| a != HELD && b != HELD);
        let pattern = Pattern::new(blocks, pairs)?;
        let slots = mesh
            .bricks
            .iter()
            .map(|b| brick_slots(&pattern, &b.map(|n| free[n])))
            .collect();
        Ok(Solid {
            mesh,
            cables,
            material,
            bricks,
            free,
            weight,
            tip,
            pattern,
            slots,
        })
    }

    /// Number of unknown coordinates.
    pub fn unknowns(&self) -> usize {
        self.pattern.unknowns()
    }

    /// Dead force on a node, N.
    pub fn dead_force(&self, node: usize, load: &Load) -> Vec3 {
        let own = load.gravity.map(|g| g * self.weight[node]);
        axpy(own, self.tip[node], load.tip)
    }

    /// Total energy, N·mm; infinite where a brick is inside out.
    pub fn energy(&self, x: &[Vec3], load: &Load) -> f64 {
        let mut energy = 0.0;
        for (brick, nodes) in self.bricks.iter().zip(&self.mesh.bricks) {
            energy += brick.energy(&nodes.map(|n| x[n]), self.material);
            if !energy.is_finite() {
                return f64::INFINITY;
            }
        }
        for (cable, &d) in self.cables.iter().zip(&load.shortening) {
            energy += cable.energy(x, d);
        }
        energy - self.dead_work(x, load)
    }

    fn dead_work(&self, x: &[Vec3], load: &Load) -> f64 {
        let moved = |n: usize| sub(x[n], self.mesh.nodes[n]);
        (0..x.len())
            .map(|n| dot(self.dead_force(n, load), moved(n)))
            .sum()
    }

    /// Add a vector of unknowns, scaled, to node places.
    pub fn displace(&self, x: &[Vec3], by: &[f64], scale: f64) -> Vec<Vec3> {
        let step = |f: usize| [by[3 * f], by[3 * f + 1], by[3 * f + 2]];
        x.iter()
            .zip(&self.free)
            .map(|(p, &f)| {
                if f == HELD {
                    *p
                } else {
                    axpy(*p, scale, step(f))
                }
            })
            .collect()
    }

    /// Right-hand side of a dead load.
    pub fn dead_vector(&self, load: &Load) -> Vec<f64> {
        let mut f = vec![0.0; self.unknowns()];
        for n in 0..self.free.len() {
            self.scatter(n, self.dead_force(n, load), &mut f);
        }
        f
    }

    fn scatter(&self, node: usize, v: Vec3, into: &mut [f64]) {
        let f = self.free[node];
        if f != HELD {
            for i in 0..3 {
                into[3 * f + i] += v[i];
            }
        }
    }
}

/// Kept storage of one thread: residual, tangent and factor at the last assembled state.
pub struct Work<'a> {
    pub solid: &'a Solid,
    /// Gradient of the total energy, N.
    pub residual: Vec<f64>,
    /// Cables that pull at the assembled state, and their b = ∂L/∂x.
    pub taut: Vec<(usize, Vec<f64>)>,
    /// What was added to the diagonal to make the factored tangent positive definite, N/mm.
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

    /// Energy, residual and K₀ at a state; infinite energy (and nothing usable) where a brick is inside out.
    pub fn assemble(&mut self, x: &[Vec3], load: &Load) -> f64 {
        let solid = self.solid;
        self.residual.fill(0.0);
        self.values.fill(0.0);
        self.taut.clear();
        let mut energy = -solid.dead_work(x, load);
        let (mut force, mut k): ([Vec3; 8], Stiffness) = ([[0.0; 3]; 8], [[[[0.0; 3]; 3]; 8]; 8]);
        for ((brick, nodes), slots) in solid
            .bricks
            .iter()
            .zip(&solid.mesh.bricks)
            .zip(&solid.slots)
        {
            energy += brick.tangent(&nodes.map(|n| x[n]), solid.material, &mut force, &mut k);
            if !energy.is_finite() {
                return f64::INFINITY;
            }
            self.add_brick(nodes, slots, &force, &k);
        }
        for n in 0..x.len() {
            let f = solid.dead_force(n, load);
            solid.scatter(n, [-f[0], -f[1], -f[2]], &mut self.residual);
        }
        for (c, cable) in solid.cables.iter().enumerate() {
            let d = load.shortening[c];
            let tension = cable.tension(x, d);
            energy += cable.energy(x, d);
            if tension > 0.0 {
                self.add_cable(c, x, tension);
            }
        }
        energy
    }

    fn add_brick(
        &mut self,
        nodes: &[usize; 8],
        slots: &[u32; 36],
        force: &[Vec3; 8],
        k: &Stiffness,
    ) {
        let solid = self.solid;
        let mut pair = 0;
        for a in 0..8 {
            solid.scatter(nodes[a], force[a], &mut self.residual);
            let fa = solid.free[nodes[a]];
            for b in 0..=a {
                let fb = solid.free[nodes[b]];
                let slot = slots[pair] as usize;
                pair += 1;
                if fa == HELD || fb == HELD {
                    continue;
                }
                if fa >= fb {
                    solid.pattern.add(&mut self.values, fb, slot, &k[a][b]);
                } else {
                    let m = &k[a][b];
                    let turned = std::array::from_fn(|i| std::array::from_fn(|j| m[j][i]));
                    solid.pattern.add(&mut self.values, fa, slot, &turned);
                }
            }
        }
    }

    fn add_cable(&mut self, c: usize, x: &[Vec3], tension: f64) {
        let solid = self.solid;
        let cable = &solid.cables[c];
        let mut slope = vec![0.0; solid.unknowns()];
        cable.slope(x, |n, v| solid.scatter(n, v, &mut slope));
        for (r, s) in self.residual.iter_mut().zip(&slope) {
            *r += tension * s;
        }
        self.taut.push((c, slope));
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

    /// Factor the assembled tangent, with a shift of its diagonal where it is indefinite; false when nothing helps.
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
        if let Some(s) = solve_small(self.small.clone(), right) {
            for (z, s) in self.solved.chunks_exact(rhs.len().max(1)).zip(s) {
                rhs.iter_mut().zip(z).for_each(|(r, z)| *r -= s * z);
            }
        }
        rhs
    }

    /// Solve with the true tangent: conjugate gradients preconditioned by the shifted factor where there was a shift.
    pub fn solve_exact(&mut self, rhs: Vec<f64>) -> Vec<f64> {
        let mut x = self.solve(rhs.clone());
        if self.shift == 0.0 {
            return x;
        }
        let mut r = rhs.clone();
        let product = self.multiply(&x);
        r.iter_mut().zip(&product).for_each(|(r, p)| *r -= p);
        let stop = 1e-10 * inner(&rhs, &rhs).sqrt();
        let mut z = self.solve(r.clone());
        let mut p = z.clone();
        for _ in 0..200 {
            let old = inner(&r, &z);
            if inner(&r, &r).sqrt() <= stop {
                break;
            }
            let q = self.multiply(&p);
            let alpha = old / inner(&p, &q);
            x.iter_mut().zip(&p).for_each(|(x, p)| *x += alpha * p);
            r.iter_mut().zip(&q).for_each(|(r, q)| *r -= alpha * q);
            z = self.solve(r.clone());
            let beta = inner(&r, &z) / old;
            p.iter_mut().zip(&z).for_each(|(p, z)| *p = z + beta * *p);
        }
        x
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

/// Shares of a tip load: volume in the last tenth of the height, faded in over half of it so that no mesh is special.
fn tip_shares(mesh: &Mesh, volume: &[f64]) -> Vec<f64> {
    let part = TIP_PART * mesh.height();
    let fade = |z: f64| ((z - mesh.height() + part) / (0.5 * part)).clamp(0.0, 1.0);
    let mut share: Vec<f64> = (0..volume.len())
        .map(|n| volume[n] * fade(mesh.nodes[n][2]))
        .collect();
    let total: f64 = share.iter().sum();
    share.iter_mut().for_each(|s| *s /= total);
    share
}

fn brick_slots(pattern: &Pattern, free: &[usize; 8]) -> [u32; 36] {
    let (mut slots, mut pair) = ([0; 36], 0);
    for a in 0..8 {
        for b in 0..=a {
            if free[a] != HELD && free[b] != HELD {
                let slot = pattern.slot(free[a].max(free[b]), free[a].min(free[b]));
                slots[pair] = slot.unwrap_or(0) as u32; // every pair of a brick is in the pattern
            }
            pair += 1;
        }
    }
    slots
}
