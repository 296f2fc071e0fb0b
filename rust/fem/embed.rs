//! Material points carried by a solid: the points of one mesh on another.
//!
//! A point is bound at rest to the cell that contains it by its natural coordinates (Newton's
//! method on the cell's map). Meshes of one finger differ by their facets: a point up to
//! `tolerance` mm outside is extrapolated, a farther one rejected.

use super::Vec3;
use super::mesh::Mesh;
use super::natural::{Kind, MOST_NODES};
use crate::error::{Result, invalid};
use rayon::prelude::*;

/// Cells tried around a point, nearest centre first; tetrahedra differ more in size.
fn candidates(kind: Kind) -> usize {
    match kind {
        Kind::Brick => 24,
        Kind::Tetrahedron => 120,
    }
}

/// Points as weighted sums of nodes.
#[derive(Debug, Clone)]
pub struct Points {
    pub weights: Vec<Vec<(usize, f64)>>,
}

impl Points {
    /// The mesh's own surface vertices.
    pub fn surface(mesh: &Mesh) -> Points {
        Points {
            weights: mesh.surface.iter().map(|&n| vec![(n, 1.0)]).collect(),
        }
    }

    /// Points bound at rest; rejected if farther than `tolerance` mm outside.
    pub fn embedded(mesh: &Mesh, points: &[Vec3], tolerance: f64) -> Result<Points> {
        let finder = Finder::new(mesh);
        let weights = points
            .par_iter()
            .enumerate()
            .map(|(index, &p)| {
                let (cell, xi, outside) = finder.nearest(p);
                if outside.is_nan() || outside > tolerance {
                    return Err(invalid(format!(
                        "template vertex {index} at {p:.2} mm lies {outside:.2} mm outside the \
                        solid (allowed {tolerance} mm); the template must belong to this finger's \
                        shape"
                    )));
                }
                let nodes = &finder.cells[cell];
                Ok(nodes.iter().copied().zip(mesh.kind.shape(xi).0).collect())
            })
            .collect::<Result<_>>()?;
        Ok(Points { weights })
    }

    /// Places of the points for node places.
    pub fn place(&self, x: &[Vec3]) -> Vec<Vec3> {
        self.weights
            .iter()
            .map(|w| w.iter().map(|&(n, s)| s * x[n]).sum())
            .collect()
    }
}

/// Finds the cell that contains a position of the rest configuration.
pub(super) struct Finder<'a> {
    mesh: &'a Mesh,
    cells: Vec<&'a [usize]>,
    centres: Vec<Vec3>,
}

impl<'a> Finder<'a> {
    pub fn new(mesh: &'a Mesh) -> Finder<'a> {
        let cells: Vec<&[usize]> = mesh.each_cell().collect();
        let (corners, count) = (mesh.kind.corners(), mesh.kind.corners() as f64);
        let centre = |cell: &&[usize]| {
            let corners = cell[..corners].iter().map(|&n| mesh.nodes[n]);
            corners.sum::<Vec3>() / count
        };
        Finder {
            mesh,
            centres: cells.iter().map(centre).collect(),
            cells,
        }
    }

    /// Cell, natural coordinates and distance outside (mm) of the best cell for a point.
    pub fn nearest(&self, p: Vec3) -> (usize, Vec3, f64) {
        let kind = self.mesh.kind;
        let mut order: Vec<usize> = (0..self.cells.len()).collect();
        let far = |b: usize| self.centres[b].distance(p);
        let count = candidates(kind).min(order.len());
        if count < order.len() {
            order.select_nth_unstable_by(count, |&a, &b| far(a).total_cmp(&far(b)));
        }
        let mut best = (0, Vec3::ZERO, f64::INFINITY);
        for &b in &order[..count] {
            let mut nodes = [Vec3::ZERO; MOST_NODES];
            for (at, &n) in nodes.iter_mut().zip(self.cells[b]) {
                *at = self.mesh.nodes[n];
            }
            if let Some(xi) = kind.natural(&nodes, p) {
                let inside = kind.inside(xi);
                let outside = if inside == xi {
                    0.0
                } else {
                    kind.place(&nodes, inside).0.distance(p)
                };
                if outside < best.2 {
                    best = (b, xi, outside);
                }
            }
        }
        best
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fem::mesh::{Resolution, finger};

    const PROFILE: [[f64; 2]; 2] = [[0.0, 12.0], [60.0, 8.0]];

    #[test]
    fn points_of_one_mesh_follow_a_linear_field_on_another() {
        let one = finger(
            &PROFILE,
            &[],
            Resolution {
                core: 3,
                rings: 1,
                layers: 12,
            },
        )
        .unwrap();
        let other = finger(
            &PROFILE,
            &[],
            Resolution {
                core: 4,
                rings: 2,
                layers: 9,
            },
        )
        .unwrap();
        let points: Vec<Vec3> = one.surface.iter().map(|&n| one.nodes[n]).collect();
        let bound = Points::embedded(&other, &points, 1.0).unwrap();
        let field =
            |p: &Vec3| Vec3::new(p[0] + 0.1 * p[2], 1.2 * p[1] - 0.3 * p[0], 0.9 * p[2] + 3.0);
        let moved = bound.place(&other.nodes.iter().map(field).collect::<Vec<_>>());
        for (p, q) in points.iter().zip(moved) {
            // Trilinear bricks carry a linear field exactly, inside and outside.
            assert!(field(p).distance(q) < 1e-9);
        }
    }

    #[test]
    fn points_far_outside_are_refused() {
        let mesh = finger(
            &PROFILE,
            &[],
            Resolution {
                core: 2,
                rings: 1,
                layers: 6,
            },
        )
        .unwrap();
        assert!(Points::embedded(&mesh, &[Vec3::new(11.0, 0.0, 5.0)], 1.0).is_ok());
        assert!(Points::embedded(&mesh, &[Vec3::new(16.0, 0.0, 5.0)], 1.0).is_err());
        assert!(Points::embedded(&mesh, &[Vec3::new(f64::NAN, 0.0, 5.0)], 1.0).is_err());
    }
}
