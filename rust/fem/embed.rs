//! Material points carried by a solid: where the points of one mesh go on another.
//!
//! A point is bound at rest to the brick that holds it by its natural coordinates (Newton's method on the trilinear map).
//! Meshes of one finger differ by their facets: a point up to `tolerance` mm outside is extrapolated, farther is refused.

use super::mesh::{Mesh, brick_place, shape};
use super::{Vec3, norm, sub};
use crate::error::{Result, invalid};

/// Bricks tried around a point, nearest first.
const CANDIDATES: usize = 24;

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

    /// Points bound at rest; refused when farther than `tolerance` mm outside.
    pub fn embedded(mesh: &Mesh, points: &[Vec3], tolerance: f64) -> Result<Points> {
        let centres: Vec<Vec3> = mesh
            .bricks
            .iter()
            .map(|b| {
                std::array::from_fn(|i| b.iter().map(|&n| mesh.nodes[n][i]).sum::<f64>() / 8.0)
            })
            .collect();
        let weights = points
            .iter()
            .enumerate()
            .map(|(index, &p)| {
                let (brick, xi, outside) = nearest(mesh, &centres, p);
                if outside.is_nan() || outside > tolerance {
                    return Err(invalid(format!(
                        "template vertex {index} at {p:.2?} mm lies {outside:.2} mm outside the solid (allowed {tolerance} mm); the template must belong to this finger's shape"
                    )));
                }
                Ok(mesh.bricks[brick].iter().copied().zip(shape(xi).0).collect())
            })
            .collect::<Result<_>>()?;
        Ok(Points { weights })
    }

    /// Places of the points for node places.
    pub fn place(&self, x: &[Vec3]) -> Vec<Vec3> {
        self.weights
            .iter()
            .map(|w| {
                w.iter()
                    .fold([0.0; 3], |p, &(n, s)| super::axpy(p, s, x[n]))
            })
            .collect()
    }
}

/// Brick, natural coordinates and distance outside (mm) of the brick that fits a point best.
fn nearest(mesh: &Mesh, centres: &[Vec3], p: Vec3) -> (usize, Vec3, f64) {
    let mut order: Vec<usize> = (0..centres.len()).collect();
    let far = |b: usize| norm(sub(centres[b], p));
    let count = CANDIDATES.min(order.len());
    if count < order.len() {
        order.select_nth_unstable_by(count, |&a, &b| far(a).total_cmp(&far(b)));
    }
    let mut best = (0, [0.0; 3], f64::INFINITY);
    for &b in &order[..count] {
        let corners = mesh.bricks[b].map(|n| mesh.nodes[n]);
        if let Some(xi) = natural(&corners, p) {
            let inside = xi.map(|v| v.clamp(-1.0, 1.0));
            let outside = if inside == xi {
                0.0
            } else {
                norm(sub(brick_place(&corners, inside).0, p))
            };
            if outside < best.2 {
                best = (b, xi, outside);
            }
        }
    }
    best
}

/// Natural coordinates of a point near a brick.
fn natural(corners: &[Vec3; 8], p: Vec3) -> Option<Vec3> {
    let mut xi = [0.0; 3];
    for _ in 0..30 {
        let (x, jacobian) = brick_place(corners, xi);
        let gap = sub(p, x);
        let (cofactor, det) = super::brick::cofactor(&jacobian);
        // J⁻¹ is the transposed cofactor over the determinant.
        let step: Vec3 =
            std::array::from_fn(|i| (0..3).map(|k| cofactor[k][i] * gap[k]).sum::<f64>() / det);
        for i in 0..3 {
            xi[i] = (xi[i] + step[i]).clamp(-4.0, 4.0);
        }
        if norm(step) < 1e-13 {
            break;
        }
    }
    let settled = norm(sub(brick_place(corners, xi).0, p)) < 1e-9;
    settled.then_some(xi)
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
        let field = |p: &Vec3| [p[0] + 0.1 * p[2], 1.2 * p[1] - 0.3 * p[0], 0.9 * p[2] + 3.0];
        let moved = bound.place(&other.nodes.iter().map(field).collect::<Vec<_>>());
        for (p, q) in points.iter().zip(moved) {
            // Trilinear bricks carry a linear field exactly, inside and outside.
            assert!(norm(sub(field(p), q)) < 1e-9);
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
        assert!(Points::embedded(&mesh, &[[11.0, 0.0, 5.0]], 1.0).is_ok());
        assert!(Points::embedded(&mesh, &[[16.0, 0.0, 5.0]], 1.0).is_err());
        assert!(Points::embedded(&mesh, &[[f64::NAN, 0.0, 5.0]], 1.0).is_err());
    }
}
