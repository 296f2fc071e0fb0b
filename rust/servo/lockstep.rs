//! A port of simulated servos whose time passes only in steps of the master
//! (`emulator/simulated.rs` is the other end).
//!
//! A local socket in place of a wire. A question is (operation u8, size u16, value u64, bytes), an
//! answer (time u64 ns, size u16, bytes), little-endian. The clock of the port is that of the
//! servos. It stops while no program waits, so a busy computer does not delay servos.

use std::io::{ErrorKind, Read, Write};
use std::os::unix::net::UnixStream;
use std::thread::sleep;
use std::time::{Duration, Instant};

use crate::bus::{Port, PortFault};
use crate::packet::LONGEST;
use crate::serial::OpenFault;

/// Operations.
pub const HELLO: u8 = 1;
pub const HEAR: u8 = 2;
pub const WAIT: u8 = 3;
pub const RECEIVE: u8 = 4;
pub const BYE: u8 = 5;
/// Header bytes of a question, and of an answer.
pub const ASKED: usize = 11;
pub const ANSWERED: usize = 10;
/// The byte that answers a greeting while another master has the port.
pub const BUSY: u8 = b'B';

/// Retry time for a port that another master has just left.
const LEAVES: Duration = Duration::from_secs(2);
/// Interval of such questions; also the duration of a period once the other end is lost.
const AGAIN: Duration = Duration::from_millis(5);

/// A connection to simulated servos.
pub struct Lockstep {
    stream: UnixStream,
    now: u64,
    forget: bool,
    gone: bool,
}

impl Lockstep {
    /// Connect to the socket at `path`, exclusively.
    pub fn open(path: &str, baud: u32) -> Result<Lockstep, OpenFault> {
        let begun = Instant::now();
        loop {
            let stream =
                UnixStream::connect(path).map_err(|_| OpenFault::Missing(path.to_owned()))?;
            let mut port = Lockstep {
                stream,
                now: 0,
                forget: false,
                gone: false,
            };
            let mut busy = [0];
            match port.ask(HELLO, baud.into(), &[], &mut busy) {
                Ok(0) => return Ok(port),
                Ok(_) if begun.elapsed() < LEAVES => sleep(AGAIN),
                Ok(_) => return Err(OpenFault::Busy(path.to_owned())),
                Err(_) => return Err(OpenFault::Missing(path.to_owned())),
            }
        }
    }

    /// Send a question and wait for the answer; return its number of bytes in `into`.
    fn ask(
        &mut self,
        operation: u8,
        value: u64,
        bytes: &[u8],
        into: &mut [u8],
    ) -> Result<usize, PortFault> {
        let wanted = if operation == RECEIVE {
            into.len()
        } else {
            bytes.len()
        };
        self.put(operation, wanted, value, bytes)?;
        let mut head = [0; ANSWERED];
        self.take(&mut head)?;
        let (time, size) = head.split_at(8);
        self.now = time.try_into().map_or(self.now, u64::from_le_bytes);
        let size = usize::from(u16::from_le_bytes([size[0], size[1]]));
        match into.get_mut(..size) {
            Some(into) => self.take(into).map(|()| size),
            None => Err(self.lost()),
        }
    }

    fn put(
        &mut self,
        operation: u8,
        size: usize,
        value: u64,
        bytes: &[u8],
    ) -> Result<(), PortFault> {
        let mut frame = [0; ASKED + LONGEST];
        frame[0] = operation;
        frame[1..3].copy_from_slice(&(size as u16).to_le_bytes());
        frame[3..ASKED].copy_from_slice(&value.to_le_bytes());
        let Some(place) = frame.get_mut(ASKED..ASKED + bytes.len()) else {
            return Err(PortFault::Stuck);
        };
        place.copy_from_slice(bytes);
        let sent = self.stream.write_all(&frame[..ASKED + bytes.len()]);
        sent.map_err(|_| self.lost())
    }

    fn take(&mut self, into: &mut [u8]) -> Result<(), PortFault> {
        let came = self.stream.read_exact(into);
        came.map_err(|_| self.lost())
    }

    fn lost(&mut self) -> PortFault {
        self.gone = true;
        PortFault::Gone
    }
}

impl Drop for Lockstep {
    fn drop(&mut self) {
        // The port is free once this is answered; a lost end does not answer.
        let _ = self.ask(BYE, 0, &[], &mut []);
    }
}

impl Port for Lockstep {
    fn now(&self) -> u64 {
        self.now
    }

    fn wait(&mut self, until: u64) {
        if until > self.now && !self.gone {
            // The next question reports a lost end.
            let _ = self.ask(WAIT, until, &[], &mut []);
        }
        if self.gone {
            sleep(AGAIN);
            self.now = self.now.max(until);
        }
    }

    fn send(&mut self, bytes: &[u8], _until: u64) -> Result<(), PortFault> {
        if self.gone {
            return Err(PortFault::Gone);
        }
        let forget = u64::from(std::mem::take(&mut self.forget));
        self.put(HEAR, bytes.len(), forget, bytes)
    }

    fn receive(&mut self, into: &mut [u8], until: u64) -> Result<usize, PortFault> {
        if self.gone {
            return Err(PortFault::Gone);
        }
        self.ask(RECEIVE, until, &[], into)
    }

    fn discard(&mut self) -> Result<(), PortFault> {
        self.forget = true;
        Ok(())
    }
}

/// Whether an error of a socket means that the other side has not sent anything yet.
pub(crate) fn passing(kind: ErrorKind) -> bool {
    matches!(
        kind,
        ErrorKind::WouldBlock | ErrorKind::TimedOut | ErrorKind::Interrupted
    )
}
