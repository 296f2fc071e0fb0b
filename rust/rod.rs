//! The rod prior: a chain of chords whose bending angles are a polynomial of the commands, and how loads bend it.
//!
//! For a robot that has no simulator. Marker p_k (k = 1..K, base to tip) hangs on chord d_k = p_k − p_{k−1} below the
//! base point p_0. In the base frame (z along the rest axis) chord k has the angle vector
//!   v_k = β · d_xy/|d_xy|,  β = atan2(|d_xy|, d_z)  (rad),   so that  d_k = |d_k| · (v_k·sin β/β, cos β).
//! Commands are normalised, q = (u − centre)/scale; all 2K angles are one polynomial of q (degree 1..4, monomials in
//! graded order, intercept first), and every chord length (mm) is a quadratic of the 2K angles.
//! Evaluation is closed form and smooth through the straight pose (β = 0). Limits: β beyond π folds back; outside the
//! fitted commands a cubic grows fast and nothing is clamped. Fitting is done in `softmap_edge/rod.py`.
//!
//! A load turns every cross-section by its bending moment. With c = 1/(E·I) (N⁻¹·mm⁻²) the markers move, to first order, by
//!   δp_i = c ∫_0^{s_i} [M(s)]_⊥ × (p_i − c(s)) ds      (mm),
//! M(s) = (p_tip − c(s)) × F for a tip force F, M(s) = ∫_s^L (c(r) − c(s)) × (W/L) dr for a weight W spread evenly, ⊥ =
//! without the part along the chord (twist is stiff). The centreline c(s) is the chords, on which the integrand is a cubic at
//! most, so Simpson's rule is exact. Motors that hold keep every tendon's length, hence each chord's mean bending: the share
//! `lock` of the mean of [M]_⊥ over the chord is carried by them. The robot's stiffness is not known from its shape: c is
//! one nominal number and amounts of load are only meaningful as displacement.

use crate::error::{Error, Result, invalid};
use crate::shape::Shape;

/// Largest number of monomials that a rod accepts: 9 channels to the cubic are 219.
const MOST_MONOMIALS: usize = 5000;

/// Every monomial of degree 1..=degree in `variables` numbers, in graded lexicographic order, without the constant.
#[derive(Debug, Clone)]
pub struct Monomials {
    variables: usize,
    /// Each monomial is an earlier one (or 1) times a variable: (parent, variable).
    steps: Vec<(Option<usize>, usize)>,
}

impl Monomials {
    /// List the monomials; refuses degree 0, no variables and more than 5000 terms.
    pub fn new(variables: usize, degree: usize) -> Result<Self> {
        if variables == 0 || degree == 0 || degree > 4 {
            return Err(invalid(format!(
                "a polynomial needs at least one variable and a degree of 1 to 4, got {variables} variables and degree {degree}"
            )));
        }
        let too_many = || {
            invalid(format!(
                "a polynomial of degree {degree} in {variables} variables has more than {MOST_MONOMIALS} terms; choose a lower degree"
            ))
        };
        if variables > MOST_MONOMIALS {
            return Err(too_many());
        }
        let mut steps: Vec<(Option<usize>, usize)> = (0..variables).map(|j| (None, j)).collect();
        let mut previous = 0..steps.len();
        for _ in 1..degree {
            let start = steps.len();
            for parent in previous {
                for j in steps[parent].1..variables {
                    steps.push((Some(parent), j));
                }
                if steps.len() > MOST_MONOMIALS {
                    return Err(too_many());
                }
            }
            previous = start..steps.len();
        }
        Ok(Self { variables, steps })
    }

    /// Number of monomials.
    pub fn len(&self) -> usize {
        self.steps.len()
    }

    /// Never true: there is at least one variable.
    pub fn is_empty(&self) -> bool {
        self.steps.is_empty()
    }

    /// The degree of each monomial.
    pub fn degrees(&self) -> Vec<usize> {
        let mut degrees: Vec<usize> = Vec::with_capacity(self.len());
        for &(parent, _) in &self.steps {
            degrees.push(1 + parent.map_or(0, |p| degrees[p]));
        }
        degrees
    }

    /// Values of all monomials at `x` (variables,).
    pub fn values(&self, x: &[f64], out: &mut [f64]) {
        for (f, &(parent, j)) in self.steps.iter().enumerate() {
            out[f] = parent.map_or(1.0, |p| out[p]) * x[j];
        }
    }

    /// Slopes of all monomials at `x`: `out[f * variables + j]`, given their `values`.
    fn slopes(&self, x: &[f64], values: &[f64], out: &mut [f64]) {
        let n = self.variables;
        for (f, &(parent, j)) in self.steps.iter().enumerate() {
            for k in 0..n {
                out[f * n + k] = parent.map_or(0.0, |p| out[p * n + k]) * x[j];
            }
            out[f * n + j] += parent.map_or(1.0, |p| values[p]);
        }
    }
}

/// A polynomial map with an intercept: weights (1 + F, outputs), row 0 the intercept.
#[derive(Debug, Clone)]
struct Polynomial {
    monomials: Monomials,
    weights: Vec<f64>,
    outputs: usize,
}

impl Polynomial {
    fn new(monomials: Monomials, weights: Vec<f64>, outputs: usize, what: &str) -> Result<Self> {
        let rows = monomials.len() + 1;
        if weights.len() != rows * outputs {
            return Err(invalid(format!(
                "{what} has {} weights, expected {rows} rows (intercept and {} monomials) of {outputs}",
                weights.len(),
                rows - 1
            )));
        }
        finite(&weights, what)?;
        Ok(Self {
            monomials,
            weights,
            outputs,
        })
    }

    /// Values at `x`; with `slopes` also d out / d x as `slopes[o * variables + j]`.
    fn eval(&self, x: &[f64], out: &mut [f64], slopes: Option<&mut [f64]>) {
        let m = self.outputs;
        let mut phi = vec![0.0; self.monomials.len()];
        self.monomials.values(x, &mut phi);
        out.copy_from_slice(&self.weights[..m]);
        for (value, row) in phi.iter().zip(self.weights[m..].chunks_exact(m)) {
            for (o, w) in out.iter_mut().zip(row) {
                *o += value * w;
            }
        }
        if let Some(slopes) = slopes {
            let n = x.len();
            let mut rise = vec![0.0; phi.len() * n];
            self.monomials.slopes(x, &phi, &mut rise);
            slopes.fill(0.0);
            for (rise, row) in rise.chunks_exact(n).zip(self.weights[m..].chunks_exact(m)) {
                for (o, w) in row.iter().enumerate() {
                    for j in 0..n {
                        slopes[o * n + j] += w * rise[j];
                    }
                }
            }
        }
    }
}

fn finite(numbers: &[f64], what: &str) -> Result<()> {
    match numbers.iter().position(|x| !x.is_finite()) {
        Some(at) => Err(invalid(format!(
            "{what} holds {} at position {at}; every number must be finite",
            numbers[at]
        ))),
        None => Ok(()),
    }
}

/// The regressed chord-angle rod: C commands to K markers.
#[derive(Debug, Clone)]
pub struct Rod {
    base: [f64; 3],
    centre: Vec<f64>,
    scale: Vec<f64>,
    angles: Polynomial,
    lengths: Polynomial,
}

impl Rod {
    /// Build from base point (mm), command centre and scale (C,), `degree`, angle weights (1 + F, 2K) in rad and length
    /// weights (1 + 2K + K(2K+1), K) in mm, both row-major with the intercept first.
    pub fn new(
        base: [f64; 3],
        centre: Vec<f64>,
        scale: Vec<f64>,
        degree: usize,
        angles: Vec<f64>,
        lengths: Vec<f64>,
    ) -> Result<Self> {
        if centre.len() != scale.len() {
            return Err(invalid(format!(
                "a rod's centre has {} channels and its scale {}; give one number of each per channel",
                centre.len(),
                scale.len()
            )));
        }
        finite(&base, "a rod's base point")?;
        finite(&centre, "a rod's command centre")?;
        finite(&scale, "a rod's command scale")?;
        if let Some(at) = scale.iter().position(|&s| s <= 0.0) {
            return Err(invalid(format!(
                "a rod's command scale [{at}] is {}; it must be positive",
                scale[at]
            )));
        }
        let monomials = Monomials::new(scale.len(), degree)?;
        let rows = monomials.len() + 1;
        if angles.is_empty() || angles.len() % (2 * rows) != 0 {
            return Err(invalid(format!(
                "a rod's angle weights hold {} numbers, expected {rows} rows (degree {degree}, {} channels) of two per chord",
                angles.len(),
                scale.len()
            )));
        }
        let chords = angles.len() / (2 * rows);
        let quadratic = Monomials::new(2 * chords, 2)?;
        Ok(Self {
            base,
            centre,
            scale,
            angles: Polynomial::new(monomials, angles, 2 * chords, "a rod's angle weights")?,
            lengths: Polynomial::new(quadratic, lengths, chords, "a rod's length weights")?,
        })
    }

    /// Number of chords, which is the number of markers K.
    pub fn chords(&self) -> usize {
        self.lengths.outputs
    }

    /// The base point p_0 (mm).
    pub fn base(&self) -> [f64; 3] {
        self.base
    }

    fn normalised(&self, u: &[f64]) -> Vec<f64> {
        u.iter()
            .zip(&self.centre)
            .zip(&self.scale)
            .map(|((u, c), s)| (u - c) / s)
            .collect()
    }

    /// Base point and markers at `u`: K + 1 points.
    fn points(&self, u: &[f64]) -> Vec<[f64; 3]> {
        let chords = self.chords();
        let (mut v, mut lengths) = (vec![0.0; 2 * chords], vec![0.0; chords]);
        self.angles.eval(&self.normalised(u), &mut v, None);
        self.lengths.eval(&v, &mut lengths, None);
        let mut points = vec![self.base];
        let mut p = self.base;
        for k in 0..chords {
            let (x, y) = (v[2 * k], v[2 * k + 1]);
            let bend = Bend::new(x, y);
            p = add(
                p,
                scaled([bend.sinc * x, bend.sinc * y, bend.cos], lengths[k]),
            );
            points.push(p);
        }
        points
    }
}

/// sin β/β, cos β and (β·cos β − sin β)/β³ with their limits 1, 1 and −1/3 at β = 0.
struct Bend {
    sinc: f64,
    cos: f64,
    /// d sinc / d x = x · rise.
    rise: f64,
}

impl Bend {
    fn new(x: f64, y: f64) -> Self {
        let square = x * x + y * y;
        let beta = square.sqrt();
        // Below 0.02 rad the series is exact to 1e-16 and the quotients lose digits.
        if beta < 0.02 {
            let sinc = 1.0 - square / 6.0 * (1.0 - square / 20.0 * (1.0 - square / 42.0));
            return Self {
                sinc,
                cos: beta.cos(),
                rise: -1.0 / 3.0 + square / 30.0 * (1.0 - square / 28.0),
            };
        }
        let (sin, cos) = beta.sin_cos();
        Self {
            sinc: sin / beta,
            cos,
            rise: (beta * cos - sin) / (square * beta),
        }
    }
}

impl Shape for Rod {
    fn channels(&self) -> usize {
        self.scale.len()
    }

    fn size(&self) -> usize {
        3 * self.chords()
    }

    fn eval(&self, u: &[f64], out: &mut [f64]) {
        for (out, p) in out.chunks_exact_mut(3).zip(self.points(u).iter().skip(1)) {
            out.copy_from_slice(p);
        }
    }

    fn jacobian(&self, u: &[f64], out: &mut [f64]) {
        let (c, chords) = (self.channels(), self.chords());
        let n = 2 * chords;
        let (mut v, mut dv) = (vec![0.0; n], vec![0.0; n * c]);
        self.angles.eval(&self.normalised(u), &mut v, Some(&mut dv));
        let (mut lengths, mut dl) = (vec![0.0; chords], vec![0.0; chords * n]);
        self.lengths.eval(&v, &mut lengths, Some(&mut dl));
        for j in 0..c {
            let mut slope = [0.0; 3];
            for k in 0..chords {
                let (x, y) = (v[2 * k], v[2 * k + 1]);
                let (dx, dy) = (
                    dv[2 * k * c + j] / self.scale[j],
                    dv[(2 * k + 1) * c + j] / self.scale[j],
                );
                let stretch: f64 =
                    (0..n).map(|i| dl[k * n + i] * dv[i * c + j]).sum::<f64>() / self.scale[j];
                let bend = Bend::new(x, y);
                let along = x * dx + y * dy;
                let turn = [
                    bend.sinc * dx + bend.rise * along * x,
                    bend.sinc * dy + bend.rise * along * y,
                    -bend.sinc * along,
                ];
                let chord = [bend.sinc * x, bend.sinc * y, bend.cos];
                slope = add(slope, add(scaled(turn, lengths[k]), scaled(chord, stretch)));
                for axis in 0..3 {
                    out[(3 * k + axis) * c + j] = slope[axis];
                }
            }
        }
    }
}

/// What bends the rod.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Load {
    /// A weight of 1 N spread evenly along the rod.
    Weight,
    /// A force of 1 N at the last marker.
    TipForce,
}

/// Marker displacements (mm) of a rod under one unit load along one axis of the base frame.
#[derive(Debug, Clone)]
pub struct RodField {
    rod: Rod,
    load: Load,
    axis: usize,
    compliance: f64,
    lock: f64,
}

impl RodField {
    /// `name` is `gravity_x|y|z` (all of the weight turned along the axis) or `tip_force_x|y|z`; `compliance` c in
    /// N⁻¹·mm⁻²: mm per N of tip force; for gravity the product c·W is mm per 1 g when W (N) is the robot's weight.
    /// `lock` is the share of each chord's mean bending moment that its tendons carry: 0 free, 1 of fixed length.
    pub fn new(rod: Rod, name: &str, compliance: f64, lock: f64) -> Result<Self> {
        let parts = name.rsplit_once('_').and_then(|(load, axis)| {
            let load = match load {
                "gravity" => Load::Weight,
                "tip_force" => Load::TipForce,
                _ => return None,
            };
            Some((load, ["x", "y", "z"].iter().position(|&a| a == axis)?))
        });
        let Some((load, axis)) = parts else {
            return Err(Error::Invalid(format!(
                "a rod has no field {name:?}; it has gravity_x, gravity_y, gravity_z, tip_force_x, tip_force_y and tip_force_z"
            )));
        };
        if !(compliance.is_finite() && compliance > 0.0) {
            return Err(invalid(format!(
                "a rod's compliance is {compliance} per N mm²; it must be positive"
            )));
        }
        if !(0.0..=1.0).contains(&lock) {
            return Err(invalid(format!(
                "a rod's lock is {lock}; it is 0 (free tendons) to 1 (tendons that hold)"
            )));
        }
        Ok(Self {
            rod,
            load,
            axis,
            compliance,
            lock,
        })
    }

    /// Bending moment per unit load at fraction `s` of chord `k`.
    fn moment(&self, chain: &Chain, k: usize, s: f64) -> [f64; 3] {
        let mut force = [0.0; 3];
        force[self.axis] = 1.0;
        let at = chain.at(k, s);
        match self.load {
            Load::TipForce => cross(sub(chain.points[chain.points.len() - 1], at), force),
            Load::Weight => {
                // First moment of what hangs beyond: the rest of this chord about its middle, then whole chords.
                let rest = chain.lengths[k] * (1.0 - s);
                let mut arm = scaled(sub(chain.at(k, 0.5 * (1.0 + s)), at), rest);
                for j in k + 1..chain.lengths.len() {
                    arm = add(arm, scaled(sub(chain.at(j, 0.5), at), chain.lengths[j]));
                }
                cross(scaled(arm, 1.0 / chain.total), force)
            }
        }
    }
}

/// The chords at one command.
struct Chain {
    points: Vec<[f64; 3]>,
    lengths: Vec<f64>,
    total: f64,
}

impl Chain {
    fn new(points: Vec<[f64; 3]>) -> Self {
        let lengths: Vec<f64> = points
            .windows(2)
            .map(|p| dot(sub(p[1], p[0]), sub(p[1], p[0])).sqrt())
            .collect();
        let total = lengths.iter().sum();
        Self {
            points,
            lengths,
            total,
        }
    }

    fn at(&self, k: usize, s: f64) -> [f64; 3] {
        add(
            self.points[k],
            scaled(sub(self.points[k + 1], self.points[k]), s),
        )
    }
}

impl Shape for RodField {
    fn channels(&self) -> usize {
        self.rod.channels()
    }

    fn size(&self) -> usize {
        self.rod.size()
    }

    fn eval(&self, u: &[f64], out: &mut [f64]) {
        let chain = Chain::new(self.rod.points(u));
        out.fill(0.0);
        for k in 0..chain.lengths.len() {
            let length = chain.lengths[k];
            if length == 0.0 {
                continue;
            }
            let tangent = scaled(sub(chain.points[k + 1], chain.points[k]), 1.0 / length);
            let nodes = [(0.0, 1.0 / 6.0), (0.5, 4.0 / 6.0), (1.0, 1.0 / 6.0)];
            let bendings = nodes.map(|(s, _)| {
                let moment = self.moment(&chain, k, s);
                sub(moment, scaled(tangent, dot(moment, tangent)))
            });
            let mean = nodes
                .iter()
                .zip(&bendings)
                .fold([0.0; 3], |sum, (node, bending)| {
                    add(sum, scaled(*bending, node.1))
                });
            for ((s, weight), bending) in nodes.into_iter().zip(bendings) {
                let bending = sub(bending, scaled(mean, self.lock));
                let turn = scaled(bending, self.compliance * weight * length);
                let at = chain.at(k, s);
                for i in k..chain.lengths.len() {
                    let shift = cross(turn, sub(chain.points[i + 1], at));
                    for axis in 0..3 {
                        out[3 * i + axis] += shift[axis];
                    }
                }
            }
        }
    }
}

fn add(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[0] + b[0], a[1] + b[1], a[2] + b[2]]
}

fn sub(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

fn scaled(a: [f64; 3], by: f64) -> [f64; 3] {
    [a[0] * by, a[1] * by, a[2] * by]
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const LENGTHS: [f64; 2] = [100.0, 80.0];

    /// Two chords, two channels, quadratic; chord lengths shorten with the angles. `offset` bends the rest pose.
    fn rod(offset: f64) -> Rod {
        let mut angles = vec![0.0; 6 * 4];
        angles[..4].copy_from_slice(&[offset, -offset, 0.5 * offset, 0.0]);
        angles[4..12].copy_from_slice(&[0.6, 0.05, -0.1, 0.02, 0.03, 0.5, 0.1, 0.7]);
        angles[12..].copy_from_slice(&[
            0.1, 0.0, 0.05, 0.0, 0.02, -0.1, 0.0, 0.0, 0.0, 0.1, 0.0, -0.05,
        ]);
        let mut lengths = vec![0.0; 15 * 2];
        lengths[..2].copy_from_slice(&LENGTHS);
        lengths[2] = 1.5;
        lengths[10] = -4.0;
        lengths[29] = -3.0;
        Rod::new(
            [1.0, 2.0, -3.0],
            vec![1.0, -1.0],
            vec![10.0, 8.0],
            2,
            angles,
            lengths,
        )
        .expect("a valid rod")
    }

    fn numeric(shape: &dyn Shape, u: &[f64]) -> Vec<f64> {
        struct Plain<'a>(&'a dyn Shape);
        impl Shape for Plain<'_> {
            fn channels(&self) -> usize {
                self.0.channels()
            }
            fn size(&self) -> usize {
                self.0.size()
            }
            fn eval(&self, u: &[f64], out: &mut [f64]) {
                self.0.eval(u, out)
            }
        }
        let mut slopes = vec![0.0; shape.size() * shape.channels()];
        Plain(shape).jacobian(u, &mut slopes);
        slopes
    }

    #[test]
    fn the_straight_pose_hangs_along_z_with_finite_slopes() {
        let rod = rod(0.0);
        let mut p = [0.0; 6];
        rod.eval(&[1.0, -1.0], &mut p);
        assert_eq!(p, [1.0, 2.0, 97.0, 1.0, 2.0, 177.0]);
        let mut slopes = [f64::NAN; 12];
        rod.jacobian(&[1.0, -1.0], &mut slopes);
        // First chord: length times the first-order angle, by hand.
        assert!(
            (slopes[0] - 100.0 * 0.6 / 10.0).abs() < 1e-12
                && (slopes[1] - 100.0 * 0.03 / 8.0).abs() < 1e-12
        );
        for (a, b) in slopes.iter().zip(numeric(&rod, &[1.0, -1.0])) {
            assert!((a - b).abs() < 1e-7, "{a} against {b}");
        }
    }

    proptest! {
        #[test]
        fn slopes_match_finite_differences(x in -15.0..15.0f64, y in -12.0..12.0f64, offset in -0.3..0.3f64) {
            let rod = rod(offset);
            let mut slopes = [0.0; 12];
            rod.jacobian(&[x, y], &mut slopes);
            for (a, b) in slopes.iter().zip(numeric(&rod, &[x, y])) {
                // Central differences of values near 200 mm over a step of 1e-5: round-off 5e-9, truncation less.
                prop_assert!((a - b).abs() < 1e-6, "{} against {}", a, b);
            }
        }

        #[test]
        fn slopes_hold_close_to_the_straight_pose(x in -1e-3..1e-3f64, y in -1e-3..1e-3f64) {
            let rod = rod(0.0);
            let at = [1.0 + x, -1.0 + y];
            let mut slopes = [0.0; 12];
            rod.jacobian(&at, &mut slopes);
            for (a, b) in slopes.iter().zip(numeric(&rod, &at)) {
                prop_assert!((a - b).abs() < 1e-6, "{} against {}", a, b);
            }
        }
    }

    #[test]
    fn the_series_meets_the_quotients() {
        for beta in [0.0199, 0.0201] {
            let bend = Bend::new(beta * 0.6, beta * 0.8);
            assert!((bend.sinc - f64::sin(beta) / beta).abs() < 1e-15);
            // The quotient cancels 1e-16 / 0.02³: good to 1e-10.
            assert!(
                (bend.rise - (beta * f64::cos(beta) - f64::sin(beta)) / beta.powi(3)).abs() < 1e-10
            );
        }
    }

    #[test]
    fn a_tip_force_bends_the_straight_rod_like_a_cantilever() {
        let (length, c) = (180.0f64, 2e-7);
        let field = RodField::new(rod(0.0), "tip_force_x", c, 0.0).expect("a field");
        let mut shift = [0.0; 6];
        field.eval(&[1.0, -1.0], &mut shift);
        let beam = |s: f64| c * s * s * (3.0 * length - s) / 6.0;
        let expected = [beam(100.0), 0.0, 0.0, beam(length), 0.0, 0.0];
        for (a, b) in shift.iter().zip(expected) {
            assert!((a - b).abs() < 1e-12, "{a} against {b}");
        }
        let field = RodField::new(rod(0.0), "gravity_y", c, 0.0).expect("a field");
        field.eval(&[1.0, -1.0], &mut shift);
        let beam =
            |s: f64| c / length * s * s * (6.0 * length * length - 4.0 * length * s + s * s) / 24.0;
        for (a, b) in shift
            .iter()
            .zip([0.0, beam(100.0), 0.0, 0.0, beam(length), 0.0])
        {
            assert!((a - b).abs() < 1e-12, "{a} against {b}");
        }
    }

    #[test]
    fn locked_chords_bend_into_an_s_and_keep_the_directions_of_their_ends() {
        let c = 1e-5;
        let mut shift = [0.0; 6];
        let field = RodField::new(rod(0.0), "tip_force_x", c, 1.0).expect("a field");
        field.eval(&[1.0, -1.0], &mut shift);
        // Clamped, guided beams one after the other: l³/12 each.
        let (first, second) = (c * 100.0f64.powi(3) / 12.0, c * 80.0f64.powi(3) / 12.0);
        for (a, b) in shift
            .iter()
            .zip([first, 0.0, 0.0, first + second, 0.0, 0.0])
        {
            assert!((a - b).abs() < 1e-12, "{a} against {b}");
        }
        assert!(RodField::new(rod(0.0), "tip_force_x", c, 1.1).is_err());
    }

    #[test]
    fn a_force_along_the_straight_rod_does_not_bend_it() {
        for name in ["tip_force_z", "gravity_z"] {
            let mut shift = [f64::NAN; 6];
            RodField::new(rod(0.0), name, 1e-6, 0.0)
                .expect("a field")
                .eval(&[1.0, -1.0], &mut shift);
            assert_eq!(shift, [0.0; 6]);
        }
    }

    #[test]
    fn fields_of_a_bent_rod_match_a_fine_sum() {
        for (name, load) in [("tip_force_z", Load::TipForce), ("gravity_z", Load::Weight)] {
            let (rod, c) = (rod(0.2), 1e-6);
            let u = [9.0, 6.0];
            let p = rod.points(&u);
            let mut shift = [0.0; 6];
            RodField::new(rod, name, c, 0.0)
                .expect("a field")
                .eval(&u, &mut shift);
            // Oracle: many short pieces, every product written out, moments summed point by point.
            let pieces = 400;
            let mut dots = Vec::new();
            for k in 0..2 {
                let d = sub(p[k + 1], p[k]);
                let ds = dot(d, d).sqrt() / f64::from(pieces);
                for i in 0..pieces {
                    dots.push((
                        k,
                        add(p[k], scaled(d, (f64::from(i) + 0.5) / f64::from(pieces))),
                        ds,
                    ));
                }
            }
            let total: f64 = dots.iter().map(|d| d.2).sum();
            let mut expected = [0.0; 6];
            for (a, &(k, at, ds)) in dots.iter().enumerate() {
                let down = [0.0, 0.0, 1.0];
                let moment = match load {
                    Load::TipForce => cross(sub(p[2], at), down),
                    Load::Weight => dots[a..].iter().fold([0.0; 3], |m, d| {
                        add(m, scaled(cross(sub(d.1, at), down), d.2 / total))
                    }),
                };
                let d = sub(p[k + 1], p[k]);
                let tangent = scaled(d, 1.0 / dot(d, d).sqrt());
                let bending = sub(moment, scaled(tangent, dot(moment, tangent)));
                for i in k..2 {
                    let turn = cross(scaled(bending, c * ds), sub(p[i + 1], at));
                    for axis in 0..3 {
                        expected[3 * i + axis] += turn[axis];
                    }
                }
            }
            let size = expected.iter().map(|x| x * x).sum::<f64>().sqrt();
            assert!(size > 0.1, "the case must bend: {size}");
            for (a, b) in shift.iter().zip(expected) {
                // The midpoint sum is off by about 1/pieces² of the size, its end piece by 1/pieces of one piece.
                assert!((a - b).abs() < 1e-4 * size, "{name}: {a} against {b}");
            }
        }
    }

    #[test]
    fn monomials_are_graded_and_complete() {
        let m = Monomials::new(6, 3).expect("monomials");
        assert_eq!(m.len(), 83);
        assert_eq!(m.degrees().iter().filter(|&&d| d == 3).count(), 56);
        let (m, mut values) = (Monomials::new(2, 3).expect("monomials"), [0.0; 9]);
        m.values(&[2.0, 3.0], &mut values);
        assert_eq!(values, [2.0, 3.0, 4.0, 6.0, 9.0, 8.0, 12.0, 18.0, 27.0]);
    }

    #[test]
    fn bad_numbers_are_refused_in_one_line() {
        let lengths = vec![1.0; 6];
        let make = |scale: f64, rows: usize, degree: usize| {
            Rod::new(
                [0.0; 3],
                vec![0.0],
                vec![scale],
                degree,
                vec![0.1; 2 * rows],
                lengths.clone(),
            )
        };
        assert!(make(1.0, 2, 1).is_ok());
        for bad in [
            make(0.0, 2, 1),
            make(f64::NAN, 2, 1),
            make(1.0, 2, 2),
            make(1.0, 2, 9),
            make(1.0, 0, 1),
        ] {
            let message = bad.expect_err("refused").to_string();
            assert!(!message.is_empty() && !message.contains('\n'));
        }
        assert!(RodField::new(rod(0.0), "twist_x", 1.0, 0.0).is_err());
        assert!(RodField::new(rod(0.0), "gravity_w", 1.0, 0.0).is_err());
        assert!(RodField::new(rod(0.0), "gravity_x", 0.0, 0.0).is_err());
    }
}
