//! The servo side of the robot: Dynamixel Protocol 2.0, its registers and bus, and the guard that every goal passes.
//!
//! No clock is read here and, once set up, nothing is allocated: whoever runs the loop brings the time.

pub mod crc;
pub mod decoder;
pub mod guard;
pub mod packet;
pub mod registers;
