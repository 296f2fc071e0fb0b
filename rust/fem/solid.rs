//! The solid: elements, cables and dead loads on one mesh; their total energy and the pattern of
//! their equations.
//!
//! Total energy = Σ elements + Σ cables − Σ f·(x − X) with dead nodal forces f: own weight
//! (consistent, ρ g) and a tip load spread over the last tenth of the height, with a slope if it
//! acts at another height. Its residual and tangent are assembled and solved in `work.rs`.

use super::Vec3;
use super::cable::{Cable, Drive};
use super::change::{self, Change};
use super::element::{Element, elements};
use super::guide::Averaging;
use super::material::Body;
use super::mesh::Mesh;
use super::route::Route;
use crate::algebra::dense;
use crate::algebra::sparse::Pattern;
use crate::error::{Result, invalid};
use crate::response::loads::{STANDARD_GRAVITY, STATIONS};

pub use super::work::Work;

/// Part of the height over which a tip load is spread.
const TIP_PART: f64 = 0.1;
/// Standard deviation along the height of a push at a station, as a part of it.
const PUSH_WIDTH: f64 = 0.04;
/// Largest distance of a tip load outside the body, as a part of the height.
const LOAD_REACH: f64 = 0.5;
/// Slope of its shares over the height above which they are round-off.
const STEEPEST: f64 = 1e4;
/// Marks a clamped node among the free numbers.
pub(super) const HELD: usize = usize::MAX;

/// The design of a finger (mm, MPa, kg/m³, N/mm), and its changes.
#[derive(Debug, Clone)]
pub struct Design {
    pub mesh: Mesh,
    pub body: Body,
    pub cable_stiffness: f64,
    /// Shortening of every cable relative to its path at rest, mm; negative if slack.
    pub pretension: f64,
    /// Position of a tip load at rest, mm; by default the middle of the tip.
    pub load_at: Option<Vec3>,
    pub averaging: Averaging,
    pub routes: Vec<Route>,
    pub drive: Drive,
    pub change: Change,
}

/// The loads of a solid: command of each cable (shortening in mm, or tension in N), gravity (g),
/// force on the tip (N).
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Load {
    pub cables: Vec<f64>,
    pub gravity: Vec3,
    pub tip: Vec3,
}

/// Elements, cables and the pattern of their equations.
pub struct Solid {
    pub mesh: Mesh,
    pub cables: Vec<Cable>,
    pub(super) elements: Vec<Box<dyn Element>>,
    /// Free number of each node, or HELD.
    pub(super) free: Vec<usize>,
    /// Weight of each node under 1 g, N.
    weight: Vec<f64>,
    /// Share of a tip load of each node; sums to 1.
    tip: Vec<f64>,
    /// The same for a push at each station except the tip.
    push: Vec<Vec<f64>>,
    pub(super) pattern: Pattern,
    /// Place in the pattern of each pair (a, b ≤ a) of each element, one element after the other.
    pub(super) slots: Vec<u32>,
    /// The design that it was built from.
    pub(super) design: Option<Box<Design>>,
}

impl Solid {
    /// The finger of a design; an error with the reason if it cannot be built.
    pub fn build(design: Design) -> Result<Solid> {
        let mut made = design.clone();
        let cables = change::bind(&mut made)?;
        let mut solid = Solid::new(made.mesh, cables, &made.body)?;
        if let Some(place) = design.load_at {
            solid.load_at(place)?;
        }
        solid.design = Some(Box::new(design));
        Ok(solid)
    }

    /// Any mesh with cables bound to it.
    pub fn new(mesh: Mesh, cables: Vec<Cable>, body: &Body) -> Result<Solid> {
        let mut elements = elements(mesh.kind, mesh.each_cell().enumerate(), &mesh.nodes, body)?;
        let mut volume = vec![0.0; mesh.nodes.len()];
        for element in &elements {
            for (&n, share) in element.nodes().iter().zip(element.share()) {
                volume[n] += share;
            }
        }
        let weight = volume
            .iter()
            .map(|v| v * body.density * 1e-9 * STANDARD_GRAVITY) // kg/m³ = 1e-9 kg/mm³
            .collect();
        let tip = tip_shares(&mesh, &volume);
        let stations = STATIONS.iter().take(STATIONS.len() - 1);
        let push = stations.map(|s| push_shares(&mesh, &volume, *s)).collect();
        // A completely clamped cell, in a flange, has weight but no unknowns.
        elements.retain(|e| e.nodes().iter().any(|&n| !mesh.clamped[n]));
        let (mut free, mut blocks) = (vec![HELD; mesh.nodes.len()], 0);
        for n in (0..mesh.nodes.len()).filter(|&n| !mesh.clamped[n]) {
            free[n] = blocks;
            blocks += 1;
        }
        let inside = elements.iter().flat_map(|e| {
            let nodes = e.nodes();
            let pairs = move |a: usize| {
                (0..=a).map(move |c| (nodes[a].max(nodes[c]), nodes[a].min(nodes[c])))
            };
            (0..nodes.len()).flat_map(pairs)
        });
        let pairs = inside
            .chain(cables.iter().flat_map(Cable::couplings))
            .map(|(a, b)| (free[a], free[b]))
            .filter(|&(a, b)| a != HELD && b != HELD);
        let pattern = Pattern::new(blocks, pairs)?;
        let slots = elements
            .iter()
            .flat_map(|e| element_slots(&pattern, &free, e.nodes()))
            .collect();
        Ok(Solid {
            mesh,
            cables,
            elements,
            free,
            weight,
            tip,
            push,
            pattern,
            slots,
            design: None,
        })
    }

    /// Move a tip load to a position of the rest shape, mm: the shares get a slope, so they give
    /// its force and moment.
    fn load_at(&mut self, place: Vec3) -> Result<()> {
        let nodes = &self.mesh.nodes;
        let middle = (0..nodes.len())
            .map(|n| self.tip[n] * nodes[n])
            .sum::<Vec3>();
        let away = place - middle;
        let far = away.length();
        if far.is_nan() || far > LOAD_REACH * self.mesh.height {
            return Err(invalid(format!(
                "load at ({:.4}, {:.4}, {:.4}) mm: allowed is up to {:.4} mm from the middle of \
                the tip at ({:.4}, {:.4}, {:.4}) mm",
                place[0],
                place[1],
                place[2],
                LOAD_REACH * self.mesh.height,
                middle[0],
                middle[1],
                middle[2]
            )));
        }
        let mut spread = vec![vec![0.0; 3]; 3];
        for (n, share) in self.tip.iter().enumerate() {
            let d = nodes[n] - middle;
            for (a, row) in spread.iter_mut().enumerate() {
                row.iter_mut()
                    .zip(d.to_array())
                    .for_each(|(s, b)| *s += share * d[a] * b);
            }
        }
        let slope = match dense::solve(spread, away.to_array().to_vec()).as_deref() {
            Some(&[x, y, z])
                if [x, y, z]
                    .iter()
                    .all(|s| s.abs() * self.mesh.height < STEEPEST) =>
            {
                Vec3::new(x, y, z)
            }
            _ => {
                return Err(invalid(format!(
                    "load at ({:.4}, {:.4}, {:.4}) mm: the last tenth of the mesh is one layer of \
                    nodes and carries no moment; use more layers",
                    place[0], place[1], place[2]
                )));
            }
        };
        for (n, share) in self.tip.iter_mut().enumerate() {
            *share *= 1.0 + slope.dot(nodes[n] - middle);
        }
        Ok(())
    }

    /// Number of unknown coordinates.
    pub fn unknowns(&self) -> usize {
        self.pattern.unknowns()
    }

    /// Dead force on a node, N.
    pub fn dead_force(&self, node: usize, load: &Load) -> Vec3 {
        self.weight[node] * load.gravity + self.tip[node] * load.tip
    }

    /// Total energy, N·mm; infinite if a cell is inverted.
    pub fn energy(&self, x: &[Vec3], load: &Load) -> f64 {
        let mut energy = 0.0;
        for element in &self.elements {
            energy += element.energy(x);
            if !energy.is_finite() {
                return f64::INFINITY;
            }
        }
        for (cable, &command) in self.cables.iter().zip(&load.cables) {
            energy += cable.energy(x, command);
        }
        energy - self.dead_work(x, load)
    }

    pub(super) fn dead_work(&self, x: &[Vec3], load: &Load) -> f64 {
        let moved = |n: usize| x[n] - self.mesh.nodes[n];
        (0..x.len())
            .map(|n| self.dead_force(n, load).dot(moved(n)))
            .sum()
    }

    /// Add a vector of unknowns, scaled, to node places.
    pub fn displace(&self, x: &[Vec3], by: &[f64], scale: f64) -> Vec<Vec3> {
        let step = |f: usize| Vec3::from_slice(&by[3 * f..]);
        x.iter()
            .zip(&self.free)
            .map(|(p, &f)| if f == HELD { *p } else { p + scale * step(f) })
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

    /// Right-hand side of 1 N along an axis at a station.
    pub fn push_vector(&self, station: usize, axis: usize) -> Vec<f64> {
        let mut f = vec![0.0; self.unknowns()];
        for (n, share) in self.push[station].iter().enumerate() {
            self.scatter(n, *share * Vec3::AXES[axis], &mut f);
        }
        f
    }

    /// Forces of all nodes, on the unknowns.
    pub(super) fn gathered(&self, force: Vec<Vec3>) -> Vec<f64> {
        let mut unknowns = vec![0.0; self.unknowns()];
        for (n, f) in force.into_iter().enumerate() {
            self.scatter(n, f, &mut unknowns);
        }
        unknowns
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

/// Shares of a tip load: volume in the last tenth of the height, faded in over half of it to be
/// independent of the mesh.
fn tip_shares(mesh: &Mesh, volume: &[f64]) -> Vec<f64> {
    let part = TIP_PART * mesh.height;
    let fade = |z: f64| ((z - mesh.height + part) / (0.5 * part)).clamp(0.0, 1.0);
    let mut share: Vec<f64> = (0..volume.len())
        .map(|n| volume[n] * fade(mesh.nodes[n][2]))
        .collect();
    let total: f64 = share.iter().sum();
    share.iter_mut().for_each(|s| *s /= total);
    share
}

/// Shares of a push at a share of the height: volume, bell-shaped along it to be independent of the
/// mesh.
fn push_shares(mesh: &Mesh, volume: &[f64], station: f64) -> Vec<f64> {
    let away = |z: f64| (z / mesh.height - station) / PUSH_WIDTH;
    let share = |n: usize| volume[n] * (-0.5 * away(mesh.nodes[n][2]).powi(2)).exp();
    let shares: Vec<f64> = (0..volume.len()).map(share).collect();
    let total: f64 = shares.iter().sum();
    shares.into_iter().map(|s| s / total).collect()
}

fn element_slots(pattern: &Pattern, free: &[usize], nodes: &[usize]) -> Vec<u32> {
    let pairs =
        (0..nodes.len()).flat_map(|a| (0..=a).map(move |b| (free[nodes[a]], free[nodes[b]])));
    let slot = |(a, b): (usize, usize)| {
        if a == HELD || b == HELD {
            return 0;
        }
        // Every pair of an element is in the pattern.
        pattern.slot(a.max(b), a.min(b)).unwrap_or(0) as u32
    };
    pairs.map(slot).collect()
}
