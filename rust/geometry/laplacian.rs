//! The cotangent Laplacian of a triangle surface: w_ij = (cot α_ij + cot β_ij)/2 over the triangles
//! at an edge.
//!
//! (L f)_i = Σ_j w_ij (f_i − f_j), the stiffness of linear elements (Pinkall & Polthier 1993,
//! doi:10.1080/10586458.1993.10504266). Weights are at least `LEAST`: obtuse triangles would give
//! negative ones, and unbounded energies.

use crate::algebra::Vec3;
use crate::error::{Result, invalid};
use std::collections::BTreeMap;

/// The least weight of an edge.
pub const LEAST: f64 = 1e-3;
/// A triangle with less area than this share of its longest edge squared has no angles.
const FLAT: f64 = 1e-12;

/// The edges of a surface: the neighbours of each vertex, ascending, and their weights.
#[derive(Debug, Clone)]
pub struct Edges {
    pub starts: Vec<usize>,
    pub others: Vec<usize>,
    pub weights: Vec<f64>,
}

impl Edges {
    /// Of `triangles` (T, 3) between vertices at `rest` (N, 3).
    pub fn new(rest: &[Vec3], triangles: &[[usize; 3]]) -> Result<Edges> {
        let mut weights: BTreeMap<(usize, usize), f64> = BTreeMap::new();
        for (t, triangle) in triangles.iter().enumerate() {
            if let Some(far) = triangle.iter().find(|v| **v >= rest.len()) {
                return Err(invalid(format!(
                    "triangle {t} has the vertex {far}, of {} there are; count vertices from 0",
                    rest.len()
                )));
            }
            for corner in 0..3 {
                let [k, i, j] = std::array::from_fn(|c| triangle[(corner + c) % 3]);
                let (a, b) = (rest[i] - rest[k], rest[j] - rest[k]);
                let area = a.cross(b).length();
                if area <= FLAT * a.length_squared().max(b.length_squared()) {
                    return Err(invalid(format!(
                        "triangle {t} (vertices {triangle:?}) is flat; mend the mesh, or merge \
                        vertices that coincide"
                    )));
                }
                let half = 0.5 * a.dot(b) / area;
                *weights.entry((i, j)).or_default() += half;
                *weights.entry((j, i)).or_default() += half;
            }
        }
        let mut edges = Edges {
            starts: vec![0],
            others: Vec::with_capacity(weights.len()),
            weights: Vec::with_capacity(weights.len()),
        };
        for ((i, j), weight) in weights {
            while edges.starts.len() <= i {
                edges.starts.push(edges.others.len());
            }
            edges.others.push(j);
            edges.weights.push(weight.max(LEAST));
        }
        edges.starts.resize(rest.len() + 1, edges.others.len());
        Ok(edges)
    }

    /// Number of vertices N.
    pub fn len(&self) -> usize {
        self.starts.len() - 1
    }

    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The neighbours of a vertex with the weights of their edges.
    pub fn of(&self, vertex: usize) -> impl Iterator<Item = (usize, f64)> + '_ {
        let range = self.starts[vertex]..self.starts[vertex + 1];
        let others = self.others[range.clone()].iter().copied();
        others.zip(self.weights[range].iter().copied())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_right_triangles_of_a_square_have_ones_on_the_sides_and_nothing_across() {
        let rest = [
            Vec3::new(0.0, 0.0, 0.0),
            Vec3::new(1.0, 0.0, 0.0),
            Vec3::new(1.0, 1.0, 0.0),
            Vec3::new(0.0, 1.0, 0.0),
        ];
        let edges = Edges::new(&rest, &[[0, 1, 2], [0, 2, 3]]).unwrap();
        let of_first: Vec<_> = edges.of(0).collect();
        assert_eq!(edges.len(), 4);
        // Each side is opposite one angle of 45°, the diagonal opposite two of 90°.
        assert_eq!(of_first.iter().map(|e| e.0).collect::<Vec<_>>(), [1, 2, 3]);
        for ((_, weight), wanted) in of_first.iter().zip([0.5, LEAST, 0.5]) {
            assert!((weight - wanted).abs() < 1e-12);
        }
    }

    #[test]
    fn flat_triangles_and_vertices_that_are_not_there_are_refused() {
        let rest = [
            Vec3::ZERO,
            Vec3::new(1.0, 0.0, 0.0),
            Vec3::new(2.0, 0.0, 0.0),
        ];
        assert!(Edges::new(&rest, &[[0, 1, 2]]).is_err());
        assert!(Edges::new(&rest, &[[0, 1, 3]]).is_err());
        assert_eq!(Edges::new(&rest, &[]).unwrap().len(), 3);
    }
}
