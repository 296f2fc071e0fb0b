//! A serial port: raw, exclusive, any baud rate, deadlines of the system's monotonic clock.

use std::os::fd::OwnedFd;

use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::fs::{FlockOperation, Mode, OFlags, flock, open};
use rustix::io::{Errno, read, write};
use rustix::termios::{
    ControlModes, OptionalActions, QueueSelector, ioctl_tiocexcl, ioctl_tiocnxcl, tcflush,
    tcgetattr, tcsetattr,
};
use rustix::thread::clock_nanosleep_absolute;
use rustix::time::{ClockId, clock_gettime};

use crate::bus::{Port, PortFault};

/// Why a port could not be opened, and the remedy.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum OpenFault {
    #[error("{0}: no such port; `softmap servo scan` lists those there are")]
    Missing(String),
    #[error(
        "{0}: no permission; add yourself to the group that owns it (dialout): sudo usermod -aG \
        dialout $USER, then log in again"
    )]
    Forbidden(String),
    #[error("{0} is in use by another program; close it first")]
    Busy(String),
    #[error("{0} is no serial port")]
    NoTerminal(String),
    #[error("{0}: cannot be set to {1} baud; choose a rate that the adapter knows")]
    Baud(String, u32),
    #[error("{0}: cannot be opened (error {1} of the system)")]
    System(String, i32),
}

/// ns of the system's monotonic clock.
pub fn monotonic() -> u64 {
    let now = clock_gettime(ClockId::Monotonic);
    now.tv_sec as u64 * 1_000_000_000 + now.tv_nsec as u64
}

/// An open serial port. No other program can open it: TIOCEXCL and an advisory lock prevent it.
pub struct Serial {
    file: OwnedFd,
}

impl Serial {
    /// Open `path` at `baud`, 8 data bits, no parity, one stop bit.
    pub fn open(path: &str, baud: u32) -> Result<Serial, OpenFault> {
        let named = || path.to_owned();
        let flags = OFlags::RDWR | OFlags::NOCTTY | OFlags::NONBLOCK | OFlags::CLOEXEC;
        let file = open(path, flags, Mode::empty()).map_err(|fault| match fault {
            Errno::NOENT | Errno::NOTDIR | Errno::NXIO | Errno::NODEV => {
                OpenFault::Missing(named())
            }
            Errno::ACCESS | Errno::PERM => OpenFault::Forbidden(named()),
            Errno::BUSY => OpenFault::Busy(named()),
            Errno::ISDIR => OpenFault::NoTerminal(named()),
            other => OpenFault::System(named(), other.raw_os_error()),
        })?;
        let mut settings = tcgetattr(&file).map_err(|_| OpenFault::NoTerminal(named()))?;
        flock(&file, FlockOperation::NonBlockingLockExclusive)
            .map_err(|_| OpenFault::Busy(named()))?;
        ioctl_tiocexcl(&file).map_err(|_| OpenFault::Busy(named()))?;
        settings.make_raw();
        settings.control_modes |= ControlModes::CREAD | ControlModes::CLOCAL;
        settings.control_modes &= !(ControlModes::CSTOPB | ControlModes::CRTSCTS);
        let set = settings
            .set_speed(baud)
            .and_then(|()| tcsetattr(&file, OptionalActions::Now, &settings))
            .and_then(|()| tcgetattr(&file));
        match set {
            Ok(set) if set.output_speed() == baud => Ok(Serial { file }),
            _ => Err(OpenFault::Baud(named(), baud)),
        }
    }

    /// Wait for `what` until `until`; return whether it occurred.
    fn ready(&self, what: PollFlags, until: u64) -> Result<bool, PortFault> {
        loop {
            let left = until.saturating_sub(monotonic());
            let left = Timespec {
                tv_sec: (left / 1_000_000_000) as i64,
                tv_nsec: (left % 1_000_000_000) as i64,
            };
            let mut asked = [PollFd::new(&self.file, what)];
            match poll(&mut asked, Some(&left)) {
                Ok(0) => return Ok(false),
                Ok(_) if asked[0].revents().intersects(what) => return Ok(true),
                Ok(_) => return Err(PortFault::Gone),
                Err(Errno::INTR) => {}
                Err(fault) => return Err(failed(fault)),
            }
        }
    }
}

impl Drop for Serial {
    fn drop(&mut self) {
        // A port that another program keeps open, as the emulator does, is free again; a lost port
        // does not need it.
        let _ = ioctl_tiocnxcl(&self.file);
    }
}

impl Port for Serial {
    fn now(&self) -> u64 {
        monotonic()
    }

    fn wait(&mut self, until: u64) {
        let until = Timespec {
            tv_sec: (until / 1_000_000_000) as i64,
            tv_nsec: (until % 1_000_000_000) as i64,
        };
        while clock_nanosleep_absolute(ClockId::Monotonic, &until) == Err(Errno::INTR) {}
    }

    fn send(&mut self, mut bytes: &[u8], until: u64) -> Result<(), PortFault> {
        while !bytes.is_empty() {
            match write(&self.file, bytes) {
                Ok(count) => bytes = &bytes[count..],
                Err(Errno::AGAIN) => {
                    if !self.ready(PollFlags::OUT, until)? {
                        return Err(PortFault::Stuck);
                    }
                }
                Err(Errno::INTR) => {}
                Err(fault) => return Err(failed(fault)),
            }
        }
        Ok(())
    }

    fn receive(&mut self, into: &mut [u8], until: u64) -> Result<usize, PortFault> {
        loop {
            match read(&self.file, &mut *into) {
                // A terminal with a closed other end always reads as empty.
                Ok(0) => return Err(PortFault::Gone),
                Ok(count) => return Ok(count),
                Err(Errno::AGAIN) => {
                    if !self.ready(PollFlags::IN, until)? {
                        return Ok(0);
                    }
                }
                Err(Errno::INTR) => {}
                Err(fault) => return Err(failed(fault)),
            }
        }
    }

    fn discard(&mut self) -> Result<(), PortFault> {
        tcflush(&self.file, QueueSelector::IFlush).map_err(failed)
    }
}

fn failed(fault: Errno) -> PortFault {
    match fault {
        Errno::IO | Errno::NODEV | Errno::NXIO | Errno::PIPE | Errno::BADF => PortFault::Gone,
        other => PortFault::System(other.raw_os_error()),
    }
}
