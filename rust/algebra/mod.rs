//! Linear algebra of small and of sparse systems, and of vectors in space.

pub mod complementarity;
pub(crate) mod dense;
pub mod sparse;
pub(crate) mod vector;
