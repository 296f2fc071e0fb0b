//! A half-duplex bus of servos: one request at a time, matched answers, a separate result for each
//! servo.
//!
//! Rules, each from a fault observed in practice. Input is discarded before a request. After a
//! time-out, the bus listens for one worst reply time before the next request, so a late answer is
//! never taken for the next one. An answer is valid only with the requested id, length and
//! instruction. A silent servo does not affect the answers of others. A missing value is never 0.
//! All deadlines use the monotonic clock of the port.

use crate::decoder::{Decoder, fast_slots};
use crate::packet::{BROADCAST, CLEAR_TURNS, Full, HEAD, HIGHEST_ID, LONGEST, Packet, instruction};
use crate::registers::{ALERT, STATUS_ERRORS, X_SERIES};

/// Bytes to and from a bus, and the clock of deadlines.
pub trait Port {
    /// ns since some start; never decreases.
    fn now(&self) -> u64;
    /// Sleep until `until`; not at all if it has passed.
    fn wait(&mut self, until: u64);
    /// Send all of `bytes`, or fail by `until`.
    fn send(&mut self, bytes: &[u8], until: u64) -> Result<(), PortFault>;
    /// Wait for bytes until `until`; 0 if none arrived.
    fn receive(&mut self, into: &mut [u8], until: u64) -> Result<usize, PortFault>;
    /// Discard received bytes that were not read.
    fn discard(&mut self) -> Result<(), PortFault>;
}

/// The fault of a port.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum PortFault {
    #[error("the port is gone: unplugged, or its adapter was reset")]
    Gone,
    #[error("the port takes no more bytes")]
    Stuck,
    #[error("the port failed (error {0} of the system)")]
    System(i32),
}

/// Why a request has no answer.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum Fault {
    #[error("no answer")]
    Silent,
    /// The error of the status, without the alert bit.
    #[error("the servo {}", refusal(*.0))]
    Refused(u8),
    #[error("{0}")]
    Port(#[from] PortFault),
    #[error("{0}")]
    Full(#[from] Full),
}

fn refusal(error: u8) -> &'static str {
    let known = STATUS_ERRORS.iter().find(|(code, _)| *code == error);
    known.map_or("answered with an unknown error", |(_, meaning)| meaning)
}

/// The answer of one servo.
pub type Heard = Result<Answer, Fault>;

/// An answer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Answer {
    /// The servo has a hardware error: read its status.
    pub alert: bool,
}

/// Counts of request results.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Counts {
    pub asked: u64,
    pub silent: u64,
    pub damaged: u64,
    pub skipped: u64,
    /// Answers after their deadline.
    pub late: u64,
    /// Unrequested answers: to another program, or from a second servo with the same id.
    pub unasked: u64,
}

/// Number of unanswered requests that are stored: an answer may be late.
const REMEMBERED: usize = 32;

/// The ids and sizes in bytes of answers that are still due.
#[derive(Debug, Clone, Copy, Default)]
struct Owed {
    id: u8,
    size: usize,
    count: u32,
}

/// The answers that are still due, and the place of the next entry.
#[derive(Debug, Clone, Copy, Default)]
struct Debts([Owed; REMEMBERED], usize);

impl Debts {
    fn add(&mut self, id: u8, size: usize) {
        let known = self
            .0
            .iter()
            .position(|one| (one.id, one.size) == (id, size));
        let place = known.unwrap_or(self.1);
        if known.is_none() {
            self.1 = (self.1 + 1) % REMEMBERED;
            self.0[place] = Owed { id, size, count: 0 };
        }
        self.0[place].count = self.0[place].count.saturating_add(1);
    }

    /// Remove such an answer from those that are due; return whether it was one of them.
    fn pay(&mut self, id: u8, size: usize) -> bool {
        let owed = |one: &&mut Owed| (one.id, one.size) == (id, size) && one.count > 0;
        self.0.iter_mut().find(owed).is_some_and(|one| {
            one.count -= 1;
            true
        })
    }
}

/// Most reads of waiting bytes before a request, so a continuous sender cannot block requests.
const MOST_READS: usize = 64;

/// Wait of a servo per lower id after a broadcast request, ns.
const PAUSE: u64 = 3_000_000;

/// Answer time of a servo beyond its return delay, plus transfer time of an adapter, ns.
pub const SLACK: u64 = 2_000_000;

/// Longest time for which an adapter keeps answers back: the latency timer of a new one, ns.
const ADAPTER: u64 = 16_000_000;

/// A bus at a port.
pub struct Bus<P> {
    port: P,
    baud: u32,
    /// ns between request and answer, without wire time.
    slack: u64,
    /// Deadline of late answers to older requests.
    quiet: u64,
    decoder: Decoder,
    counts: Counts,
    owed: Debts,
}

impl<P: Port> Bus<P> {
    /// A bus at `port`; `slack` is the longest return delay plus transfer time in ns (`SLACK`).
    pub fn new(port: P, baud: u32, slack: u64) -> Bus<P> {
        Bus {
            port,
            baud,
            slack,
            quiet: 0,
            decoder: Decoder::default(),
            counts: Counts::default(),
            owed: Debts::default(),
        }
    }

    pub fn port(&mut self) -> &mut P {
        &mut self.port
    }

    pub fn counts(&self) -> Counts {
        Counts {
            damaged: self.decoder.damaged,
            skipped: self.decoder.skipped,
            ..self.counts
        }
    }

    /// Wire time of `bytes`, ns: ten bits each.
    pub fn wire(&self, bytes: usize) -> u64 {
        bytes as u64 * 10_000_000_000 / u64::from(self.baud)
    }

    /// Ask `id` for its model number and firmware.
    pub fn ping(&mut self, id: u8) -> Result<(u16, u8), Fault> {
        let mut data = [0; 3];
        self.ask(id, instruction::PING, &[], &mut data)?;
        Ok((u16::from_le_bytes([data[0], data[1]]), data[2]))
    }

    /// Ask every servo for its model number and firmware; each answers after the lower ids.
    pub fn ping_all(&mut self, mut found: impl FnMut(u8, u16, u8)) -> Result<(), Fault> {
        let mut buffer = [0; LONGEST];
        let packet = Packet::new(&mut buffer, BROADCAST, instruction::PING).finish()?;
        self.send(packet)?;
        let count = usize::from(HIGHEST_ID) + 1;
        let mut until = self.port.now()
            + self.wire(packet.len() + longest(3))
            + count as u64 * PAUSE
            + self.slack
            + ADAPTER;
        let last = until + self.wire(count * longest(3)); // no sender delays the end further
        let mut some = [0; 256];
        loop {
            let received = self.port.receive(&mut some, until)?;
            if received == 0 {
                // Bytes of an incomplete packet also count as unread.
                self.decoder.skipped += self.decoder.waiting().len() as u64;
                self.decoder.clear();
                return Ok(());
            }
            // The higher ids waited for these bytes.
            until = last.min(until + self.wire(received));
            self.decoder.push(&some[..received]);
            while let Some(packet) = self.decoder.next(longest(3)) {
                if let Some((_, [low, high, firmware])) = packet.status() {
                    found(packet.id, u16::from_le_bytes([*low, *high]), *firmware);
                }
            }
        }
    }

    /// Write `data` to the registers from `address` on of every servo; none answers.
    pub fn write_all(&mut self, address: u16, data: &[u8]) -> Result<(), Fault> {
        let mut buffer = [0; LONGEST];
        let mut packet = Packet::new(&mut buffer, BROADCAST, instruction::WRITE);
        packet.word(address);
        packet.bytes(data);
        let packet = packet.finish()?;
        self.send(packet)
    }

    /// Switch the torque of all servos off, whether or not they answer.
    pub fn release(&mut self) -> Result<(), Fault> {
        self.write_all(X_SERIES.torque_enable.address, &[0])
    }

    /// Read the registers from `address` on into `data`.
    pub fn read(&mut self, id: u8, address: u16, data: &mut [u8]) -> Heard {
        let [a, b] = address.to_le_bytes();
        let [c, d] = (data.len() as u16).to_le_bytes();
        self.ask(id, instruction::READ, &[&[a, b, c, d]], data)
    }

    /// Write `data` to the registers from `address` on.
    pub fn write(&mut self, id: u8, address: u16, data: &[u8]) -> Heard {
        self.ask(
            id,
            instruction::WRITE,
            &[&address.to_le_bytes(), data],
            &mut [],
        )
    }

    /// Restart a servo: its RAM and, in modes that count turns, its turns are lost.
    pub fn reboot(&mut self, id: u8) -> Heard {
        self.ask(id, instruction::REBOOT, &[], &mut [])
    }

    /// Reset the present position to within one turn; only at standstill.
    pub fn clear_turns(&mut self, id: u8) -> Heard {
        self.ask(id, instruction::CLEAR, &[&CLEAR_TURNS], &mut [])
    }

    /// Write `data` (one `size` after another) to each of `ids`; none answers.
    pub fn sync_write(
        &mut self,
        ids: &[u8],
        address: u16,
        size: usize,
        data: &[u8],
    ) -> Result<(), Fault> {
        let mut buffer = [0; LONGEST];
        let mut packet = Packet::new(&mut buffer, BROADCAST, instruction::SYNC_WRITE);
        packet.word(address);
        packet.word(size as u16);
        for (id, data) in ids.iter().zip(data.chunks_exact(size.max(1))) {
            packet.byte(*id);
            packet.bytes(data);
        }
        let packet = packet.finish()?;
        self.send(packet)
    }

    /// Read `size` bytes from `address` on of each of `ids` into `data`; `heard` has the result of
    /// each.
    ///
    /// `fast` requests all answers in one packet, which servos with `FAST_FIRMWARE` or later
    /// support.
    pub fn sync_read(
        &mut self,
        ids: &[u8],
        address: u16,
        size: usize,
        data: &mut [u8],
        heard: &mut [Heard],
        fast: bool,
    ) -> Result<(), Fault> {
        let mut buffer = [0; LONGEST];
        let asked = if fast {
            instruction::FAST_SYNC_READ
        } else {
            instruction::SYNC_READ
        };
        let mut packet = Packet::new(&mut buffer, BROADCAST, asked);
        packet.word(address);
        packet.word(size as u16);
        packet.bytes(ids);
        let packet = packet.finish()?;
        heard.fill(Err(Fault::Silent));
        self.send(packet)?;
        let bytes = packet.len() + ids.len() * longest(size);
        let until = self.port.now()
            + self.wire(bytes)
            + self.slack * if fast { 1 } else { ids.len() as u64 };
        let found = if fast {
            self.collect_fast(ids, size, data, heard, until)
        } else {
            self.collect(ids, size, data, heard, until)
        };
        self.note(ids, size, heard);
        found
    }

    /// Send a request to one servo, and read its answer into `data`.
    fn ask(&mut self, id: u8, instruction: u8, parameters: &[&[u8]], data: &mut [u8]) -> Heard {
        let mut buffer = [0; LONGEST];
        let mut packet = Packet::new(&mut buffer, id, instruction);
        parameters.iter().for_each(|part| packet.bytes(part));
        let packet = packet.finish()?;
        self.send(packet)?;
        let until = self.port.now() + self.wire(packet.len() + longest(data.len())) + self.slack;
        let mut heard = [Err(Fault::Silent)];
        let found = self.collect(&[id], data.len(), data, &mut heard, until);
        self.note(&[id], data.len(), &heard);
        found.and(heard[0])
    }

    fn note(&mut self, ids: &[u8], size: usize, heard: &[Heard]) {
        for (id, _) in ids
            .iter()
            .zip(heard)
            .filter(|(_, one)| **one == Err(Fault::Silent))
        {
            self.owed.add(*id, size);
        }
        let silent = heard
            .iter()
            .filter(|one| **one == Err(Fault::Silent))
            .count() as u64;
        self.counts.asked += heard.len() as u64;
        self.counts.silent += silent;
        if silent > 0 {
            self.quiet = self.port.now() + self.wire(heard.len() * longest(0)) + self.slack;
        }
    }

    fn send(&mut self, packet: &[u8]) -> Result<(), Fault> {
        let mut lost = [0; 256];
        for _ in 0..MOST_READS {
            let until = self.port.now().max(self.quiet);
            let count = self.port.receive(&mut lost, until)?;
            if count == 0 {
                break;
            }
            self.decoder.push(&lost[..count]);
            self.count_unasked();
        }
        self.port.discard()?;
        self.decoder.skipped += self.decoder.waiting().len() as u64;
        self.decoder.clear();
        let until = self.port.now() + self.wire(packet.len()) + self.slack;
        Ok(self.port.send(packet, until)?)
    }

    /// Count received answers without a pending request.
    fn count_unasked(&mut self) {
        while let Some(packet) = self.decoder.next(LONGEST) {
            // An answer of all servos in one packet was read in place.
            if let Some((_, body)) = packet.status()
                && packet.id != BROADCAST
            {
                let late = self.owed.pay(packet.id, body.len());
                self.counts.late += u64::from(late);
                self.counts.unasked += u64::from(!late);
            }
        }
    }

    fn collect(
        &mut self,
        ids: &[u8],
        size: usize,
        data: &mut [u8],
        heard: &mut [Heard],
        until: u64,
    ) -> Result<(), Fault> {
        let mut some = [0; 256];
        let mut missing = ids.len();
        while missing > 0 {
            let count = self.port.receive(&mut some, until)?;
            if count == 0 {
                break;
            }
            self.decoder.push(&some[..count]);
            while let Some(packet) = self.decoder.next(longest(size)) {
                let Some((error, body)) = packet.status() else {
                    continue;
                };
                let refused = error & !ALERT != 0;
                let fits = |place: &usize| {
                    heard[*place] == Err(Fault::Silent) && (refused || body.len() == size)
                };
                let place = ids.iter().position(|id| *id == packet.id).filter(fits);
                let Some(place) = place else {
                    let late = self.owed.pay(packet.id, body.len());
                    self.counts.late += u64::from(late);
                    self.counts.unasked += u64::from(!late);
                    continue;
                };
                heard[place] = if refused {
                    Err(Fault::Refused(error & !ALERT))
                } else {
                    data[place * size..(place + 1) * size].copy_from_slice(body);
                    Ok(Answer {
                        alert: error & ALERT != 0,
                    })
                };
                missing -= 1;
            }
        }
        Ok(())
    }

    fn collect_fast(
        &mut self,
        ids: &[u8],
        size: usize,
        data: &mut [u8],
        heard: &mut [Heard],
        until: u64,
    ) -> Result<(), Fault> {
        let mut some = [0; 256];
        let mut found = 0;
        while found < ids.len() {
            let count = self.port.receive(&mut some, until)?;
            if count == 0 {
                break;
            }
            self.decoder.push(&some[..count]);
            for (place, error, body) in fast_slots(self.decoder.waiting(), ids, size).skip(found) {
                found = place + 1;
                data[place * size..found * size].copy_from_slice(body);
                let refused = error & !ALERT;
                heard[place] = match refused {
                    0 => Ok(Answer {
                        alert: error & ALERT != 0,
                    }),
                    _ => Err(Fault::Refused(refused)),
                };
            }
        }
        if found < ids.len() && !self.decoder.waiting().is_empty() {
            self.decoder.damaged += 1;
        } else {
            self.count_unasked();
        }
        self.decoder.clear();
        Ok(())
    }
}

/// Bytes of the longest answer with `size` bytes of data: stuffing adds one in three at most.
const fn longest(size: usize) -> usize {
    HEAD + 4 + size + size / 3 + 1
}

#[cfg(test)]
#[path = "bus_tests.rs"]
mod tests;
