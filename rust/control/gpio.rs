//! A line of a GPIO chip, by the character device of Linux (second ABI, kernel 5.10 and later; `linux/gpio.h`).
//!
//! The line is asked for once, as an input with its pull-up, and is ours until it is dropped. Reading it is one call to the
//! kernel: a register for pins of the processor; a chip behind I2C or SPI takes as long as its bus, use none for this.
//! No test machine had a chip: the structures are pinned by their sizes and request numbers, what fails by a file that is no
//! chip, and what follows from a level by `emergency.rs`.

use std::os::fd::{AsFd, FromRawFd, OwnedFd};

use rustix::fs::{Mode, OFlags, open};
use rustix::io::Errno;
use rustix::ioctl::{Updater, ioctl, opcode};

/// Something that is high or low.
pub trait Line {
    fn high(&mut self) -> Result<bool, Errno>;
}

/// A setting of lines.
#[repr(C)]
#[derive(Clone, Copy)]
struct Attribute {
    id: u32,
    padding: u32,
    value: u64,
    mask: u64,
}

#[repr(C)]
struct Request {
    offsets: [u32; 64],
    consumer: [u8; 32],
    flags: u64,
    attributes: u32,
    padding: [u32; 5],
    attribute: [Attribute; 10],
    lines: u32,
    event_buffer: u32,
    more_padding: [u32; 5],
    fd: i32,
}

#[repr(C)]
struct Values {
    bits: u64,
    mask: u64,
}

const GROUP: u8 = 0xB4;
const GET_LINE: rustix::ioctl::Opcode = opcode::read_write::<Request>(GROUP, 0x07);
const GET_VALUES: rustix::ioctl::Opcode = opcode::read_write::<Values>(GROUP, 0x0E);
const INPUT: u64 = 1 << 2;
const PULL_UP: u64 = 1 << 8;
const CONSUMER: &[u8] = b"softmap emergency stop";

/// A line that was asked for.
pub struct Gpio {
    line: OwnedFd,
}

impl Gpio {
    /// Ask for line `offset` of `chip` (`/dev/gpiochip0`), an input with its pull-up; or why that cannot be.
    pub fn open(chip: &str, offset: u32) -> Result<Gpio, String> {
        let failed = |what: &str, fault: Errno| {
            format!(
                "the emergency stop's line {offset} of {chip} {what} ({fault}); `gpioinfo` lists lines, mend [emergency] of \
                 rig.toml, or the permission to open the chip (group gpio)"
            )
        };
        let flags = OFlags::RDONLY | OFlags::CLOEXEC;
        let chip =
            open(chip, flags, Mode::empty()).map_err(|fault| failed("is not there", fault))?;
        let none = Attribute {
            id: 0,
            padding: 0,
            value: 0,
            mask: 0,
        };
        let mut request = Request {
            offsets: [0; 64],
            consumer: [0; 32],
            flags: INPUT | PULL_UP,
            attributes: 0,
            padding: [0; 5],
            attribute: [none; 10],
            lines: 1,
            event_buffer: 0,
            more_padding: [0; 5],
            fd: -1,
        };
        request.offsets[0] = offset;
        request.consumer[..CONSUMER.len()].copy_from_slice(CONSUMER);
        // SAFETY: the request number is that of this structure, which lives through the call.
        unsafe { ioctl(&chip, Updater::<GET_LINE, Request>::new(&mut request)) }
            .map_err(|fault| failed("cannot be had", fault))?;
        if request.fd < 0 {
            return Err(failed("cannot be had", Errno::BADF));
        }
        // SAFETY: the kernel has just opened it for us alone.
        let line = unsafe { OwnedFd::from_raw_fd(request.fd) };
        let mut gpio = Gpio { line };
        gpio.high()
            .map_err(|fault| failed("cannot be read", fault))?;
        Ok(gpio)
    }
}

impl Line for Gpio {
    fn high(&mut self) -> Result<bool, Errno> {
        let mut values = Values { bits: 0, mask: 1 };
        // SAFETY: the request number is that of this structure, which lives through the call.
        unsafe {
            ioctl(
                self.line.as_fd(),
                Updater::<GET_VALUES, Values>::new(&mut values),
            )
        }?;
        Ok(values.bits & 1 != 0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rustix::pipe::pipe;

    #[test]
    fn the_structures_are_those_of_the_kernel() {
        // The size of what is passed stands in bits 16 to 29 of a request number.
        assert_eq!((size_of::<Request>(), size_of::<Values>()), (592, 16));
        assert_eq!((GET_LINE, GET_VALUES), (0xC250_B407, 0xC010_B40E));
        let offsets = [
            std::mem::offset_of!(Request, consumer),
            std::mem::offset_of!(Request, flags),
            std::mem::offset_of!(Request, attribute),
            std::mem::offset_of!(Request, lines),
            std::mem::offset_of!(Request, fd),
        ];
        assert_eq!(offsets, [256, 288, 320, 560, 588]);
    }

    #[test]
    fn what_is_no_chip_is_refused_with_a_reason() {
        let said = Gpio::open("/dev/gpiochip999", 17).err().unwrap();
        assert!(said.contains("line 17 of /dev/gpiochip999 is not there"));
        let said = Gpio::open("/dev/null", 3).err().unwrap();
        assert!(said.contains("line 3 of /dev/null cannot be had"), "{said}");
    }

    #[test]
    fn a_line_that_cannot_be_read_says_so() {
        let (line, _other) = pipe().unwrap();
        assert!(Gpio { line }.high().is_err());
    }
}
