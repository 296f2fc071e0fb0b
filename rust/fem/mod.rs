//! The simulator: quasi-static finite elements of a soft finger that is bent by cables.
//!
//! `mesh` builds the solid's bricks, `brick` is the material, `cable` the tendons, `sparse` the linear algebra,
//! `solid` puts them together, `work` assembles and solves, `newton` finds equilibria, `sweep` visits many of them,
//! `embed` carries material points.
//! Units: mm, N, MPa (N/mm²), N·mm; gravity in multiples of g in the base frame (z along the rest axis to the tip).

pub mod brick;
pub mod cable;
pub mod embed;
pub mod mesh;
pub mod newton;
pub mod solid;
pub mod sparse;
pub mod sweep;
mod work;

/// A point or vector in the base frame.
pub type Vec3 = [f64; 3];

pub(crate) fn dot(a: Vec3, b: Vec3) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

pub(crate) fn sub(a: Vec3, b: Vec3) -> Vec3 {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

pub(crate) fn norm(a: Vec3) -> f64 {
    dot(a, a).sqrt()
}

/// `a + s b`
pub(crate) fn axpy(a: Vec3, s: f64, b: Vec3) -> Vec3 {
    [a[0] + s * b[0], a[1] + s * b[1], a[2] + s * b[2]]
}
