//! A GPIO line, through the Linux character device (second ABI, kernel 5.10 and later) and
//! `gpiocdev`.
//!
//! The line is requested once, as an input with its pull-up, and is held until it is dropped.
//! Reading it is one kernel call: a register access for processor pins. A chip behind I2C or SPI is
//! as slow as its bus; do not use one. No test machine had a chip: failures are tested with files
//! that are no chips, and the effects of a level by `emergency.rs`.

use gpiocdev::Request;
use gpiocdev::line::{Bias, Value};

/// A digital level; None if it cannot be read.
pub trait Line {
    fn high(&mut self) -> Option<bool>;
}

/// A requested line.
pub struct Gpio {
    request: Request,
    offset: u32,
}

impl Gpio {
    /// Request line `offset` of `chip` (`/dev/gpiochip0`) as an input with its pull-up, or return
    /// the reason for the failure.
    pub fn open(chip: &str, offset: u32) -> Result<Gpio, String> {
        let opened = || {
            let request = Request::builder()
                .on_chip(chip)
                .with_consumer("softmap emergency stop")
                .with_line(offset)
                .as_input()
                .with_bias(Bias::PullUp)
                .request()?;
            request.value(offset)?;
            Ok(Gpio { request, offset })
        };
        opened().map_err(|fault: gpiocdev::Error| {
            format!(
                "the emergency stop's line {offset} of {chip} cannot be had ({}); `gpioinfo` lists \
                 lines, mend [emergency] of rig.toml, or the permission to open the chip (group \
                 gpio)",
                fault.to_string().trim_end_matches('.')
            )
        })
    }
}

impl Line for Gpio {
    fn high(&mut self) -> Option<bool> {
        let value = self.request.value(self.offset).ok()?;
        Some(value == Value::Active)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_no_chip_is_refused_with_a_reason() {
        for (chip, why) in [
            ("/dev/gpiochip999", "No such file"),
            ("/dev/null", "not a GPIO"),
            ("/etc/hostname", "not a"),
        ] {
            let said = Gpio::open(chip, 17).err().unwrap();
            assert!(
                said.contains(&format!("line 17 of {chip} cannot be had")) && said.contains(why),
                "{said}"
            );
        }
    }
}
