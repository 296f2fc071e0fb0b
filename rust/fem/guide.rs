//! The nodes that carry the guides of a tendon.
//!
//! A guide is not a point: a point load cuts into a mesh like a wire, with a mesh-dependent depth.
//! In a mesh with layers each guide is the average over a ring (the anchor over a disc) of
//! moving-least-squares interpolants of one layer's nodes; every layer has a guide, like a cable in
//! a continuous channel. In any other mesh, a guide is one interpolant of the nodes within four
//! rings in space, a wider average. The weights are smooth in the guide's position (no jump between
//! elements) and reproduce linear fields. So rest position and rigid motion are exact, also for a
//! guide in a hollow channel. Units: mm, rad. Limits: in layers guides stay in their rest layer, so
//! a channel must not run sideways; without them, a guide more than two rings (3 mm) outside the
//! solid is rejected.

use super::Vec3;
use super::embed::Finder;
use super::mesh::{Mesh, Section, radius_at};
use super::route::Route;
use crate::algebra::{Mat3, dense, outer};
use crate::error::{Result, invalid};
use std::f64::consts::TAU;

/// Reach of the smooth weights over the outer radius: the same on every mesh, so cables do not cut
/// in deeper under refinement (a reach of two cells moved the tip by 3 mm of 18 between a core of 2
/// and of 6 cells).
const REACH: f64 = 0.75;
/// Coarser cores have too few nodes within it; their reach is larger in proportion.
const REACH_CORE: usize = 3;
/// Points on a ring.
const RING_PLACES: usize = 12;
/// In a mesh without layers: reach of the weights, and how far outside a guide may lie, in rings.
const REACH_RINGS: f64 = 4.0;
const OUTSIDE_RINGS: f64 = 2.0;
/// There, the weights include at least this many nodes.
const FEWEST: usize = 12;
/// Weights that sum to 1 with a larger absolute sum come from nodes on one side.
const MOST_WEIGHT: f64 = 6.0;

/// Node weights; they sum to 1.
pub type Weights = Vec<(usize, f64)>;

/// Averaging of the guides, mm.
#[derive(Debug, Clone, Copy)]
pub struct Averaging {
    pub ring: f64,
    pub disc: f64,
}

/// The guides of a route on a mesh; rejected if one is outside the solid.
pub fn guides(mesh: &Mesh, route: &Route, averaging: Averaging) -> Result<Vec<Weights>> {
    let Some((first, last)) = route.ends() else {
        return Err(invalid("tendon route: empty; give at least two guides"));
    };
    let finite = match route {
        Route::Formula { angle, turn, path } => {
            angle.is_finite() && turn.is_finite() && path.iter().flatten().all(|v| v.is_finite())
        }
        Route::Points(points) => points.iter().all(|p| p.is_finite()),
    };
    if !finite || !matches!(route, Route::Points(p) if p.len() >= 2) && !route.ascends() {
        return Err(invalid(
            "tendon route: expected at least two (z, radius) pairs or points in mm, z of the pairs \
            ascending",
        ));
    }
    if mesh.levels.is_empty() {
        return scattered(mesh, &route.places(mesh.height), averaging.ring);
    }
    if !route.ascends() || first < 0.0 || last > mesh.height + 1e-9 {
        return Err(invalid(format!(
            "tendon runs from z = {first} to {last} mm; allowed is ascending from 0 to {} mm, \
            outside the solid there is nothing to hold it",
            mesh.height
        )));
    }
    layered(mesh, route, averaging)
}

/// A guide at every layer between the ends.
fn layered(mesh: &Mesh, route: &Route, averaging: Averaging) -> Result<Vec<Weights>> {
    let (first, last) = route.ends().unwrap_or_default();
    let on_route: Vec<usize> = (0..mesh.levels.len())
        .filter(|&k| mesh.levels[k] > first - 1e-6 && mesh.levels[k] < last + 1e-6)
        .collect();
    let mut guides = Vec::new();
    for (i, &layer) in on_route.iter().enumerate() {
        let z = mesh.levels[layer];
        let anchor = i + 1 == on_route.len();
        let spread = if anchor {
            averaging.disc
        } else {
            averaging.ring
        };
        let centre = route.at(z);
        let (size, room, cells) = around(&mesh.section, z, centre);
        if room.is_nan() || room < spread {
            return Err(invalid(format!(
                "tendon at x = {:.2}, y = {:.2} mm runs outside the solid at z = {z:.1} mm: the \
                wall is {room:.2} mm away, its channel takes {spread:.1} mm; route it further \
                inside",
                centre[0], centre[1]
            )));
        }
        let reach = REACH * size * REACH_CORE as f64 / cells.min(REACH_CORE) as f64;
        guides.push(ring(mesh, layer, centre, spread, anchor, reach)?);
    }
    if guides.len() < 2 {
        return Err(invalid(format!(
            "tendon from z = {first} to {last} mm crosses fewer than two layers of the mesh; use \
            more layers or a longer tendon"
        )));
    }
    Ok(guides)
}

/// Half the section's size, distance of a place from its wall, and cells across.
fn around(section: &Section, z: f64, at: [f64; 2]) -> (f64, f64, usize) {
    match section {
        Section::Disc(profile, core) => {
            let outer = radius_at(profile, z);
            // The radius comes from a cosine and a sine: round-off must not decide on the border
            // itself.
            (outer, outer - at[0].hypot(at[1]) + 1e-9, *core)
        }
        Section::Rectangle(half, cells) => {
            let room = (half[0] - at[0].abs()).min(half[1] - at[1].abs());
            (half[0].hypot(half[1]), room + 1e-9, *cells)
        }
        Section::Free => (f64::NAN, f64::NAN, 1),
    }
}

/// Average of smooth interpolants over a ring (or a disc: rings of equal area and the centre).
fn ring(
    mesh: &Mesh,
    layer: usize,
    centre: [f64; 2],
    spread: f64,
    disc: bool,
    reach: f64,
) -> Result<Weights> {
    let first = layer * mesh.per_layer;
    let mut total = vec![0.0; mesh.per_layer];
    // Radii at the middle of four rings of equal area.
    let radii: Vec<f64> = if disc {
        (0..4)
            .map(|i| spread * ((i as f64 + 0.5) / 4.0).sqrt())
            .collect()
    } else {
        vec![spread]
    };
    let share = 1.0 / (radii.len() * RING_PLACES) as f64;
    for r in radii {
        for k in 0..RING_PLACES {
            let angle = TAU * k as f64 / RING_PLACES as f64;
            let place = [centre[0] + r * angle.cos(), centre[1] + r * angle.sin()];
            add_moving_least_squares(
                &mesh.nodes[first..first + mesh.per_layer],
                place,
                reach,
                share,
                &mut total,
            )?;
        }
    }
    Ok(total
        .iter()
        .enumerate()
        .filter(|(_, w)| **w != 0.0)
        .map(|(i, &w)| (first + i, w))
        .collect())
}

/// Add `share` × the weights φᵢ (1, xᵢ − x)·M⁻¹·(1, 0, 0), M = Σ φᵢ (1, xᵢ − x)(1, xᵢ − x)ᵀ, φ = (1
/// − s²)³ within `reach`.
fn add_moving_least_squares(
    nodes: &[Vec3],
    place: [f64; 2],
    reach: f64,
    share: f64,
    total: &mut [f64],
) -> Result<()> {
    let row = |n: &Vec3| Vec3::new(1.0, (n[0] - place[0]) / reach, (n[1] - place[1]) / reach);
    let bump = |r: &Vec3| (1.0 - r[1] * r[1] - r[2] * r[2]).max(0.0).powi(3);
    let mut moment = Mat3::ZERO;
    for n in nodes {
        let r = row(n);
        moment += bump(&r) * outer(r, r);
    }
    let det = moment.determinant();
    if det.is_nan() || det < 1e-9 * moment.x_axis.x.powi(3).max(1e-12) {
        return Err(invalid(format!(
            "tendon guide at x = {:.1}, y = {:.1} mm has too few nodes around it; use a finer core \
            or more rings",
            place[0], place[1]
        )));
    }
    let first = moment.inverse().x_axis;
    for (n, w) in nodes.iter().zip(total) {
        let r = row(n);
        *w += share * bump(&r) * first.dot(r);
    }
    Ok(())
}

/// Guides in a mesh without layers: the same least squares in space.
fn scattered(mesh: &Mesh, places: &[Vec3], ring: f64) -> Result<Vec<Weights>> {
    let finder = Finder::new(mesh);
    let bind = |(g, &place): (usize, &Vec3)| {
        let inside = finder.nearest(place).2 == 0.0;
        let outside = if inside { 0.0 } else { to_surface(mesh, place) };
        if outside.is_nan() || outside > OUTSIDE_RINGS * ring {
            return Err(invalid(format!(
                "guide {g} of a tendon at {place:.2} mm lies {outside:.2} mm outside the solid; \
                allowed are two rings, {:.1} mm: check the tendon's frame and unit, or widen \
                guide_ring_mm",
                OUTSIDE_RINGS * ring
            )));
        }
        in_space(&mesh.nodes, place, REACH_RINGS * ring).ok_or_else(|| {
            invalid(format!(
                "guide {g} of a tendon at {place:.2} mm has all its nodes on one side; use a \
                finer mesh or a wider guide_ring_mm"
            ))
        })
    };
    places.iter().enumerate().map(bind).collect()
}

/// Distance to the outer surface, mm.
fn to_surface(mesh: &Mesh, p: Vec3) -> f64 {
    let corners = |t: &[usize; 3]| t.map(|v| mesh.nodes[mesh.surface[v]]);
    mesh.triangles
        .iter()
        .map(|t| p.distance(on_triangle(corners(t), p)))
        .fold(f64::INFINITY, f64::min)
}

/// The point of a triangle nearest to a point (Ericson, Real-Time Collision Detection, ch. 5.1.5).
fn on_triangle([a, b, c]: [Vec3; 3], p: Vec3) -> Vec3 {
    let (ab, ac) = (b - a, c - a);
    let from = |corner: Vec3| (ab.dot(p - corner), ac.dot(p - corner));
    let ((a1, a2), (b1, b2), (c1, c2)) = (from(a), from(b), from(c));
    if a1 <= 0.0 && a2 <= 0.0 {
        return a;
    }
    if b1 >= 0.0 && b2 <= b1 {
        return b;
    }
    if c2 >= 0.0 && c1 <= c2 {
        return c;
    }
    let (to_a, to_b, to_c) = (b1 * c2 - c1 * b2, c1 * a2 - a1 * c2, a1 * b2 - b1 * a2);
    if to_c <= 0.0 && a1 >= 0.0 && b1 <= 0.0 {
        return a + a1 / (a1 - b1) * ab;
    }
    if to_b <= 0.0 && a2 >= 0.0 && c2 <= 0.0 {
        return a + a2 / (a2 - c2) * ac;
    }
    if to_a <= 0.0 && b2 >= b1 && c1 >= c2 {
        let along = (b2 - b1) / ((b2 - b1) + (c1 - c2));
        return b + along * (c - b);
    }
    let sum = to_a + to_b + to_c;
    a + to_b / sum * ab + to_c / sum * ac
}

/// Moving-least-squares weights of a position among nodes in space; None if the nodes do not
/// surround it.
fn in_space(nodes: &[Vec3], place: Vec3, reach: f64) -> Option<Weights> {
    let mut far: Vec<(f64, usize)> = nodes
        .iter()
        .enumerate()
        .map(|(n, p)| (p.distance(place), n))
        .collect();
    far.sort_by(|a, b| a.0.total_cmp(&b.0));
    // The distance of the twelfth node is continuous in the position, and so are the weights.
    let reach = reach.max(1.5 * far[FEWEST.min(far.len()) - 1].0);
    let near: Vec<(usize, [f64; 4], f64)> = far
        .iter()
        .take_while(|(d, _)| *d < reach)
        .map(|&(d, n)| {
            let r = (nodes[n] - place) / reach;
            (
                n,
                [1.0, r[0], r[1], r[2]],
                (1.0 - (d / reach).powi(2)).powi(3),
            )
        })
        .collect();
    let mut moment = vec![vec![0.0; 4]; 4];
    for (_, r, phi) in &near {
        for i in 0..4 {
            for j in 0..4 {
                moment[i][j] += phi * r[i] * r[j];
            }
        }
    }
    let c = dense::solve(moment, vec![1.0, 0.0, 0.0, 0.0])?;
    let weight = |r: &[f64; 4], phi: f64| phi * (0..4).map(|i| c[i] * r[i]).sum::<f64>();
    let weights: Weights = near
        .iter()
        .map(|(n, r, phi)| (*n, weight(r, *phi)))
        .collect();
    let (size, sum) = weights
        .iter()
        .fold((0.0, 0.0), |(size, sum), (_, w)| (size + w.abs(), sum + w));
    (size < MOST_WEIGHT && f64::abs(sum - 1.0) < 1e-9).then_some(weights)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_nearest_place_on_a_triangle_beats_every_other() {
        let corners = [
            Vec3::ZERO,
            Vec3::new(3.0, 0.5, 0.0),
            Vec3::new(0.5, 2.0, 1.0),
        ];
        let at = |u: f64, v: f64| {
            corners[0] + u * (corners[1] - corners[0]) + v * (corners[2] - corners[0])
        };
        for k in 0..200 {
            let number = |i: usize| 4.0 * ((17 * k + 5 * i) as f64).sin() + 1.0;
            let p = Vec3::new(number(0), number(1), number(2));
            let found = p.distance(on_triangle(corners, p));
            let tried = (0..=60).flat_map(|i| (0..=60 - i).map(move |j| (i, j)));
            let best = tried
                .map(|(i, j)| p.distance(at(i as f64 / 60.0, j as f64 / 60.0)))
                .fold(f64::INFINITY, f64::min);
            // The grid of tested positions has 0.05 mm spacing.
            assert!(
                found < best + 1e-12 && best < found + 0.05,
                "{p:?}: {found} {best}"
            );
        }
    }
}
