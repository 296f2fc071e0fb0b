//! The simulator: quasi-static finite elements of a soft finger that is bent by cables.
//!
//! `mesh` builds bricks and `tetrahedra` takes imported cells, `element` is what a cell of
//! either kind stores and `natural` its shape functions, `material` what it is made of, `cable` the
//! tendons and `guide` their way through the nodes, `sparse` the linear algebra, `solid` puts them
//! together, `work` assembles and solves, `newton` finds equilibria, `sweep` visits many of them
//! and reports its `progress`, `embed` carries material points, `change` a body that differs from
//! its description, `bend` what is not linear in a load. Units: mm, N, MPa (N/mm²), N·mm; gravity
//! in multiples of g in the base frame (z along the rest axis to the tip).

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
