//! Linear algebra of small and of sparse systems, and of vectors in space.

pub mod complementarity;
pub(crate) mod dense;
pub mod sparse;

pub use glam::{DMat3 as Mat3, DVec3 as Vec3};

/// `a bᵀ`
#[inline(always)]
pub(crate) fn outer(a: Vec3, b: Vec3) -> Mat3 {
    Mat3::from_cols(b.x * a, b.y * a, b.z * a)
}
