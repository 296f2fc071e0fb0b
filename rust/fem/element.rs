//! The element: a nearly incompressible neo-Hookean cell, total Lagrangian; a brick or a
//! tetrahedron.
//!
//! Energy of a cell (Simo, Taylor & Pister 1985; Bonet & Wood, Nonlinear Continuum Mechanics, ch.
//! 8):
//!   W = ∫ μ/2 (J^(−2/3) tr FᵀF − 3) dV + Σ V·U(θ),   θ = (1/V) ∫ J dV,   U(θ) = κ/4 (θ² − 1 − 2 ln
//!     θ)
//! with N nodes, Q Gauss points and the sum over parts of G points with rest volume V. A brick has
//! 8 nodes, 2×2×2 points and one part: its mean dilatation, without which it locks. A tetrahedron
//! has 10 nodes, 4 points and 4 parts: at ν ≤ 0.48 it does not lock, and with a mean dilatation
//! four points would leave it modes without energy (58 % too soft). μ is taken at the points, κ is
//! the mean over a part; MPa, energy in N·mm. U grows without bound as θ → 0, so a line search
//! cannot pass through a collapsed cell; a cell with J ≤ 0 at a point has infinite energy. Limits:
//! one pressure a brick, so stresses show a faint checkerboard; shapes do not (0.4–0.8 mm from a
//! fine reference at 43–86° on the usual mesh). Four-node tetrahedra lock (2–5 mm) and are never
//! used. Pinned by the tests below and the patch test.

use super::Vec3;
use super::material::Body;
use super::natural::Kind;
use crate::algebra::{Mat3, outer};
use crate::error::{Result, invalid};

/// Stiffness of a pair of nodes, N/mm.
pub type Block = [Vec3; 3];

/// The interface of a cell of any kind; `x` are the positions of all nodes.
pub trait Element: Send + Sync {
    /// Numbers of its nodes.
    fn nodes(&self) -> &[usize];
    /// ∫ N_a dV of each node: its share of the volume, mm³.
    fn share(&self) -> &[f64];
    /// Energy, N·mm; infinite if the cell is inverted.
    fn energy(&self, x: &[Vec3]) -> f64;
    /// The gradient of the energy (N) alone, added by node; undefined if the cell is inverted.
    fn force(&self, x: &[Vec3], force: &mut [Vec3]);
    /// Energy, its gradient (N) by node and its tangent (N/mm) by pairs (a, b ≤ a), row after row.
    fn tangent(&self, x: &[Vec3], force: &mut [Vec3], k: &mut [Block]) -> f64;
}

/// The elements of a mesh: cells of one kind, each with its number in the mesh.
pub fn elements<'a>(
    kind: Kind,
    cells: impl Iterator<Item = (usize, &'a [usize])>,
    nodes: &[Vec3],
    body: &Body,
) -> Result<Vec<Box<dyn Element>>> {
    let make = |cell: (usize, &[usize])| -> Result<Box<dyn Element>> {
        Ok(match kind {
            Kind::Brick => Box::new(Hyperelastic::<8, 8, 8>::new(kind, cell, nodes, body)?),
            Kind::Tetrahedron => Box::new(Hyperelastic::<10, 4, 1>::new(kind, cell, nodes, body)?),
        })
    };
    cells.map(make).collect()
}

/// One cell: gradients of its shape functions, weights and shear moduli at the Gauss points, and
/// the bulk modulus.
struct Hyperelastic<const N: usize, const Q: usize, const G: usize> {
    nodes: [usize; N],
    gradient: [[Vec3; N]; Q],
    weight: [f64; Q],
    mu: [f64; Q],
    /// Bulk modulus and rest volume of each part; the first Q/G are used.
    kappa: [f64; Q],
    volume: [f64; Q],
    share: [f64; N],
}

impl<const N: usize, const Q: usize, const G: usize> Hyperelastic<N, Q, G> {
    /// Rest geometry of a cell; rejected if it is inverted.
    fn new(
        kind: Kind,
        (number, cell): (usize, &[usize]),
        nodes: &[Vec3],
        body: &Body,
    ) -> Result<Self> {
        let corners: [Vec3; N] = std::array::from_fn(|a| nodes[cell[a]]);
        let mut element = Hyperelastic {
            nodes: std::array::from_fn(|a| cell[a]),
            gradient: [[Vec3::ZERO; N]; Q],
            weight: [0.0; Q],
            mu: [0.0; Q],
            kappa: [0.0; Q],
            volume: [0.0; Q],
            share: [0.0; N],
        };
        let (points, weight) = kind.points();
        let mut kappa = [0.0; Q];
        for (q, &xi) in points.iter().enumerate() {
            let (value, slope) = kind.shape(xi);
            let (place, jacobian) = kind.place(&corners, xi);
            let det = jacobian.determinant();
            if !(det.is_finite() && det > 0.0) {
                return Err(invalid(format!(
                    "cell at {:.1} mm is inside out (Jacobian {det:.3e}); use a smoother profile, \
                    more layers or a better mesh",
                    corners[0]
                )));
            }
            let steeper = jacobian.inverse().transpose();
            for a in 0..N {
                element.gradient[q][a] = steeper * slope[a]; // dN/dX = J^(−T) dN/dξ
                element.share[a] += weight * det * value[a];
            }
            let material = body.at(place, number);
            (element.mu[q], kappa[q]) = (material.mu, material.kappa);
            element.weight[q] = weight * det;
            element.volume[q / G] += weight * det;
        }
        // The mean, in a form that keeps equal numbers bit for bit.
        for part in 0..Q / G {
            let (points, one) = (part * G..(part + 1) * G, kappa[part * G]);
            let away: f64 = points.map(|q| element.weight[q] * (kappa[q] - one)).sum();
            element.kappa[part] = one + away / element.volume[part];
        }
        Ok(element)
    }

    /// V·U of a part of deformed volume `dilated`, its slope (a pressure) and its curvature in that
    /// volume.
    fn bulk(&self, part: usize, dilated: f64) -> (f64, f64, f64) {
        let (volume, kappa) = (self.volume[part], self.kappa[part]);
        let theta = dilated / volume;
        (
            volume * 0.25 * kappa * (theta * theta - 1.0 - 2.0 * theta.ln()),
            0.5 * kappa * (theta - 1.0 / theta),
            0.5 * kappa * (1.0 + 1.0 / (theta * theta)) / volume,
        )
    }

    fn gather(&self, x: &[Vec3]) -> [Vec3; N] {
        self.nodes.map(|n| x[n])
    }

    /// Forces of one Gauss point: with g = F^(−T) ∇N (spatial gradient) and v = F ∇N, I₁ = tr FᵀF,
    /// they are μ J^(−2/3) (v_a − I₁/3 g_a), and J g_a is its share of the part's swelling. Returns
    /// g, v, I₁ and μ J^(−2/3) dV.
    fn add_force(
        &self,
        q: usize,
        f: Mat3,
        j: f64,
        force: &mut [Vec3],
        swell: &mut [Vec3; N],
    ) -> ([Vec3; N], [Vec3; N], f64, f64) {
        let weight = self.weight[q];
        let (spatial, first) = (f.inverse().transpose(), first(f));
        let scale = self.mu[q] * weight / j.cbrt().powi(2);
        let (mut g, mut v) = ([Vec3::ZERO; N], [Vec3::ZERO; N]);
        for a in 0..N {
            let n = self.gradient[q][a];
            (g[a], v[a]) = (spatial * n, f * n);
            force[a] += scale * (v[a] - first / 3.0 * g[a]);
            swell[a] += weight * j * g[a];
        }
        (g, v, first, scale)
    }

    /// One Gauss point: besides its forces the blocks μ J^(−2/3) [(∇N_a·∇N_b) I − 2/3 (v_a g_bᵀ +
    /// g_a v_bᵀ) + I₁ (2/9 g_a g_bᵀ + 1/3 g_b g_aᵀ)] + p J (g_a g_bᵀ − g_b g_aᵀ).
    fn add_point(
        &self,
        q: usize,
        f: Mat3,
        j: f64,
        pressure: f64,
        force: &mut [Vec3],
        k: &mut [Block],
        swell: &mut [Vec3; N],
    ) -> f64 {
        let (weight, mu) = (self.weight[q], self.mu[q]);
        let (g, v, first, scale) = self.add_force(q, f, j, force, swell);
        let spin = pressure * j * weight;
        for a in 0..N {
            let left = scale * (first * 2.0 / 9.0 * g[a] - 2.0 / 3.0 * v[a]) + spin * g[a];
            let middle = -2.0 / 3.0 * scale * g[a];
            let right = (scale * first / 3.0 - spin) * g[a];
            for b in 0..=a {
                let same = scale * self.gradient[q][a].dot(self.gradient[q][b]);
                let block = &mut k[a * (a + 1) / 2 + b];
                for i in 0..3 {
                    block[i] += left[i] * g[b] + middle[i] * v[b] + g[b][i] * right;
                    block[i][i] += same;
                }
            }
        }
        weight * 0.5 * mu * (first / j.cbrt().powi(2) - 3.0)
    }

    #[inline(always)]
    fn deformation(&self, x: &[Vec3; N], q: usize) -> Mat3 {
        let mut f = Mat3::ZERO;
        for a in 0..N {
            f += outer(x[a], self.gradient[q][a]);
        }
        f
    }
}

impl<const N: usize, const Q: usize, const G: usize> Element for Hyperelastic<N, Q, G> {
    fn nodes(&self) -> &[usize] {
        &self.nodes
    }

    fn share(&self) -> &[f64] {
        &self.share
    }

    fn energy(&self, x: &[Vec3]) -> f64 {
        let x = self.gather(x);
        let mut energy = 0.0;
        for part in 0..Q / G {
            let (mut shear, mut dilated) = (0.0, 0.0);
            for q in part * G..(part + 1) * G {
                let f = self.deformation(&x, q);
                let j = f.determinant();
                if j.is_nan() || j <= 0.0 {
                    return f64::INFINITY;
                }
                shear += self.weight[q] * 0.5 * self.mu[q] * (first(f) / j.cbrt().powi(2) - 3.0);
                dilated += self.weight[q] * j;
            }
            energy += shear + self.bulk(part, dilated).0;
        }
        energy
    }

    fn force(&self, x: &[Vec3], force: &mut [Vec3]) {
        let x = self.gather(x);
        for part in 0..Q / G {
            let (mut dilated, mut swell) = (0.0, [Vec3::ZERO; N]);
            for q in part * G..(part + 1) * G {
                let f = self.deformation(&x, q);
                let j = f.determinant();
                dilated += self.weight[q] * j;
                self.add_force(q, f, j, force, &mut swell);
            }
            let pressure = self.bulk(part, dilated).1;
            for a in 0..N {
                force[a] += pressure * swell[a];
            }
        }
    }

    fn tangent(&self, x: &[Vec3], force: &mut [Vec3], k: &mut [Block]) -> f64 {
        let x = self.gather(x);
        force.fill(Vec3::ZERO);
        k.fill([Vec3::ZERO; 3]);
        let mut energy = 0.0;
        for part in 0..Q / G {
            let mut points = [(Mat3::ZERO, 0.0); G];
            let mut dilated = 0.0;
            for (g, point) in points.iter_mut().enumerate() {
                let f = self.deformation(&x, part * G + g);
                let j = f.determinant();
                if j.is_nan() || j <= 0.0 {
                    return f64::INFINITY;
                }
                *point = (f, j);
                dilated += self.weight[part * G + g] * j;
            }
            let (stored, pressure, bulk) = self.bulk(part, dilated);
            energy += stored;
            let mut swell = [Vec3::ZERO; N]; // dV/dx of the deformed part
            for (g, &(f, j)) in points.iter().enumerate() {
                energy += self.add_point(part * G + g, f, j, pressure, force, k, &mut swell);
            }
            for a in 0..N {
                force[a] += pressure * swell[a];
                for b in 0..=a {
                    let block = &mut k[a * (a + 1) / 2 + b];
                    for i in 0..3 {
                        block[i] += bulk * swell[a][i] * swell[b];
                    }
                }
            }
        }
        energy
    }
}

/// I₁ = tr FᵀF
fn first(f: Mat3) -> f64 {
    f.x_axis.length_squared() + f.y_axis.length_squared() + f.z_axis.length_squared()
}

#[cfg(test)]
#[path = "element_tests.rs"]
mod tests;
