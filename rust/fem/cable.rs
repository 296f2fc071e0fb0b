//! Tendons: elastic cables that pull and never push, led through guides in the solid.
//!
//! Driven by shortening: energy kc/2 ⟨L − (L₀ − d)⟩₊² with the cable's length L through its guides
//! (`guide.rs`), its rest length L₀, the shortening d (mm) and the stiffness kc of cable and drive
//! together (N/mm). Driven by tension: energy T (L − L₀) with T = ⟨command⟩₊ in N, whatever the
//! length. Frictionless.

use super::Vec3;
use super::guide::{Averaging, Weights, guides};
use super::mesh::Mesh;
use super::route::Route;
use crate::error::{Result, invalid};

/// The kind of a cable's command.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Drive {
    /// Shortening, mm.
    Shortening,
    /// Tension, N.
    Tension,
}

/// A cable bound to a mesh.
#[derive(Debug, Clone)]
pub struct Cable {
    pub guides: Vec<Weights>,
    pub rest_length: f64,
    pub stiffness: f64,
    pub drive: Drive,
}

impl Cable {
    /// Bind a route to a mesh; rejected if a guide is outside the solid.
    pub fn new(
        mesh: &Mesh,
        route: &Route,
        averaging: Averaging,
        stiffness: f64,
        drive: Drive,
    ) -> Result<Cable> {
        if !(stiffness.is_finite() && stiffness > 0.0) {
            return Err(invalid(format!(
                "cable stiffness {stiffness} N/mm: must be above 0; cable and drive have about 20"
            )));
        }
        let mut cable = Cable {
            guides: guides(mesh, route, averaging)?,
            rest_length: 0.0,
            stiffness,
            drive,
        };
        cable.rest_length = cable.length(&mesh.nodes);
        Ok(cable)
    }

    /// Place of a guide.
    pub fn place(&self, guide: usize, x: &[Vec3]) -> Vec3 {
        self.guides[guide].iter().map(|&(n, w)| w * x[n]).sum()
    }

    /// Length through the guides, mm.
    pub fn length(&self, x: &[Vec3]) -> f64 {
        (1..self.guides.len())
            .map(|g| self.place(g, x).distance(self.place(g - 1, x)))
            .sum()
    }

    /// Pull at a command (mm or N), N: the tension, or below zero how slack the cable is (stiffness
    /// × stretch).
    pub fn pull(&self, x: &[Vec3], command: f64) -> f64 {
        match self.drive {
            Drive::Shortening => self.stiffness * (self.length(x) - self.rest_length + command),
            Drive::Tension => command,
        }
    }

    /// Tension at a command, N: zero when slack.
    pub fn tension(&self, x: &[Vec3], command: f64) -> f64 {
        self.pull(x, command).max(0.0)
    }

    /// Energy at a command, N·mm.
    pub fn energy(&self, x: &[Vec3], command: f64) -> f64 {
        let tension = self.tension(x, command);
        match self.drive {
            Drive::Shortening => 0.5 * tension * tension / self.stiffness,
            Drive::Tension => tension * (self.length(x) - self.rest_length),
        }
    }

    /// Call `add(node, dL/dx)` for every node of a guide (a node may occur several times).
    pub fn slope(&self, x: &[Vec3], mut add: impl FnMut(usize, Vec3)) {
        self.segments(x, |g, _, t| {
            for &(n, w) in &self.guides[g] {
                add(n, w * t);
            }
            for &(n, w) in &self.guides[g - 1] {
                add(n, -w * t);
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
            let h = Vec3::AXES.map(|axis| tension / length * (axis - axis.dot(t) * t));
            let both: Vec<(usize, f64)> = self.guides[g - 1]
                .iter()
                .map(|&(n, w)| (n, -w))
                .chain(self.guides[g].iter().copied())
                .collect();
            for &(a, wa) in &both {
                for &(b, wb) in both.iter().filter(|&&(b, _)| b <= a) {
                    add(a, b, h.map(|row| wa * wb * row));
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
            let step = here - before;
            let length = step.length().max(1e-12);
            visit(g, length, step / length);
            before = here;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fem::mesh::{Resolution, finger, radius_at};
    use crate::fem::tetrahedra::{tests::cut_block, tetrahedra};

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
        let route = Route::Formula {
            angle,
            turn: 0.0,
            path: vec![[0.0, 8.0], [50.0, 6.0]],
        };
        let cable = Cable::new(&mesh, &route, AVERAGE, 20.0, Drive::Shortening).unwrap();
        (mesh, cable)
    }

    fn bent(mesh: &Mesh) -> Vec<Vec3> {
        mesh.nodes
            .iter()
            .map(|p| {
                Vec3::new(
                    p[0] + 0.003 * p[2] * p[2],
                    0.98 * p[1],
                    p[2] - 0.04 * p[0] * p[2] / 10.0,
                )
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
            let mut s = vec![Vec3::ZERO; n];
            cable.slope(x, |a, v| s[a] += v);
            s
        };
        let at = slope(&x);
        let mut stiff = std::collections::HashMap::new();
        cable.geometric(&x, 1.0, |a, b, block| {
            let e = stiff.entry((a, b)).or_insert([Vec3::ZERO; 3]);
            for i in 0..3 {
                e[i] += block[i];
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
            let route = Route::Formula {
                angle: 0.0,
                turn: 0.0,
                path,
            };
            assert!(Cable::new(&mesh, &route, AVERAGE, 20.0, Drive::Shortening).is_err());
        }
    }

    #[test]
    fn a_route_by_points_is_the_formula_it_samples_and_a_helix_turns() {
        let (mesh, straight) = setup(0.7);
        let (c, s) = (0.7f64.cos(), 0.7f64.sin());
        let points = Route::Points(vec![
            Vec3::new(8.0 * c, 8.0 * s, 0.0),
            Vec3::new(6.0 * c, 6.0 * s, 50.0),
        ]);
        let same = Cable::new(&mesh, &points, AVERAGE, 20.0, Drive::Shortening).unwrap();
        assert!((same.length(&bent(&mesh)) - straight.length(&bent(&mesh))).abs() < 1e-9);
        let helix = Route::Formula {
            angle: 0.7,
            turn: 1.5,
            path: vec![[0.0, 7.0], [50.0, 7.0]],
        };
        let helix = Cable::new(&mesh, &helix, AVERAGE, 20.0, Drive::Shortening).unwrap();
        // The chords between eleven guides are slightly shorter than the curve.
        let curve = (50f64.powi(2) + (7.0f64 * 1.5).powi(2)).sqrt();
        assert!((helix.rest_length / curve - 1.0).abs() < 1e-3 && helix.rest_length < curve);
        let last = helix.place(helix.guides.len() - 1, &mesh.nodes);
        assert!((last[1].atan2(last[0]) - 2.2).abs() < 1e-9);
    }

    #[test]
    fn guides_in_a_free_mesh_lie_on_the_route_follow_a_linear_field_and_are_smooth() {
        let (nodes, cells) = cut_block([3, 3, 6], Vec3::new(18.0, 18.0, 48.0));
        let mesh = tetrahedra(nodes, &cells, 0).unwrap();
        let cable = |shift: f64| {
            let points = (0..9)
                .map(|k| Vec3::new(6.0 + shift, 1.0, 5.0 * k as f64))
                .collect();
            Cable::new(
                &mesh,
                &Route::Points(points),
                AVERAGE,
                20.0,
                Drive::Shortening,
            )
        };
        let field =
            |p: &Vec3| Vec3::new(p[0] + 0.1 * p[2], 1.2 * p[1] - 0.3 * p[0], 0.9 * p[2] + 3.0);
        let moved: Vec<Vec3> = mesh.nodes.iter().map(field).collect();
        // Inside, at the wall, and in a channel outside it.
        for shift in [0.0, 3.0, 5.5] {
            let cable = cable(shift).unwrap();
            for g in 0..9 {
                let place = Vec3::new(6.0 + shift, 1.0, 5.0 * g as f64);
                assert!(cable.place(g, &mesh.nodes).distance(place) < 1e-9);
                assert!(cable.place(g, &moved).distance(field(&place)) < 1e-9);
            }
        }
        let message = cable(6.2).unwrap_err().to_string();
        assert!(message.contains("3.20 mm outside"), "{message}");
        // A jump between cells would be some 0.1 mm; the steepest slope is a few mm for each mm of
        // shift.
        let x = bent(&mesh);
        let length = |shift: f64| cable(shift).unwrap().length(&x);
        for k in 0..80 {
            let at = -3.0 + 0.1 * k as f64;
            let step = |h: f64| (length(at + h) - length(at)).abs();
            assert!(
                step(1e-5) < 1e-4 && step(0.1) > 1e-4,
                "at {at}: {} {}",
                step(1e-5),
                step(0.1)
            );
        }
    }

    #[test]
    fn a_cable_driven_by_tension_pulls_with_it_at_any_length() {
        let (mesh, mut cable) = setup(0.3);
        cable.drive = Drive::Tension;
        let x = bent(&mesh);
        assert_eq!(
            (cable.tension(&x, 3.0), cable.tension(&x, -3.0)),
            (3.0, 0.0)
        );
        assert!(
            (cable.energy(&x, 3.0) - 3.0 * (cable.length(&x) - cable.rest_length)).abs() < 1e-12
        );
    }
}
