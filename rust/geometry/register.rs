//! Registers the template of a finger to point clouds: the positions of its vertices, and their
//! visibility.
//!
//! E(p, R) = ARAP(p, R; f(u*)) + λ N/K Σ_k ω_k [(n_k·(x_k − c_k))² + τ |x_k − c_k|²] + B Σ_base
//! |p_i − q_i|²
//!
//! It starts from the model's shape f(u*) nearest to the cloud (`start.rs`), which is also the rest
//! shape of the ARAP term. So the surface represents only the difference from the model. Data terms
//! go from the cloud to the surface: K points c_k, each to the nearest point x_k of the surface (a
//! blend of three vertices) along the surface normal n_k there, with Tukey weights ω_k of
//! decreasing width. So hidden parts have no data term, and outliers lose their weight. The base is
//! fixed at the clamp. Each round updates nearest points, weights and rotations, then solves for
//! all vertices at once; the plane term couples x, y and z. The roll of a round, unmarked finger
//! about its own axis cannot be identified. mm. Published objective for comparison: `paper.rs`.

use super::arap::Arap;
use super::robust::{OF_MEDIAN, median, tukey};
use super::start::{CUT, spread};
use super::surface::{Foot, Surface};
use crate::algebra::sparse::{Factor, Pattern};
use crate::algebra::{Mat3, Vec3, outer};
use crate::error::{Result, invalid};

/// Width of the Tukey weights, mm: the first, and the last for a noisy cloud; else a multiple of
/// its noise.
const WIDE: f64 = 3.0;
const NARROW: f64 = 1.5;
const OF_NOISE: f64 = 3.0;
/// Rounds per halving of the width.
const HALVES: f64 = 8.0;
/// Least width, mm: the accuracy of templates.
const LEAST: f64 = 0.3;
/// Weight of a point along the surface, relative to across.
const ALONG: f64 = 0.05;
/// Converged if the vertices move by less in a round, mm RMS.
const SETTLED: f64 = 1e-2;

/// The settings of a registration.
#[derive(Debug, Clone, Copy)]
pub struct Recipe {
    /// λ: weight of the cloud relative to the stiffness of the surface.
    pub cloud: f64,
    /// Points of the cloud that are used.
    pub points: usize,
    /// Most rounds.
    pub rounds: usize,
    /// B: weight of the fixed base.
    pub base: f64,
}

impl Default for Recipe {
    fn default() -> Recipe {
        Recipe {
            cloud: 3.0,
            points: 2000,
            rounds: 25,
            base: 100.0,
        }
    }
}

/// A finger's surface, prepared for registration.
pub struct Template {
    pub arap: Arap,
    /// The triangles that may be visible: points are never on the walls of a cavity.
    pub triangles: Vec<[usize; 3]>,
    /// The clamped vertices.
    pub base: Vec<usize>,
    pattern: Pattern<3>,
}

/// A registered frame.
#[derive(Debug, Clone)]
pub struct Registered {
    /// The vertices (N, 3).
    pub places: Vec<Vec3>,
    /// Supporting points of each vertex (N,), by their weights.
    pub support: Vec<f64>,
    /// RMS distance from the cloud to the surface, by the weights, and noise of the cloud along the
    /// normals.
    pub residual_mm: f64,
    pub noise_mm: f64,
    /// Share of the cloud that is used.
    pub used: f64,
    pub rounds: usize,
    /// Whether it converged within the rounds.
    pub settled: bool,
}

impl Template {
    /// From vertices (N, 3) without load, triangles, and fixed vertices.
    pub fn new(rest: Vec<Vec3>, triangles: Vec<[usize; 3]>, base: Vec<usize>) -> Result<Template> {
        if let Some(far) = base.iter().find(|v| **v >= rest.len()) {
            return Err(invalid(format!(
                "the base has the vertex {far}, of {} there are; count vertices from 0",
                rest.len()
            )));
        }
        let shown = Surface::new(&rest, &triangles)?.shown();
        let arap = Arap::new(rest, &triangles)?;
        let triangles = shown.iter().map(|t| triangles[*t]).collect();
        let edges = arap.edges();
        let pairs = (0..edges.len()).flat_map(|i| edges.of(i).map(move |(j, _)| (i, j)));
        let pattern = Pattern::new(edges.len(), pairs.filter(|(i, j)| i > j))?;
        Ok(Template {
            arap,
            triangles,
            base,
            pattern,
        })
    }

    /// Number of vertices N.
    pub fn len(&self) -> usize {
        self.arap.rest().len()
    }

    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The matrix of the surface and its fixed base alone.
    fn still(&self, base: f64) -> Vec<f64> {
        let mut values = vec![0.0; self.pattern.len()];
        let edges = self.arap.edges();
        for i in 0..self.len() {
            let mut own = 0.0;
            for (j, w) in edges.of(i) {
                own += 2.0 * w;
                if let (true, Some(slot)) = (i > j, self.pattern.slot(i, j)) {
                    self.pattern.add(&mut values, j, slot, &diagonal(-2.0 * w));
                }
            }
            self.pattern.add(&mut values, i, 0, &diagonal(own));
        }
        for i in &self.base {
            self.pattern.add(&mut values, *i, 0, &diagonal(base));
        }
        values
    }
}

fn diagonal(value: f64) -> [[f64; 3]; 3] {
    Mat3::from_diagonal(Vec3::splat(value)).to_cols_array_2d()
}

/// Registers one frame after another on one thread.
pub struct Registrar<'a> {
    template: &'a Template,
    recipe: Recipe,
    still: Vec<f64>,
    values: Vec<f64>,
    right: Vec<f64>,
    factor: Factor,
}

impl<'a> Registrar<'a> {
    pub fn new(template: &'a Template, recipe: Recipe) -> Result<Registrar<'a>> {
        let still = template.still(recipe.base);
        Ok(Registrar {
            template,
            recipe,
            values: still.clone(),
            right: vec![0.0; 3 * template.len()],
            factor: Factor::new(&template.pattern, 1)?,
            still,
        })
    }

    /// Register a `cloud` from the model's shape `start` (N, 3).
    pub fn register(&mut self, cloud: &[Vec3], start: Vec<Vec3>) -> Result<Registered> {
        let template = self.template;
        let cloud = spread(cloud, self.recipe.points);
        let mut surface = Surface::new(&start, &template.triangles)?;
        let arap = template.arap.resting_at(start);
        let mut pose = arap.pose();
        let (mut noise, mut settled, mut rounds) = (f64::INFINITY, false, 0);
        let mut feet: Vec<Foot> = vec![];
        let mut weights: Vec<f64> = vec![];
        while rounds < self.recipe.rounds && !settled {
            feet.clear();
            feet.extend(cloud.iter().map(|p| surface.foot(*p)));
            let falling = WIDE * 0.5f64.powf(rounds as f64 / HALVES);
            let least = (OF_NOISE * noise).clamp(LEAST, NARROW);
            let width = falling.max(least);
            weights.clear();
            weights.extend(feet.iter().map(|foot| tukey(foot.distance, CUT * width)));
            let across = |k: usize| {
                surface
                    .normal(feet[k].triangle)
                    .dot(feet[k].place - cloud[k])
            };
            let mut off: Vec<f64> = (0..cloud.len())
                .filter(|k| weights[*k] > 0.0)
                .map(|k| across(k).abs())
                .collect();
            noise = OF_MEDIAN * median(&mut off);
            arap.local(&mut pose);
            self.assemble(&arap, &pose.turns, &surface, &cloud, &feet, &weights);
            if !self.factor.refactor(&template.pattern, &self.values) {
                return Err(invalid(
                    "nothing holds the surface: no base and no points of the cloud near it; give \
                    the vertices of the base",
                ));
            }
            self.factor.solve(&template.pattern, &mut self.right);
            let mut moved: f64 = 0.0;
            for (place, now) in pose.places.iter_mut().zip(self.right.chunks_exact(3)) {
                let now = Vec3::from_slice(now);
                moved += now.distance_squared(*place);
                *place = now;
            }
            surface.move_to(&pose.places);
            rounds += 1;
            settled = (moved / pose.places.len() as f64).sqrt() < SETTLED && falling <= least;
        }
        Ok(self.told(pose.places, &surface, &cloud, noise, rounds, settled))
    }

    fn told(
        &self,
        places: Vec<Vec3>,
        surface: &Surface,
        cloud: &[Vec3],
        noise: f64,
        rounds: usize,
        settled: bool,
    ) -> Registered {
        let cut = CUT * (OF_NOISE * noise).clamp(LEAST, NARROW);
        let mut support = vec![0.0; places.len()];
        let (mut sum, mut squares, mut used) = (0.0, 0.0, 0);
        for p in cloud {
            let foot = surface.foot(*p);
            let weight = tukey(foot.distance, cut);
            used += usize::from(weight > 0.0);
            sum += weight;
            squares += weight * foot.distance * foot.distance;
            for (v, w) in surface.corners(foot.triangle).iter().zip(foot.weights) {
                support[*v] += weight * w;
            }
        }
        Registered {
            places,
            support,
            residual_mm: (squares / f64::max(sum, f64::MIN_POSITIVE)).sqrt(),
            noise_mm: noise,
            used: used as f64 / cloud.len().max(1) as f64,
            rounds,
            settled,
        }
    }

    /// The system of one round.
    fn assemble(
        &mut self,
        arap: &Arap,
        turns: &[super::rotation::Quaternion],
        surface: &Surface,
        cloud: &[Vec3],
        feet: &[Foot],
        weights: &[f64],
    ) {
        let Registrar {
            template,
            recipe,
            still,
            values,
            right,
            ..
        } = self;
        values.copy_from_slice(still);
        arap.wanted(turns, |i, sum| sum.write_to_slice(&mut right[3 * i..]));
        for i in &template.base {
            (0..3).for_each(|c| right[3 * i + c] += recipe.base * template.arap.rest()[*i][c]);
        }
        let each = recipe.cloud * template.len() as f64 / cloud.len().max(1) as f64;
        for (k, foot) in feet.iter().enumerate().filter(|(k, _)| weights[*k] > 0.0) {
            let (n, m) = (surface.normal(foot.triangle), each * weights[k]);
            let pull = m * (outer(n, n) + Mat3::from_diagonal(Vec3::splat(ALONG)));
            let goal = pull * cloud[k];
            let corners = surface.corners(foot.triangle);
            for (a, i) in corners.iter().enumerate() {
                let own = foot.weights[a];
                (0..3).for_each(|c| right[3 * i + c] += own * goal[c]);
                for (b, j) in corners.iter().enumerate().filter(|(_, j)| *j <= i) {
                    let both = own * foot.weights[b];
                    if let Some(slot) = template.pattern.slot(*i, *j) {
                        let block = (both * pull).to_cols_array_2d();
                        template.pattern.add(values, *j, slot, &block);
                    }
                }
            }
        }
    }
}
