//! The servo part of the robot: Dynamixel Protocol 2.0, its registers and bus, and the guard for
//! every goal.
//!
//! Only the serial port reads a clock, and only the emulator allocates after set-up.

// As tests/ name it, so that both can use `emulated_rig.rs`.
#[cfg(test)]
extern crate self as softmap_servo;

pub mod bus;
pub mod control;
pub mod crc;
pub mod decoder;
pub mod drive;
#[cfg(test)]
mod emulated_rig;
pub mod emulator;
pub mod guard;
pub mod lockstep;
pub mod opened;
pub mod packet;
pub mod registers;
pub mod serial;
pub mod timing;
pub mod urgent;
