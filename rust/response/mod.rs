//! The response of a body to loads: fields of its prior, slack cables, contact, second-order terms.

pub mod answer;
pub(crate) mod cables;
pub mod contact;
pub mod fields;
pub mod loads;
pub mod second_order;
