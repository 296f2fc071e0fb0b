//! The material: a nearly incompressible neo-Hookean 8-node brick with mean dilatation (Q1P0), total Lagrangian.
//!
//! Energy of a brick of rest volume V (Simo, Taylor & Pister 1985; Bonet & Wood, Nonlinear Continuum Mechanics, ch. 8):
//!   W = ∫ μ/2 (J^(−2/3) tr FᵀF − 3) dV + V·U(θ),   θ = (1/V) ∫ J dV,   U(θ) = κ/4 (θ² − 1 − 2 ln θ)
//! with 2×2×2 Gauss points. μ = E/2(1+ν), κ = E/3(1−2ν) in MPa; energy in N·mm.
//! U grows without bound as θ → 0, so that a line search cannot walk through a collapsed brick; a brick with J ≤ 0 at a
//! Gauss point has infinite energy. Limit: one pressure a brick, so stresses show a faint checkerboard; shapes do not
//! (0.4–0.8 mm from a fine reference at 43–86° on the usual mesh). Pinned by the tests below and the patch test.

use super::{Vec3, axpy, dot, mesh};
use crate::error::{Result, invalid};

/// Shear and bulk modulus, MPa.
#[derive(Debug, Clone, Copy)]
pub struct Material {
    pub mu: f64,
    pub kappa: f64,
}

impl Material {
    /// From Young's modulus (MPa) and Poisson's ratio.
    pub fn new(young: f64, poisson: f64) -> Result<Material> {
        if !(young.is_finite() && young > 0.0) {
            return Err(invalid(format!(
                "Young's modulus {young} MPa: must be above 0; soft silicones have 0.05 to 1"
            )));
        }
        if !(poisson > 0.0 && poisson < 0.4999) {
            return Err(invalid(format!(
                "Poisson's ratio {poisson}: allowed is 0 to 0.4999; silicones take 0.45 to 0.49"
            )));
        }
        Ok(Material {
            mu: young / (2.0 * (1.0 + poisson)),
            kappa: young / (3.0 * (1.0 - 2.0 * poisson)),
        })
    }
}

/// Rest geometry of one brick: gradients of the shape functions and weights at the eight Gauss points.
#[derive(Debug, Clone)]
pub struct Brick {
    gradient: [[Vec3; 8]; 8],
    weight: [f64; 8],
    volume: f64,
    /// ∫ N_a dV: the node's share of the volume.
    pub share: [f64; 8],
}

/// Stiffness blocks `[a][b]` of the node pairs with b ≤ a.
pub type Stiffness = [[[Vec3; 3]; 8]; 8];

impl Brick {
    /// Rest geometry of the brick with these corners; refused when it is turned inside out.
    pub fn new(corners: &[Vec3; 8]) -> Result<Brick> {
        let g = 1.0 / 3f64.sqrt();
        let mut brick = Brick {
            gradient: [[[0.0; 3]; 8]; 8],
            weight: [0.0; 8],
            volume: 0.0,
            share: [0.0; 8],
        };
        for q in 0..8 {
            let sign = |bit: usize| if q >> bit & 1 == 1 { g } else { -g };
            let xi = [sign(0), sign(1), sign(2)];
            let (value, slope) = mesh::shape(xi);
            let (_, jacobian) = mesh::brick_place(corners, xi);
            let (cofactor, det) = cofactor(&jacobian);
            if !(det.is_finite() && det > 0.0) {
                return Err(invalid(format!(
                    "brick at {:.1?} mm is inside out (Jacobian {det:.3e}); use a smoother profile or more layers",
                    corners[0]
                )));
            }
            for a in 0..8 {
                // dN/dX = J^(−T) dN/dξ, and J^(−T) is the cofactor over the determinant.
                self::apply(&cofactor, slope[a], 1.0 / det, &mut brick.gradient[q][a]);
                brick.share[a] += det * value[a];
            }
            brick.weight[q] = det;
            brick.volume += det;
        }
        Ok(brick)
    }

    /// Energy at the deformed corners, N·mm; infinite where the brick is inside out.
    pub fn energy(&self, x: &[Vec3; 8], material: Material) -> f64 {
        let (mut shear, mut dilated) = (0.0, 0.0);
        for q in 0..8 {
            let f = self.deformation(x, q);
            let j = det(&f);
            if j.is_nan() || j <= 0.0 {
                return f64::INFINITY;
            }
            let trace = dot(f[0], f[0]) + dot(f[1], f[1]) + dot(f[2], f[2]);
            shear += self.weight[q] * 0.5 * material.mu * (trace / j.cbrt().powi(2) - 3.0);
            dilated += self.weight[q] * j;
        }
        let theta = dilated / self.volume;
        shear + self.volume * 0.25 * material.kappa * (theta * theta - 1.0 - 2.0 * theta.ln())
    }

    /// Energy, its gradient (N) and tangent (N/mm) at the deformed corners, for a brick that is not inside out.
    pub fn tangent(
        &self,
        x: &[Vec3; 8],
        material: Material,
        force: &mut [Vec3; 8],
        k: &mut Stiffness,
    ) -> f64 {
        *force = [[0.0; 3]; 8];
        *k = [[[[0.0; 3]; 3]; 8]; 8];
        let mut points = [([[0.0; 3]; 3], [[0.0; 3]; 3], 0.0); 8];
        let (mut energy, mut dilated) = (0.0, 0.0);
        for q in 0..8 {
            let f = self.deformation(x, q);
            let (c, j) = cofactor(&f);
            if j.is_nan() || j <= 0.0 {
                return f64::INFINITY;
            }
            points[q] = (f, c, j);
            dilated += self.weight[q] * j;
        }
        let theta = dilated / self.volume;
        energy += self.volume * 0.25 * material.kappa * (theta * theta - 1.0 - 2.0 * theta.ln());
        let pressure = 0.5 * material.kappa * (theta - 1.0 / theta);
        let bulk = 0.5 * material.kappa * (1.0 + 1.0 / (theta * theta)) / self.volume;
        let mut swell = [[0.0; 3]; 8]; // dV/dx of the deformed brick
        for q in 0..8 {
            let (f, c, j) = &points[q];
            energy += self.add_point(q, f, c, *j, material.mu, pressure, force, k, &mut swell);
        }
        for a in 0..8 {
            force[a] = axpy(force[a], pressure, swell[a]);
            for b in 0..=a {
                for i in 0..3 {
                    k[a][b][i] = axpy(k[a][b][i], bulk * swell[a][i], swell[b]);
                }
            }
        }
        energy
    }

    /// One Gauss point: with g = F^(−T) ∇N (spatial gradient) and v = F ∇N the blocks are
    /// μ J^(−2/3) [(∇N_a·∇N_b) I − 2/3 (v_a g_bᵀ + g_a v_bᵀ) + I₁ (2/9 g_a g_bᵀ + 1/3 g_b g_aᵀ)] + p J (g_a g_bᵀ − g_b g_aᵀ).
    fn add_point(
        &self,
        q: usize,
        f: &[Vec3; 3],
        c: &[Vec3; 3],
        j: f64,
        mu: f64,
        pressure: f64,
        force: &mut [Vec3; 8],
        k: &mut Stiffness,
        swell: &mut [Vec3; 8],
    ) -> f64 {
        let weight = self.weight[q];
        let first = dot(f[0], f[0]) + dot(f[1], f[1]) + dot(f[2], f[2]);
        let scale = mu * weight / j.cbrt().powi(2);
        let (mut g, mut v) = ([[0.0; 3]; 8], [[0.0; 3]; 8]);
        for a in 0..8 {
            let n = self.gradient[q][a];
            apply(c, n, 1.0 / j, &mut g[a]);
            apply(f, n, 1.0, &mut v[a]);
            for i in 0..3 {
                force[a][i] += scale * (v[a][i] - first / 3.0 * g[a][i]);
                swell[a][i] += weight * j * g[a][i];
            }
        }
        let spin = pressure * j * weight;
        for a in 0..8 {
            let left: Vec3 = std::array::from_fn(|i| {
                scale * (first * 2.0 / 9.0 * g[a][i] - 2.0 / 3.0 * v[a][i]) + spin * g[a][i]
            });
            let middle: Vec3 = std::array::from_fn(|i| -2.0 / 3.0 * scale * g[a][i]);
            let right: Vec3 = std::array::from_fn(|i| (scale * first / 3.0 - spin) * g[a][i]);
            for b in 0..=a {
                let same = scale * dot(self.gradient[q][a], self.gradient[q][b]);
                let block = &mut k[a][b];
                for i in 0..3 {
                    for m in 0..3 {
                        block[i][m] += left[i] * g[b][m] + middle[i] * v[b][m] + g[b][i] * right[m];
                    }
                    block[i][i] += same;
                }
            }
        }
        weight * 0.5 * mu * (first / j.cbrt().powi(2) - 3.0)
    }

    fn deformation(&self, x: &[Vec3; 8], q: usize) -> [Vec3; 3] {
        let mut f = [[0.0; 3]; 3];
        for a in 0..8 {
            for i in 0..3 {
                f[i] = axpy(f[i], x[a][i], self.gradient[q][a]);
            }
        }
        f
    }
}

/// `out = s M n`
fn apply(m: &[Vec3; 3], n: Vec3, s: f64, out: &mut Vec3) {
    for i in 0..3 {
        out[i] = s * dot(m[i], n);
    }
}

fn det(f: &[Vec3; 3]) -> f64 {
    f[0][0] * (f[1][1] * f[2][2] - f[1][2] * f[2][1])
        - f[0][1] * (f[1][0] * f[2][2] - f[1][2] * f[2][0])
        + f[0][2] * (f[1][0] * f[2][1] - f[1][1] * f[2][0])
}

/// Cofactor matrix (det · F^(−T)) and determinant.
pub fn cofactor(f: &[Vec3; 3]) -> ([Vec3; 3], f64) {
    let minor = |i: usize, j: usize| {
        let (a, b, c, d) = ((i + 1) % 3, (i + 2) % 3, (j + 1) % 3, (j + 2) % 3);
        f[a][c] * f[b][d] - f[a][d] * f[b][c]
    };
    let c = std::array::from_fn(|i| std::array::from_fn(|j| minor(i, j)));
    (c, det(f))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn skewed() -> ([Vec3; 8], [Vec3; 8]) {
        let rest = [
            [0.0, 0.1, 0.0],
            [2.0, 0.0, 0.2],
            [2.2, 1.9, 0.0],
            [0.1, 2.0, -0.1],
            [0.0, 0.0, 3.0],
            [2.1, 0.1, 2.9],
            [2.0, 2.1, 3.2],
            [-0.1, 1.8, 3.0],
        ];
        // A stretch with shear, bent by a quadratic term, so that no symmetry hides a wrong sign.
        let x = rest.map(|p| {
            [
                1.1 * p[0] + 0.3 * p[2] + 0.02 * p[2] * p[2],
                0.9 * p[1] - 0.2 * p[0] + 0.03 * p[0] * p[2],
                0.95 * p[2] + 0.1 * p[1] - 0.02 * p[1] * p[0],
            ]
        });
        (rest, x)
    }

    #[test]
    fn gradient_and_tangent_agree_with_finite_differences() {
        let (rest, x) = skewed();
        let material = Material::new(0.6, 0.48).unwrap();
        let brick = Brick::new(&rest).unwrap();
        let (mut force, mut k) = ([[0.0; 3]; 8], [[[[0.0; 3]; 3]; 8]; 8]);
        let energy = brick.tangent(&x, material, &mut force, &mut k);
        assert!((energy - brick.energy(&x, material)).abs() < 1e-13 * energy);
        let h = 1e-5;
        for b in 0..8 {
            for m in 0..3 {
                let moved = |s: f64| {
                    let mut y = x;
                    y[b][m] += s * h;
                    y
                };
                let slope = (brick.energy(&moved(1.0), material)
                    - brick.energy(&moved(-1.0), material))
                    / (2.0 * h);
                // Central differences of step 1e-5: truncation and round-off are both about 1e-9.
                assert!(
                    (slope - force[b][m]).abs() < 1e-8,
                    "{slope} {}",
                    force[b][m]
                );
                let (mut up, mut down, mut scrap) = ([[0.0; 3]; 8], [[0.0; 3]; 8], k);
                brick.tangent(&moved(1.0), material, &mut up, &mut scrap);
                brick.tangent(&moved(-1.0), material, &mut down, &mut scrap);
                for a in b..8 {
                    for i in 0..3 {
                        let numeric = (up[a][i] - down[a][i]) / (2.0 * h);
                        assert!((numeric - k[a][b][i][m]).abs() < 1e-8, "{a} {i} {b} {m}");
                    }
                }
            }
        }
    }

    #[test]
    fn rigid_motion_costs_nothing_and_uniform_strain_has_the_closed_form() {
        let (rest, _) = skewed();
        let material = Material::new(0.3, 0.45).unwrap();
        let brick = Brick::new(&rest).unwrap();
        let (c, s) = (0.8, 0.6);
        let turned = rest.map(|p| {
            [
                c * p[0] - s * p[1] + 5.0,
                s * p[0] + c * p[1] - 2.0,
                p[2] + 1.0,
            ]
        });
        assert!(brick.energy(&turned, material).abs() < 1e-13);
        let stretch = [1.2, 0.9, 1.05];
        let x = rest.map(|p| [stretch[0] * p[0], stretch[1] * p[1], stretch[2] * p[2]]);
        let j: f64 = stretch.iter().product();
        let first: f64 = stretch.iter().map(|l| l * l).sum();
        let density = 0.5 * material.mu * (first * j.powf(-2.0 / 3.0) - 3.0)
            + 0.25 * material.kappa * (j * j - 1.0 - 2.0 * j.ln());
        assert!((brick.energy(&x, material) - density * brick.volume).abs() < 1e-12);
    }

    #[test]
    fn an_inverted_brick_is_refused_or_infinite() {
        let (rest, x) = skewed();
        let material = Material::new(0.3, 0.45).unwrap();
        let mut flipped = x;
        flipped.swap(0, 4);
        assert_eq!(
            Brick::new(&rest).unwrap().energy(&flipped, material),
            f64::INFINITY
        );
        assert!(Brick::new(&flipped).is_err());
        assert!(Material::new(0.3, 0.5).is_err() && Material::new(f64::NAN, 0.4).is_err());
    }
}
