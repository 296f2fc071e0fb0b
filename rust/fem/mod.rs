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

pub use crate::vector::Vec3;
pub(crate) use crate::vector::{axpy, dot, norm, sub};
