//! Orders through a pipe, as frames of fixed size: little-endian, packed in Python with `struct`.
//!
//! flags (u8: 1 enable key, 2 emergency, 4 command) · request (u8, 0 none) · 6 zeros ·
//! sent (u64 ns) · command (C f64, mm)
//!
//! The newest command wins. An enable key released in any frame counts as released. An emergency
//! stop pressed in any frame counts as pressed (until a later frame without it). Each request
//! counts, one per period. The emergency stops of the rig are also read.

use std::collections::VecDeque;
use std::os::fd::OwnedFd;

use rustix::fs::{OFlags, fcntl_getfl, fcntl_setfl};
use rustix::io::{Errno, read};
use softmap_servo::control::{Mailbox, Orders};
use softmap_servo::guard::{MOST_SERVOS, Request};
use softmap_servo::serial::monotonic;

use super::emergency::Emergency;

const HEAD: usize = 16;
/// Bytes per read.
const SOME: usize = 4096;
/// Most queued requests; requests faster than the loop are dropped.
const WAITING: usize = 16;

/// Orders from a pipe.
pub struct PipeMailbox {
    pipe: OwnedFd,
    channels: usize,
    bytes: Vec<u8>,
    requests: VecDeque<Request>,
    emergency: bool,
    stops: Emergency,
    closed: bool,
}

impl PipeMailbox {
    /// Read from `pipe`, commands of `channels` numbers; `stops` are the emergency stops of the
    /// rig.
    pub fn new(pipe: OwnedFd, channels: usize, stops: Emergency) -> PipeMailbox {
        if let Ok(flags) = fcntl_getfl(&pipe) {
            // If this fails, the loop waits for orders, holds, and releases tension.
            let _ = fcntl_setfl(&pipe, flags | OFlags::NONBLOCK);
        }
        PipeMailbox {
            pipe,
            channels,
            bytes: Vec::with_capacity(2 * SOME),
            requests: VecDeque::with_capacity(WAITING),
            emergency: false,
            stops,
            closed: false,
        }
    }

    /// Whether the sender of the orders is gone.
    pub fn closed(&self) -> bool {
        self.closed
    }

    /// Add a request from this side.
    pub fn ask(&mut self, request: Request) {
        if self.requests.len() < WAITING {
            self.requests.push_back(request);
        }
    }

    fn receive(&mut self) {
        let mut some = [0; SOME];
        while self.bytes.len() + SOME <= self.bytes.capacity() {
            match read(&self.pipe, &mut some) {
                Ok(0) => return self.closed = true,
                Ok(count) => self.bytes.extend_from_slice(&some[..count]),
                Err(Errno::INTR) => {}
                Err(Errno::AGAIN) => return,
                Err(_) => return self.closed = true,
            }
        }
    }
}

impl Mailbox for PipeMailbox {
    fn collect(&mut self) -> Orders {
        if !self.closed {
            self.receive();
        }
        let size = HEAD + 8 * self.channels;
        let whole = self.bytes.len() / size * size;
        let mut orders = Orders {
            heard: self.closed || whole > 0,
            deadman: !self.closed && whole > 0,
            emergency: self.stops.pressed(monotonic()),
            ..Orders::default()
        };
        for at in (0..whole).step_by(size) {
            let frame = &self.bytes[at..at + size];
            let number = |at: usize| std::array::from_fn::<u8, 8, _>(|k| frame[at + k]);
            orders.deadman &= frame[0] & 1 != 0;
            self.emergency = frame[0] & 2 != 0;
            orders.emergency |= self.emergency;
            if frame[0] & 4 != 0 {
                let mut command = [f64::NAN; MOST_SERVOS];
                for (k, place) in command.iter_mut().enumerate().take(self.channels) {
                    *place = f64::from_le_bytes(number(HEAD + 8 * k));
                }
                orders.command = Some(command);
                orders.sent = u64::from_le_bytes(number(8));
            }
            let asked = usize::from(frame[1]).checked_sub(1);
            if let Some(request) = asked.and_then(|k| Request::ALL.get(k))
                && self.requests.len() < WAITING
            {
                self.requests.push_back(*request);
            }
        }
        self.bytes.drain(..whole);
        orders.emergency |= self.emergency;
        orders.request = self.requests.pop_front();
        orders
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rustix::io::write;
    use rustix::pipe::pipe;

    fn frame(flags: u8, request: u8, sent: u64, command: [f64; 2]) -> Vec<u8> {
        let mut bytes = vec![flags, request, 0, 0, 0, 0, 0, 0];
        bytes.extend(sent.to_le_bytes());
        command.iter().for_each(|mm| bytes.extend(mm.to_le_bytes()));
        bytes
    }

    #[test]
    fn the_newest_command_wins_and_nothing_else_is_lost() {
        let (reader, writer) = pipe().unwrap();
        let mut mailbox = PipeMailbox::new(reader, 2, Emergency::default());
        let nothing = mailbox.collect();
        assert!(!nothing.heard && nothing.command.is_none() && nothing.request.is_none());
        let frames = [
            frame(5, 1, 7, [1.0, 2.0]),
            frame(5, 3, 8, [3.0, 4.0]),
            frame(1, 0, 9, [9.0, 9.0]),
        ]
        .concat();
        write(&writer, &frames[..40]).unwrap();
        let first = mailbox.collect();
        assert_eq!(
            (first.deadman, first.sent, first.request),
            (true, 7, Some(Request::Connect))
        );
        write(&writer, &frames[40..]).unwrap();
        let second = mailbox.collect();
        assert_eq!(second.command.unwrap()[..2], [3.0, 4.0]);
        assert_eq!((second.sent, second.request), (8, Some(Request::Arm)));
        write(
            &writer,
            &[
                frame(1, 0, 0, [0.0; 2]),
                frame(0, 0, 0, [0.0; 2]),
                frame(3, 99, 0, [0.0; 2]),
            ]
            .concat(),
        )
        .unwrap();
        let third = mailbox.collect();
        assert!(third.heard && !third.deadman && third.emergency && third.request.is_none());
        assert!(
            mailbox.collect().emergency,
            "pressed until another frame arrives"
        );
        write(
            &writer,
            &[frame(3, 0, 0, [0.0; 2]), frame(1, 0, 0, [0.0; 2])].concat(),
        )
        .unwrap();
        assert!(mailbox.collect().emergency, "pressed in one of two");
        assert!(!mailbox.collect().emergency, "and released since");
        mailbox.ask(Request::Stop);
        drop(writer);
        let last = mailbox.collect();
        assert!(mailbox.closed() && last.heard && !last.deadman);
        assert_eq!(last.request, Some(Request::Stop));
    }

    #[test]
    fn a_flood_is_survived() {
        let (reader, writer) = pipe().unwrap();
        let mut mailbox = PipeMailbox::new(reader, 2, Emergency::default());
        let flood = frame(5, 5, 1, [0.5, 0.5]).repeat(1000);
        write(&writer, &flood).unwrap();
        let asked = (0..40)
            .filter(|_| mailbox.collect().request == Some(Request::Hold))
            .count();
        assert!((WAITING..1000).contains(&asked), "{asked}");
    }
}
