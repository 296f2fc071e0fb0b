//! The compiled core of SOFTMAP-Edge: whatever loops over vertices, time steps or candidates.
//!
//! Only the `python` module depends on Python; it converts and forwards.

#[cfg(test)]
mod allocations;

pub mod algebra;
pub mod control;
pub mod effects;
pub mod error;
pub mod families;
pub mod fem;
pub mod geometry;
pub mod inverse;
mod memory;
pub mod network;
pub mod predict;
#[cfg(feature = "python")]
mod python;
pub mod response;
pub mod rod;
pub mod shape;

pub use error::{Error, Result};
