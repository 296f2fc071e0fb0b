//! The route of a tendon: by a formula of height, or by points. Units: mm, rad.

use super::Vec3;
use super::mesh::radius_at;

/// Largest distance of a formula's guides in a mesh without layers, as a part of the height.
const SPACING: f64 = 0.04;

/// The route of a tendon, from the base to its anchor.
#[derive(Debug, Clone)]
pub enum Route {
    /// `(z, radius)` pairs, z ascending, at an angle about z that turns uniformly with z by `turn`
    /// on the full length.
    Formula {
        angle: f64,
        turn: f64,
        path: Vec<[f64; 2]>,
    },
    /// Guides in order.
    Points(Vec<Vec3>),
}

impl Route {
    /// The same route turned about z by an angle, rad.
    pub fn turned(&self, by: f64) -> Route {
        match self {
            Route::Formula { angle, turn, path } => Route::Formula {
                angle: angle + by,
                turn: *turn,
                path: path.clone(),
            },
            Route::Points(points) => {
                let (s, c) = by.sin_cos();
                let turn = |p: &Vec3| Vec3::new(c * p[0] - s * p[1], s * p[0] + c * p[1], p[2]);
                Route::Points(points.iter().map(turn).collect())
            }
        }
    }

    /// Heights of the first guide and the anchor.
    pub fn ends(&self) -> Option<(f64, f64)> {
        match self {
            Route::Formula { path, .. } => Some((path.first()?[0], path.last()?[0])),
            Route::Points(points) => Some((points.first()?[2], points.last()?[2])),
        }
    }

    fn heights(&self) -> Vec<f64> {
        match self {
            Route::Formula { path, .. } => path.iter().map(|p| p[0]).collect(),
            Route::Points(points) => points.iter().map(|p| p[2]).collect(),
        }
    }

    pub(super) fn ascends(&self) -> bool {
        let z = self.heights();
        z.len() >= 2 && z.windows(2).all(|w| w[1] > w[0])
    }

    /// The point of an ascending route at a height.
    pub(super) fn at(&self, z: f64) -> [f64; 2] {
        match self {
            Route::Formula { angle, turn, path } => {
                let (r, first, last) = (radius_at(path, z), path[0][0], path[path.len() - 1][0]);
                let angle = angle + turn * (z - first) / (last - first);
                [r * angle.cos(), r * angle.sin()]
            }
            Route::Points(points) => {
                let along = |i: usize| points.iter().map(|p| [p[2], p[i]]).collect::<Vec<_>>();
                [radius_at(&along(0), z), radius_at(&along(1), z)]
            }
        }
    }

    /// The positions of the guides in a mesh of this height.
    pub(super) fn places(&self, height: f64) -> Vec<Vec3> {
        match self {
            Route::Points(points) => points.clone(),
            Route::Formula { path, .. } => {
                let (first, last) = (path[0][0], path[path.len() - 1][0]);
                let count = ((last - first) / (SPACING * height)).ceil().clamp(1.0, 1e3) as usize;
                let z = |k: usize| first + (last - first) * k as f64 / count as f64;
                let place = |k: usize| {
                    let [x, y] = self.at(z(k));
                    Vec3::new(x, y, z(k))
                };
                (0..=count).map(place).collect()
            }
        }
    }
}
