//! The simulator: quasi-static finite elements of a soft finger that is bent by cables.
//!
//! `mesh` builds bricks, `tetrahedra` imports cells, `element` has the data of a cell and `natural`
//! its shape functions, `material` its material, `cable` the tendons and `guide` their guides in
//! the nodes, `sparse` the linear algebra. `solid` combines them, `work` assembles and solves,
//! `newton` finds equilibria, `sweep` computes many of them and reports its `progress`, `embed`
//! carries material points, `change` is a body that differs from its description, `bend` has the
//! terms beyond linear loads. Units: mm, N, MPa (N/mm²), N·mm; gravity in multiples of g in the
//! base frame (z along the rest axis to the tip).

mod bend;
pub mod cable;
pub mod change;
mod compliance;
pub mod element;
pub mod embed;
pub mod guide;
pub mod material;
pub mod mesh;
mod moduli;
pub mod natural;
pub mod newton;
pub mod progress;
pub mod route;
pub mod solid;
pub mod sweep;
pub mod tetrahedra;
mod work;

pub use crate::algebra::Vec3;
