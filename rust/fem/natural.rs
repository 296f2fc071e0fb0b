//! Natural coordinates of a cell: shape functions, Gauss points, edges and faces of 8-node bricks
//! and 10-node tetrahedra.
//!
//! A brick's coordinates run over [−1, 1]³, its functions are trilinear. A tetrahedron's are three
//! of its four barycentric coordinates L₁, L₂, L₃ (L₀ = 1 − L₁ − L₂ − L₃), its functions the
//! quadratic Lᵢ(2Lᵢ − 1) at corners and 4LᵢLⱼ at mid-edges (Zienkiewicz & Taylor, The Finite
//! Element Method, ch. 4), in the order of VTK: corners, then the edges of `EDGES`.

use super::Vec3;
use crate::algebra::{Mat3, outer};

/// Nodes of the largest cell.
pub const MOST_NODES: usize = 10;
/// Corners of each mid-edge node of a tetrahedron.
pub const EDGES: [[usize; 2]; 6] = [[0, 1], [1, 2], [2, 0], [0, 3], [1, 3], [2, 3]];

const CORNERS: [[f64; 3]; 8] = [
    [-1., -1., -1.],
    [1., -1., -1.],
    [1., 1., -1.],
    [-1., 1., -1.],
    [-1., -1., 1.],
    [1., -1., 1.],
    [1., 1., 1.],
    [-1., 1., 1.],
];
/// Slopes of the barycentric coordinates.
const SLOPES: [Vec3; 4] = [Vec3::NEG_ONE, Vec3::X, Vec3::Y, Vec3::Z];

/// The kind of cells of a mesh.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    Brick,
    Tetrahedron,
}

impl Kind {
    /// Nodes of a cell.
    pub fn nodes(self) -> usize {
        match self {
            Kind::Brick => 8,
            Kind::Tetrahedron => 10,
        }
    }

    /// Corners of a cell; they are its first nodes.
    pub fn corners(self) -> usize {
        match self {
            Kind::Brick => 8,
            Kind::Tetrahedron => 4,
        }
    }

    /// Corners of the faces, seen from outside counter-clockwise.
    pub fn faces(self) -> &'static [&'static [usize]] {
        match self {
            Kind::Brick => &[
                &[0, 3, 2, 1],
                &[4, 5, 6, 7],
                &[0, 1, 5, 4],
                &[1, 2, 6, 5],
                &[2, 3, 7, 6],
                &[3, 0, 4, 7],
            ],
            Kind::Tetrahedron => &[&[0, 2, 1], &[0, 1, 3], &[1, 2, 3], &[2, 0, 3]],
        }
    }

    /// Gauss points and their weight: 2×2×2 in a brick, four of degree 2 in a tetrahedron.
    pub fn points(self) -> (Vec<Vec3>, f64) {
        match self {
            Kind::Brick => {
                let g = 1.0 / 3f64.sqrt();
                let sign = |q: usize, bit: usize| if q >> bit & 1 == 1 { g } else { -g };
                (
                    (0..8)
                        .map(|q| Vec3::new(sign(q, 0), sign(q, 1), sign(q, 2)))
                        .collect(),
                    1.0,
                )
            }
            Kind::Tetrahedron => {
                let near = (5.0 + 3.0 * 5f64.sqrt()) / 20.0;
                let far = (5.0 - 5f64.sqrt()) / 20.0;
                let at = |q: usize| [1, 2, 3].map(|i| if q == i { near } else { far });
                ((0..4).map(|q| at(q).into()).collect(), 1.0 / 24.0)
            }
        }
    }

    /// The start of a search for natural coordinates.
    pub fn centre(self) -> Vec3 {
        match self {
            Kind::Brick => Vec3::ZERO,
            Kind::Tetrahedron => Vec3::splat(0.25),
        }
    }

    /// Coordinates inside the cell: unchanged if inside, else about the nearest.
    pub fn inside(self, xi: Vec3) -> Vec3 {
        match self {
            Kind::Brick => xi.map(|v| v.clamp(-1.0, 1.0)),
            Kind::Tetrahedron => {
                let l = [1.0 - xi[0] - xi[1] - xi[2], xi[0], xi[1], xi[2]];
                if l.iter().all(|&v| v >= -1e-9) {
                    return xi;
                }
                let positive = l.map(|v| v.max(0.0));
                let sum: f64 = positive.iter().sum();
                Vec3::new(positive[1], positive[2], positive[3]) / sum
            }
        }
    }

    /// Shape functions and their derivatives; a brick uses the first eight.
    pub fn shape(self, xi: Vec3) -> ([f64; MOST_NODES], [Vec3; MOST_NODES]) {
        let (mut value, mut slope) = ([0.0; MOST_NODES], [Vec3::ZERO; MOST_NODES]);
        match self {
            Kind::Brick => {
                for (a, c) in CORNERS.into_iter().map(Vec3::from).enumerate() {
                    let f = 1.0 + c * xi;
                    value[a] = 0.125 * f[0] * f[1] * f[2];
                    slope[a] = 0.125 * c * Vec3::new(f[1] * f[2], f[0] * f[2], f[0] * f[1]);
                }
            }
            Kind::Tetrahedron => {
                let l = [1.0 - xi[0] - xi[1] - xi[2], xi[0], xi[1], xi[2]];
                for a in 0..4 {
                    value[a] = l[a] * (2.0 * l[a] - 1.0);
                    slope[a] = (4.0 * l[a] - 1.0) * SLOPES[a];
                }
                for (e, &[i, j]) in EDGES.iter().enumerate() {
                    value[4 + e] = 4.0 * l[i] * l[j];
                    slope[4 + e] = 4.0 * l[j] * SLOPES[i] + 4.0 * l[i] * SLOPES[j];
                }
            }
        }
        (value, slope)
    }

    /// Place and Jacobian dx/dξ (rows x, columns ξ) of a cell with these nodes at natural
    /// coordinates.
    pub fn place(self, nodes: &[Vec3], xi: Vec3) -> (Vec3, Mat3) {
        let (value, slope) = self.shape(xi);
        let (mut x, mut jacobian) = (Vec3::ZERO, Mat3::ZERO);
        for a in 0..self.nodes() {
            x += value[a] * nodes[a];
            jacobian += outer(nodes[a], slope[a]);
        }
        (x, jacobian)
    }

    /// Natural coordinates of a point near a cell, by Newton's method on its map.
    pub fn natural(self, nodes: &[Vec3], p: Vec3) -> Option<Vec3> {
        let mut xi = self.centre();
        for _ in 0..30 {
            let (x, jacobian) = self.place(nodes, xi);
            let step = jacobian.inverse() * (p - x);
            xi = (xi + step).map(|v| v.clamp(-4.0, 4.0));
            if step.length() < 1e-13 {
                break;
            }
        }
        let settled = self.place(nodes, xi).0.distance(p) < 1e-9;
        settled.then_some(xi)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn functions_are_one_at_their_node_sum_to_one_and_slope_as_differences_do() {
        for kind in [Kind::Brick, Kind::Tetrahedron] {
            let corners: Vec<Vec3> = match kind {
                Kind::Brick => CORNERS.map(Vec3::from).to_vec(),
                Kind::Tetrahedron => {
                    let c = [Vec3::ZERO, SLOPES[1], SLOPES[2], SLOPES[3]];
                    let mid = |e: &[usize; 2]| 0.5 * (c[e[0]] + c[e[1]]);
                    c.iter().copied().chain(EDGES.iter().map(mid)).collect()
                }
            };
            for (n, &at) in corners.iter().enumerate() {
                let value = kind.shape(at).0;
                for a in 0..kind.nodes() {
                    assert!((value[a] - f64::from(a == n)).abs() < 1e-14);
                }
                assert!(kind.place(&corners, at).0.distance(at) < 1e-14);
            }
            let (xi, h) = (Vec3::new(0.21, 0.33, 0.17), 1e-6);
            let slope = kind.shape(xi).1;
            assert!((kind.shape(xi).0.iter().sum::<f64>() - 1.0).abs() < 1e-14);
            for i in 0..3 {
                let at = |s: f64| {
                    let mut y = xi;
                    y[i] += s * h;
                    kind.shape(y).0
                };
                for a in 0..kind.nodes() {
                    let numeric = (at(1.0)[a] - at(-1.0)[a]) / (2.0 * h);
                    assert!((numeric - slope[a][i]).abs() < 1e-9);
                }
            }
            let found = kind.natural(&corners, xi).unwrap();
            assert!(found.distance(xi) < 1e-12 && kind.inside(found) == found);
            let (points, weight) = kind.points();
            // The rules integrate a quadratic exactly: ∫ x² is 8/3 over the brick and 1/60 over the
            // tetrahedron.
            let square: f64 = points.iter().map(|p| weight * p[0] * p[0]).sum();
            let exact = if kind == Kind::Brick {
                8.0 / 3.0
            } else {
                1.0 / 60.0
            };
            assert!((square - exact).abs() < 1e-15);
        }
    }
}
