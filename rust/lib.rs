//! The compiled core of SOFTMAP-Edge: whatever loops over vertices, time steps or candidates.
//!
//! Nothing here knows Python except the `python` module, which only converts and forwards.

#[cfg(test)]
mod allocations;
pub mod answer;
mod cables;
pub mod complementarity;
pub mod contact;
pub mod control;
mod cubic;
mod dense;
pub mod effects;
pub mod error;
pub mod families;
pub mod fem;
pub mod fields;
pub mod geometry;
mod grid;
pub mod inverse;
pub mod loads;
pub mod modes;
pub mod network;
pub mod predict;
pub mod projected;
#[cfg(feature = "python")]
mod python;
pub mod rod;
mod room;
pub mod scattered;
pub mod second;
pub mod shape;
pub mod sparse;
pub mod table;
mod vector;

pub use error::{Error, Result};
