//! Geometry of point sets and triangle surfaces: nearest neighbours, Chamfer distance, Laplacian,
//! rigid and as-rigid-as-possible motion. Points are `Vec3` in the base frame, mm.

pub mod arap;
pub mod chamfer;
mod curve;
pub mod laplacian;
pub mod nearest;
pub mod paper;
pub mod register;
mod robust;
pub mod rotation;
pub mod start;
pub mod surface;
