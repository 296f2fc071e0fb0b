//! The solid: bricks, cables and dead loads on one mesh; their total energy and the pattern of their equations.
//!
//! Total energy = Σ bricks + Σ cables − Σ f·(x − X) with dead nodal forces f: own weight (consistent, ρ g) and a tip load
//! spread over the last tenth of the height. Its residual and tangent are assembled and solved in `work.rs`.

use super::brick::{Brick, Material};
use super::cable::{Averaging, Cable, Route};
use super::mesh::{self, Mesh, Resolution};
use super::sparse::Pattern;
use super::{Vec3, axpy, dot, sub};
use crate::error::{Result, invalid};
use crate::loads::STANDARD_GRAVITY;

pub use super::work::Work;

/// Part of the height over which a tip load is spread.
const TIP_PART: f64 = 0.1;
/// Number of a clamped node among the free ones.
pub(super) const HELD: usize = usize::MAX;

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
    pub(super) bricks: Vec<Brick>,
    /// Free number of each node, or HELD.
    pub(super) free: Vec<usize>,
    /// Weight of each node under 1 g, N.
    weight: Vec<f64>,
    /// Share of a tip load of each node; sums to 1.
    tip: Vec<f64>,
    pub(super) pattern: Pattern,
    /// Place in the pattern of each pair (a, b ≤ a) of each brick.
    pub(super) slots: Vec<[u32; 36]>,
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
            .map(|v| v * density * 1e-9 * STANDARD_GRAVITY) // kg/m³ = 1e-9 kg/mm³
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

    pub(super) fn dead_work(&self, x: &[Vec3], load: &Load) -> f64 {
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

    pub(super) fn scatter(&self, node: usize, v: Vec3, into: &mut [f64]) {
        let f = self.free[node];
        if f != HELD {
            for i in 0..3 {
                into[3 * f + i] += v[i];
            }
        }
    }
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
