//! Meshes, and those of 8-node bricks: the round tapered finger as an O-grid, and the block.
//!
//! The base frame's origin is at the centre of the clamped base, z runs to the tip; nodes at z = 0
//! or below are clamped. A layer of the O-grid is a square core of `core` × `core` cells inside
//! `rings` rings of 4·`core` cells. The outer polygon is inflated to the area of the circle, so
//! weight and axial stiffness are correct at every resolution. 3×3 core, 1 ring, 42 layers: 1204
//! nodes, 882 bricks, 548 surface vertices.

use super::Vec3;
use super::natural::Kind;
use crate::error::{Result, invalid};
use std::collections::HashMap;
use std::f64::consts::{FRAC_PI_2, FRAC_PI_4, PI};

/// Corner of the core, as a fraction of the outer radius: makes the ring's cells about as thick as
/// wide.
const CORE_FRACTION: f64 = 0.62;
/// Nodes times nodes of a layer: the factored tangent is a band, and grows with this. Usual meshes
/// have 3e4.
const MOST_WORK: usize = 4_000_000;
/// GB of the factor for each of these: 9 numbers of 8 bytes per pair of nodes, twice for the fill
/// beyond a layer.
const FACTOR_BYTES: f64 = 2.0 * 9.0 * 8e-9;

/// The cross-section of a mesh, if known.
#[derive(Debug, Clone)]
pub enum Section {
    /// Round: the profile `(z, radius)` and the cells across the core.
    Disc(Vec<[f64; 2]>, usize),
    /// A block: half its width and depth, and the fewest cells across.
    Rectangle([f64; 2], usize),
    /// Any other: given by the cells only.
    Free,
}

/// Cells of one kind in the rest configuration, with the clamped nodes and the outer surface.
#[derive(Debug, Clone)]
pub struct Mesh {
    pub nodes: Vec<Vec3>,
    pub kind: Kind,
    /// Nodes of the cells, one cell after the other.
    pub cells: Vec<usize>,
    /// Clamped.
    pub clamped: Vec<bool>,
    /// Node of each surface vertex, ascending.
    pub surface: Vec<usize>,
    /// Corners of the surface triangles as indices into `surface`, outward.
    pub triangles: Vec<[usize; 3]>,
    /// From the clamped base to the tip, mm.
    pub height: f64,
    pub section: Section,
    /// Height of each layer of nodes, mm, from base to tip; empty in a mesh without layers.
    pub levels: Vec<f64>,
    /// Nodes in a layer; layer k holds the nodes k·per_layer .. (k+1)·per_layer.
    pub per_layer: usize,
}

/// Cells of a finger mesh.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Resolution {
    pub core: usize,
    pub rings: usize,
    pub layers: usize,
}

/// Radius at height `z` of a piecewise linear profile `[(z, radius)]`, held constant beyond its
/// ends.
pub fn radius_at(profile: &[[f64; 2]], z: f64) -> f64 {
    let next = profile.partition_point(|p| p[0] < z);
    if next == 0 {
        return profile[0][1];
    }
    if next == profile.len() {
        return profile[next - 1][1];
    }
    let [[z0, r0], [z1, r1]] = [profile[next - 1], profile[next]];
    r0 + (r1 - r0) * (z - z0) / (z1 - z0)
}

/// Check a profile `[(z, radius)]` that starts at z = 0 and ascends.
pub fn check_profile(profile: &[[f64; 2]]) -> Result<()> {
    let ascending = profile.windows(2).all(|w| w[1][0] > w[0][0]);
    let finite = profile
        .iter()
        .all(|p| p[0].is_finite() && p[1].is_finite() && p[1] > 0.0);
    if profile.len() < 2 || !ascending || !finite || profile[0][0] != 0.0 {
        return Err(invalid(
            "profile: expected at least two (z, radius) pairs in mm, z from 0 ascending, radius \
            above 0; check profile_mm",
        ));
    }
    Ok(())
}

/// The finger: layers between `breaks` (required layer heights: the ends of tendons), base clamped.
pub fn finger(profile: &[[f64; 2]], breaks: &[f64], resolution: Resolution) -> Result<Mesh> {
    let Resolution {
        core,
        rings,
        layers,
    } = resolution;
    check_profile(profile)?;
    if core == 0 || rings == 0 || core > 16 || rings > 16 || layers > 400 {
        return Err(invalid(format!(
            "mesh core {core}, rings {rings}, layers {layers}: allowed are 1-16, 1-16 and at most \
            400; 3, 1, 42 is usual"
        )));
    }
    let per_layer = (core + 1) * (core + 1) + 4 * core * rings;
    let nodes = per_layer * (layers + 1);
    if nodes * per_layer > MOST_WORK {
        return Err(invalid(format!(
            "mesh core {core}, rings {rings}, layers {layers}: {nodes} nodes, {per_layer} a layer, \
            need about {:.1} GB a core to solve, at most {:.1} GB are allowed; 3, 1, 42 is usual",
            nodes as f64 * per_layer as f64 * FACTOR_BYTES,
            MOST_WORK as f64 * FACTOR_BYTES,
        )));
    }
    let levels = layer_heights(profile[profile.len() - 1][0], breaks, layers)?;
    let disc = unit_disc(core, rings);
    let nodes = levels
        .iter()
        .flat_map(|&z| {
            let r = radius_at(profile, z);
            disc.iter()
                .map(move |p| Vec3::new(r * p[0], r * p[1], z))
                .collect::<Vec<_>>()
        })
        .collect();
    let mut bricks = Vec::new();
    for layer in 0..layers {
        let (low, high) = (layer * per_layer, (layer + 1) * per_layer);
        for q in disc_cells(core, rings) {
            bricks.push([
                q[0] + low,
                q[1] + low,
                q[2] + low,
                q[3] + low,
                q[0] + high,
                q[1] + high,
                q[2] + high,
                q[3] + high,
            ]);
        }
    }
    let section = Section::Disc(profile.to_vec(), core);
    Ok(Mesh::layered(nodes, bricks, section, levels, per_layer))
}

/// A block of `cells` bricks and `size` mm, z = 0 at its clamped face, x and y through its middle.
pub fn block(cells: [usize; 3], size: Vec3) -> Result<Mesh> {
    let [nx, ny, nz] = cells;
    if !(size.is_finite() && size.cmpgt(Vec3::ZERO).all()) {
        return Err(invalid(format!(
            "block of {size} mm: each length must be above 0; measure width, depth and height"
        )));
    }
    let per_layer = nx.saturating_add(1).saturating_mul(ny.saturating_add(1));
    let work = per_layer
        .saturating_mul(per_layer)
        .saturating_mul(nz.saturating_add(1));
    if cells.contains(&0) || nz > 400 || work > MOST_WORK {
        return Err(invalid(format!(
            "block of {cells:?} cells: allowed are 1 or more each way, at most 400 along z, and \
            about {:.1} GB a core to solve; 4, 4, 20 is usual",
            MOST_WORK as f64 * FACTOR_BYTES,
        )));
    }
    let step = size / Vec3::from(cells.map(|n| n as f64));
    let at = |i: usize, j: usize, k: usize| (k * (ny + 1) + j) * (nx + 1) + i;
    let (mut nodes, mut bricks) = (Vec::new(), Vec::new());
    for k in 0..=nz {
        for j in 0..=ny {
            for i in 0..=nx {
                let (x, y) = (i as f64 * step[0], j as f64 * step[1]);
                nodes.push(Vec3::new(
                    x - 0.5 * size[0],
                    y - 0.5 * size[1],
                    k as f64 * step[2],
                ));
                if i < nx && j < ny && k < nz {
                    let q = |k: usize| {
                        [
                            at(i, j, k),
                            at(i + 1, j, k),
                            at(i + 1, j + 1, k),
                            at(i, j + 1, k),
                        ]
                    };
                    let (low, high) = (q(k), q(k + 1));
                    bricks.push([
                        low[0], low[1], low[2], low[3], high[0], high[1], high[2], high[3],
                    ]);
                }
            }
        }
    }
    let levels = (0..=nz).map(|k| k as f64 * step[2]).collect();
    let section = Section::Rectangle([0.5 * size[0], 0.5 * size[1]], nx.min(ny));
    Ok(Mesh::layered(nodes, bricks, section, levels, per_layer))
}

impl Mesh {
    fn layered(
        nodes: Vec<Vec3>,
        bricks: Vec<[usize; 8]>,
        section: Section,
        levels: Vec<f64>,
        per_layer: usize,
    ) -> Mesh {
        let clamped = (0..nodes.len()).map(|n| n < per_layer).collect();
        let cells = bricks.into_flattened();
        let (surface, triangles) = outer_surface(Kind::Brick, &cells);
        Mesh {
            nodes,
            kind: Kind::Brick,
            cells,
            clamped,
            surface,
            triangles,
            height: levels[levels.len() - 1],
            section,
            levels,
            per_layer,
        }
    }

    /// Nodes of each cell.
    pub fn each_cell(&self) -> std::slice::ChunksExact<'_, usize> {
        self.cells.chunks_exact(self.kind.nodes())
    }
}

/// Heights of the node layers: uniform between breaks, so every break is a layer.
fn layer_heights(height: f64, breaks: &[f64], layers: usize) -> Result<Vec<f64>> {
    let mut ends: Vec<f64> = breaks
        .iter()
        .copied()
        .filter(|&z| z > 1e-9 && z < height - 1e-9)
        .collect();
    ends.extend([0.0, height]);
    ends.sort_by(f64::total_cmp);
    ends.dedup_by(|a, b| (*a - *b).abs() < 1e-6);
    let spans = ends.len() - 1;
    if layers < spans {
        return Err(invalid(format!(
            "mesh layers {layers}: the tendons' ends cut the finger into {spans} spans; use at \
            least {spans} layers"
        )));
    }
    let mut count = vec![1usize; spans];
    for _ in spans..layers {
        // Add the next layer where layers are thickest.
        let thick = |i: usize| (ends[i + 1] - ends[i]) / count[i] as f64;
        let best = (0..spans)
            .max_by(|&a, &b| thick(a).total_cmp(&thick(b)))
            .unwrap_or(0);
        count[best] += 1;
    }
    let mut levels = vec![0.0];
    for (i, &n) in count.iter().enumerate() {
        levels.extend((1..=n).map(|k| ends[i] + (ends[i + 1] - ends[i]) * k as f64 / n as f64));
    }
    Ok(levels)
}

/// Nodes of one layer on a disc of unit area-radius: the core row by row, then the rings outwards.
fn unit_disc(core: usize, rings: usize) -> Vec<[f64; 2]> {
    let sides = 4 * core;
    let inflate = (2.0 * PI / (sides as f64 * (2.0 * PI / sides as f64).sin())).sqrt();
    let mut nodes = Vec::new();
    for j in 0..=core {
        for i in 0..=core {
            let place = |k: usize| 2.0 * k as f64 / core as f64 - 1.0;
            nodes.push(core_place(place(i), place(j)));
        }
    }
    for ring in 1..=rings {
        let s = ring as f64 / rings as f64;
        for (k, &inner) in core_rim(core).iter().enumerate() {
            let angle = FRAC_PI_2 * k as f64 / core as f64 - FRAC_PI_4;
            let (p, outer) = (nodes[inner], [inflate * angle.cos(), inflate * angle.sin()]);
            nodes.push([p[0] + s * (outer[0] - p[0]), p[1] + s * (outer[1] - p[1])]);
        }
    }
    nodes
}

/// Halfway between a square and a disc: bulged sides keep the cells' corners away from 180°.
fn core_place(a: f64, b: f64) -> [f64; 2] {
    let m = a.abs().max(b.abs());
    if m == 0.0 {
        return [0.0, 0.0];
    }
    let angle = if a.abs() >= b.abs() {
        FRAC_PI_4 * b / a + if a > 0.0 { 0.0 } else { PI }
    } else {
        -FRAC_PI_4 * a / b + if b > 0.0 { FRAC_PI_2 } else { -FRAC_PI_2 }
    };
    let square = 0.5f64.sqrt();
    [
        CORE_FRACTION * 0.5 * (square * a + m * angle.cos()),
        CORE_FRACTION * 0.5 * (square * b + m * angle.sin()),
    ]
}

/// Core nodes on its rim, counter-clockwise from the corner at −45°.
fn core_rim(core: usize) -> Vec<usize> {
    let at = |i: usize, j: usize| j * (core + 1) + i;
    let mut rim: Vec<usize> = (0..core).map(|j| at(core, j)).collect();
    rim.extend((0..core).map(|i| at(core - i, core)));
    rim.extend((0..core).map(|j| at(0, core - j)));
    rim.extend((0..core).map(|i| at(i, 0)));
    rim
}

fn disc_cells(core: usize, rings: usize) -> Vec<[usize; 4]> {
    let at = |i: usize, j: usize| j * (core + 1) + i;
    let mut cells = Vec::new();
    for j in 0..core {
        for i in 0..core {
            cells.push([at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)]);
        }
    }
    let sides = 4 * core;
    let mut inner = core_rim(core);
    for ring in 0..rings {
        let first = (core + 1) * (core + 1) + ring * sides;
        let outer: Vec<usize> = (first..first + sides).collect();
        for k in 0..sides {
            let n = (k + 1) % sides;
            cells.push([inner[k], outer[k], outer[n], inner[n]]);
        }
        inner = outer;
    }
    cells
}

/// Vertices and outward triangles of the faces that belong to one cell only.
pub(super) fn outer_surface(kind: Kind, cells: &[usize]) -> (Vec<usize>, Vec<[usize; 3]>) {
    let mut seen: HashMap<Vec<usize>, usize> = HashMap::new();
    let faces = |cell: &[usize]| -> Vec<Vec<usize>> {
        let corners = |f: &&[usize]| f.iter().map(|&c| cell[c]).collect();
        kind.faces().iter().map(corners).collect()
    };
    let key = |f: &[usize]| {
        let mut f = f.to_vec();
        f.sort_unstable();
        f
    };
    for cell in cells.chunks_exact(kind.nodes()) {
        for face in faces(cell) {
            *seen.entry(key(&face)).or_default() += 1;
        }
    }
    let outer: Vec<Vec<usize>> = cells
        .chunks_exact(kind.nodes())
        .flat_map(faces)
        .filter(|f| seen[&key(f)] == 1)
        .collect();
    let mut surface: Vec<usize> = outer.iter().flatten().copied().collect();
    surface.sort_unstable();
    surface.dedup();
    let place: HashMap<usize, usize> = surface.iter().enumerate().map(|(i, &n)| (n, i)).collect();
    let triangles = outer
        .iter()
        .flat_map(|f| (2..f.len()).map(|k| [f[0], f[k - 1], f[k]]))
        .map(|t| t.map(|n| place[&n]))
        .collect();
    (surface, triangles)
}

#[cfg(test)]
#[path = "mesh_tests.rs"]
mod tests;
