//! The nearest point of a triangle surface: parry's bounding tree, refitted as the vertices move.
//! mm.

use crate::algebra::Vec3;
use crate::error::{Result, invalid};
use parry3d_f64::query::{PointQueryWithLocation, Ray, RayCast};
use parry3d_f64::shape::TriMesh;

/// Offset of a ray's start from the surface, mm, so its own triangle does not block it.
const OFF: f64 = 1e-3;

/// Views for the visibility of triangles: directions about z, at these elevations, rad.
const AROUND: usize = 24;
const ABOVE: [f64; 3] = [0.02, 0.5, 1.0];

/// The point of a surface nearest to a point.
#[derive(Debug, Clone, Copy)]
pub struct Foot {
    pub triangle: usize,
    /// Weights of the three corners; their sum is 1.
    pub weights: [f64; 3],
    pub place: Vec3,
    pub distance: f64,
}

/// A triangle surface that can move.
pub struct Surface {
    mesh: TriMesh,
}

impl Surface {
    /// Of `triangles` (T, 3) between vertices at `places` (N, 3).
    pub fn new(places: &[Vec3], triangles: &[[usize; 3]]) -> Result<Surface> {
        if let Some(t) = triangles
            .iter()
            .position(|t| t.iter().any(|v| *v >= places.len()))
        {
            return Err(invalid(format!(
                "triangle {t} {:?} names a vertex of {} there are; count vertices from 0",
                triangles[t],
                places.len()
            )));
        }
        if let Some(i) = places.iter().position(|p| !p.is_finite()) {
            return Err(invalid(format!("vertex {i} is not finite; mend the mesh")));
        }
        let corners = triangles.iter().map(|t| t.map(|v| v as u32)).collect();
        let mesh = TriMesh::new(places.to_vec(), corners)
            .map_err(|why| invalid(format!("no surface: {why}; give one triangle or more")))?;
        Ok(Surface { mesh })
    }

    /// Move the vertices to `places` (N, 3).
    pub fn move_to(&mut self, places: &[Vec3]) {
        self.mesh
            .update_vertices(|vertices| vertices.copy_from_slice(places));
    }

    /// The vertices of a triangle.
    pub fn corners(&self, triangle: usize) -> [usize; 3] {
        self.mesh.indices()[triangle].map(|v| v as usize)
    }

    /// The unit normal of a triangle by the order of its corners; 0 of a flat one.
    pub fn normal(&self, triangle: usize) -> Vec3 {
        let [a, b, c] = self.corners(triangle).map(|v| self.mesh.vertices()[v]);
        let normal = (b - a).cross(c - a);
        1.0 / normal.length().max(f64::MIN_POSITIVE) * normal
    }

    /// Whether the surface does not occlude one of its points from an eye; `normal` points outward
    /// there.
    pub fn sees(&self, eye: Vec3, place: Vec3, normal: Vec3) -> bool {
        let towards = eye - place;
        if towards.dot(normal) <= 0.0 {
            return false;
        }
        let from = place + OFF * normal;
        let ray = Ray::new(from, eye - from);
        !self.mesh.intersects_local_ray(&ray, 1.0)
    }

    /// The triangles visible from the side or above (z), from far away, for any order of their
    /// corners: not the walls of a cavity, nor the bottom. All, if none is visible.
    pub fn shown(&self) -> Vec<usize> {
        let looks: Vec<Vec3> = (0..AROUND)
            .flat_map(|k| ABOVE.map(|up| (k as f64 / AROUND as f64 * std::f64::consts::TAU, up)))
            .map(|(turn, up)| Vec3::new(turn.cos() * up.cos(), turn.sin() * up.cos(), up.sin()))
            .collect();
        let sees = |middle: Vec3, look: &Vec3| {
            let ray = Ray::new(middle + OFF * look, *look);
            !self.mesh.intersects_local_ray(&ray, f64::MAX)
        };
        let count = self.mesh.indices().len();
        let found: Vec<usize> = (0..count)
            .filter(|t| {
                let corners = self.corners(*t).map(|v| self.mesh.vertices()[v]);
                let middle = corners.iter().sum::<Vec3>() / 3.0;
                looks.iter().any(|look| sees(middle, look))
            })
            .collect();
        if found.is_empty() {
            (0..count).collect()
        } else {
            found
        }
    }

    /// The point nearest to a given point.
    pub fn foot(&self, of: Vec3) -> Foot {
        let (found, (triangle, location)) =
            self.mesh.project_local_point_and_get_location(of, false);
        let place = found.point;
        Foot {
            triangle: triangle as usize,
            weights: location.barycentric_coordinates().unwrap_or([1.0 / 3.0; 3]),
            place,
            distance: of.distance(place),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const SQUARE: [Vec3; 4] = [
        Vec3::ZERO,
        Vec3::new(2.0, 0.0, 0.0),
        Vec3::new(2.0, 2.0, 0.0),
        Vec3::new(0.0, 2.0, 0.0),
    ];

    #[test]
    fn feet_lie_on_faces_edges_and_corners_and_follow_the_surface() {
        let mut surface = Surface::new(&SQUARE, &[[0, 1, 2], [0, 2, 3]]).unwrap();
        for (of, place) in [
            ([1.5, 0.5, 3.0], [1.5, 0.5, 0.0]),
            ([1.0, -4.0, 3.0], [1.0, 0.0, 0.0]),
            ([5.0, 6.0, 0.0], [2.0, 2.0, 0.0]),
        ]
        .map(|(of, place)| (Vec3::from(of), Vec3::from(place)))
        {
            let foot = surface.foot(of);
            assert!(foot.place.distance(place) < 1e-12);
            assert!((foot.distance - of.distance(place)).abs() < 1e-12);
            let mut there = Vec3::ZERO;
            for (v, w) in surface.corners(foot.triangle).iter().zip(foot.weights) {
                there += w * SQUARE[*v];
            }
            assert!(there.distance(place) < 1e-12);
        }
        assert_eq!(surface.normal(0), Vec3::Z);
        surface.move_to(&SQUARE.map(|p| p + 7.0 * Vec3::Z));
        assert!((surface.foot(Vec3::new(1.5, 0.5, 3.0)).distance - 4.0).abs() < 1e-12);
    }

    proptest! {
        #[test]
        fn no_place_of_the_surface_is_nearer(p in [-3.0..5.0f64, -3.0..5.0, -2.0..2.0], w in [0.0..1.0f64, 0.0..1.0]) {
            let bent = [[0.0; 3], [2.0, 0.0, 0.4], [2.0, 2.0, -0.3], [0.0, 2.0, 0.5]].map(Vec3::from);
            let surface = Surface::new(&bent, &[[0, 1, 2], [0, 2, 3]]).unwrap();
            let p = Vec3::from(p);
            let foot = surface.foot(p);
            for t in 0..2 {
                let [a, b, c] = surface.corners(t).map(|v| bent[v]);
                let (s, r) = (w[0].min(1.0 - w[1]), w[1]);
                let at = a + s * (b - a) + r * (c - a);
                prop_assert!(foot.distance <= p.distance(at) + 1e-9);
            }
        }
    }

    #[test]
    fn what_stands_in_the_way_hides_what_is_behind() {
        let two = [SQUARE, SQUARE.map(|p| p + 3.0 * Vec3::Z)].concat();
        let surface = Surface::new(&two, &[[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]]).unwrap();
        let sees = |eye: [f64; 3], place: [f64; 3]| surface.sees(eye.into(), place.into(), Vec3::Z);
        assert!(!sees([1.0, 0.5, 50.0], [1.0, 0.5, 0.0]));
        assert!(sees([1.0, 0.5, 50.0], [1.0, 0.5, 3.0]));
        assert!(sees([50.0, 0.5, 1.0], [1.5, 0.5, 0.0]));
        assert!(!sees([1.0, 0.5, -50.0], [1.0, 0.5, 0.0]));
    }

    #[test]
    fn the_walls_of_a_cavity_are_not_shown_whichever_way_they_are_turned() {
        let corner = |size: f64, k: usize| {
            let bits = [k & 1, k >> 1 & 1, k >> 2].map(|b| b as f64);
            size * (Vec3::from(bits) - 0.5)
        };
        let places: Vec<Vec3> = [4.0, 2.0]
            .iter()
            .flat_map(|size| (0..8).map(move |k| corner(*size, k)))
            .collect();
        let faces = [
            [0, 1, 3, 2],
            [4, 5, 7, 6],
            [0, 1, 5, 4],
            [2, 3, 7, 6],
            [0, 2, 6, 4],
            [1, 3, 7, 5],
        ];
        let triangles: Vec<[usize; 3]> = [0, 8]
            .iter()
            .flat_map(|o| faces.map(|f| f.map(|v| v + o)))
            .flat_map(|[a, b, c, d]| [[a, b, c], [a, d, c]])
            .collect();
        let surface = Surface::new(&places, &triangles).unwrap();
        // 0 and 1 are the side on which it stands
        assert_eq!(surface.shown(), (2..12).collect::<Vec<_>>());
        let alone = Surface::new(&places, &triangles[..2]).unwrap();
        assert_eq!(alone.shown(), [0, 1]);
    }

    #[test]
    fn a_surface_of_nothing_is_refused() {
        assert!(Surface::new(&SQUARE, &[]).is_err());
        assert!(Surface::new(&SQUARE, &[[0, 1, 9]]).is_err());
        assert!(Surface::new(&[Vec3::NAN; 3], &[[0, 1, 2]]).is_err());
    }
}
