//! Tendons: elastic cables that pull and never push, led through guides in the solid.
//!
//! Energy kc/2 ⟨L − (L₀ − d)⟩₊² with the cable's length L through its guides, its rest length L₀, the shortening d (mm)
//! and the stiffness kc of cable and drive together (N/mm). A guide is not a point: a point load cuts into a mesh like a
//! wire and its depth depends on the mesh. Each guide is the average over a ring (the anchor over a disc) of moving-least-
//! squares interpolants of one layer's nodes. Their weights are smooth in the guide's place and reproduce linear fields,
//! so that rest position and rigid motion are exact. There is a guide at every layer: a cable in a continuous channel.
//! Frictionless. Limit: guides stay in their rest layer, so a channel must not run sideways.

use super::mesh::{Mesh, radius_at};
use super::{Vec3, axpy, dot, norm, sub};
use crate::error::{Result, invalid};
use std::f64::consts::TAU;

/// Reach of the smooth weights over the outer radius: the same on every mesh, so that refinement does not let cables cut in
/// deeper (a reach of two cells moved the tip by 3 mm of 18 between a core of 2 and of 6 cells).
const REACH: f64 = 0.75;
/// Coarser cores have too few nodes within it; theirs reaches farther in proportion.
const REACH_CORE: usize = 3;
/// Places on a ring.
const RING_PLACES: usize = 12;

/// Where a tendon runs: its angle about z and its distance from the axis along z.
#[derive(Debug, Clone)]
pub struct Route {
    pub angle: f64,
    /// `(z, radius)` in mm, ascending; the first is where the cable leaves the base, the last is the anchor.
    pub path: Vec<[f64; 2]>,
}

/// Averaging of the guides, mm.
#[derive(Debug, Clone, Copy)]
pub struct Averaging {
    pub ring: f64,
    pub disc: f64,
}

/// Node weights; they sum to 1.
pub type Weights = Vec<(usize, f64)>;

/// A cable bound to a mesh.
#[derive(Debug, Clone)]
pub struct Cable {
    pub guides: Vec<Weights>,
    pub rest_length: f64,
    pub stiffness: f64,
}

impl Cable {
    /// Bind a route to the layers of a finger mesh; refused where a guide would leave the solid.
    pub fn new(
        mesh: &Mesh,
        profile: &[[f64; 2]],
        core: usize,
        route: &Route,
        averaging: Averaging,
        stiffness: f64,
    ) -> Result<Cable> {
        let path = &route.path;
        if !(stiffness.is_finite() && stiffness > 0.0) {
            return Err(invalid(format!(
                "cable stiffness {stiffness} N/mm: must be above 0; cable and drive have about 20"
            )));
        }
        if path.len() < 2 || !path.windows(2).all(|w| w[1][0] > w[0][0]) || path[0][0] < 0.0 {
            return Err(invalid(
                "tendon route: expected at least two (z, radius) pairs in mm, z ascending from 0 or above",
            ));
        }
        let (first, last) = (path[0][0], path[path.len() - 1][0]);
        if last > mesh.height() + 1e-9 {
            return Err(invalid(format!(
                "tendon ends at z = {last} mm, outside the solid of {} mm; end it lower",
                mesh.height()
            )));
        }
        let on_route: Vec<usize> = (0..mesh.levels.len())
            .filter(|&k| mesh.levels[k] > first - 1e-6 && mesh.levels[k] < last + 1e-6)
            .collect();
        let mut guides = Vec::new();
        for (i, &layer) in on_route.iter().enumerate() {
            let z = mesh.levels[layer];
            let (r, outer) = (radius_at(path, z), radius_at(profile, z));
            let anchor = i + 1 == on_route.len();
            let spread = if anchor {
                averaging.disc
            } else {
                averaging.ring
            };
            if !(r.is_finite() && r >= 0.0 && r + spread <= outer) {
                return Err(invalid(format!(
                    "tendon at angle {:.0}° runs outside the solid at z = {z:.1} mm: radius {r:.2} + {spread:.1} mm of channel, the solid ends at {outer:.2} mm; route it further inside",
                    route.angle.to_degrees()
                )));
            }
            let centre = [r * route.angle.cos(), r * route.angle.sin()];
            let reach = REACH * outer * REACH_CORE as f64 / core.min(REACH_CORE) as f64;
            guides.push(guide(mesh, layer, centre, spread, anchor, reach)?);
        }
        let mut cable = Cable {
            guides,
            rest_length: 0.0,
            stiffness,
        };
        cable.rest_length = cable.length(&mesh.nodes);
        Ok(cable)
    }

    /// Place of a guide.
    pub fn place(&self, guide: usize, x: &[Vec3]) -> Vec3 {
        self.guides[guide]
            .iter()
            .fold([0.0; 3], |p, &(n, w)| axpy(p, w, x[n]))
    }

    /// Length through the guides, mm.
    pub fn length(&self, x: &[Vec3]) -> f64 {
        (1..self.guides.len())
            .map(|g| norm(sub(self.place(g, x), self.place(g - 1, x))))
            .sum()
    }

    /// Stiffness × stretch at a shortening `d` (mm), N: the tension, or below zero how slack the cable is.
    pub fn pull(&self, x: &[Vec3], d: f64) -> f64 {
        self.stiffness * (self.length(x) - self.rest_length + d)
    }

    /// Tension at a shortening `d` (mm), N: zero when slack.
    pub fn tension(&self, x: &[Vec3], d: f64) -> f64 {
        self.pull(x, d).max(0.0)
    }

    /// Energy at a shortening `d`, N·mm.
    pub fn energy(&self, x: &[Vec3], d: f64) -> f64 {
        let tension = self.tension(x, d);
        0.5 * tension * tension / self.stiffness
    }

    /// Call `add(node, dL/dx)` for every node that a guide weighs (a node comes up several times).
    pub fn slope(&self, x: &[Vec3], mut add: impl FnMut(usize, Vec3)) {
        self.segments(x, |g, _, t| {
            for &(n, w) in &self.guides[g] {
                add(n, [w * t[0], w * t[1], w * t[2]]);
            }
            for &(n, w) in &self.guides[g - 1] {
                add(n, [-w * t[0], -w * t[1], -w * t[2]]);
            }
        });
    }

    /// Call `add(node a, node b, block)` for the geometric stiffness T·∂²L/∂x², pairs with b ≤ a.
    pub fn geometric(
        &self,
        x: &[Vec3],
        tension: f64,
        mut add: impl FnMut(usize, usize, [Vec3; 3]),
    ) {
        self.segments(x, |g, length, t| {
            let h: [Vec3; 3] = std::array::from_fn(|i| {
                std::array::from_fn(|j| tension / length * (f64::from(i == j) - t[i] * t[j]))
            });
            let both: Vec<(usize, f64)> = self.guides[g - 1]
                .iter()
                .map(|&(n, w)| (n, -w))
                .chain(self.guides[g].iter().copied())
                .collect();
            for &(a, wa) in &both {
                for &(b, wb) in both.iter().filter(|&&(b, _)| b <= a) {
                    add(a, b, h.map(|row| row.map(|v| wa * wb * v)));
                }
            }
        });
    }

    /// Pairs of nodes that the geometric stiffness couples, b ≤ a.
    pub fn couplings(&self) -> impl Iterator<Item = (usize, usize)> + '_ {
        (1..self.guides.len()).flat_map(move |g| {
            let both: Vec<usize> = self.guides[g - 1]
                .iter()
                .chain(&self.guides[g])
                .map(|p| p.0)
                .collect();
            let pairs: Vec<_> = both
                .iter()
                .flat_map(|&a| both.iter().filter(move |&&b| b <= a).map(move |&b| (a, b)))
                .collect();
            pairs
        })
    }

    fn segments(&self, x: &[Vec3], mut visit: impl FnMut(usize, f64, Vec3)) {
        let mut before = self.place(0, x);
        for g in 1..self.guides.len() {
            let here = self.place(g, x);
            let step = sub(here, before);
            let length = norm(step).max(1e-12);
            visit(g, length, step.map(|v| v / length));
            before = here;
        }
    }
}

/// Average of smooth interpolants over a ring (or a disc: rings of equal area and the centre).
fn guide(
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

/// Add `share` × the weights φᵢ (1, xᵢ − x)·M⁻¹·(1, 0, 0), M = Σ φᵢ (1, xᵢ − x)(1, xᵢ − x)ᵀ, φ = (1 − s²)³ within `reach`.
fn add_moving_least_squares(
    nodes: &[Vec3],
    place: [f64; 2],
    reach: f64,
    share: f64,
    total: &mut [f64],
) -> Result<()> {
    let row = |n: &Vec3| [1.0, (n[0] - place[0]) / reach, (n[1] - place[1]) / reach];
    let bump = |r: &Vec3| (1.0 - r[1] * r[1] - r[2] * r[2]).max(0.0).powi(3);
    let mut moment = [[0.0; 3]; 3];
    for n in nodes {
        let r = row(n);
        let phi = bump(&r);
        for i in 0..3 {
            moment[i] = axpy(moment[i], phi * r[i], r);
        }
    }
    let (inverse, det) = super::brick::cofactor(&moment);
    if det.is_nan() || det < 1e-9 * moment[0][0].powi(3).max(1e-12) {
        return Err(invalid(format!(
            "tendon guide at x = {:.1}, y = {:.1} mm has too few nodes around it; use a finer core or more rings",
            place[0], place[1]
        )));
    }
    for (n, w) in nodes.iter().zip(total) {
        let r = row(n);
        *w += share * bump(&r) * dot(inverse[0], r) / det;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fem::mesh::{Resolution, finger};

    const PROFILE: [[f64; 2]; 2] = [[0.0, 12.0], [60.0, 9.0]];
    const AVERAGE: Averaging = Averaging {
        ring: 1.5,
        disc: 2.0,
    };

    fn setup(angle: f64) -> (Mesh, Cable) {
        let mesh = finger(
            &PROFILE,
            &[50.0],
            Resolution {
                core: 3,
                rings: 1,
                layers: 12,
            },
        )
        .unwrap();
        let route = Route {
            angle,
            path: vec![[0.0, 8.0], [50.0, 6.0]],
        };
        let cable = Cable::new(&mesh, &PROFILE, 3, &route, AVERAGE, 20.0).unwrap();
        (mesh, cable)
    }

    fn bent(mesh: &Mesh) -> Vec<Vec3> {
        mesh.nodes
            .iter()
            .map(|p| {
                [
                    p[0] + 0.003 * p[2] * p[2],
                    0.98 * p[1],
                    p[2] - 0.04 * p[0] * p[2] / 10.0,
                ]
            })
            .collect()
    }

    #[test]
    fn guides_lie_on_the_route_at_rest() {
        let (mesh, cable) = setup(0.7);
        assert!((cable.rest_length - (50f64.powi(2) + 4.0).sqrt()).abs() < 1e-10);
        for g in 0..cable.guides.len() {
            let p = cable.place(g, &mesh.nodes);
            let r = radius_at(&[[0.0, 8.0], [50.0, 6.0]], p[2]);
            assert!(
                (p[0] - r * 0.7f64.cos()).abs() < 1e-10 && (p[1] - r * 0.7f64.sin()).abs() < 1e-10
            );
        }
    }

    #[test]
    fn weights_are_smooth_in_the_guide_s_place() {
        let (mesh, a) = setup(0.70);
        let x = bent(&mesh);
        let (_, b) = setup(0.70 + 1e-6);
        let (_, c) = setup(0.70 + 2e-6);
        let slope = |p: &Cable, q: &Cable| (q.length(&x) - p.length(&x)) / 1e-6;
        // A jump between elements would make the two one-sided slopes differ by far more than this.
        assert!((slope(&a, &b) - slope(&b, &c)).abs() < 1e-3);
    }

    #[test]
    fn slope_and_geometric_stiffness_agree_with_finite_differences() {
        let (mesh, cable) = setup(0.3);
        let x = bent(&mesh);
        let n = mesh.nodes.len();
        let slope = |x: &[Vec3]| {
            let mut s = vec![[0.0; 3]; n];
            cable.slope(x, |a, v| s[a] = axpy(s[a], 1.0, v));
            s
        };
        let at = slope(&x);
        let mut stiff = std::collections::HashMap::new();
        cable.geometric(&x, 1.0, |a, b, block| {
            let e = stiff.entry((a, b)).or_insert([[0.0; 3]; 3]);
            for i in 0..3 {
                e[i] = axpy(e[i], 1.0, block[i]);
            }
        });
        let h = 1e-5;
        for b in (mesh.per_layer..n).step_by(7) {
            for m in 0..3 {
                let moved = |s: f64| {
                    let mut y = x.clone();
                    y[b][m] += s * h;
                    y
                };
                let (up, down) = (moved(1.0), moved(-1.0));
                assert!(
                    ((cable.length(&up) - cable.length(&down)) / (2.0 * h) - at[b][m]).abs() < 1e-8
                );
                let (up, down) = (slope(&up), slope(&down));
                for a in b..n {
                    let block = stiff.get(&(a, b)).copied().unwrap_or_default();
                    for i in 0..3 {
                        assert!(((up[a][i] - down[a][i]) / (2.0 * h) - block[i][m]).abs() < 1e-8);
                    }
                }
            }
        }
    }

    #[test]
    fn a_pushed_cable_is_slack_and_a_cable_outside_is_refused() {
        let (mesh, cable) = setup(0.0);
        assert_eq!(cable.tension(&mesh.nodes, -1.0), 0.0);
        assert!((cable.tension(&mesh.nodes, 0.5) - 10.0).abs() < 1e-12);
        for path in [
            vec![[0.0, 11.0], [50.0, 6.0]],
            vec![[0.0, 8.0], [61.0, 6.0]],
            vec![[0.0, 8.0]],
        ] {
            let route = Route { angle: 0.0, path };
            assert!(Cable::new(&mesh, &PROFILE, 3, &route, AVERAGE, 20.0).is_err());
        }
    }
}
