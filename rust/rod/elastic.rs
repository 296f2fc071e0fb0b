//! The elastic-tendon rod: segments of constant curvature, bent by tendons that stretch and, if
//! they are cables, become slack.
//!
//! For a command u (C,) the bending vectors θ = θ⁰ + φ (2S numbers, rad) minimise
//!   Σ_s ½ κ_s |φ_s|² + Σ_j ½ w_j δ_j²,   δ_j = d_j u_{c(j)} + p_j − r_j n_j · Σ_{s ≤ e(j)} φ_s
//!     (mm).
//! Tendon j ends in segment e(j), runs at radius r_j (mm) on the side n_j = (cos α_j, sin α_j), is
//! shortened by d_j mm per unit of command c(j) and by p_j at command 0; it bends every segment
//! that it passes. δ is its stretch, and w is 1 if δ > 0, else `slack`: 1 for two-sided tendons,
//! which also push, 0 for cables. κ (mm²) is bending stiffness over tendon stiffness: a shape shows
//! only their ratio. The sum is strictly convex and piecewise quadratic: Newton's method with
//! halved steps reaches the minimum after a few changes of the set of pulling tendons. Then a chain
//! of arcs (`arc.rs`) from a tilted base point carries the markers. Slopes are exact; where a
//! tendon is just taut, they are one-sided. Limits: no twist, no shear, no friction; loads only by
//! `elastic_field.rs`. Pinned by `elastic_tests.rs`.

use super::arc::Chain;
use super::layout::Layout;
use crate::algebra::Vec3;
use crate::algebra::dense::Factor;
use crate::error::Result;
use crate::shape::Shape;
use std::sync::Arc;

const STEPS: usize = 100; // of Newton; ten are many
const HALVINGS: usize = 40;

/// The elastic-tendon rod: C commands to M markers.
#[derive(Debug, Clone)]
pub struct ElasticRod {
    pub(super) layout: Layout,
    pub(super) numbers: Vec<f64>,
    /// Rows (tendons, 2S): δ falls by these, mm per rad of bending.
    reach: Vec<f64>,
}

/// A minimum of the energy: φ, the stretch of each tendon (mm), and the Hessian (mm²).
pub(super) struct Equilibrium {
    pub(super) bent: Vec<f64>,
    pub(super) stretch: Vec<f64>,
    pub(super) hessian: Factor,
}

impl ElasticRod {
    /// `numbers` as `Layout::labels` names them: angles and bendings in rad, stiffness in mm², the
    /// rest in mm.
    pub fn new(layout: Layout, numbers: Vec<f64>) -> Result<Self> {
        layout.check(&numbers)?;
        let width = 2 * layout.segments;
        let mut reach = vec![0.0; layout.tendons.len() * width];
        for (j, tendon) in layout.tendons.iter().enumerate() {
            let radius = numbers[layout.first.radius + j];
            let angle = numbers[layout.first.angle + j];
            for s in 0..=tendon.end {
                reach[j * width + 2 * s] = radius * angle.cos();
                reach[j * width + 2 * s + 1] = radius * angle.sin();
            }
        }
        Ok(Self {
            layout,
            numbers,
            reach,
        })
    }

    pub fn layout(&self) -> &Layout {
        &self.layout
    }

    pub(super) fn stiffness(&self, i: usize) -> f64 {
        self.numbers[self.layout.first.stiffness + i / 2]
    }

    /// The same rod with tendons that push `factor` times as hard; None if they do not push.
    pub(super) fn slacker(&self, name: &str, factor: f64) -> Option<ElasticRod> {
        let mut rod = self.clone();
        rod.numbers[0] = (rod.numbers[0] * factor).clamp(0.0, 1.0);
        self.numbers().contains(&name).then_some(rod)
    }

    /// Length (mm) of each segment.
    pub(super) fn lengths(&self) -> &[f64] {
        &self.numbers[self.layout.first.length..self.layout.first.rest]
    }

    pub(super) fn row(&self, j: usize) -> &[f64] {
        let width = 2 * self.layout.segments;
        &self.reach[j * width..(j + 1) * width]
    }

    /// The weight of a tendon stretched by `stretch`.
    pub(super) fn weight(&self, stretch: f64) -> f64 {
        if stretch > 0.0 { 1.0 } else { self.numbers[0] }
    }

    /// Shortening of each tendon relative to the resting rod, mm.
    fn drawn(&self, u: &[f64]) -> Vec<f64> {
        let pretension = &self.numbers[self.layout.first.pretension..];
        let tendons = self.layout.tendons.iter().zip(pretension);
        tendons.map(|(t, p)| t.pull * u[t.channel] + p).collect()
    }

    fn stretched(&self, drawn: &[f64], bent: &[f64]) -> Vec<f64> {
        let along = |j: usize| {
            self.row(j)
                .iter()
                .zip(bent)
                .map(|(a, b)| a * b)
                .sum::<f64>()
        };
        (0..drawn.len()).map(|j| drawn[j] - along(j)).collect()
    }

    fn energy(&self, bent: &[f64], stretch: &[f64]) -> f64 {
        let body = bent.iter().enumerate();
        let body: f64 = body.map(|(i, x)| self.stiffness(i) * x * x).sum();
        let tendons: f64 = stretch.iter().map(|x| self.weight(*x) * x * x).sum();
        0.5 * (body + tendons)
    }

    /// κ + Σ w·g·gᵀ, positive definite since κ is.
    fn hessian(&self, stretch: &[f64]) -> Factor {
        let n = 2 * self.layout.segments;
        let mut a = vec![0.0; n * n];
        for i in 0..n {
            a[i * n + i] = self.stiffness(i);
        }
        for (j, tendon) in self.layout.tendons.iter().enumerate() {
            let (row, weight) = (self.row(j), self.weight(stretch[j]));
            for i in 0..2 * (tendon.end + 1) {
                for k in 0..=i {
                    a[i * n + k] += weight * row[i] * row[k];
                }
            }
        }
        Factor::new(a, n)
    }

    /// The minimum of the energy at the command `u`.
    pub(super) fn equilibrium(&self, u: &[f64]) -> Equilibrium {
        let drawn = self.drawn(u);
        let mut stretch = drawn.clone();
        let mut bent = vec![0.0; 2 * self.layout.segments];
        let mut energy = self.energy(&bent, &stretch);
        let mut hessian = self.hessian(&stretch);
        for _ in 0..STEPS {
            // the minimum, if the set of pulling tendons does not change
            let mut goal = vec![0.0; bent.len()];
            for (j, drawn) in drawn.iter().enumerate() {
                let weight = self.weight(stretch[j]);
                for (goal, reach) in goal.iter_mut().zip(self.row(j)) {
                    *goal += weight * drawn * reach;
                }
            }
            hessian.solve(&mut goal);
            let (moved, now, reached) = self.descend(&bent, &goal, &drawn, energy);
            let same = now
                .iter()
                .zip(&stretch)
                .all(|(a, b)| (*a > 0.0) == (*b > 0.0));
            let settled = reached >= energy || (same && moved == goal);
            (bent, stretch, energy) = (moved, now, reached);
            if !same {
                hessian = self.hessian(&stretch);
            }
            if settled {
                break;
            }
        }
        Equilibrium {
            bent,
            stretch,
            hessian,
        }
    }

    /// Step from `bent` towards `goal`, halved until the energy falls; no step if it does not.
    fn descend(
        &self,
        bent: &[f64],
        goal: &[f64],
        drawn: &[f64],
        energy: f64,
    ) -> (Vec<f64>, Vec<f64>, f64) {
        let (mut share, mut moved) = (1.0, goal.to_vec());
        for _ in 0..HALVINGS {
            let stretch = self.stretched(drawn, &moved);
            let reached = self.energy(&moved, &stretch);
            if reached < energy {
                return (moved, stretch, reached);
            }
            share *= 0.5;
            let ends = bent.iter().zip(goal);
            moved = ends.map(|(a, b)| a + share * (b - a)).collect();
        }
        (bent.to_vec(), self.stretched(drawn, bent), energy)
    }

    /// Bending vectors θ (2S,) of the segments at an equilibrium.
    pub(super) fn bends(&self, equilibrium: &Equilibrium) -> Vec<f64> {
        let rest = &self.numbers[self.layout.first.rest..];
        let pairs = equilibrium.bent.iter().zip(rest);
        pairs.map(|(bent, rest)| bent + rest).collect()
    }

    pub(super) fn chain<'a>(&'a self, bends: &'a [f64]) -> Chain<'a> {
        let base = &self.numbers[self.layout.first.base..];
        let (base, tilt) = (Vec3::from_slice(base), [base[3], base[4]]);
        Chain::new(base, tilt, bends, self.lengths())
    }

    /// Bending (2S,) rad of the segments and stretch (tendons,) mm at a command; a negative stretch
    /// is the slack of a cable.
    pub fn state(&self, u: &[f64]) -> (Vec<f64>, Vec<f64>) {
        let equilibrium = self.equilibrium(u);
        (self.bends(&equilibrium), equilibrium.stretch)
    }
}

/// Displacement of a marker for a change `turn` (2S,) of θ, given its `slopes` over θ.
pub(super) fn along(slopes: &[Vec3], turn: &[f64]) -> Vec3 {
    slopes
        .iter()
        .zip(turn)
        .map(|(slope, turn)| turn * slope)
        .sum()
}

impl Shape for ElasticRod {
    fn numbers(&self) -> Vec<&'static str> {
        let pushes = self.numbers[0] > 0.0;
        if pushes { vec!["slack"] } else { vec![] }
    }

    fn with_number(&self, name: &str, factor: f64) -> Option<Arc<dyn Shape>> {
        Some(Arc::new(self.slacker(name, factor)?))
    }

    fn channels(&self) -> usize {
        self.layout.channels
    }

    fn size(&self) -> usize {
        3 * self.layout.markers.len()
    }

    fn eval(&self, u: &[f64], out: &mut [f64]) {
        let bends = self.bends(&self.equilibrium(u));
        let chain = self.chain(&bends);
        for (out, &(k, f)) in out.chunks_exact_mut(3).zip(&self.layout.markers) {
            chain.point(k, f).write_to_slice(out);
        }
    }

    fn jacobian(&self, u: &[f64], out: &mut [f64]) {
        let (channels, width) = (self.layout.channels, 2 * self.layout.segments);
        let equilibrium = self.equilibrium(u);
        let mut turns = vec![vec![0.0; width]; channels];
        for (j, tendon) in self.layout.tendons.iter().enumerate() {
            let pull = self.weight(equilibrium.stretch[j]) * tendon.pull;
            for (turn, reach) in turns[tendon.channel].iter_mut().zip(self.row(j)) {
                *turn += pull * reach;
            }
        }
        for turn in &mut turns {
            equilibrium.hessian.solve(turn);
        }
        let bends = self.bends(&equilibrium);
        let chain = self.chain(&bends);
        let mut slopes = chain.room();
        for (m, &(k, f)) in self.layout.markers.iter().enumerate() {
            chain.slopes(k, f, &mut slopes);
            for (c, turn) in turns.iter().enumerate() {
                let slope = along(&slopes.bends, turn);
                for axis in 0..3 {
                    out[(3 * m + axis) * channels + c] = slope[axis];
                }
            }
        }
    }
}
