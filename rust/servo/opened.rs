//! A port by its path: a serial one, or a socket of simulated servos.

use std::fs::metadata;
use std::os::unix::fs::FileTypeExt;

use crate::bus::{Port, PortFault};
use crate::lockstep::Lockstep;
use crate::serial::{OpenFault, Serial};

/// An open port.
pub enum Opened {
    Serial(Serial),
    Simulated(Lockstep),
}

impl Opened {
    /// Open what stands at `path` at `baud`.
    pub fn open(path: &str, baud: u32) -> Result<Opened, OpenFault> {
        if metadata(path).is_ok_and(|found| found.file_type().is_socket()) {
            Lockstep::open(path, baud).map(Opened::Simulated)
        } else {
            Serial::open(path, baud).map(Opened::Serial)
        }
    }

    /// Whether its clock is that of simulated servos.
    pub fn simulated(&self) -> bool {
        matches!(self, Opened::Simulated(_))
    }
}

macro_rules! either {
    ($port:expr, $name:ident($($given:expr),*)) => {
        match $port {
            Opened::Serial(port) => port.$name($($given),*),
            Opened::Simulated(port) => port.$name($($given),*),
        }
    };
}

impl Port for Opened {
    fn now(&self) -> u64 {
        either!(self, now())
    }

    fn wait(&mut self, until: u64) {
        either!(self, wait(until))
    }

    fn send(&mut self, bytes: &[u8], until: u64) -> Result<(), PortFault> {
        either!(self, send(bytes, until))
    }

    fn receive(&mut self, into: &mut [u8], until: u64) -> Result<usize, PortFault> {
        either!(self, receive(into, until))
    }

    fn discard(&mut self) -> Result<(), PortFault> {
        either!(self, discard())
    }
}
