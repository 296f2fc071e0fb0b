//! Imported meshes of tetrahedra: checked, promoted to ten nodes, refined.
//!
//! Four-node cells lock; each gets a node at the middle of every edge, shared with its neighbours.
//! Refining splits a cell into eight at its mid-edges (Bey 1995), the octahedron in its middle
//! along its shortest diagonal. Rejected, with one line: no cells, non-finite numbers, invalid node
//! indices, inverted or flat cells, loose nodes, several bodies, an impossible size, no clamped
//! nodes. Units: mm in the base frame; z ≤ 0 is clamped.

use super::Vec3;
use super::mesh::{Mesh, Section, outer_surface};
use super::natural::{EDGES, Kind};
use crate::error::{Result, invalid};
use std::collections::HashMap;

/// Most cells of a mesh: beyond, one factor needs more than about 4 GB.
const MOST_CELLS: usize = 60_000;
/// A cell with less volume than this times its longest edge cubed is flat; an equilateral one has
/// 0.118.
const FLAT: f64 = 1e-4;
/// Plausible heights of a finger, mm; others are in another unit.
const HEIGHTS: [f64; 2] = [2.0, 2000.0];
/// Nodes up to this height above the base plane are also clamped, as a part of the height.
const ON_BASE: f64 = 1e-6;

/// A mesh of 4-node (promoted) or 10-node tetrahedra, in VTK's order of nodes, refined `refine`
/// times.
pub fn tetrahedra(nodes: Vec<Vec3>, cells: &[Vec<usize>], refine: usize) -> Result<Mesh> {
    check_numbers(&nodes, cells, refine)?;
    check_nodes(nodes.len(), cells)?;
    let (low, high) = nodes
        .iter()
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), p| {
            (a.min(p[2]), b.max(p[2]))
        });
    if !(HEIGHTS[0]..=HEIGHTS[1]).contains(&high) {
        return Err(invalid(format!(
            "the mesh reaches from z = {low:.4} to {high:.4} mm above its base plane; a finger is \
            {} to {} mm tall: give the file's unit, axes and origin",
            HEIGHTS[0], HEIGHTS[1]
        )));
    }
    let (mut nodes, mut cells) = (nodes, cells.to_vec());
    check_cells(&nodes, &cells)?;
    promote(&mut nodes, &mut cells);
    for _ in 0..refine {
        cells = split(&nodes, &cells);
        promote(&mut nodes, &mut cells);
    }
    let clamped: Vec<bool> = nodes.iter().map(|p| p[2] <= ON_BASE * high).collect();
    let held = clamped.iter().filter(|&&c| c).count();
    if held < 3 || held == nodes.len() {
        return Err(invalid(format!(
            "{held} of {} nodes lie at or below z = 0 and are held; put the origin where the \
            finger leaves its clamp",
            nodes.len()
        )));
    }
    let cells = cells.concat();
    let (surface, triangles) = outer_surface(Kind::Tetrahedron, &cells);
    Ok(Mesh {
        nodes,
        kind: Kind::Tetrahedron,
        cells,
        clamped,
        surface,
        triangles,
        height: high,
        section: Section::Free,
        levels: Vec::new(),
        per_layer: 0,
    })
}

fn check_numbers(nodes: &[Vec3], cells: &[Vec<usize>], refine: usize) -> Result<()> {
    if cells.is_empty() {
        return Err(invalid(
            "the mesh has no tetrahedra; mesh the volume, not the surface alone, and save its \
            tetrahedra",
        ));
    }
    let count = (0..refine.min(10)).fold(cells.len(), |n, _| n.saturating_mul(8));
    if count > MOST_CELLS {
        return Err(invalid(format!(
            "the mesh has {} tetrahedra, refined {refine} times {count}; at most {MOST_CELLS} are \
            solved: mesh it coarser (cells of a tenth of the height are usual)",
            cells.len()
        )));
    }
    let width = cells[0].len();
    if !(width == 4 || width == 10) || cells.iter().any(|c| c.len() != width) {
        return Err(invalid(format!(
            "cells of {width} nodes: expected tetrahedra of 4 or of 10 nodes, all alike"
        )));
    }
    if let Some(n) = nodes
        .iter()
        .position(|p| !p.abs().cmplt(Vec3::splat(1e9)).all())
    {
        return Err(invalid(format!(
            "node {n} of the mesh lies at {}; export it again",
            nodes[n]
        )));
    }
    Ok(())
}

/// Every node belongs to a cell, every cell to one body.
fn check_nodes(count: usize, cells: &[Vec<usize>]) -> Result<()> {
    let mut body: Vec<usize> = (0..count).collect();
    fn root(body: &mut [usize], mut n: usize) -> usize {
        while body[n] != n {
            body[n] = body[body[n]];
            n = body[n];
        }
        n
    }
    let mut used = vec![false; count];
    for (c, cell) in cells.iter().enumerate() {
        if let Some(n) = cell.iter().find(|&&n| n >= count) {
            return Err(invalid(format!(
                "cell {c} names node {n}, the mesh has {count}; export it again"
            )));
        }
        let first = root(&mut body, cell[0]);
        for &n in cell {
            used[n] = true;
            let other = root(&mut body, n);
            body[other] = first;
        }
    }
    let loose = used.iter().filter(|u| !**u).count();
    if loose > 0 {
        let first = used.iter().position(|u| !u).unwrap_or(0);
        return Err(invalid(format!(
            "{loose} of {count} nodes belong to no tetrahedron (the first is node {first}); remove \
            loose nodes and save the volume only"
        )));
    }
    let mut roots: Vec<usize> = (0..count).map(|n| root(&mut body, n)).collect();
    roots.sort_unstable();
    roots.dedup();
    if roots.len() > 1 {
        return Err(invalid(format!(
            "the mesh has {} separate bodies; a finger is one: join them, or save one only",
            roots.len()
        )));
    }
    Ok(())
}

fn check_cells(nodes: &[Vec3], cells: &[Vec<usize>]) -> Result<()> {
    let (mut flat, mut turned, mut first) = (0, 0, None);
    for (c, cell) in cells.iter().enumerate() {
        let corner = |i: usize| nodes[cell[i]];
        let edges = [1, 2, 3].map(|i| corner(i) - corner(0));
        let volume = triple(edges) / 6.0;
        let length = |e: &[usize; 2]| corner(e[0]).distance(corner(e[1]));
        let longest = EDGES.iter().map(length).fold(0.0, f64::max);
        if volume.abs() <= FLAT * longest.powi(3) {
            flat += 1;
        } else if volume < 0.0 {
            turned += 1;
        } else {
            continue;
        }
        first.get_or_insert((c, corner(0), volume));
    }
    match first {
        None => Ok(()),
        Some((c, at, volume)) => Err(invalid(format!(
            "of {} tetrahedra {turned} are inside out and {flat} flat (the first is cell {c} at \
            {at:.2} mm with {volume:.3e} mm³); \
            mesh it again, or number its nodes in VTK's order",
            cells.len()
        ))),
    }
}

/// Signed volume of the parallelepiped of three edges.
fn triple([a, b, c]: [Vec3; 3]) -> f64 {
    a.dot(b.cross(c))
}

/// Give 4-node cells a node in the middle of each edge.
fn promote(nodes: &mut Vec<Vec3>, cells: &mut [Vec<usize>]) {
    let mut middle: HashMap<[usize; 2], usize> = HashMap::new();
    for cell in cells.iter_mut().filter(|c| c.len() == 4) {
        for [i, j] in EDGES {
            let (a, b) = (cell[i].min(cell[j]), cell[i].max(cell[j]));
            let node = *middle.entry([a, b]).or_insert_with(|| {
                nodes.push(0.5 * (nodes[a] + nodes[b]));
                nodes.len() - 1
            });
            cell.push(node);
        }
    }
}

/// Eight 4-node cells for each of 10 nodes.
fn split(nodes: &[Vec3], cells: &[Vec<usize>]) -> Vec<Vec<usize>> {
    // The four corners, then the octahedron around each of its diagonals: the edge and the ring of
    // four about it.
    const CORNERS: [[usize; 4]; 4] = [[0, 4, 6, 7], [4, 1, 5, 8], [6, 5, 2, 9], [7, 8, 9, 3]];
    const AROUND: [([usize; 2], [usize; 4]); 3] = [
        ([4, 9], [5, 6, 7, 8]),
        ([5, 7], [4, 6, 9, 8]),
        ([6, 8], [4, 5, 9, 7]),
    ];
    let mut finer = Vec::with_capacity(8 * cells.len());
    for cell in cells {
        let at = |i: usize| nodes[cell[i]];
        finer.extend(CORNERS.map(|c| c.map(|i| cell[i]).to_vec()));
        let length = |d: &[usize; 2]| at(d[0]).distance(at(d[1]));
        let shortest = AROUND
            .iter()
            .min_by(|a, b| length(&a.0).total_cmp(&length(&b.0)))
            .unwrap_or(&AROUND[0]);
        let ([a, b], ring) = *shortest;
        for k in 0..4 {
            let mut four = [a, b, ring[k], ring[(k + 1) % 4]];
            let edges = [1, 2, 3].map(|i| at(four[i]) - at(four[0]));
            if triple(edges) < 0.0 {
                four.swap(2, 3);
            }
            finer.push(four.map(|i| cell[i]).to_vec());
        }
    }
    finer
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::fem::mesh;

    /// A block cut into six tetrahedra per brick: nodes and 4-node cells.
    pub(crate) fn cut_block(cells: [usize; 3], size: Vec3) -> (Vec<Vec3>, Vec<Vec<usize>>) {
        const SIX: [[usize; 4]; 6] = [
            [0, 1, 2, 6],
            [0, 2, 3, 6],
            [0, 3, 7, 6],
            [0, 7, 4, 6],
            [0, 4, 5, 6],
            [0, 5, 1, 6],
        ];
        let bricks = mesh::block(cells, size).unwrap();
        let cut = bricks
            .each_cell()
            .flat_map(|b| SIX.map(|t| t.map(|i| b[i]).to_vec()));
        (bricks.nodes.clone(), cut.collect())
    }

    fn volume(mesh: &Mesh) -> f64 {
        let at = |v: usize| mesh.nodes[mesh.surface[v]];
        let six: f64 = mesh.triangles.iter().map(|t| triple(t.map(at))).sum();
        six / 6.0
    }

    #[test]
    fn a_cut_block_has_its_volume_and_refining_keeps_it() {
        let (nodes, cells) = cut_block([2, 2, 3], Vec3::new(4.0, 6.0, 9.0));
        for refine in 0..2 {
            let mesh = tetrahedra(nodes.clone(), &cells, refine).unwrap();
            assert_eq!(mesh.cells.len(), 10 * 72 * 8usize.pow(refine as u32));
            assert!((volume(&mesh) - 216.0).abs() < 1e-9);
            // Euler: vertices − edges + faces = 2, with 3/2 edges per triangle.
            assert_eq!(2 * mesh.surface.len(), mesh.triangles.len() + 4);
            let held = mesh.clamped.iter().filter(|&&c| c).count();
            let across = 4 * (refine + 1) + 1;
            assert_eq!(held, across * across);
        }
    }

    #[test]
    fn ten_node_cells_are_taken_as_they_are() {
        let (mut nodes, mut cells) = cut_block([1, 1, 2], Vec3::new(4.0, 4.0, 9.0));
        let promoted = tetrahedra(nodes.clone(), &cells, 0).unwrap();
        promote(&mut nodes, &mut cells);
        let given = tetrahedra(nodes, &cells, 0).unwrap();
        assert_eq!(given.nodes, promoted.nodes);
        assert_eq!(given.cells, promoted.cells);
    }

    #[test]
    fn bad_meshes_are_refused_in_one_line() {
        type Parts = (Vec<Vec3>, Vec<Vec<usize>>);
        type Spoil = fn(&mut Parts);
        let good = || cut_block([1, 1, 2], Vec3::new(4.0, 4.0, 9.0));
        let cases: [(&str, Spoil); 9] = [
            ("no tetrahedra", |m| m.1.clear()),
            ("inside out", |m| m.1[3].swap(0, 1)),
            ("flat", |m| m.1[3][0] = m.1[3][1]),
            ("names node", |m| m.1[0][2] = 999),
            ("belong to no tetrahedron", |m| m.0.push(Vec3::ONE)),
            ("2 separate bodies", |m| {
                let n = m.0.len();
                m.0.extend([
                    Vec3::new(9.0, 0.0, 0.0),
                    Vec3::new(10.0, 0.0, 0.0),
                    Vec3::new(9.0, 1.0, 0.0),
                    Vec3::new(9.0, 0.0, 1.0),
                ]);
                m.1.push(vec![n, n + 1, n + 2, n + 3]);
            }),
            ("unit", |m| m.0.iter_mut().for_each(|p| *p *= 1e-3)),
            ("are held", |m| m.0.iter_mut().for_each(|p| p[2] += 1.0)),
            ("node 2", |m| m.0[2][1] = f64::NAN),
        ];
        assert!(tetrahedra(good().0, &good().1, 0).is_ok());
        for (says, spoil) in cases {
            let mut parts = good();
            spoil(&mut parts);
            let message = tetrahedra(parts.0, &parts.1, 0).unwrap_err().to_string();
            assert!(
                message.contains(says) && !message.contains('\n'),
                "{says}: {message}"
            );
        }
        assert!(tetrahedra(good().0, &good().1, 9).is_err());
    }
}
